"""A robot's firmware image in a swarm: every byte it says on its serial line is what its mirror says."""

from __future__ import annotations

import random
import re
import shutil
import socket
import subprocess
from collections.abc import Callable, Iterator
from contextlib import suppress
from pathlib import Path

import can
import pytest

from mcp_asdf_tools.bus.frames import (
    EVERY_ROBOT,
    Action,
    Command,
    FrameFormat,
    Health,
    Heartbeat,
    Message,
    decode_heartbeat,
    encode,
    encode_command,
)
from mcp_asdf_tools.bus.slcan_server import line_of
from support import PATIENCE, ROOT, made_once, require, run, slow
from targets import matrix
from targets.firmware_loop import (
    BOARDS,
    IMAGE_ID,
    Loop,
    build,
    mirror_node,
    open_bus,
    over,
)
from targets.matrix import TARGETS
from targets.qemu import Board
from targets.slcan_model import OPENING, Model, frame_in
from targets.slow_line import SlowLine

FILTER_PERIOD = 25
SEED = 20261121
PACE = 400
SOURCES = {"mcp_asdf.c", "mcp_asdf_frame.c", "t_table_omega05_q30.c", "node.c"}
SOURCES |= {"slcan_robot.c", "slcan.c"}
LINUX = ROOT / "c_ref/ports/linux"
COMPILERS_OWN = re.compile(r"libgcc2\.c|_\w+\.o|")

Builder = Callable[[str], Path]

every_target = pytest.mark.parametrize("target", BOARDS)
one_of_each = pytest.mark.parametrize("target", ["cortex-m3", "rv32imc"])


@pytest.fixture(scope="module")
def image_of(tmp_path_factory: pytest.TempPathFactory) -> Builder:
    """Builds the image for a target, once; skips the test if that is impossible here."""

    def image(target: str) -> Path:
        require("ninja", "ninja-build")
        folder = made_once(
            tmp_path_factory, f"loop {target}", lambda folder: build(target, folder, FILTER_PERIOD)
        )
        return folder / "slcan_robot"

    return image


@pytest.fixture
def board(target: str, image_of: Builder) -> Iterator[Board]:
    require_target(target)
    with Board(BOARDS[target], image_of(target)) as running:
        yield running


def require_target(name: str) -> None:
    (target,) = (each for each in TARGETS if each.name == name)
    if target.missing():
        pytest.skip(target.missing())


class Line:
    """The serial line as a host's program has it, without python-can in between; a context manager."""

    def __init__(self, board: Board, receive_buffer: int | None = None) -> None:
        host, port = board.channel.removeprefix("socket://").split(":")
        self._socket = socket.socket()
        if receive_buffer is not None:
            self._socket.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, receive_buffer)
        self._socket.settimeout(PATIENCE)
        self._socket.connect((host, int(port)))

    def __enter__(self) -> Line:
        return self

    def __exit__(self, *_: object) -> None:
        self._socket.close()

    def send(self, text: bytes) -> None:
        self._socket.sendall(text)

    def receive(self, length: int) -> bytes:
        """Exactly so many bytes."""
        text = b""
        while len(text) < length:
            more = self._socket.recv(length - len(text))
            assert more, "the image has gone"
            text += more
        return text

    def rest(self) -> bytes:
        """All that comes until everything sent has been answered, and the answer to a last request."""
        text = b""
        self._socket.settimeout(1)
        for _ in range(int(PATIENCE)):
            self.send(b"V\r")  # it may find no room either
            with suppress(TimeoutError):
                while more := self._socket.recv(1 << 16):
                    text += more
            if text.endswith(b"V1001\r"):
                self._socket.settimeout(PATIENCE)
                return text
        raise AssertionError(f"the image does not answer; the last it said is {text[-100:]!r}")


def model() -> Model:
    return Model(lambda: mirror_node(FILTER_PERIOD))


# ---- Lockstep ----


@every_target
@pytest.mark.parametrize("ticks", [50, pytest.param(500, marks=pytest.mark.slow)])
def test_in_lockstep_every_frame_is_the_mirror_s(target: str, ticks: int, board: Board) -> None:
    with open_bus(board) as bus:
        loop = Loop(*over(bus), FILTER_PERIOD)
        loop.start()
        for _ in range(ticks):
            loop.tick()
    assert loop.compared == 1 + 2 * ticks + (ticks - 1) // 10
    assert loop.mirror.robot.counters.updates > 0, "nothing was tried that the filter does"
    assert loop.mirror.robot.counters.accepted == 9 * ticks


# ---- What hosts and noise say: a swarm's talk with everything that can go wrong on the line ----


class Talk:
    """A host that drives the robot, and neighbours, over a line with noise; all drawn from a seed."""

    def __init__(self, seed: int) -> None:
        self._random = random.Random(seed)
        self._tick = 0

    def tick(self, noise: int, loss: float = 0.0) -> bytes:
        """The lines of one tick, with ``noise`` others between them that may be anything but an opening.

        Each of its own, commands too, gets lost with the probability ``loss``.
        """
        lines = [self._command(Action(self._random.randrange(3)), self._tick)]
        lines += [self.estimate(sender) for sender in range(10) if sender != IMAGE_ID]
        lines += [self._command(Action.SETTLE, self._tick)]
        lines = [line for line in lines if self._random.random() >= loss]
        for _ in range(noise):
            lines.insert(self._random.randint(0, len(lines)), self.noise())
        self._tick += 1
        return b"".join(lines)

    def _command(self, action: Action, tick: int, target: int = IMAGE_ID) -> bytes:
        return line_of(encode_command(Command(126, tick, target, action, tick % 32)))

    def estimate(self, sender: int) -> bytes:
        x_hat, alpha = self._random.randint(0, 1 << 23), self._random.getrandbits(32)
        return line_of(encode(Message(sender, x_hat, alpha, self._tick % 32), FrameFormat()))

    def noise(self) -> bytes:
        kinds = (
            self._liar,
            self._other_frame,
            self._repeated,
            self._spoilt,
            self._cut,
            self._merged,
            self._garbage,
        )
        return self._random.choice(kinds)()

    def _liar(self) -> bytes:
        return self.estimate(self._random.randrange(128))

    def _other_frame(self) -> bytes:
        is_long, data = self._random.random() < 0.5, self._random.randbytes(self._random.randrange(9))
        identifier = self._random.getrandbits(29 if is_long else 11)
        is_remote = self._random.random() < 0.2
        return line_of(
            can.Message(
                arbitration_id=identifier,
                is_extended_id=is_long,
                is_remote_frame=is_remote,
                dlc=len(data),
                data=None if is_remote else data,
            )
        )

    def _repeated(self) -> bytes:
        """A command that comes again, early, or for another robot."""
        target = self._random.choice((IMAGE_ID, EVERY_ROBOT, 4))
        tick = self._tick + self._random.randrange(2)
        return self._command(Action(self._random.randrange(4)), tick, target)

    def _spoilt(self) -> bytes:
        line, at = bytearray(self._liar()), self._random.randrange(26)
        line[at] ^= 1 << self._random.randrange(8)
        return bytes(line)

    def _cut(self) -> bytes:
        return self._liar()[: self._random.randint(2, 25)] + b"\r"

    def _merged(self) -> bytes:
        return self._liar()[:-1] + self._liar()

    def _garbage(self) -> bytes:
        return self._random.randbytes(self._random.randrange(60)) + b"?\r"

    def request(self) -> bytes:
        """A line of a host or an adapter that is no frame."""
        requests = (
            b"\r",
            b"V\r",
            b"N\r",
            b"F\r",
            b"S8\r",
            b"s031C\r",
            b"z\r",
            b"Z\r",
            b"\a",
            b"C\rO\r",
            b"O\r",
            b"L\r",
        )
        return self._random.choice(requests)


@pytest.fixture(scope="module")
def program(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The robot for this computer, on standard input and output, built to stop at every undefined act."""
    require("ninja", "ninja-build")
    sanitize = "-fsanitize=address,undefined -fno-sanitize-recover=all"
    folder = made_once(
        tmp_path_factory, "loop host", lambda folder: build("host", folder, FILTER_PERIOD, flags=sanitize)
    )
    return folder / "slcan_robot"


@pytest.mark.parametrize("number", [0, 1, *slow([2, 3])])
def test_whatever_comes_in_the_robot_says_what_its_model_says(program: Path, number: int) -> None:
    seed = SEED + number
    talk, chance = Talk(seed), random.Random(seed)
    pieces = [b"S8\rO\r"] if number else []  # it starts with an adapter, and most go on with a host
    for _ in range(150):
        pieces += [
            talk.tick(chance.choice((0, 3, 30)), loss=chance.choice((0.0, 0.2))),
            talk.request() if chance.random() < 0.3 else b"",
        ]
    told = model()
    done = subprocess.run([program], input=b"".join(pieces), capture_output=True, check=False)
    assert (done.returncode, done.stderr) == (0, b"")
    assert done.stdout == OPENING + told.take(b"".join(pieces)), f"Talk({seed})"
    assert told.dropped > 500
    assert told.is_adapter or number == 0


def test_who_starts_with_an_adapter_answers_nobody(program: Path) -> None:
    """No answer, no frame before the adapter has agreed, and one heartbeat then."""
    talk, told = Talk(SEED), model()
    said = b"V106BB82A8\rC\rz\rx\rS\rs\rs031\r" + talk.tick(0) + b"\a\r\r\r" + b"C\rF\r" + talk.tick(0)
    done = subprocess.run([program], input=said, capture_output=True, check=True)
    assert done.stdout == OPENING + told.take(said)
    assert re.fullmatch(rb"(T1\w+\r){3}", done.stdout.removeprefix(OPENING)), done.stdout
    assert (told.is_adapter, told.dropped, told.refused) == (False, 5, 1)


@one_of_each
def test_a_lost_command_costs_its_tick_and_no_other(target: str, board: Board) -> None:
    """A settle that never comes, an observe, or both: the robot answers in every whole tick after it."""
    told, talk, opening = model(), Talk(SEED), b"S8\rO\r"
    health = list[Health]()
    with Line(board) as line:
        assert line.receive(len(OPENING)) == OPENING  # before it has started, what it is sent may be lost
        line.send(opening)
        expected = told.take(opening)
        assert line.receive(len(expected)) == expected
        for number in range(2 * FILTER_PERIOD):
            lines = talk.tick(noise=0).splitlines(keepends=True)
            kept = (lines, lines, lines[:-1], lines, lines[1:], lines[1:-1])[number % 6]
            line.send(text := b"".join(kept))
            expected = told.take(text)
            assert line.receive(len(expected)) == expected, f"tick {number}"
            frames = [frame for each in expected.split(b"\r") if (frame := frame_in(each)) is not None]
            health += [
                beat.health for each in frames if isinstance(beat := decode_heartbeat(each), Heartbeat)
            ]
            assert len(frames) >= (2, 2, 1, 2, 0, 0)[number % 6], f"tick {number}"
    assert told.node.unsettled == 8
    assert told.node.robot.counters.tests > 0
    assert health and set(health[1:]) == {Health.ADVISORY}


@pytest.mark.parametrize("target", ["cortex-m3", *slow(["rv32imc"])])
def test_a_flood_with_noise_is_dropped_counted_and_survived(target: str, board: Board) -> None:
    """A hundred lines more a tick are a thousand a second at ten ticks; here they come as fast as they go."""
    told, talk = model(), Talk(SEED)
    with Line(board) as line:
        assert line.receive(len(OPENING)) == OPENING
        for number, text in enumerate([b"S8\rO\r", *(talk.tick(noise=100) for _ in range(20)), b"F\r"]):
            line.send(text)
            expected = told.take(text)
            assert line.receive(len(expected)) == expected, f"piece {number}"
    assert told.is_open
    assert told.node.ticks >= 20
    assert told.dropped > 500
    assert expected == b"F08\r"


@pytest.mark.slow
def test_who_does_not_listen_loses_whole_lines_and_stops_nobody(image_of: Builder) -> None:
    require_target(target := "cortex-m3")
    told, talk = model(), Talk(SEED)
    with Board(BOARDS[target], image_of(target), send_buffer=4096) as board, Line(board, 4096) as line:
        line.send(b"S8\rO\r")
        expected = OPENING + told.take(b"S8\rO\r")
        for _ in range(2):
            text = talk.tick(noise=3) + 3000 * b"N\r"  # which is answered with three times as much
            line.send(text)
            expected += told.take(text)
        heard = line.rest()
        if len(heard) >= len(expected):
            pytest.skip("the computer's buffers took in every answer, so none could get lost")
        assert set(re.split(b"[\r\a]", heard)) <= {*re.split(b"[\r\a]", expected), b"V1001"}, (
            "part of a line came"
        )
        line.send(b"F\r")
        assert line.receive(4) == b"F0A\r"
        text = talk.tick(noise=0)
        line.send(text)
        expected = told.take(text)
        assert line.receive(len(expected)) == expected


# ---- On a line that does not wait ----


def slow_line(image: Path) -> SlowLine:
    """The image for Cortex-M3 on such a line, with a host that has opened the bus."""
    line = SlowLine(image)
    assert line.say(b"S8\rO\r", PACE) == OPENING + model().take(b"S8\rO\r")
    return line


@pytest.fixture
def cortex_m3(image_of: Builder) -> Path:
    require_target("cortex-m3")
    return image_of("cortex-m3")


@pytest.mark.parametrize("ticks", [4, *slow([FILTER_PERIOD + 5])])
def test_no_byte_is_lost_at_230400_baud(ticks: int, cortex_m3: Path) -> None:
    """At 25 MHz a byte takes 1085 cycles then: more than two an instruction, the interrupt's included."""
    line, told, talk = slow_line(cortex_m3), model(), Talk(SEED)
    told.take(b"S8\rO\r")
    for _ in range(ticks):
        text = talk.tick(noise=2)
        assert line.say(text, PACE) == told.take(text)
    assert told.node.robot.counters.tests == ticks // FILTER_PERIOD


def test_a_byte_that_is_overrun_costs_its_line_and_no_other(cortex_m3: Path) -> None:
    line, told, chance = slow_line(cortex_m3), model(), random.Random(SEED)
    told.take(b"S8\rO\r")
    for sender in range(20, 50):
        lines = [Talk(SEED).estimate(sender) for _ in range(3)]
        lost = chance.randrange(len(lines[0]) - 1)  # of the middle line, which keeps its end
        text = b"".join(lines) + b"F\r"
        expected = told.take(lines[0] + b"?\r" + lines[2] + b"F\r")
        assert line.say(text, PACE, late=[len(lines[0]) + lost]) == expected, lost
    assert told.dropped == 30


@pytest.mark.slow
@pytest.mark.parametrize("first", [1, 9, 12, 26])
def test_halves_of_two_lines_do_not_make_one(cortex_m3: Path, first: int) -> None:
    """27 lost bytes, one line's end and the next one's beginning, leave what looks like a line."""
    line, told, talk = slow_line(cortex_m3), model(), Talk(SEED)
    told.take(b"S8\rO\r")
    text = talk.estimate(20) + talk.estimate(21) + b"F\r"
    assert line.say(text, PACE, late=range(first, first + 27)) == told.take(b"?\rF\r")


def test_a_queue_that_overflows_costs_lines_and_nothing_else(cortex_m3: Path) -> None:
    line, talk = slow_line(cortex_m3), Talk(SEED)
    text = b"".join(talk.estimate(sender) for sender in range(10, 100))
    answers = line.say(text, pace=10)
    assert set(answers) == set(b"Z\r\a"), "every line is either a frame or dropped"
    assert 0 < answers.count(b"Z") < 90
    line.say(b"\r", PACE)  # ends what is left of the last line
    told = model()
    told.take(b"S8\r")
    for text in (b"O\r", *(talk.tick(noise=0) for _ in range(3))):
        assert line.say(text, PACE) == told.take(text)


# ---- What is in the image, and boards that do not work ----


@every_target
def test_the_image_holds_the_firmware_and_its_port(target: str, image_of: Builder) -> None:
    require_target(target)
    image = image_of(target)
    files = {symbol.name for symbol in matrix.symbols(image) if symbol["st_info"]["type"] == "STT_FILE"}
    ours = {name for name in files if not COMPILERS_OWN.fullmatch(name)}
    assert ours >= SOURCES
    assert ours - SOURCES <= {"start.c", "mps2.c", "virt.c", "virt_uart.c", "memory.c"}
    assert not ours & {path.name for path in LINUX.glob("*.c")}, "this needs no Linux"
    assert matrix.flash(image) < 8 * 1024
    assert sum(matrix.ram_sections(image).values()) < 1024


PAGE = ROOT / "docs/firmware_in_the_loop.md"


@pytest.mark.slow
def test_the_commands_of_the_page_work(tmp_path: Path) -> None:
    """The verdict takes minutes; it is left out."""
    require_target("cortex-m3")
    require("ninja", "ninja-build")
    for name in ("c_ref", "tables"):
        shutil.copytree(ROOT / name, tmp_path / name)
    (block,) = re.findall(
        r"^```sh\n(cmake .*?)^```", PAGE.read_text(encoding="utf-8"), re.DOTALL | re.MULTILINE
    )
    commands = [command for command in block.splitlines() if "--verify" not in command]
    shown = [run("sh", "-c", command, cwd=tmp_path) for command in commands]
    assert re.search(r"\b500 +broadcasts reproduced bit for bit", shown[-2])
