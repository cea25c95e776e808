"""The options of ``mcp-asdf swarm``, and what they describe: settings, and which robot is on which bus."""

from __future__ import annotations

import argparse
from typing import Any, get_args

import can

from mcp_asdf_tools.bus import interfaces
from mcp_asdf_tools.bus.frames import FrameFormat
from mcp_asdf_tools.cli import parameter_options, view
from mcp_asdf_tools.common.errors import UsageError
from mcp_asdf_tools.recording.frame_logs import add_log_option
from mcp_asdf_tools.robots.clock import ClockKind
from mcp_asdf_tools.swarm.carrier import Wiring
from mcp_asdf_tools.swarm.fault_injection.kinds import FAULT_KINDS
from mcp_asdf_tools.swarm.remote_robot import check_remote
from mcp_asdf_tools.swarm.settings import SwarmSettings

PACE = 500.0
"""Steps a second with ``--view``, unless another number is given."""

_DEFAULTS = SwarmSettings()


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare all options of the command."""
    parameter_options.add_common_parameters(parser, SwarmSettings, "swarm and world")
    _add_faults(parser)
    _add_bus_and_output(parser)
    parameter_options.add_further_parameters(parser, SwarmSettings)
    _add_frame_options(parser)


def _add_faults(parser: argparse.ArgumentParser) -> None:
    """Declare the options of disturbances and of the clock, with a help that lists all kinds of fault."""
    kind_lines = []
    for kind in FAULT_KINDS:
        kind_options = "".join(f"; {option}=" for option in kind.own_options())
        kind_lines.append(f"  {kind.name:10}{kind.summary}{kind_options}")
    group = parser.add_argument_group(
        "faults and clock",
        "A fault is KIND=RATE (1 if left out), then options, separated by commas. All kinds have\n"
        "from=TICK, to=TICK (the first without it), robots=0+3-5 (the nodes, or senders of frames).\n"
        + "\n".join(kind_lines),
    )
    group.add_argument(
        "--fault",
        metavar="FAULT",
        action="append",
        default=[],
        dest="faults",
        help="repeatable; faults act in the order given",
    )
    group.add_argument(
        "--clock",
        choices=get_args(ClockKind),
        default=_DEFAULTS.clock,
        help="a tick ends when all frames have arrived, or with its time slot (default %(default)s)",
    )


def _add_bus_and_output(parser: argparse.ArgumentParser) -> None:
    """Declare the options of the bus, of who else is on it, and of what is written and shown."""
    interfaces.add_arguments(parser)
    elsewhere = parser.add_argument_group("robots and programs elsewhere")
    elsewhere.add_argument(
        "--slcan",
        metavar="PORT",
        type=int,
        help="let other programs join the bus as an slcan adapter at this TCP port (0: any free one)",
    )
    remote_robots = elsewhere.add_mutually_exclusive_group()
    remote_robots.add_argument(
        "--processes", action="store_true", help="run each robot as a process with a connection of its own"
    )
    remote_robots.add_argument(
        "--device",
        metavar="ID=INTERFACE:CHANNEL",
        action="append",
        default=[],
        help="this robot is a controller there that obeys command frames; repeatable",
    )
    output = parser.add_argument_group("output (beside a log, FILE.json gets all parameters and results)")
    add_log_option(output, "FILE.events gets what each robot saw and heard")
    output.add_argument(
        "--compare",
        action="store_true",
        help="also run the same swarm without a filter, with ASDF- and with the robust filter",
    )
    output.add_argument("--view", action="store_true", help="show the run in a browser as it goes")
    output.add_argument(
        "--pace", metavar="N", type=float, help=f"steps a second with --view; 0 for any (default {PACE:g})"
    )
    view.add_server_options(output)
    output.add_argument(
        "--quiet", action="store_true", help="nothing while it runs, and one line for a summary"
    )


def _add_frame_options(parser: argparse.ArgumentParser) -> None:
    """Declare the options of the format of estimates."""
    default_format = _DEFAULTS.frames
    group = parser.add_argument_group("frames")
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


def settings_of(args: argparse.Namespace) -> SwarmSettings:
    """Return the settings that the options describe. Raises UsageError for a value out of range."""
    return parameter_options.settings_from(
        args,
        SwarmSettings,
        frames=FrameFormat(args.subject, args.priority),
        faults=args.faults,
        clock=args.clock,
    )


def wiring_of(args: argparse.Namespace, settings: SwarmSettings, choice: interfaces.BusChoice) -> Wiring:
    """Return how the robots of the swarm are connected: which robot joins which bus, and which run elsewhere.

    ``choice`` is the bus of all robots without a ``--device``. Raises UsageError if the options contradict
    each other or the settings.
    """
    devices = dict(_parse_device(text) for text in args.device)
    if len(devices) < len(args.device):
        raise UsageError(f"two devices are one robot: {', '.join(args.device)}; give each an id of its own")

    remote_robots = frozenset(range(settings.robots) if args.processes else devices)

    def open_bus(robot: int) -> can.BusABC:
        # Robots here that share one bus share this connection, so it has to return what they send.
        returns_own = not choice.has_channels and not remote_robots
        return devices.get(robot, choice.of_robot(robot)).open(returns_own)

    needs_bus = remote_robots or args.slcan is not None or choice.has_channels or not choice.is_private
    wiring = Wiring(
        open_bus=open_bus if needs_bus else None,
        is_shared=not choice.has_channels,
        remote=remote_robots,
        channel=choice.channel or "",
    )
    check_remote(settings, wiring)
    return wiring


def _parse_device(text: str) -> tuple[int, interfaces.BusChoice]:
    """Return robot id and bus of a text such as ``3=slcan:socket://127.0.0.1:20001``. Raises UsageError."""
    robot, _, bus_text = text.partition("=")
    interface, _, channel = bus_text.partition(":")
    if not (robot.isascii() and robot.isdigit() and channel) or interface not in can.VALID_INTERFACES:
        raise UsageError(
            f"device is {text!r}; write ID=INTERFACE:CHANNEL, such as 3=slcan:socket://127.0.0.1:20001"
        )
    settings: dict[str, Any] = {"channel": channel, "ignore_config": True}
    if interface == "slcan":  # python-can gives adapters two seconds to start; what answers has started
        settings["sleep_after_open"] = 0
    return int(robot), interfaces.BusChoice(interface, settings)
