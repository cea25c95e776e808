"""Robots with the radios of c_ref/examples; stubs stand for the libraries of their boards."""

from __future__ import annotations

import ctypes
import shutil
from pathlib import Path

import pytest

from ctypes_robot import CtypesRobot
from mcp_asdf.fixed_point import alpha_word_from_float
from mcp_asdf.mirror import MirrorRobot
from mcp_asdf.robot import Config, Filter, Observation
from mcp_asdf_tools.bus import frames
from mcp_asdf_tools.bus.frames import Estimate, FrameFormat
from support import CORE, ROOT, WARNINGS, require, run

EXAMPLES = ROOT / "c_ref/examples/radios"
STUBS = ROOT / "tests/c_ref"
INCLUDES = {"esp_now": (STUBS, STUBS / "esp_now"), "crazyflie": (STUBS / "freertos", STUBS / "crazyflie")}
"""Folders with the headers that a radio includes."""
WITHOUT_FILTER = Config(filter=Filter.OFF)
ROBOT_ID = 7
ALPHA_100 = alpha_word_from_float(100.0)
"""The confidence 100 as the firmware has it in frames."""


class RadioRobot:
    """A robot with the radio of an example, and the air around it.

    Attributes:
        robot: The robot.
        library: The radio, its stub and the firmware.
    """

    def __init__(self, library_path: Path) -> None:
        """Start the robot and its radio."""
        self.library = ctypes.CDLL(str(library_path))
        self.robot = CtypesRobot(self.library, WITHOUT_FILTER, ROBOT_ID, 0.95)
        self.library.radio_start()

    def broadcast(self) -> bytes:
        """Return the message that the robot broadcasts now."""
        self.library.radio_broadcast(self.robot.memory)
        length = ctypes.c_size_t.in_dll(self.library, "air_sent_length").value
        whole_buffer = bytes((ctypes.c_uint8 * 64).in_dll(self.library, "air_sent_data"))
        return whole_buffer[:length]

    def receive(self, *messages: bytes) -> None:
        """Bring messages to the radio, then let the robot receive them."""
        for message in messages:
            self.library.air_deliver(message, len(message))
        self.library.radio_receive(self.robot.memory)

    def beta(self) -> int:
        """Return the sum of the confidences of those that the robot received in the last round."""
        return self.robot.read("beta", ctypes.c_uint64)


@pytest.fixture(scope="module")
def libraries(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    """Each radio with its stub and the firmware, as a shared library."""
    folder = tmp_path_factory.mktemp("radios")
    paths = {radio: folder / f"{radio}.so" for radio in INCLUDES}
    for radio, path in paths.items():
        build_radio(radio, path)
    return paths


def build_radio(radio: str, path: Path) -> None:
    """Build a radio, a key of INCLUDES, with its stub and the firmware, as a shared library."""
    core = [CORE, CORE.with_name("mcp_asdf_accessors.c"), CORE.with_name("mcp_asdf_frame.c")]
    stubs = [*(STUBS / radio).glob("*.c"), *(STUBS / "freertos").glob("*.c")]
    include = [option for folder in INCLUDES[radio] for option in ("-isystem", str(folder))]
    flags = ["-std=c99", *WARNINGS.split(), "-shared", "-fPIC", f"-I{CORE.parent}", *include]
    run(require("gcc", "gcc"), *flags, EXAMPLES / f"{radio}.c", *stubs, *core, "-o", path)


@pytest.fixture(params=INCLUDES)
def radio_robot(request: pytest.FixtureRequest, libraries: dict[str, Path], tmp_path: Path) -> RadioRobot:
    """A robot with each of the radios, whose variables are as they are at the start."""
    return RadioRobot(Path(shutil.copy(libraries[request.param], tmp_path)))


def message_of(estimate: Estimate) -> bytes:
    """Return the nine bytes of an estimate: the sender's id and the data of its frame."""
    return bytes([estimate.sender, *frames.encode_estimate(estimate, FrameFormat()).data])


def test_the_robot_broadcasts_the_same_bytes_as_the_robot_in_python(radio_robot: RadioRobot) -> None:
    """Its radio, ESP-NOW or a Crazyflie's, is a stub. Both observe three tiles, and number their messages."""
    robot_in_python = MirrorRobot(WITHOUT_FILTER, ROBOT_ID, b_hat=0.95)
    for message_number, is_black in enumerate([True, False, True]):
        radio_robot.robot.step(is_black)
        robot_in_python.step(Observation(is_black))

        x_hat, alpha = robot_in_python.x_hat_raw, robot_in_python.alpha_raw
        expected_message = message_of(Estimate(ROBOT_ID, x_hat, alpha, transfer_id=message_number))
        assert radio_robot.broadcast() == expected_message


def test_the_robot_receives_the_messages_of_two_others(radio_robot: RadioRobot) -> None:
    """They change what it believes, x, and its confidence in others, beta, as in the robot in Python.

    Robot 1 estimates that a quarter of the tiles is black, and robot 2 that half of them are.
    """
    quarter, half = 2**21, 2**22  # x_hat is in units of 2^-23
    robot_in_python = MirrorRobot(WITHOUT_FILTER, ROBOT_ID, b_hat=0.95)
    robot_in_python.receive_raw(1, quarter, ALPHA_100)
    robot_in_python.receive_raw(2, half, ALPHA_100)
    robot_in_python.step(Observation.BLACK)

    radio_robot.receive(
        message_of(Estimate(sender=1, x_hat=quarter, alpha=ALPHA_100, transfer_id=0)),
        message_of(Estimate(sender=2, x_hat=half, alpha=ALPHA_100, transfer_id=5)),
    )
    radio_robot.robot.step(True)

    assert radio_robot.robot.read("x") == robot_in_python.x_raw
    assert robot_in_python.beta_raw > 0
    assert radio_robot.beta() == robot_in_python.beta_raw


MESSAGE_OF_ROBOT_1 = message_of(Estimate(sender=1, x_hat=0, alpha=ALPHA_100, transfer_id=0))


@pytest.mark.parametrize(
    "wrong_message",
    [
        pytest.param(b"", id="empty"),
        pytest.param(MESSAGE_OF_ROBOT_1[:-1], id="too short"),
        pytest.param(MESSAGE_OF_ROBOT_1 + b"\0", id="too long"),
        pytest.param(b"\xff" * 9, id="not an estimate"),
        pytest.param(bytes([128]) + MESSAGE_OF_ROBOT_1[1:], id="no such id"),
        pytest.param(bytes([ROBOT_ID]) + MESSAGE_OF_ROBOT_1[1:], id="its own id"),
    ],
)
def test_the_robot_ignores_what_is_no_message_of_another_robot(
    radio_robot: RadioRobot, wrong_message: bytes
) -> None:
    """The radio receives a wrong message. beta, the sum of the confidences in received estimates, stays 0."""
    radio_robot.receive(wrong_message)
    radio_robot.robot.step(True)
    assert radio_robot.beta() == 0


def test_the_robot_loses_only_messages_that_find_the_queue_full(radio_robot: RadioRobot) -> None:
    """Its queue has room for 20 messages. 25 messages come, all from different senders.

    beta is the sum of the confidences in the received estimates. Each is 100 units of 2**24.
    """
    twenty_five_senders, half = range(10, 35), 2**22  # x_hat is in units of 2^-23
    messages = [
        message_of(Estimate(sender, x_hat=half, alpha=ALPHA_100, transfer_id=0))
        for sender in twenty_five_senders
    ]

    radio_robot.receive(*messages)
    radio_robot.robot.step(True)

    room_in_queue, confidence_of_each = 20, 100 * 2**24
    assert radio_robot.beta() == room_in_queue * confidence_of_each


@pytest.mark.parametrize("radio_robot", ["crazyflie"], indirect=True)
def test_a_crazyflie_ignores_messages_to_another_port(radio_robot: RadioRobot) -> None:
    """The stub delivers a message to port 3. beta, the sum of the confidences received, stays 0."""
    another_port, half = 3, 2**22  # x_hat is in units of 2^-23
    ctypes.c_uint8.in_dll(radio_robot.library, "air_port").value = another_port

    radio_robot.receive(message_of(Estimate(sender=1, x_hat=half, alpha=ALPHA_100, transfer_id=0)))
    radio_robot.robot.step(True)

    assert radio_robot.beta() == 0
