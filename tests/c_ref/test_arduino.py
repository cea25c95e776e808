"""The Arduino sketch of c_ref/examples: it builds for an Uno, and computes what the robot in Python does."""

from __future__ import annotations

import re
import shlex
import shutil
from pathlib import Path

import pytest

from mcp_asdf.mirror import MirrorRobot
from mcp_asdf.robot import Config, Filter, Observation
from mcp_asdf_tools.bus import frames
from mcp_asdf_tools.bus.frames import Estimate, FrameFormat
from mcp_asdf_tools.cli.main import main
from packets import PACKET_SIZE, packet_of
from robots import ALPHA_ONE
from simulated_avr import Board, require_simavr
from support import ROOT, block_with, made_once, require, run

pytestmark = pytest.mark.slow

PAGE = ROOT / "docs/porting.md"
SKETCH_S_ROBOT_ID = 7
CLOCK = 16_000_000
CYCLES_OF_A_TICK = CLOCK // 2
CYCLES_OF_A_BYTE = CLOCK * 10 // 9600  # ten bits, at 9600 a second
PORT_B, LED_BIT = 0x25, 5
"""Register of the Uno's pin 13, and the bit that lights the LED there."""


def build_sketch(folder: Path) -> None:
    """Build the sketch for an Uno, with the firmware as a library, and keep all files in the folder."""
    library = folder / "libraries/mcp_asdf"
    shutil.copytree(ROOT / "c_ref", library)
    build_with_libraries(library / "examples/MinimalRobot/MinimalRobot.ino", folder)


def build_with_libraries(sketch: Path, folder: Path) -> None:
    """Build a sketch for an Uno in the folder, which has its ``libraries``."""
    (folder / "build").mkdir()
    options = [
        *("-hardware", "/usr/share/arduino-builder", "-hardware", "/usr/share/arduino/hardware"),
        *("-tools", "/usr/bin", "-libraries", folder / "libraries", "-build-path", folder / "build"),
        *("-fqbn", "arduino:avr:uno", "-warnings", "all"),
        # Debian's core asks for a macro that Debian's avr-gcc does not have in C++.
        *("-prefs", "compiler.cpp.extra_flags=-DDECIMAL_DIG=17"),
    ]
    command = shlex.join(["arduino-builder", "-compile", *map(str, options), str(sketch)])
    run("sh", "-c", f"{command} >output.txt 2>&1 || {{ cat output.txt; exit 1; }}", cwd=folder)


@pytest.fixture(scope="module")
def built_sketch(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The folder in which the sketch has been built."""
    require("arduino-builder", "arduino-builder arduino-core-avr")
    require("avr-gcc", "gcc-avr avr-libc")
    return made_once(tmp_path_factory, "sketch", build_sketch)


@pytest.fixture
def sent_packets() -> list[bytes]:
    """The packets that ``robot`` has sent so far: the list grows while the robot runs."""
    return []


@pytest.fixture
def robot(built_sketch: Path, sent_packets: list[bytes]) -> Board:
    """A simulated Uno with the sketch, half a tick after its start."""
    require_simavr()
    sent_bytes = bytearray()

    def collect_byte(byte: int) -> None:
        sent_bytes.append(byte)
        if len(sent_bytes) == PACKET_SIZE:
            sent_packets.append(bytes(sent_bytes))
            sent_bytes.clear()

    board = Board(built_sketch / "build/MinimalRobot.ino.elf", CLOCK, collect_byte)
    board.place_on_tile(0)
    board.run_until(CYCLES_OF_A_TICK // 2)
    return board


def make_sketch_s_robot_in_python() -> MirrorRobot:
    """Return the robot that the sketch makes: the robust filter, a sensor that is right 95 times in 100."""
    return MirrorRobot(Config(filter=Filter.ROBUST), SKETCH_S_ROBOT_ID, b_hat=0.95)


def send_to(robot: Board, received: bytes) -> None:
    """Let the robot's UART receive bytes, as fast as the line can bring them."""
    for byte in received:
        robot.receive_byte(byte)
        robot.run_until(robot.cycle + CYCLES_OF_A_BYTE)


def run_tick(robot: Board, tile: int) -> None:
    """Run the robot on a tile until half a tick after its next tick."""
    robot.place_on_tile(tile)
    half_a_tick = CYCLES_OF_A_TICK // 2
    half_ticks_so_far = round(robot.cycle / half_a_tick)  # instructions do not end exactly there
    robot.run_until((half_ticks_so_far + 2) * half_a_tick)


def is_led_lit(robot: Board) -> bool:
    return bool(ord(robot.registers[PORT_B]) >> LED_BIT & 1)


def test_the_sketch_builds_without_a_warning(built_sketch: Path) -> None:
    """Warnings about Debian's Arduino core, which is not ours, do not count."""
    output = (built_sketch / "output.txt").read_text(encoding="utf-8")

    complaints = re.findall(r"^.*(?:warning|error):.*$", output, re.MULTILINE)
    complaints_about_ours = [line for line in complaints if "/usr/share/arduino/" not in line]

    assert complaints_about_ours == []
    assert "Sketch uses" in output, "the line with which a build ends"


def test_the_sketch_of_docs_porting_builds_with_the_library_that_the_command_writes(tmp_path: Path) -> None:
    """The command is ``mcp-asdf firmware``; the page has sketch and robot.c. A build that fails raises."""
    require("arduino-builder", "arduino-builder arduino-core-avr")
    require("avr-gcc", "gcc-avr avr-libc")
    assert main(["firmware", str(tmp_path / "libraries/mcp_asdf"), "--neighbours", "30"]) == 0
    (tmp_path / "sketch").mkdir()
    sketch = tmp_path / "sketch/sketch.ino"
    sketch.write_text(block_with(PAGE, "sketch.ino", "cpp"))
    (tmp_path / "sketch/robot.c").write_text(block_with(PAGE, "/* robot.c */", "c"))

    build_with_libraries(sketch, tmp_path)

    output = (tmp_path / "output.txt").read_text(encoding="utf-8")
    assert "Sketch uses" in output, "the line with which a build ends"


def test_the_arduino_broadcasts_the_same_bytes_as_the_robot_in_python(
    robot: Board, sent_packets: list[bytes]
) -> None:
    """Both move over five tiles, where 1 is black and 0 white. On each tile they broadcast a packet.

    A packet has the robot's estimate, x_hat and alpha, as a frame. While the Arduino runs, its serial line
    adds what it sends to ``sent_packets``.
    """
    robot_in_python = make_sketch_s_robot_in_python()
    expected_packets = []
    for packet_number, tile in enumerate([1, 1, 0, 1, 0]):
        run_tick(robot, tile)

        robot_in_python.observe(Observation(tile))
        x_hat, alpha = robot_in_python.x_hat_raw, robot_in_python.alpha_raw
        estimate = Estimate(SKETCH_S_ROBOT_ID, x_hat, alpha, transfer_id=packet_number)
        expected_packets.append(packet_of(frames.encode_estimate(estimate, FrameFormat())))

    assert sent_packets == expected_packets


BLACK_TILE = 1
PACKET_THAT_MAKES_THE_LED_DARK = packet_of(
    frames.encode_estimate(Estimate(sender=9, x_hat=0, alpha=ALPHA_ONE, transfer_id=0), FrameFormat())
)
"""The packet of a robot that estimates that all tiles are white: x_hat, the share of black ones, is 0."""


def test_the_led_is_lit_once_the_robot_has_seen_a_black_tile(robot: Board) -> None:
    """The LED of the sketch is lit while the robot believes that more than half of the tiles are black."""
    run_tick(robot, BLACK_TILE)
    assert is_led_lit(robot)


def test_the_robot_ignores_a_packet_with_a_wrong_checksum(robot: Board) -> None:
    """The LED is lit, as the robot has seen a black tile and nothing else.

    Had it received the packet, whose sender estimates that all tiles are white, the LED would be dark.
    """
    *bytes_before, checksum = PACKET_THAT_MAKES_THE_LED_DARK
    wrong_checksum = checksum ^ 1

    send_to(robot, bytes([*bytes_before, wrong_checksum]))
    run_tick(robot, BLACK_TILE)

    assert is_led_lit(robot)


def test_the_robot_finds_the_packet_after_noise(robot: Board) -> None:
    """The packet's sender estimates that all tiles are white, and is the first to vote.

    So the LED, which would be lit without the packet, is dark.
    """
    noise = b"\x00\xff"

    send_to(robot, noise + PACKET_THAT_MAKES_THE_LED_DARK)
    run_tick(robot, BLACK_TILE)

    assert not is_led_lit(robot)
