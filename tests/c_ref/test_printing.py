"""C programs of the pages and ports print the same where an unsigned long has 32 bits."""

from __future__ import annotations

import json
import re
import subprocess
from dataclasses import dataclass
from pathlib import Path

import pytest

from mcp_asdf_tools.bus.frames import Estimate, FrameFormat, encode_estimate
from support import CORE, PAGES, PATIENCE, ROOT, TABLE, block_with, blocks, require, run, slow
from targets.c_node import CORTEX_A8, PLAIN, Kind, built
from targets.test_khepera import LIBRARY

README, TUTORIAL, KHEPERA = ROOT / "README.md", ROOT / "docs/robot_tutorial.md", ROOT / "docs/khepera.md"
ARM_PACKAGES = "gcc-arm-linux-gnueabihf libc6-dev-armhf-cross"
NODE_OF_32_BITS = Kind("32-bit", flags=" -m32 -idirafter /usr/include/x86_64-linux-gnu")  # asm/types.h
PRINTS = re.compile(r"printf\(|\bputchar\(|\bputs\(")


@dataclass(frozen=True)
class Machine:
    """A machine to build for and run on.

    Attributes:
        compiler: Compiler and flags.
        runner: Program that runs the machine's programs, or nothing.
    """

    compiler: tuple[str, ...]
    runner: tuple[str, ...] = ()


HERE = Machine(("gcc",))
MACHINES = {
    "-m32": Machine(("gcc", "-m32")),
    "armhf": Machine(("arm-linux-gnueabihf-gcc", "-static"), ("qemu-arm",)),
}


for_every_machine = pytest.mark.parametrize(
    "machine",
    [
        pytest.param(MACHINES["-m32"], id="-m32"),
        pytest.param(MACHINES["armhf"], id="armhf", marks=pytest.mark.slow),  # under emulation
    ],
)


def require_machine(machine: Machine) -> None:
    require(machine.compiler[0], ARM_PACKAGES)
    for runner in machine.runner:
        require(runner, "qemu-user")


def output_of(machine: Machine, program: str, folder: Path, *flags: str) -> tuple[str, str]:
    """Build a program in C with the firmware and run it; returns its standard output and standard error."""
    require_machine(machine)
    folder.mkdir()
    source, binary = folder / "program.c", folder / "program"
    source.write_text(program, encoding="utf-8")
    sources = (source, *sorted(CORE.parent.glob("*.c")), TABLE)
    run(*machine.compiler, "-std=gnu99", *flags, f"-I{CORE.parent}", *map(str, sources), "-o", str(binary))
    done = subprocess.run(
        [*machine.runner, binary], cwd=folder, capture_output=True, text=True, check=False, timeout=PATIENCE
    )
    assert done.returncode in (0, 1), done.stderr
    return done.stdout, done.stderr


SWARM_OF_THE_TUTORIAL = """\
#include <time.h>
#include <unistd.h>
/* In the place of the bus: in each tick all neighbours are heard, then there is nothing to read. */
static const char neighbours[] = "{lines}";
static unsigned long position;
static long read_neighbours(int file, char *c, unsigned long size)
{{
    (void)file, (void)size;
    if (position == sizeof neighbours - 1) {{
        position = 0;
        return 0;
    }}
    *c = neighbours[position++];
    return 1;
}}
#define read read_neighbours
#define nanosleep(tick, left) (void)(tick)
"""


def swarm_of_the_tutorial() -> str:
    """C code that takes the place of the tutorial's bus: five neighbours that see nine tiles in ten black."""
    frames = [
        encode_estimate(Estimate(sender, 7_549_747 + 999 * sender, 0x8000000A, 0), FrameFormat())
        for sender in range(5)
    ]
    lines = [f"T{frame.arbitration_id:08X}8{frame.data.hex().upper()}\\r" for frame in frames]
    return SWARM_OF_THE_TUTORIAL.format(lines="".join(lines))


def program_of_the_readme() -> str:
    return block_with(README, "int main", "c")


def program_of_the_tutorial(name: str) -> str:
    return block_with(TUTORIAL, f"my_robot/{name}", "c")


def sensor_of_the_khepera() -> str:
    include = "#include <khepera/khepera.h>"
    return block_with(KHEPERA, include, "c").replace(include, LIBRARY)


@for_every_machine
def test_the_program_of_the_readme_prints_the_same(machine: Machine, tmp_path: Path) -> None:
    shown = block_with(README, "share of black 0.685", "text")
    assert output_of(machine, program_of_the_readme(), tmp_path / "build") == (shown, "")


@for_every_machine
def test_the_first_robot_of_the_tutorial_prints_the_same(machine: Machine, tmp_path: Path) -> None:
    program = program_of_the_tutorial("main.c")
    assert output_of(machine, program, tmp_path / "build") == ("share of black 1.000\n", "")


@for_every_machine
def test_the_second_robot_of_the_tutorial_prints_the_same(machine: Machine, tmp_path: Path) -> None:
    program = swarm_of_the_tutorial() + program_of_the_tutorial("on_bus.c")
    flags = ("-D_POSIX_C_SOURCE=200809L",)
    here = output_of(HERE, program, tmp_path / "here", *flags)
    assert here[1].startswith("tick  50: share of black 0.9"), here[1]
    assert output_of(machine, program, tmp_path / "build", *flags) == here


@for_every_machine
def test_the_sensor_of_the_khepera_prints_the_same(machine: Machine, tmp_path: Path) -> None:
    (tmp_path / "ground").write_text("200 300\n1000 1023\n-1 0\n")
    program = sensor_of_the_khepera().replace('"ground"', f'"{tmp_path}/ground"')
    assert output_of(machine, program, tmp_path / "build")[0] == "250\n1011\n-1\n"


@pytest.mark.parametrize(
    "kind",
    slow([NODE_OF_32_BITS, CORTEX_A8]),
    ids=lambda kind: kind.name,
)
def test_the_node_prints_the_same(
    kind: Kind, tmp_path: Path, tmp_path_factory: pytest.TempPathFactory
) -> None:
    (tmp_path / "tiles").write_text("1101111111" * 5)

    def printed(kind: Kind) -> dict[str, object]:
        options = (
            "--interface udp:239.74.163.99:43199 --hop-limit 0 --id 7 --b-hat 0.95 --steps-per-second 1000"
        )
        command = [
            *built(kind, tmp_path_factory),
            *options.split(),
            "--observations",
            str(tmp_path / "tiles"),
        ]
        figures: dict[str, object] = json.loads(run(*command))
        return figures

    here, there = printed(PLAIN), printed(kind)
    assert here["t"] == 50
    for name in ("t", "n", "b_hat", "x_hat", "alpha", "x", "x_bar"):
        assert there[name] == here[name], name


def test_no_program_that_prints_is_left_out() -> None:
    """A new one in a page needs a test above, and a new one in the ports, too."""
    programs = [code for page in PAGES for code in blocks(page, "c", "cpp") if PRINTS.search(code)]
    tested = [program_of_the_readme(), program_of_the_tutorial("main.c"), program_of_the_tutorial("on_bus.c")]
    assert sorted(programs) == sorted([*tested, block_with(KHEPERA, "kh4_proximity_ir", "c")])
    ports = ROOT / "c_ref/ports"
    printing = [path for path in ports.rglob("*.[ch]") if PRINTS.search(path.read_text(encoding="utf-8"))]
    others = {path.name for path in printing if path.parent != ports / "linux"}  # that is mcp_asdf_node
    assert others == {"hosted.c"}, "which sends single bytes"
