"""Every target computes the mirror's bits in an image that holds nothing else, and shows where it differs."""

from __future__ import annotations

import re
import shutil
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

from support import CORE, ROOT, require, run
from targets import matrix
from targets.golden_scenarios import edge_scenarios, run_scenarios
from targets.golden_vectors import encode, explain
from targets.matrix import CHOICES, CORE_SOURCES, HOST, TARGETS, VECTORS, Cell, Target, cells_of
from targets.slcan_model import OPENING

SCENARIOS = edge_scenarios() + run_scenarios()
EDGES = Path(__file__).with_name("golden_edges.bin")
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


def test_the_documentation_shows_what_a_target_prints() -> None:
    page = (ROOT / "docs/targets.md").read_text(encoding="utf-8")
    assert f"\n{matrix.verdict_of(*VECTORS)}\n" in page


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


@pytest.mark.slow
@pytest.mark.parametrize("choice", [choice for choice in CHOICES if choice != "own"])
def test_this_computer_computes_the_same_by_every_choice(choice: str) -> None:
    require("ninja", "ninja-build")
    verdict, details = matrix.result_of(Cell(HOST, choice=choice))
    assert verdict == "passed", details


FLAGS = {
    "avr": "-mmcu=atmega328p",
    **{name: f"-mcpu={name} -mthumb" for name in ("cortex-m0", "cortex-m3", "cortex-m4")},
    **{name: f"-march={name} -mabi=ilp32 -ffreestanding" for name in ("rv32imc", "rv32imac")},
    "cortex-a8": "-mcpu=cortex-a8",
}
"""For the compilers of targets that choose by it."""
ARITHMETIC = {"DIVIDE": range(1, 5), "SPLIT_MULTIPLY": range(2), "SHIFT_BYTES": range(2), "HAS_CLZ": range(2)}
"""Macros of mcp_asdf_arithmetic.h, and their values."""


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


@pytest.mark.parametrize("path", PORTS, ids=lambda path: path.name)
def test_a_port_is_small(path: Path) -> None:
    assert len(path.read_text(encoding="utf-8").splitlines()) <= 100


def test_there_is_a_target_for_every_preset_and_preset_for_every_target() -> None:
    presets = Path(__file__).with_name("CMakePresets.json").read_text(encoding="utf-8")
    names = set(re.findall(r'"name": "([^"]+)"', presets)) - {"base", "small", "host"}
    assert names == {target.name for target in TARGETS}


def test_what_is_missing_is_named() -> None:
    target = Target("any", ("no-such-compiler", "no-such-emulator"), "one two", "")
    assert target.missing() == "no no-such-compiler and no no-such-emulator: apt-get install one two"
    assert Target("any", ("python3", "cmake"), "", "").missing() == ""


def test_symbols_of_floating_point_and_of_a_library_are_refused() -> None:
    soft_float = (
        "__aeabi_dadd",
        "__aeabi_ui2d",
        "__aeabi_fmul",
        "__adddf3",
        "__mulsf3",
        "__floatsisf",
        "__cmpdf2",
    )
    for target in TARGETS:
        for name in (*soft_float, "printf", "malloc", "memcmp", "abort"):
            assert not re.fullmatch(target.helpers, name), f"{target.name}: {name}"


def test_variables_and_needed_symbols_are_seen(tmp_path: Path) -> None:
    source, linked = tmp_path / "bad.c", tmp_path / "bad.o"
    source.write_text("double sin(double); int one = 1; int zero; double f(void) { return sin(one + zero); }")
    subprocess.run([require("gcc", "gcc"), "-c", source, "-o", linked], check=True)
    assert matrix.needed_symbols(linked) == {"sin"}
    assert matrix.ram_sections(linked) == {".data": 4, ".bss": 4}


# ---- Settings of the robot on a serial line ----

SLCAN = ROOT / "c_ref/ports/slcan"


def configure_robot(folder: Path, *settings: str) -> None:
    options = [f"-D{setting}" for setting in settings]
    run(require("cmake"), "-S", SLCAN, "-B", folder, *options)


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("ROBOT_ID", -1),
        ("ROBOT_ID", 126),
        ("ROBOT_ID", 300),
        ("ROBOT_FILTER_PERIOD", 0),
        ("ROBOT_FILTER_PERIOD", 2**32),
    ],
)
def test_the_compiler_refuses_a_setting(name: str, value: int) -> None:
    with pytest.raises(AssertionError, match=f"{name} has to be"):
        run("cc", "-fsyntax-only", f"-I{CORE.parent}", f"-D{name}={value}", SLCAN / "slcan_robot.c")


@pytest.mark.slow
@pytest.mark.parametrize("b_hat", ["0", "1.0", "9.5e-7", "0.9999991", "high"])
def test_an_accuracy_that_the_firmware_refuses_is_refused_before(b_hat: str, tmp_path: Path) -> None:
    with pytest.raises(AssertionError, match=f"ROBOT_B_HAT={b_hat} is outside"):
        configure_robot(tmp_path, f"ROBOT_B_HAT={b_hat}")


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


# ---- The player finds faults, and the first call that shows one is named ----


def play_on_host(folder: Path, *settings: str) -> tuple[int, str]:
    """Exit status and output of the player built for this computer."""
    require("ninja", "ninja-build")
    options = (*settings, "CMAKE_COMPILE_WARNING_AS_ERROR=OFF", "CMAKE_BUILD_TYPE=Debug")
    image = matrix.build("host", folder / "build", *options, only=matrix.IMAGE)
    done = subprocess.run([image], capture_output=True, text=True, check=False)
    return done.returncode, done.stdout


def core_with(folder: Path, right: str, wrong: str) -> str:
    """A copy of the firmware with a fault in it, as a setting for CMake."""
    copy = folder / "c_ref"
    shutil.copytree(CORE.parents[1], copy)
    code = CORE.read_text(encoding="utf-8")
    assert code.count(right) == 1, right
    (copy / "src" / CORE.name).write_text(code.replace(right, wrong), encoding="utf-8")
    return f"MCP_ASDF_CORE={copy}"


FAULTS = [
    (  # ties away from zero: first seen when n = 1 is halved
        "(n >> 1 & 1U)",
        "(n & 1U)",
        "scenario 6 (a memory of 64 halves, ties to even), call 4, step:1:",
    ),
    (  # a message whose effect the digest covers only with the next call
        "before | UINT32_C(1) << (sender & 7U)",
        "before | UINT32_C(3) << (sender & 7U)",
        "scenario 42 (senders), call 1, receive:0:8388608:2147483649:",
    ),
    (  # one bit of a sum: seen when a round stays open
        "multiply(x_hat, x_hat)",
        "(multiply(x_hat, x_hat) | 1)",
        "scenario 42 (senders), call 1, receive:0:8388608:2147483649:",
    ),
    (  # a member that is in no image
        "shift_left(c, c_shift));",
        "shift_left(c, c_shift)) ^ 1;",
        "scenario 0 (nothing observed), call 0, table:0.05:30,robot:0:1:2147483648:0:3221225472:",
    ),
    (  # the edge of what says something
        "if (g < INFORMATIVE) {",
        "if (g <= INFORMATIVE) {",
        "scenario 73 (x_bar below 1/2 that hardly says something), call 14, settle:",
    ),
    (  # the flag of an update
        "    robot->updated = 0;\n",
        "",
        "scenario 11 (1 black among 2), call 2, observe:1:",
    ),
    (  # the last bit of 60 in the test of eq. 12
        "upper_part + (multiply(k, low_word(spread)) >> 26)",
        "upper_part + (multiply(k, low_word(spread)) >> 26) + 1",
        "scenario 58 (the threshold for 2), call 8, settle:",
    ),
    (
        "multiply(difference, difference) > upper_part",
        "multiply(difference, difference) >= upper_part",
        "scenario 59 (the threshold for 3), call 5, settle:",
    ),
]
"""A piece of the core, a wrong one to replace it, and the first call that shows the difference."""


@pytest.mark.slow
@pytest.mark.parametrize(("right", "wrong", "first"), FAULTS)
def test_a_planted_fault_is_found_at_its_first_call(
    right: str, wrong: str, first: str, tmp_path: Path
) -> None:
    status, printed = play_on_host(tmp_path, core_with(tmp_path, right, wrong))
    assert status == 1
    assert printed.endswith("FAIL\n")
    told = explain(printed, SCENARIOS).splitlines()
    assert told[0] == first
    assert told[1].startswith("  expected status")
    assert told[2].startswith("  found    status")
    assert told[1][11:] != told[2][11:]


@pytest.mark.slow
def test_a_fault_in_the_vectors_is_found(tmp_path: Path) -> None:
    spoilt = tmp_path / "spoilt.bin"
    edges = EDGES.read_bytes()
    spoilt.write_bytes(edges[:6] + bytes([edges[6] ^ 1]) + edges[7:])
    status, printed = play_on_host(tmp_path, f"GOLDEN_VECTORS={spoilt}")
    assert status == 1
    assert "every call agrees" in explain(printed, SCENARIOS)


def test_the_player_counts_what_it_plays(tmp_path: Path) -> None:
    few = tmp_path / "few.bin"
    played = SCENARIOS[:2]
    few.write_bytes(encode(played))
    names = [call.name for scenario in played for call in scenario.calls()]
    counts = (len(played), len(names) + 2 * len(played), names.count("observe") + names.count("step"))
    said = "PASS scenarios {} calls {} ticks {}\n".format(*counts)
    assert play_on_host(tmp_path, f"GOLDEN_VECTORS={few}") == (0, said)
    assert matrix.run(tmp_path / "build")[0]


# ---- The matrix passes what has played everything ----


def cell_with(vectors: str, monkeypatch: pytest.MonkeyPatch) -> tuple[str, str]:
    """A cell for this computer, whose image is given other vectors than it should."""
    require("ninja", "ninja-build")
    settings_of = matrix.settings_of

    def settings(*cell: Any) -> list[str]:
        return [*settings_of(*cell), f"GOLDEN_VECTORS={vectors}"]

    monkeypatch.setattr(matrix, "settings_of", settings)
    return matrix.result_of(Cell(HOST))


def test_an_image_that_plays_everything_passes() -> None:
    require("ninja", "ninja-build")
    verdict, details = matrix.result_of(Cell(HOST))
    assert verdict == "passed", details
    assert re.fullmatch(r" *\d+ bytes", details)


@pytest.mark.slow
def test_an_image_that_plays_too_little_fails(monkeypatch: pytest.MonkeyPatch) -> None:
    verdict, details = cell_with(str(EDGES), monkeypatch)
    assert (verdict, details.splitlines()[-1]) == ("FAILED", f"instead of {matrix.verdict_of(*VECTORS)}")


@pytest.mark.parametrize("content", [None, b"", b"nothing", EDGES.read_bytes()[:4] + b"\0\0"])
def test_nothing_to_play_fails(
    content: bytes | None, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    empty = tmp_path / "empty.bin"
    if content is not None:
        empty.write_bytes(content)
    verdict, details = cell_with("" if content is None else str(empty), monkeypatch)
    assert verdict == "FAILED"
    assert re.search(r"is\s+no\s+file\s+of\s+golden\s+vectors|gives\s+nothing\s+to\s+play", details)


CELLS = [cell for target in (*TARGETS, HOST) for cell in cells_of(target)]


def test_every_cell_plays_everything() -> None:
    assert len(set(CELLS)) == len(CELLS)
    for cell in CELLS:
        assert [name for vectors in matrix.images_of(cell) for name in vectors] == list(VECTORS)


@pytest.mark.slow
@pytest.mark.parametrize(
    "cell",
    [cell for cell in CELLS if cell.target.name != "avr" or cell.level == "-Os"],
    ids=lambda cell: " ".join(str(cell).split()),
)
def test_the_cell_passes(cell: Cell) -> None:
    """The matrix, as ``make targets`` shows it, which also plays the AVR's other levels: each keeps its
    simulator busy for over a minute."""
    verdict, details = matrix.result_of(cell)
    if verdict == "left out":
        pytest.skip(details)
    assert verdict == "passed", details


def test_a_matrix_without_tools_fails() -> None:
    """Everything is left out, with the reason; that nothing went wrong is not a success."""
    command = [sys.executable, "-m", "targets.matrix"]
    nothing = {"PATH": "/nonexistent", "PYTHONPATH": str(ROOT / "tests")}
    done = subprocess.run(command, env=nothing, capture_output=True, text=True, check=False)
    *cells, summary = done.stdout.splitlines()
    assert (done.returncode, done.stderr, summary) == (1, "", f"{len(cells)} left out")
    assert len(cells) == len(CELLS) >= 2 * (len(TARGETS) + 1) * len(matrix.LEVELS)
    assert all("no cmake" in line or "clang does not build" in line for line in cells)
