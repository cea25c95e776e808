"""``mcp-asdf radio``: emulate the neighbours of one real controller."""

from __future__ import annotations

import argparse
from dataclasses import asdict, replace
from datetime import UTC, datetime
from pathlib import Path
from typing import TYPE_CHECKING, Any

from mcp_asdf.robot import B_HAT_MARGIN, Filter
from mcp_asdf_tools.cli import options
from mcp_asdf_tools.cli.output import exit_code_of_run, json_report, print_again, recording_for
from mcp_asdf_tools.common.errors import UsageError
from mcp_asdf_tools.common.signals import stopping
from mcp_asdf_tools.robots.filters import FilteringRobots, describe_filters
from mcp_asdf_tools.swarm.settings import SwarmSettings

if TYPE_CHECKING:
    import can
    from rich.console import Console

    from mcp_asdf_tools.bus.interfaces import BusChoice
    from mcp_asdf_tools.radio.neighbourhood import RadioSettings
    from mcp_asdf_tools.radio.real_time import RadioRun
    from mcp_asdf_tools.radio.verification import ControllerVerdict
    from mcp_asdf_tools.recording.events import EventsHeader
    from mcp_asdf_tools.recording.recording import LogOutputs
    from mcp_asdf_tools.robots.robot_setup import RobotSetup

EPILOG = """\
examples:
  mcp-asdf radio --id 3 --robots 11 --interface socketcan --channel can0             # until Ctrl-C
  mcp-asdf radio --id 3 --interface socketcan --channel can0 --verify --wait 60 --report verdict.md
      PASSED: 45 of 45 phases passed; every frame of the controller equals the model's
Describe your controller with --id, --b-hat, --filter, --filter-period and --neighbours. Without --verify it
only has to broadcast: the neighbours run in real time and receive its messages, and it receives theirs. With
--verify it has to obey command frames (docs/design.md) and to start just before, or within --wait seconds.
docs/radio.md explains verdicts.
exit code: 0 done or verified, 1 not verified or the bus failed, 2 bad usage, 128 + signal if
interrupted"""
LIBRARIES = ("numpy", "can", "rich.console")

_WORLD_PARAMETERS = (
    "robots",
    "topology",
    "graph",
    "fill_ratio",
    "true_accuracy",
    "density",
    "radio_range",
    "steps_per_second",
    "latency",
    "seed",
)
"""Parameters of a swarm that hold for the controller and its neighbours together."""
_VERIFICATION_OPTIONS = ("timeout", "wait", "report")
_DEFAULT_PHASE_TICKS = 25
_DEFAULT_TIMEOUT = 2.0
"""Seconds."""

# --- Options ---------------------------------------------------------------------------------------------


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the options of ``mcp-asdf radio``: controller, neighbours, bus, run and output."""
    group = parser.add_argument_group("controller", options.describe_filters())
    group.add_argument("--id", type=int, metavar="ID", required=True, help="id of the controller, 0 to 127")
    options.add_robot_options(group, "mirror")
    options.add_bus_options(parser)
    _add_verification_options(parser)
    _add_neighbour_options(parser)
    options.add_subject_options(parser)
    output = parser.add_argument_group("output")
    options.add_log_option(output, "with --verify FILE.events gets what 'mcp-asdf replay FILE' needs")


def _add_neighbour_options(parser: argparse.ArgumentParser) -> None:
    """Declare ``--first-id``, ``--steps`` and ``--fault``, and the parameters of the world of all robots."""
    group = parser.add_argument_group("neighbours")
    group.add_argument(
        "--first-id",
        type=int,
        metavar="ID",
        default=0,
        help="give the emulated robots ids from here on, without the controller's (default %(default)s)",
    )
    group.add_argument(
        "--steps",
        type=int,
        metavar="N",
        help="end after N steps (default: at Ctrl-C); with --verify, end each phase among neighbours after "
        f"N steps, or two rounds if these are longer (default {_DEFAULT_PHASE_TICKS})",
    )
    group.add_argument(
        "--fault",
        metavar="FAULT",
        action="append",
        default=[],
        dest="faults",
        help="inject this fault, as for swarm; repeatable; with --verify each fault adds a phase",
    )
    options.add_parameters(
        parser, SwarmSettings, "world of the controller and its neighbours", _WORLD_PARAMETERS
    )


def _add_verification_options(parser: argparse.ArgumentParser) -> None:
    """Declare ``--verify``, and ``--timeout``, ``--wait`` and ``--report``, which need it."""
    group = parser.add_argument_group("verification")
    group.add_argument(
        "--verify",
        action="store_true",
        help="drive the controller in lockstep and compare every frame with a model",
    )
    group.add_argument(
        "--timeout",
        type=float,
        metavar="SECONDS",
        help=f"wait this many seconds for an answer of the controller (default {_DEFAULT_TIMEOUT:g})",
    )
    group.add_argument(
        "--wait",
        type=float,
        metavar="SECONDS",
        help="wait this many seconds for the controller's first heartbeat (default: assume that it runs)",
    )
    group.add_argument(
        "--report", metavar="FILE", type=Path, help="write the report, with all parameters, as Markdown"
    )


def settings_of(args: argparse.Namespace) -> RadioSettings:
    """Return the settings that the options describe.

    Raises UsageError for a value out of range and for options that contradict each other.
    """
    from mcp_asdf_tools.radio.neighbourhood import RadioSettings
    from mcp_asdf_tools.swarm.fault_injection.parsing import parse_fault

    _check_run_options(args)
    controller = options.robot_of(args)
    world = options.settings_from(args, SwarmSettings, steps=_DEFAULT_PHASE_TICKS)
    neighbours = _make_neighbours(controller, world, args.first_id)
    faults = tuple(parse_fault(text) for text in args.faults)
    return RadioSettings(controller, neighbours, world, options.subjects_of(args), faults)


def _make_neighbours(controller: RobotSetup, world: SwarmSettings, first_id: int) -> tuple[RobotSetup, ...]:
    """Return the robots of a world that are emulated: all but the controller, which they resemble.

    Their ids rise from ``first_id`` on, without the controller's. They assume the true accuracy and, where
    only flawed robots filter, have no filter. Raises UsageError if ids do not suffice.
    """
    from mcp_asdf_tools.radio.neighbourhood import choose_ids

    # Neighbours assume the true accuracy, as far as the firmware can: it needs a margin to 0 and 1.
    lowest_b_hat = B_HAT_MARGIN
    highest_b_hat = 1 - B_HAT_MARGIN
    b_hat = min(max(world.true_accuracy, lowest_b_hat), highest_b_hat)
    any_neighbour = replace(controller, b_hat=b_hat)
    if world.swarm_filter.filtering_robots is FilteringRobots.FLAWED:
        # Of this swarm the controller alone is in doubt, so its neighbours do not recalibrate.
        config = replace(controller.config, table=None, filter=Filter.OFF)
        any_neighbour = replace(any_neighbour, config=config)
    neighbour_ids = choose_ids(controller.id, world.robots - 1, first_id)
    return tuple(replace(any_neighbour, id=neighbour_id) for neighbour_id in neighbour_ids)


def _check_run_options(args: argparse.Namespace) -> None:
    """Raise UsageError for --steps or times out of range, and for options that need --verify without it."""
    if args.steps is not None and args.steps < 1:
        raise UsageError(f"steps is {args.steps}; it must be 1 or more")
    for option_name in _VERIFICATION_OPTIONS:
        value = getattr(args, option_name)
        if value is not None and not args.verify:
            raise UsageError(f"--{option_name} is for a verification; add --verify or leave it out")
        # The report is a path, the other two options are times.
        if isinstance(value, float) and not 0 < value < float("inf"):
            raise UsageError(f"{option_name} is {value}; it must be above 0 seconds")


# --- Runs ------------------------------------------------------------------------------------------------


def run(args: argparse.Namespace) -> int:
    """Verify the controller with --verify, or else emulate its neighbours; return the exit code.

    Raises UsageError for wrong options, for a bus on which no controller can be, and if the bus or the files
    to be written cannot be opened.
    """
    from rich.console import Console

    from mcp_asdf_tools.common.files import check_target

    if args.report is not None:
        # Now, and not after all phases, which take long.
        check_target(args.report)
    settings = settings_of(args)
    bus_choice = options.bus_of(args)
    if bus_choice.is_private and "interface" not in args:
        raise UsageError(
            f"say with --interface on which bus the controller is: the bus {bus_choice} is inside this "
            "process, where nothing else is"
        )
    console = Console(stderr=True, quiet=args.json)
    if args.verify:
        return _verify(args, settings, bus_choice, console)
    return _emulate_neighbours(args, settings, bus_choice, console)


def _verify(
    args: argparse.Namespace, settings: RadioSettings, bus_choice: BusChoice, console: Console
) -> int:
    """Take the controller through all phases, print the verdict and write the report; return an exit code.

    That is 0 if it has passed, 1 if not, INTERRUPTED if a signal came, and 2 if the log is not complete.
    """
    from mcp_asdf_tools.common.files import write_atomically
    from mcp_asdf_tools.radio.verification import details, markdown

    report = _make_report(args, settings, bus_choice)
    events_header = _events_header_of(settings, report["parameters"])
    recording = recording_for("radio", args.log, events_header, bus_choice)
    with recording as log_outputs, bus_choice.open() as bus:
        verdict = _run_phases(args, settings, bus, log_outputs, console)
    report["verdict"] = verdict.plain()
    try:
        if args.report is not None:
            write_atomically(args.report, markdown(verdict, report))
    finally:  # also if the file cannot be written
        report_text = f"filter: {report['filter']}\n\n{details(verdict)}\n{verdict.headline}\n"
        _print_report(args, report_text, report)
    if not verdict.has_passed and not verdict.is_interrupted:
        return 1  # which counts more than a log that lacks its end
    return exit_code_of_run(args, None, verdict.is_interrupted, recording)


def _events_header_of(settings: RadioSettings, parameters: dict[str, Any]) -> EventsHeader:
    """Return the first line of the controller's events; ``parameters`` are all those of the run."""
    from mcp_asdf_tools.recording.events import EventsHeader

    return EventsHeader([settings.controller], settings.swarm.seed, settings.subjects.estimates, parameters)


def _run_phases(
    args: argparse.Namespace,
    settings: RadioSettings,
    bus: can.BusABC,
    log_outputs: LogOutputs,
    console: Console,
) -> ControllerVerdict:
    """Take the controller on ``bus`` through all phases, showing the progress, and return the verdict.

    A signal ends the phases early, and the verdict says so. ``log_outputs`` get the frames and the
    controller's events.
    """
    from mcp_asdf_tools.radio.controller_link import BenchOptions
    from mcp_asdf_tools.radio.verification import Verification

    with stopping() as should_stop, console.status("") as status:
        bench_options = BenchOptions(
            bus,
            # Neither can be 0, as _check_run_options has seen to it.
            ticks=args.steps or _DEFAULT_PHASE_TICKS,
            timeout=args.timeout or _DEFAULT_TIMEOUT,
            wait=args.wait,
            recorder=log_outputs.recorder_of(settings.controller.id),
            log=log_outputs.record_frame,
            should_stop=should_stop,
        )
        verification = Verification(settings, bench_options)

        def show_progress(ticks: int) -> None:
            """Show how many ticks are done, and what the present phase does."""
            status.update(f"tick {ticks}   {verification.bench.activity}")

        bench_options.progress = show_progress
        return verification.run()


def _emulate_neighbours(
    args: argparse.Namespace, settings: RadioSettings, bus_choice: BusChoice, console: Console
) -> int:
    """Run the neighbours until --steps are done or Ctrl-C, print and write results; return the exit code.

    The results are written beside a log, if there is one, as JSON. The exit code is 0, 1 if the bus failed,
    INTERRUPTED if a signal came before the end, and 2 if the log is not complete.
    """
    from mcp_asdf_tools.common.files import results_beside, write_atomically

    results_path = None if args.log is None else results_beside(args.log)
    recording = recording_for("radio", args.log, None, bus_choice)
    with recording as log_outputs, bus_choice.open() as bus:
        radio_run = _run_in_real_time(args, settings, bus, log_outputs, console)
    report = _make_report(args, settings, bus_choice)
    report["results"] = radio_run.figures()
    try:
        if results_path is not None:
            write_atomically(results_path, json_report(report) + "\n")
    finally:  # also if the file cannot be written
        _print_report(args, _format_results(report["results"], report["filter"]), report)
    outcome = radio_run.outcome
    return exit_code_of_run(args, outcome.failure, outcome.is_interrupted, recording)


def _run_in_real_time(
    args: argparse.Namespace,
    settings: RadioSettings,
    bus: can.BusABC,
    log_outputs: LogOutputs,
    console: Console,
) -> RadioRun:
    """Run the neighbours of the controller on ``bus``, showing the progress, and return the run at its end.

    It ends after the ticks of --steps, when a signal comes, or when the bus is gone.
    """
    from mcp_asdf_tools.radio.real_time import RadioRun
    from mcp_asdf_tools.robots.node import BusLink, filters_for

    # Other frames do not concern the neighbours, and need not reach this process.
    bus.set_filters(filters_for(settings.subjects.estimates, settings.subjects.telemetry))
    with stopping() as should_stop:
        # In real time a run goes on while the bus fails, as a controller does.
        link = BusLink(bus, should_stop, tolerates_failures=True, log=log_outputs.record_frame)
        radio_run = RadioRun(settings, link, args.steps)
        _run_with_progress(radio_run, console)
    return radio_run


def _run_with_progress(radio_run: RadioRun, console: Console) -> None:
    """Run the neighbours to the end of the run, and show in every tick the numbers of frames so far."""
    with console.status("") as status:

        def show_progress() -> None:
            """Show the tick and how many frames were sent and heard; called in every tick."""
            status.update(
                f"tick {radio_run.neighbours.ticks}   frames sent {radio_run.sent_count}, "
                f"estimates heard {radio_run.estimate_count}"
            )

        radio_run.on_tick = show_progress
        radio_run.run()


# --- Reports ---------------------------------------------------------------------------------------------


def _make_report(args: argparse.Namespace, settings: RadioSettings, bus_choice: BusChoice) -> dict[str, Any]:
    """Return everything that is needed to repeat the run, as plain values; results are still to be added.

    That is the time, the filter, all parameters, the bus and the versions of software.
    """
    from mcp_asdf_tools.common.versions import software_versions

    robots = [settings.controller, *settings.neighbours]
    return {
        "time": datetime.now(UTC).isoformat(timespec="seconds"),
        "filter": describe_filters(robot.config.filter for robot in robots),
        "parameters": _parameters_of(args, settings),
        "bus": bus_choice.plain(),
        "versions": software_versions(),
    }


def _parameters_of(args: argparse.Namespace, settings: RadioSettings) -> dict[str, Any]:
    """Return the parameters of a run as plain values: robots, formats of frames, world, faults and limits."""
    subjects = {name: asdict(frame_format) for name, frame_format in vars(settings.subjects).items()}
    world_parameters = settings.swarm.parameters()
    return {
        "controller": settings.controller.plain(),
        "neighbours": [neighbour.plain() for neighbour in settings.neighbours],
        "subjects": subjects,
        **{name: world_parameters[name] for name in _WORLD_PARAMETERS},
        "faults": [str(fault) for fault in settings.faults],
        "verify": args.verify,
        "steps": args.steps,
        "timeout": args.timeout,
    }


def _print_report(args: argparse.Namespace, report_text: str, report: dict[str, Any]) -> None:
    """Print the report as JSON with --json, or else the text and the line that makes the run again."""
    if args.json:
        print(json_report(report))
        return
    print(report_text, end="")
    print_again(args, seed=report["parameters"]["seed"])


def _format_results(results: dict[str, Any], filter_description: str) -> str:
    """Format the results of a run in real time for a terminal.

    ``results`` is what ``RadioRun.figures`` returns. There is a line each on the run, the filter, the frames
    and the neighbours, then one for each injected fault and for each id that another node also uses. In these
    texts "it" is the controller, and strangers are nodes that are neither the controller nor emulated.
    """
    lines = [
        f"run         {results['steps']} steps; {results['ending']}",
        f"filter      {filter_description}",
        f"frames      {results['frames_sent']} sent to it, {results['estimates_heard']} estimates heard "
        f"of it, {results['strangers']} from strangers; {results['error_frames']} error frames, "
        f"the bus failed {results['bus_failures']} times",
        f"neighbours  mean x {results['mean_x']:.5f}, spread {results['spread_x']:.5f}",
    ]
    for fault in results["faults"]:
        lines.append(f"fault       {fault['fault']}: struck {fault['injected']} times")
    for sender, count in results["id_conflicts"].items():
        lines.append(
            f"node-id conflict: another node sent {count} messages as robot {sender}; see --first-id"
        )
    return "\n".join(lines) + "\n"
