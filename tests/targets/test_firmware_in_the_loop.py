"""A robot's firmware on an emulated board with a serial line answers what its model in Python does."""

from __future__ import annotations

import random
import re
import shlex
import shutil
import subprocess
from collections.abc import Callable
from contextlib import ExitStack, closing
from decimal import Decimal
from functools import partial
from pathlib import Path
from socket import create_server
from typing import Any

import can
import pytest
import yaml

from benchmarks.cost.images import TARGETS, Image
from mcp_asdf.robot import Config, Filter
from mcp_asdf_tools.bus.frame_layout import Action
from mcp_asdf_tools.bus.frames import Heartbeat, decode_heartbeat
from mcp_asdf_tools.bus.slcan_server import format_frame_line, parse_frame
from mcp_asdf_tools.cli import main as cli
from mcp_asdf_tools.robots.node import RobotNode, Subjects
from mcp_asdf_tools.robots.robot_setup import RobotSetup
from mcp_asdf_tools.tables.thresholds import generate
from support import CORE, PATIENCE, ROOT, blocks, made_once, require, run, slow
from targets.c_node import SANITIZERS, WARNINGS
from targets.test_node import any_frame, command_frame

IMAGE_ID, B_HAT, FILTER_PERIOD = 3, 0.55, 5
SEED = 20261121
SLCAN = ROOT / "c_ref/ports/slcan"
PAGE = ROOT / "docs/radio.md"
QEMU = {
    "cortex-m3": "qemu-system-arm -M mps2-an385",
    "cortex-m4": "qemu-system-arm -M mps2-an386",
    "rv32imc": "qemu-system-riscv32 -bios none -M virt",
}
"""Names of toolchain files, and the boards that run their code."""
Builder = Callable[[str, Filter], Path]


@pytest.fixture(scope="module")
def image_of(tmp_path_factory: pytest.TempPathFactory) -> Builder:
    """Builds the image for a target once, or with sanitizers for this computer, where it speaks on standard
    input and output; skips the test if that is impossible here."""

    def build(target: str, filters: Filter, folder: Path) -> None:
        chosen = {"ID": IMAGE_ID, "B_HAT": B_HAT, "FILTER": filters.name, "FILTER_PERIOD": FILTER_PERIOD}
        settings = [f"-DROBOT_{name}={value}" for name, value in chosen.items()]
        if target != "host":
            settings.append(f"-DCMAKE_TOOLCHAIN_FILE={ROOT / 'c_ref/cmake'}/{target}.cmake")
        flags = WARNINGS + SANITIZERS * (target == "host")
        run("cmake", "-G", "Ninja", "-S", SLCAN, "-B", folder, *settings, CFLAGS=flags)
        run("cmake", "--build", folder)

    def image(target: str, filters: Filter) -> Path:
        require_target(target)
        name = f"loop {target} {filters.name}"
        return made_once(tmp_path_factory, name, partial(build, target, filters)) / "slcan_robot"

    return image


def require_target(name: str) -> None:
    """Skips the test where the compiler or the emulator of a target is missing."""
    require("ninja", "ninja-build")
    if name in QEMU:
        require(QEMU[name].split()[0], "qemu-system-arm qemu-system-misc")
        compiler = "riscv64-unknown-elf-gcc" if name == "rv32imc" else "arm-none-eabi-gcc"
        require(compiler, "gcc-arm-none-eabi gcc-riscv64-unknown-elf")


TABLE = generate(Decimal("0.05"), 30)


def switched_on(filters: Filter) -> RobotNode:
    """The image's robot, in plain integers."""
    return RobotNode(RobotSetup(IMAGE_ID, "mirror", B_HAT, Config(TABLE, filters, FILTER_PERIOD)))


# ---- The image once more, from the documents: the tools' server reads lines, the robot is the mirror ----

GREETING = b"\r"
_LONGEST = 26
_COMMAND = re.compile(rb"|[OCVNF]|S.|s....", re.DOTALL)


class Model:
    """The program at the other end of the serial line.

    Attributes:
        node: The robot.
        dropped: Lines that were neither a frame nor a command.
        is_open: Whether the bus is.
    """

    def __init__(self, filters: Filter) -> None:
        self._filters = filters
        self.node = switched_on(filters)
        self.dropped = 0
        self.is_open = False
        self._line = b""

    def take(self, text: bytes) -> bytes:
        """The program's answer to ``text``."""
        sent = b""
        for piece in re.findall(rb"[^\r\a]*[\r\a]|[^\r\a]+", text):
            self._line += piece
            if piece[-1:] in (b"\r", b"\a"):
                line, end, self._line = self._line[:-1], self._line[-1:], b""
                sent += self._line_ended(line) if end == b"\r" else self._drop()
        return sent

    def _line_ended(self, line: bytes) -> bytes:
        frame = parse_frame(line) if line[:1] in (b"t", b"T", b"r", b"R") else None
        if frame is None and (len(line) > _LONGEST or _COMMAND.fullmatch(line) is None):
            return self._drop()
        return self._command(line[:1]) if frame is None else self._frame(frame)

    def _frame(self, frame: can.Message) -> bytes:
        if not self.is_open:
            return b"\a"
        is_unwell = self.dropped > 0 or self.node.unsettled > 0
        answers = self.node.receive_frame(frame)
        for answer in answers:
            if isinstance(decode_heartbeat(answer), Heartbeat):
                answer.data[4] = is_unwell  # health: advisory
        return (b"Z\r" if frame.is_extended_id else b"z\r") + b"".join(map(format_frame_line, answers))

    def _command(self, command: bytes) -> bytes:
        flags = b"F%02X\r" % (8 * (self.dropped > 0))
        answer = {b"V": b"V1001\r", b"N": b"NASDF\r", b"F": flags}.get(command, b"\r")
        self.is_open = command == b"O" or (self.is_open and command != b"C")
        if command == b"O":
            self.node = switched_on(self._filters)
            answer += b"".join(map(format_frame_line, self.node.start()))
        return answer

    def _drop(self) -> bytes:
        self.dropped += 1
        return b"\a"


# ---- What hosts and noise say ----

REQUESTS = (b"\r", b"V\r", b"N\r", b"F\r", b"S8\r", b"s031C\r", b"z\r", b"Z\r", b"\a", b"C\rO\r", b"L\r")
"""Lines of hosts that are no frames, or that no host sends."""


def any_line(draw: random.Random) -> bytes:
    """A frame's, or one that is said twice, cut or spoilt, or garbage; no opening."""
    line = format_frame_line(any_frame(draw, IMAGE_ID, Subjects()))
    at = draw.randrange(len(line) - 1)
    spoilt = line[:at] + bytes([line[at] ^ 1 << draw.randrange(8)]) + line[at + 1 :]
    cut, garbage = line[: max(at, 2)] + b"\r", draw.randbytes(draw.randrange(60)) + b"?\r"
    return line if draw.random() < 0.7 else draw.choice((line[:-1] + line, cut, spoilt, garbage))


def draw_conversation(draw: random.Random) -> list[bytes]:
    """Return what a host says, piece by piece: commands of eleven ticks, before and after it opens the bus.

    Then noise and further requests; for a while only the ends of ticks get lost, or only lines were.
    """
    ticks = [
        format_frame_line(command_frame(tick, IMAGE_ID, action, Subjects()))
        for tick in range(11)
        for action in (Action.OBSERVE_BLACK, Action.SETTLE)
    ]
    without_ends_of_ticks = ticks[::2]
    noise = [b"".join(any_line(draw) for _ in range(draw.choice((1, 10, 30)))) for _ in range(100)]
    before_opening, opening = ticks[0], b"S8\rO\r"
    pieces = [
        before_opening,
        opening,
        *ticks,
        *without_ends_of_ticks,
        b"?\rC\r",
        noise[0],
        b"O\r",
        *ticks,
        *noise,
    ]
    # Not later, since one of them opens the bus anew, and the counters that are read in the end are then 0.
    for place in range(60, 120, 2):
        pieces.insert(place, draw.choice(REQUESTS))
    return pieces


def command_of_image(target: str, image: Path) -> list[str]:
    """Return the command that runs an image, on its emulated board or here, for a limited time."""
    time_limit = ["timeout", str(PATIENCE / 4)]
    if target not in QEMU:
        return [*time_limit, str(image)]
    with_serial_line = ["-display", "none", "-monitor", "none", "-serial", "stdio"]
    return [*time_limit, *QEMU[target].split(), *with_serial_line, "-kernel", str(image)]


@pytest.mark.parametrize(
    ("target", "number", "filters"),
    [
        *slow([("host", 6, Filter.ROBUST), ("host", 0, Filter.ADAPTIVE), ("host", 1, Filter.ADAPTIVE)]),
        *slow([("cortex-m3", 2, Filter.ADAPTIVE), ("cortex-m3", 7, Filter.ROBUST)]),
        *slow([("rv32imc", 3, Filter.ADAPTIVE), ("cortex-m4", 5, Filter.ADAPTIVE)]),
    ],
)
def test_whatever_comes_in_the_robot_answers_what_its_model_in_python_answers(
    target: str, number: int, filters: Filter, image_of: Builder
) -> None:
    """Byte by byte, on a serial line. ``number`` makes another conversation of each case."""
    image, model = image_of(target, filters), Model(filters)
    seed = SEED + number
    pieces = draw_conversation(random.Random(seed))
    pipes: dict[str, Any] = dict.fromkeys(("stdin", "stdout", "stderr"), subprocess.PIPE)

    with subprocess.Popen(command_of_image(target, image), **pipes) as robot, ExitStack() as end:
        end.callback(robot.terminate)
        assert robot.stdin and robot.stdout
        # Before it has started, what it is sent may be lost.
        assert robot.stdout.read(len(GREETING)) == GREETING
        for place, piece in enumerate(pieces):
            robot.stdin.write(piece)
            robot.stdin.flush()
            expected = model.take(piece)
            assert robot.stdout.read(len(expected)) == expected, f"random.Random({seed}), piece {place}"
        if target == "host":
            nothing_more = (b"", b"")
            assert robot.communicate() == nothing_more
            assert robot.returncode == 0

    assert model.dropped > 30, "lines that are neither a frame nor a command"
    assert model.node.unsettled > 30, "ticks whose end was lost"
    assert model.node.obeyed > 30
    assert model.node.robot.counters.tests > 0


@pytest.mark.parametrize(
    ("name", "value"), [("ROBOT_ID", 126), ("ROBOT_FILTER_PERIOD", 0), ("ROBOT_FILTER_PERIOD", 2**32)]
)
def test_the_compiler_refuses_a_setting(name: str, value: int) -> None:
    with pytest.raises(AssertionError, match=f"{name} has to be"):
        run("cc", "-fsyntax-only", f"-I{CORE.parent}", f"-D{name}={value}", SLCAN / "slcan_robot.c")


# ---- In a swarm ----


def copy_sources(target: str, folder: Path) -> None:
    """Copy the firmware's sources into a folder; skip the test if they cannot be compiled for the target."""
    require_target(target)
    for name in ("c_ref", "tables"):
        shutil.copytree(ROOT / name, folder / name)


def find_free_port() -> str:
    """Return the number of a TCP port of this computer on which no program listens."""
    any_port = 0
    with closing(create_server(("127.0.0.1", any_port))) as server:
        _, port = server.getsockname()
    return str(port)


def replace_each(text: str, replacements: dict[str, str]) -> str:
    """Replace texts by others. Fails if one of them is not there."""
    for old, new in replacements.items():
        assert old in text
        text = text.replace(old, new)
    return text


@pytest.mark.slow
@pytest.mark.parametrize("target", ["cortex-m3", "cortex-m4", "rv32imc"])
def test_the_commands_of_docs_radio_run_a_swarm_with_an_emulated_board(target: str, tmp_path: Path) -> None:
    """All 600 broadcasts, of ten robots in 60 ticks, are those of the robots in Python.

    The commands are those of the page but for the board, the port, and a filter that runs soon. The verdict
    takes minutes, so it is left out.
    """
    copy_sources(target, tmp_path)
    [block] = [block for block in blocks(PAGE, "sh") if "build/loop" in block]
    block = replace_each(
        block,
        {
            "20001": find_free_port(),
            "cortex-m3": target,
            "qemu-system-arm -M mps2-an385": QEMU[target],
            " --steps 50": " --steps 60 --filter-period 20",
            "build/loop -D": "build/loop -DROBOT_FILTER_PERIOD=20 -D",
        },
    )
    *commands, stop_the_board = [command for command in block.splitlines() if "--verify" not in command]

    try:
        outputs = [run("sh", "-c", command, cwd=tmp_path) for command in commands]
    finally:
        run("sh", "-c", stop_the_board, cwd=tmp_path)

    assert re.search(r"\b600 +broadcasts reproduced bit for bit", outputs[-1])
    bytes_of_flash, bytes_of_variables = Image(TARGETS[-1], tmp_path / "build/loop/slcan_robot").sizes()
    assert bytes_of_flash < 8 * 1024
    assert bytes_of_variables < 1024


def read_workflow(replacements: dict[str, str] | None = None) -> Any:
    """Return the jobs of the GitHub workflow that docs/radio.md proposes, by their names.

    ``replacements`` are texts to put in place of others before the workflow is parsed.
    """
    [text] = blocks(PAGE, "yaml")
    return yaml.safe_load(replace_each(text, replacements or {}))["jobs"]


def step_named(name: str, steps: list[dict[str, str]]) -> str:
    """Return the shell commands of the step that has this name in a job of a workflow."""
    [commands] = [step["run"] for step in steps if step.get("name") == name]
    return commands


@pytest.mark.slow
def test_the_workflow_of_docs_radio_fails_on_a_wrong_image_and_leaves_a_report(tmp_path: Path) -> None:
    """Its job "emulated" builds the firmware, starts it on an emulated board, and verifies what it sends.

    Here the firmware is built for a sensor with an accuracy of 0.6, and is verified as one with 0.55. So the
    verification fails soon, and leaves a report, and a log that can be replayed. All other commands are the
    page's, but for the port; the step that installs tools, as root, is left out.
    """
    copy_sources("cortex-m3", tmp_path)
    replacements = {"20001": find_free_port(), "-B build ": "-B build -DROBOT_B_HAT=0.6 "}
    steps = read_workflow(replacements)["emulated"]["steps"]
    run("sh", "-exc", step_named("build", steps), cwd=tmp_path)

    try:
        with pytest.raises(AssertionError, match=r"FAILED: 0 of \d+ phases passed"):
            run("sh", "-exc", step_named("verify", steps), cwd=tmp_path)
    finally:
        stop_the_board = "kill $(cat qemu.pid)"
        run("sh", "-c", stop_the_board, cwd=tmp_path)

    assert "expected" in (tmp_path / "verdict.md").read_text()
    assert (tmp_path / "verdict.log.events").exists()


def test_the_workflow_of_docs_radio_uploads_the_report_also_of_a_failure() -> None:
    """The last step of its job "emulated" uploads it, whether the steps before have failed or not."""
    *_, upload = read_workflow()["emulated"]["steps"]
    assert upload["if"] == "always()"
    assert upload["with"]["path"] == "verdict.*"


def test_the_workflow_of_docs_radio_has_a_command_for_a_real_board_that_is_understood() -> None:
    """The last line of the second step of its job "board" is a ``mcp-asdf radio`` command."""
    _, second_step, *_ = read_workflow()["board"]["steps"]
    command = second_step["run"].splitlines()[-1]
    _program, _radio, *options = shlex.split(command)

    # The private functions make the parser of a command's options, as the program does.
    cli._parser_for("radio", cli._load("radio")).parse_args(options)
