"""Options of one robot and of the formats of its messages."""

from __future__ import annotations

import argparse

from mcp_asdf.robot import MAX_ID, FirmwareError
from mcp_asdf_tools.bus.frames import FrameFormat
from mcp_asdf_tools.cli.parameter_options import add_parameters, settings_from
from mcp_asdf_tools.common.errors import UsageError
from mcp_asdf_tools.common.parameters import parameters_of
from mcp_asdf_tools.robots.filters import FILTERS, SwarmFilter
from mcp_asdf_tools.robots.firmwares import firmware_names
from mcp_asdf_tools.robots.node import Subjects
from mcp_asdf_tools.robots.population import Population
from mcp_asdf_tools.robots.robot_setup import RobotSetup

_OF_ROBOT = ("filter", "activation", "comms_period", "filter_period", "omega", "memory")
"""Parameters of a population that each of its robots has."""

_SUBJECTS = Subjects()


def add_robot_options(parser: argparse.ArgumentParser, firmware: str, id_help: str) -> None:
    """Declare the options of a robot; ``firmware`` is the default."""
    group = parser.add_argument_group("robot")
    group.add_argument("--id", type=int, metavar="ID", required=True, help=id_help)
    group.add_argument(
        "--b-hat",
        type=float,
        metavar="B",
        default=0.95,
        help="accuracy that it assumes (default %(default)s)",
    )
    group.add_argument(
        "--neighbours",
        type=int,
        metavar="Q",
        help=f"neighbours that its t-table is made for, 2 to 127 (default {MAX_ID})",
    )
    group.add_argument(
        "--firmware",
        choices=firmware_names(),
        default=firmware,
        help="firmware of the robot (default %(default)s)",
    )
    add_parameters(parser, Population, "robot's configuration", _OF_ROBOT)


def robot_of(args: argparse.Namespace) -> RobotSetup:
    """The robot that the options describe. Raises UsageError if they contradict each other."""
    neighbours = MAX_ID if args.neighbours is None else args.neighbours
    if not 2 <= neighbours <= MAX_ID:
        raise UsageError(f"--neighbours is {neighbours}; it must be 2 to {MAX_ID}")
    own = argparse.Namespace(**{name: getattr(args, name) for name in _OF_ROBOT})
    swarm = settings_from(own, Population, robots=neighbours + 1, flawed=1)
    config = swarm.config(0)
    if config.table is None and args.neighbours is not None:
        raise UsageError("--neighbours would do nothing: the robot uses no t-table; leave it out")
    record = RobotSetup(args.id, args.firmware, args.b_hat, config, swarm.comms_period)
    try:
        record.make_robot()
    except FirmwareError as error:
        raise UsageError(str(error)) from error
    return record


def swarm_filter_of(args: argparse.Namespace) -> SwarmFilter:
    """Return the filter that ``--filter`` names, or the default where the option was not given."""
    return FILTERS[args.filter or parameters_of(Population)["filter"].default]


def add_subject_options(parser: argparse.ArgumentParser) -> None:
    """Declare the options of all message formats."""
    group = parser.add_argument_group("frames")
    for name, text, default in (
        ("subject", "Cyphal subject of estimates, 0 to 6143", _SUBJECTS.estimates.subject),
        ("priority", "of estimates, 0 (first) to 7", _SUBJECTS.estimates.priority),
        ("telemetry-subject", "Cyphal subject of telemetry", _SUBJECTS.telemetry.subject),
        ("command-subject", "Cyphal subject of commands", _SUBJECTS.commands.subject),
    ):
        words = f"{text} (default {default})"
        group.add_argument(f"--{name}", type=int, metavar="N", default=default, help=words)


def subjects_of(args: argparse.Namespace) -> Subjects:
    """Message formats by the options. Raises UsageError if they are invalid."""
    return Subjects(
        FrameFormat(args.subject, args.priority),
        FrameFormat(args.telemetry_subject, _SUBJECTS.telemetry.priority),
        FrameFormat(args.command_subject, _SUBJECTS.commands.priority),
    )
