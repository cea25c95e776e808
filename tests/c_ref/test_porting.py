"""The robot of docs/porting.md: the page shows it, it builds as the page says, and on a PC and an ATmega328P
it does what the mirror does, to the bit.
"""

from __future__ import annotations

import random
import re
import shutil
import subprocess
from pathlib import Path
from typing import Any

import can
import pytest

from benchmarks.cost.images import AVR, Image
from mcp_asdf.fixed_point import alpha_word_from_float
from mcp_asdf.mirror import MirrorRobot
from mcp_asdf.robot import Config, Filter, Observation
from mcp_asdf_tools.bus import frames
from mcp_asdf_tools.bus.frames import Estimate, FrameFormat, Heartbeat, Telemetry
from simulated_avr import Board, require_simavr
from support import CORE, ROOT, block_with, blocks, require, run, slow

PAGE = ROOT / "docs/porting.md"
TEXT = PAGE.read_text(encoding="utf-8")
PORTS = ROOT / "c_ref/ports"
ROBOT_ID, B_HAT = 7, 0xF3333333  # MCP_ASDF_PROBABILITY(95, 100)
ESTIMATES = FrameFormat()
MARK, SLOTS = 0x7E, 8
IMAGE_SIZE = 124
NO_TILE = 2
"""Of a script: a tick in which the sensor gives no colour."""
WARNINGS = "-Wall -Wextra -Wpedantic -Wconversion -Wsign-conversion -Wshadow -Wundef -Werror"


# --- What the robot has to send ----------------------------------------------------------------------------


def checksum(content: bytes) -> int:
    """CRC-8 with the polynomial 0x07, bit by bit as a division."""
    value = int.from_bytes(content, "big") << 8
    for bit in reversed(range(8, 8 + 8 * len(content))):
        if value >> bit & 1:
            value ^= 0x107 << (bit - 8)
    return value


def packet(frame: can.Message) -> bytes:
    content = frame.arbitration_id.to_bytes(4, "little") + bytes(frame.data)
    return bytes([MARK]) + content + bytes([checksum(content)])


Script = list[tuple[list[bytes], int]]
"""Ticks: packets that come at once before it, and what the sensor sees, 0, 1 or NO_TILE."""


def expected(ticks: Script) -> bytes:
    """What the demonstration robot sends, by the mirror; its radio's queue keeps the first packets."""
    robot = MirrorRobot(Config(filter=Filter.ROBUST), ROBOT_ID, B_HAT / 2**32)
    assert robot.b_hat_raw == B_HAT
    sent, lost = b"", 0
    for number, (packets, tile) in enumerate(ticks, 1):
        lost += max(0, len(packets) - SLOTS)
        for content in (each[1:] for each in packets[:SLOTS]):
            if checksum(content[:-1]) != content[-1]:
                lost += 1
                continue
            identifier = int.from_bytes(content[:4], "little")
            message = frames.decode_estimate(
                can.Message(arbitration_id=identifier, data=content[4:-1]), ESTIMATES
            )
            if isinstance(message, Estimate):
                robot.receive_raw(message.sender, message.x_hat, message.alpha)
        if tile != NO_TILE:
            robot.observe(Observation(tile))
        own = Estimate(ROBOT_ID, robot.x_hat_raw, robot.alpha_raw, (number - 1) % 32)
        sent += packet(frames.encode_estimate(own, ESTIMATES))
        robot.settle()
        if number % 10 == 0:
            seconds, count, updates = number // 10, (number // 10 - 1) % 32, robot.counters.updates % 256
            beat = Heartbeat(ROBOT_ID, seconds, count, vendor_status=lost % 256)
            state = Telemetry(ROBOT_ID, robot.x_raw, robot.b_hat_raw >> 8, updates, count)
            sent += packet(frames.encode_heartbeat(beat)) + packet(frames.encode_telemetry(state))
    return sent


def script(seed: int, ticks: int, tiles: tuple[int, ...], most_packets: int) -> Script:
    """A run in a swarm that sees about 70 % black, with packets that are damaged or none of ours."""
    stream = random.Random(seed)
    return [
        ([a_packet(stream) for _ in range(stream.randint(0, most_packets))], stream.choice(tiles))
        for _ in range(ticks)
    ]


def played(ticks: Script) -> bytes:
    """The script in the format of scripted_board.c, with noise between the packets."""
    contents = [(b"\x00\xff".join(packets), tile) for packets, tile in ticks]
    return b"".join(
        (bytes([NO_TILE + len(content)]) + content if content else b"") + bytes([tile])
        for content, tile in contents
    )


def a_packet(stream: random.Random) -> bytes:
    sender, x_hat = stream.choice((1, 2, 3, ROBOT_ID, 127)), round(2**23 * stream.uniform(0.6, 0.8))
    alpha = alpha_word_from_float(stream.choice((0.0, 1.0, 1e3, 1e8)))
    frame = frames.encode_estimate(Estimate(sender, x_hat, alpha, stream.randrange(32)), ESTIMATES)
    if stream.random() < 0.1:  # off the grid, too large, too small, or none
        frame.data[3:7] = stream.randbytes(4)
    if stream.random() < 0.2:  # another subject, x_hat too large, no estimate at all
        frame.arbitration_id ^= stream.choice((0, 1 << 8))
        frame.data[stream.choice((2, 6, 7))] ^= 0x80
    whole = bytearray(packet(frame))
    if stream.random() < 0.1:
        whole[stream.randrange(1, len(whole))] ^= 1 << stream.randrange(8)
    return bytes(whole)


# --- The page's promises ---------------------------------------------------------------------------------

TARGETS = {
    "host": ("gcc", "gcc"),
    "32-bit": ("gcc -m32", "gcc"),
    "Cortex-M4": ("arm-none-eabi-gcc -mcpu=cortex-m4 -mthumb", "gcc-arm-none-eabi"),
    "Cortex-M0+": ("arm-none-eabi-gcc -mcpu=cortex-m0plus -mthumb", "gcc-arm-none-eabi"),
    "RV32IMAC": ("riscv64-unknown-elf-gcc -march=rv32imac -mabi=ilp32", "gcc-riscv64-unknown-elf"),
    "ATmega328P": ("avr-gcc -mmcu=atmega328p", "gcc-avr avr-libc"),
    "s390x": ("s390x-linux-gnu-gcc", "gcc-s390x-linux-gnu libc6-dev-s390x-cross"),
}
QUICK_TARGETS = ("Cortex-M0+", "ATmega328P")
"""Targets that leave the most to helpers of their compilers."""
SLOW_TARGETS = [name for name in TARGETS if name not in QUICK_TARGETS]
PARTS = {"mcp_asdf": "method", "mcp_asdf_image": "saving", "mcp_asdf_frame": "frames"}
"""What each file is for, as the page's budget of flash says it."""
MEMORY_CALLS = re.compile(r"(__aeabi_)?mem(cpy|set|clr|move)\d?")
LONG_DIVISION_OR_FLOAT = re.compile(r"u?(div|mod|divmod)(di|ti)\d|uldivmod|ldivmod|[sdx]f\d|aeabi_[fd]")


@pytest.mark.parametrize("part", PARTS)
@pytest.mark.parametrize("target", [*QUICK_TARGETS, *slow(SLOW_TARGETS)])
def test_the_core_stands_on_its_own(target: str, part: str, tmp_path: Path) -> None:
    """No warning on any target, no 64-bit division, float, library or data that can change, and no more flash
    than the page says. Only the image needs another part: it makes robots with functions of the core.
    """
    (compiler, *flags), packages = TARGETS[target][0].split(), TARGETS[target][1]
    require(compiler, packages)
    tools, out = compiler.removesuffix("gcc"), tmp_path / "core.o"
    freestanding = ("-std=c99", "-pedantic-errors", "-ffreestanding", "-Os", *WARNINGS.split())
    run(compiler, *flags, *freestanding, "-c", CORE.with_name(f"{part}.c"), "-o", out)
    symbols = [line.split()[-2:] for line in run(f"{tools}nm", out).splitlines()]
    undefined = {name for kind, name in symbols if kind == "U"} - {"_GLOBAL_OFFSET_TABLE_"}
    foreign = {name for name in undefined if not name.startswith("__") and not MEMORY_CALLS.fullmatch(name)}
    assert foreign == ({"mcp_asdf_init", "mcp_asdf_observe"} if part == "mcp_asdf_image" else set())
    assert not [name for name in undefined if LONG_DIVISION_OR_FLOAT.search(name)]
    assert not [name for kind, name in symbols if kind in "bBdDcC"]
    text, data, bss = map(int, run(f"{tools}size", out).splitlines()[1].split()[:3])
    assert (data, bss) == (0, 0)
    (row,) = re.findall(rf"^\| flash, {PARTS[part]} \| (.*) \|$", TEXT, re.MULTILINE)
    for budget in re.findall(rf"([\d.]+) KB \({re.escape(target)}\)", row):
        assert 0.8 * float(budget) < text / 1000 <= float(budget)


def test_it_does_what_the_mirror_does(tmp_path: Path) -> None:
    """The project of the page, with a script for a board; the page shows the end of the robot."""
    robot = (PORTS / "demo.c").read_text(encoding="utf-8")
    assert robot.endswith("\n" + blocks(PAGE, "c")[0])
    (tmp_path / "mcp-asdf").symlink_to(ROOT)
    (tmp_path / "CMakeLists.txt").write_text(blocks(PAGE, "cmake")[0])
    (tmp_path / "main.c").write_text(robot)
    shutil.copy(Path(__file__).with_name("scripted_board.c"), tmp_path / "board.c")
    run(require("cmake"), "-S", tmp_path, "-B", tmp_path / "build", CFLAGS=WARNINGS)
    run("cmake", "--build", tmp_path / "build")
    ticks = script(seed=5, ticks=2500, tiles=(0, 1, 1, 2), most_packets=15)
    done = subprocess.run([tmp_path / "build/robot"], input=played(ticks), capture_output=True, check=True)
    assert done.stdout == b"?" + expected(ticks)  # after the board's greeting


# --- Over a reset ------------------------------------------------------------------------------------------

POWER_FAILS = """
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
    static const mcp_asdf_config_t config = {0, 1, MCP_ASDF_MEMORY_MAX, MCP_ASDF_OFF};
    const unsigned whole = 2 * MCP_ASDF_IMAGE_SIZE;
    mcp_asdf_t robot, found;
    memset(memory, 0xFF, sizeof memory);
    if (begin(&robot, &config, 3, 0xC0000000) != MCP_ASDF_OK || mcp_asdf_t_count(&robot) != 0) {
        return 1;
    }
    for (unsigned fails = 0; fails <= whole; ++fails) {
        bytes_left = whole;
        keep(&robot);
        mcp_asdf_step(&robot, MCP_ASDF_BLACK);
        bytes_left = fails;
        keep(&robot);
        begin(&found, &config, 3, 0xC0000000);
        printf("%lu ", (unsigned long)(mcp_asdf_t_count(&robot) - mcp_asdf_t_count(&found)));
    }
    return begin(&found, &config, 4, 0x40000000) != MCP_ASDF_OK || mcp_asdf_id(&found) != 4 ||
           mcp_asdf_t_count(&found) != 0 || mcp_asdf_b_hat(&found) != 0x40000000;
}
"""


def test_it_goes_on_whenever_the_power_fails(tmp_path: Path) -> None:
    """Observations lost after a power failure at every byte of the writing: one until a copy is whole. At the
    end both copies are, and a robot of another id begins anew in spite of them.
    """
    (tmp_path / "main.c").write_text(blocks(PAGE, "c")[1] + POWER_FAILS)
    sources = [tmp_path / "main.c", CORE, CORE.with_name("mcp_asdf_image.c")]
    run("cc", "-std=c99", *WARNINGS.split(), f"-I{ROOT}/c_ref/src", *sources, "-o", tmp_path / "robot")
    lost = [int(number) for number in run(tmp_path / "robot").split()]
    assert lost == [1] * IMAGE_SIZE + [0] * (IMAGE_SIZE + 1)


# --- The whole firmware of an ATmega328P -------------------------------------------------------------------


PACKAGES = "gcc-avr avr-libc libsimavr-dev"
CLOCKS = {"Uno": (16_000_000, 115_200), "Kilobot": (8_000_000, 38_400)}
"""Hertz of the chip and bits a second of its serial line."""
UART_STATE, DOUBLE_SPEED, UART_DIVISOR = 0xC0, 2, 0xC4
"""Registers of the chip, and a bit of the first."""
KILOBOT = re.compile(r"-D(?:F_CPU|BAUD)=\w+")
"""In the page: what to add to the command for a Kilobot."""


def avr_image(folder: Path, *macros: str) -> Path:
    """The robot's image, built by the page's command; it leaves half of the flash and most of the memory."""
    require("avr-gcc", PACKAGES)
    command = block_with(PAGE, "avr-gcc", "console")
    (folder / "c_ref").symlink_to(ROOT / "c_ref")
    (folder / "tables").symlink_to(ROOT / "tables")
    run(*command.replace("\\\n", " ").split(), *WARNINGS.split(), *macros, cwd=folder)
    image = folder / "robot.elf"
    text, data, bss = map(int, run(require("avr-size"), image).splitlines()[1].split()[:3])
    assert text + data < 15.2 * 1000 and data + bss < 300
    return image


@pytest.mark.parametrize("board", ["Kilobot", *slow(["Uno"])])
def test_it_does_the_same_on_an_atmega(board: str, tmp_path: Path) -> None:
    """With the chip's own timer, ADC and UART interrupt: ten ticks a second by the board's clock, bytes as
    fast as the line can bring them, and a UART of the line's speed.
    """
    require_simavr()
    image = avr_image(tmp_path, *(KILOBOT.findall(TEXT) if board == "Kilobot" else ()))
    clock, baud = CLOCKS[board]
    ticks, said = script(seed=7, ticks=60, tiles=(0, 1, 1), most_packets=5), bytearray()
    robot = Board(image, clock, said.append)
    now = clock // 20  # half a tick away from the robot's
    robot.run(now)
    for packets, tile in ticks:
        for byte in b"\x00\xff".join(packets):
            robot.hear(byte)
            robot.run(robot.cycle + clock // (baud // 10))
        robot.see(tile)
        now += clock // 10
        robot.run(now)
    assert said == expected(ticks)
    state, (low, high) = robot.registers[UART_STATE], robot.registers[UART_DIVISOR : UART_DIVISOR + 2]
    made = clock / (8 if ord(state) & DOUBLE_SPEED else 16) / (low + 256 * high + 1)
    assert made == pytest.approx(baud, rel=0.025)


# --- Two Kilobots ------------------------------------------------------------------------------------------

TELLING = "uint32_t told(void) { return mcp_asdf_x(&robot); }\n"
KILOBOTS, ROUND, WAITING = (5, 6), 32, 8
"""Ids, ticks of a round, and messages that a Kilobot keeps until it looks at them."""


class Kilobot:
    """The page's robot on a simulated ATmega328P, whose functions are called as kilolib calls them."""

    def __init__(self, machine: Any, own_id: int) -> None:
        self.machine = machine
        self.set("kilo_uid", own_id.to_bytes(2, "little"))
        self.machine.call("main")

    def set(self, name: str, value: bytes) -> None:
        """Set a variable of kilobot/kilolib.h."""
        self.machine.write(self.machine.image.address(name), value)

    def says(self) -> bytes:
        """The message that it broadcasts now."""
        return bytes(self.machine.read(self.machine.call("message_tx").value >> 16, 12))

    def hears(self, message: bytes) -> None:
        """A message comes, from near."""
        self.set("kilo_heard", message)
        self.machine.call("message_rx", (self.machine.image.address("kilo_heard"), 2), (0, 2))

    def loops(self, tick: int, light: int) -> int:
        """It looks at its clock and at the light; returns x."""
        self.set("kilo_ticks", tick.to_bytes(4, "little"))
        self.set("kilo_light", light.to_bytes(2, "little", signed=True))
        self.machine.call("loop")
        return int(self.machine.call("told").value)


@pytest.mark.slow
def test_two_kilobots_exchange_estimates(tmp_path: Path) -> None:
    """And hear others, of which more may come at once than they keep; now and then no light can be read."""
    machines = pytest.importorskip("benchmarks.cost.machines", reason="unicorn is not installed: make setup")
    require("avr-gcc", PACKAGES)
    require_simavr()
    code = block_with(PAGE, "kilolib.h", "c")
    (tmp_path / "kilobot.c").write_text(code + TELLING, encoding="utf-8")
    sources = [*CORE.parent.glob("*.c"), ROOT / "tables/t_table_omega05_q30.c", tmp_path / "kilobot.c"]
    flags = "-mmcu=atmega328p -Os -std=gnu99 -ffunction-sections -Wl,--gc-sections -Wl,-u,told"
    include = (f"-I{CORE.parent}", f"-I{Path(__file__).parent / 'kilobot'}")
    run("avr-gcc", *flags.split(), *WARNINGS.split(), *include, *sources, "-o", tmp_path / "kilobot.elf")
    image, draw = Image(AVR, tmp_path / "kilobot.elf"), random.Random(9)
    config = Config(filter=Filter.ROBUST)
    both = [
        (Kilobot(machines.AvrMachine(image), each), MirrorRobot(config, each, B_HAT / 2**32))
        for each in KILOBOTS
    ]
    for number in range(40):
        for (robot, mirror), (other, _) in (both, both[::-1]):
            own = Estimate(mirror.id, mirror.x_hat_raw, mirror.alpha_raw, number % 32)
            assert robot.says() == said(own)
            ids = draw.sample(range(7, 40), draw.choice((0, 1, 9)))
            strangers = [said(Estimate(each, draw.randrange(2**23), 0x80000001, 0)) for each in ids]
            heard = [other.says(), *strangers, b"\xff" * 12]
            for message in heard:
                robot.hears(message)
            for message in heard[:WAITING]:
                found = frames.decode_estimate(frame_of(message), ESTIMATES)
                if isinstance(found, Estimate):
                    mirror.receive_raw(found.sender, found.x_hat, found.alpha)
            assert robot.loops(ROUND * number + ROUND - 1, 0) == mirror.x_raw, "the round goes on"
            light = draw.choice((-1, 511, 511, 512, 1023))
            mirror.settle()
            if light >= 0:
                mirror.observe(Observation(light < 512))
            assert robot.loops(ROUND * (number + 1), light) == mirror.x_raw
    assert all(mirror.counters.repeated + mirror.counters.accepted > 40 for _, mirror in both)


def said(message: Estimate) -> bytes:
    """What a Kilobot makes of an estimate: node id, data, type and checksum."""
    frame = frames.encode_estimate(message, ESTIMATES)
    return bytes([frame.arbitration_id & 0x7F, *frame.data, 0, 0x34, 0x12])


def frame_of(message: bytes) -> can.Message:
    """The estimate's frame of a message."""
    empty = frames.encode_estimate(Estimate(0, 0, 0, 0), ESTIMATES)
    return can.Message(arbitration_id=empty.arbitration_id | message[0], data=message[1:9])
