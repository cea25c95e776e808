"""Which CAN bus to use: python-can's own options, variables and files, with an in-process default."""

from __future__ import annotations

import argparse
import configparser
from dataclasses import dataclass
from typing import Any

import can
from can.cli import add_bus_arguments, create_bus_from_namespace
from can.util import load_environment_config, load_file_config

from host_tools.errors import UsageError

DEFAULT_INTERFACE = "virtual"

# Only for what the user leaves open. Time stamps given by the sender make a log depend on the seed
# alone; one hop more and udp_multicast frames would leave this host.
_DEFAULTS: dict[str, dict[str, Any]] = {
    "virtual": {"channel": "vcan0", "preserve_timestamps": True},
    "udp_multicast": {"hop_limit": 0},
}
_OPTIONS = ("interface", "channel", "bitrate", "fd", "data_bitrate", "timing")


@dataclass(frozen=True)
class BusChoice:
    """A bus that can be joined any number of times.

    Attributes:
        interface: python-can's name of the kind of bus.
        channel: The bus among those of its kind; None is the interface's own default.
    """

    interface: str
    channel: str | None
    _args: argparse.Namespace
    _defaults: dict[str, Any]

    def __str__(self) -> str:
        return self.interface + (f" {self.channel}" if self.channel else "")

    def open(self) -> can.BusABC:
        """Join the bus as one more node. Raises UsageError if that is impossible."""
        try:
            return create_bus_from_namespace(self._args, **self._defaults)
        except argparse.ArgumentError as error:
            raise UsageError(
                f"cannot open the bus {self}: {error.__cause__}; see --interface, --channel and --bus-kwargs"
            ) from error


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the bus options that python-can's own tools have."""
    add_bus_arguments(
        parser,
        group_title="bus options (default: the interface 'virtual' inside this process; python-can's "
        "CAN_* variables and configuration files are honoured)",
    )


def choose_bus(args: argparse.Namespace) -> BusChoice:
    """Decide on a bus. Raises UsageError if python-can's variables or files cannot be read."""
    asked = _asked_for(args)
    interface = str(asked.get("interface") or asked.get("bustype") or DEFAULT_INTERFACE)
    defaults = {"interface": interface, **_DEFAULTS.get(interface, {})}
    defaults = {key: value for key, value in defaults.items() if key not in asked}
    channel = asked.get("channel", defaults.get("channel"))
    return BusChoice(interface, None if channel is None else str(channel), args, defaults)


def _asked_for(args: argparse.Namespace) -> dict[str, Any]:
    """What files, variables, ``can.rc`` and arguments say; the later overrule the earlier."""
    merged: dict[str, Any] = {}
    try:
        merged |= load_file_config()
        merged |= load_environment_config()
    except (configparser.Error, OSError, TypeError, ValueError) as error:
        raise UsageError(
            f"python-can's CAN_* variables or configuration files are not valid: {error}"
        ) from error
    given = {name: getattr(args, name) for name in _OPTIONS if name in args}
    return merged | can.rc | given | getattr(args, "bus_kwargs", {})
