"""Dependencies have tested lower bounds; builds are reproducible; the bill of materials is whole."""

from __future__ import annotations

import json
import re
from pathlib import Path

import pytest

from c_ref.consumer import version_of_header
from release.lowest import requirements
from release.reproducible import build_twice
from release.sbom import bill
from support import require

BOUNDED = re.compile(r"([\w.-]+)(\[[\w,-]+\])?>=\d[\d.]*")


def test_each_dependency_has_a_lower_bound() -> None:
    assert len(requirements()) > 8
    assert [each for each in requirements() if not BOUNDED.fullmatch(each)] == []


@pytest.mark.slow
def test_two_builds_give_the_same_bytes(tmp_path: Path) -> None:
    require("cmake")
    first, second = build_twice(tmp_path)
    assert {Path(name).suffix for name in first} > {".a", ".whl", ".so"}
    assert first == second


def test_the_bill_names_each_dependency() -> None:
    found = bill()
    validator = pytest.importorskip("cyclonedx.validation.json", reason="cyclonedx-bom is not installed")
    schema = pytest.importorskip("cyclonedx.schema").SchemaVersion.V1_6
    assert validator.JsonStrictValidator(schema).validate_str(json.dumps(found)) is None
    names = {each["name"] for each in found["components"]}
    builders = {"scikit-build-core", "cffi", "hatch-fancy-pypi-readme"}
    stated = {match[1].lower() for each in requirements() if (match := BOUNDED.fullmatch(each))}
    assert {*stated - builders, "uplot"} <= names
    assert names.isdisjoint({"pytest", "mypy", "ruff", "mkdocs", "cyclonedx-bom"}), "tests' own tools"
    assert found["metadata"]["component"]["version"] == version_of_header()
