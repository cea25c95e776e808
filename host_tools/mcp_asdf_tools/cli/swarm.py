"""``mcp-asdf swarm``: emulate a swarm of robots on a CAN bus."""

from __future__ import annotations

import argparse
import logging
import sys
from collections.abc import Sequence
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, get_args

from mcp_asdf_tools.cli import options
from mcp_asdf_tools.cli.output import (
    announce_page,
    exit_code_of_run,
    json_report,
    print_again,
    recording_for,
    report_failure,
    sleep_until,
    warn,
)
from mcp_asdf_tools.common.errors import UsageError
from mcp_asdf_tools.common.signals import stopping
from mcp_asdf_tools.robots.clock import ClockKind
from mcp_asdf_tools.swarm.fault_injection.kinds import FAULT_KINDS
from mcp_asdf_tools.swarm.settings import MAX_ROBOTS_AND_TOOLS, SwarmSettings

if TYPE_CHECKING:
    import can
    from rich.console import Console

    from mcp_asdf_tools.bus.interfaces import BusChoice
    from mcp_asdf_tools.bus.slcan_server import SlcanServer
    from mcp_asdf_tools.recording.recording import LogOutputs, NoRecording, Recording
    from mcp_asdf_tools.robots.processes import NodeProcesses
    from mcp_asdf_tools.swarm.carrier import Wiring
    from mcp_asdf_tools.swarm.run import Baselines, SwarmRun
    from mcp_asdf_tools.swarm.swarm import Swarm
    from mcp_asdf_tools.view.history import History
    from mcp_asdf_tools.view.run_histories import SwarmRecorder

EPILOG = """\
examples:
  mcp-asdf swarm --robots 6 --steps 60 --quiet
      seed 1: 6 robots, ASDF-, 60 steps, mean error 0.04549, spread 0.00000
  mcp-asdf swarm --topology dynamic --flawed 50% --filter robust --compare   # beside other filters
  mcp-asdf swarm --topology dynamic --view          # in a browser, while it runs
  mcp-asdf swarm --interface socketcan --channel vcan0 --robots 5 --log run.log
  mcp-asdf swarm --fault loss=0.5 --fault liar,robots=3,x=1,alpha=1e6
  mcp-asdf swarm --channel 'vcan{robot}' --device 3=slcan:socket://127.0.0.1:20001
With {robot} in the channel each robot has its own bus. The same settings give the same run, bit for bit, on
every bus. docs/swarm.md explains topologies, buses and faults.
exit code: 0 done, 1 the bus lost a frame or a robot elsewhere did not answer, 2 bad usage, 128 + signal
if interrupted (results so far are saved)"""
LIBRARIES = ("numpy", "can", "rich.console")

_logger = logging.getLogger(__name__)

_STARTING_TIMEOUT = 60.0
"""Seconds that robots in other processes and controllers have to send their first heartbeats."""

# --- Options ---------------------------------------------------------------------------------------------


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the options of ``mcp-asdf swarm``: the swarm, its faults, the bus, the run and the output."""
    options.add_parameters(parser, SwarmSettings, "swarm and world", options.COMMON_PARAMETERS)
    _add_fault_options(parser)
    options.add_bus_options(parser)
    _add_remote_options(parser)
    _add_output_options(parser)
    options.add_further_parameters(parser, SwarmSettings)
    options.add_estimate_format(parser.add_argument_group("frames"))


def _add_fault_options(parser: argparse.ArgumentParser) -> None:
    """Declare the options of disturbances and of the clock, with a help that lists all kinds of fault."""
    kind_lines = []
    for kind in FAULT_KINDS:
        kind_options = "".join(f"; {option}=" for option in kind.own_options())
        kind_lines.append(f"  {kind.name:10}{kind.summary}{kind_options}")
    group = parser.add_argument_group(
        "faults and clock",
        "A fault is KIND=RATE (default 1) and options, separated by commas. All kinds take\n"
        "from=TICK, to=TICK (the first tick without it) and robots=0+3-5 (affected nodes or senders).\n"
        + "\n".join(kind_lines),
    )
    group.add_argument(
        "--fault",
        metavar="FAULT",
        action="append",
        default=[],
        dest="faults",
        help="inject this fault; repeatable, and faults act in the order given",
    )
    group.add_argument(
        "--clock",
        choices=get_args(ClockKind),
        default=SwarmSettings.clock,
        help="end a tick when its frames have arrived, or with its share of a second (default %(default)s)",
    )


def _add_remote_options(parser: argparse.ArgumentParser) -> None:
    """Declare --slcan, --processes and --device: programs and robots that are not in this process.

    --processes and --device exclude each other.
    """
    group = parser.add_argument_group("robots and programs outside this process")
    group.add_argument(
        "--slcan",
        metavar="PORT",
        type=int,
        help="let other programs join the bus through an slcan adapter at this TCP port (0: any free port)",
    )
    remote_robots = group.add_mutually_exclusive_group()
    remote_robots.add_argument(
        "--processes", action="store_true", help="run each robot as a process with its own connection"
    )
    remote_robots.add_argument(
        "--device",
        metavar="ID=INTERFACE:CHANNEL",
        action="append",
        default=[],
        help="use the controller there, which obeys command frames, as this robot; repeatable",
    )


def _add_output_options(parser: argparse.ArgumentParser) -> None:
    """Declare --log, --compare, --view, --pace, --port and --quiet: what a run writes and shows."""
    group = parser.add_argument_group("output")
    options.add_log_option(
        group, "FILE.json gets all parameters and results, FILE.events what each robot saw and heard"
    )
    group.add_argument(
        "--compare",
        action="store_true",
        help="also run the same swarm without a filter, with ASDF- and with the robust filter",
    )
    group.add_argument("--view", action="store_true", help="show the run in a browser while it runs")
    group.add_argument(
        "--pace",
        metavar="N",
        type=float,
        default=500,
        help="run N steps per second with --view; 0: as fast as possible (default %(default)s)",
    )
    options.add_port_option(group)
    group.add_argument("--quiet", action="store_true", help="print only a summary of one line")


def settings_of(args: argparse.Namespace) -> SwarmSettings:
    """Return the settings that the options describe. Raises UsageError for a value out of range."""
    return options.settings_from(
        args,
        SwarmSettings,
        frames=options.estimate_format_of(args),
        faults=args.faults,
        clock=args.clock,
    )


def wiring_of(args: argparse.Namespace, settings: SwarmSettings, bus_choice: BusChoice) -> Wiring:
    """Return how the robots of the swarm are connected: which robot joins which bus, and which run elsewhere.

    ``bus_choice`` is the bus of all robots without a ``--device``. Raises UsageError if the options
    contradict each other or the settings.
    """
    from mcp_asdf_tools.swarm.carrier import Wiring
    from mcp_asdf_tools.swarm.remote_robot import check_remote

    devices = _parse_devices(args.device)
    # With --processes all robots are remote, otherwise the devices alone.
    remote_robots = frozenset(range(settings.robots)) if args.processes else frozenset(devices)
    is_shared = not bus_choice.has_bus_per_robot
    # Robots here that share one bus share a connection, which has to return what they send.
    returns_own = is_shared and not remote_robots

    def open_bus(robot: int) -> can.BusABC:
        """Open a connection to a robot's bus: its device's, its own, or the bus that all share."""
        robot_bus = devices.get(robot, bus_choice.of_robot(robot))
        return robot_bus.open(returns_own)

    # Without any of these nobody else can be on a bus, and frames go from robot to robot in memory.
    needs_bus = remote_robots or args.slcan is not None or not is_shared or not bus_choice.is_private
    wiring = Wiring(open_bus if needs_bus else None, is_shared, remote_robots)
    check_remote(settings, wiring)
    return wiring


def _parse_devices(device_texts: Sequence[str]) -> dict[int, BusChoice]:
    """Return the bus of each device, by the id of its robot.

    Raises UsageError for a text that names no device, and for two devices with the same id.
    """
    devices = dict(_parse_device(device) for device in device_texts)
    # In the dictionary devices with the same id are one.
    if len(devices) < len(device_texts):
        raise UsageError(f"two devices are one robot: {', '.join(device_texts)}; give each an id of its own")
    return devices


def _parse_device(device: str) -> tuple[int, BusChoice]:
    """Return robot id and bus of a text such as ``3=slcan:socket://127.0.0.1:20001``.

    Raises UsageError for a text of another form, or with an interface that python-can does not have.
    """
    import can

    from mcp_asdf_tools.bus.interfaces import BusChoice

    robot_text, _, bus_text = device.partition("=")
    interface, _, channel = bus_text.partition(":")
    # isdigit alone is also true for digits of other scripts.
    is_robot_id = robot_text.isascii() and robot_text.isdigit()
    if not is_robot_id or not channel or interface not in can.VALID_INTERFACES:
        raise UsageError(
            f"device is {device!r}; write ID=INTERFACE:CHANNEL, such as 3=slcan:socket://127.0.0.1:20001"
        )
    # The bus is named in full: python-can's variables and files, which are about another, do not hold for it.
    bus_settings: dict[str, Any] = {"channel": channel, "ignore_config": True}
    if interface == "slcan":  # python-can gives adapters two seconds to start; what answers has started
        bus_settings["sleep_after_open"] = 0
    return int(robot_text), BusChoice(interface, bus_settings)


@dataclass(frozen=True)
class _RunPlan:
    """Everything that a run needs to know.

    Attributes:
        args: The parsed options, for what concerns output.
        settings: Settings of the swarm.
        bus_choice: The bus of all robots that have none of their own.
        wiring: Which robots are on which bus.
        results_path: Where the results are written, as JSON; None without --log.
        console: Where progress is shown; quiet with --quiet or --json.
    """

    args: argparse.Namespace
    settings: SwarmSettings
    bus_choice: BusChoice
    wiring: Wiring
    results_path: Path | None
    console: Console


def _plan_run(args: argparse.Namespace) -> _RunPlan:
    """Return the run that the options describe, with a console that is silent with --quiet or --json.

    Raises UsageError for options that contradict each other, or that would do nothing, and if results cannot
    be written beside the log.
    """
    from rich.console import Console

    from mcp_asdf_tools.common.files import results_beside

    settings = settings_of(args)
    bus_choice = options.bus_of(args)
    wiring = wiring_of(args, settings, bus_choice)
    _check_output_options(args, wiring)
    if args.slcan is not None:
        _check_slcan(settings, bus_choice)
    results_path = None if args.log is None else results_beside(args.log)
    console = Console(quiet=args.quiet or args.json)
    return _RunPlan(args, settings, bus_choice, wiring, results_path, console)


def _check_output_options(args: argparse.Namespace, wiring: Wiring) -> None:
    """Raise UsageError for --pace or --port without --view, and for --compare with robots elsewhere."""
    for option in ("--pace", "--port"):
        if option in args.typed_options and not args.view:
            raise UsageError(f"{option} is for the page of --view; add --view, or leave it out")
    if args.compare and wiring.remote:
        raise UsageError(
            "--compare runs the swarm again with other filters, but robots elsewhere run once; leave it out"
        )


def _check_slcan(settings: SwarmSettings, bus_choice: BusChoice) -> None:
    """Raise UsageError if other programs cannot join the swarm by --slcan.

    They need one bus for all, and the two ids of tools.
    """
    if bus_choice.has_bus_per_robot:
        raise UsageError(
            f"--slcan needs one bus for all, and {bus_choice} is one for each robot; choose one of them"
        )
    if settings.robots > MAX_ROBOTS_AND_TOOLS:
        raise UsageError(
            f"robots is {settings.robots}; with --slcan take at most {MAX_ROBOTS_AND_TOOLS}, since tools use "
            "the ids 126 and 127"
        )


# --- The run ---------------------------------------------------------------------------------------------


def run(args: argparse.Namespace) -> int:
    """Run the swarm, write its log and results, and print a summary; return the exit code.

    That is 0, 1 if the bus or a robot elsewhere failed, INTERRUPTED if a signal came, and 2 if the log is not
    complete. With --view the page is served until Ctrl-C. Raises UsageError for wrong options, and if a bus
    or file cannot be opened.
    """
    from can import CanError

    from mcp_asdf_tools.robots.lockstep import LockstepError

    plan = _plan_run(args)
    recording = _prepare_recording(plan)
    try:
        with ExitStack() as page_stack:
            recorder = _start_view(plan, page_stack)
            outcome = _run_and_record(plan, recording, recorder)
            # The page stays until Ctrl-C, unless that has ended the run already.
            if recorder is not None and not outcome.interrupted:
                _keep_page(recorder.history)
    except (LockstepError, CanError) as error:
        # Robots elsewhere have not started, or their bus failed before they had.
        return report_failure("mcp-asdf swarm", str(error), args.json)
    failure = None if outcome.failure is None else f"failed in {outcome.failure}"
    return exit_code_of_run(args, failure, outcome.interrupted, recording)


def _prepare_recording(plan: _RunPlan) -> Recording | NoRecording:
    """Return the recording of a run with --log, and one that keeps nothing without."""
    from mcp_asdf_tools.recording.events import EventsHeader

    settings = plan.settings
    header = EventsHeader(settings.robot_setups(), settings.seed, settings.frames, settings.plain())
    return recording_for("swarm", plan.args.log, header, plan.bus_choice)


def _run_and_record(
    plan: _RunPlan, recording: Recording | NoRecording, recorder: SwarmRecorder | None
) -> SwarmRun:
    """Run the swarm, write its log and results, print the results, and return the run at its end.

    Raises UsageError if a file cannot be written, and what ``_emulate`` raises.
    """
    from mcp_asdf_tools.common.files import write_atomically

    with recording as log_outputs:
        outcome, report = _emulate(plan, log_outputs, recorder)
    try:
        if plan.results_path is not None:
            write_atomically(plan.results_path, json_report(report) + "\n")
    finally:  # also if the file cannot be written
        _print_result(plan, outcome, report)
    return outcome


def _emulate(
    plan: _RunPlan, log_outputs: LogOutputs, recorder: SwarmRecorder | None
) -> tuple[SwarmRun, dict[str, Any]]:
    """Run the swarm to its end or Ctrl-C, and return the run with its report for JSON.

    With --compare the same swarm also runs with other filters, its baselines, whose results are in the report
    unless the run has failed. ``log_outputs`` get frames and events for the log, and ``recorder``, if there
    is one, states for the web page. Raises LockstepError if robots in other processes or at devices do not
    start, and can.CanError if their bus fails before they have.
    """
    from mcp_asdf_tools.swarm.run import Baselines
    from mcp_asdf_tools.swarm.swarm import Swarm

    baselines = Baselines(plan.settings) if plan.args.compare else None
    with ExitStack() as stack:
        slcan_port = _serve_slcan(plan, stack)
        swarm = stack.enter_context(
            Swarm(plan.settings, plan.wiring, log_outputs.record_frame, log_outputs.events_writer)
        )
        processes = stack.enter_context(_prepare_processes(plan))
        _wait_for_robots(plan, swarm, processes)
        outcome = _run_with_progress(plan, swarm, baselines, recorder)
    # A process reports when it ends, and all have ended with the context of ``processes``.
    return outcome, _report_of(plan, outcome, slcan_port, processes, baselines)


def _run_with_progress(
    plan: _RunPlan, swarm: Swarm, baselines: Baselines | None, recorder: SwarmRecorder | None
) -> SwarmRun:
    """Run the swarm until its last step or a signal, show how far it is, and return the run at its end.

    If there are ``baselines``, they run beside it; if there is a ``recorder``, it gets the swarm's states.
    """
    from mcp_asdf_tools.swarm.live_view import live_view
    from mcp_asdf_tools.swarm.run import run_swarm

    # A signal counts between two ticks, so that log and results end on a whole one.
    with live_view(plan.console, swarm.settings.steps, baselines) as show_tick, stopping() as should_stop:
        # Baselines come first, since the live view shows their errors after the same tick.
        hooks = [hook for hook in (baselines, recorder, show_tick) if hook is not None]
        return run_swarm(swarm, hooks, should_stop)


def _report_of(
    plan: _RunPlan,
    outcome: SwarmRun,
    slcan_port: int | None,
    processes: NodeProcesses,
    baselines: Baselines | None,
) -> dict[str, Any]:
    """Return parameters and results of a run as plain values, for JSON.

    "processes" has the report of each robot that ran in a process of its own, and "compared" the results of
    the ``baselines`` by their filters. There is no "compared" without baselines, or if the run has failed.
    """
    from mcp_asdf_tools.swarm.run import results_of

    report = outcome.report(bus=plan.bus_choice.plain() | {"slcan": slcan_port})
    reports_by_robot = sorted(processes.reports.items())
    report["processes"] = {str(robot): node_report for robot, node_report in reports_by_robot}
    if baselines is not None and outcome.failure is None:
        report["compared"] = {
            filter_name: results_of(baseline) for filter_name, baseline in baselines.swarms.items()
        }
    return report


def _prepare_processes(plan: _RunPlan) -> NodeProcesses:
    """Return the processes of all robots with --processes, and none without. They start in its context.

    Raises UsageError if the user's subject of estimates belongs to another kind of frames.
    """
    from mcp_asdf_tools.robots.node import Subjects
    from mcp_asdf_tools.robots.processes import NodeProcesses

    settings = plan.settings
    if plan.args.processes:
        robots = settings.robot_setups()
        # Processes tell kinds of frames apart by their subjects, which must therefore differ.
        subjects = Subjects(estimates=settings.frames)
    else:
        robots, subjects = [], Subjects()
    return NodeProcesses(robots, plan.bus_choice.of_robot, subjects, settings.steps_per_second)


def _wait_for_robots(plan: _RunPlan, swarm: Swarm, processes: NodeProcesses) -> None:
    """Wait until all robots elsewhere have sent their first heartbeats. Raises LockstepError if one does not.

    ``processes`` are those among them that are watched meanwhile.
    """
    if plan.wiring.remote:
        with plan.console.status("waiting for robots elsewhere"):
            # A process that has died ends this wait and all later ones at once, with what it printed.
            swarm.wait_until_up(_STARTING_TIMEOUT, processes.check)
    remote_count = len(plan.wiring.remote)
    _logger.info("%d robots are up, %d of them elsewhere", plan.settings.robots, remote_count)


def _start_view(plan: _RunPlan, at_end: ExitStack) -> SwarmRecorder | None:
    """Return a recorder of the run whose page is served until ``at_end`` closes, or None without --view.

    The page's address is printed, as JSON with --json.
    """
    if not plan.args.view:
        return None
    from mcp_asdf_tools.view.run_histories import SwarmRecorder
    from mcp_asdf_tools.view.server import serve_page

    recorder = SwarmRecorder(plan.settings, plan.args.pace)
    url = at_end.enter_context(serve_page(recorder.history, plan.args.port))
    announce_page(url, plan.args.json)
    return recorder


def _keep_page(history: History) -> None:
    """Mark the run on the page as over, pass on what was printed, and wait for Ctrl-C."""
    history.has_ended = True
    # Who reads the results through a pipe should not wait until the page is closed.
    sys.stdout.flush()
    with stopping() as should_stop:
        sleep_until(should_stop)


def _serve_slcan(plan: _RunPlan, stack: ExitStack) -> int | None:
    """Let other programs join the bus until ``stack`` closes; return the TCP port, None without --slcan."""
    if plan.args.slcan is None:
        return None
    from mcp_asdf_tools.bus.slcan_server import HOST, SlcanServer

    server = stack.enter_context(SlcanServer(plan.bus_choice.open(), plan.args.slcan))
    stack.callback(_warn_of_dropped_frames, server)
    # On standard error: with port 0 the user needs the number, and standard output may be JSON.
    print(f"the bus is an slcan adapter, too: socket://{HOST}:{server.port}", file=sys.stderr, flush=True)
    return server.port


def _warn_of_dropped_frames(server: SlcanServer) -> None:
    """Print how many frames of the bus a program at the slcan adapter has missed, if any."""
    if server.dropped > 0:
        warn(
            "swarm",
            f"a program at the slcan adapter read too slowly: {server.dropped} frames did not reach it",
        )


# --- The summary -----------------------------------------------------------------------------------------


def _print_result(plan: _RunPlan, outcome: SwarmRun, report: dict[str, Any]) -> None:
    """Print the results: as JSON, in one line (--quiet), as a table on a terminal, else in lines with tabs.

    The sentence that compares filters follows in any case but JSON.
    """
    from rich.console import Console

    from mcp_asdf_tools.swarm.summary import comparison, one_line

    if plan.args.json:
        print(json_report(report))
        return
    console = Console()  # unlike the plan's console it prints with --quiet, too
    if plan.args.quiet:
        print(one_line(outcome))
    else:
        _print_summary(plan, outcome, console)
    if "compared" in report:
        results_by_filter = {plan.settings.filter: report["results"], **report["compared"]}
        sentence = comparison(results_by_filter, plan.settings)
        console.print(sentence, soft_wrap=not console.is_terminal, markup=False, highlight=False)


def _print_summary(plan: _RunPlan, outcome: SwarmRun, console: Console) -> None:
    """Print the summary of a run, and the line that makes the same run again.

    The summary is a table on a terminal, and otherwise lines with tabs. A warning goes to standard error if a
    real bus would be too busy.
    """
    from mcp_asdf_tools.swarm.summary import load_warning, summary, summary_table

    rows = summary(outcome, str(plan.bus_choice))
    if console.is_terminal:
        console.print(summary_table(rows))
    else:
        # For programs that read the output: a line is the name of a row, a tab and its text.
        print("\n".join("\t".join(row) for row in rows))
    warning = load_warning(outcome.results)
    if warning is not None:
        warn("swarm", warning)
    print_again(plan.args, seed=plan.settings.seed)
