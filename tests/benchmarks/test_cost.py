"""The pages say of the cost what is measured, and nothing grows."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from simulated_avr import require_simavr
from support import require, slow

pytest.importorskip("unicorn", reason="the emulator that counts instructions is not installed: make setup")

from benchmarks.cost import report
from benchmarks.cost.images import AVR, LEVELS, TARGETS, Image, Target, build
from benchmarks.cost.machines import load
from benchmarks.cost.measurement import BUILDS, PAPER, ROBUST, Build, Figures, kilobot, measure
from benchmarks.cost.robots import TESTED, UPDATED

TOLERANCE = 0.02
ALIGNMENT = {"avr-": 1, "arm-none-eabi-": 8, "riscv64-unknown-elf-": 16}
"""Bytes to which the stack pointer is aligned."""
NUMBER = re.compile(r"[\d.]+")


def usable(target: Target) -> Target:
    """The target; skips where something is missing."""
    require(target.compiler, target.package)
    if target == AVR:
        require_simavr()
    return target


@pytest.mark.parametrize(
    ("target", "levels"),
    slow((target, LEVELS) for target in TARGETS),
    ids=lambda value: getattr(value, "name", "".join(value) if isinstance(value, tuple) else None),
)
def test_a_robot_with_the_paper_s_filter_costs_what_the_docs_state(
    target: Target, levels: tuple[str, ...], tmp_path: Path
) -> None:
    """In instructions, stack and flash, on a target at each level of optimisation, and no more than before.

    All at once, as measuring is what takes the time.
    """
    figures_by_level = {level: measure(usable(target), level, tmp_path / level) for level in levels}

    for level, figures in figures_by_level.items():
        check_growth(target, figures)
        check_stacks(target, figures)
        figures_before = BEFORE.get(target.name, {}).get(level)
        if figures_before is not None:
            check_same(figures, figures_before)
    page = published_page(target)
    if levels == LEVELS:
        check_row(page, report.short_row(target.name, figures_by_level["-O2"]))
    for level, figures in figures_by_level.items():
        if report.is_in_page(target.name, level):
            check_row(page, report.call_row("paper's filter", f"{target.name} {level}", figures))
            check_row(page, report.memory_row(f"{target.name} {level}", figures))


BEFORE = {
    "ATmega328P": {
        "-Os": (1322, 3559, 11084, 3344, 7527, 11267),
        "-O2": (1339, 3626, 10895, 3079, 8409, 15821),  # 90 bytes more, outside the core
    },
    "Cortex-M4": {"-Os": (50, 147, 407, 85, 1574, 2736), "-O2": (49, 125, 376, 78, 2040, 4120)},
}
"""What receive, a step, one with test and update, and x took at most, and the bytes of code, before there was
a robust filter: a build without it takes no more."""


def check_same(figures: Figures, figures_before: tuple[int, ...]) -> None:
    """Check that calls and code take no more than they did, but for half a percent."""
    calls = ("receive", "step", UPDATED, "x")
    most = [figures.bound[call] if figures.bound else figures.most(call, "cycles") for call in calls]
    for new, old in zip((*most, *figures.code), figures_before, strict=True):
        assert new <= 1.005 * old


SLACK_OF_BOUND = {"receive": 1.1, "step": 1.1, "x": 1.1, UPDATED: 1.15}
"""How far bounds may be above the most that was observed. The robust filter's test has loops, whose turns are
not all as long as the longest one."""


def check_bounds(paper: Figures, robust: Figures, alone: Figures) -> None:
    """Check that no call takes more than its bound, and that no bound is far above the most that was seen."""
    for call, bound in alone.bound.items():
        assert alone.most(call) <= bound <= SLACK_OF_BOUND[call] * alone.most(call), call
    for call, bound in robust.bound.items():
        most = max(paper.most(call), robust.most(call))
        assert bound == paper.bound[call], call
        assert most <= bound <= SLACK_OF_BOUND[call] * most, call


def check_chip_of_readme(target: Target, robust: Figures) -> None:
    """Check the README's row of a chip, and what it promises of all: 15 KB of flash and 500 bytes of RAM."""
    readme = report.README.read_text(encoding="utf-8")
    check_row(readme, report.chip_row(target.name, robust))
    assert "| flash | [at most 15 KB]" in readme
    assert "| RAM | [at most 500 bytes]" in readme
    bytes_of_flash, *_ = robust.code
    assert bytes_of_flash <= 15_000
    assert robust.ram + robust.tick_stack() <= 500


@pytest.mark.slow
@pytest.mark.parametrize("target", TARGETS, ids=lambda target: target.name)
def test_a_robot_with_the_robust_filter_costs_what_the_docs_state(target: Target, tmp_path: Path) -> None:
    """Three builds are compared at each level of optimisation, all at once, as measuring takes the time.

    ``paper`` and ``robust`` are one firmware with both filters, used with either, and ``alone`` has no other
    filter.
    """
    figures_by_level = {
        level: [
            measure(usable(target), level, tmp_path / f"{level}{number}", build_options)
            for number, build_options in enumerate(BUILDS)
        ]
        for level in LEVELS
    }

    for paper, robust, alone in figures_by_level.values():
        check_stacks(target, alone)
        assert len(robust.seen) > 0
        assert paper.code == robust.code
        assert alone.ram == robust.ram
        check_bounds(paper, robust, alone)
    page = published_page(target)
    if target.name == "Cortex-M4":
        check_aims(figures_by_level)
        paper, robust, _ = figures_by_level["-O2"]
        check_summary(" ".join(page.split()), paper, robust)
    if target.name in report.CHIPS:
        _, robust, _ = figures_by_level["-Os"]
        check_chip_of_readme(target, robust)
    for level, (_, robust, alone) in figures_by_level.items():
        if report.is_in_page(target.name, level):
            check_row(page, report.call_row("robust filter", f"{target.name} {level}", alone))
            check_row(page, report.filter_memory_row(f"{target.name} {level}", robust, alone))


def published_page(target: Target) -> str:
    """Return docs/internals/cost.md; skips where it is of another compiler."""
    page = report.PAGE.read_text(encoding="utf-8")
    if target.version() not in page:
        pytest.skip(f"the pages are of other compilers than {target.version()}: run make cost")
    return page


def check_summary(page: str, paper: Figures, robust: Figures) -> None:
    """The page's summary has the figures of one build: what was seen and what bounds it, told apart."""
    seen = max(paper.most(UPDATED), robust.most(UPDATED))
    told = re.search(
        r"([\d.]+) KB of flash, (\d+) bytes of RAM for a robot and (\d+) of stack\."
        r".* took at most (\d+) instructions, and the bound is (\d+)",
        page,
    )
    assert told is not None
    flash, *others = map(float, told.groups())
    assert flash == pytest.approx(robust.code[0] / 1000, abs=0.06)
    assert others == [robust.ram, robust.tick_stack(), seen, robust.bound[UPDATED]]


def check_aims(compared: dict[str, list[Figures]]) -> None:
    """What the robust filter may cost on a Cortex-M4: memory, a message, a round, and a test."""
    for _, robust, alone in compared.values():
        assert (robust.ram, alone.ram) == (176, 176)
        assert robust.bound["receive"] <= 55 and alone.bound["receive"] <= 40
    small, fast = compared["-Os"][2], compared["-O2"][2]
    assert fast.bound["step"] <= 190 and small.bound["step"] <= 200
    assert fast.bound[UPDATED] <= 7450 and small.bound[UPDATED] <= 8450
    assert small.code[0] <= 2250


def check_row(page: str, fresh: report.Row) -> None:
    """The page has the row, in a table with its titles, with about its numbers."""
    titles, _, row = report.table([fresh]).splitlines()
    name, _, cells = row.removeprefix("| ").partition(" |")
    published = re.search(rf"^\| {re.escape(name)} \|(.*)$", page.partition(f"{titles}\n")[2], re.MULTILINE)
    assert published, f"{row}: run make cost"
    old, new = ([float(each) for each in NUMBER.findall(line)] for line in (published[1], cells))
    assert old == pytest.approx(new, rel=TOLERANCE), f"{row}: run make cost"


def check_growth(target: Target, found: Figures) -> None:
    """No call is longer than its longest path, and no longest path is far above what was seen: code without
    loops does not grow. An AVR has loops: its most at large t and m is that at small ones, but that it shifts
    1 by the sender's id in one. A Cortex-M0+ divides by a table, an AVR bit by bit, the others with an
    instruction."""
    if target != AVR:
        for kind, bound in found.bound.items():
            assert found.most(kind) <= bound <= 1.1 * found.most(kind), kind
        assert found.divisions == (0 if target.name == "Cortex-M0+" else 14)
        return
    cycles = {
        kind: [(each.t, each.m, each.cost.cycles) for each in found.seen if each.kind == kind]
        for kind in ("step", "receive", "settle")
    }
    old, young = (max(c for t, _, c in cycles["step"] if (t > 2**16) is is_old) for is_old in (True, False))
    many, few = (max(c for _, m, c in cycles["receive"] if (m >= 8) is is_many) for is_many in (True, False))
    assert old <= 1.06 * young and many <= 1.25 * few
    assert len({c for _, _, c in cycles["settle"]}) == 1


def check_stacks(target: Target, found: Figures) -> None:
    for name, kinds in {"receive": ["receive"], "x": ["x"], "step": ["step", TESTED, UPDATED]}.items():
        touched = max(found.most(kind, "stack") for kind in kinds)
        assert touched <= found.stack[name] <= touched + 2 * ALIGNMENT[target.tools] + 8, name


@pytest.mark.parametrize(
    ("build_options", "largest_share_of_flash"),
    [
        pytest.param(PAPER, 1 / 2, id="paper", marks=pytest.mark.slow),
        pytest.param(Build(), 2 / 3, id="both"),
        pytest.param(ROBUST, 1 / 2, id="robust", marks=pytest.mark.slow),
    ],
)
def test_the_firmware_leaves_room_on_a_kilobot_and_the_docs_state_how_much_it_takes(
    build_options: Build, largest_share_of_flash: float, tmp_path: Path
) -> None:
    """With either filter or both. The docs' figures are those of one version of the compiler."""
    usable(AVR)

    flash, ram = kilobot(tmp_path / "image", build_options)

    assert flash <= largest_share_of_flash * report.FLASH
    assert ram <= report.RAM / 2
    page = report.PAGE.read_text(encoding="utf-8").replace("\n", " ")
    if AVR.version() in page:
        assert report.share((flash, ram)) in page


# ---- What measures ----

KNOWN = {
    "ATmega328P": (
        ("ldi r24, 10", "1: dec r24", "brne 1b", "mul r24, r24", "clr r1", "push r24", "pop r24", "ret"),
        (1 + 10 + 10 + 5, 1 + 10 + (9 * 2 + 1) + 2 + 1 + 2 + 2 + 4, 2 + 1),
    ),
    "Cortex-M4": (
        (
            *(".syntax unified", ".thumb_func", "push {r4, lr}", "movs r0, #10", "1: subs r0, #1", "bne 1b"),
            *("cmp r0, #1", "it eq", "moveq r1, #2", "it ne", "movne r1, #3", "pop {r4, pc}"),
        ),
        (2 + 10 + 10 + 1 + 1 + 2 + 1, 0, 8),
    ),
}
"""Functions in assembly, and their instructions, cycles by the processor's manual, and bytes of stack: an
instruction that a condition before it skips does not count."""


def program(target: Target, folder: Path, code: str) -> Image:
    """An image with functions in C, of which known() stays in it."""
    (folder / "program.c").write_text(f"{code}\nint main(void) {{ return 0; }}\n", encoding="utf-8")
    return build(target, folder / "build", [folder / "program.c"], "-O1", "-Wl,-u,known")


@pytest.mark.parametrize("name", KNOWN)
def test_instructions_cycles_and_stack_are_counted_as_in_the_processor_s_manual(
    name: str, tmp_path: Path
) -> None:
    """The processor runs a function in assembly, whose counts KNOWN adds up from the manual."""
    lines, counts_of_the_manual = KNOWN[name]
    target = usable(next(target for target in TARGETS if target.name == name))
    text = "\\n".join((".globl known", ".type known, %function", "known:", *lines))
    machine = load(program(target, tmp_path, f'__asm__("{text}\\n");'))

    _value, *counts = machine.call("known")

    assert tuple(counts) == counts_of_the_manual
