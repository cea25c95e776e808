"""Costs of the firmware are those that the documentation states, and none grows with age or neighbours."""

from __future__ import annotations

import pickle
import re
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path

import pytest

from simulated_avr import require_simavr
from support import made_once, require

pytest.importorskip("unicorn", reason="the emulator that counts instructions is not installed: make setup")

from benchmarks.cost import report
from benchmarks.cost.images import AVR, LEVELS, TARGETS, Image, Target, build
from benchmarks.cost.machines import load
from benchmarks.cost.measurement import PAPER, ROBUST, Build, Cost, Figures, kilobot, measure_builds
from benchmarks.cost.robots import TESTED, UPDATED, ObservedCall

[CORTEX_M4] = [target for target in TARGETS if target.name == "Cortex-M4"]


def usable(target: Target) -> Target:
    """Return the target; skips where its compiler or its emulator is missing."""
    require(target.compiler, target.package)
    if target == AVR:
        require_simavr()
    return target


@dataclass(frozen=True)
class Measured:
    """The costs of a target by the level of optimisation, which are measured once for all tests."""

    target: Target
    costs: dict[str, Cost]


def measured_once(target: Target, factory: pytest.TempPathFactory) -> Measured:
    """Measure a target at each level, or return what another test has measured. Takes half a minute."""

    def measure_and_keep(folder: Path) -> None:
        costs = {level: measure_builds(target, level, folder / level) for level in LEVELS}
        (folder / "costs").write_bytes(pickle.dumps(costs))

    folder = made_once(factory, f"cost of {target.name}", measure_and_keep)
    return Measured(target, pickle.loads((folder / "costs").read_bytes()))


@pytest.fixture(params=TARGETS, ids=lambda target: target.name)
def measured(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Measured:
    """The costs of each of five microcontrollers, in turn."""
    return measured_once(usable(request.param), tmp_path_factory)


@pytest.fixture(params=[target for target in TARGETS if target != AVR], ids=lambda target: target.name)
def measured_32_bit(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Measured:
    """The costs of each microcontroller of 32 bits, in turn."""
    return measured_once(usable(request.param), tmp_path_factory)


@pytest.fixture
def cortex_m4(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Cost]:
    """The costs of a Cortex-M4 by level."""
    return measured_once(usable(CORTEX_M4), tmp_path_factory).costs


@pytest.fixture
def atmega328p(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Cost]:
    """The costs of an ATmega328P, a processor of 8 bits, by level."""
    return measured_once(usable(AVR), tmp_path_factory).costs


# --- The documentation ------------------------------------------------------------------------------------


def skip_if_documented_of_another_compiler(target: Target) -> None:
    """Skip the test if docs/internals/cost.md has the figures of another compiler than that which is here."""
    if target.version() not in report.PAGE.read_text(encoding="utf-8"):
        pytest.skip(f"the pages are of other compilers than {target.version()}: run make cost")


def numbers_in(row: str) -> list[float]:
    """Return the numbers in the cells of a table's row behind its first cell, which is a name."""
    _, _name, *cells = row.split("|")
    return [float(number) for number in re.findall(r"[\d.]+", " ".join(cells))]


def documented_row(table_name: str, name: str) -> str:
    """Return the row of this name in a table of the README or docs/internals/cost.md."""
    page = report.README if table_name == "cost table" else report.PAGE
    table = report.section_in(page.read_text(encoding="utf-8"), table_name)
    [row] = [line for line in table.splitlines() if line.startswith(f"| {name} |")]
    return row


def measured_rows(measured: Measured) -> list[tuple[str, str, str]]:
    """Return the name of the table, the name of the row and its text for each row with measured costs."""
    costs = {(measured.target.name, level): cost for level, cost in measured.costs.items()}
    named_rows = []
    for table_name, rows in report.rows_by_table(costs).items():
        for row in rows:
            row_name, *_cells = row.values()
            _titles, _rule, text = report.table([row]).splitlines()
            named_rows.append((table_name, row_name, text))
    return named_rows


@pytest.mark.slow
def test_the_tables_of_the_documentation_have_the_costs_that_are_measured(measured: Measured) -> None:
    """Every figure of a target in the README and docs/internals/cost.md is within 2 % of the measured one.

    If not, ``make cost`` writes the tables again.
    """
    skip_if_documented_of_another_compiler(measured.target)

    for table_name, row_name, measured_row in measured_rows(measured):
        documented_numbers = numbers_in(documented_row(table_name, row_name))
        measured_numbers = numbers_in(measured_row)
        assert documented_numbers == pytest.approx(measured_numbers, rel=0.02), measured_row


@pytest.mark.slow
def test_the_first_lines_of_the_cost_page_have_the_figures_of_a_cortex_m4(cortex_m4: dict[str, Cost]) -> None:
    """The build has both filters, at -O2, and the robust filter runs.

    The bound is the longest path of a step with test and update. No observed step was that long.
    """
    skip_if_documented_of_another_compiler(CORTEX_M4)
    cost = cortex_m4["-O2"]
    page = " ".join(report.PAGE.read_text(encoding="utf-8").split())
    stated = re.search(
        r"([\d.]+) KB of flash, (\d+) bytes of RAM for a robot and (\d+) of stack\."
        r".* took at most (\d+) instructions, and the bound is (\d+)",
        page,
    )
    assert stated is not None
    flash, ram, stack, most_instructions, bound = map(float, stated.groups())
    bytes_of_flash, _with_save_and_restore = cost.robust.code

    assert flash == pytest.approx(bytes_of_flash / 1000, abs=0.06), "KB, with one decimal"
    assert (ram, stack) == (cost.robust.ram, cost.robust.tick_stack())
    assert most_instructions == max(cost.paper.largest(UPDATED), cost.robust.largest(UPDATED))
    assert bound == cost.robust.bound[UPDATED]


@pytest.mark.slow
def test_each_chip_of_the_readme_needs_at_most_15_kb_of_flash_and_500_bytes_of_ram(
    measured: Measured,
) -> None:
    """The README promises it of a build with both filters that is optimised for size."""
    readme = report.README.read_text(encoding="utf-8")
    assert "| flash | [at most 15 KB]" in readme
    assert "| RAM | [at most 500 bytes]" in readme

    robust = measured.costs["-Os"].robust
    bytes_of_flash, _with_save_and_restore = robust.code
    assert bytes_of_flash <= 15_000
    assert robust.ram + robust.tick_stack() <= 500


# --- Nothing grows ----------------------------------------------------------------------------------------


@pytest.mark.slow
@pytest.mark.parametrize("level", LEVELS)
@pytest.mark.parametrize(
    ("builds", "allowed_ratio_of_test"),
    [(["paper_alone"], 1.1), (["robust_alone"], 1.2), (["paper", "robust"], 1.2)],
    ids=["paper's filter alone", "robust filter alone", "both filters"],
)
def test_no_call_takes_more_instructions_than_its_bound_which_is_not_far_above(
    builds: list[str], allowed_ratio_of_test: float, level: str, measured_32_bit: Measured
) -> None:
    """The bound is the longest path through the machine code, for any data.

    It is at most 10 % above the largest cost that long searches found with either filter. The robust filter's
    test has loops, and only some turns are as long as the longest turn. So the test is allowed 20 %.
    """
    costs = measured_32_bit.costs[level]
    figures_of_builds: list[Figures] = [getattr(costs, build_name) for build_name in builds]
    for call in ("receive", "step", UPDATED, "x"):  # in an UPDATED step the filter runs
        most_observed = max(figures.largest(call) for figures in figures_of_builds)
        allowed_ratio = allowed_ratio_of_test if call == UPDATED else 1.1
        for figures in figures_of_builds:
            assert most_observed <= figures.bound[call] <= allowed_ratio * most_observed, call


@pytest.mark.slow
def test_a_cortex_m0_divides_by_a_table_and_larger_processors_by_14_instructions(
    measured_32_bit: Measured,
) -> None:
    """A Cortex-M0+ has no instruction that divides. The image has the paper's filter alone, at -O2."""
    expected_divisions = 0 if measured_32_bit.target.name == "Cortex-M0+" else 14
    assert measured_32_bit.costs["-O2"].paper_alone.divisions == expected_divisions


def most_cycles(calls: Iterable[ObservedCall]) -> int:
    return max(call.cost.cycles for call in calls)


@pytest.mark.slow
@pytest.mark.parametrize("level", LEVELS)
def test_calls_on_an_8_bit_processor_take_hardly_longer_in_an_old_robot_or_in_a_crowd(
    level: str, atmega328p: dict[str, Cost]
) -> None:
    """An AVR divides and shifts in loops, so it has no bound from the machine code.

    An old robot has observed more than 2^16 times, t. In a crowd it has heard 8 others or more in a round, m.
    To receive, it shifts 1 by the sender's id, one place in a turn of a loop. The end of a round, settle,
    takes the same number of cycles in all of them.
    """
    calls = atmega328p[level].paper_alone.observed_calls
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
@pytest.mark.parametrize("level", LEVELS)
@pytest.mark.parametrize(
    ("function", "kinds_of_calls"),
    [("receive", ["receive"]), ("x", ["x"]), ("step", ["step", TESTED, UPDATED])],
)
def test_no_call_touches_more_stack_than_its_frames_add_up_to(
    function: str, kinds_of_calls: list[str], level: str, measured: Measured
) -> None:
    """The compiler reports the frame of each function. They add up over the deepest chain of calls.

    The sum is a bound of the bytes that any call has touched. It is above them by two alignments of the stack
    pointer and 8 bytes at most, in a build with either filter.
    """
    cost = measured.costs[level]
    largest_difference = 2 * ALIGNMENT[measured.target.tools] + 8
    for figures in (cost.paper_alone, cost.robust_alone):
        sum_of_frames = figures.stack[function]
        touched_bytes = max(figures.largest(kind, "stack") for kind in kinds_of_calls)
        assert touched_bytes <= sum_of_frames <= touched_bytes + largest_difference


@pytest.mark.slow
@pytest.mark.parametrize(
    ("target", "level", "calls_before", "code_before"),
    [
        pytest.param(AVR, "-Os", (1322, 3559, 11084, 3344), (7527, 11267), id="ATmega328P-Os"),
        pytest.param(AVR, "-O2", (1339, 3626, 10895, 3079), (8409, 15821), id="ATmega328P-O2"),
        pytest.param(CORTEX_M4, "-Os", (50, 147, 407, 85), (1574, 2736), id="Cortex-M4-Os"),
        pytest.param(CORTEX_M4, "-O2", (49, 125, 376, 78), (2040, 4120), id="Cortex-M4-O2"),
    ],
)
def test_a_firmware_without_the_robust_filter_costs_what_it_did_before_there_was_one(
    target: Target,
    level: str,
    calls_before: tuple[int, ...],
    code_before: tuple[int, int],
    tmp_path_factory: pytest.TempPathFactory,
) -> None:
    """No call takes half a percent more, in cycles on an AVR and in instructions on a Cortex-M4.

    ``calls_before`` has the costs of four calls, and ``code_before`` the bytes of code, without and with save
    and restore. The instructions are those of the longest path; an AVR has no such bound, so the longest call
    of all that were observed counts.
    """
    figures = measured_once(usable(target), tmp_path_factory).costs[level].paper_alone
    calls = ("receive", "step", UPDATED, "x")  # in an UPDATED step the filter runs
    for call, cost_before in zip(calls, calls_before, strict=True):
        cost = figures.bound[call] if figures.bound else figures.largest(call, "cycles")
        assert cost <= 1.005 * cost_before, call
    for size, size_before in zip(figures.code, code_before, strict=True):
        assert size <= 1.005 * size_before


@pytest.mark.slow
def test_the_robust_filter_takes_no_more_on_a_cortex_m4_than_it_was_meant_to(
    cortex_m4: dict[str, Cost],
) -> None:
    """It was to keep limits of RAM and code in bytes, and of the instructions of three calls.

    The calls receive a message, take a step without the filter, and take a step with test and update
    (UPDATED). ``robust_alone`` is a build without the paper's filter, ``robust`` one with both.
    """
    small, fast = cortex_m4["-Os"], cortex_m4["-O2"]  # optimised for size and for speed
    for cost in (small, fast):
        assert (cost.robust.ram, cost.robust_alone.ram) == (176, 176)
        assert cost.robust.bound["receive"] <= 55
        assert cost.robust_alone.bound["receive"] <= 40
    assert fast.robust_alone.bound["step"] <= 190
    assert small.robust_alone.bound["step"] <= 200
    assert fast.robust_alone.bound[UPDATED] <= 7000
    assert small.robust_alone.bound[UPDATED] <= 8600
    bytes_of_code, _with_save_and_restore = small.robust_alone.code
    assert bytes_of_code <= 2250


@pytest.mark.parametrize(
    ("build_options", "largest_share_of_flash"),
    [
        pytest.param(PAPER, 1 / 2, id="paper", marks=pytest.mark.slow),
        pytest.param(Build(), 2 / 3, id="both"),
        pytest.param(ROBUST, 1 / 2, id="robust", marks=pytest.mark.slow),
    ],
)
def test_the_firmware_of_a_kilobot_leaves_room_and_the_documentation_states_how_much_it_takes(
    build_options: Build, largest_share_of_flash: float, tmp_path: Path
) -> None:
    """It is built with either filter or both, and takes half of the RAM at most.

    The documentation's figures are compared only if they are from the compiler that is here.
    """
    usable(AVR)
    flash, ram = kilobot(tmp_path / "image", build_options)

    assert flash <= largest_share_of_flash * report.FLASH
    assert ram <= report.RAM / 2
    page = report.PAGE.read_text(encoding="utf-8").replace("\n", " ")
    if AVR.version() in page:
        shares_of_flash_and_ram = report.share((flash, ram))
        assert shares_of_flash_and_ram in page


# --- What measures ----------------------------------------------------------------------------------------


def image_with(code: str, target: Target, folder: Path) -> Image:
    """Return an image with functions in C. The linker keeps known() in it."""
    (folder / "program.c").write_text(f"{code}\nint main(void) {{ return 0; }}\n", encoding="utf-8")
    return build(target, folder / "build", [folder / "program.c"], "-O1", "-Wl,-u,known")


def counts_of(lines: Sequence[str], target: Target, folder: Path) -> tuple[int, int, int]:
    """Return instructions, cycles and bytes of stack of a function of these lines of assembly."""
    text = "\\n".join((".globl known", ".type known, %function", "known:", *lines))
    machine = load(image_with(f'__asm__("{text}\\n");', usable(target), folder))
    _value, instructions, cycles, stack = machine.call("known")
    return instructions, cycles, stack


def test_instructions_cycles_and_stack_of_an_avr_are_counted_as_in_its_manual(tmp_path: Path) -> None:
    """The loop turns ten times, so its branch is taken nine times. A branch that is taken takes two cycles.

    So do mul, push and pop. ret takes four, all others one. A call pushes 2 bytes, and the function one more.
    """
    loop = ("ldi r24, 10", "1: dec r24", "brne 1b")
    lines = (*loop, "mul r24, r24", "clr r1", "push r24", "pop r24", "ret")

    instructions, cycles, stack = counts_of(lines, AVR, tmp_path)

    assert instructions == 1 + 10 * 2 + 5  # the first ldi, dec and brne in each turn, and five after the loop
    cycles_of_dec, cycles_of_brne = 10, 9 * 2 + 1
    cycles_of_loop = 1 + cycles_of_dec + cycles_of_brne
    assert cycles == cycles_of_loop + 2 + 1 + 2 + 2 + 4  # mul, clr, push, pop and ret
    assert stack == 2 + 1


def test_instructions_of_a_cortex_m4_are_counted_without_those_that_a_condition_skips(tmp_path: Path) -> None:
    """The loop turns ten times. moveq, the move for equal numbers, is skipped and not counted; ``it`` is.

    push saves two registers of 4 bytes on the stack.
    """
    loop = ("movs r0, #10", "1: subs r0, #1", "bne 1b")
    choice = ("cmp r0, #1", "it eq", "moveq r1, #2", "it ne", "movne r1, #3")
    lines = (".syntax unified", ".thumb_func", "push {r4, lr}", *loop, *choice, "pop {r4, pc}")

    instructions, _cycles, stack = counts_of(lines, CORTEX_M4, tmp_path)

    of_loop = 1 + 10 * 2  # the first movs, and subs and bne in each turn
    of_choice = 4  # cmp, both it, and movne
    of_push, of_pop = 1, 1
    assert instructions == of_push + of_loop + of_choice + of_pop
    assert stack == 2 * 4
