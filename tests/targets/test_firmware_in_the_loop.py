"""A robot's firmware on an emulated board with a serial line answers what its model in Python does."""

from __future__ import annotations

import random
import re
import shlex
import shutil
import subprocess
from collections.abc import Callable
from contextlib import closing
from dataclasses import dataclass
from decimal import Decimal
from functools import partial
from pathlib import Path
from socket import create_server
from subprocess import PIPE
from typing import Any

import can
import pytest
import yaml

from benchmarks.cost.images import TARGETS, Image
from mcp_asdf.robot import Config, Filter
from mcp_asdf_tools.bus.frame_layout import Action, Health
from mcp_asdf_tools.bus.frames import Heartbeat, decode_heartbeat
from mcp_asdf_tools.bus.slcan_server import format_frame_line, parse_frame
from mcp_asdf_tools.cli import main as cli
from mcp_asdf_tools.robots.node import RobotNode, Subjects
from mcp_asdf_tools.robots.robot_setup import RobotSetup
from mcp_asdf_tools.tables.thresholds import generate
from support import CORE, PATIENCE, ROOT, blocks, made_once, replace_each, require, run, slow
from targets.c_node import SANITIZERS, WARNINGS
from targets.test_node import any_frame, command_frame

IMAGE_ID, B_HAT, FILTER_PERIOD = 3, 0.55, 5
SLCAN = ROOT / "c_ref/ports/slcan"
PAGE = ROOT / "docs/radio.md"
QEMU = {
    "cortex-m3": "qemu-system-arm -M mps2-an385",
    "cortex-m4": "qemu-system-arm -M mps2-an386",
    "rv32imc": "qemu-system-riscv32 -bios none -M virt",
}
"""Names of toolchain files, and the boards that run their code."""
BuildImage = Callable[[str, Filter], Path]


@pytest.fixture(scope="module")
def build_image(tmp_path_factory: pytest.TempPathFactory) -> BuildImage:
    """A function that builds the robot's program, once for each target and filter.

    For the target "host", this computer, it has sanitizers, and its serial line is standard input and output.
    """

    def build(target: str, firmware_filter: Filter, folder: Path) -> None:
        settings = [
            f"-DROBOT_ID={IMAGE_ID}",
            f"-DROBOT_B_HAT={B_HAT}",
            f"-DROBOT_FILTER={firmware_filter.name}",
            f"-DROBOT_FILTER_PERIOD={FILTER_PERIOD}",
        ]
        if target != "host":
            settings.append(f"-DCMAKE_TOOLCHAIN_FILE={ROOT / 'c_ref/cmake'}/{target}.cmake")
        flags = WARNINGS + SANITIZERS * (target == "host")
        run("cmake", "-G", "Ninja", "-S", SLCAN, "-B", folder, *settings, CFLAGS=flags)
        run("cmake", "--build", folder)

    def build_once(target: str, firmware_filter: Filter) -> Path:
        require_target(target)
        name = f"loop {target} {firmware_filter.name}"
        return made_once(tmp_path_factory, name, partial(build, target, firmware_filter)) / "slcan_robot"

    return build_once


def require_target(name: str) -> None:
    """Skip the test where the compiler or the emulator of a target is missing."""
    require("ninja", "ninja-build")
    if name in QEMU:
        require(QEMU[name].split()[0], "qemu-system-arm qemu-system-misc")
        compiler = "riscv64-unknown-elf-gcc" if name == "rv32imc" else "arm-none-eabi-gcc"
        require(compiler, "gcc-arm-none-eabi gcc-riscv64-unknown-elf")


TABLE = generate(Decimal("0.05"), 30)


def new_robot(firmware_filter: Filter) -> RobotNode:
    """Return the robot in Python with the settings of the image, as it is when it is switched on."""
    return RobotNode(RobotSetup(IMAGE_ID, "mirror", B_HAT, Config(TABLE, firmware_filter, FILTER_PERIOD)))


# ---- The image once more, from the documents: the tools' server reads lines, the robot is the mirror ----

GREETING = b"\r"
_LONGEST = 26
_COMMAND = re.compile(rb"|[OCVNF]|S.|s....", re.DOTALL)


class Model:
    """The program at the robot's end of the serial line, written again in Python.

    Attributes:
        node: The robot.
        dropped: Number of lines that were neither a frame nor a command.
        is_open: Whether the host has opened the bus.
    """

    def __init__(self, firmware_filter: Filter) -> None:
        self._firmware_filter = firmware_filter
        self.node = new_robot(firmware_filter)
        self.dropped = 0
        self.is_open = False
        self._line = b""

    def answer(self, text: bytes) -> bytes:
        """Return the program's answer to bytes that need not end where a line does."""
        answers = b""
        for character in text.decode("latin-1"):
            if character == "\r":
                answers += self._end_line(self._line)
                self._line = b""
            elif character == "\a":
                answers += self._drop_line()
                self._line = b""
            else:
                self._line += character.encode("latin-1")
        return answers

    def _end_line(self, line: bytes) -> bytes:
        frame = parse_frame(line) if line[:1] in (b"t", b"T", b"r", b"R") else None
        if frame is not None:
            return self._receive(frame)
        if len(line) <= _LONGEST and _COMMAND.fullmatch(line):
            return self._obey(line[:1])
        return self._drop_line()

    def _receive(self, frame: can.Message) -> bytes:
        if not self.is_open:
            return b"\a"
        is_unwell = self.dropped > 0 or self.node.unsettled > 0
        answers = self.node.receive_frame(frame)
        for answer in answers:
            if isinstance(decode_heartbeat(answer), Heartbeat):
                answer.data[4] = (Health.ADVISORY if is_unwell else Health.NOMINAL).value
        return (b"Z\r" if frame.is_extended_id else b"z\r") + b"".join(map(format_frame_line, answers))

    def _obey(self, command: bytes) -> bytes:
        if command == b"O":  # opens the bus, and starts the robot anew
            self.is_open = True
            self.node = new_robot(self._firmware_filter)
            return b"\r" + b"".join(map(format_frame_line, self.node.start()))
        if command == b"C":  # closes the bus
            self.is_open = False
        flags = 8 if self.dropped > 0 else 0  # bit 3: data were lost
        answer_by_question = {b"V": b"V1001\r", b"N": b"NASDF\r", b"F": b"F%02X\r" % flags}
        return answer_by_question.get(command, b"\r")

    def _drop_line(self) -> bytes:
        self.dropped += 1
        return b"\a"


# ---- What hosts and noise say ----

REQUESTS = (b"\r", b"V\r", b"N\r", b"F\r", b"S8\r", b"s031C\r", b"z\r", b"Z\r", b"\a", b"C\rO\r", b"L\r")
"""Lines of hosts that are no frames, or that no host sends."""


def draw_line(draw: random.Random) -> bytes:
    """Draw the line of a frame; 3 of 10 are two in one, cut, spoilt, or garbage. None opens the bus."""
    line = format_frame_line(any_frame(draw, IMAGE_ID, Subjects()))
    if draw.random() < 0.7:
        return line
    index = draw.randrange(len(line) - 1)  # not the index of the carriage return
    two_in_one = line[:-1] + line
    cut = line[: max(index, 2)] + b"\r"
    spoilt = bytearray(line)
    spoilt[index] ^= 1 << draw.randrange(8)
    garbage = draw.randbytes(draw.randrange(60)) + b"?\r"
    return draw.choice((two_in_one, cut, bytes(spoilt), garbage))


def command_line(tick: int, action: Action) -> bytes:
    """Return the line by which a host commands the robot in a tick."""
    return format_frame_line(command_frame(tick, IMAGE_ID, action, Subjects()))


def draw_conversation(draw: random.Random) -> list[bytes]:
    """Draw what a host sends, piece by piece: commands of eleven ticks, before and after it opens the bus.

    Later the commands that end ticks get lost, and noise and requests of other hosts come.
    """
    whole_ticks, ticks_without_end = [], []
    for tick in range(11):
        observe_line = command_line(tick, Action.OBSERVE_BLACK)
        whole_ticks += [observe_line, command_line(tick, Action.SETTLE)]
        ticks_without_end.append(observe_line)
    noise = [b"".join(draw_line(draw) for _ in range(draw.choice((1, 10, 30)))) for _ in range(100)]
    before_opening, opening, closing = whole_ticks[0], b"S8\rO\r", b"?\rC\r"
    pieces = [before_opening, opening, *whole_ticks, *ticks_without_end, closing, noise[0]]
    pieces += [b"O\r", *whole_ticks, *noise]
    # Not later: one request opens the bus anew, which would set the counters that are read at the end to 0.
    for index in range(60, 120, 2):
        pieces.insert(index, draw.choice(REQUESTS))
    return pieces


def command_of_image(target: str, image: Path) -> list[str]:
    """Return the command that runs an image, on its emulated board or here, for a limited time."""
    time_limit = ["timeout", str(PATIENCE / 4)]
    if target not in QEMU:
        return [*time_limit, str(image)]
    with_serial_line = ["-display", "none", "-monitor", "none", "-serial", "stdio"]
    return [*time_limit, *QEMU[target].split(), *with_serial_line, "-kernel", str(image)]


@dataclass(frozen=True)
class SerialTalk:
    """What a program has answered on its serial line.

    Attributes:
        answers: Its answer to each piece.
        rest: What it has sent after its last answer, until its input has ended.
        exit_code: Its exit code, or that of the emulator, which is stopped.
    """

    answers: list[bytes]
    rest: bytes
    exit_code: int


def talk_to(command: list[str], pieces: list[bytes], lengths_of_answers: list[int]) -> SerialTalk:
    """Run a program, send it the pieces, and read an answer of the given length after each.

    If the program ends, its last answer is shorter, and the pieces that are left are not sent.
    """
    answers = []
    with subprocess.Popen(command, stdin=PIPE, stdout=PIPE, stderr=PIPE) as robot:
        # Before it has started, what it is sent may be lost.
        assert exchange(robot, b"", len(GREETING)) == GREETING
        for piece, length in zip(pieces, lengths_of_answers, strict=True):
            answer = exchange(robot, piece, length)
            answers.append(answer)
            if len(answer) < length:
                break
        if "-kernel" in command:  # a board, which does not end with its input
            robot.terminate()
        rest, _ = robot.communicate()
    return SerialTalk(answers, rest, robot.returncode)


def exchange(robot: subprocess.Popen[bytes], piece: bytes, length_of_answer: int) -> bytes:
    """Send a piece to a program, and return its answer, which is shorter if the program ends first."""
    assert robot.stdin and robot.stdout
    robot.stdin.write(piece)
    robot.stdin.flush()
    return robot.stdout.read(length_of_answer)


CONVERSATIONS = [
    ("host", Filter.ROBUST, 20261127),
    ("host", Filter.ADAPTIVE, 20261122),
    ("cortex-m3", Filter.ADAPTIVE, 20261123),
    ("rv32imc", Filter.ADAPTIVE, 20261124),
    ("cortex-m4", Filter.ADAPTIVE, 20261126),
]
"""Target, filter, and seed of what the host sends."""


@pytest.mark.parametrize(("target", "firmware_filter", "seed"), slow(CONVERSATIONS))
def test_a_robot_on_a_serial_line_answers_every_line_as_its_model_in_python_does(
    target: str, firmware_filter: Filter, seed: int, build_image: BuildImage
) -> None:
    """The host sends frames, commands, damaged lines and noise. A seed draws them, and many of each.

    The robot is the firmware with the port that speaks slcan, the text format of serial CAN adapters. It runs
    here (target "host") or on an emulated board. ``Model`` is the same program, written again in Python. A
    tick is unsettled if the command that ends it gets lost.
    """
    pieces = draw_conversation(random.Random(seed))
    model = Model(firmware_filter)
    expected_answers = [model.answer(piece) for piece in pieces]
    assert model.dropped > 30, "lines that are neither a frame nor a command"
    assert model.node.unsettled > 30, "ticks without their end"
    assert model.node.obeyed > 30, "commands"
    assert model.node.robot.counters.tests > 0, "runs of the filter"

    command = command_of_image(target, build_image(target, firmware_filter))
    # Answers have no end by which they could be read, so as many bytes are read as are expected.
    talk = talk_to(command, pieces, lengths_of_answers=[len(answer) for answer in expected_answers])

    assert talk.answers == expected_answers, f"random.Random({seed})"
    assert talk.rest == b""


@pytest.mark.slow
def test_a_robot_on_a_serial_line_of_this_computer_ends_with_its_input(build_image: BuildImage) -> None:
    """It has answered the host's question V, for its version, with V1001, and ends with the exit code 0."""
    command = command_of_image("host", build_image("host", Filter.ROBUST))
    talk = talk_to(command, pieces=[b"V\r"], lengths_of_answers=[len(b"V1001\r")])
    assert talk == SerialTalk(answers=[b"V1001\r"], rest=b"", exit_code=0)


@pytest.mark.parametrize(
    ("name", "wrong_value"), [("ROBOT_ID", 126), ("ROBOT_FILTER_PERIOD", 0), ("ROBOT_FILTER_PERIOD", 2**32)]
)
def test_the_compiler_refuses_a_setting_that_no_robot_can_have(name: str, wrong_value: int) -> None:
    """Settings are macros. 126 and 127 are ids of tools on the bus. run() raises what the compiler prints."""
    with pytest.raises(AssertionError, match=f"{name} has to be"):
        run("cc", "-fsyntax-only", f"-I{CORE.parent}", f"-D{name}={wrong_value}", SLCAN / "slcan_robot.c")


# ---- In a swarm ----


def copy_sources(folder: Path) -> None:
    """Copy the firmware's sources into a folder; skip the test where the page's board is missing."""
    require_target("cortex-m3")
    for name in ("c_ref", "tables"):
        shutil.copytree(ROOT / name, folder / name)


def find_free_port() -> str:
    """Return the number of a TCP port of this computer on which no program listens."""
    any_port = 0
    with closing(create_server(("127.0.0.1", any_port))) as server:
        _, port = server.getsockname()
    return str(port)


def commands_for_a_swarm() -> tuple[list[str], str]:
    """Return docs/radio.md's commands that run a swarm with a board, and its command that stops the board.

    They are the page's but for the port, 60 ticks, and a filter that runs soon. The command that takes
    minutes for a verdict is left out.
    """
    [block] = [block for block in blocks(PAGE, "sh") if "build/loop" in block]
    block = replace_each(
        block,
        {
            "20001": find_free_port(),
            " --steps 50": " --steps 60 --filter-period 20",
            "build/loop -D": "build/loop -DROBOT_FILTER_PERIOD=20 -D",
        },
    )
    *commands, stop_the_board = [command for command in block.splitlines() if "--verify" not in command]
    return commands, stop_the_board


@pytest.mark.slow
def test_the_commands_of_docs_radio_run_a_swarm_with_an_emulated_board(tmp_path: Path) -> None:
    """In a swarm of ten robots one is the board. The last command repeats all broadcasts in Python.

    run() raises if a command fails. The firmware is smaller than 8 KB, and has less than 1 KB of variables.
    """
    copy_sources(tmp_path)
    commands, stop_the_board = commands_for_a_swarm()

    try:
        outputs = [run("sh", "-c", command, cwd=tmp_path) for command in commands]
    finally:
        run("sh", "-c", stop_the_board, cwd=tmp_path)

    *_, output_of_replay = outputs
    broadcasts = 10 * 60  # of ten robots in 60 ticks
    assert re.search(rf"\b{broadcasts} +broadcasts reproduced bit for bit", output_of_replay)
    *_, rv32imc = TARGETS  # whose program ``size`` also reads the images of other targets
    bytes_of_flash, bytes_of_variables = Image(rv32imc, tmp_path / "build/loop/slcan_robot").sizes()
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
    """It builds the firmware, starts it on an emulated board, and verifies what it sends.

    The firmware is built for a sensor with an accuracy of 0.6, and is verified as one with 0.55. run() raises
    if a command fails, and the command that verifies has to fail. All other commands are the page's, with
    another port. The step that installs tools, as root, is left out.
    """
    copy_sources(tmp_path)
    port_of_page, cmake_of_page = "20001", "-B build "
    replacements = {port_of_page: find_free_port(), cmake_of_page: "-B build -DROBOT_B_HAT=0.6 "}
    steps = read_workflow(replacements)["emulated"]["steps"]
    run("sh", "-exc", step_named("build", steps), cwd=tmp_path)

    try:
        with pytest.raises(AssertionError, match=r"FAILED: 0 of \d+ phases passed"):
            run("sh", "-exc", step_named("verify", steps), cwd=tmp_path)
    finally:
        stop_the_board = "kill $(cat qemu.pid)"
        run("sh", "-c", stop_the_board, cwd=tmp_path)

    report = (tmp_path / "verdict.md").read_text()
    assert "expected" in report, "the first answer that differs, beside the expected one"
    assert (tmp_path / "verdict.log.events").exists(), "so the log can be replayed"


def test_the_workflow_of_docs_radio_uploads_the_report_also_of_a_failure() -> None:
    """The last step of its job "emulated" uploads it, whether the steps before have failed or not.

    The report is files with names such as verdict.md. In GitHub's workflows always() means so.
    """
    *_, upload = read_workflow()["emulated"]["steps"]
    assert upload["if"] == "always()"
    assert upload["with"]["path"] == "verdict.*"


def test_the_tools_accept_the_command_for_a_real_board_in_the_workflow_of_docs_radio() -> None:
    """It is a ``mcp-asdf radio`` command, the last line of the second step of the job "board"."""
    _, second_step, *_ = read_workflow()["board"]["steps"]
    *_, command = second_step["run"].splitlines()
    program, subcommand, *options = shlex.split(command)
    assert (program, subcommand) == ("mcp-asdf", "radio")

    # The private functions make the parser, as the program does. It raises SystemExit for a wrong option.
    parser = cli._parser_for("radio", cli._load("radio"))
    parser.parse_args(options)
