"""Write a software bill of materials of the wheel, in CycloneDX's JSON: build/sbom.json or a path given.

Run as ``python -m release.sbom [PATH]`` with ``tests`` on PYTHONPATH. cyclonedx-py lists what is installed
in this environment; what the wheel needs is kept, its extras included, and what it ships of others is added.
"""

from __future__ import annotations

import json
import re
import sys
from importlib import metadata
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

from cyclonedx.schema import SchemaVersion
from cyclonedx.validation.json import JsonStrictValidator
from packaging.requirements import Requirement
from packaging.utils import canonicalize_name

from c_ref.consumer import version_of_header
from mcp_asdf_tools.common import write_atomically
from support import ROOT, run

UPLOT = ROOT / "host_tools/mcp_asdf_tools/view/page/uplot/uPlot.iife.min.js"
"""Software of others in the wheel: a library of the page."""
UPLOT_VERSION = re.compile(r"uPlot \(v([\d.]+)\)")
NAME = "mcp-asdf"
PROJECT = "root-component"
"""The project's own reference in a bill of cyclonedx-py."""

Bill = dict[str, Any]
"""A bill as JSON holds it."""


def of_environment(folder: Path) -> Bill:
    """All that is installed beside this Python; the bill names no time and no folder."""
    written = folder / "environment.json"
    tool = (
        Path(sys.executable).with_name("cyclonedx-py"),
        "environment",
        "--output-reproducible",
        "--sv",
        "1.6",
    )
    about = ("--pyproject", ROOT / "pyproject.toml", "--mc-type", "library", "--short-PURLs")
    command = (*tool, *about, "--output-file", written, sys.executable)
    run(*command)
    bill: Bill = json.loads(written.read_text(encoding="utf-8"))
    return bill


def needed() -> set[str]:
    """Normal names of all that the project needs, directly or not, its extras included."""
    extras = frozenset(metadata.metadata(NAME).get_all("Provides-Extra") or ())
    left = [(canonicalize_name(NAME), extras)]
    found = set(left)
    while left:
        name, extras = left.pop()
        for required in map(Requirement, metadata.requires(name) or ()):
            marker = required.marker
            if marker is None or any(marker.evaluate({"extra": each}) for each in {"", *extras}):
                new = canonicalize_name(required.name), frozenset(required.extras)
                left += [new] if new not in found else []
                found.add(new)
    return {str(name) for name, _ in found} - {NAME}


def uplot() -> Bill:
    """The library of the page, by the version that its first line states."""
    stated = UPLOT_VERSION.search(UPLOT.read_text(encoding="utf-8")[:200])
    assert stated, f"{UPLOT} states no version"
    return {
        "bom-ref": f"uplot=={stated[1]}",
        "type": "library",
        "name": "uplot",
        "version": stated[1],
        "purl": f"pkg:npm/uplot@{stated[1]}",
        "licenses": [{"license": {"id": "MIT", "acknowledgement": "declared"}}],
    }


def of_wheel(bill: Bill, names: set[str]) -> Bill:
    """The part of an environment's bill with these normal names, and what the wheel ships."""
    shipped = uplot()
    components = [each for each in bill["components"] if canonicalize_name(each["name"]) in names]
    kept = {PROJECT, *(each["bom-ref"] for each in components)}
    dependencies = [
        {"ref": each["ref"], "dependsOn": [ref for ref in each.get("dependsOn", ()) if ref in kept]}
        for each in bill["dependencies"]
        if each["ref"] in kept
    ]
    for each in dependencies:
        if each["ref"] == PROJECT:
            each["dependsOn"] = [*each["dependsOn"], shipped["bom-ref"]]
    own = {**bill["metadata"]["component"], "version": version_of_header()}
    return {
        **bill,
        "metadata": {**bill["metadata"], "component": own},
        "components": [*components, shipped],
        "dependencies": [*dependencies, {"ref": shipped["bom-ref"]}],
    }


def write(path: Path) -> None:
    """Write the bill of this environment's wheel. Raises ValueError if it breaks CycloneDX's schema."""
    with TemporaryDirectory(prefix="mcp-asdf-") as folder:
        bill = of_wheel(of_environment(Path(folder)), needed())
    text = json.dumps(bill, indent=2, ensure_ascii=False) + "\n"
    wrong = JsonStrictValidator(SchemaVersion.V1_6).validate_str(text)
    if wrong is not None:
        raise ValueError(f"the bill breaks CycloneDX's schema: {wrong}")
    path.parent.mkdir(parents=True, exist_ok=True)
    write_atomically(path, text)


def main(arguments: list[str]) -> None:
    """Write the bill and tell how much is in it."""
    path = Path(arguments[0]) if arguments else ROOT / "build/sbom.json"
    write(path)
    count = len(json.loads(path.read_text(encoding="utf-8"))["components"])
    print(f"{path}: {count} components")


if __name__ == "__main__":
    main(sys.argv[1:])
