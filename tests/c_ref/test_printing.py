"""C programs of the pages and ports print the same whether an unsigned long has 32 bits or 64."""

from __future__ import annotations

import re
import subprocess
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import pytest

from mcp_asdf_tools.bus.frames import Estimate, FrameFormat, encode_estimate
from support import CORE, PAGES, PATIENCE, ROOT, TABLE, block_with, blocks, made_once, run
from targets.test_khepera import STAND_IN_FOR_LIBRARY

README, TUTORIAL = ROOT / "README.md", ROOT / "docs/robot_tutorial.md"
KHEPERA = ROOT / "docs/platforms/khepera.md"


# --- Building and running ---------------------------------------------------------------------------------

THIS_COMPUTER, WITH_32_BITS = ("gcc",), ("gcc", "-m32")
"""Compilers with their flags. Where a long has 32 bits, a wrong format for it shows."""


@dataclass(frozen=True)
class Output:
    """Output of a program."""

    stdout: str
    stderr: str


def compile_firmware(compiler: tuple[str, ...], folder: Path) -> None:
    """Compile the firmware and its table into a folder."""
    sources = (*sorted(CORE.parent.glob("*.c")), TABLE)
    run(*compiler, "-std=gnu99", f"-I{CORE.parent}", "-c", *sources, cwd=folder)


def build_and_run(
    compiler: tuple[str, ...], program: str, factory: pytest.TempPathFactory, *flags: str
) -> Output:
    """Build a program in C with the firmware, run it, and return what it prints.

    The program may fail with exit code 1, as one without its bus does.
    """
    firmware = made_once(factory, f"firmware {compiler}", partial(compile_firmware, compiler))
    folder = factory.mktemp("program")
    source, binary = folder / "program.c", folder / "program"
    source.write_text(program, encoding="utf-8")
    objects = firmware.glob("*.o")
    run(*compiler, "-std=gnu99", *flags, f"-I{CORE.parent}", source, *objects, "-o", binary)
    done = subprocess.run([binary], cwd=folder, capture_output=True, text=True, check=False, timeout=PATIENCE)
    assert done.returncode in (0, 1), done.stderr
    return Output(done.stdout, done.stderr)


# --- Programs of the pages -------------------------------------------------------------------------------


README_PROGRAM = block_with(README, "int main", "c")
FIRST_ROBOT_OF_TUTORIAL = block_with(TUTORIAL, "my_robot/main.c", "c")
SECOND_ROBOT_OF_TUTORIAL = block_with(TUTORIAL, "my_robot/on_bus.c", "c")
KHEPERA_SENSOR = block_with(KHEPERA, "kh4_proximity_ir", "c")


REPLACED_BUS = """\
#include <time.h>
#include <unistd.h>
/* In the place of the bus: in each tick all neighbours are received, then there is nothing to read. */
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


def bus_with_five_neighbours() -> str:
    """Return C code that takes the place of the tutorial's bus.

    On it are five neighbours that see nine of ten tiles black.
    """
    lines = ""
    for sender in range(5):
        x_hat = 7_549_747 + 999 * sender  # 0.9 in units of 2^-23, and a bit more
        alpha = 0x8000000A  # 512: a mantissa of 2^23, shifted by 10, in units of 2^-24
        frame = encode_estimate(Estimate(sender, x_hat, alpha, transfer_id=0), FrameFormat())
        lines += f"T{frame.arbitration_id:08X}8{frame.data.hex().upper()}\\r"
    return REPLACED_BUS.format(lines=lines)


def test_the_program_of_the_readme_prints_what_the_readme_shows(
    tmp_path_factory: pytest.TempPathFactory,
) -> None:
    """It is compiled for 32 bits. A long has another size there, so a wrong format for it shows."""
    shown_output = block_with(README, "share of black 0.685", "text")

    output = build_and_run(WITH_32_BITS, README_PROGRAM, tmp_path_factory)

    assert output == Output(stdout=shown_output, stderr="")


def test_the_first_robot_of_the_tutorial_prints_its_estimate(
    tmp_path_factory: pytest.TempPathFactory,
) -> None:
    """Its program, in docs/robot_tutorial.md, lets it see a black floor, so its estimate is 1.

    It is compiled for 32 bits. A long has another size there, so a wrong format for it shows.
    """
    output = build_and_run(WITH_32_BITS, FIRST_ROBOT_OF_TUTORIAL, tmp_path_factory)
    assert output == Output(stdout="share of black 1.000\n", stderr="")


def test_the_second_robot_of_the_tutorial_prints_the_same_on_32_bits_as_on_this_computer(
    tmp_path_factory: pytest.TempPathFactory,
) -> None:
    """It has five neighbours that see nine of ten tiles black; its program prints to standard error."""
    program = bus_with_five_neighbours() + SECOND_ROBOT_OF_TUTORIAL
    flag_of_tutorial = "-D_POSIX_C_SOURCE=200809L"

    output_here = build_and_run(THIS_COMPUTER, program, tmp_path_factory, flag_of_tutorial)
    output_on_32_bits = build_and_run(WITH_32_BITS, program, tmp_path_factory, flag_of_tutorial)

    assert output_here.stderr.startswith("tick  50: share of black 0.9"), output_here.stderr
    assert output_on_32_bits == output_here


def test_the_sensor_of_the_khepera_prints_the_mean_of_each_line(
    tmp_path: Path, tmp_path_factory: pytest.TempPathFactory
) -> None:
    """The sensor is a C program of docs/platforms/khepera.md, which prints the mean of two readings.

    In the place of its maker's library is one that reads the file "ground", with two readings in each line.
    The mean is rounded down. The third line stands for a failure, for which the program prints -1. It is
    compiled for 32 bits, where a wrong format for a long shows.
    """
    (tmp_path / "ground").write_text("200 300\n1000 1023\n-1 0\n")
    program = KHEPERA_SENSOR.replace("#include <khepera/khepera.h>", STAND_IN_FOR_LIBRARY)
    program = program.replace('"ground"', f'"{tmp_path}/ground"')

    output = build_and_run(WITH_32_BITS, program, tmp_path_factory)

    assert output.stdout == "250\n1011\n-1\n"


# --- Programs that are not tested ------------------------------------------------------------------------

PRINTING_CALL = re.compile(r"printf\(|\bputchar\(|\bputs\(")


def test_every_c_program_in_the_docs_that_prints_has_a_test_here() -> None:
    """A program without one may print a long wrongly where that has another size."""
    tested_programs = {README_PROGRAM, FIRST_ROBOT_OF_TUTORIAL, SECOND_ROBOT_OF_TUTORIAL, KHEPERA_SENSOR}
    printing_programs = set()
    for page in PAGES:
        for code in blocks(page, "c", "cpp"):
            if PRINTING_CALL.search(code):
                printing_programs.add(code)
    assert printing_programs == tested_programs


def test_no_port_prints_but_the_hosted_one_and_the_node_for_linux() -> None:
    """The hosted port sends single bytes, so it needs no long. The node has tests of its own."""
    ports = ROOT / "c_ref/ports"
    sources = [path for path in ports.rglob("*.[ch]") if path.parent != ports / "linux"]

    printing_files = {path.name for path in sources if PRINTING_CALL.search(path.read_text(encoding="utf-8"))}

    assert printing_files == {"hosted.c"}
