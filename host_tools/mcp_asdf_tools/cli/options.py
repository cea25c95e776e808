"""Options that several commands share, each with the function that reads it from the parsed arguments.

An option therefore means the same in every command, and its help is written once. Options of one command
alone stand in its module. What only some of these options need is imported by their functions, so that the
``--help`` of a command is quick.
"""

from __future__ import annotations

import argparse
import os
from collections.abc import Collection
from decimal import Decimal
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

from mcp_asdf_tools.cli.parsing import describe_unknown_value, option_of
from mcp_asdf_tools.common.errors import UsageError
from mcp_asdf_tools.common.extensions import Names
from mcp_asdf_tools.common.parameters import Parameter, ParameterError, parameters_of

if TYPE_CHECKING:
    from mcp_asdf_tools.bus.frames import FrameFormat
    from mcp_asdf_tools.bus.interfaces import BusChoice
    from mcp_asdf_tools.experiments.experiment import Experiment
    from mcp_asdf_tools.experiments.results import Trials
    from mcp_asdf_tools.experiments.scores import Limits
    from mcp_asdf_tools.robots.node import Subjects
    from mcp_asdf_tools.robots.population import Population
    from mcp_asdf_tools.robots.robot_setup import RobotSetup

Settings = TypeVar("Settings", bound="Population")

# --- Options made from declared parameters ---------------------------------------------------------------

COMMON_PARAMETERS = (
    "robots",
    "topology",
    "graph",
    "fill_ratio",
    "sensor",
    "density",
    "steps_per_second",
    "steps",
    "seed",
    "flawed",
    "filter",
    "filter_period",
    "firmware",
    "trials",
)
"""Parameters that users change most; the help lists them before all others."""


def add_further_parameters(parser: argparse.ArgumentParser, settings_class: Any) -> None:
    """Add a group of options for those parameters of a class that are not COMMON_PARAMETERS."""
    further_names = parameters_of(settings_class).keys() - COMMON_PARAMETERS
    add_parameters(parser, settings_class, "further parameters", further_names)


def add_parameters(
    parser: argparse.ArgumentParser, settings_class: Any, group_title: str, parameter_names: Collection[str]
) -> None:
    """Add a group ``group_title`` of options for the named parameters of the class ``settings_class``.

    The options keep the order in which the class declares its parameters, and names that it does not declare
    are left out. The parsed value of an option that the user leaves out is None.
    """
    # The filters have more to say than fits behind an option.
    description = describe_filters() if "filter" in parameter_names else None
    group = parser.add_argument_group(group_title, description)
    add_parameters_to(group, settings_class, parameter_names)


def add_parameters_to(
    group: argparse._ArgumentGroup, settings_class: Any, parameter_names: Collection[str]
) -> None:
    """Add the options for the named parameters of the class ``settings_class`` to a group."""
    for parameter_name, parameter in parameters_of(settings_class).items():
        if parameter_name in parameter_names:
            _add_option(group, parameter)


def describe_filters() -> str:
    """Return lines for the help: a heading, and for each filter its name and which robots recalibrate."""
    from mcp_asdf_tools.robots.filters import FILTERS

    name_width = 1 + max(len(name) for name in FILTERS)
    lines = [f"  {name:{name_width}} {swarm_filter.meaning}" for name, swarm_filter in FILTERS.items()]
    return "\n".join(["Which robots recalibrate (--filter):", *lines])


def _add_option(group: argparse._ArgumentGroup, parameter: Parameter) -> None:
    """Add the option of one parameter, with its meaning and default as help."""
    help_text = parameter.meaning
    if parameter.default != "":
        help_text += f" (default {parameter.default})"
    # argparse fills in what follows a single % in a help.
    escaped_help = help_text.replace("%", "%%")
    group.add_argument(option_of(parameter.name), help=escaped_help, **_keywords_of_value(parameter))


def _keywords_of_value(parameter: Parameter) -> dict[str, Any]:
    """Return the keyword arguments of ``add_argument`` for the values of a parameter.

    They are ``choices``, or ``type`` and ``metavar``, the word for a value in the help. The type is int,
    float or a text.
    """
    if isinstance(parameter.choices, Names):
        return _keywords_of_names(parameter.choices)
    if parameter.choices:
        return {"choices": parameter.choices}
    # A value of another type, such as a count or share, is parsed by the class of the parameters.
    value_type = parameter.kind if parameter.kind in (int, float) else str
    last_word = parameter.name.split("_")[-1]
    return {"type": value_type, "metavar": last_word.upper()}  # such as PERIOD for filter_period


def _keywords_of_names(names: Names) -> dict[str, Any]:
    """Return the keyword arguments of ``add_argument`` for an option whose value is one of these names.

    The help shows the names that come with the project, such as ``{native,mirror,reference,...}``: the search
    for installed extensions would take longer than all else that it needs. Any of the names is accepted.
    """

    def check_name(name: str) -> str:
        """Return one of the names unchanged. Raises ArgumentTypeError, with the nearest, for another."""
        if name not in names:
            raise argparse.ArgumentTypeError(describe_unknown_value(name, names))
        return name

    shown_names = ",".join([*names.built_in, "..."])
    return {"type": check_name, "metavar": f"{{{shown_names}}}"}  # in braces, as argparse shows choices


def settings_from(
    args: argparse.Namespace,
    settings_class: type[Settings],
    base_values: dict[str, Any] | None = None,
    **other_values: Any,
) -> Settings:
    """Return settings of the class ``settings_class`` with the values of the options that the user gave.

    ``base_values`` hold where an option was left out; ``other_values`` hold in any case. Raises UsageError,
    which names the option, for a value that the class refuses and for an option that would have no effect.
    """
    option_values = {
        parameter_name: getattr(args, parameter_name)
        for parameter_name in parameters_of(settings_class)
        if getattr(args, parameter_name, None) is not None
    }
    try:
        # Of values for the same parameter the last one holds.
        values = (base_values or {}) | option_values | other_values
        settings = settings_class(**values)
    except ParameterError as error:
        raise UsageError(_name_option(error)) from error
    # A file's value may have no effect here; one that was typed is a misunderstanding.
    for parameter_name, reason in settings.unused_parameters().items():
        if parameter_name in option_values:
            raise UsageError(f"{option_of(parameter_name)} would do nothing: {reason}; leave it out")
    return settings


def _name_option(error: ParameterError) -> str:
    """Return the message of ``error`` with the option's name at its start, in place of the parameter's."""
    message = str(error)
    # Most messages have the parameter as their subject.
    if message.startswith(f"{error.key} "):
        return option_of(error.key) + message.removeprefix(error.key)
    return f"{option_of(error.key)}: {message}"


# --- One robot -------------------------------------------------------------------------------------------

_FILTER_PARAMETERS = ("filter", "filter_period")
_OTHER_ROBOT_PARAMETERS = ("comms_period", "memory", "omega", "activation")
_ROBOT_PARAMETERS = _FILTER_PARAMETERS + _OTHER_ROBOT_PARAMETERS
"""Parameters of a population that are settings of each of its robots."""
ROBOT_OPTIONS = ("--b-hat", "--neighbours", "--firmware", *map(option_of, _ROBOT_PARAMETERS))
"""The options that ``add_robot_options`` adds."""


def add_robot_options(group: argparse._ArgumentGroup, default_firmware: str) -> None:
    """Add to a group the options that describe one robot, which ``robot_of`` reads beside its ``--id``.

    They are ``--b-hat`` (the accuracy that it assumes), ``--neighbours`` (for its t-table), ``--firmware``
    with the default ``default_firmware``, and those of _ROBOT_PARAMETERS, such as ``--filter``.
    """
    from mcp_asdf.robot import MAX_ID
    from mcp_asdf_tools.robots.firmwares import firmware_names
    from mcp_asdf_tools.robots.population import Population

    group.add_argument(
        "--b-hat",
        type=float,
        metavar="B",
        default=0.95,
        help="accuracy that it assumes at the start, 0 to 1 (default %(default)s)",
    )
    group.add_argument(
        "--neighbours",
        type=int,
        metavar="Q",
        default=MAX_ID,
        help="neighbours for which its t-table is made, 2 to 127 (default %(default)s)",
    )
    # In two calls, for the help: within one, options come in the order that they have in Population.
    add_parameters_to(group, Population, _FILTER_PARAMETERS)
    add_parameters_to(group, Population, _OTHER_ROBOT_PARAMETERS)
    group.add_argument(
        "--firmware",
        default=default_firmware,
        help="implementation of the robot (default %(default)s)",
        **_keywords_of_names(firmware_names()),
    )


def robot_of(args: argparse.Namespace) -> RobotSetup:
    """Return the robot that the options describe, checked by making it once.

    It has a t-table only if its filter needs one, and ``--neighbours`` is refused if not. Raises UsageError
    for a value out of range and for options that contradict each other.
    """
    from mcp_asdf.robot import MAX_ID, FirmwareError
    from mcp_asdf_tools.robots.robot_setup import RobotSetup

    if not 2 <= args.neighbours <= MAX_ID:
        raise UsageError(f"--neighbours is {args.neighbours}; it must be 2 to {MAX_ID}")
    # The robot is taken from a population, so that the options mean what they mean in the command swarm.
    population = _population_around_robot(args)
    robot_in_population = 0  # the flawed robot: flawed ones are the first by id
    config = population.config(robot_in_population)
    if config.table is None and "--neighbours" in args.typed_options:
        raise UsageError("--neighbours would do nothing: the robot uses no t-table; leave it out")
    robot_setup = RobotSetup(args.id, args.firmware, args.b_hat, config, population.comms_period)
    try:
        robot_setup.make_robot()
    except FirmwareError as error:
        raise UsageError(str(error)) from error
    return robot_setup


def _population_around_robot(args: argparse.Namespace) -> Population:
    """Return the population of the robot that the options describe and of its neighbours.

    That robot is the only flawed one, since the filter asdf-minus is for flawed robots alone. Raises
    UsageError for a value out of range.
    """
    from mcp_asdf_tools.robots.population import Population

    robot_args = argparse.Namespace(**{name: getattr(args, name) for name in _ROBOT_PARAMETERS})
    return settings_from(robot_args, Population, robots=args.neighbours + 1, flawed=1)


# --- T-tables --------------------------------------------------------------------------------------------


def add_table_options(parser: argparse.ArgumentParser) -> None:
    """Add the options that describe a t-table, which ``table_of`` reads."""
    parser.add_argument(
        "--omega",
        default="0.05",
        help="set the type II error probability of the test, above 0 to 0.9, with up to 9 decimal places "
        "(default %(default)s)",
    )
    parser.add_argument(
        "--neighbours",
        metavar="Q",
        type=int,
        default=127,
        help="store exact thresholds for up to this many neighbours, 2 to 127; 4 bytes each "
        "(default %(default)s)",
    )


def table_of(args: argparse.Namespace) -> tuple[Decimal, int]:
    """Return omega and the number of neighbours q of the table that the options describe.

    Raises UsageError for an omega that no table has.
    """
    from mcp_asdf_tools.tables.thresholds import parse_omega

    return parse_omega(args.omega), args.neighbours


# --- Bus, frames and logs --------------------------------------------------------------------------------


def add_bus_options(parser: argparse.ArgumentParser) -> None:
    """Add the options of the bus, which ``bus_of`` reads: python-can's own, without those for CAN FD.

    An option that the user leaves out is no attribute of the parsed arguments.
    """
    group = parser.add_argument_group(
        "bus (default: inside this process; python-can's CAN_* variables and files also count)",
        argument_default=argparse.SUPPRESS,
    )
    group.add_argument(
        "-i",
        "--interface",
        metavar="INTERFACE",
        type=_check_interface,
        help="use this kind of bus: socketcan, slcan, udp_multicast, pcan or another of python-can's",
    )
    group.add_argument(
        "-c",
        "--channel",
        metavar="CHANNEL",
        help="use this bus of that kind, such as can0, vcan0, /dev/ttyACM0 or 239.74.163.2",
    )
    group.add_argument("-b", "--bitrate", type=int, help="set the bit rate in bit/s, if the interface can")
    group.add_argument(
        "--bus-kwargs",
        type=_parse_bus_setting,
        nargs="+",
        metavar="KEY=VALUE",
        help="pass further settings to the interface, such as app_name=MyCanApp serial=1234",
    )


def _check_interface(interface_name: str) -> str:
    """Return the name of an interface. Raises ArgumentTypeError, with the nearest, if python-can has none.

    The interfaces' names are not an option's ``choices``, since the help would load python-can for them.
    """
    import can

    if interface_name not in can.VALID_INTERFACES:
        raise argparse.ArgumentTypeError(describe_unknown_value(interface_name, sorted(can.VALID_INTERFACES)))
    return interface_name


def _parse_bus_setting(setting_text: str) -> tuple[str, str]:
    """Return name and value of a text such as ``serial=1234``. Raises ArgumentTypeError for any other."""
    setting_name, equals_sign, value = setting_text.partition("=")
    if not equals_sign:
        raise argparse.ArgumentTypeError(f"{setting_text} is no KEY=VALUE")
    return setting_name, value


def bus_of(args: argparse.Namespace) -> BusChoice:
    """Return the bus that the options describe, with python-can's own settings where they leave it open.

    Raises UsageError if python-can's variables or files cannot be read.
    """
    from mcp_asdf_tools.bus.interfaces import choose_bus

    # Options that were left out are no attributes: python-can's own settings hold for them.
    typed_settings = {
        name: getattr(args, name) for name in ("interface", "channel", "bitrate") if name in args
    }
    further_settings = dict(getattr(args, "bus_kwargs", ()))  # pairs of name and value
    return choose_bus(typed_settings | further_settings)


def add_estimate_format(group: argparse._ActionsContainer) -> None:
    """Add the options of the format of estimates, which ``estimate_format_of`` reads."""
    from mcp_asdf_tools.bus.frames import FrameFormat

    default_format = FrameFormat()
    group.add_argument(
        "--subject",
        type=int,
        metavar="N",
        default=default_format.subject,
        help="Cyphal subject of estimates, 0 to 6143 (default %(default)s)",
    )
    group.add_argument(
        "--priority",
        type=int,
        metavar="N",
        default=default_format.priority,
        help="priority of estimates, 0 (first) to 7 (default %(default)s)",
    )


def estimate_format_of(args: argparse.Namespace) -> FrameFormat:
    """Return the format of estimates that the options describe. Raises UsageError if it is invalid."""
    from mcp_asdf_tools.bus.frames import FrameFormat

    return FrameFormat(args.subject, args.priority)


def add_subject_options(parser: argparse.ArgumentParser) -> None:
    """Add the options that say by which CAN frames robots send estimates, telemetry and commands.

    These are --telemetry-subject and --command-subject, and the options of ``add_estimate_format`` for
    estimates. ``subjects_of`` reads them all.
    """
    from mcp_asdf_tools.bus.frames import COMMAND_FORMAT, TELEMETRY_FORMAT

    group = parser.add_argument_group("frames")
    add_estimate_format(group)
    group.add_argument(
        "--telemetry-subject",
        type=int,
        metavar="N",
        default=TELEMETRY_FORMAT.subject,
        help="Cyphal subject of telemetry (default %(default)s)",
    )
    group.add_argument(
        "--command-subject",
        type=int,
        metavar="N",
        default=COMMAND_FORMAT.subject,
        help="Cyphal subject of commands (default %(default)s)",
    )


def subjects_of(args: argparse.Namespace) -> Subjects:
    """Return the formats of frames that the options describe. Raises UsageError if they are invalid."""
    from mcp_asdf_tools.bus.frames import COMMAND_FORMAT, TELEMETRY_FORMAT, FrameFormat
    from mcp_asdf_tools.robots.node import Subjects

    return Subjects(
        estimate_format_of(args),
        FrameFormat(args.telemetry_subject, TELEMETRY_FORMAT.priority),
        FrameFormat(args.command_subject, COMMAND_FORMAT.priority),
    )


def add_log_option(group: argparse._ArgumentGroup, files_beside: str) -> None:
    """Add the option ``--log``; ``files_beside`` says for its help what the files beside the log hold."""
    group.add_argument(
        "--log",
        metavar="FILE",
        type=Path,
        help=f"write all frames to this file, which ends in .log, in candump's format; {files_beside}",
    )


def add_port_option(group: argparse._ActionsContainer) -> None:
    """Add the option ``--port`` of commands that serve a page."""
    group.add_argument("--port", type=int, help="serve the page at this TCP port (default: any free port)")


# --- Experiments and their results -----------------------------------------------------------------------


def add_experiment_options(parser: argparse.ArgumentParser, output_help: str) -> None:
    """Add the options of a command that runs experiments: parameters, output, limits of scores and workers.

    The parsed value of a parameter that the user leaves out is None. ``output_help`` is the help of
    ``--output``.
    """
    from mcp_asdf_tools.experiments.experiment import Experiment

    parser.add_argument("--output", metavar="FILE", type=Path, help=output_help)
    parser.add_argument(
        "--record",
        metavar="STEPS",
        type=int,
        default=0,
        help="keep the values of each robot every STEPS steps, such as 100 (default: only the scores)",
    )
    add_worker_option(parser)
    add_parameters(parser, Experiment, "experiment (values replace those of FILE)", COMMON_PARAMETERS)
    add_limit_options(parser)
    add_further_parameters(parser, Experiment)


def experiments_of(args: argparse.Namespace) -> list[Experiment]:
    """Return the experiments of FILE, or the default one without a file, with the options' parameters.

    Raises UsageError for a value out of range, and if ``--record`` is longer than a trial.
    """
    from mcp_asdf_tools.experiments.experiment import Experiment
    from mcp_asdf_tools.experiments.experiment_files import read_experiments

    if args.file is None:
        base_values: list[dict[str, Any]] = [{}]
    else:
        base_values = [experiment.parameters() for experiment in read_experiments(args.file)]
    experiments = [settings_from(args, Experiment, values) for values in base_values]
    # The experiments of a file may have trials of different lengths.
    shortest_trial = min(experiment.steps for experiment in experiments)
    if not 0 <= args.record <= shortest_trial:
        raise UsageError(f"--record is {args.record}; choose 1 to {shortest_trial} steps, or 0 for none")
    return experiments


def check_results_path(path: Path) -> None:
    """Raise UsageError unless the name of a file for results ends in .parquet."""
    if path.suffix != ".parquet":
        raise UsageError(f"cannot write results to {path}: choose a name that ends in .parquet")


def add_worker_option(parser: argparse.ArgumentParser) -> None:
    """Add the option ``--workers``, the number of processes that run trials."""
    parser.add_argument(
        "--workers",
        type=int,
        metavar="N",
        default=_count_processors(),
        help="run N processes (default %(default)s: one per processor)",
    )


def _count_processors() -> int:
    """Return how many processors this process may use: all, where the system does not say."""
    if hasattr(os, "sched_getaffinity"):  # macOS and Windows do not have it
        this_process = 0
        return len(os.sched_getaffinity(this_process))
    return os.cpu_count() or 1


def workers_of(args: argparse.Namespace) -> int:
    """Return the number of worker processes. Raises UsageError if it is not 1 to 1024."""
    workers: int = args.workers
    if not 1 <= workers <= 1024:
        raise UsageError(f"--workers is {workers}; choose 1 to 1024")
    return workers


def add_scheduler_option(parser: argparse.ArgumentParser) -> None:
    """Add the option ``--scheduler``, which runs trials on a cluster."""
    parser.add_argument(
        "--scheduler",
        metavar="ADDRESS",
        help="run on the Dask cluster of this scheduler, such as tcp://head:8786 (default: on this machine)",
    )


def add_firmware_option(parser: argparse.ArgumentParser, help_text: str) -> None:
    """Add the option ``--firmware`` without a default, for commands that do not have all parameters."""
    from mcp_asdf_tools.robots.firmwares import firmware_names

    parser.add_argument("--firmware", help=help_text, **_keywords_of_names(firmware_names()))


def add_limit_options(parser: argparse.ArgumentParser) -> None:
    """Add the options for K_max and e_max, the convergence time K and the error e that score 0."""
    from mcp_asdf_tools.experiments.scores import E_MAX

    group = parser.add_argument_group("scores")
    group.add_argument(
        "--k-max",
        type=float,
        metavar="STEPS",
        help="score 0 for this convergence time K (default: length of a trial)",
    )
    group.add_argument(
        "--e-max",
        type=float,
        metavar="ERROR",
        default=E_MAX,
        help="score 0 for this error e (default: %(default)s)",
    )


def limits_of(args: argparse.Namespace) -> Limits:
    """Return the limits K_max and e_max of scores that the user typed, or else the paper's.

    Raises UsageError for one of 0 or less.
    """
    from mcp_asdf_tools.experiments.scores import Limits

    return Limits(args.k_max, args.e_max)  # a K_max of None stands for the length of each trial


def add_where_option(group: argparse._ActionsContainer) -> None:
    """Add the option ``--where``, whose conditions ``read_selected_experiments`` applies."""
    group.add_argument(
        "--where",
        metavar="NAME=VALUE",
        action="append",
        default=[],
        help="choose the experiments with this parameter, such as filter=none; repeatable",
    )


def read_selected_experiments(args: argparse.Namespace) -> list[Trials]:
    """Read the results file ``args.file``, and return the experiments that meet all ``--where`` conditions.

    Raises UsageError, with the existing values, for a condition on no parameter and one that nothing meets.
    """
    from mcp_asdf_tools.experiments.result_files import stream_experiments
    from mcp_asdf_tools.experiments.results import describe_differences, select_experiments

    experiments = list(stream_experiments(args.file))
    # One condition after the other, so that an error names the first that nothing meets.
    for condition in args.where:
        name, equals_sign, value = condition.partition("=")
        if not equals_sign:
            differences = describe_differences(experiments)
            raise UsageError(
                f"--where {condition}: write NAME=VALUE; the experiments differ in {differences}"
            )
        experiments = select_experiments(experiments, {name: value})
    return experiments
