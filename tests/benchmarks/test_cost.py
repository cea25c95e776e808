"""Costs of the firmware are those that the documentation states, and none grows with age or neighbours."""

from __future__ import annotations

import os
import pickle
from collections.abc import Iterable
from pathlib import Path

import pytest

from golden import RENEW, assert_equals_section
from simulated_avr import require_simavr
from support import cells_of_line, made_once, require

pytest.importorskip("unicorn", reason="the emulator that counts instructions is not installed: make setup")

from benchmarks.cost import report
from benchmarks.cost.images import AVR, TARGETS, Target
from benchmarks.cost.measurement import BOTH, BUILDS, PAPER, ROBUST, Build, Figures, kilobot, measure
from benchmarks.cost.report import Measurements
from benchmarks.cost.robots import TESTED, UPDATED, ObservedCall

LEVELS = {target.name: ("-Os", "-O2") if target.name == "Cortex-M4" else ("-Os",) for target in TARGETS}
"""The levels of optimisation at which targets are measured. One target shows what -O2 gains."""


@pytest.fixture(scope="module")
def measurements(tmp_path_factory: pytest.TempPathFactory) -> Measurements:
    """The costs of all builds on each target, which are measured once for all tests. Takes 20 seconds."""
    for target in TARGETS:
        require(target.compiler, target.package)
    require_simavr()

    def measure_and_keep(folder: Path) -> None:
        measurements: Measurements = {}
        for target in TARGETS:
            for level in LEVELS[target.name]:
                for build in BUILDS:
                    build_folder = folder / target.name / level / build.name
                    measurements[target.name, level, build] = measure(target, level, build_folder, build)
        (folder / "measurements").write_bytes(pickle.dumps(measurements))

    folder = made_once(tmp_path_factory, "cost", measure_and_keep)
    kept: Measurements = pickle.loads((folder / "measurements").read_bytes())
    return kept


def on_32_bits(measurements: Measurements) -> dict[str, Figures]:
    """Return the costs on processors of 32 bits, by the names of target, level and build."""
    return {
        f"{target} {level}, {build.name}": figures
        for (target, level, build), figures in measurements.items()
        if target != AVR.name
    }


# --- The documentation ------------------------------------------------------------------------------------


@pytest.mark.slow
def test_the_tables_of_the_documentation_have_the_costs_that_are_measured(measurements: Measurements) -> None:
    """If not, ``make cost`` writes them again. With other compilers than those on the page they differ."""
    compilers = report.compilers()
    if compilers not in report.PAGE.read_text(encoding="utf-8") and RENEW not in os.environ:
        pytest.skip(f"the pages are of others: {compilers} Run make cost")
    sections = report.sections(measurements)

    assert_equals_section(report.README, "cost table", sections.pop("cost table"))
    for name, section in sections.items():
        assert_equals_section(report.PAGE, name, section)
    assert_equals_section(report.PAGE, "compilers", compilers)


def test_the_first_lines_of_the_page_have_the_figures_of_a_cortex_m4_in_its_tables() -> None:
    """The figures are of a build with both filters at -O2; a KB has 1000 bytes."""
    page = report.PAGE.read_text(encoding="utf-8")
    summary = page.partition("\n## ")[0]
    rows = [line for line in page.splitlines() if line.startswith("| Cortex-M4 -O2, both |")]
    [memory, calls] = [cells_of_line(row) for row in rows]
    _build, code, _with_save_and_restore, ram, stack_of_tick, _stack_of_restore = memory
    _build, _receive, _x, _step, updated_step, bound = calls

    kilobytes = f"{int(code) / 1000:.1f}"
    assert (
        f"takes {kilobytes} KB of flash, {ram} bytes of RAM for a robot and {stack_of_tick} of stack"
        in summary
    )
    assert f"took at most {updated_step} instructions, and the bound is {bound}" in summary


@pytest.mark.slow
def test_each_chip_of_the_readme_needs_at_most_15_kb_of_flash_and_500_bytes_of_ram(
    measurements: Measurements,
) -> None:
    """The README promises it of a build with both filters that is optimised for size."""
    readme = report.README.read_text(encoding="utf-8")
    assert "| flash | [at most 15 KB]" in readme
    assert "| RAM | [at most 500 bytes]" in readme

    for target in TARGETS:
        figures = measurements[target.name, "-Os", BOTH]
        bytes_of_flash, _with_save_and_restore = figures.code
        assert bytes_of_flash <= 15_000
        assert figures.ram + figures.tick_stack() <= 500


# --- Nothing grows ----------------------------------------------------------------------------------------


@pytest.mark.slow
def test_no_call_takes_more_instructions_than_its_bound_which_is_not_far_above(
    measurements: Measurements,
) -> None:
    """The bound is the longest path through the machine code, for any data.

    It is at most 10 % above the largest cost that was observed with the paper's filter. The robust filter's
    test has loops, and only some turns are as long as the longest turn. So the test is allowed 20 %.
    """
    for name, figures in on_32_bits(measurements).items():
        for call in ("receive", "step", UPDATED, "x"):  # in an UPDATED step the filter runs
            assert figures.largest(call) <= figures.bound[call], f"{call} of {name}"
            if BOTH.name not in name:  # with both built, the robot has only one of them
                allowed_ratio = 1.2 if call == UPDATED else 1.1
                assert figures.bound[call] <= allowed_ratio * figures.largest(call), f"{call} of {name}"


def most_cycles(calls: Iterable[ObservedCall]) -> int:
    return max(call.cost.cycles for call in calls)


@pytest.mark.slow
def test_calls_on_an_8_bit_processor_take_hardly_longer_in_an_old_robot_or_in_a_crowd(
    measurements: Measurements,
) -> None:
    """An AVR divides and shifts in loops, so it has no bound from the machine code.

    An old robot has observed more than 2^16 times, t. In a crowd it has heard 8 others or more in a round, m.
    To receive, it shifts 1 by the sender's id, one place in a turn of a loop. The end of a round, settle,
    takes the same number of cycles in all of them.
    """
    calls = measurements[AVR.name, "-Os", PAPER].observed_calls
    old_steps = [call for call in calls if call.kind == "step" and call.t > 2**16]
    young_steps = [call for call in calls if call.kind == "step" and call.t <= 2**16]
    crowded_receives = [call for call in calls if call.kind == "receive" and call.m >= 8]
    lonely_receives = [call for call in calls if call.kind == "receive" and call.m < 8]

    assert most_cycles(old_steps) <= 1.06 * most_cycles(young_steps)
    assert most_cycles(crowded_receives) <= 1.25 * most_cycles(lonely_receives)
    cycles_of_settle = {call.cost.cycles for call in calls if call.kind == "settle"}
    assert len(cycles_of_settle) == 1


ALIGNMENT = {"avr-": 1, "arm-none-eabi-": 8, "riscv64-unknown-elf-": 16}
"""Bytes to which the stack pointer is aligned, by what the names of a target's tools begin with."""


@pytest.mark.slow
@pytest.mark.parametrize("target", TARGETS, ids=lambda target: target.name)
@pytest.mark.parametrize(
    ("function", "kinds_of_calls"),
    [("receive", ["receive"]), ("x", ["x"]), ("step", ["step", TESTED, UPDATED])],
)
def test_no_call_touches_more_stack_than_its_frames_add_up_to(
    function: str, kinds_of_calls: list[str], target: Target, measurements: Measurements
) -> None:
    """The compiler reports the frame of each function. They add up over the deepest chain of calls.

    The sum is a bound of the bytes that any call has touched. It is above them by two alignments of the stack
    pointer and 8 bytes at most, in a build with either filter.
    """
    largest_difference = 2 * ALIGNMENT[target.tools] + 8
    for level in LEVELS[target.name]:
        for build in (PAPER, ROBUST):
            figures = measurements[target.name, level, build]
            sum_of_frames = figures.stack[function]
            touched_bytes = max(figures.largest(kind, "stack") for kind in kinds_of_calls)
            assert touched_bytes <= sum_of_frames <= touched_bytes + largest_difference


@pytest.mark.parametrize(
    ("build", "largest_share_of_flash"),
    [
        pytest.param(PAPER, 1 / 2, id="paper", marks=pytest.mark.slow),
        pytest.param(BOTH, 2 / 3, id="both"),
        pytest.param(ROBUST, 1 / 2, id="robust", marks=pytest.mark.slow),
    ],
)
def test_the_firmware_of_a_kilobot_leaves_room_and_the_documentation_states_how_much_it_takes(
    build: Build, largest_share_of_flash: float, tmp_path: Path
) -> None:
    """It is built with either filter or both, and takes half of the RAM at most.

    The documentation's figures are compared only if they are from the compiler that is here.
    """
    require(AVR.compiler, AVR.package)
    require_simavr()
    flash, ram = kilobot(tmp_path / "image", build)

    assert flash <= largest_share_of_flash * report.FLASH
    assert ram <= report.RAM / 2
    page = report.PAGE.read_text(encoding="utf-8")
    if AVR.version() in page:
        assert report.kilobot_row(build, flash, ram) in page
