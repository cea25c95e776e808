"""The robots of docs/porting.md: they build as the page says, and compute the bits of the robot in Python.

They run on this computer, one of them with a scripted board, and on a simulated ATmega328P.
"""

from __future__ import annotations

import math
import random
import re
import shutil
import statistics
import subprocess
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import can
import pytest

import mcp_asdf_tools as m
from benchmarks.cost.images import AVR, Image
from mcp_asdf.fixed_point import alpha_word_from_float
from mcp_asdf.mirror import MirrorRobot
from mcp_asdf.robot import Config, Filter, Observation
from mcp_asdf_tools.bus import frames
from mcp_asdf_tools.bus.frames import Estimate, FrameFormat, Heartbeat, Telemetry
from packets import frame_of_packet, packet_of
from simulated_avr import Board, require_simavr
from support import CORE, ROOT, TABLE, WARNINGS, block_with, cells_of_line, require, run, slow

PAGE = ROOT / "docs/porting.md"
KILOBOT_PAGE = ROOT / "docs/platforms/kilobot.md"
TEXT = PAGE.read_text(encoding="utf-8")
PORTS = ROOT / "c_ref/ports"
ROBOT_ID, B_HAT = 7, 0xF3333333  # MCP_ASDF_PROBABILITY(95, 100): 0.95 in units of 2^-32
FORMAT = FrameFormat()
RADIO_QUEUE = 8
"""Packets that the robot's radio keeps until the end of a tick."""
WHITE, BLACK, NO_TILE = 0, 1, 2
"""What the sensor reads in a tick; NO_TILE stands for a tick in which it gives no colour."""
NOISE = b"\x00\xff"
"""Bytes between packets."""


# --- Packets ---------------------------------------------------------------------------------------------


def draw_packet(stream: random.Random) -> bytes:
    """Draw an estimate's packet; some are damaged, and some hold no estimate that the robot may use."""
    sender = stream.choice((1, 2, 3, ROBOT_ID, 127))
    x_hat = round(2**23 * stream.uniform(0.6, 0.8))
    alpha = alpha_word_from_float(stream.choice((0.0, 1.0, 1e3, 1e8)))
    frame = frames.encode_estimate(Estimate(sender, x_hat, alpha, stream.randrange(32)), FORMAT)
    if stream.random() < 0.1:  # an alpha that is off the grid, too large, too small, or none
        frame.data[3:7] = stream.randbytes(4)
    if stream.random() < 0.2:  # another subject, an x_hat that is too large, or another kind of frame
        frame.arbitration_id ^= stream.choice((0, 1 << 8))
        frame.data[stream.choice((2, 6, 7))] ^= 0x80
    packet = bytearray(packet_of(frame))
    if stream.random() < 0.1:
        packet[stream.randrange(1, len(packet))] ^= 1 << stream.randrange(8)
    return bytes(packet)


# --- Scripts, and what the robot sends in them -----------------------------------------------------------


@dataclass(frozen=True)
class ScriptedTick:
    """What happens to a robot in a tick.

    Attributes:
        packets: What its radio receives, all at once, before it observes.
        tile: What its sensor reads: WHITE, BLACK or NO_TILE.
    """

    packets: list[bytes]
    tile: int


def draw_script(
    seed: int, ticks: int, draw_tile_from: tuple[int, ...], max_packets_in_a_tick: int
) -> list[ScriptedTick]:
    """Draw ticks in a swarm that sees about 70 % black."""
    stream = random.Random(seed)
    script = []
    for _ in range(ticks):
        packets = [draw_packet(stream) for _ in range(stream.randint(0, max_packets_in_a_tick))]
        script.append(ScriptedTick(packets, stream.choice(draw_tile_from)))
    return script


def format_script(script: list[ScriptedTick]) -> bytes:
    """Return a script in the format that scripted_board.c reads."""
    formatted = bytearray()
    for tick in script:
        received = NOISE.join(tick.packets)
        if received:
            number_that_is_no_tile = NO_TILE + len(received)
            formatted += bytes([number_that_is_no_tile]) + received
        formatted.append(tick.tile)
    return bytes(formatted)


def receive_packets(robot: MirrorRobot, packets: list[bytes]) -> int:
    """Let the robot in Python receive the packets of a tick, and return how many its radio loses.

    Lost are packets with a wrong checksum, and those that find the radio's queue full.
    """
    queued_packets = packets[:RADIO_QUEUE]
    lost = len(packets) - len(queued_packets)
    for packet in queued_packets:
        frame = frame_of_packet(packet)
        if frame is None:  # its checksum is wrong
            lost += 1
            continue
        estimate = frames.decode_estimate(frame, FORMAT)
        if isinstance(estimate, Estimate):  # and not the reason why the frame has none
            robot.receive_raw(estimate.sender, estimate.x_hat, estimate.alpha)
    return lost


def expected_output(script: list[ScriptedTick]) -> bytes:
    """Return what the demonstration robot has to send in a script, as the robot in Python computes it.

    It sends an estimate in each tick, and a heartbeat and telemetry after each ten, which are a second.
    Transfer ids count the frames of each kind in 5 bits.
    """
    robot = MirrorRobot(Config(filter=Filter.ROBUST), ROBOT_ID, B_HAT / 2**32)
    assert robot.b_hat_raw == B_HAT
    output, lost_packets = b"", 0
    for tick_number, tick in enumerate(script):
        lost_packets += receive_packets(robot, tick.packets)
        if tick.tile != NO_TILE:
            robot.observe(Observation(tick.tile))
        estimate = Estimate(ROBOT_ID, robot.x_hat_raw, robot.alpha_raw, transfer_id=tick_number % 32)
        output += packet_of(frames.encode_estimate(estimate, FORMAT))
        robot.settle()
        seconds, tick_of_second = divmod(tick_number + 1, 10)
        if tick_of_second == 0:
            output += packets_of_report(robot, seconds, lost_packets)
    return output


def packets_of_report(robot: MirrorRobot, seconds: int, lost_packets: int) -> bytes:
    """Return the heartbeat and the telemetry that the demonstration robot sends after so many seconds."""
    transfer_id = (seconds - 1) % 32
    heartbeat = Heartbeat(ROBOT_ID, seconds, transfer_id, vendor_status=lost_packets % 256)
    updates = robot.counters.updates % 256
    b_hat_in_24_bits = robot.b_hat_raw >> 8
    telemetry = Telemetry(ROBOT_ID, robot.x_raw, b_hat_in_24_bits, updates, transfer_id)
    return packet_of(frames.encode_heartbeat(heartbeat)) + packet_of(frames.encode_telemetry(telemetry))


# --- The compiled core -----------------------------------------------------------------------------------

COMPILERS = {
    "Cortex-M4": ("arm-none-eabi-gcc -mcpu=cortex-m4 -mthumb", "gcc-arm-none-eabi"),
    "Cortex-M0+": ("arm-none-eabi-gcc -mcpu=cortex-m0plus -mthumb", "gcc-arm-none-eabi"),
    "RV32IMAC": ("riscv64-unknown-elf-gcc -march=rv32imac -mabi=ilp32", "gcc-riscv64-unknown-elf"),
    "ATmega328P": ("avr-gcc -mmcu=atmega328p", "gcc-avr avr-libc"),
}
"""Compiler and Debian packages of each target of the page."""


@dataclass(frozen=True)
class Sizes:
    """Bytes of code, of variables with a value and of variables without, in a compiled file."""

    code: int
    variables_with_values: int
    zeroed_variables: int


def compile_core(source: Path, target: str, output: Path, *options: str) -> Sizes:
    """Compile a source of the core for a target without an operating system, and return its sizes."""
    command, packages = COMPILERS[target]
    compiler, *flags = command.split()
    require(compiler, packages)
    run(compiler, *flags, "-ffreestanding", "-Os", *options, "-c", source, "-o", output)
    return section_sizes(compiler.removesuffix("gcc"), output)


def section_sizes(tools: str, path: Path) -> Sizes:
    """Return the sizes of a file by ``size`` of a toolchain."""
    _titles, numbers = run(require(f"{tools}size"), path).splitlines()
    code, variables_with_values, zeroed_variables, *_ = numbers.split()
    return Sizes(int(code), int(variables_with_values), int(zeroed_variables))


QUICK_TARGETS = ("Cortex-M0+", "ATmega328P")
"""Targets that leave the most to helpers of their compilers."""
NAMES_OF_PARTS_ON_PAGE = {
    "mcp_asdf": "method",
    "mcp_asdf_image": "saving",
    "mcp_asdf_frame": "frames",
    "mcp_asdf_small": "small messages",
}
"""Files of the core, and the names by which the page's budget of flash has them."""
MEMORY_CALLS = re.compile(r"(__aeabi_)?mem(cpy|set|clr|move)\d?")
LONG_DIVISION_OR_FLOAT = re.compile(r"u?(div|mod|divmod)(di|ti)\d|uldivmod|ldivmod|[sdx]f\d|aeabi_[fd]")


@dataclass(frozen=True)
class CompiledPart:
    """A part of the core, compiled for a target.

    Attributes:
        target: Key of COMPILERS.
        part: Key of NAMES_OF_PARTS_ON_PAGE.
        undefined_symbols: Names of what it uses of other parts, and of libraries.
        sizes: How much memory it needs.
    """

    target: str
    part: str
    undefined_symbols: set[str]
    sizes: Sizes


@pytest.fixture(
    scope="module",
    params=[
        pytest.param(
            (target, part), id=f"{target}-{part}", marks=[] if target in QUICK_TARGETS else [pytest.mark.slow]
        )
        for target in COMPILERS
        for part in NAMES_OF_PARTS_ON_PAGE
    ],
)
def compiled_part(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> CompiledPart:
    """A part of the core, compiled for a target without an operating system and without a warning."""
    target, part = request.param
    path = tmp_path_factory.mktemp("core") / "core.o"
    strict = ("-std=c99", "-pedantic-errors", *WARNINGS.split())
    sizes = compile_core(CORE.with_name(f"{part}.c"), target, path, *strict)
    compiler, *_flags = COMPILERS[target][0].split()
    nm = compiler.removesuffix("gcc") + "nm"
    undefined_symbols = {line.split()[-1] for line in run(nm, "-u", path).splitlines()}
    return CompiledPart(target, part, undefined_symbols, sizes)


def test_the_firmware_calls_no_library_but_its_compiler_s_helpers(compiled_part: CompiledPart) -> None:
    """So it runs without a C library. Only mcp_asdf_image, which restores robots, calls another part.

    Helpers have names such as __aeabi_lmul; compilers also call memcpy and memset by themselves.
    """
    called_functions = set()
    for name in compiled_part.undefined_symbols:
        is_helper_of_compiler = name.startswith("__") or MEMORY_CALLS.fullmatch(name)
        if not is_helper_of_compiler:
            called_functions.add(name)

    if compiled_part.part == "mcp_asdf_image":
        assert called_functions == {"mcp_asdf_init", "mcp_asdf_observe"}
    else:
        assert called_functions == set()


def test_the_core_needs_neither_long_divisions_nor_floats(compiled_part: CompiledPart) -> None:
    """A compiler for a small processor would call helpers for them, such as __udivdi3."""
    calls = {name for name in compiled_part.undefined_symbols if LONG_DIVISION_OR_FLOAT.search(name)}
    assert calls == set()


def test_the_core_has_no_variables(compiled_part: CompiledPart) -> None:
    """All state is in the robots, so that many of them, and interrupts, do not disturb each other."""
    assert compiled_part.sizes.variables_with_values == 0
    assert compiled_part.sizes.zeroed_variables == 0


def flash_budgets() -> dict[tuple[str, str], float]:
    """Return the page's budgets of flash in KB, by part and target."""
    text_from_table_on = TEXT[TEXT.index("| flash | ") :]
    table, _, _ = text_from_table_on.partition("\n\n")
    title_line, _rule, *lines = table.splitlines()
    _flash, *targets = cells_of_line(title_line)
    budgets = {}
    for line in lines:
        part, *cells = cells_of_line(line)
        for target, cell in zip(targets, cells, strict=True):
            budgets[part, target] = float(cell.removesuffix(" KB"))
    return budgets


def test_each_part_of_the_firmware_takes_the_flash_that_docs_porting_states(
    compiled_part: CompiledPart,
) -> None:
    """The page states how many KB a part takes at most; it takes not less than four fifths of that."""
    name_on_page = NAMES_OF_PARTS_ON_PAGE[compiled_part.part]
    budget_in_kb = flash_budgets()[name_on_page, compiled_part.target]
    code_in_kb = compiled_part.sizes.code / 1000

    assert code_in_kb <= budget_in_kb
    assert code_in_kb > 0.8 * budget_in_kb, "the page could state less"


@pytest.mark.parametrize(
    ("remaining_filter", "target"),
    [
        ("robust filter", "ATmega328P"),
        *slow(("robust filter", target) for target in COMPILERS if target != "ATmega328P"),
        *slow(("paper's filter", target) for target in COMPILERS),
    ],
)
def test_a_firmware_with_one_filter_takes_the_flash_that_docs_porting_states(
    remaining_filter: str, target: str, tmp_path: Path
) -> None:
    """A macro leaves the other filter out. The page states how many KB the firmware then takes at most.

    It takes not less than four fifths of that.
    """
    filter_left_out = "ASDF" if remaining_filter == "robust filter" else "ROBUST"
    budget_in_kb = flash_budgets()[f"method, {remaining_filter} alone", target]

    sizes = compile_core(CORE, target, tmp_path / "core.o", f"-DMCP_ASDF_WITH_{filter_left_out}=0")

    code_in_kb = sizes.code / 1000
    assert code_in_kb <= budget_in_kb
    assert code_in_kb > 0.8 * budget_in_kb, "the page could state less"


# --- On this computer ------------------------------------------------------------------------------------


MAIN = """
#include "mcp_asdf.h"

#include <stdio.h>

bool start_robot(uint8_t id);
void tick(void);
void hear(uint8_t id, uint32_t x_hat, uint32_t alpha);

static unsigned number;

bool read_tile(mcp_asdf_observation_t *tile)
{
    *tile = ++number % 4 == 0 ? MCP_ASDF_WHITE : MCP_ASDF_BLACK;
    return number % 7 != 0;
}

void broadcast(uint8_t id, uint32_t x_hat, uint32_t alpha)
{
    printf("%u %lu %lu\\n", id, (unsigned long)x_hat, (unsigned long)alpha);
    for (uint8_t i = 1; i < 7; ++i) {
        hear(id + i, x_hat > 9000U * i ? x_hat - 9000U * i : 0, alpha);
    }
}

void show(unsigned thousandths) { printf("%u\\n", thousandths); }

int main(void)
{
    if (!start_robot(5)) {
        return 1;
    }
    for (int i = 0; i < 3000; ++i) {
        tick();
    }
    return 0;
}
"""
"""What the page's robot.c leaves to the user: most tiles are black, and six neighbours believe a bit less."""


def output_of_robot_in_python() -> str:
    """Return what the page's robot has to print with the program above."""
    robot = MirrorRobot(Config(filter=Filter.ROBUST, filter_period=100), 5, b_hat=0.95)
    output = ""
    for number in range(1, 3001):
        if number % 7 != 0:
            is_black = number % 4 != 0
            robot.observe(Observation(is_black))
        if number % 10 == 0:  # the page's robot broadcasts in every tenth tick
            x_hat, alpha = robot.x_hat_raw, robot.alpha_raw
            output += f"5 {x_hat} {alpha}\n"
            for i in range(1, 7):
                robot.receive_raw(5 + i, max(x_hat - 9000 * i, 0), alpha)
            robot.settle()
            rounded_thousandths = math.floor(robot.x * 1000 + 1 / 2)
            output += f"{rounded_thousandths}\n"
    return output


def begin_project(folder: Path, vendor: str = "vendor/mcp_asdf") -> str:
    """Write the page's robot, a main program and the firmware; return what the command prints."""
    (folder / "robot.c").write_text(block_with(PAGE, "/* robot.c */", "c"))
    (folder / "main.c").write_text(MAIN)
    command = block_with(PAGE, "mcp-asdf firmware", "sh").replace("vendor/mcp_asdf", vendor)
    return run("sh", "-ec", command, cwd=folder)


@pytest.fixture
def project(tmp_path: Path) -> Path:
    """The folder of a project with the page's robot and with the firmware that the page's command writes."""
    assert begin_project(tmp_path) == block_with(PAGE, "wrote 25 files", "text")
    return tmp_path


@pytest.mark.slow
def test_the_robot_of_docs_porting_builds_by_cmake_and_computes_what_the_robot_in_python_does(
    project: Path,
) -> None:
    """It builds without a warning, by the lines for CMake that the page shows."""
    page_s_lines = block_with(PAGE, "add_subdirectory(vendor/mcp_asdf)", "cmake")
    (project / "CMakeLists.txt").write_text(page_s_lines)

    run(require("cmake"), "-S", project, "-B", project / "build", CFLAGS=WARNINGS)
    run("cmake", "--build", project / "build")

    assert run(project / "build/robot") == output_of_robot_in_python()


@pytest.mark.slow
def test_the_robot_of_docs_porting_builds_by_cmake_for_a_cortex_m4(project: Path) -> None:
    """It builds by the lines for CMake that the page shows, or run() raises. It does not run here."""
    require("arm-none-eabi-gcc", "gcc-arm-none-eabi libnewlib-arm-none-eabi")
    page_s_lines = block_with(PAGE, "add_subdirectory(vendor/mcp_asdf)", "cmake")
    (project / "CMakeLists.txt").write_text(page_s_lines)
    options = (
        "-DCMAKE_SYSTEM_NAME=Generic",
        "-DCMAKE_C_COMPILER=arm-none-eabi-gcc",
        "-DCMAKE_C_FLAGS=-mcpu=cortex-m4 -mthumb",
        "-DCMAKE_EXE_LINKER_FLAGS=--specs=nosys.specs",
    )

    run(require("cmake"), "-S", project, "-B", project / "build", *options)
    run("cmake", "--build", project / "build")


def test_the_robot_of_docs_porting_builds_without_a_build_system(project: Path) -> None:
    """The page's command compiles it, or run() raises, and it computes what the robot in Python does."""
    run("sh", "-ec", block_with(PAGE, "-Ivendor/mcp_asdf", "sh"), cwd=project)
    assert run(project / "robot") == output_of_robot_in_python()


@pytest.mark.slow
def test_the_robot_of_docs_porting_builds_by_meson_and_computes_what_the_robot_in_python_does(
    project: Path,
) -> None:
    """It builds without a warning of Meson's, by the lines for Meson that the page shows."""
    require("meson")
    require("ninja")
    page_s_lines = block_with(PAGE, "subdir(", "meson")
    (project / "meson.build").write_text(page_s_lines)

    run("meson", "setup", "--werror", "build", cwd=project)
    run("meson", "compile", "-C", "build", cwd=project)

    assert run(project / "build/robot") == output_of_robot_in_python()


ESP_IDF_PROJECT = """
cmake_minimum_required(VERSION 3.21)
project(robot LANGUAGES C)
set(ESP_PLATFORM 1)
function(idf_component_register)
    cmake_parse_arguments(component "" "" "SRCS;INCLUDE_DIRS;REQUIRES" ${ARGN})
    list(TRANSFORM component_SRCS PREPEND ${CMAKE_CURRENT_LIST_DIR}/)
    if(component_REQUIRES)
        add_executable(robot ${component_SRCS})
        target_link_libraries(robot PRIVATE ${component_REQUIRES})
    else()
        add_library(mcp_asdf ${component_SRCS})
        target_include_directories(mcp_asdf PUBLIC ${component_INCLUDE_DIRS})
    endif()
endfunction()
add_subdirectory(components/mcp_asdf)
add_subdirectory(main)
"""
"""A project with what stands in for ESP-IDF's function."""


@pytest.mark.slow
def test_the_robot_of_docs_porting_builds_as_a_component_of_esp_idf(tmp_path: Path) -> None:
    """It builds by the page's lines, and computes what the robot in Python does.

    The one function of ESP-IDF that the lines call is a stand-in here.
    """
    (tmp_path / "main").mkdir()
    begin_project(tmp_path / "main", vendor="../components/mcp_asdf")
    page_s_lines = block_with(PAGE, "idf_component_register", "cmake")
    (tmp_path / "main/CMakeLists.txt").write_text(page_s_lines)
    (tmp_path / "CMakeLists.txt").write_text(ESP_IDF_PROJECT)

    run(require("cmake"), "-S", tmp_path, "-B", tmp_path / "build")
    run("cmake", "--build", tmp_path / "build")

    assert run(tmp_path / "build/main/robot") == output_of_robot_in_python()


def test_the_commands_for_tables_print_what_docs_porting_shows(tmp_path: Path) -> None:
    """They also write C files. One defines the array that the page declares: "extern const ... [];"."""
    printed = run("sh", "-ec", block_with(PAGE, "mcp-asdf table", "sh"), cwd=tmp_path)

    assert printed == block_with(PAGE, "omega 0.125, q 40", "text")
    declaration = block_with(PAGE, "omega125_q40[]", "c").strip()
    array = declaration.removeprefix("extern ").removesuffix("[];")
    assert array in (tmp_path / "build/tables/t_table_omega125_q40.c").read_text(encoding="utf-8")


def ticks_until_a_swarm_agrees(filter_name: str, comms_period: int) -> float:
    """Return the ticks until the robots agree, if they broadcast in every ``comms_period``-th tick.

    It is the mean over the robots of a trial, and the median of 30 trials.
    """
    [experiment] = m.grid(
        topology="dynamic", filter=filter_name, comms_period=comms_period, steps=20_000, trials=30
    )
    # The column "k" has one list per trial: the ticks from which on the robots agree.
    ticks_by_robot_and_trial = m.simulate([experiment])["k"].to_pylist()
    return statistics.median(statistics.fmean(ticks) for ticks in ticks_by_robot_and_trial)


@pytest.mark.slow
@pytest.mark.parametrize(("filter_name", "times_as_long"), [("asdf-minus", 1.0), ("robust", 2.0)])
def test_with_rare_broadcasts_only_the_robust_filter_needs_longer(
    filter_name: str, times_as_long: float
) -> None:
    """A simulated swarm with a broadcast in every tenth tick agrees as soon as with one in every tick.

    With one in every hundredth tick it needs ``times_as_long``: twice as long with the robust filter.
    """
    ticks_with_period_1 = ticks_until_a_swarm_agrees(filter_name, comms_period=1)
    ticks_with_period_10 = ticks_until_a_swarm_agrees(filter_name, comms_period=10)
    ticks_with_period_100 = ticks_until_a_swarm_agrees(filter_name, comms_period=100)

    assert ticks_with_period_10 == pytest.approx(ticks_with_period_1, rel=0.3)
    assert ticks_with_period_100 == pytest.approx(times_as_long * ticks_with_period_10, rel=0.2)


@pytest.fixture
def robot_on_scripted_board(tmp_path: Path) -> Path:
    """The page's project, built for a board that is a program here, whose sensor and radio read a script."""
    (tmp_path / "mcp-asdf").symlink_to(ROOT)
    (tmp_path / "CMakeLists.txt").write_text(block_with(PAGE, "mcp_asdf_port", "cmake"))
    shutil.copy(PORTS / "demo.c", tmp_path / "main.c")
    shutil.copy(Path(__file__).with_name("scripted_board.c"), tmp_path / "board.c")
    run(require("cmake"), "-S", tmp_path, "-B", tmp_path / "build", CFLAGS=WARNINGS)
    run("cmake", "--build", tmp_path / "build")
    return tmp_path / "build/robot"


def test_the_robot_on_a_scripted_board_sends_what_the_robot_in_python_sends(
    robot_on_scripted_board: Path,
) -> None:
    """In each of 1500 ticks up to 15 packets are sent to it. Some are damaged and some get lost.

    It is a program here, which reads the script with the tiles and packets on its standard input.
    """
    tiles = (WHITE, BLACK, BLACK, NO_TILE)
    script = draw_script(seed=5, ticks=1500, draw_tile_from=tiles, max_packets_in_a_tick=15)

    robot = subprocess.run(
        [robot_on_scripted_board], input=format_script(script), capture_output=True, check=True
    )

    greeting_of_the_board = b"?"
    assert robot.stdout == greeting_of_the_board + expected_output(script)


# --- Over a reset ------------------------------------------------------------------------------------------

PROGRAM_WHOSE_POWER_FAILS = """
#include <stdio.h>
#include <string.h>

static uint8_t memory[2][MCP_ASDF_IMAGE_SIZE];
static unsigned bytes_left; /* until the power fails */

void board_store(uint8_t copy, const uint8_t image[MCP_ASDF_IMAGE_SIZE])
{
    for (unsigned i = 0; i < MCP_ASDF_IMAGE_SIZE && bytes_left > 0; ++i, --bytes_left) {
        memory[copy][i] = image[i];
    }
}

void board_load(uint8_t copy, uint8_t image[MCP_ASDF_IMAGE_SIZE])
{
    memcpy(image, memory[copy], MCP_ASDF_IMAGE_SIZE);
}

int main(void)
{
    static const mcp_asdf_config_t config = {0, 1, MCP_ASDF_MEMORY_MAX, MCP_ASDF_ROBUST};
    const unsigned all_bytes = 2 * MCP_ASDF_IMAGE_SIZE;
    mcp_asdf_t robot, restarted;
    memset(memory, 0xFF, sizeof memory);
    if (begin(&robot, &config, 3, 0xC0000000) != MCP_ASDF_OK || mcp_asdf_t_count(&robot) != 0) {
        return 1;
    }
    for (unsigned written = 0; written <= all_bytes; ++written) {
        bytes_left = all_bytes;
        keep(&robot);
        mcp_asdf_step(&robot, MCP_ASDF_BLACK);
        bytes_left = written;
        keep(&robot);
        begin(&restarted, &config, 3, 0xC0000000);
        printf("%lu ", (unsigned long)(mcp_asdf_t_count(&robot) - mcp_asdf_t_count(&restarted)));
    }
    /* A robot of another id begins anew, whatever is stored. */
    return begin(&restarted, &config, 4, 0x40000000) != MCP_ASDF_OK || mcp_asdf_id(&restarted) != 4 ||
           mcp_asdf_t_count(&restarted) != 0 || mcp_asdf_b_hat(&restarted) != 0x40000000;
}
"""


def test_a_robot_loses_one_observation_at_most_if_the_power_fails_while_it_is_saved(tmp_path: Path) -> None:
    """Its state is saved in two copies of 156 bytes. The power fails after each number of bytes.

    A program prints how many observations are lost: one until the first copy is complete, then none.
    """
    (tmp_path / "main.c").write_text(block_with(PAGE, "board_store", "c") + PROGRAM_WHOSE_POWER_FAILS)
    sources = [tmp_path / "main.c", CORE, CORE.with_name("mcp_asdf_image.c")]
    run("cc", "-std=c99", *WARNINGS.split(), f"-I{CORE.parent}", *sources, "-o", tmp_path / "robot")

    printed_numbers = run(tmp_path / "robot").split()
    lost_observations = [int(number) for number in printed_numbers]

    while_first_copy_is_written = [1] * 156  # the power fails after 0 to 155 bytes
    from_its_end_on = [0] * 157  # after 156 to 312 bytes
    assert lost_observations == while_first_copy_is_written + from_its_end_on


# --- On an ATmega328P ------------------------------------------------------------------------------------

AVR_PACKAGES = "gcc-avr avr-libc libsimavr-dev"
UART_STATE, DOUBLE_SPEED_BIT = 0xC0, 2
UART_DIVISOR = 0xC4
"""Registers of the chip; the divisor has two bytes, the lower one first."""


@dataclass(frozen=True)
class AvrBoard:
    """A board with an ATmega328P.

    Attributes:
        clock: Frequency of the chip, in Hz.
        baud: Bits a second on its serial line.
        macros: What the page adds to the command that builds an image for the Uno.
    """

    clock: int
    baud: int
    macros: tuple[str, ...] = ()


UNO = AvrBoard(clock=16_000_000, baud=115_200)
KILOBOT = AvrBoard(clock=8_000_000, baud=38_400, macros=tuple(re.findall(r"-D(?:F_CPU|BAUD)=\w+", TEXT)))


@pytest.fixture(
    scope="module",
    params=[pytest.param(KILOBOT, id="Kilobot"), pytest.param(UNO, id="Uno", marks=pytest.mark.slow)],
)
def avr_image(
    request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory
) -> tuple[AvrBoard, Path]:
    """A board, and the image of the robot that the page's command builds for it."""
    board: AvrBoard = request.param
    require("avr-gcc", AVR_PACKAGES)
    folder = tmp_path_factory.mktemp("avr")
    (folder / "c_ref").symlink_to(ROOT / "c_ref")
    (folder / "tables").symlink_to(ROOT / "tables")
    command = block_with(PAGE, "avr-gcc", "console").replace("\\\n", " ")
    run(*command.split(), *WARNINGS.split(), *board.macros, cwd=folder)
    return board, folder / "robot.elf"


def test_the_robot_leaves_a_third_of_the_flash_and_most_of_the_memory_of_an_atmega(
    avr_image: tuple[AvrBoard, Path],
) -> None:
    """The chip has 32 KB of flash and 2 KB of memory, of which the robot takes less than 320 bytes."""
    _board, image = avr_image

    sizes = section_sizes("avr-", image)

    bytes_of_flash = sizes.code + sizes.variables_with_values  # the values are copied from flash at the start
    bytes_of_memory = sizes.variables_with_values + sizes.zeroed_variables
    flash_of_chip = 32 * 1024
    assert bytes_of_flash < 2 / 3 * flash_of_chip
    assert bytes_of_memory < 320


def play_script(robot: Board, board: AvrBoard, script: list[ScriptedTick]) -> None:
    """Run a script of ten ticks a second, with bytes as fast as the serial line can bring them."""
    cycles_of_a_tick = board.clock // 10
    bytes_a_second = board.baud // 10  # a byte has ten bits on the line
    cycles_of_a_byte = board.clock // bytes_a_second
    end_of_tick = cycles_of_a_tick // 2  # half a tick away from the robot's own
    robot.run_until(end_of_tick)
    for tick in script:
        for byte in NOISE.join(tick.packets):
            robot.receive_byte(byte)
            robot.run_until(robot.cycle + cycles_of_a_byte)
        robot.place_on_tile(tick.tile)
        end_of_tick += cycles_of_a_tick
        robot.run_until(end_of_tick)


def test_the_robot_on_an_atmega_sends_what_the_robot_in_python_sends(
    avr_image: tuple[AvrBoard, Path],
) -> None:
    """It uses the chip's own timer, analogue-to-digital converter and interrupt of the serial line.

    The chip is simulated. In each of 60 ticks up to 5 packets are sent to it.
    """
    require_simavr()
    board, image = avr_image
    tiles = (WHITE, BLACK, BLACK)
    script = draw_script(seed=7, ticks=60, draw_tile_from=tiles, max_packets_in_a_tick=5)
    sent_bytes = bytearray()
    robot = Board(image, board.clock, on_sent_byte=sent_bytes.append)

    play_script(robot, board, script)

    assert sent_bytes == expected_output(script)


def test_the_robot_sets_its_serial_port_to_the_speed_of_the_line(avr_image: tuple[AvrBoard, Path]) -> None:
    """By the chip's manual a bit takes 16 cycles, or 8 at double speed, times a divisor.

    A register has the divisor less 1. A receiver bears an error of 2.5 %.
    """
    require_simavr()
    board, image = avr_image
    bytes_that_do_not_matter = bytearray()
    robot = Board(image, board.clock, on_sent_byte=bytes_that_do_not_matter.append)

    robot.run_until(board.clock // 10)  # a tenth of a second, in which it starts

    bits_per_second = board.clock / cycles_of_a_bit(robot)
    assert bits_per_second == pytest.approx(board.baud, rel=0.025)


def cycles_of_a_bit(robot: Board) -> int:
    """Return how many cycles of the clock a bit takes on the robot's serial line, by its registers."""
    low_byte, high_byte = robot.registers[UART_DIVISOR : UART_DIVISOR + 2]
    divisor = int(low_byte) + 256 * int(high_byte) + 1
    has_double_speed = ord(robot.registers[UART_STATE]) & DOUBLE_SPEED_BIT
    return (8 if has_double_speed else 16) * divisor


# --- A Kilobot --------------------------------------------------------------------------------------------

READ_X = "uint32_t read_x(void) { return mcp_asdf_x(&robot); }\n"
"""Function behind the page's robot; kilobot/kilolib.h declares it."""
TICKS_OF_A_ROUND = 32
KEPT_MESSAGES = 8
"""Messages that a Kilobot keeps until its loop runs."""
NO_LIGHT = -1
"""What kilolib returns if the light cannot be measured."""


class Kilobot:
    """The page's robot on a simulated ATmega328P, whose functions are called as kilolib calls them."""

    def __init__(self, machine: Any, robot_id: int) -> None:
        self.machine = machine
        self.set_variable("kilo_uid", robot_id.to_bytes(2, "little"))
        self.machine.call("main")

    def set_variable(self, name: str, value: bytes) -> None:
        """Set a variable of kilobot/kilolib.h."""
        self.machine.write(self.machine.image.address(name), value)

    def broadcast(self) -> bytes:
        """Return the message that the robot sends now."""
        address = self.machine.call("message_tx").value >> 16  # a pointer, in the upper half of 32 bits
        bytes_of_message = 12
        return bytes(self.machine.read(address, bytes_of_message))

    def receive(self, message: bytes) -> None:
        """Let the robot receive a message from a robot nearby."""
        self.set_variable("kilo_heard", message)
        bytes_of_pointer = 2
        message_pointer = (self.machine.image.address("kilo_heard"), bytes_of_pointer)
        no_distance = (0, bytes_of_pointer)
        self.machine.call("message_rx", message_pointer, no_distance)

    def run_loop(self, tick: int, light: int) -> int:
        """Run the robot's loop at a tick and in a light, and return x."""
        self.set_variable("kilo_ticks", tick.to_bytes(4, "little"))
        self.set_variable("kilo_light", light.to_bytes(2, "little", signed=True))
        self.machine.call("loop")
        return int(self.machine.call("read_x").value)


def kilobot_message(estimate: Estimate) -> bytes:
    """Return the message that a Kilobot makes of an estimate: node id, data, type and checksum."""
    frame = frames.encode_estimate(estimate, FORMAT)
    node_id, message_type = frame.arbitration_id & 0x7F, 0
    any_checksum = (0x34, 0x12)
    return bytes([node_id, *frame.data, message_type, *any_checksum])


NOISE_MESSAGE = b"\xff" * 12


def draw_messages(stream: random.Random) -> list[bytes]:
    """Draw messages of no, one or nine robots that are not simulated, and a message without an estimate."""
    sender_ids = stream.sample(range(7, 40), stream.choice((0, 1, 9)))
    alpha = 0x80000001  # 1.0
    estimates = [Estimate(sender, stream.randrange(2**23), alpha, transfer_id=0) for sender in sender_ids]
    return [*map(kilobot_message, estimates), NOISE_MESSAGE]


def step_twin(robot: MirrorRobot, messages: list[bytes], light: int) -> None:
    """Let the robot in Python do what a Kilobot does in a round with these messages and this light."""
    for message in messages[:KEPT_MESSAGES]:
        receive_kilobot_message(robot, message)
    robot.settle()
    if light != NO_LIGHT:
        is_black = light < 512
        robot.observe(Observation(is_black))


def receive_kilobot_message(robot: MirrorRobot, message: bytes) -> None:
    """Let the robot in Python receive a Kilobot's message, if it is an estimate."""
    empty_frame = frames.encode_estimate(Estimate(0, 0, 0, 0), FORMAT)
    frame = can.Message(arbitration_id=empty_frame.arbitration_id | message[0], data=message[1:9])
    estimate = frames.decode_estimate(frame, FORMAT)
    if isinstance(estimate, Estimate):
        robot.receive_raw(estimate.sender, estimate.x_hat, estimate.alpha)


@pytest.fixture
def kilobot(tmp_path: Path) -> Kilobot:
    """A Kilobot with the page's program and the id 5."""
    machines = pytest.importorskip("benchmarks.cost.machines", reason="unicorn is not installed: make setup")
    require("avr-gcc", AVR_PACKAGES)
    require_simavr()
    image = build_kilobot(tmp_path)
    return Kilobot(machines.AvrMachine(Image(AVR, image)), robot_id=5)


def build_kilobot(folder: Path) -> Path:
    """Build the page's program and READ_X with the firmware in a folder, and return the image."""
    program, image = folder / "kilobot.c", folder / "kilobot.elf"
    program.write_text(block_with(KILOBOT_PAGE, "kilolib.h", "c") + READ_X, encoding="utf-8")
    flags = "-mmcu=atmega328p -Os -std=gnu99 -ffunction-sections -Wl,--gc-sections -Wl,-u,read_x"
    include = (f"-I{CORE.parent}", f"-I{Path(__file__).parent / 'kilobot'}")
    sources = [*CORE.parent.glob("*.c"), TABLE, program]
    run("avr-gcc", *flags.split(), *WARNINGS.split(), *include, *sources, "-o", image)
    return image


@pytest.mark.slow
def test_a_kilobot_sends_and_believes_what_the_robot_in_python_does(kilobot: Kilobot) -> None:
    """There are 40 rounds, in each of which both receive the same messages of made-up robots.

    A Kilobot keeps the first eight until its loop runs. At the end of a round it measures the light. Below
    512 the floor is black. Some measurements fail. x is what a robot believes.
    """
    stream = random.Random(9)
    twin = MirrorRobot(Config(filter=Filter.ROBUST), 5, B_HAT / 2**32)
    for round_number in range(40):
        estimate = Estimate(twin.id, twin.x_hat_raw, twin.alpha_raw, round_number % 32)
        assert kilobot.broadcast() == kilobot_message(estimate)

        messages = draw_messages(stream)
        for message in messages:
            kilobot.receive(message)
        light = stream.choice((NO_LIGHT, 511, 511, 512, 1023))
        x = kilobot.run_loop(TICKS_OF_A_ROUND * (round_number + 1), light)

        step_twin(twin, messages, light)
        assert x == twin.x_raw
    assert twin.counters.accepted > 40, "of rounds with one and with nine messages"


@pytest.mark.slow
def test_a_kilobot_ends_a_round_after_32_ticks(kilobot: Kilobot) -> None:
    """Only then it looks at the floor, and estimates which share is black: 1/2 at first.

    ``run_loop`` returns that share, in units of 2^-23. The second round ends after 64 ticks.
    """
    half, one = 2**22, 2**23  # in units of 2^-23
    black, white = 0, 1023

    assert kilobot.run_loop(tick=31, light=black) == half
    assert kilobot.run_loop(tick=32, light=black) == one
    assert kilobot.run_loop(tick=63, light=white) == one
    assert kilobot.run_loop(tick=64, light=white) < one
