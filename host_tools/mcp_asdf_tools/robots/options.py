"""Options of one robot and of the formats of its messages."""

from __future__ import annotations

import argparse
from collections.abc import Iterable

from mcp_asdf.robot import DEFAULT_MEMORY, MAX_ID, Filter, FirmwareError
from mcp_asdf_tools.bus import FrameFormat
from mcp_asdf_tools.common import UsageError
from mcp_asdf_tools.robots.firmwares import firmware_names
from mcp_asdf_tools.robots.node import Subjects
from mcp_asdf_tools.robots.population import Activation, Filtering, filter_of
from mcp_asdf_tools.robots.record import RobotRecord, config_as_plain
from mcp_asdf_tools.robots.rounds import TickConfig
from mcp_asdf_tools.tables import generate, parse_omega

_DEFAULTS = TickConfig()
_OMEGA = "0.05"
_SUBJECTS = Subjects()
_FILTERS = {
    Filter.OFF: {"filter": Filtering.NONE.value},
    Filter.ALWAYS: {"filter": Filtering.ASDF_PLUS.value, "activation": Activation.ALWAYS.value},
    Filter.ADAPTIVE: {"filter": Filtering.ASDF_PLUS.value},
}
"""Options of each of the firmware's filters."""


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
        "--filter",
        choices=[Filtering.NONE.value, Filtering.ASDF_PLUS.value],
        default=Filtering.ASDF_PLUS.value,
        help="whether it recalibrates (default %(default)s)",
    )
    group.add_argument(
        "--activation",
        choices=[each.value for each in Activation],
        default=Activation.ADAPTIVE.value,
        help="recalibrate if the test rejects, or always (default %(default)s)",
    )
    for name, value, text in (
        ("comms-period", _DEFAULTS.comms_period, "steps between broadcasts"),
        (
            "filter-period",
            _DEFAULTS.filter_period,
            "nominal filtering period tau, steps: a multiple of --comms-period",
        ),
    ):
        group.add_argument(
            f"--{name}", type=int, metavar="STEPS", default=value, help=f"{text} (default {value})"
        )
    group.add_argument(
        "--memory",
        type=int,
        metavar="M",
        default=DEFAULT_MEMORY,
        help="forgetting: halve t and n at so many observations, 4 k (default %(default)s)",
    )
    group.add_argument(
        "--omega",
        metavar="W",
        default=_OMEGA,
        help="of the t-table: type II error probability, above 0 and at most 0.9 (default %(default)s)",
    )
    group.add_argument(
        "--neighbours",
        type=int,
        metavar="Q",
        default=MAX_ID,
        help="of the t-table: neighbours that it is made for, 2 to 127 (default %(default)s)",
    )
    group.add_argument(
        "--firmware",
        choices=firmware_names(),
        default=firmware,
        help="firmware of the robot (default %(default)s)",
    )


def robot_of(args: argparse.Namespace) -> RobotRecord:
    """The robot that the options describe. Raises UsageError if they contradict each other."""
    filters, activation, omega = args.filter, Activation(args.activation), parse_omega(args.omega)
    if filters == Filtering.NONE.value and activation is not Activation.ADAPTIVE:
        raise UsageError("--activation would do nothing: filter is none; leave it out")
    filter_ = filter_of(filters != Filtering.NONE.value, activation)
    has_table = filter_ is Filter.ADAPTIVE
    if not has_table and (omega, args.neighbours) != (parse_omega(_OMEGA), MAX_ID):
        raise UsageError(
            "the robot runs no test: leave out --omega and --neighbours, which are of its t-table"
        )
    table = generate(omega, args.neighbours) if has_table else None
    config = TickConfig(table, filter_, args.comms_period, args.filter_period, args.memory)
    record = RobotRecord(args.id, args.firmware, args.b_hat, config)
    try:
        record.make()
    except FirmwareError as error:
        raise UsageError(str(error)) from error
    return record


def robot_arguments(robot: RobotRecord) -> list[str]:
    """Options that describe ``robot``; the inverse of ``robot_of``."""
    plain = config_as_plain(robot.config)
    table = plain.pop("table", None)
    plain |= {"id": robot.id, "b_hat": robot.b_hat, "firmware": robot.firmware}
    plain |= _FILTERS[robot.config.filter]
    if table is not None and robot.config.filter is Filter.ADAPTIVE:
        plain |= {"omega": table["omega"], "neighbours": table["q"]}
    return _options(plain.items())


def add_estimate_options(parser: argparse.ArgumentParser) -> argparse._ArgumentGroup:
    """Declare the options of the estimates' format; returns the group of options."""
    group = parser.add_argument_group("frames")
    _add_number(group, "subject", "Cyphal subject of estimates, 0 to 6143", _SUBJECTS.estimates.subject)
    _add_number(group, "priority", "of estimates, 0 (first) to 7", _SUBJECTS.estimates.priority)
    return group


def add_subject_options(parser: argparse.ArgumentParser) -> None:
    """Declare the options of all message formats."""
    group = add_estimate_options(parser)
    _add_number(group, "telemetry-subject", "Cyphal subject of telemetry", _SUBJECTS.telemetry.subject)
    _add_number(group, "command-subject", "Cyphal subject of commands", _SUBJECTS.commands.subject)


def _add_number(group: argparse._ArgumentGroup, name: str, text: str, default: int) -> None:
    group.add_argument(
        f"--{name}", type=int, metavar="N", default=default, help=f"{text} (default {default})"
    )


def format_of(subject: int, priority: int) -> FrameFormat:
    """A message format. Raises UsageError if it is invalid."""
    try:
        return FrameFormat(subject, priority)
    except ValueError as error:
        raise UsageError(str(error)) from error


def subjects_of(args: argparse.Namespace) -> Subjects:
    """Message formats by the options. Raises UsageError if they are invalid."""
    return Subjects(
        format_of(args.subject, args.priority),
        format_of(args.telemetry_subject, _SUBJECTS.telemetry.priority),
        format_of(args.command_subject, _SUBJECTS.commands.priority),
    )


def subject_arguments(subjects: Subjects) -> list[str]:
    """Options that describe ``subjects``; the inverse of ``subjects_of``."""
    plain = {
        "subject": subjects.estimates.subject,
        "priority": subjects.estimates.priority,
        "telemetry_subject": subjects.telemetry.subject,
        "command_subject": subjects.commands.subject,
    }
    return _options(plain.items())


def _options(values: Iterable[tuple[str, object]]) -> list[str]:
    """Options in one word each, so that a negative number is not taken for an option."""
    return [f"--{name.replace('_', '-')}={value}" for name, value in values]
