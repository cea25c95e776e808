"""Measurement of what the firmware costs on a target at a level of optimisation."""

from __future__ import annotations

import random
import re
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from statistics import fmean
from tempfile import TemporaryDirectory

from mcp_asdf import Filter

from .images import AVR, FIRMWARE, HERE, TABLE, Image, Target, build, kilobot_image
from .machines import load
from .paths import Paths, division
from .robots import PROBABILITY_OF_BLACK, UPDATED, ObservedCall, Robot

TICK_CALLS = ("observe", "receive", "settle", "step", "x")
STACK_CALLS = (*TICK_CALLS, "init", "save", "restore", "invariants_hold")
SEED = 1
_SYMBOL_OF_PROGRAM = re.compile(r"(main|config|bench_\w+|mcp_asdf_t_table_\w+)$")


@dataclass(frozen=True)
class Build:
    """A build's flags, its robot's filter, and random situations of robots of every age."""

    flags: tuple[str, ...] = ()
    filter: Filter = Filter.ROBUST
    samples: int = 10


PAPER = Build(("-DMCP_ASDF_WITH_ROBUST=0",), Filter.ADAPTIVE, samples=40)
"""The paper's filter alone: what all figures are that name no other build."""
ROBUST = Build(("-DMCP_ASDF_WITH_ASDF=0",))
"""The robust filter alone."""


@dataclass
class Figures:
    """Cost of a target at a level.

    Attributes:
        mean: Instructions of calls and kinds of a step in a usual life.
        observed_calls: Calls in that life and in all other situations.
        bound: The longest path of a call through the machine code, where there is no loop. In a "step"
            the filter is not due.
        divisions: Number of divisions on the longest path of a step.
        stack: Bytes by function.
        code: Bytes of flash of init, observe, receive, settle and x, and of all functions.
        ram: Bytes of a robot.
        times: Instructions of a baseline's step and x, divided by the firmware's. By the baseline's type.
    """

    mean: dict[str, float]
    observed_calls: list[ObservedCall]
    bound: dict[str, int]
    divisions: int
    stack: dict[str, int]
    code: tuple[int, int]
    ram: int
    times: dict[str, float]

    def largest(self, kind: str, unit: str = "instructions") -> int:
        """Return the largest cost of a call of this kind: "instructions", "cycles" (on an AVR) or "stack"."""
        return max(int(getattr(call.cost, unit)) for call in self.observed_calls if call.kind == kind)

    def tick_stack(self) -> int:
        """Return the bytes of stack that a tick needs: those of its deepest call."""
        return max(self.stack[name] for name in TICK_CALLS)


@dataclass
class Cost:
    """The costs of a target at a level. Two builds have a single filter. One has both, and runs either."""

    paper_alone: Figures
    robust_alone: Figures
    paper: Figures
    robust: Figures


def measure_builds(target: Target, level: str, folder: Path) -> Cost:
    """Measure all builds of a target at a level, in a new folder."""
    return Cost(
        paper_alone=measure(target, level, folder / "paper_alone", PAPER),
        robust_alone=measure(target, level, folder / "robust_alone", ROBUST),
        paper=measure(target, level, folder / "paper", Build(filter=Filter.ADAPTIVE)),
        robust=measure(target, level, folder / "robust", Build()),
    )


def robot_image(target: Target, level: str, folder: Path, firmware_build: Build) -> Image:
    """Build an image with the firmware, a robot, and functions that set its state and call it."""
    functions = [f"mcp_asdf_{name}" for name in STACK_CALLS]
    functions += [f"bench_{name}" for name in ("start", "set", "filtered", "votes", "batch", "estimates")]
    # Nothing in the image calls these functions, so the linker must be told to keep them.
    keep_functions = [f"-Wl,-u,{name}" for name in functions]
    sources = [HERE / "firmware.c", *FIRMWARE.glob("*.c"), TABLE]
    return build(target, folder, sources, level, *firmware_build.flags, *keep_functions)


def plain_cost(target: Target, level: str, folder: Path, kind: str) -> float:
    """Return the mean instructions of step and x of the baseline in this type of floating point."""
    keep_functions = [f"-Wl,-u,plain_{name}" for name in ("hear", "step", "x")]
    image = build(target, folder, [HERE / "plain.c"], level, f"-DREAL={kind}", *keep_functions)
    machine = load(image)
    rng = random.Random(10)
    instructions = []
    for _ in range(240):
        machine.call("plain_hear")
        observation = int(rng.random() < PROBABILITY_OF_BLACK)
        step, x = machine.call("plain_step", (observation, 2)), machine.call("plain_x")
        instructions.append(step.instructions + x.instructions)
    return fmean(instructions)


def measure(target: Target, level: str, folder: Path, firmware_build: Build = PAPER) -> Figures:
    """Return all costs of a target at a level; the baselines are compared with the paper's filter alone."""
    image = robot_image(target, level, folder / "firmware", firmware_build)
    robot, paths = Robot(load(image), firmware_build.filter), Paths(image)
    mean = robot.run_usual_life()
    robot.run_situations(SEED, firmware_build.samples)
    bound = {}
    if target != AVR:
        bound = {name: paths.longest(f"mcp_asdf_{name}") for name in ("receive", "x")}
        bound["step"] = paths.longest("mcp_asdf_step", without="update_b_hat")
        bound[UPDATED] = paths.longest("mcp_asdf_step")
    float_types: tuple[str, ...] = ("double", "float")
    if target == AVR:
        float_types = ("float",)  # avr-gcc 5 has no double of 64 bits
    flags = firmware_build.flags
    return Figures(
        mean=mean,
        observed_calls=robot.observed_calls,
        bound=bound,
        divisions=0 if target == AVR else paths.longest("mcp_asdf_step", division),
        stack={name: paths.deepest(f"mcp_asdf_{name}") for name in STACK_CALLS},
        code=(code_bytes(target, level, *flags), code_bytes(target, level, *flags, "-DWHOLE")),
        ram=int(image.symbols["robot"]["st_size"]),
        times={
            kind: plain_cost(target, level, folder / kind, kind) / (mean["step"] + mean["x"])
            for kind in (float_types if firmware_build == PAPER else ())
        },
    )


@cache
def code_bytes(target: Target, level: str, *flags: str) -> int:
    """Return the bytes of flash that the firmware adds to a program, without main() and the table."""
    sources = (HERE / "firmware.c", FIRMWARE / "mcp_asdf.c", FIRMWARE / "mcp_asdf_image.c", TABLE)
    return _bytes(target, level, sources, *flags) - _bytes(target, level, (HERE / "empty.c",))


@cache
def _bytes(target: Target, level: str, sources: tuple[Path, ...], *flags: str) -> int:
    with TemporaryDirectory() as folder:
        image = build(target, Path(folder) / "image", sources, level, *flags)
        bytes_of_flash, _bytes_of_ram = image.sizes()
        bytes_of_program = sum(
            int(symbol["st_size"]) for name, symbol in image.symbols.items() if _SYMBOL_OF_PROGRAM.match(name)
        )
        return bytes_of_flash - bytes_of_program


def kilobot(folder: Path, firmware_build: Build = PAPER) -> tuple[int, int]:
    """Return a Kilobot's bytes of flash and of RAM: variables, main()'s stack and an interrupt's."""
    image = kilobot_image(folder, *firmware_build.flags)
    paths = Paths(image)
    handlers = [
        name
        for name, symbol in image.symbols.items()
        if re.fullmatch(r"__vector_\d+", name) and symbol["st_info"]["bind"] == "STB_GLOBAL"
    ]
    flash, ram = image.sizes()
    return flash, ram + paths.deepest("main") + max(map(paths.deepest, handlers))
