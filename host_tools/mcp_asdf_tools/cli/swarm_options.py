"""The options of ``mcp-asdf swarm``."""

from __future__ import annotations

import argparse
from collections.abc import Callable
from dataclasses import fields
from pathlib import Path
from typing import Any

import can

from mcp_asdf_tools.bus import interfaces
from mcp_asdf_tools.bus.frames import FrameFormat
from mcp_asdf_tools.common.errors import UsageError
from mcp_asdf_tools.robots.clock import ClockKind
from mcp_asdf_tools.robots.firmwares import FIRMWARES
from mcp_asdf_tools.swarm.fault_spec import Kind, parse_fault
from mcp_asdf_tools.swarm.medium import Wiring
from mcp_asdf_tools.swarm.remote_robot import check_remote
from mcp_asdf_tools.swarm.settings import Deployment, Settings
from mcp_asdf_tools.tables.thresholds import parse_omega
from mcp_asdf_tools.world.topology import read_graph

_DEFAULTS = Settings()


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the options."""
    _add_experiment(parser)
    _add_topology(parser)
    _add_robots(parser)
    _add_faults(parser)
    _add_bus_and_output(parser)


def _add_experiment(parser: argparse.ArgumentParser) -> None:
    group = parser.add_argument_group("experiment")
    _add(group, "robots", int, "N", "number of robots, 1 to 128 (126 where tools join)")
    _add(group, "flawed", float, "P", "proportion of robots with a flawed assumed accuracy, 0 to 1")
    _add(group, "fill-ratio", float, "F", "share of black tiles, 0 to 1")
    _add(group, "true-accuracy", float, "B", "true accuracy of every sensor; the other robots assume it")
    _add(group, "flawed-accuracy", float, "B", "accuracy that flawed robots assume at the start")
    _add(group, "ticks", int, "N", "length of the run")
    _add(group, "ticks-per-second", int, "N", "of simulated time; heartbeats are sent once a second")
    _add(group, "seed", int, "N", "of everything random")


def _add_topology(parser: argparse.ArgumentParser) -> None:
    group = parser.add_argument_group("who hears whom (default: everybody everybody)")
    group.add_argument(
        "--graph", metavar="FILE", type=Path, help="edges, one a line: '3 5', or '3 > 5' if only 5 hears 3"
    )
    group.add_argument(
        "--density",
        metavar="D",
        type=float,
        help="robots move through a square of this swarm density D and hear those in range",
    )
    _add(group, "radio-range", float, "METRES", "of robots that move")


def _add_faults(parser: argparse.ArgumentParser) -> None:
    kinds = "\n".join(
        f"  {kind.value:10}{kind.text}" + "".join(f"; {option}=" for option in kind.options) for kind in Kind
    )
    group = parser.add_argument_group(
        "what goes wrong, and when a tick is over",
        "A fault is KIND=RATE (1 if left out), then options, all apart by commas. For all: from=TICK,\n"
        "to=TICK (the first without it), robots=0+3-5 (the nodes, or senders of frames). KIND is\n" + kinds,
    )
    group.add_argument(
        "--fault",
        metavar="FAULT",
        action="append",
        default=[],
        dest="faults",
        help="may be given again and again; faults act in the order given",
    )
    group.add_argument(
        "--clock",
        choices=[kind.value for kind in ClockKind],
        default=_DEFAULTS.clock.value,
        help="a tick is over when all is done, or when its time has come (default %(default)s)",
    )


def _add_robots(parser: argparse.ArgumentParser) -> None:
    group = parser.add_argument_group("robots")
    filters = [deployment.value for deployment in Deployment]
    group.add_argument(
        "--filter",
        choices=filters,
        default=_DEFAULTS.filter.value,
        help="which robots recalibrate: all (ASDF+), only the flawed (ASDF-), none (default %(default)s)",
    )
    _add(group, "comms-period", int, "TICKS", "ticks between broadcasts")
    _add(group, "filter-period", int, "TICKS", "nominal filtering period tau, a multiple of --comms-period")
    _add(group, "omega", str, "W", "type II error probability, above 0, at most 0.9; not with --filter off")
    _add(group, "memory", int, "M", "observations at which t and n are halved, a multiple of 4, at least 64")
    group.add_argument(
        "--firmware",
        choices=list(FIRMWARES),
        default=_DEFAULTS.firmware,
        help="the C itself, the same in Python integers, or the paper's equations (default %(default)s)",
    )


def _add_bus_and_output(parser: argparse.ArgumentParser) -> None:
    interfaces.add_arguments(parser)
    parser.add_argument(
        "--slcan",
        metavar="PORT",
        type=int,
        help="let other programs join the bus as an slcan adapter at this TCP port (0: any free one)",
    )
    elsewhere = parser.add_mutually_exclusive_group()
    elsewhere.add_argument(
        "--processes", action="store_true", help="run each robot as a process with a connection of its own"
    )
    elsewhere.add_argument(
        "--device",
        metavar="ID=INTERFACE:CHANNEL",
        action="append",
        default=[],
        help="this robot is a controller there that obeys command frames; may be given again",
    )
    frames = parser.add_argument_group("frames")
    _add(
        frames, "telemetry-period", int, "TICKS", "ticks between two telemetry frames of a robot, 0 for none"
    )
    frame_format = _DEFAULTS.frames
    frames.add_argument(
        "--subject",
        type=int,
        default=frame_format.subject,
        help="Cyphal subject, 0 to 6143 (default %(default)s)",
    )
    frames.add_argument(
        "--priority", type=int, default=frame_format.priority, help="0 (first) to 7 (default %(default)s)"
    )
    output = parser.add_argument_group("output (beside each file, FILE.json gets all parameters and results)")
    output.add_argument("--plot", metavar="FILE", type=Path, help="draw the run: .png, .svg or .pdf")
    output.add_argument(
        "--log",
        metavar="FILE",
        type=Path,
        help="keep all frames: .log (candump), .asc, .blf, .csv, .trc, .txt; FILE.events gets what each "
        "robot saw and heard",
    )
    output.add_argument("--quiet", action="store_true", help="no live table, and one line for a summary")


def _add(
    group: argparse._ArgumentGroup, name: str, kind: Callable[[str], Any], metavar: str, text: str
) -> None:
    default = getattr(_DEFAULTS, name.replace("-", "_"))
    group.add_argument(
        f"--{name}", type=kind, metavar=metavar, default=default, help=f"{text} (default {default})"
    )


def settings_of(args: argparse.Namespace) -> Settings:
    """Read the settings from parsed arguments. Raises UsageError if they will not do."""
    own = {item.name: getattr(args, item.name) for item in fields(Settings) if item.name != "frames"}
    own |= {"filter": Deployment(args.filter), "omega": parse_omega(str(args.omega))}
    own |= {"clock": ClockKind(args.clock), "faults": tuple(map(parse_fault, args.faults))}
    own |= {"graph": None if args.graph is None else read_graph(args.graph)}
    try:
        return Settings(frames=FrameFormat(args.subject, args.priority), **own)
    except ValueError as error:
        raise UsageError(str(error)) from error


def wiring_of(args: argparse.Namespace, settings: Settings, choice: interfaces.BusChoice) -> Wiring:
    """Read from parsed arguments who is on which bus. Raises UsageError if that cannot be."""
    places = list(map(_device, args.device))
    devices = dict(places)
    if len(devices) < len(places):
        raise UsageError(f"two devices are one robot: {', '.join(args.device)}; give each an id of its own")

    def open_bus(robot: int) -> can.BusABC:
        return _open_device(*devices[robot]) if robot in devices else choice.of_robot(robot).open()

    remote = range(settings.robots) if args.processes else devices
    wiring = Wiring(open_bus, not choice.has_channels, frozenset(remote))
    check_remote(settings, wiring)
    return wiring


def _device(text: str) -> tuple[int, tuple[str, str]]:
    """The robot and the bus of ``3=slcan:socket://127.0.0.1:20001``."""
    robot, _, place = text.partition("=")
    interface, _, channel = place.partition(":")
    if not (robot.isascii() and robot.isdigit() and channel) or interface not in can.VALID_INTERFACES:
        raise UsageError(
            f"device is {text!r}; write ID=INTERFACE:CHANNEL, such as 3=slcan:socket://127.0.0.1:20001"
        )
    return int(robot), (interface, channel)


def _open_device(interface: str, channel: str) -> can.BusABC:
    # python-can gives slcan adapters two seconds to start; what answers on a socket has started.
    extra: dict[str, Any] = {"sleep_after_open": 0} if interface == "slcan" else {}
    try:
        bus = can.Bus(interface=interface, channel=channel, ignore_config=True, **extra)
    except (can.CanError, OSError, ValueError) as error:
        raise UsageError(
            f"cannot open the device at {interface}:{channel}: {error}; is it there, and not in use?"
        ) from error
    return interfaces.wrapped(interface, bus)
