"""MISRA C:2012: the addon of cppcheck finds only what ``misra.toml`` lists with a reason."""

from __future__ import annotations

import re
import shutil
import subprocess
import tomllib
from collections import defaultdict
from pathlib import Path

import pytest

from proofs.source import Variant
from support import CORE, ROOT, require, section_of

RECORD = Path(__file__).with_name("misra.toml")
ON_AN_AVR = ("-D__AVR__", "--platform=avr8", "-DMCP_ASDF_ROM=", "-DMCP_ASDF_READ_BYTE(at)=(*(at))")
TARGETS = {
    "1001": (),
    "2100": (),
    "1000": ("-D__riscv", "--platform=unix32"),
    "3010": (*ON_AN_AVR, "-DMCP_ASDF_READ_WORD(at)=(*(at))"),
    "2000": ("-D__OPTIMIZE_SIZE__", "--platform=unix32"),
}
"""Options of cppcheck for each target, by its choices (the digits of tests/c_ref/CMakeLists.txt)."""
FIRST_TARGET = "1001"
BUILDS_OF_ONE_FILTER = ("-DMCP_ASDF_WITH_ROBUST=0", "-DMCP_ASDF_WITH_ASDF=0")
TARGETS_OF_ALL_FILES = ("1001", "3010")
"""Targets for which all files are checked. Of the others it is the core alone: their choices change no other
file, but an int of 16 bits may matter everywhere."""
SYSTEM_HEADERS = ("-D__GNUC__=12", "-DUINT32_C(v)=((uint32_t)v##U)", "-DUINT64_C(v)=((uint64_t)v##ULL)")
"""Macros of headers that cppcheck does not read, so that constants have the type that they ask for."""

ADVISORY_RULES = frozenset(
    {"1.2", "4.2", "5.9", "8.7", "8.9", "8.11", "8.13", "10.5", "11.4", "11.5", "12.1", "12.3", "12.4"}
    | {"13.3", "13.4", "15.1", "15.4", "15.5", "17.5", "17.8", "18.4", "18.5", "19.2"}
    | {"20.1", "20.5", "20.10", "21.12"}
    | {f"2.{number}" for number in range(3, 8)}
)
"""Rules for which the record names no places: a reason is enough."""
FINDING = re.compile(r"^([^:\n]+):(\d+) misra-c2012-([\d.]+)$", re.MULTILINE)
COMMENT = re.compile(r"/\*.*?(\*/|$)")

Findings = defaultdict[str, set[str]]
"""Places by rule. A place is a file's name and a line of code without its comments and its number."""


def find(target: str, sources: Path, *build_options: str) -> Findings:
    """Return what cppcheck finds under a target's choices. Fails if it prints anything else."""
    printed = run_cppcheck(target, sources, *build_options)
    text_beside_findings = FINDING.sub("", printed).strip()
    assert text_beside_findings == "", printed
    places_by_rule: Findings = defaultdict(set)
    for file_name, line_number, rule in FINDING.findall(printed):
        path = sources / Path(file_name).name
        code = code_of_line(path, int(line_number))
        places_by_rule[rule].add(f"{path.name}: {code}")
    return places_by_rule


def run_cppcheck(target: str, sources: Path, *build_options: str) -> str:
    """Run cppcheck on the sources under a target's choices, and return its messages."""
    files = sorted(sources.glob("*.c")) if target in TARGETS_OF_ALL_FILES else [sources / CORE.name]
    command = ["cppcheck", "--addon=misra", "--std=c99", "--quiet", "--template={file}:{line} {id}"]
    options = [*SYSTEM_HEADERS, *Variant(target).flags(), *build_options, *TARGETS[target]]
    result = subprocess.run(
        [*command, *options, *map(str, files)], capture_output=True, text=True, check=True, timeout=120
    )
    return result.stderr


def code_of_line(path: Path, line_number: int) -> str:
    """Return a line of a file, by its number from 1, without comments and with single spaces."""
    line = path.read_text(encoding="utf-8").splitlines()[line_number - 1]
    return " ".join(COMMENT.sub("", line).split())


def recorded_places() -> Findings:
    """Return the places of exceptions from required rules, as the record lists them."""
    places_by_rule: Findings = defaultdict(set)
    for entry in tomllib.loads(RECORD.read_text(encoding="utf-8"))["required"]:
        places_by_rule[entry["rule"]].update(entry["places"])
    return places_by_rule


def recorded_advisory_rules() -> set[str]:
    """Return the advisory rules that the record excepts."""
    return {entry["rule"] for entry in tomllib.loads(RECORD.read_text(encoding="utf-8"))["advisory"]}


@pytest.fixture(scope="module")
def all_findings(tmp_path_factory: pytest.TempPathFactory) -> Findings:
    """Findings for all targets together, and in builds of one filter for the first of them."""
    require("cppcheck", "cppcheck")
    # A copy, since cppcheck writes files beside what it reads.
    sources = Path(shutil.copytree(CORE.parent, tmp_path_factory.mktemp("misra") / "src"))
    places_by_rule: Findings = defaultdict(set)
    findings = [find(target, sources) for target in TARGETS]
    findings += [find(FIRST_TARGET, sources, build_option) for build_option in BUILDS_OF_ONE_FILTER]
    for findings_of_run in findings:
        for rule, places in findings_of_run.items():
            places_by_rule[rule] |= places
    return places_by_rule


@pytest.mark.slow
def test_required_misra_rules_are_broken_at_the_recorded_places_and_nowhere_else(
    all_findings: Findings,
) -> None:
    """cppcheck looks for them in all targets' choices. misra.toml records each place with a reason."""
    places_by_required_rule = {
        rule: places for rule, places in all_findings.items() if rule not in ADVISORY_RULES
    }
    assert places_by_required_rule == recorded_places()


@pytest.mark.slow
def test_the_recorded_advisory_misra_rules_and_no_others_are_broken(all_findings: Findings) -> None:
    """MISRA advises to follow them. misra.toml gives a reason for each that the firmware breaks."""
    broken_advisory_rules = all_findings.keys() & ADVISORY_RULES
    assert broken_advisory_rules == recorded_advisory_rules()


def test_docs_trust_names_the_required_misra_rules_that_are_broken() -> None:
    """The section "MISRA" of docs/internals/trust.md names just those for which misra.toml lists places.

    A rule is named by its number, such as 10.4.
    """
    section = section_of(ROOT / "docs/internals/trust.md", "MISRA")
    rules_on_page = set(re.findall(r"\b\d+\.\d+\b", section))
    assert rules_on_page == recorded_places().keys()
