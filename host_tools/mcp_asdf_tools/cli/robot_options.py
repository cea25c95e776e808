"""Options of one robot and of the formats of its frames, for the commands node and radio."""

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

_ROBOT_PARAMETERS = ("filter", "activation", "comms_period", "filter_period", "omega", "memory")
"""Parameters of a population that are settings of each of its robots."""

_DEFAULT_SUBJECTS = Subjects()


def add_robot_options(parser: argparse.ArgumentParser, firmware: str, id_help: str) -> None:
    """Add the options of a robot; ``firmware`` is the default one, and ``id_help`` the help of ``--id``."""
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
    add_parameters(parser, Population, "robot's configuration", _ROBOT_PARAMETERS)


def robot_of(args: argparse.Namespace) -> RobotSetup:
    """Return the robot that the options describe, checked by making it once.

    Raises UsageError for a value out of range and for options that contradict each other.
    """
    neighbours = MAX_ID if args.neighbours is None else args.neighbours
    if not 2 <= neighbours <= MAX_ID:
        raise UsageError(f"--neighbours is {neighbours}; it must be 2 to {MAX_ID}")
    robot_args = argparse.Namespace(**{name: getattr(args, name) for name in _ROBOT_PARAMETERS})
    # Options and checks are those of a population, so the robot is taken from one in which it has all the
    # neighbours that its t-table is made for. It is the flawed one, since asdf-minus is for these alone.
    population = settings_from(robot_args, Population, robots=neighbours + 1, flawed=1)
    config = population.config(0)
    if config.table is None and args.neighbours is not None:
        raise UsageError("--neighbours would do nothing: the robot uses no t-table; leave it out")
    robot_setup = RobotSetup(args.id, args.firmware, args.b_hat, config, population.comms_period)
    try:
        robot_setup.make_robot()
    except FirmwareError as error:
        raise UsageError(str(error)) from error
    return robot_setup


def swarm_filter_of(args: argparse.Namespace) -> SwarmFilter:
    """Return the filter that ``--filter`` names, or the default where the option was not given."""
    return FILTERS[args.filter or parameters_of(Population)["filter"].default]


def add_subject_options(parser: argparse.ArgumentParser) -> None:
    """Add the options of the formats of estimates, telemetry and commands."""
    group = parser.add_argument_group("frames")
    estimates, telemetry, commands = (
        _DEFAULT_SUBJECTS.estimates,
        _DEFAULT_SUBJECTS.telemetry,
        _DEFAULT_SUBJECTS.commands,
    )
    for option, meaning, default in (
        ("--subject", "Cyphal subject of estimates, 0 to 6143", estimates.subject),
        ("--priority", "of estimates, 0 (first) to 7", estimates.priority),
        ("--telemetry-subject", "Cyphal subject of telemetry", telemetry.subject),
        ("--command-subject", "Cyphal subject of commands", commands.subject),
    ):
        group.add_argument(
            option, type=int, metavar="N", default=default, help=f"{meaning} (default {default})"
        )


def subjects_of(args: argparse.Namespace) -> Subjects:
    """Return the formats of frames that the options describe. Raises UsageError if they are invalid."""
    return Subjects(
        FrameFormat(args.subject, args.priority),
        FrameFormat(args.telemetry_subject, _DEFAULT_SUBJECTS.telemetry.priority),
        FrameFormat(args.command_subject, _DEFAULT_SUBJECTS.commands.priority),
    )
