"""The pages say of the cost what is measured, and nothing grows."""

from __future__ import annotations

from pathlib import Path

import pytest

from support import require, slow

pytest.importorskip("unicorn", reason="the emulator that counts instructions is not installed: make setup")

from benchmarks.cost import report
from benchmarks.cost.images import AVR, LEVELS, TARGETS, Image, Target, build
from benchmarks.cost.machines import load
from benchmarks.cost.measurement import TICK_CALLS, Figures, kilobot, measure, robot_image
from benchmarks.cost.paths import Paths
from benchmarks.cost.report import Numbers
from benchmarks.cost.robots import OWN_ID, UPDATED, Robot
from mcp_asdf import Config, MirrorRobot, Observation
from mcp_asdf_tools.tables.thresholds import generate, parse_omega

TOLERANCE = 0.02
each_disassembler = pytest.mark.parametrize("target", TARGETS[::2], ids=lambda target: target.name)
ALIGNMENT = {"avr-": 1, "arm-none-eabi-": 8, "riscv64-unknown-elf-": 16}
"""Bytes to which the stack pointer is aligned."""


def usable(target: Target) -> Target:
    """The target; skips where something is missing."""
    require(target.compiler, target.package)
    if target == AVR and not Path("/usr/include/simavr/sim_avr.h").exists():
        pytest.skip("simavr's headers are not installed: apt-get install libsimavr-dev")
    return target


# ---- The figures ----


@pytest.mark.parametrize(
    "target", [TARGETS[0], TARGETS[3], *slow(TARGETS[1:3] + TARGETS[4:])], ids=lambda target: target.name
)
def test_nothing_grows_and_the_cost_is_as_published(target: Target, tmp_path: Path) -> None:
    """All at once, as measuring is what takes the time: a target at both levels."""
    small, fast = (measure(usable(target), level, tmp_path / level) for level in LEVELS)
    for found in (small, fast):
        check_growth(target, found)
        check_stacks(target, found)
    readme = report.README.read_text(encoding="utf-8")
    if target.version() not in readme:
        pytest.skip(f"the pages are of other compilers than {target.version()}: run make cost")
    if target.name == "Cortex-M4":
        assert f"at most {fast.bound[UPDATED]} instructions for a step" in readme
    columns = {
        (report.README, "cost table"): report.short_column(small, fast),
        (report.PAGE, "memory"): report.memory_column(small, fast),
    }
    for (path, section), column in columns.items():
        check_page(report.read(path, section), report.table("", {target.name: column}))
    rows = {
        f"{target.name} {level}": report.call_column(each)
        for level, each in zip(LEVELS, (small, fast), strict=True)
    }
    check_page(report.read(report.PAGE, "calls"), report.table("", rows, transposed=True))


def check_page(published: Numbers, fresh: str) -> None:
    for cell, numbers in report.numbers(fresh).items():
        assert published[cell] == pytest.approx(numbers, rel=TOLERANCE), f"{cell}: run make cost"


def check_growth(target: Target, found: Figures) -> None:
    """No call is longer than its longest path, and no longest path is far above what was seen: code without
    loops does not grow. An AVR has loops: its most at large t and m is that at small ones, but that it shifts
    1 by the sender's id in one. A Cortex-M0+ divides by a table, an AVR bit by bit, the others with an
    instruction."""
    if target == AVR:
        assert found.bound == {}
        half = len(found.by_age) // 2
        assert max(found.by_age[half:]) <= 1.06 * max(found.by_age[:half])
        receive, settle = zip(*found.by_messages, strict=True)
        assert max(receive) <= 1.25 * max(receive[:4])
        assert max(settle) == min(settle)
        return
    for name, bound in found.bound.items():
        if name != "settle":  # whose costly kinds are those of steps
            assert found.most[name] <= bound <= 1.1 * found.most[name], name
    assert found.divisions == (0 if target.name == "Cortex-M0+" else 14)


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


@each_disassembler
def test_an_image_computes_the_firmware_s_bits(target: Target, tmp_path: Path) -> None:
    robot = Robot(load(robot_image(usable(target), "-Os", tmp_path / "image")))
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
def test_instructions_and_cycles_are_those_of_the_manual(name: str, tmp_path: Path) -> None:
    lines, expected = KNOWN[name]
    target = usable(next(target for target in TARGETS if target.name == name))
    text = "\\n".join((".globl known", ".type known, %function", "known:", *lines))
    assert load(program(target, tmp_path, f'__asm__("{text}\\n");')).call("known")[1:] == expected


NOINLINE = "__attribute__((noinline)) static int"
NO_BOUNDS = {
    "calls itself|there is a loop": (
        f"int known(int x); {NOINLINE} other(int x) {{ volatile int y = x; return known(x - 1) * y; }}"
        "int known(int x) { volatile int y = x; return x < 2 ? 1 : other(x - 1) + y; }"
    ),
    "what a pointer leads to": "int known(int (*f)(int)) { return f(1) + f(2); }",
    "there is a loop": "int known(int x) { volatile int y = 0; while (x-- > 0) y += x; return y; }",
}


@pytest.mark.parametrize("reason", NO_BOUNDS)
@each_disassembler
def test_what_has_no_bound_is_refused(target: Target, reason: str, tmp_path: Path) -> None:
    paths = Paths(program(usable(target), tmp_path, NO_BOUNDS[reason]))
    for bound in (paths.longest, paths.deepest) if reason != "there is a loop" else (paths.longest,):
        with pytest.raises(ValueError, match=reason):
            bound("known")


def test_the_longest_path_is_that_of_the_data_that_take_it(tmp_path: Path) -> None:
    code = (
        f"{NOINLINE} other(int y) {{ return y * 7; }}"
        "int known(unsigned x) { volatile int y = 0; if (x & 1) y *= 5; if (x & 2) y = other(y); return y; }"
    )
    image = program(usable(TARGETS[-1]), tmp_path, code)
    machine, paths = load(image), Paths(image)
    costs = [machine.call("known", ("word", x)).instructions for x in range(4)]
    assert paths.longest("known") == max(costs) == costs[3] > costs[0]
    assert paths.longest("known", without="other") == costs[1]
