"""The bill of materials is valid and names what the wheel needs and ships, and nothing else."""

from __future__ import annotations

import json
import re
import tomllib
from pathlib import Path

import pytest

from c_ref.consumer import version_of_header
from support import ROOT, require

NAME = re.compile(r"[\w.-]+")


def normal(name: str) -> str:
    """A package's name as indexes compare it."""
    return re.sub(r"[-_.]+", "-", name).lower()


def stated() -> set[str]:
    """All that pyproject.toml names as needed by the project, its extras included."""
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    extras = project["optional-dependencies"].values()
    every = (*project["dependencies"], *(each for extra in extras for each in extra))
    names = (NAME.match(each) for each in every)
    return {normal(name[0]) for name in names if name} - {"mcp-asdf"}


@pytest.mark.slow
def test_the_bill_names_each_dependency(tmp_path: Path) -> None:
    """Writing it fails if it is not valid."""
    require("cyclonedx-py")
    from release.sbom import write  # noqa: PLC0415 - needs the library that the tool comes with

    write(tmp_path / "sbom.json")
    bill = json.loads((tmp_path / "sbom.json").read_text(encoding="utf-8"))
    own = bill["metadata"]["component"]
    assert (own["name"], own["version"]) == ("mcp-asdf", version_of_header())
    versions = {normal(each["name"]): each["version"] for each in bill["components"]}
    assert stated() <= versions.keys() and "uplot" in versions
    assert len(stated()) > 10 and all(versions.values())
    assert versions.keys().isdisjoint({"pytest", "mypy", "ruff", "mkdocs", "cyclonedx-bom"}), (
        "tests' own tools"
    )
    assert str(ROOT) not in json.dumps(bill)


def test_what_is_not_needed_is_left_out() -> None:
    require("cyclonedx-py")
    from release.sbom import of_wheel  # noqa: PLC0415

    parts = ("a", "b", "tool")
    bill = {
        "metadata": {"component": {"name": "mcp-asdf"}},
        "components": [{"bom-ref": each, "name": each} for each in parts],
        "dependencies": [
            {"ref": "root-component", "dependsOn": ["a"]},
            {"ref": "a", "dependsOn": ["b"]},
            {"ref": "b", "dependsOn": ["tool"]},
            {"ref": "tool", "dependsOn": ["b"]},
        ],
    }
    found = of_wheel(bill, {"a", "b"})
    assert [each["name"] for each in found["components"]] == ["a", "b", "uplot"]
    assert [each["ref"] for each in found["dependencies"]][:3] == ["root-component", "a", "b"]
    assert found["dependencies"][0]["dependsOn"][0] == "a" and found["dependencies"][2]["dependsOn"] == []
