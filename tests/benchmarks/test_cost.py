"""The kept figures of the cost tables are what the compilers they name give, budgets hold, nothing grows.

What measures is tested, too: emulated images compute the firmware's bits, counts are those of hand-written
code, and bounds of the stack are what runs reach.
"""

from __future__ import annotations

import copy
import functools
import os
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from support import ROOT, require

pytest.importorskip("unicorn", reason="the emulator that counts instructions is not installed: make setup")
from unicorn import UC_HOOK_CODE

from benchmarks.cost import figures, measurement, picture, report, runs, turns
from benchmarks.cost.budgets import (
    AVR,
    AVR_CYCLES_BEFORE,
    AVR_FLASH_BEFORE,
    BUDGETS,
    Budget,
    dearer_on_avr,
    grows,
    measured,
    most,
)
from benchmarks.cost.demo import measure_demo
from benchmarks.cost.flow import Flow
from benchmarks.cost.images import LEVELS, TARGETS, Image, Target, build
from benchmarks.cost.machines import Machine, UnicornMachine, load
from benchmarks.cost.robots import UNITS, Robot
from benchmarks.cost.stacks import Stacks
from benchmarks.cost.timing import TIMINGS
from benchmarks.cost.ways import TURNS, Bound, LongestWay, cycles
from mcp_asdf import Config, MirrorRobot, Observation
from mcp_asdf_tools.tables.thresholds import generate, parse_omega

KEPT = figures.kept()
TOLERANCE = 0.02
CLOSE = 1.06
"""The longest way along turns that calls were seen to take, in the dearest call that was seen, at most."""
ALIGNMENT = {"avr-": 1, "arm-none-eabi-": 8, "riscv64-unknown-elf-": 16}
"""Of the stack pointer, bytes."""
UNUSED = {"avr-": 8, "arm-none-eabi-": 4, "riscv64-unknown-elf-": 28}
"""Most bytes of the deepest frames that stay as they were: they align it, are for arguments of another call
than the deepest one, or for a variable that then found a register.
"""

every_target = pytest.mark.parametrize("target", TARGETS, ids=lambda target: target.name)
every_level = pytest.mark.parametrize("level", LEVELS)


def usable(target: Target) -> Target:
    """The target; skips where something is missing."""
    require(target.compiler, target.package)
    if target.tools == "avr-" and not Path("/usr/include/simavr/sim_avr.h").exists():
        pytest.skip("simavr's headers are not installed: apt-get install libsimavr-dev")
    return target


def named(name: str) -> Target:
    return usable(next(target for target in TARGETS if target.name == name))


# ---- The kept figures ----


def untrue(kept: measurement.Figures, fresh: measurement.Figures) -> list[str]:
    """Where kept figures are not those that were measured; ``fresh`` has all or some of the targets."""
    only = {name: kept["targets"][name] for name in fresh["targets"]}
    return list(figures.differences({**kept, "targets": only}, {**kept, **fresh}, TOLERANCE))


QUICK = {("ATmega328P", "-Os")}
"""Measured in every run of the tests."""


some_cells = pytest.mark.parametrize(
    ("target", "level"),
    [
        pytest.param(
            *(target, level),
            id=f"{target.name}-{level}",
            marks=() if (target.name, level) in QUICK else pytest.mark.slow,
        )
        for target in TARGETS
        for level in LEVELS
    ],
)


@pytest.mark.slow
@some_cells
def test_the_kept_figures_are_what_is_measured(target: Target, level: str, tmp_path: Path) -> None:
    usable(target)
    kept_with = KEPT["compilers"][target.name]
    if target.version() != kept_with:
        pytest.skip(f"the figures of {target.name} are those of {kept_with}, not {target.version()}")
    levels = {**KEPT["targets"][target.name], level: measurement.measure(target, level, tmp_path)}
    fresh = {"settings": measurement.SETTINGS, "targets": {target.name: levels}}
    assert untrue(KEPT, fresh) == [], "run make cost"
    for budget in BUDGETS:
        if budget.target == target.name:
            assert measured(budget, {**KEPT, **fresh}) <= budget.limit, budget


def test_the_table_and_the_whole_firmware_are_what_is_measured(tmp_path: Path) -> None:
    target = named("ATmega328P")
    if target.version() != KEPT["compilers"][target.name]:
        pytest.skip(f"the figures are those of another compiler than {target.version()}")
    fresh = {
        "table": measurement.table_bytes(tmp_path / "table"),
        "demo": measure_demo(tmp_path / "demo"),
    }
    assert untrue(KEPT, {**fresh, "targets": {}}) == [], "run make cost"


def test_the_whole_firmware_fits_a_kilobot() -> None:
    demo = KEPT["demo"]
    assert demo["flash"] <= 32 * 1024
    assert demo["variables"] + demo["stack"] <= 2 * 1024


@pytest.mark.parametrize("budget", BUDGETS, ids=lambda budget: f"{budget.target} {budget.what}")
def test_the_kept_figures_are_within_budget(budget: Budget) -> None:
    assert measured(budget, KEPT) <= budget.limit


@pytest.mark.parametrize("path", report.pages(KEPT), ids=lambda path: path.name)
def test_the_pages_say_what_was_kept(path: Path) -> None:
    text = path.read_text(encoding="utf-8")
    assert report.fill(text, report.pages(KEPT)[path]) == text, "run make cost"


@every_level
@every_target
def test_nothing_grows(target: Target, level: str) -> None:
    series = KEPT["targets"][target.name][level]["firmware"]["series"]
    assert [at for at, _, _ in series["step"]] == list(runs.AGES)
    assert [at for at, _, _ in series["receive"]] == list(runs.ROUNDS)
    # Halving the memory comes on top at the last t; an AVR shifts 1 by the sender's id in a loop.
    assert not grows(series["step"], 0.06)
    assert not grows(series["receive"], 0.25 if target.tools == "avr-" else 0.0)
    assert not grows(series["settle"], 0.0)


@every_level
@every_target
def test_no_call_is_longer_than_its_bound(target: Target, level: str) -> None:
    core = KEPT["targets"][target.name][level]["firmware"]
    assert list(core["bounds"]) == [*measurement.TICK_CALLS, *measurement.OTHER_CALLS]
    for call, bound in core["bounds"].items():
        assert all(0 < report.most_seen(core, call, unit) <= bound[unit] for unit in UNITS), call
    assert report.largest_ratio(core, measurement.TICK_CALLS) <= (1.32 if target.name == AVR else 1.08)
    assert report.largest_ratio(core, measurement.OTHER_CALLS) < 2.8
    for name, longest in core["longest seen"].items():
        bound = core["bounds"]["x" if name == "x" else "step"]["instructions"]
        if target.name != AVR:
            assert most(core["calls"], name) <= longest <= CLOSE * most(core["calls"], name), name
            assert longest <= bound


@every_level
@every_target
def test_loops_and_divisions_are_where_the_target_needs_them(target: Target, level: str) -> None:
    """An AVR has no other way to divide; a Cortex-M0+ takes a table; the others have an instruction."""
    bounds = KEPT["targets"][target.name][level]["firmware"]["bounds"]
    has_divider = target.name not in (AVR, "Cortex-M0+")
    for call in measurement.TICK_CALLS:
        assert (bounds[call]["turns"] > 0) == (target.name == AVR), call
        assert (bounds[call]["divisions"] > 0) == (has_divider and call != "receive"), call


def test_growth_is_seen() -> None:
    per_octave = [[2**k, 100, 140 + k] for k in range(33)]
    assert grows(per_octave, 0.06)
    assert grows([[m, 40, 40 + m // 8] for m in runs.ROUNDS], 0.0)
    assert not grows([[m, 40, 60] for m in runs.ROUNDS], 0.0)


@every_level
@every_target
def test_painted_stacks_reach_the_bounds(target: Target, level: str) -> None:
    stacks = KEPT["targets"][target.name][level]["firmware"]["stack"]
    unused = {name: bound - painted for name, (bound, painted) in stacks.items()}
    assert all(0 <= rest <= UNUSED[target.tools] for rest in unused.values()), unused


Place = tuple[Any, ...]


def places(part: object, at: Place = ()) -> Iterator[Place]:
    """Where the numbers are."""
    if isinstance(part, dict | list):
        for key, below in part.items() if isinstance(part, dict) else enumerate(part):
            yield from places(below, (*at, key))
    elif isinstance(part, int | float):
        yield at


@contextmanager
def off_by(part: measurement.Figures, place: Place, factor: float) -> Iterator[None]:
    """Multiply one number for a while."""
    *way, last = place
    numbers = functools.reduce(lambda inner, key: inner[key], way, part)
    right = numbers[last]
    numbers[last] *= factor
    yield
    numbers[last] = right


@some_cells
def test_every_figure_that_is_off_is_told(target: Target, level: str) -> None:
    fresh = {**KEPT, "targets": {target.name: KEPT["targets"][target.name]}}
    kept = copy.deepcopy(fresh)
    of_level = [place for place in places(kept) if place[0] != "targets" or place[2] == level]
    assert len(of_level) > 250
    for place in of_level:
        for factor in (0.97, 1.03):
            with off_by(kept, place, factor):
                told = [one.split(": ")[0] for one in untrue(kept, fresh)]
            assert told in ([", ".join(map(str, place))], [] if is_zero(kept, place) else None), place


def is_zero(part: measurement.Figures, place: Place) -> bool:
    number: Any = functools.reduce(lambda inner, key: inner[key], place, part)
    return bool(number == 0)  # no factor changes it


def test_a_figure_within_the_tolerance_is_not_told() -> None:
    place = ("targets", "Cortex-M4", "-O2", "firmware", "calls", "receive", "instructions", 2)
    kept = copy.deepcopy(KEPT)
    with off_by(kept, place, 1.019):
        assert untrue(kept, KEPT) == []
    with off_by(kept, place, 1.021):
        assert len(untrue(kept, KEPT)) == 1


def test_figures_that_are_missing_are_told() -> None:
    fresh = copy.deepcopy(KEPT)
    del fresh["targets"]["Cortex-M4"]["-Os"]["firmware"]["calls"]["receive"]
    assert untrue(KEPT, fresh) != []
    assert untrue(fresh, KEPT) != []


def test_on_an_avr_floats_are_cheaper_but_for_the_step() -> None:
    both = KEPT["targets"][AVR]["-O2"]
    own, plain = (
        {name: call["cycles"][1] for name, call in both[kind]["calls"].items()}
        for kind in ("firmware", "float")
    )
    assert plain["receive"] < own["receive"]
    assert plain["x"] < own["x"]
    assert own[report.USUAL] < plain[report.USUAL]
    assert plain[report.USUAL] + plain["x"] < own[report.USUAL] + own["x"]


def test_an_avr_is_not_the_worse_for_the_smaller_core() -> None:
    assert dearer_on_avr(KEPT) == []
    for level, before in AVR_FLASH_BEFORE.items():
        flash = KEPT["targets"][AVR][level]["flash"]
        assert all(flash[kind] < size for kind, size in before.items()), flash


@every_level
def test_a_dearer_call_is_seen(level: str) -> None:
    worse = copy.deepcopy(KEPT)
    calls = worse["targets"][AVR][level]["firmware"]["calls"]
    for name, before in AVR_CYCLES_BEFORE[level].items():
        calls[name]["cycles"] = before
    calls["x"]["cycles"] = [1.11 * cycles for cycles in AVR_CYCLES_BEFORE[level]["x"]]
    assert [found.split(":")[0] for found in dearer_on_avr(worse)] == [f"x at {level}"]


def test_a_page_without_markers_is_refused() -> None:
    assert report.fill("a <!-- x -->old<!-- end of x --> b", {"x": "new"}) == (
        "a <!-- x -->\nnew\n<!-- end of x --> b"
    )
    with pytest.raises(ValueError, match="end of y"):
        report.fill("<!-- x --><!-- end of x -->", {"y": "new"})


# ---- What measures ----


@pytest.mark.slow
@every_target
def test_an_image_computes_the_firmware_s_bits(target: Target, tmp_path: Path) -> None:
    machine = load(measurement.firmware_image(usable(target), "-Os", tmp_path / "image"))
    life = next(life for life in runs.lives() if life.neighbours == 10)
    config = Config(table=generate(parse_omega("0.05"), q=30), filter_period=life.period)
    robot, mirror = Robot(machine, "mcp_asdf"), MirrorRobot(config, runs.OWN_ID, life.b_hat / 2**32)
    robot.start(life.b_hat, life.period)
    for tick in life.ticks[:45]:  # two tests
        for message in tick.messages:
            robot.receive(message)
            mirror.receive_raw(*message)
        robot.step(tick.observation)
        mirror.step(Observation(tick.observation))
        assert robot.call("x").value == mirror.x_raw
    assert mirror.counters.tests == 2
    assert machine.call("bench_updates").value == mirror.counters.updates


@pytest.mark.parametrize("target", ["Cortex-M0+", "Cortex-M4", "RV32IMC"])
def test_counting_blocks_is_counting_instructions(target: str, tmp_path: Path) -> None:
    machine = load(measurement.firmware_image(named(target), "-O2", tmp_path / "image"))
    assert isinstance(machine, UnicornMachine)
    addresses: list[int] = []
    machine._uc.hook_add(UC_HOOK_CODE, lambda _, address, size, __: addresses.append(address))
    robot = Robot(machine, "mcp_asdf")
    robot.start(0xF3333333, 1, 1000, 600)
    for message in ((6, 5_000_000, 0x48000000), (7, 4_000_000, 0x48000000)):
        robot.receive(message)
    addresses.clear()
    assert robot.step(1).instructions == len(addresses) > 100


def program(target: Target, folder: Path, *functions: str, flags: tuple[str, ...] = ("-O1",)) -> Image:
    """An image with functions in C, of which known() stays in it."""
    folder.mkdir(exist_ok=True)
    source = folder / "program.c"
    source.write_text("\n".join((*functions, "int main(void) { return 0; }")) + "\n", encoding="utf-8")
    return build(target, folder / "build", [source], *flags, "-Wl,-u,known")


def written(target: Target, folder: Path, *lines: str) -> Machine:
    """A machine whose known() is these lines of assembly."""
    text = "\\n".join(line.split(";")[0] for line in lines)
    return load(program(target, folder, f'__asm__(".globl known\\n{_TYPE}known:\\n{text}\\n");'))


_TYPE = ".type known, %function\\n"


def test_cycles_of_an_avr_are_those_of_its_manual(tmp_path: Path) -> None:
    cost = written(
        named("ATmega328P"),
        tmp_path,
        "ldi r24, 10; 1",
        "1: dec r24; 1",
        "brne 1b; 2 if taken, else 1",
        "mul r24, r24; 2",
        "clr r1; 1",
        "lds r24, 0x100; 2",
        "push r24; 2",
        "pop r24; 2",
        "ret; 4",
    ).call("known")
    assert cost.cycles == 1 + 10 + (9 * 2 + 1) + 2 + 1 + 2 + 2 + 2 + 4
    assert cost.instructions == 1 + 10 + 10 + 6
    assert cost.stack == 2 + 1


def test_cycles_of_a_cortex_m0plus_are_those_of_its_manual(tmp_path: Path) -> None:
    cost = written(
        named("Cortex-M0+"),
        tmp_path,
        ".syntax unified",
        ".thumb_func",
        "push {r4, lr}; 1 + 2",
        "movs r0, #10; 1",
        "1: subs r0, #1; 1",
        "bne 1b; 2 if taken, else 1",
        "ldr r0, [sp]; 2",
        "muls r0, r0; 1",
        "nop; 1",
        "pop {r4, pc}; 3 + 2",
    ).call("known")
    assert cost.cycles == 3 + 1 + 10 + (9 * 2 + 1) + 2 + 1 + 1 + 5
    assert cost.instructions == 1 + 1 + 10 + 10 + 4
    assert cost.stack == 8


@pytest.mark.parametrize(
    ("target", "name", "operands", "cycles"),
    [
        ("ATmega328P", "brne", ".-12", 1),
        ("ATmega328P", "ldi", "r24, 1", 1),
        ("ATmega328P", "ldd", "r24, Z+2", 2),
        ("ATmega328P", "lpm", "r24, Z+", 3),
        ("ATmega328P", "rcall", ".+8", 3),
        ("ATmega328P", "call", "0x10 <x>", 4),
        ("ATmega328P", "mul", "r1, r2", 2),
        ("Cortex-M0+", "bl", "10234 <x>", 3),
        ("Cortex-M0+", "b.n", "10234 <x>", 2),
        ("Cortex-M0+", "blt.n", "10234 <x>", 1),
        ("Cortex-M0+", "bls.n", "10234 <x>", 1),
        ("Cortex-M0+", "bx", "lr", 2),
        ("Cortex-M0+", "bics", "r0, r1", 1),
        ("Cortex-M3", "umull", "r0, r1, r2, r3", 5),
        ("Cortex-M4", "umull", "r0, r1, r2, r3", 1),
        ("Cortex-M4", "udiv", "r0, r1, r2", 12),
        ("Cortex-M4", "ldmia.w", "sp!, {r4, r5, pc}", 1 + 3 + 3),
        ("Cortex-M4", "ldr.w", "pc, [sp], #4", 2 + 3),
        ("Cortex-M4", "ldrd", "r0, r1, [r2]", 3),
        ("Cortex-M4", "bfi", "r0, r1, #0, #4", 1),
        ("RV32IMC", "mulhu", "a0,a1,a2", 2),
        ("RV32IMC", "bltu", "a0,a1,10234 <x>", 1),
        ("RV32IMC", "ret", "", 2),
        ("RV32IMC", "lw", "a0,0(a1)", 2),
        ("RV32IMC", "srl", "a0,a1,a2", 1),
    ],
)
def test_estimates_are_those_of_the_manuals(target: str, name: str, operands: str, cycles: int) -> None:
    assert TIMINGS[target].cycles(name, operands) == cycles


NOT_INLINE = "__attribute__((noinline))"


# Bytes that look like paint would go unseen: both arrays are written where the stack is deepest.
LEAF = "static int leaf(volatile int *p) { volatile int a[20]; a[0] = a[19] = *p; return a[0]; }"
CALLER = "int known(int x) { volatile int b[8]; b[0] = b[7] = x; return leaf(b) + leaf(b + 7); }"
NO_BOUNDS = {
    "calls itself": (
        "int known(int x);",
        f"{NOT_INLINE} static int other(int x) {{ volatile int y = x; return known(x - 1) * y; }}",
        "int known(int x) { volatile int y = x; return x < 2 ? 1 : other(x - 1) + y; }",
    ),
    "what a pointer leads to": ("int known(int (*f)(int)) { return f(1) + f(2); }",),
    "has no bound": ("void known(int n) { volatile char c[n]; c[0] = c[n - 1] = 1; }",),
}


@every_target
def test_bounds_of_the_stack_are_reached(target: Target, tmp_path: Path) -> None:
    image = program(usable(target), tmp_path, f"{NOT_INLINE} {LEAF}", CALLER)
    bound, painted = Stacks(image).deepest("known"), load(image).call("known", ("enum", 1)).stack
    integer = 2 if target.tools == "avr-" else 4
    assert 28 * integer <= painted <= bound < painted + 2 * ALIGNMENT[target.tools] + integer


@pytest.mark.parametrize("reason", NO_BOUNDS)
@every_target
def test_what_has_no_bound_is_refused(target: Target, reason: str, tmp_path: Path) -> None:
    with pytest.raises(ValueError, match=reason):
        Stacks(program(usable(target), tmp_path, *NO_BOUNDS[reason])).deepest("known")


def test_the_longest_way_is_that_of_the_data_that_take_it(tmp_path: Path) -> None:
    other = f"{NOT_INLINE} static int other(int y) {{ return y * 7; }}"
    code = (
        "int known(unsigned x) { volatile int y = 0; if (x & 1) y *= 5; if (x & 2) y = other(y); return y; }"
    )
    image = program(named("RV32IMC"), tmp_path, other, code)
    machine = load(image)
    costs = [machine.call("known", ("word", x)).instructions for x in range(4)]
    assert LongestWay(Flow(image)).of("known") == max(costs) == costs[3] > costs[0]


@every_target
def test_a_loop_is_found(target: Target, tmp_path: Path) -> None:
    code = "int known(int x) { volatile int y = 0; while (x-- > 0) y += x; return y; }"
    with pytest.raises(ValueError, match="loop in known"):
        LongestWay(Flow(program(usable(target), tmp_path, code))).of("known")


@every_target
def test_recursion_is_found(target: Target, tmp_path: Path) -> None:
    with pytest.raises(ValueError, match=r"loop in|calls itself"):
        LongestWay(Flow(program(usable(target), tmp_path, *NO_BOUNDS["calls itself"]))).of("known")


LOOPS = """
int known(unsigned x)
{
    volatile int y = 0;
    for (unsigned char i = 0; i < 5; ++i) {
        for (unsigned char j = 0; j < (x & 3); ++j) {
            y += 3;
        }
    }
    return y;
}
"""


@every_target
def test_loops_within_loops_count_as_often_as_they_run(target: Target, tmp_path: Path) -> None:
    """Both are left where they are entered or at their end: one after 5 turns, the inner after 3."""
    image = program(usable(target), tmp_path, LOOPS)
    most = load(image).call("known", ("enum", 3))
    sizes: list[int] = []

    def bound(outer: int, inner: int) -> Bound:
        """Of the times that a loop's entry runs: one more than it turns, if it is the test."""

        def of(loop: set[int], entries: set[int]) -> tuple[int, int]:
            sizes.append(len(loop))
            return min(entries), outer if len(loop) == max(sizes) else inner

        return of

    flow = Flow(image)
    assert most.instructions <= LongestWay(flow, bound(6, 4)).of("known") < 2 * most.instructions
    assert LongestWay(flow, bound(4, 2)).of("known") < most.instructions
    timing = cycles(TIMINGS[target.name])
    assert most.cycles <= LongestWay(flow, bound(6, 4), timing).of("known") < 2 * most.cycles


def test_turns_are_those_of_the_text(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Of a stated loop, shifts by a mask, a stated count and a constant; a loop without a bound has none."""
    functions = (
        "char robot[20]; unsigned long known(unsigned long x, unsigned char n) {",
        "for (unsigned char i = 0; i < n; ++i) { /* at most 6 turns */",
        "robot[i] = robot[i + 1] + robot[x]; }",
        "robot[1] = x >> (n & 7);",
        "robot[2] = x << n; /* a shift by at most 9 */",
        "return (x ^ robot[1]) << 13; }",
    )
    image = program(named(AVR), tmp_path, *functions, flags=("-gdwarf-4", "-Os"))
    text = (tmp_path / "program.c").read_text(encoding="utf-8")
    monkeypatch.setattr(turns, "_sources", lambda: {"program.c": text.splitlines()})
    flow = Flow(image)
    assert LongestWay(flow, turns.Turns(image, flow), TURNS).of("known") == 6 + 7 + 9 + (13 - 1)
    text = text.replace("shift by", "shift of")
    assert LongestWay(flow, turns.Turns(image, flow), TURNS).of("known") == 6 + 7 + 31 + (13 - 1)
    text = text.replace("at most 6", "many")
    with pytest.raises(ValueError, match="nothing bounds a loop in known"):
        LongestWay(flow, turns.Turns(image, flow), TURNS).of("known")


# ---- The command ----


def command(*arguments: str | Path, cwd: Path) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [sys.executable, "-m", "benchmarks.cost", *arguments],
        cwd=cwd,
        env={**os.environ, "PYTHONPATH": str(ROOT / "tests")},
        capture_output=True,
        text=True,
        check=False,
    )


def test_the_picture_is_drawn_from_what_was_kept(tmp_path: Path) -> None:
    done = command("--draw", "cost.png", cwd=tmp_path)
    assert (done.returncode, done.stderr) == (0, "")
    assert (tmp_path / "cost.png").read_bytes().startswith(b"\x89PNG")


def test_cycles_and_instructions_have_axes_of_their_own() -> None:
    kept = figures.kept()
    panels = picture.draw(kept).axes
    assert [axes.get_ylabel() for axes in panels[::2]] == ["cycles of a call", "instructions of a call"]
    for axes, names in zip(
        panels[::2], (["ATmega328P"], ["Cortex-M0+", "RV32IMC", "Cortex-M3", "Cortex-M4"]), strict=True
    ):
        most = [
            [most for _, _, most in kept["targets"][name]["-O2"]["firmware"]["series"]["step"]]
            for name in names
        ]
        assert [np.asarray(line.get_ydata()).tolist() for line in axes.lines] == most
    with pytest.raises(ValueError, match="was measured in words"):
        picture.draw(_in_other_units(kept))


def _in_other_units(kept: measurement.Figures) -> measurement.Figures:
    changed: measurement.Figures = copy.deepcopy(kept)
    changed["targets"]["Cortex-M3"]["-O2"]["firmware"]["series"]["unit"] = "words"
    return changed


def test_the_readme_has_the_bound_of_a_step() -> None:
    """The one of the machine code, not the most that a search has found."""
    bound = figures.kept()["targets"]["Cortex-M4"]["-O2"]["firmware"]["bounds"]["step"]["instructions"]
    assert f"at most {bound} instructions for a step" in (ROOT / "README.md").read_text(encoding="utf-8")


@pytest.mark.slow
def test_bad_usage_is_told(tmp_path: Path) -> None:
    done = command("--draw", "cost.txt", cwd=tmp_path)
    assert done.returncode == 2
    assert "choose a name that ends in" in done.stderr
    assert command("--draw", cwd=tmp_path).returncode == 2
