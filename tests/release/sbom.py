"""Write a software bill of materials of the wheel, in CycloneDX's JSON: build/sbom.json or a path given.

Run as ``python -m release.sbom [PATH]`` with ``tests`` on PYTHONPATH. The bill has what the wheel needs, its
extras included, in the versions installed here, and uPlot, which it ships; each with its licences and a hash.
"""

from __future__ import annotations

import hashlib
import json
import re
import sys
from importlib import metadata
from pathlib import Path
from typing import Any

from packaging.requirements import Requirement
from packaging.utils import canonicalize_name

from mcp_asdf_tools.common.files import write_atomically
from support import ROOT, version_of_header

UPLOT = ROOT / "host_tools/mcp_asdf_tools/view/page/uplot/uPlot.iife.min.js"
NAME = "mcp-asdf"
OF_THE_INSTALLER = {"INSTALLER", "REQUESTED", "RECORD", "direct_url.json", "uv_cache.json"}


def dependencies() -> dict[str, set[str]]:
    """Normal names of the project and of all that it needs, directly or not, its extras included; and what
    each of them needs."""
    found = dict[str, set[str]]()
    left = [(NAME, frozenset(metadata.metadata(NAME).get_all("Provides-Extra") or ()))]
    seen = set(left)
    while left:
        name, extras = left.pop()
        needs = found.setdefault(name, set())
        for required in map(Requirement, metadata.requires(name) or ()):
            marker = required.marker
            if marker is None or any(marker.evaluate({"extra": each}) for each in {"", *extras}):
                new = str(canonicalize_name(required.name)), frozenset(required.extras)
                needs.add(new[0])
                left += [new] if new not in seen else []
                seen.add(new)
    return {name: needs - {NAME} for name, needs in found.items()}


def component(name: str, version: str, kind: str = "pypi", **more: Any) -> dict[str, Any]:
    """An entry of the bill."""
    about = {"bom-ref": name, "type": "library", "name": name, "version": version}
    return {**about, "purl": f"pkg:{kind}/{name}@{version}", **more}


def licences(about: metadata.PackageMetadata) -> list[dict[str, Any]]:
    """Return the licences that a package states: an expression, classifiers, or the first line of a text."""
    if expressions := about.get_all("License-Expression"):
        return [{"expression": each} for each in expressions]
    stated = [each for each in about.get_all("Classifier") or () if each.startswith("License ::")]
    names = [each.rpartition(" :: ")[2] for each in stated] or "".join(
        about.get_all("License") or ()
    ).splitlines()[:1]
    return [{"license": {"name": name}} for name in names]


def digest(name: str) -> str:
    """SHA-256 over the paths and SHA-256 of the files that the package's wheel has, whatever installed it."""
    files = metadata.files(name) or ()
    rows = [f"{path} {path.hash.value}" for path in files if path.hash and path.name not in OF_THE_INSTALLER]
    return hashlib.sha256("\n".join(sorted(rows)).encode()).hexdigest()


def bill() -> dict[str, Any]:
    """Bill of all that is needed, and of uPlot by the version it states."""
    needs = dependencies()
    stated = re.search(r"uPlot \(v([\d.]+)\)", UPLOT.read_text(encoding="utf-8")[:200])
    assert stated, f"{UPLOT} states no version"
    needed = []
    for name in sorted(needs.keys() - {NAME}):
        about = metadata.metadata(name)
        files = [{"name": "mcp-asdf:sha-256-of-files", "value": digest(name)}]
        needed.append(component(name, about["Version"], licenses=licences(about), properties=files))
    hashes = [{"alg": "SHA-256", "content": hashlib.sha256(UPLOT.read_bytes()).hexdigest()}]
    uplot = component("uplot", stated[1], "npm", licenses=[{"license": {"id": "MIT"}}], hashes=hashes)
    return {
        **{"bomFormat": "CycloneDX", "specVersion": "1.6", "version": 1},
        "metadata": {"component": component(NAME, version_of_header())},
        "components": [*needed, uplot],
        "dependencies": [{"ref": name, "dependsOn": sorted(each)} for name, each in sorted(needs.items())],
    }


def main(arguments: list[str]) -> None:
    """Write the bill and tell how much is in it."""
    path = Path(arguments[0]) if arguments else ROOT / "build/sbom.json"
    found = bill()
    path.parent.mkdir(parents=True, exist_ok=True)
    write_atomically(path, json.dumps(found, indent=2, ensure_ascii=False) + "\n")
    print(f"{path}: {len(found['components'])} components")


if __name__ == "__main__":
    main(sys.argv[1:])
