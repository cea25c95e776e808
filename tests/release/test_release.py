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

import pytest

from release.sbom import bill
from support import ROOT, TABLE, require, run, version_of_header

BOUNDED = re.compile(r"([\w.-]+)(\[[\w,-]+\])?>=\d[\d.]*")


def requirements() -> set[str]:
    """Requirements of the project to be built and run, all its extras included, as it states them."""
    stated = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))
    project = stated["project"]
    extras = [each for extra in project["optional-dependencies"].values() for each in extra]
    every = {*stated["build-system"]["requires"], *project["dependencies"], *extras}
    return {each for each in every if not each.startswith("mcp-asdf")}


def test_each_dependency_has_a_lower_bound() -> None:
    assert len(requirements()) > 8
    assert [each for each in requirements() if not BOUNDED.fullmatch(each)] == []


def build(source: Path, out: Path) -> dict[str, str]:
    """SHA-256 of each file that is built from a copy of the source in this folder, by its path: the library,
    the wheel and what is in it."""
    for name in filter(None, run("git", "ls-files", "-z", "-co", "--exclude-standard").split("\0")):
        if (ROOT / name).is_file():
            (source / name).parent.mkdir(parents=True, exist_ok=True)
            shutil.copy(ROOT / name, source / name)  # with the time of now
    given = {"SOURCE_DATE_EPOCH": "1700000000", "CFLAGS": f"-g -ffile-prefix-map='{source}'=."}
    flags = ("-DCMAKE_BUILD_TYPE=RelWithDebInfo", "-DCMAKE_INSTALL_PREFIX=/usr")
    run("cmake", "-S", source / "c_ref", "-B", source / "build", *flags, cwd=source, **given)
    run("cmake", "--build", source / "build", cwd=source, **given)
    run("cmake", "--install", source / "build", cwd=source, **given, DESTDIR=str(out / "library"))
    options = ("--quiet", "--no-build-isolation", "--no-deps", "--no-index", "--wheel-dir", out)
    where = f"--config-settings=build-dir={source / 'build wheel'}"
    run(sys.executable, "-m", "pip", "wheel", *options, where, source, cwd=source, **given)
    (made,) = out.glob("*.whl")
    zipfile.ZipFile(made).extractall(out / "contents")
    paths = sorted(path for path in out.rglob("*") if path.is_file())
    return {str(path.relative_to(out)): hashlib.sha256(path.read_bytes()).hexdigest() for path in paths}


@pytest.mark.slow
def test_two_builds_give_the_same_bytes(tmp_path: Path) -> None:
    require("cmake")
    folders = ("first", "another folder/with a longer name")
    first, second = (build(tmp_path / name, tmp_path / f"made {len(name)}") for name in folders)
    assert {Path(name).suffix for name in first} > {".a", ".whl", ".so"}
    assert first == second


def test_reference_data_are_those_that_the_page_names() -> None:
    """An oracle that changes in silence is none."""
    folder = ROOT / "tests/data"
    own = {"README.md", "study_verdicts.csv"}
    files = [path for path in folder.rglob("*") if path.is_file() and path.name not in own]
    found = {str(path.relative_to(folder)): hashlib.sha256(path.read_bytes()).hexdigest() for path in files}
    page = (folder / "README.md").read_text(encoding="utf-8")
    assert dict(re.findall(r"^\| `([^`]+)` \| `([0-9a-f]{64})` \|$", page, re.MULTILINE)) == found


@pytest.mark.slow
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
    assert [each["name"] for each in found["components"] if not each["licenses"]] == []
    hashes = [
        each.get("properties", [{}])[0].get("value") or each["hashes"][0]["content"]
        for each in found["components"]
    ]
    assert len(set(hashes)) == len(hashes) and all(re.fullmatch("[0-9a-f]{64}", each) for each in hashes)
    assert found["metadata"]["component"]["version"] == version_of_header()


@pytest.mark.slow
def test_the_evidence_is_one_archive(tmp_path: Path) -> None:
    script, archive = ROOT / "tests/release/evidence.sh", tmp_path / "evidence.tar.gz"
    with pytest.raises(AssertionError, match=r"no reports in .*; run make test and make verify first"):
        run(script, tmp_path, archive)
    (tmp_path / "pytest.xml").write_text("<testsuites/>")
    digest = run(script, tmp_path, archive, sys.executable).split()[0]
    assert digest == hashlib.sha256(archive.read_bytes()).hexdigest()
    files = dict[str, str]()
    with tarfile.open(archive) as opened:
        for member in opened:
            if content := opened.extractfile(member):  # None for a folder
                files[Path(member.name).name] = content.read().decode("utf-8")
    table = hashlib.sha256(TABLE.read_bytes()).hexdigest()
    assert f"{table}  {TABLE.relative_to(ROOT)}\n" in files["SHA256SUMS"]
    assert re.search(r"^gcc: gcc .*\d+\.\d+", files["tools.txt"], re.MULTILINE)
    assert f"pytest=={pytest.__version__}" in files["packages.txt"]
    assert re.match("[0-9a-f]{40} 20", files["commit.txt"])
    assert json.loads(files["sbom.json"])["bomFormat"] == "CycloneDX"
