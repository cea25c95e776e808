"""``mcp-asdf node``: one robot on a bus, which obeys commands."""

from __future__ import annotations

import argparse
import json
import logging
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import asdict, dataclass, replace
from typing import TYPE_CHECKING, Any

from mcp_asdf_tools.cli import options
from mcp_asdf_tools.cli.output import exit_code_of_run, json_report, print_again, recording_for
from mcp_asdf_tools.common.errors import UsageError
from mcp_asdf_tools.common.signals import stopping
from mcp_asdf_tools.common.standard_streams import has_input_ended, standard_input_descriptor
from mcp_asdf_tools.robots.filters import describe_filters
from mcp_asdf_tools.robots.population import Population
from mcp_asdf_tools.robots.robot_setup import RobotSetup, parse_ids

if TYPE_CHECKING:
    from rich.console import Console

    from mcp_asdf_tools.bus.interfaces import BusChoice
    from mcp_asdf_tools.recording.events import EventsHeader
    from mcp_asdf_tools.robots.node import FrameTaker, RobotNode, RunOutcome, Subjects
    from mcp_asdf_tools.robots.suspicion import Suspicion

EPILOG = """\
examples:
  mcp-asdf node --id 3 --interface udp_multicast    # until Ctrl-C, on this computer
  mcp-asdf radio --id 3 --interface udp_multicast --verify     # in another terminal
      PASSED: 45 of 45 phases passed; every frame of the controller equals the model's
  mcp-asdf node --id 3 --interface socketcan --channel can0 --b-hat 0.8 --log run.log
Command frames drive the robot (docs/design.md). The C node, mcp_asdf_node, also runs in real time and reads
a sensor (docs/platforms/linux.md).
exit code: 0 done, 1 the bus failed, 2 bad usage, 128 + signal if one came before --steps were done"""
LIBRARIES = ("numpy", "can", "rich.console")


_logger = logging.getLogger(__name__)


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the options of the robot, its bus, the run and the output.

    The robot is described by ``--id`` and further options, or by ``--setup`` alone: one of the two is
    required.
    """
    group = parser.add_argument_group("robot", options.describe_filters())
    identity = group.add_mutually_exclusive_group(required=True)
    identity.add_argument(
        "--id", type=int, metavar="ID", help="id on the bus, 0 to 127; no other robot may have it"
    )
    identity.add_argument(
        "--setup",
        metavar="JSON",
        help="start as a robot of an earlier run: an entry of robots in the first line of FILE.events, or "
        "parameters.robot of node --json; instead of all other options of the robot",
    )
    options.add_robot_options(group, "native")
    options.add_bus_options(parser)
    group = parser.add_argument_group("run")
    group.add_argument("--steps", type=int, metavar="N", help="end after N steps (default: at Ctrl-C)")
    group.add_argument("--allow", metavar="IDS", help="take estimates of these ids only, such as 0-19+30")
    group.add_argument("--until-eof", action="store_true", help="also end when the standard input ends")
    options.add_parameters_to(group, Population, ("steps_per_second",))
    options.add_subject_options(parser)
    output = parser.add_argument_group("output")
    options.add_log_option(output, "FILE.events gets what a replay needs")
    output.add_argument("--quiet", action="store_true", help="print nothing but errors")


def run(args: argparse.Namespace) -> int:
    """Run the robot until it ends, write its log, and print its results; return the exit code.

    With --json the results are printed with all parameters, and with --quiet not at all. The exit code is 0,
    1 if the bus failed, INTERRUPTED if a signal came, and 2 if the log is not complete. Raises UsageError for
    wrong options, and if the bus or the log cannot be opened.
    """
    from mcp_asdf_tools.robots.node import RobotNode

    plan = _plan_run(args)
    recording = recording_for("node", args.log, _events_header_of(plan), plan.bus_choice)
    with recording as log_outputs:
        recorder = log_outputs.recorder_of(plan.robot_setup.id)
        node = RobotNode(plan.robot_setup, plan.subjects, plan.steps_per_second, recorder)
        outcome = _run_on_bus(args, node, plan.bus_choice, log_outputs.record_frame)
    results = _results_of(node, plan.robot_setup, outcome)
    if args.json:
        print(json_report(_report_of(plan, results)))
    # --quiet also leaves out the line that repeats the run.
    elif not args.quiet:
        print(_format_summary(node, results, str(plan.bus_choice)))
        print_again(args)
    return exit_code_of_run(args, outcome.failure, outcome.is_interrupted, recording)


@dataclass(frozen=True)
class _RunPlan:
    """A run of a robot as the options describe it.

    Attributes:
        robot_setup: Initial state of the robot.
        subjects: Formats of the frames that it sends and receives.
        bus_choice: The bus that it joins.
        steps_per_second: Ticks that make a second of its own time.
        steps: Ticks after which the run ends; None if it goes on.
    """

    robot_setup: RobotSetup
    subjects: Subjects
    bus_choice: BusChoice
    steps_per_second: int
    steps: int | None

    @property
    def clock_parameters(self) -> dict[str, Any]:
        """Ticks in a second and ticks of the whole run, by the names of their options."""
        return {"steps_per_second": self.steps_per_second, "steps": self.steps}


def _plan_run(args: argparse.Namespace) -> _RunPlan:
    """Return the run that the options describe.

    Raises UsageError for a value out of range, and for options that contradict each other.
    """
    robot_setup = setup_of(args)
    subjects = options.subjects_of(args)
    bus_choice = options.bus_of(args)
    if args.steps is not None and args.steps < 1:
        raise UsageError(f"steps is {args.steps}; it must be 1 or more")
    # The clock is the only parameter of a population here: the other options describe the robot alone.
    clock_options = argparse.Namespace(steps_per_second=args.steps_per_second)
    steps_per_second = options.settings_from(clock_options, Population).steps_per_second
    return _RunPlan(robot_setup, subjects, bus_choice, steps_per_second, args.steps)


def _events_header_of(plan: _RunPlan) -> EventsHeader:
    """Return the first line of the events of a run."""
    from mcp_asdf_tools.recording.events import EventsHeader

    # There is no seed, as the robot's observations come from the bus.
    return EventsHeader(
        [plan.robot_setup], seed=None, frames=plan.subjects.estimates, parameters=plan.clock_parameters
    )


def _report_of(plan: _RunPlan, results: dict[str, Any]) -> dict[str, Any]:
    """Return parameters, bus, versions of software and results as plain values, for JSON."""
    from mcp_asdf_tools.common.versions import software_versions

    return {
        "parameters": {
            **plan.clock_parameters,
            "robot": plan.robot_setup.plain(),
            "subjects": asdict(plan.subjects),
        },
        "bus": plan.bus_choice.plain(),
        "versions": software_versions(),
        "results": results,
    }


def setup_of(args: argparse.Namespace) -> RobotSetup:
    """Return the robot of --setup or, without it, the one that the other options describe.

    Raises UsageError for a value out of range, and for options that contradict each other.
    """
    if args.setup is None:
        allow = None if args.allow is None else parse_ids(args.allow, "--allow")
        return replace(options.robot_of(args), allow=allow)
    for option in (*options.ROBOT_OPTIONS, "--allow"):
        if option in args.typed_options:
            raise UsageError(f"--setup and {option} both describe the robot; leave out one of them")
    return _parse_setup(args.setup)


def _parse_setup(setup_text: str) -> RobotSetup:
    """Return the robot in the JSON text of --setup. Raises UsageError if it describes none."""
    try:
        plain_setup = json.loads(setup_text)
    except (ValueError, RecursionError) as error:
        raise UsageError(
            f"--setup is no JSON ({error}): {setup_text!r}; give one such as "
            """'{"id": 3, "b_hat": 0.8, "filter": "robust"}'"""
        ) from error
    try:
        return RobotSetup.from_plain(plain_setup)
    except UsageError as error:
        raise UsageError(f"--setup: {error}") from error


def _run_on_bus(
    args: argparse.Namespace, node: RobotNode, bus_choice: BusChoice, record_frame: FrameTaker
) -> RunOutcome:
    """Join the bus and run the node until its steps are done, it is stopped or the bus fails.

    The result says how the run has ended. ``record_frame`` is called with every frame sent and received.
    Raises UsageError if the bus cannot be opened, or if standard input is to end the run and there is none.
    """
    from rich.console import Console

    from mcp_asdf_tools.robots.node import BusLink, filters_for, run_node

    console = Console(stderr=True, quiet=args.quiet)
    with bus_choice.open() as bus, _stopping_at_signal_or_end_of_input(args.until_eof) as should_stop:
        # Other frames do not concern the node, and need not reach this process.
        bus.set_filters(filters_for(node.subjects.estimates, node.subjects.commands))
        link = BusLink(bus, should_stop, log=record_frame)
        _logger.info("robot %d is up", node.id)
        return run_node(node, link, args.steps, _suspicion_printer(node, console))


@contextmanager
def _stopping_at_signal_or_end_of_input(until_eof: bool) -> Iterator[Callable[[], bool]]:
    """Context manager that yields a function, by which a run finds out whether it should stop.

    The function returns True once a signal has come. The signal itself interrupts nothing. With ``until_eof``
    the function also returns True once the standard input has ended, and if there is no standard input, the
    context manager raises UsageError.
    """
    with stopping() as was_interrupted:
        input_descriptor = standard_input_descriptor() if until_eof else None

        def should_stop() -> bool:
            """Return whether a signal came or the standard input has ended, if that is watched."""
            if was_interrupted():
                return True
            return input_descriptor is not None and has_input_ended(input_descriptor)

        yield should_stop


def _suspicion_printer(node: RobotNode, console: Console) -> Callable[[], None]:
    """Return a function that prints what is suspicious in the estimates that the node has received.

    A kind of suspicion is printed once for each sender, at the first call after it has come up.
    """
    from mcp_asdf_tools.robots.suspicion import MEANINGS

    reported: set[tuple[Suspicion, int]] = set()

    def print_new_suspicions() -> None:
        """Print the pairs of kind and sender, by which the node counts, that have not been printed yet."""
        new_suspicions = node.reception.events.keys() - reported
        reported.update(new_suspicions)
        for kind, sender in new_suspicions:
            console.print(f"mcp-asdf node: node {sender}: {MEANINGS[kind]}", soft_wrap=True)

    return print_new_suspicions


def _results_of(node: RobotNode, robot_setup: RobotSetup, outcome: RunOutcome) -> dict[str, Any]:
    """Return how a run has ended, its robot's state and the numbers of its frames, as plain values.

    The keys are ``filter``, which is a description, ``steps``, ``robot``, ``frames``, and the attributes of
    ``RunOutcome``.
    """
    from mcp_asdf_tools.robots.node import state_of

    return {
        "filter": describe_filters([robot_setup.config.filter]),
        "steps": node.ticks,
        **vars(outcome),
        "robot": state_of(node),
        "frames": node.figures(),
    }


def _format_summary(node: RobotNode, results: dict[str, Any], bus_name: str) -> str:
    """Return the lines that sum up a run for a reader; ``bus_name`` is such as "virtual vcan0"."""
    robot = node.robot
    frames = results["frames"]
    counters = node.counters
    return (
        f"run       {node.ticks} ticks as robot {node.id}; {results['ending']}\n"
        f"estimate  x {robot.x:.5f}, x_hat {robot.x_hat:.5f}, alpha {robot.alpha:.5g}\n"
        f"filter    {results['filter']}; b_hat {robot.b_hat:.4f}, {counters.tests} tests, "
        f"{counters.updates} updates\n"
        f"sent      {frames['estimates_sent']} estimates, {frames['heartbeats_sent']} heartbeats, "
        f"{frames['telemetry_sent']} telemetry on {bus_name}\n"
        f"heard     {frames['delivered']} estimates, {frames['refused']} of them refused, and "
        f"{sum(frames['rejected'].values())} other frames"
    )
