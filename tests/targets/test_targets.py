"""Every target computes the mirror's bits in an image that holds nothing else, and shows where it differs."""

from __future__ import annotations

import re
import subprocess
from pathlib import Path

import pytest

from support import CORE, ROOT, require, run
from targets import matrix
from targets.golden_scenarios import edge_scenarios, run_scenarios
from targets.golden_vectors import explain
from targets.matrix import CHOICES, CORE_SOURCES, HOST, TARGETS, VECTORS, Cell, Target, cells_of
from targets.slcan_model import OPENING

SCENARIOS = edge_scenarios() + run_scenarios()
OUR_SOURCES = {*CORE_SOURCES, "t_table_omega05_q30.c", "player.c", "golden_vectors.c"}
COMPILERS_OWN = re.compile(r"libgcc2\.c|_\w+\.o|crt\w*\.o|")
PORTS = sorted(
    path
    for path in (ROOT / "c_ref/ports").rglob("*.*")
    if path.suffix in (".c", ".h", ".ld") and path.parent.name != "linux"
)


ALIKE = {"cortex-m3", "cortex-m4", "rv32imac"}
"""Targets whose core computes by the same choices as another one's or this computer's."""


@pytest.mark.parametrize(
    "target",
    [
        pytest.param(target, id=target.name, marks=pytest.mark.slow if target.name in ALIKE else ())
        for target in TARGETS
    ],
)
def test_the_target_computes_the_mirror_s_bits(target: Target, tmp_path: Path) -> None:
    reason = target.missing()
    if reason:
        pytest.skip(reason)
    require("ninja", "ninja-build")
    image = matrix.build(target.name, tmp_path)
    passed, printed = matrix.run(tmp_path)
    assert passed, difference(printed)
    played = list(VECTORS)[:1] if target.name == "avr" else list(VECTORS)
    assert matrix.verdict_in(printed) == matrix.verdict_of(*played)
    check_core(target, matrix.link_core_alone(target, tmp_path))
    if target.bare:
        check_contents(image)


def difference(printed: str) -> str:
    return explain(printed, SCENARIOS) if "found" in printed else f"the image did not finish:\n{printed}"


def check_core(target: Target, alone: Path) -> None:
    """The core needs integer helpers of the compiler, no more, and has no variables of its own."""
    odd = {name for name in matrix.needed_symbols(alone) if not re.fullmatch(target.helpers, name)}
    assert not odd, f"the core alone needs {sorted(odd)}"
    constants = (".rodata",) if target.name == "avr" else ()  # there they are copied to RAM
    assert matrix.ram_sections(alone, *constants) == {}


def check_contents(image: Path) -> None:
    """The image was linked from the core, a table, the player and the port; the rest is the compiler's."""
    files = {symbol.name for symbol in matrix.symbols(image) if symbol["st_info"]["type"] == "STT_FILE"}
    ours = {name for name in files if not COMPILERS_OWN.fullmatch(name)}
    assert ours >= OUR_SOURCES
    assert ours - OUR_SOURCES <= {path.name for path in PORTS}


FLAGS = {
    "avr": "-mmcu=atmega328p",
    **{name: f"-mcpu={name} -mthumb" for name in ("cortex-m0", "cortex-m3", "cortex-m4")},
    **{name: f"-march={name} -mabi=ilp32 -ffreestanding" for name in ("rv32imc", "rv32imac")},
    "cortex-a8": "-mcpu=cortex-a8",
}
"""For the compilers of targets that choose by it."""
ARITHMETIC = {"DIVIDE": range(1, 4), "SPLIT_MULTIPLY": range(2), "SHIFT_BYTES": range(2), "HAS_CLZ": range(2)}
"""Macros of mcp_asdf_target.h, and their values."""


def chosen_by(cell: Cell) -> list[tuple[str, int]]:
    """The macros that the cell's core is compiled with."""
    compiler = require(cell.target.tools[0], cell.target.packages)
    settings = [f"-D{setting}" for setting in CHOICES[cell.choice]]
    probe = '#include "mcp_asdf_arithmetic.h"\nchosen ' + " ".join(f"MCP_ASDF_{name}" for name in ARITHMETIC)
    flags = [*FLAGS.get(cell.target.name, "").split(), f"-I{CORE.parent}", *settings]
    command = [compiler, *flags, "-E", "-P", "-x", "c", "-"]
    done = subprocess.run(command, input=probe, capture_output=True, text=True, check=True)
    values = done.stdout.splitlines()[-1].split()[1:]
    return [(name, int(value)) for name, value in zip(ARITHMETIC, values, strict=True)]


def test_the_matrix_plays_every_choice_of_the_arithmetic() -> None:
    cells = {
        (cell.target.name, cell.choice): cell for target in (*TARGETS, HOST) for cell in cells_of(target)
    }
    played = {pair for cell in cells.values() for pair in chosen_by(cell)}
    assert played == {(name, value) for name, values in ARITHMETIC.items() for value in values}


# ---- Settings of the robot on a serial line ----

SLCAN = ROOT / "c_ref/ports/slcan"


def configure_robot(folder: Path, *settings: str) -> None:
    options = [f"-D{setting}" for setting in settings]
    run(require("cmake"), "-S", SLCAN, "-B", folder, *options)


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("ROBOT_ID", 126),
        ("ROBOT_FILTER_PERIOD", 0),
        ("ROBOT_FILTER_PERIOD", 2**32),
    ],
)
def test_the_compiler_refuses_a_setting(name: str, value: int) -> None:
    with pytest.raises(AssertionError, match=f"{name} has to be"):
        run("cc", "-fsyntax-only", f"-I{CORE.parent}", f"-D{name}={value}", SLCAN / "slcan_robot.c")


@pytest.mark.parametrize(
    ("number", "b_hat", "period"), [(0, "9.5367431640625e-07", 1), (125, "0.99999904632568359375", 2**32 - 1)]
)
def test_the_widest_settings_are_built_and_run(number: int, b_hat: str, period: int, tmp_path: Path) -> None:
    """The robot asks the other end of the line to open a bus; one that cannot start ends before."""
    configure_robot(tmp_path, f"ROBOT_ID={number}", f"ROBOT_B_HAT={b_hat}", f"ROBOT_FILTER_PERIOD={period}")
    run("cmake", "--build", tmp_path)
    with subprocess.Popen([tmp_path / "slcan_robot"], stdin=subprocess.PIPE, stdout=subprocess.PIPE) as robot:
        assert robot.stdin and robot.stdout
        assert robot.stdout.read(len(OPENING)) == OPENING
        robot.stdin.write(b"V\rO\r")
        robot.stdin.flush()
        said = robot.stdout.read(8)
        robot.kill()
    assert said.startswith(b"V1001\r")


# ---- The matrix passes what has played everything ----


def representative(cell: Cell) -> bool:
    """True for the cells that stand for the matrix, which ``make targets`` plays: every level, by one of the
    compilers, and every choice of the arithmetic, on either order of bytes."""
    if cell.choice != "own":
        return (cell.compiler, cell.level) == ("gcc" if cell.target is HOST else "clang", "-O2")
    if cell.target.name == "avr":
        return cell.level == "-Os"  # others keep the simulator busy for over a minute each
    return (cell.compiler, cell.level) in {
        ("gcc", "-O0"),
        ("gcc", "-O3"),
        ("clang", "-Os"),
        ("clang", "-O2 LTO"),
    }


CELLS = [cell for target in (*TARGETS, HOST) for cell in cells_of(target) if representative(cell)]


@pytest.mark.slow
@pytest.mark.parametrize("cell", CELLS, ids=lambda cell: " ".join(str(cell).split()))
def test_the_cell_passes(cell: Cell) -> None:
    verdict, details = matrix.result_of(cell)
    if verdict == "left out":
        pytest.skip(details)
    assert verdict == "passed", details
