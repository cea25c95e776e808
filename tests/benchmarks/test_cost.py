"""The pages say of the cost what is measured, budgets hold, and nothing grows."""

from __future__ import annotations

from pathlib import Path

import pytest

from support import require

pytest.importorskip("unicorn", reason="the emulator that counts instructions is not installed: make setup")

from benchmarks.cost import report
from benchmarks.cost.images import AVR, LEVELS, TARGETS, Image, Target, build
from benchmarks.cost.machines import Machine, load
from benchmarks.cost.measurement import (
    BUDGETS,
    TICK_CALLS,
    Figures,
    firmware_image,
    kilobot,
    measure,
    within,
)
from benchmarks.cost.paths import Paths
from benchmarks.cost.report import Numbers
from benchmarks.cost.robots import OWN_ID, UPDATED, Robot
from mcp_asdf import Config, MirrorRobot, Observation
from mcp_asdf_tools.tables.thresholds import generate, parse_omega

TOLERANCE = 0.02
every_target = pytest.mark.parametrize("target", TARGETS, ids=lambda target: target.name)
ALIGNMENT = {"avr-": 1, "arm-none-eabi-": 8, "riscv64-unknown-elf-": 16}
"""Bytes to which the stack pointer is aligned."""


def usable(target: Target) -> Target:
    """The target; skips where something is missing."""
    require(target.compiler, target.package)
    if target == AVR and not Path("/usr/include/simavr/sim_avr.h").exists():
        pytest.skip("simavr's headers are not installed: apt-get install libsimavr-dev")
    return target


def named(name: str) -> Target:
    return usable(next(target for target in TARGETS if target.name == name))


# ---- The figures ----


@every_target
def test_cost_is_within_budget_and_as_published(target: Target, tmp_path: Path) -> None:
    """All at once, as measuring is what takes the time: a target at both levels."""
    small, fast = (measure(usable(target), level, tmp_path / level) for level in LEVELS)
    levels = dict(zip(LEVELS, (small, fast), strict=True))
    measured = {
        name: pair for level in LEVELS for name, pair in within(target.name, level, levels[level]).items()
    }
    assert measured.keys() == BUDGETS.get(target.name, {}).keys()
    assert {name: pair for name, pair in measured.items() if pair[0] > pair[1]} == {}
    for found in levels.values():
        check_bounds(target, found)
        check_growth(target, found)
        check_stacks(target, found)
    readme = report.README.read_text(encoding="utf-8")
    if target.version() not in readme:
        pytest.skip(f"the pages are of other compilers than {target.version()}: run make cost")
    if target.name == "Cortex-M4":
        assert f"at most {fast.bound[UPDATED]} instructions for a step" in readme
    columns = {
        (report.README, "cost table"): {target.name: report.short_column(small, fast)},
        (report.PAGE, "memory"): {target.name: report.memory_column(small, fast)},
    }
    for (path, section), fresh in columns.items():
        check_page(report.read(path, section), target.name, report.numbers(report.table("", fresh)))
    for level in LEVELS:
        fresh = {target.name: report.call_column(levels[level])}
        published = report.read(report.PAGE, "calls")
        for (title, _), numbers in report.numbers(report.table("", fresh)).items():
            assert published[f"{target.name} {level}", title] == pytest.approx(numbers, rel=TOLERANCE), title


def check_page(published: Numbers, column: str, fresh: Numbers) -> None:
    of_target = {cell: numbers for cell, numbers in published.items() if cell[1] == column}
    assert of_target.keys() == fresh.keys()
    for cell, numbers in fresh.items():
        assert of_target[cell] == pytest.approx(numbers, rel=TOLERANCE), f"{cell}: run make cost"


def check_bounds(target: Target, found: Figures) -> None:
    """No call is longer than its longest path, and no longest path is far above what was seen. Only an AVR
    has loops; a Cortex-M0+ divides by a table, an AVR bit by bit, the others with an instruction."""
    if target == AVR:
        assert found.bound == {}
        return
    for name, bound in found.bound.items():
        if name != "settle":  # whose costly kinds are those of steps
            assert found.most[name] <= bound <= 1.1 * found.most[name], name
    assert found.divisions == (0 if target.name == "Cortex-M0+" else 14)


def check_growth(target: Target, found: Figures) -> None:
    """The most of large t and m is that of small ones. An AVR shifts 1 by the sender's id in a loop."""
    steps, rounds = list(found.by_age.values()), list(found.by_messages.values())
    half = len(steps) // 2
    assert max(steps[half:]) <= 1.06 * max(steps[:half])
    receive, settle = zip(*rounds, strict=True)
    assert max(receive) <= (1.25 if target == AVR else 1.0) * max(receive[:4])
    assert max(settle) == min(settle)


def check_stacks(target: Target, found: Figures) -> None:
    for name in TICK_CALLS:
        bound, touched = found.stack[name]
        if name != "settle":  # which is seen without a filter only
            assert touched <= bound <= touched + 2 * ALIGNMENT[target.tools] + 8, name


def test_a_kilobot_holds_its_firmware(tmp_path: Path) -> None:
    usable(AVR)
    flash, ram = kilobot(tmp_path / "image")
    assert flash <= report.FLASH / 2 and ram <= report.RAM / 2
    text = report.README.read_text(encoding="utf-8").replace("\n", " ")
    if AVR.version() in text:
        assert f"{flash / report.FLASH:.0%} of its flash and {ram / report.RAM:.0%} of its RAM" in text


# ---- What measures ----


@pytest.mark.parametrize("target", [AVR, *TARGETS[1:5:3]], ids=lambda target: target.name)
def test_an_image_computes_the_firmware_s_bits(target: Target, tmp_path: Path) -> None:
    robot = Robot(load(firmware_image(usable(target), "-Os", tmp_path / "image")))
    mirror = MirrorRobot(Config(table=generate(parse_omega("0.05"), q=30), filter_period=20), OWN_ID, 0.75)
    robot.start(3 << 30, 20)
    for tick in range(45):
        for sender in (6, 7, 9):
            message = sender, (tick * 7919 + sender * 104729) % (1 << 23), 0x80000000 + sender
            robot.receive(message)
            mirror.receive_raw(*message)
        robot.step(tick % 2, tick % 20 == 19, 3)
        mirror.step(Observation(tick % 2))
        assert robot.call("x").value == mirror.x_raw
    assert robot.machine.call("bench_updates").value == mirror.counters.updates > 0


_TYPE = ".type known, %function\\n"


def program(target: Target, folder: Path, *functions: str) -> Image:
    """An image with functions in C, of which known() stays in it."""
    source = folder / "program.c"
    source.write_text("\n".join((*functions, "int main(void) { return 0; }")) + "\n", encoding="utf-8")
    return build(target, folder / "build", [source], "-O1", "-Wl,-u,known")


def written(target: Target, folder: Path, *lines: str) -> Machine:
    """A machine whose known() is these lines of assembly."""
    text = "\\n".join(lines)
    return load(program(target, folder, f'__asm__(".globl known\\n{_TYPE}known:\\n{text}\\n");'))


def test_cycles_of_an_avr_are_those_of_its_manual(tmp_path: Path) -> None:
    loop = ("ldi r24, 10", "1: dec r24", "brne 1b", "mul r24, r24", "clr r1", "push r24", "pop r24", "ret")
    cost = written(usable(AVR), tmp_path, *loop).call("known")
    assert cost.cycles == 1 + 10 + (9 * 2 + 1) + 2 + 1 + 2 + 2 + 4
    assert (cost.instructions, cost.stack) == (1 + 10 + 10 + 5, 2 + 1)


def test_instructions_that_run_are_counted(tmp_path: Path) -> None:
    """With those that a condition before them skips left out."""
    lines = [".syntax unified", ".thumb_func", "push {r4, lr}", "movs r0, #10", "1: subs r0, #1", "bne 1b"]
    lines += ("cmp r0, #1", "it eq", "moveq r1, #2", "it ne", "movne r1, #3", "pop {r4, pc}")
    cost = written(named("Cortex-M4"), tmp_path, *lines).call("known")
    assert (cost.instructions, cost.stack) == (2 + 10 + 10 + 1 + 1 + 2 + 1, 8)


NOT_INLINE = "__attribute__((noinline))"
NO_BOUNDS = {
    "calls itself|there is a loop": (
        "int known(int x);",
        f"{NOT_INLINE} static int other(int x) {{ volatile int y = x; return known(x - 1) * y; }}",
        "int known(int x) { volatile int y = x; return x < 2 ? 1 : other(x - 1) + y; }",
    ),
    "what a pointer leads to": ("int known(int (*f)(int)) { return f(1) + f(2); }",),
    "there is a loop": ("int known(int x) { volatile int y = 0; while (x-- > 0) y += x; return y; }",),
}


@pytest.mark.parametrize("reason", NO_BOUNDS)
@every_target
def test_what_has_no_bound_is_refused(target: Target, reason: str, tmp_path: Path) -> None:
    paths = Paths(program(usable(target), tmp_path, *NO_BOUNDS[reason]))
    with pytest.raises(ValueError, match=reason):
        paths.longest("known")
    if reason != "there is a loop":
        with pytest.raises(ValueError, match=reason):
            paths.deepest("known")


def test_the_longest_path_is_that_of_the_data_that_take_it(tmp_path: Path) -> None:
    other = f"{NOT_INLINE} static int other(int y) {{ return y * 7; }}"
    code = (
        "int known(unsigned x) { volatile int y = 0; if (x & 1) y *= 5; if (x & 2) y = other(y); return y; }"
    )
    image = program(named("RV32IMC"), tmp_path, other, code)
    machine, paths = load(image), Paths(image)
    costs = [machine.call("known", ("word", x)).instructions for x in range(4)]
    assert paths.longest("known") == max(costs) == costs[3] > costs[0]
    assert paths.longest("known", without="other") == costs[1]


@every_target
def test_bounds_of_the_stack_are_reached(target: Target, tmp_path: Path) -> None:
    leaf = "static int leaf(volatile int *p) { volatile int a[20]; a[0] = a[19] = *p; return a[0]; }"
    caller = "int known(int x) { volatile int b[8]; b[0] = b[7] = x; return leaf(b) + leaf(b + 7); }"
    image = program(usable(target), tmp_path, f"{NOT_INLINE} {leaf}", caller)
    bound, touched = Paths(image).deepest("known"), load(image).call("known", ("enum", 1)).stack
    integer = 2 if target == AVR else 4
    assert 28 * integer <= touched <= bound < touched + 2 * ALIGNMENT[target.tools] + integer
