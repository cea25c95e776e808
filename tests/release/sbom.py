"""Write a software bill of materials of the wheel, in CycloneDX's JSON: build/sbom.json or a path given.

Run as ``python -m release.sbom [PATH]`` with ``tests`` on PYTHONPATH. cyclonedx-py lists what is installed
here; what the wheel needs is kept, its extras included, and uPlot, which it ships, is added.
"""

from __future__ import annotations

import json
import re
import sys
from importlib import metadata
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

from packaging.requirements import Requirement
from packaging.utils import canonicalize_name

from c_ref.consumer import version_of_header
from mcp_asdf_tools.common.files import write_atomically
from support import ROOT, run

UPLOT = ROOT / "host_tools/mcp_asdf_tools/view/page/uplot/uPlot.iife.min.js"
NAME = "mcp-asdf"


def needed() -> set[str]:
    """Normal names of all that the project needs, directly or not, its extras included."""
    left = [(NAME, frozenset(metadata.metadata(NAME).get_all("Provides-Extra") or ()))]
    found = set(left)
    while left:
        name, extras = left.pop()
        for required in map(Requirement, metadata.requires(name) or ()):
            marker = required.marker
            if marker is None or any(marker.evaluate({"extra": each}) for each in {"", *extras}):
                new = str(canonicalize_name(required.name)), frozenset(required.extras)
                left += [new] if new not in found else []
                found.add(new)
    return {name for name, _ in found} - {NAME}


def bill() -> dict[str, Any]:
    """Bill of all that is installed here and needed, and of uPlot by the version it states."""
    with TemporaryDirectory(prefix="mcp-asdf-") as folder:
        written = Path(folder, "environment.json")
        tool = (Path(sys.executable).with_name("cyclonedx-py"), "environment", "--output-reproducible")
        about = (
            "--sv",
            "1.6",
            "--pyproject",
            ROOT / "pyproject.toml",
            "--mc-type",
            "library",
            "--short-PURLs",
        )
        run(*tool, *about, "--output-file", written, sys.executable)
        found: dict[str, Any] = json.loads(written.read_text(encoding="utf-8"))
    stated = re.search(r"uPlot \(v([\d.]+)\)", UPLOT.read_text(encoding="utf-8")[:200])
    assert stated, f"{UPLOT} states no version"
    uplot = {
        **{"bom-ref": "uplot", "type": "library", "name": "uplot", "version": stated[1]},
        **{"purl": f"pkg:npm/uplot@{stated[1]}", "licenses": [{"license": {"id": "MIT"}}]},
    }
    own, names = found["metadata"]["component"], needed()
    own["version"] = version_of_header()
    components = [each for each in found["components"] if canonicalize_name(each["name"]) in names]
    kept = {own["bom-ref"], *(each["bom-ref"] for each in components)}
    dependencies = [
        {**each, "dependsOn": [one for one in each.get("dependsOn", ()) if one in kept]}
        for each in found["dependencies"]
        if each["ref"] in kept
    ]
    return {**found, "components": [*components, uplot], "dependencies": dependencies}


def main(arguments: list[str]) -> None:
    """Write the bill and tell how much is in it."""
    path = Path(arguments[0]) if arguments else ROOT / "build/sbom.json"
    found = bill()
    path.parent.mkdir(parents=True, exist_ok=True)
    write_atomically(path, json.dumps(found, indent=2, ensure_ascii=False) + "\n")
    print(f"{path}: {len(found['components'])} components")


if __name__ == "__main__":
    main(sys.argv[1:])
