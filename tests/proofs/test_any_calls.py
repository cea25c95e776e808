"""Frama-C's Eva finds nothing in the whole firmware: no trap, no stray access, nothing that C leaves open,
whatever the arguments, the table, the image and the robot's memory hold."""

from __future__ import annotations

import re
import shutil
from pathlib import Path

import pytest
import z3

from proofs.arithmetic import are_leading_zeros
from proofs.solver import prove
from proofs.source import AVR, INCLUDE, SOURCES, VARIANTS, Variant
from support import CORE, require, run

CALLS = Path(__file__).with_name("any_calls.c")
DOMAINS = ("-eva-split-return", "auto", "-eva-domains", "equality,symbolic-locations")
ALARM = re.compile(r"^\[eva:alarm\] .*: Warning: *\n  (.*?)(?:assert.*)?$", re.MULTILINE)
PART = re.compile(r"^  (\w+): (\d+) stmts out of (\d+) ", re.MULTILINE)
UNKNOWN_FUNCTION = "neither code nor specification"
"""Part of Eva's message about a function of which it has no code."""
FUNCTIONS_CALLED = set(re.findall(r"\b(mcp_asdf_\w+)\(&", CALLS.read_text(encoding="utf-8")))
"""Functions of the firmware that any_calls.c calls."""


# design: R34
@pytest.mark.slow
@pytest.mark.parametrize("variant", VARIANTS, ids=str)
def test_no_call_can_trap_or_reach_foreign_memory(variant: Variant) -> None:
    """Eva, an analyser, has no alarm of any_calls.c, which calls everything with unknown arguments.

    It has to reach all functions that any_calls.c calls, and all of their code but what a variant's constants
    leave out: only where a table has reciprocals is a short divisor doubled, and only where one filter is
    built is there no choice.
    """
    report = eva(variant)

    assert alarms(report) == []
    assert UNKNOWN_FUNCTION not in report
    reached_functions, functions_reached_in_part = functions_in(report)
    assert reached_functions >= FUNCTIONS_CALLED
    assert functions_reached_in_part <= {"divide_24", "mcp_asdf_is_robust"}, "which have constant conditions"


# design: R34
@pytest.mark.slow
@pytest.mark.parametrize("filter_left_out", ["ASDF", "ROBUST"])
@pytest.mark.parametrize("variant", [VARIANTS[0], AVR], ids=str)
def test_no_call_can_trap_or_reach_foreign_memory_in_a_build_of_one_filter(
    variant: Variant, filter_left_out: str
) -> None:
    """A macro leaves the other filter out. There more conditions are constants, so less code is reached.

    Eva needs a higher precision to find no alarm there.
    """
    report = eva(variant, SOURCES, f"-DMCP_ASDF_WITH_{filter_left_out}=0", precision=6)

    assert alarms(report) == []
    assert UNKNOWN_FUNCTION not in report
    reached_functions, _functions_reached_in_part = functions_in(report)
    assert reached_functions >= FUNCTIONS_CALLED


def test_a_word_of_32_or_more_has_at_most_26_leading_zeros() -> None:
    """Eva takes this for granted, as any_calls.c admits it. It follows from the lemma of leading_zeros()."""
    zeros, value = z3.BitVecs("zeros value", 32)
    prove(z3.ULE(zeros, 26), are_leading_zeros(zeros, value), z3.UGE(value, 32))


@pytest.mark.slow
def test_eva_finds_a_shift_that_damaged_memory_makes_too_large(tmp_path: Path) -> None:
    """The firmware masks the shift; without the mask there has to be an alarm.

    Eva reads the firmware as it is for a Cortex-M4.
    """
    shutil.copytree(SOURCES, tmp_path, dirs_exist_ok=True)
    core_text = CORE.read_text(encoding="utf-8")
    assert "accuracy->g_shift & 31U" in core_text
    without_mask = core_text.replace("accuracy->g_shift & 31U", "accuracy->g_shift")
    (tmp_path / CORE.name).write_text(without_mask, encoding="utf-8")

    cortex_m4 = VARIANTS[0]
    found_alarms = alarms(eva(cortex_m4, tmp_path))

    assert any("shift" in alarm for alarm in found_alarms)


def functions_in(report: str) -> tuple[set[str], set[str]]:
    """Return the functions that Eva reached, and the functions where it left out some statements."""
    reached, reached_in_part = set[str](), set[str]()
    for name, reached_statements, statements in PART.findall(report):
        reached.add(name)
        if reached_statements != statements:
            reached_in_part.add(name)
    return reached, reached_in_part


def alarms(report: str) -> list[str]:
    """Return the subjects of the alarms in Eva's report."""
    return sorted({about.strip() for about in ALARM.findall(report)})


def eva(variant: Variant, sources: Path = SOURCES, *more: str, precision: int = 3) -> str:
    """Return what the analyser prints. An int has 16 or 32 bits and a long 32, as on the targets."""
    flags = " ".join([f"-I{sources}", *variant.flags(), *more, "-idirafter", str(INCLUDE)])
    machine = ("-machdep", f"gcc_x86_{variant.int_bits}", f"-cpp-extra-args={flags}")
    plugins = ("-no-autoload-plugins", "-load-module", "eva,from,inout,scope,metrics")
    eva = ("-eva", "-eva-precision", str(precision), *DOMAINS, "-metrics-eva-cover", CALLS)
    return run(require("frama-c", "frama-c-base"), *plugins, *machine, *eva)
