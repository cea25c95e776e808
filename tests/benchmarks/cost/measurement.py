"""Figures of a target at a level, and the budgets that they keep to."""

from __future__ import annotations

import re
from dataclasses import dataclass, field
from pathlib import Path

from .images import AVR, FIRMWARE, HERE, TABLE, Image, Target, build, kilobot_image
from .machines import load
from .paths import Paths, division
from .robots import SHORT, TESTED, UPDATED, Robot

TICK_CALLS = ("observe", "receive", "settle", "step", "x")
STACK_CALLS = (*TICK_CALLS, "x_bar", "init", "save", "restore", "invariants_hold")
KINDS = ("step", SHORT, TESTED, UPDATED, "receive", "x")
BASELINES = ("double", "float")
SEED = 1
_OWN = re.compile(r"(main|config|bench_\w+|mcp_asdf_t_table_\w+)$")


@dataclass
class Figures:
    """Cost of a target at a level.

    Attributes:
        mean: Instructions of calls in a usual life.
        most: Most instructions that were seen, of calls and kinds of a step.
        cycles: Most cycles that were seen, on an AVR.
        by_age: The most units (cycles on an AVR) of a step at each power of two of t.
        by_messages: The same of a round's last message, and of its end.
        bound: The longest path of a call through the machine code, where there is no loop; "step" is one in
            which the filter is not due.
        divisions: Those on the longest path of a step.
        stack: Bytes by function: bound, and the most that was touched.
        code: Bytes of flash of init, observe, receive, settle and x, and of all functions.
        ram: Bytes of a robot.
        times: Instructions of a baseline's step and x in those of the firmware's, by its type.
    """

    mean: dict[str, float]
    most: dict[str, int]
    cycles: dict[str, int]
    by_age: dict[int, int]
    by_messages: dict[int, tuple[int, int]]
    stack: dict[str, tuple[int, int]]
    code: tuple[int, int]
    ram: int
    bound: dict[str, int] = field(default_factory=dict)
    divisions: int = 0
    times: dict[str, float] = field(default_factory=dict)

    def tick_stack(self) -> int:
        """Bytes of stack that a tick needs: the deepest of its calls."""
        return max(self.stack[name][0] for name in TICK_CALLS)


def _kept(*names: str) -> list[str]:
    return [f"-Wl,-u,{name}" for name in ("bench_start", "bench_set", "bench_updates", "bench_size", *names)]


def firmware_image(target: Target, level: str, folder: Path) -> Image:
    """The firmware, ready to be called."""
    sources = [HERE / "firmware.c", *sorted(FIRMWARE.glob("*.c")), TABLE]
    return build(target, folder, sources, level, *_kept(*(f"mcp_asdf_{name}" for name in STACK_CALLS)))


def measure(target: Target, level: str, folder: Path) -> Figures:
    """All of a target at a level."""
    image = firmware_image(target, level, folder / "firmware")
    robot, paths, is_avr = Robot(load(image)), Paths(image), target == AVR
    robot.live()
    mean = _means(robot)
    robot.suffer(SEED)
    unit = "cycles" if is_avr else "instructions"
    found = Figures(
        mean=mean,
        most={name: max(cost.instructions for cost in costs) for name, costs in robot.costs.items()},
        cycles={name: max(cost.cycles for cost in costs) for name, costs in robot.costs.items()},
        by_age={age: max(getattr(cost, unit) for cost in costs) for age, costs in robot.by_age.items()},
        by_messages={
            messages: (
                max(getattr(one, unit) for one, _ in pairs),
                max(getattr(end, unit) for _, end in pairs),
            )
            for messages, pairs in robot.by_messages.items()
        },
        stack={name: (paths.deepest(f"mcp_asdf_{name}"), robot.deepest[name]) for name in STACK_CALLS},
        code=(
            code_bytes(target, level, folder / "least"),
            code_bytes(target, level, folder / "whole", "-DWHOLE"),
        ),
        ram=robot.machine.call("bench_size").value,
    )
    if not is_avr:
        found.bound = {
            name: paths.longest(f"mcp_asdf_{name}") for name in ("observe", "receive", "settle", "x")
        }
        found.bound |= {
            "step": paths.longest("mcp_asdf_step", without="filter"),
            UPDATED: paths.longest("mcp_asdf_step"),
        }
        found.divisions = paths.longest("mcp_asdf_step", division)
    for kind in BASELINES if not is_avr else ("float",):  # avr-gcc 5 has no double of 64 bits
        found.times[kind] = baseline(target, level, folder / kind, kind) / (mean["step"] + mean["x"])
    return found


def _means(robot: Robot) -> dict[str, float]:
    return {
        name: sum(cost.instructions for cost in costs) / len(costs) for name, costs in robot.lived.items()
    }


def baseline(target: Target, level: str, folder: Path, kind: str) -> float:
    """Instructions of a baseline's step and x, in the mean of its life."""
    names = (f"plain_robot_{name}" for name in TICK_CALLS)
    robot = Robot(
        load(build(target, folder, [HERE / "plain.c", TABLE], level, f"-DREAL={kind}", *_kept(*names))),
        "plain_robot",
    )
    robot.live()
    mean = _means(robot)
    return mean["step"] + mean["x"]


def code_bytes(target: Target, level: str, folder: Path, *flags: str) -> int:
    """Bytes of flash that the firmware adds to a program, without main() and the table."""
    sources = [HERE / "firmware.c", FIRMWARE / "mcp_asdf.c", FIRMWARE / "mcp_asdf_image.c", TABLE]
    images = (
        build(target, folder / "with", sources, level, *flags),
        build(target, folder / "without", [HERE / "empty.c"], level),
    )
    own, nothing = (
        image.flash() - sum(int(each["st_size"]) for name, each in image.symbols.items() if _OWN.match(name))
        for image in images
    )
    return own - nothing


def kilobot(folder: Path) -> tuple[int, int]:
    """Bytes of flash and of RAM of a whole Kilobot: variables, main()'s stack and an interrupt's."""
    image = kilobot_image(folder)
    paths = Paths(image)
    handlers = [
        name
        for name, symbol in image.symbols.items()
        if re.fullmatch(r"__vector_\d+", name) and symbol["st_info"]["bind"] == "STB_GLOBAL"
    ]
    return image.flash(), image.ram() + paths.deepest("main") + max(map(paths.deepest, handlers))


BUDGETS: dict[str, dict[str, int]] = {
    "Cortex-M4": {
        **{"step": 130, "step at -Os": 150, "receive": 52, UPDATED: 375, "x": 80},
        **{"code": 1600, "RAM": 144, "stack": 96},
    },
    "Cortex-M0+": {
        "step": 390,
        "receive": 165,
        UPDATED: 1130,
        "x": 270,
        "code": 2300,
        "RAM": 144,
        "stack": 160,
    },
    "RV32IMC": {"step": 205, "receive": 74, UPDATED: 560, "x": 122, "code": 2250, "RAM": 144, "stack": 112},
    AVR.name: {"step": 2945, "receive": 1064, UPDATED: 10673, "x": 2367, "code": 9406, "stack": 180},
}
"""Limits of the design: most instructions at -O2, bytes of code at -Os, of RAM and of a tick's
stack; on an AVR a tenth above the first core."""


def within(target: str, level: str, found: Figures) -> dict[str, tuple[int, int]]:
    """By budget that concerns this level: what was measured, and the limit."""
    figures = {"code": found.code[0]} if level == "-Os" else {}
    figures |= {f"{name}{'' if level == '-O2' else ' at -Os'}": most for name, most in found.most.items()}
    if level == "-O2":
        figures |= {"RAM": found.ram, "stack": found.tick_stack()}
    limits = BUDGETS.get(target, {})
    return {name: (figures[name], limit) for name, limit in limits.items() if name in figures}
