"""Measuring the firmware and the baseline on a target: everything the tables and the picture say."""

from __future__ import annotations

import random
import re
from collections.abc import Iterable
from pathlib import Path
from typing import Any

from . import runs
from .flow import Flow, SeenFlow
from .images import FIRMWARE, HERE, ROOT, TARGETS, Image, Target, build
from .machines import Argument, Cost, Machine, load
from .robots import SHORT, TESTED, UPDATED, Robot
from .search import seek
from .stacks import Stacks
from .timing import TIMINGS
from .turns import Turns
from .ways import DIVISIONS, INSTRUCTIONS, TURNS, LongestWay, cycles

Figures = dict[str, Any]
"""Measurements as JSON holds them."""

BASELINES = {"double": "-DREAL=double", "float": "-DREAL=float"}
COMPARED = "-O2"
"""The level at which the firmware's calls are compared with the baselines'."""
TICK_CALLS = ("observe", "receive", "settle", "step", "x")
STEPS = ("step", SHORT, TESTED, UPDATED)
"""Kinds of a step; the first is that in which the filter is not due."""
STACK_CALLS = (*TICK_CALLS, "init", "save", "restore", "invariants_hold")
"""Functions of the firmware whose stack is measured."""
OTHER_CALLS = ("x_bar", *STACK_CALLS[len(TICK_CALLS) :], "encode", "decode")
"""Those that a tick does not always need."""
WEIGHTS = ("instructions", "cycles", "divisions", "turns")
"""Counted on the longest ways."""
_TABLES = {q: ROOT / "tables" / f"t_table_omega05_q{q}.c" for q in (30, 127)}
_KEPT = ("bench_start", "bench_set", "bench_updates", "bench_size")
USUAL_ALPHA = 0x80000012
_IS_OWN = re.compile(r"(main|config|bench_\w+|mcp_asdf_t_table_\w+)$")

SETTINGS = {
    "seed": 1,
    "samples of every age": 15,
    "climbs for every call": 10,
    "vain changes that end a climb": 80,
    "rounds of every size": 8,
}
"""Of the situations that the robots live through beside their lives; kept with the figures."""


def firmware_image(target: Target, level: str, folder: Path, q: int = 30) -> Image:
    """The firmware with a table of ``q`` entries, ready to be called. It knows which line of C made which
    instruction; that changes no instruction."""
    names = ("mcp_asdf.c", "mcp_asdf_image.c", "mcp_asdf_frame.c")
    sources = [HERE / "firmware.c", *(FIRMWARE / name for name in names), _TABLES[q]]
    kept = (*_KEPT, *map(_symbol, (*TICK_CALLS, *OTHER_CALLS)), "frame", "format", "estimate", "image")
    return build(target, folder, sources, level, f"-DQ={q}", "-gdwarf-4", *_keep(kept))


def _symbol(call: str) -> str:
    return f"mcp_asdf_{call}_estimate" if call in ("encode", "decode") else f"mcp_asdf_{call}"


def baseline_image(target: Target, level: str, folder: Path, kind: str) -> Image:
    """The same equations in floating point, ready to be called."""
    calls = [f"plain_{name}" for name in TICK_CALLS]
    flags = (level, BASELINES[kind], *_keep((*_KEPT, *calls)))
    return build(target, folder, [HERE / "plain.c", _TABLES[30]], *flags)


def _keep(names: Iterable[str]) -> list[str]:
    return [f"-Wl,-u,{name}" for name in names]


# ---- Flash ----


def flash(target: Target, level: str, folder: Path) -> Figures:
    """Bytes of flash that the firmware and the baselines add to a program, without main() and table."""
    core = [HERE / "firmware.c", FIRMWARE / "mcp_asdf.c", _TABLES[30]]
    whole = [*core, FIRMWARE / "mcp_asdf_image.c"]
    nothing = _code(build(target, folder / "nothing", [HERE / "empty.c"], level))
    sizes = {
        "least": _code(build(target, folder / "least", core, level)) - nothing,
        "whole": _code(build(target, folder / "whole", whole, level, "-DWHOLE")) - nothing,
    }
    for kind in kinds(target):
        plain = [HERE / "plain.c", _TABLES[30]]
        sizes[kind] = _code(build(target, folder / f"least {kind}", plain, level, BASELINES[kind])) - nothing
    return sizes


def _code(image: Image) -> int:
    own = (symbol for name, symbol in image.symbols.items() if _IS_OWN.match(name))
    return image.flash() - sum(int(symbol["st_size"]) for symbol in own)


def kinds(target: Target) -> list[str]:
    """The baselines there are: avr-gcc 5 has no double of 64 bits."""
    return ["float"] if target.tools.startswith("avr") else list(BASELINES)


def table_bytes(folder: Path) -> list[int]:
    """[a, b] where a table takes a + b q bytes."""
    sizes = {}
    for q, file in _TABLES.items():
        sources = [HERE / "firmware.c", FIRMWARE / "mcp_asdf.c", file]
        image = build(TARGETS[0], folder / str(q), sources, f"-DQ={q}")
        sizes[q] = int(image.symbols[f"mcp_asdf_t_table_omega05_q{q}"]["st_size"])
    entry = (sizes[127] - sizes[30]) // (127 - 30)
    return [sizes[30] - 30 * entry, entry]


# ---- Robots ----


def firmware(target: Target, level: str, folder: Path) -> Figures:
    """Calls, RAM and stack of the firmware."""
    image = firmware_image(target, level, folder)
    machine = load(image)
    robot = Robot(machine, "mcp_asdf")
    rng = random.Random(SETTINGS["seed"])
    robot.live()
    robot.suffer(SETTINGS["samples of every age"], rng)
    seek(robot, SETTINGS["climbs for every call"], SETTINGS["vain changes that end a climb"], rng)
    robot.fill_rounds(SETTINGS["rounds of every size"], rng)
    robot.lead_usual_life()  # whose invariants hold to the last
    painted = robot.deepest | _other_stacks(machine)
    stacks = Stacks(image)
    return {
        "calls": robot.spans() | _spans(_codec(machine)),
        "ram": machine.call("bench_size").value,
        "series": _series(robot, "cycles" if target.tools.startswith("avr") else "instructions"),
        "bounds": _bounds(image),
        "others": _others(firmware_image(target, level, folder / "others", q=127)),
        "longest seen": _longest_seen(image, robot),
        "stack": {name: [stacks.deepest(f"mcp_asdf_{name}"), painted[name]] for name in STACK_CALLS},
    }


def _bounds(image: Image) -> dict[str, dict[str, int]]:
    """The most of each weight that a way through each function has, whatever the data."""
    flow = Flow(image)
    turns = Turns(image, flow)
    counted = (INSTRUCTIONS, cycles(TIMINGS[image.target.name]), DIVISIONS, TURNS)
    ways = {name: LongestWay(flow, turns, each) for name, each in zip(WEIGHTS, counted, strict=True)}
    return {
        call: {name: way.of(_symbol(call)) for name, way in ways.items()}
        for call in (*TICK_CALLS, *OTHER_CALLS)
    }


def _others(image: Image) -> dict[str, list[int]]:
    """Most instructions and cycles of the calls that no tick needs, in situations of all kinds."""
    machine, rng = load(image), random.Random(SETTINGS["seed"])
    robot = Robot(machine, "mcp_asdf")
    own, room, config = (_address(machine, name) for name in ("robot", "image", "config"))
    most: dict[str, list[int]] = {call: [0, 0] for call in OTHER_CALLS}

    def note(call: str, *arguments: Argument) -> None:
        cost = machine.call(_symbol(call), *arguments)
        most[call] = [max(most[call][0], cost.instructions), max(most[call][1], cost.cycles)]

    for messages in (0, 1, 2, 10, 127):
        for _ in range(6):
            situation = runs.situation(rng, messages)
            robot.x_in(situation)
            for message in situation.messages:
                robot.receive(message)
            note("x_bar", own)
            note("save", own, room)
            note("invariants_hold", own)
            note("restore", own, config, room)
            note("init", own, config, ("byte", runs.OWN_ID), ("word", situation.b_hat))
    for word in (0, 0x100, 0x80000012, 0xFFFFFF1F):
        for name, cost in _codec(machine, word).items():
            spent = [max(pair) for pair in zip(most[name], (cost.instructions, cost.cycles), strict=True)]
            most[name] = spent
    return most


def _longest_seen(image: Image, robot: Robot) -> dict[str, int | None]:
    """Instructions of the longest way through each kind of step, and x, along turns that one of them took.

    None where ways were not recorded.
    """
    longest: dict[str, int | None] = {}
    for name in (*STEPS, "x"):
        seen = robot.ways[name]
        symbol = _symbol("x" if name == "x" else "step")
        longest[name] = LongestWay(SeenFlow(image, seen)).of(symbol) if all(seen) else None
    return longest


def _series(robot: Robot, unit: str) -> Figures:
    """[t, least, most] of a step; [m, least, most] of a round's last message and of its end."""

    def spans(costs: dict[int, list[Cost]]) -> list[list[int]]:
        values = {at: [getattr(cost, unit) for cost in some] for at, some in costs.items()}
        return [[at, min(some), max(some)] for at, some in values.items()]

    received = {messages: [last for last, _ in costs] for messages, costs in robot.by_messages.items()}
    settled = {messages: [end for _, end in costs] for messages, costs in robot.by_messages.items()}
    return {"unit": unit, "step": spans(robot.by_age), "receive": spans(received), "settle": spans(settled)}


def _other_stacks(machine: Machine) -> dict[str, int]:
    """Stack of the functions that no tick calls."""
    robot, image, config = (_address(machine, name) for name in ("robot", "image", "config"))
    calls = {
        "save": (robot, image),
        "restore": (robot, config, image),
        "invariants_hold": (robot,),
        "init": (robot, config, ("byte", runs.OWN_ID), ("word", 0xF3333333)),
    }
    return {name: machine.call(f"mcp_asdf_{name}", *arguments).stack for name, arguments in calls.items()}


def _codec(machine: Machine, alpha: int = USUAL_ALPHA) -> dict[str, Cost]:
    """Costs of turning an estimate into a frame and back."""
    frame, estimate, form = (_address(machine, name) for name in ("frame", "estimate", "format"))
    last = estimate[1] + int(machine.image.symbols["estimate"]["st_size"]) - 4
    machine.write(last, alpha.to_bytes(4, "little"))
    return {
        "encode": machine.call(_symbol("encode"), frame, form, estimate),
        "decode": machine.call(_symbol("decode"), estimate, ("enum", 3000), frame),
    }


def _spans(costs: dict[str, Cost]) -> Figures:
    """Of calls that always cost the same."""
    return {
        name: {"instructions": [cost.instructions] * 3, "cycles": [cost.cycles] * 3}
        for name, cost in costs.items()
    }


def _address(machine: Machine, name: str) -> Argument:
    return "pointer", machine.image.address(name)


def baseline(target: Target, level: str, folder: Path, kind: str) -> Figures:
    """Calls and RAM of the baseline."""
    machine = load(baseline_image(target, level, folder, kind))
    robot = Robot(machine, "plain")
    robot.live()
    stack = max(robot.deepest.values())
    return {"calls": robot.spans(), "ram": machine.call("bench_size").value, "stack": stack}


def measure(target: Target, level: str, folder: Path) -> Figures:
    """All of a target at a level; the baselines' calls at one of them."""
    figures = {
        "flash": flash(target, level, folder),
        "firmware": firmware(target, level, folder / "firmware"),
    }
    if level != COMPARED:
        return figures
    return figures | {kind: baseline(target, level, folder / kind, kind) for kind in kinds(target)}
