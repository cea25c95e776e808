"""MISRA C:2012, by cppcheck's addon: no finding but those that ``misra.toml`` lists with a reason."""

from __future__ import annotations

import re
import shutil
import subprocess
import tomllib
from collections import defaultdict
from pathlib import Path

import pytest

from proofs.source import Variant
from support import CORE, ROOT, require

RECORD = Path(__file__).with_name("misra.toml")
ON_AN_AVR = ("-D__AVR__", "--platform=avr8", "-DMCP_ASDF_ROM=", "-DMCP_ASDF_READ_BYTE(at)=(*(at))")
TARGETS = {
    "1001": (),
    "2100": (),
    "1000": ("-D__riscv", "--platform=unix32"),
    "3010": (*ON_AN_AVR, "-DMCP_ASDF_READ_WORD(at)=(*(at))"),
    "2000": ("-D__OPTIMIZE_SIZE__", "--platform=unix32"),
}
"""Choices of the targets that tests/c_ref/CMakeLists.txt names, and what else tells them apart."""
BUILDS = ("-DMCP_ASDF_WITH_ROBUST=0", "-DMCP_ASDF_WITH_ASDF=0")
"""Builds without a filter, for the first target."""
WHOLE = ("1001", "3010")
"""Targets for which all files are checked: choices change only the core, the width of an int all of them."""
HEADERS = ("-D__GNUC__=12", "-DUINT32_C(v)=((uint32_t)v##U)", "-DUINT64_C(v)=((uint64_t)v##ULL)")
"""From headers of the system, which cppcheck does not read: constants have the type they are asked for."""

ADVISORY = frozenset(
    {"1.2", "4.2", "5.9", "8.7", "8.9", "8.11", "8.13", "10.5", "11.4", "11.5", "12.1", "12.3", "12.4"}
    | {"13.3", "13.4", "15.1", "15.4", "15.5", "17.5", "17.8", "18.4", "18.5", "19.2"}
    | {"20.1", "20.5", "20.10", "21.12"}
    | {f"2.{number}" for number in range(3, 8)}
)
"""Rules of this category; the record has a place for each exception from any other."""
FINDING = re.compile(r"^([^:\n]+):(\d+) misra-c2012-([\d.]+)$", re.MULTILINE)
COMMENT = re.compile(r"/\*.*?(\*/|$)")


def findings(target: str, sources: Path, *build: str) -> dict[str, set[str]]:
    """Places of each rule's findings under a target's choices: file and line of code, without its number.

    Beside the sources cppcheck writes files of its own, so these are a copy.
    """
    files = sorted(sources.glob("*.c")) if target in WHOLE else [sources / CORE.name]
    command = ["cppcheck", "--addon=misra", "--std=c99", "--quiet", "--template={file}:{line} {id}"]
    done = subprocess.run(
        [*command, *HEADERS, *Variant(target).flags(), *build, *TARGETS[target], *map(str, files)],
        capture_output=True,
        text=True,
        check=True,
        timeout=120,
    )
    lines = {path.name: path.read_text(encoding="utf-8").splitlines() for path in sources.glob("*.[ch]")}
    found: defaultdict[str, set[str]] = defaultdict(set)
    for path, line, rule in FINDING.findall(done.stderr):
        name = Path(path).name
        found[rule].add(f"{name}: {' '.join(COMMENT.sub('', lines[name][int(line) - 1]).split())}")
    assert not FINDING.sub("", done.stderr).strip(), done.stderr
    return found


def record() -> tuple[dict[str, set[str]], set[str]]:
    """Places of each required rule, and the advisory rules, that the record excepts."""
    read = tomllib.loads(RECORD.read_text(encoding="utf-8"))
    places = [(entry["rule"], place) for entry in read["required"] for place in entry["places"]]
    rules = [entry["rule"] for entry in read["advisory"]]
    required: defaultdict[str, set[str]] = defaultdict(set)
    for rule, place in places:
        required[rule].add(place)
    return required, set(rules)


@pytest.fixture
def sources(tmp_path: Path) -> Path:
    require("cppcheck", "cppcheck")
    return Path(shutil.copytree(CORE.parent, tmp_path / "src"))


def test_misra_finds_nothing_new_for_the_first_target(sources: Path) -> None:
    required, advisory = record()
    found = findings("1001", sources)
    assert {rule for rule, places in found.items() if places - required[rule]} <= advisory


@pytest.mark.slow
def test_misra_finds_what_the_record_lists_and_nothing_else(sources: Path) -> None:
    """A new finding fails, and so does an entry without a finding."""
    found: defaultdict[str, set[str]] = defaultdict(set)
    for run in (*((target,) for target in TARGETS), *(("1001", build) for build in BUILDS)):
        for rule, places in findings(run[0], sources, *run[1:]).items():
            found[rule] |= places
    required, advisory = record()
    assert {rule: places for rule, places in found.items() if rule not in ADVISORY} == required
    assert found.keys() & ADVISORY == advisory
    page = (ROOT / "docs/trust.md").read_text(encoding="utf-8").partition("## MISRA")[2].partition("\n## ")[0]
    assert set(re.findall(r"\b\d+\.\d+\b", page)) == required.keys()
