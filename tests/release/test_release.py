"""Dependencies have tested lower bounds; builds are reproducible; the bill of materials is whole."""

from __future__ import annotations

import hashlib
import json
import re
import shutil
import sys
import tarfile
import tomllib
import zipfile
from pathlib import Path
from typing import Any

import pytest
from packaging.requirements import Requirement

from release.sbom import bill
from support import ROOT, TABLE, require, run, version_of_header

BOUNDED = re.compile(r"([\w.-]+)(\[[\w,-]+\])?>=\d[\d.]*")


def requirements() -> set[str]:
    """Requirements of the project to be built and run, all its extras included, as it states them."""
    stated = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))
    project = stated["project"]
    all_stated = {*stated["build-system"]["requires"], *project["dependencies"]}
    for packages_of_extra in project["optional-dependencies"].values():
        all_stated |= set(packages_of_extra)
    return {requirement for requirement in all_stated if not requirement.startswith("mcp-asdf")}


def test_each_dependency_has_a_lower_bound() -> None:
    """numpy>=1.24 is such a bound. An older version, which no test has tried, is not installed."""
    assert len(requirements()) > 8
    without_bound = [requirement for requirement in requirements() if not BOUNDED.fullmatch(requirement)]
    assert without_bound == []


def sha256(path: Path) -> str:
    return hashlib.sha256(path.read_bytes()).hexdigest()


def copy_listed_files(folder: Path) -> None:
    """Copy all files that git lists to a folder, with the time of now."""
    for name in filter(None, run("git", "ls-files", "-z", "-co", "--exclude-standard").split("\0")):
        if (ROOT / name).is_file():
            (folder / name).parent.mkdir(parents=True, exist_ok=True)
            shutil.copy(ROOT / name, folder / name)


def build(source: Path, out: Path) -> dict[str, str]:
    """Build library and wheel from a copy of the source in a folder.

    Returns the SHA-256 of each file that is built, by its path, and of those in the wheel.
    """
    copy_listed_files(source)
    environment = {"SOURCE_DATE_EPOCH": "1700000000", "CFLAGS": f"-g -ffile-prefix-map='{source}'=."}
    flags = ("-DCMAKE_BUILD_TYPE=RelWithDebInfo", "-DCMAKE_INSTALL_PREFIX=/usr")
    run("cmake", "-S", source / "c_ref", "-B", source / "build", *flags, cwd=source, **environment)
    run("cmake", "--build", source / "build", cwd=source, **environment)
    run("cmake", "--install", source / "build", cwd=source, **environment, DESTDIR=str(out / "library"))
    options = ("--quiet", "--no-build-isolation", "--no-deps", "--no-index", "--wheel-dir", out)
    where = f"--config-settings=build-dir={source / 'build wheel'}"
    run(sys.executable, "-m", "pip", "wheel", *options, where, source, cwd=source, **environment)
    [wheel] = out.glob("*.whl")
    zipfile.ZipFile(wheel).extractall(out / "contents")
    paths = sorted(path for path in out.rglob("*") if path.is_file())
    return {str(path.relative_to(out)): sha256(path) for path in paths}


@pytest.mark.slow
def test_two_builds_in_different_folders_give_the_same_bytes(tmp_path: Path) -> None:
    """So anybody can check that a published file comes from this source: its hash is the same."""
    require("cmake")

    first = build(tmp_path / "first", tmp_path / "built first")
    second = build(tmp_path / "another folder/with a longer name", tmp_path / "built second")

    suffixes = {Path(name).suffix for name in first}
    assert suffixes > {".a", ".whl", ".so"}
    assert first == second, "hashes of all files, by name"


def test_the_authors_data_are_those_whose_hashes_their_page_lists() -> None:
    """If the numbers that the tests compare with changed in silence, the tests would prove nothing.

    Their page, tests/data/README.md, has a table with a path and a SHA-256 in each row.
    """
    folder = ROOT / "tests/data"
    own_files = {"README.md", "study_verdicts.csv"}
    files = [path for path in folder.rglob("*") if path.is_file() and path.name not in own_files]
    hashes = {str(path.relative_to(folder)): sha256(path) for path in files}

    page = (folder / "README.md").read_text(encoding="utf-8")
    listed_hashes = dict(re.findall(r"^\| `([^`]+)` \| `([0-9a-f]{64})` \|$", page, re.MULTILINE))

    assert listed_hashes == hashes


@pytest.fixture(scope="module")
def bill_of_materials() -> dict[str, Any]:
    """The list that release/sbom.py writes for a release: the components that come with the project."""
    pytest.importorskip("cyclonedx.schema", reason="cyclonedx-bom is not installed")
    return bill()


@pytest.mark.slow
def test_the_bill_of_materials_is_a_valid_one(bill_of_materials: dict[str, Any]) -> None:
    """Other programs read it: it follows the schema 1.6 of CycloneDX."""
    validator = pytest.importorskip("cyclonedx.validation.json")
    schema = pytest.importorskip("cyclonedx.schema").SchemaVersion.V1_6

    error = validator.JsonStrictValidator(schema).validate_str(json.dumps(bill_of_materials))

    assert error is None


@pytest.mark.slow
def test_the_bill_of_materials_names_each_dependency_and_no_tool_of_the_tests(
    bill_of_materials: dict[str, Any],
) -> None:
    """It lists what users get: not what builds the project, but uplot, a script of ``mcp-asdf view``."""
    names = {component["name"] for component in bill_of_materials["components"]}
    builders = {"scikit-build-core", "hatch-fancy-pypi-readme"}
    dependencies = {Requirement(text).name.lower() for text in requirements()}
    dependencies_of_users = dependencies - builders

    assert names >= {"uplot"} | dependencies_of_users
    assert names.isdisjoint({"pytest", "mypy", "ruff", "mkdocs", "cyclonedx-bom"})
    needs = {entry["ref"]: entry["dependsOn"] for entry in bill_of_materials["dependencies"]}
    assert set(needs["mcp-asdf"]) == dependencies_of_users


@pytest.mark.slow
def test_each_component_of_the_bill_of_materials_has_a_licence(bill_of_materials: dict[str, Any]) -> None:
    """A component is a package that users get, or a file of others that comes with the project."""
    components = bill_of_materials["components"]
    without_licence = [component["name"] for component in components if not component["licenses"]]
    assert without_licence == []


def hash_of_component(component: dict[str, Any]) -> str:
    """Return the SHA-256 of a component: of its one file, or of all its files, which is a property."""
    if "properties" in component:
        [hash_of_files] = component["properties"]
        return str(hash_of_files["value"])
    [hash_of_file] = component["hashes"]
    return str(hash_of_file["content"])


@pytest.mark.slow
def test_no_two_components_of_the_bill_of_materials_have_the_same_hash(
    bill_of_materials: dict[str, Any],
) -> None:
    """A user recognises the component that was released by its hash of 64 hexadecimal digits."""
    hashes = [hash_of_component(component) for component in bill_of_materials["components"]]

    assert all(re.fullmatch("[0-9a-f]{64}", digest) for digest in hashes)
    assert len(set(hashes)) == len(hashes)


@pytest.mark.slow
def test_the_bill_of_materials_has_the_version_of_the_header(bill_of_materials: dict[str, Any]) -> None:
    """The C header has the version of the whole project."""
    assert bill_of_materials["metadata"]["component"]["version"] == version_of_header()


EVIDENCE = ROOT / "tests/release/evidence.sh"
"""Script that packs reports of the tests, and what they were run with, into an archive."""


@pytest.mark.slow
def test_without_reports_there_is_no_archive_of_evidence(tmp_path: Path) -> None:
    """The archive would prove nothing. Its program ends with an error that says what to run first."""
    with pytest.raises(AssertionError, match=r"no reports in .*; run make test and make verify first"):
        run(EVIDENCE, tmp_path, tmp_path / "evidence.tar.gz")


def files_in(archive: Path) -> dict[str, str]:
    """Return the texts of the files in an archive, by their names without folders."""
    texts = {}
    with tarfile.open(archive) as opened:
        for member in opened:
            content = opened.extractfile(member)
            if content is not None:  # None for a folder
                texts[Path(member.name).name] = content.read().decode("utf-8")
    return texts


@pytest.mark.slow
def test_the_archive_of_evidence_says_what_was_tested_and_with_which_tools(tmp_path: Path) -> None:
    """It has the commit, hashes of the project's files, and the versions of compilers and packages.

    The program that packs the archive prints its hash.
    """
    archive = tmp_path / "evidence.tar.gz"
    (tmp_path / "pytest.xml").write_text("<testsuites/>")  # stands for the tests' reports

    printed_hash, *_ = run(EVIDENCE, tmp_path, archive, sys.executable).split()

    files = files_in(archive)
    assert printed_hash == sha256(archive)
    assert f"{sha256(TABLE)}  {TABLE.relative_to(ROOT)}\n" in files["SHA256SUMS"]
    assert re.search(r"^gcc: gcc .*\d+\.\d+", files["tools.txt"], re.MULTILINE)
    assert f"pytest=={pytest.__version__}" in files["packages.txt"]
    assert re.match("[0-9a-f]{40} 20", files["commit.txt"]), "hash and date"
    assert json.loads(files["sbom.json"])["bomFormat"] == "CycloneDX"
