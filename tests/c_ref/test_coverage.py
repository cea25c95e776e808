"""MC/DC of the firmware by its C tests, measured by clang.

Modified condition/decision coverage: every condition has been true and false, and has changed the result of
its decision by itself.
"""

from __future__ import annotations

import json
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import pytest

from mutation.c_killers import third_object
from proofs.source import HERE
from support import CORE, ROOT, TABLE, require, run

PACKAGES = "clang-19 llvm-19 libclang-rt-19-dev"
PORTS = ROOT / "c_ref/ports"
SOURCES = [*sorted(CORE.parent.glob("*.c")), *sorted((PORTS / "node").glob("*.c"))]
MEASURED_FILES = {*SOURCES, *CORE.parent.glob("*.h")}
BLACK_BOX_TESTS = ("frame", "small", "node")
FLAGS = ("-std=c99", "-O1", "-fprofile-instr-generate", "-fcoverage-mapping", "-fcoverage-mcdc")

Span = tuple[int, int, int, int]
"""First line and column, last line and column."""
Place = tuple[str, str, Span]
"""Function, file and span."""


def span_of(record: list[Any]) -> Span:
    """Return the span with which a record of llvm-cov begins."""
    first_line, first_column, last_line, last_column, *_ = record
    return first_line, first_column, last_line, last_column


@dataclass
class Coverage:
    """What some programs together have covered of the conditions of some functions.

    Attributes:
        outcome_counts: How often each condition was true and was false.
        effects: For each decision, whether each of its conditions has changed the result by itself.
    """

    outcome_counts: dict[Place, tuple[int, int]] = field(default_factory=dict)
    effects: dict[Place, list[bool]] = field(default_factory=dict)

    def add(self, function: dict[str, Any]) -> None:
        """Add what llvm-cov exports of a function in one program."""
        # A static function is called, say, "mcp_asdf.c:divide_24", with a semicolon in newer versions.
        name = function["name"].replace(";", ":").rpartition(":")[2]
        path = function["filenames"][0]
        for branch in function["branches"]:
            true_count, false_count = branch[4:6]
            self._add_outcomes((name, path, span_of(branch)), true_count, false_count)
        for record in function["mcdc_records"]:
            *_, effects = record
            self._add_effects((name, path, span_of(record)), effects)

    def _add_outcomes(self, place: Place, true_count: int, false_count: int) -> None:
        """Add how often the condition at a place was true and was false in one program."""
        earlier_true, earlier_false = self.outcome_counts.get(place, (0, 0))
        self.outcome_counts[place] = (earlier_true + true_count, earlier_false + false_count)

    def _add_effects(self, place: Place, effects: list[bool]) -> None:
        """Add which conditions of the decision at a place have changed its result in one program."""
        earlier_effects = self.effects.get(place, [False] * len(effects))
        self.effects[place] = [a or b for a, b in zip(earlier_effects, effects, strict=True)]

    def missing(self) -> list[tuple[str, str, str]]:
        """Return function, text and missing outcome of each condition that is not covered.

        An outcome is ``true`` or ``false`` of a condition, or ``effect of condition i`` of a decision.
        """
        missing_outcomes: list[tuple[Place, str]] = []
        for place, (true_count, false_count) in self.outcome_counts.items():
            if true_count == 0:
                missing_outcomes.append((place, "true"))
            if false_count == 0:
                missing_outcomes.append((place, "false"))
        for place, effects in self.effects.items():
            for number, has_effect in enumerate(effects, 1):
                if not has_effect:
                    missing_outcomes.append((place, f"effect of condition {number}"))
        return sorted(
            (name, text_at(path, span), outcome) for (name, path, span), outcome in missing_outcomes
        )


def text_at(path: str, span: Span) -> str:
    """Return a span of a source file, on one line."""
    first_line, first_column, last_line, last_column = span
    lines = Path(path).read_text(encoding="utf-8").splitlines()[first_line - 1 : last_line]
    lines[-1] = lines[-1][: last_column - 1]  # first the last line, as it may also be the first one
    lines[0] = lines[0][first_column - 1 :]
    return " ".join(" ".join(lines).split())


def build_programs(folder: Path) -> Iterator[Path]:
    """Build the C tests as for the project, but with counters in them, and yield each program."""
    require("clang-19", PACKAGES)
    tests = ROOT / "tests/c_ref"
    for name in BLACK_BOX_TESTS:
        yield build(folder / name, tests / f"test_{name}.c", *SOURCES, TABLE)
    third = third_object(folder)
    core = (CORE, CORE.with_name("mcp_asdf_image.c"), TABLE)
    for variant in HERE:
        yield build(folder / f"core_{variant}", tests / "test_core.c", *variant.flags())
        yield build(folder / f"third_{variant}", *variant.flags(), *core, third, "-lstdc++", "-lm")


def build(program: Path, *arguments: str | Path) -> Path:
    run("clang-19", *FLAGS, f"-I{CORE.parent}", f"-I{PORTS}", *arguments, "-o", program)
    return program


def run_and_export(program: Path) -> list[dict[str, Any]]:
    """Run a program, and return what llvm-cov exports of its functions in the measured files."""
    raw_profile, profile = program.with_suffix(".profraw"), program.with_suffix(".profdata")
    run(program, LLVM_PROFILE_FILE=str(raw_profile))
    run(require("llvm-profdata-19", PACKAGES), "merge", "-o", profile, raw_profile)
    llvm_cov = require("llvm-cov-19", PACKAGES)
    exported = run(llvm_cov, "export", "-skip-expansions", f"-instr-profile={profile}", program)
    functions = json.loads(exported)["data"][0]["functions"]
    return [function for function in functions if Path(function["filenames"][0]) in MEASURED_FILES]


REASON = "a constant of each build, so no run can change it; both its values are compiled and tested"
CONSTANT_CONDITIONS = {
    ("divide_24", "MCP_ASDF_DIVIDE == MCP_ASDF_DIVIDE_BY_TABLE && d >> 30 == 0U"): (1,),
    (
        "mcp_asdf_is_robust",
        "MCP_ASDF_WITH_ROBUST && (!MCP_ASDF_WITH_ASDF || config->filter == MCP_ASDF_ROBUST)",
    ): (1, 2),
    ("mcp_asdf_settle", "MCP_ASDF_WITH_ROBUST && mcp_asdf_is_robust(robot->config)"): (1,),
}
"""Function and text of decisions, and the numbers of their conditions that are constants of a build."""
GUARDS = {
    ("huber_step", "balance < divisor", "false"): (
        "a step is shorter than a spread, which is at most 1/4: "
        "in 10 million sets of estimates none exceeded 0.234"
    ),
    ("median_distance", "below > 0U", "false"): (
        "of the count / 2 + 1 estimates that are passed the first is not below the median, and so below >= 1"
    ),
    ("median_distance", "below > 0U && distance_below < distance_above", "effect of condition 1"): (
        "the same guard again, for the analyser that looks at each read of an array"
    ),
}
"""Conditions that keep a function's arguments or indices in range without a proof, and why they hold."""
UNREACHABLE = GUARDS | {
    (*decision, f"effect of condition {number}"): REASON
    for decision, numbers in CONSTANT_CONDITIONS.items()
    for number in numbers
}
"""What no test can cover, as ``Coverage.missing`` has it, and why."""


@pytest.fixture(scope="module")
def coverage(tmp_path_factory: pytest.TempPathFactory) -> Coverage:
    """Coverage of all C tests together."""
    coverage = Coverage()
    for program in build_programs(tmp_path_factory.mktemp("coverage")):
        for function in run_and_export(program):
            coverage.add(function)
    return coverage


@pytest.mark.slow
def test_coverage_is_measured_in_every_file_that_has_code(coverage: Coverage) -> None:
    """A file that is left out would look as if everything in it were tested.

    Some headers have code, too: inline functions. That many conditions are measured shows that each counts.
    """
    source_files = {path.name for path in SOURCES}
    source_files.remove("mcp_asdf_accessors.c")  # it has no code: its functions stand in mcp_asdf.h
    headers_with_code = {"mcp_asdf.h", "mcp_asdf_arithmetic.h", "mcp_asdf_robust.h"}
    headers_with_code |= {"mcp_asdf_target.h", "mcp_asdf_target_avr.h", "mcp_asdf_target_small.h"}

    measured_files = {Path(path).name for _function, path, _span in coverage.outcome_counts}

    assert measured_files == source_files | headers_with_code
    number_of_conditions = len(coverage.outcome_counts)
    assert number_of_conditions > 150
    conditions_of_decisions_with_several = sum(len(effects) for effects in coverage.effects.values())
    assert conditions_of_decisions_with_several > 70


@pytest.mark.slow
def test_the_c_tests_together_cover_every_condition_that_can_be(coverage: Coverage) -> None:
    """Each has been true and false, and has changed a decision by itself.

    UNREACHABLE lists those that no test can cover: function, text and missing outcome, with the reason.
    """
    assert set(coverage.missing()) == set(UNREACHABLE)
