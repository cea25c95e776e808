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
    """Return a dictionary from a package's name to the names of the packages that it needs.

    Its keys are the project with all its extras, and all packages that it needs directly or indirectly.
    """
    names_by_package = dict[str, set[str]]()
    waiting = {(NAME, frozenset(metadata.metadata(NAME).get_all("Provides-Extra") or ()))}
    known = set(waiting)
    while waiting:
        package, extras = waiting.pop()
        needs = needs_of(package, extras)
        names = names_by_package.setdefault(package, set())
        names |= {name for name, _extras in needs}
        waiting |= needs - known
        known |= needs
    return {package: names - {NAME} for package, names in names_by_package.items()}


def needs_of(package: str, extras: frozenset[str]) -> set[tuple[str, frozenset[str]]]:
    """Return the packages that a package with these extras needs.

    A needed package is a pair of its name and those of its own extras that are needed.
    """
    needs = set()
    for text in metadata.requires(package) or ():
        requirement = Requirement(text)
        marker = requirement.marker
        if marker is None or any(marker.evaluate({"extra": extra}) for extra in {"", *extras}):
            needs.add((str(canonicalize_name(requirement.name)), frozenset(requirement.extras)))
    return needs


def component(name: str, version: str, kind: str = "pypi", **more: Any) -> dict[str, Any]:
    """Return an entry of the bill; ``kind`` is that of the index of packages."""
    about = {"bom-ref": name, "type": "library", "name": name, "version": version}
    return {**about, "purl": f"pkg:{kind}/{name}@{version}", **more}


def licences(about: metadata.PackageMetadata) -> list[dict[str, Any]]:
    """Return the licences that a package states: an expression, classifiers, or the first line of a text."""
    expressions = about.get_all("License-Expression")
    if expressions:
        return [{"expression": expression} for expression in expressions]
    classifiers = about.get_all("Classifier") or ()
    names = [text.rpartition(" :: ")[2] for text in classifiers if text.startswith("License ::")]
    if not names:
        names = "".join(about.get_all("License") or ()).splitlines()[:1]
    return [{"license": {"name": name}} for name in names]


def digest(name: str) -> str:
    """Return a SHA-256 over the paths and hashes of the files in a package's wheel, whatever installed it."""
    files = metadata.files(name) or ()
    rows = [f"{path} {path.hash.value}" for path in files if path.hash and path.name not in OF_THE_INSTALLER]
    return hashlib.sha256("\n".join(sorted(rows)).encode()).hexdigest()


def uplot() -> dict[str, Any]:
    """Return the entry of uPlot, with the version that its own file states."""
    version = re.search(r"uPlot \(v([\d.]+)\)", UPLOT.read_text(encoding="utf-8")[:200])
    assert version, f"{UPLOT} states no version"
    hashes = [{"alg": "SHA-256", "content": hashlib.sha256(UPLOT.read_bytes()).hexdigest()}]
    return component("uplot", version[1], "npm", licenses=[{"license": {"id": "MIT"}}], hashes=hashes)


def bill() -> dict[str, Any]:
    """Return the bill of all packages that are needed, and of uPlot."""
    needs_by_package = dependencies()
    components = []
    for name in sorted(needs_by_package.keys() - {NAME}):
        about = metadata.metadata(name)
        files = [{"name": "mcp-asdf:sha-256-of-files", "value": digest(name)}]
        components.append(component(name, about["Version"], licenses=licences(about), properties=files))
    return {
        "bomFormat": "CycloneDX",
        "specVersion": "1.6",
        "version": 1,
        "metadata": {"component": component(NAME, version_of_header())},
        "components": [*components, uplot()],
        "dependencies": [
            {"ref": name, "dependsOn": sorted(needs)} for name, needs in sorted(needs_by_package.items())
        ],
    }


def main(arguments: list[str]) -> None:
    """Write the bill, and print how many components are in it."""
    path = Path(arguments[0]) if arguments else ROOT / "build/sbom.json"
    content = bill()
    path.parent.mkdir(parents=True, exist_ok=True)
    write_atomically(path, json.dumps(content, indent=2, ensure_ascii=False) + "\n")
    print(f"{path}: {len(content['components'])} components")


if __name__ == "__main__":
    main(sys.argv[1:])
