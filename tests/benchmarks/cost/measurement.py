"""Measurement of what the firmware costs on a target at a level of optimisation."""

from __future__ import annotations

import re
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from tempfile import TemporaryDirectory

from mcp_asdf import Filter
from support import TABLE

from .images import AVR, FIRMWARE, HERE, Image, Target, build, kilobot_image
from .machines import load
from .paths import Paths
from .robots import UPDATED, ObservedCall, Robot

TICK_CALLS = ("observe", "receive", "settle", "step", "x")
STACK_CALLS = (*TICK_CALLS, "init", "save", "restore", "invariants_hold")
SEED, SAMPLES = 1, 10
"""The seed of the random situations, and how many pairs of them are drawn for a robot of each age."""
_SYMBOL_OF_PROGRAM = re.compile(r"(main|config|mcp_asdf_t_table_\w+)$")


@dataclass(frozen=True)
class Build:
    """A build of the firmware.

    Attributes:
        name: The name that the tables show.
        flags: The compiler's flags that choose the filters of the build.
        filter: The filter with which its robot is measured.
    """

    name: str
    flags: tuple[str, ...]
    filter: Filter


PAPER = Build("paper's filter", ("-DMCP_ASDF_WITH_ROBUST=0",), Filter.ADAPTIVE)
ROBUST = Build("robust filter", ("-DMCP_ASDF_WITH_ASDF=0",), Filter.ROBUST)
BOTH = Build("both", (), Filter.ROBUST)
BUILDS = (PAPER, ROBUST, BOTH)


@dataclass
class Figures:
    """The cost of a build on a target at a level of optimisation.

    Attributes:
        observed_calls: All calls of the robot, each with its cost.
        bound: The number of instructions on the longest path through the machine code, by the kind of call.
            In a call of the kind "step" the filter is not due. An AVR has no bounds.
        stack: The bytes of stack that a call of a function needs at most, by the function's name.
        code: The bytes of flash of init, observe, receive, settle and x, and those of all functions.
        ram: The bytes of RAM of a robot.
    """

    observed_calls: list[ObservedCall]
    bound: dict[str, int]
    stack: dict[str, int]
    code: tuple[int, int]
    ram: int

    def largest(self, kind: str, unit: str = "instructions") -> int:
        """Return the largest cost of a call of this kind, in "instructions", "cycles" or "stack".

        Cycles are counted on an AVR only, and "stack" is in bytes.
        """
        return max(int(getattr(call.cost, unit)) for call in self.observed_calls if call.kind == kind)

    def tick_stack(self) -> int:
        """Return the bytes of stack that a tick needs: those of its deepest call."""
        return max(self.stack[name] for name in TICK_CALLS)


def robot_image(target: Target, level: str, folder: Path, firmware_build: Build) -> Image:
    """Build an image with the firmware, a robot, and functions that set its state and call it."""
    functions = [*(f"mcp_asdf_{name}" for name in STACK_CALLS), "bench_start", "bench_filtered"]
    # Nothing in the image calls these functions, so the linker must be told to keep them.
    keep_functions = [f"-Wl,-u,{name}" for name in functions]
    sources = [HERE / "firmware.c", *FIRMWARE.glob("*.c"), TABLE]
    return build(target, folder, sources, level, *firmware_build.flags, *keep_functions)


def measure(target: Target, level: str, folder: Path, firmware_build: Build) -> Figures:
    """Return the costs of a build on a target at a level."""
    image = robot_image(target, level, folder / "firmware", firmware_build)
    robot, paths = Robot(load(image), firmware_build.filter), Paths(image)
    robot.run_situations(SEED, SAMPLES)
    bound = {}
    if target != AVR:
        bound = {name: paths.longest(f"mcp_asdf_{name}") for name in ("receive", "x")}
        bound["step"] = paths.longest("mcp_asdf_step", without="update_b_hat")
        bound[UPDATED] = paths.longest("mcp_asdf_step")
    flags = firmware_build.flags
    return Figures(
        observed_calls=robot.observed_calls,
        bound=bound,
        stack={name: paths.deepest(f"mcp_asdf_{name}") for name in STACK_CALLS},
        code=(code_bytes(target, level, *flags), code_bytes(target, level, *flags, "-DWHOLE")),
        ram=int(image.symbols["robot"]["st_size"]),
    )


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


def kilobot(folder: Path, firmware_build: Build) -> tuple[int, int]:
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
