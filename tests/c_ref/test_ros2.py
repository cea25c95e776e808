"""The ROS 2 package of c_ref/examples: its node over stubs of rclpy, its messages and its launch file."""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import fields
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import mcp_asdf_ros.msg
import pytest
import rclpy
import yaml
from launch import LaunchContext
from launch.actions import DeclareLaunchArgument, OpaqueFunction
from mcp_asdf_ros.msg import Estimate, State
from rclpy.node import environment
from std_msgs.msg import Bool

from mcp_asdf import Config, Filter, MirrorRobot, Observation
from mcp_asdf.fixed_point import alpha_word_from_float
from support import ROOT, load_program, version_of_header

PACKAGE = ROOT / "c_ref/examples/ros2/mcp_asdf_ros"
ALPHA_100 = alpha_word_from_float(100.0)
"""The confidence 100 as the firmware has it in messages."""


ROBOT_NODE = load_program(PACKAGE / "scripts/robot_node.py")
LAUNCH_FILE = load_program(PACKAGE / "launch/swarm.launch.py")


@pytest.fixture(autouse=True)
def fresh_environment() -> Iterator[None]:
    """Forget nodes and messages of other tests."""
    environment.callbacks.clear()
    environment.published.clear()
    yield
    environment.namespace, environment.parameters = "", {}
    rclpy.spun_nodes.clear()


def start_node(robot_id: int, **parameters: Any) -> Any:
    """Start a node in the namespace of its robot, which has no filter unless a parameter says so."""
    environment.namespace = f"/robot_{robot_id}"
    environment.parameters = {"id": robot_id, "filter": "none", **parameters}
    return ROBOT_NODE.RobotNode()


def end_round(node: Any) -> None:
    """Let the node's timer expire: it publishes its estimate, which all nodes receive, and ends its round."""
    [(_, callback)] = node.timers
    callback()


# --- The node --------------------------------------------------------------------------------------------


def test_a_node_passes_tiles_and_estimates_to_its_robot_and_publishes_what_that_estimates() -> None:
    """A robot in Python that gets the same tiles and the same estimate ends with the same bits.

    The node has no filter. It publishes its own estimate before the round ends.
    """
    node = start_node(3, initial_b_hat=0.9)
    robot_in_python = MirrorRobot(Config(filter=Filter.OFF), 3, 0.9)
    estimate_of_robot_4 = Estimate(sender=4, x_hat=2**22, alpha=ALPHA_100)

    for is_black in (True, True, False):
        environment.publish("/robot_3/black", Bool(is_black))
        robot_in_python.observe(Observation(is_black))
    environment.publish("/estimates", estimate_of_robot_4)
    robot_in_python.receive_raw(4, 2**22, ALPHA_100)
    end_round(node)
    own_estimate = Estimate(sender=3, x_hat=robot_in_python.x_hat_raw, alpha=robot_in_python.alpha_raw)
    robot_in_python.settle()

    assert node.robot.state() == robot_in_python.state()
    assert environment.published["/estimates"] == [estimate_of_robot_4, own_estimate]


def test_a_node_publishes_its_state_after_each_round() -> None:
    """After one black tile it estimates that all are black. It has no filter, so b_hat stays as it was."""
    node = start_node(3, initial_b_hat=0.9)
    environment.publish("/robot_3/black", Bool(True))

    end_round(node)

    [state] = environment.published["/robot_3/state"]
    assert state.b_hat == pytest.approx(0.9)
    assert state == State(x=1.0, x_hat=1.0, b_hat=state.b_hat, observations=1)


def test_a_node_ignores_its_own_estimates() -> None:
    """It publishes and subscribes to the same topic, so the stub of ROS delivers its own message.

    If the node passed this message on, the firmware would reject it, and count it.
    """
    node = start_node(3)

    end_round(node)

    assert len(environment.published["/estimates"]) == 1
    assert node.robot.counters.rejected == 0


@pytest.mark.parametrize(
    "impossible_estimate",
    [Estimate(sender=128, alpha=ALPHA_100), Estimate(sender=4, x_hat=2**23 + 1, alpha=ALPHA_100)],
)
def test_a_node_rejects_impossible_estimates_and_goes_on(impossible_estimate: Estimate) -> None:
    """There is no robot 128, and x_hat, in units of 2^-23, is at most 1."""
    node = start_node(3)

    environment.publish("/estimates", impossible_estimate)
    end_round(node)

    [state] = environment.published["/robot_3/state"]
    assert state.rejected == 1


def test_a_node_closes_a_round_in_each_broadcast_period() -> None:
    """The period is a parameter in seconds; the node has one timer with it."""
    node = start_node(3, broadcast_period=0.5)
    [(period, _callback)] = node.timers
    assert period == 0.5


def test_a_node_with_the_paper_s_filter_re_estimates_its_accuracy() -> None:
    """It assumes an accuracy of 0.55, and has seen 20 black tiles and no white one.

    Two others are certain that three quarters are black. Then about half of its tiles should have been black,
    so it is more accurate than it assumes: in its first test of that the filter changes the accuracy once.
    """
    node = start_node(3, filter="adaptive", filter_period=1, initial_b_hat=0.55, omega=0.1, neighbours=2)
    for _ in range(20):
        environment.publish("/robot_3/black", Bool(True))
    three_quarters = 3 * 2**23 // 4  # x_hat is in units of 2^-23
    environment.publish("/estimates", Estimate(sender=1, x_hat=three_quarters, alpha=ALPHA_100))
    environment.publish("/estimates", Estimate(sender=2, x_hat=three_quarters, alpha=ALPHA_100))

    end_round(node)

    [state] = environment.published["/robot_3/state"]
    assert state.updates == 1


def test_ros_reads_the_name_of_each_filter_as_it_stands() -> None:
    """Values of parameters are YAML, in which some words are truth values."""
    names = list(ROBOT_NODE.FILTERS)
    assert [yaml.safe_load(name) for name in names] == names


@pytest.mark.parametrize(
    ("wrong_parameter", "expected_message"),
    [
        ({"id": 128}, "robot id is 128; choose 0 .. 127"),
        ({"initial_b_hat": 1.0}, "b_hat is 1.0; choose one in"),
        ({"initial_b_hat": 1}, "initial_b_hat is 1, and not float"),
        ({"filter": "off"}, "filter is 'off'; choose robust, adaptive, always, none"),
        ({"filter_period": 0}, "the firmware refuses the filter, the filter_period"),
        ({"broadcast_period": 0.0}, "broadcast_period is 0.0 seconds; choose more than 0"),
        ({"filter": "adaptive", "omega": 1.5}, "omega is 1.5; it must be above 0"),
        ({"filter": "adaptive", "neighbours": 1}, "the number of neighbours is 1; it must be 2 to 127"),
    ],
)
def test_a_node_does_not_start_with_a_wrong_parameter(
    wrong_parameter: dict[str, Any], expected_message: str, capsys: pytest.CaptureFixture[str]
) -> None:
    """Its program prints what is wrong, and ends with the code 1.

    A stub of rclpy gives the node its parameters, and lists in ``spun_nodes`` the nodes that it has run.
    """
    environment.parameters = wrong_parameter

    exit_code = ROBOT_NODE.main()

    assert exit_code == 1
    assert expected_message in capsys.readouterr().err
    assert rclpy.spun_nodes == []


def test_a_node_runs_until_ctrl_c() -> None:
    """The stub of rclpy.spin notes the node in ``spun_nodes``, and raises KeyboardInterrupt: no failure."""
    exit_code = ROBOT_NODE.main()

    assert exit_code == 0
    assert len(rclpy.spun_nodes) == 1


def test_the_docs_list_the_parameters_of_a_node_with_their_defaults() -> None:
    """docs/platforms/elsewhere.md has a table, with rows such as "| `id` | 0 |"."""
    page = (ROOT / "docs/platforms/elsewhere.md").read_text(encoding="utf-8")
    defaults = {name: str(value) for name, value in start_node(0).defaults.items()}

    rows = re.findall(r"^\| `(\w+)` \| `?([\w.]+)`? \|", page, re.MULTILINE)

    assert dict(rows) == defaults


# --- The package -----------------------------------------------------------------------------------------

PYTHON_TYPES = {"uint8": "int", "uint16": "int", "uint32": "int", "float64": "float"}


@pytest.mark.parametrize("path", sorted(PACKAGE.glob("msg/*.msg")), ids=lambda path: path.name)
def test_the_messages_of_these_tests_have_the_fields_of_those_in_ros(path: Path) -> None:
    """ROS has a line such as ``uint8 sender`` for each field. The tests have dataclasses instead."""
    types_and_names = re.findall(r"^(\w+) (\w+) ", path.read_text(encoding="utf-8"), re.MULTILINE)
    fields_in_ros = [(name, PYTHON_TYPES[ros_type]) for ros_type, name in types_and_names]

    fields_of_dataclass = fields(getattr(mcp_asdf_ros.msg, path.stem))

    assert [(field.name, field.type) for field in fields_of_dataclass] == fields_in_ros


def test_the_package_has_the_version_and_the_licence_of_the_firmware() -> None:
    """ROS reads them in package.xml."""
    manifest = ElementTree.parse(PACKAGE / "package.xml").getroot()

    assert manifest.findtext("name") == "mcp_asdf_ros"
    assert manifest.findtext("version") == version_of_header()
    assert manifest.findtext("license") == "MIT"


def test_cmake_generates_the_messages() -> None:
    """CMakeLists.txt names all files of the folder msg in one call."""
    commands = (PACKAGE / "CMakeLists.txt").read_text(encoding="utf-8")
    messages = " ".join(f"msg/{path.name}" for path in sorted(PACKAGE.glob("msg/*.msg")))
    assert f"rosidl_generate_interfaces(${{PROJECT_NAME}} {messages})" in commands


def test_cmake_installs_the_node_as_a_program() -> None:
    """``ros2 run mcp_asdf_ros robot_node`` finds it by that name in this folder."""
    commands = (PACKAGE / "CMakeLists.txt").read_text(encoding="utf-8")
    assert "scripts/robot_node.py DESTINATION lib/${PROJECT_NAME} RENAME robot_node)" in commands


# --- The launch file -------------------------------------------------------------------------------------


def launch(**arguments: str) -> list[Any]:
    """Return the nodes that the launch file starts with these arguments, and its defaults for the others."""
    *argument_declarations, function = LAUNCH_FILE.generate_launch_description().entities
    assert isinstance(function, OpaqueFunction)
    assert all(isinstance(argument, DeclareLaunchArgument) for argument in argument_declarations)
    defaults = {argument.name: argument.default_value for argument in argument_declarations}
    return function.function(LaunchContext(defaults | arguments))


def test_the_launch_file_starts_a_node_for_each_robot() -> None:
    """Each node has a namespace, such as robot_0, its id, and the filter that is given to all."""
    node_0, node_1, node_2 = launch(robots="3", filter="adaptive")

    for robot_id, node in enumerate((node_0, node_1, node_2)):
        assert (node.package, node.executable) == ("mcp_asdf_ros", "robot_node")
        assert node.namespace == f"robot_{robot_id}"
        assert node.parameters == [{"id": robot_id, "filter": "adaptive"}]


@pytest.mark.parametrize("robots", ["0", "129", "many", "2.0"])
def test_the_launch_file_refuses_a_number_of_robots_that_cannot_be(robots: str) -> None:
    """Robots have 7 bits for their ids."""
    with pytest.raises(ValueError, match="; choose 1 to 128"):
        launch(robots=robots)
