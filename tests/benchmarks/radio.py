"""How many frames a second a swarm exchanges over each interface, and what takes the time.

``python tests/benchmarks/radio.py [--robots 20] [--seconds 3] [--topology dynamic] [--fault loss=0.3]
[--socketcan vcan0] [--json]``

Each swarm runs in lockstep in one process, for the given time after one tick to warm up. *x virtual* is the
speed relative to python-can's virtual bus in the same run; *in process* is the run without a bus.
*python-can alone* and *sockets alone* send as many frames over one connection, read them from another, as the
carrier of a swarm does on one bus, and do nothing else: no such swarm can be faster on that interface.
Seconds are of processor time, that of the kernel included. *Delivered* are messages that reached a
neighbour's firmware. *Send* and *receive* are the shares that python-can and the kernel take for that; *rest*
is all that is ours: world, codec, firmware, medium.
"""

from __future__ import annotations

import argparse
import json
import os
import socket
import struct
import time
from collections.abc import Callable, Sequence
from functools import partial
from typing import Any

import can
from rich.console import Console
from rich.table import Table

from mcp_asdf_tools.bus.frames import FrameFormat, Message, encode
from mcp_asdf_tools.bus.interfaces import WithoutEcho, wrapped
from mcp_asdf_tools.swarm.carrier import OpenBus, Wiring
from mcp_asdf_tools.swarm.settings import SwarmSettings
from mcp_asdf_tools.swarm.swarm import Swarm

PORT = 30_000 + os.getpid() % 100 * 130
"""And 128 more: of this process."""
GROUP = ("239.74.163.2", PORT + 128)
COLUMNS = (
    "ticks/s",
    "x virtual",
    "robot-ticks/s",
    "delivered/s",
    "us a delivery",
    "send",
    "receive",
    "rest",
    "limited by",
)

CAN_FRAME = struct.Struct("=IB3x8s")
"""Linux's struct can_frame."""

Row = dict[str, Any]
"""Figures by the names of COLUMNS; those that make no sense are left out."""


class Timed(can.BusABC):
    """A bus whose ``send`` and ``recv`` keep the time that they take in ``spent``."""

    def __init__(self, bus: can.BusABC, spent: dict[str, float]) -> None:
        super().__init__(channel=str(bus.channel_info))
        self.channel_info = bus.channel_info
        self._bus = bus
        self._spent = spent

    def send(self, msg: can.Message, timeout: float | None = None) -> None:
        """As ``can.BusABC.send``."""
        began = time.process_time()
        self._bus.send(msg, timeout)
        self._spent["send"] += time.process_time() - began

    def recv(self, timeout: float | None = None) -> can.Message | None:
        """As ``can.BusABC.recv``."""
        began = time.process_time()
        frame = self._bus.recv(timeout)
        self._spent["receive"] += time.process_time() - began
        return frame

    def shutdown(self) -> None:
        """As ``can.BusABC.shutdown``."""
        super().shutdown()
        self._bus.shutdown()


def measure(settings: SwarmSettings, open_bus: OpenBus | None, is_shared: bool, seconds: float) -> Row:
    """Figures of one swarm, by the names of COLUMNS; the ratio is still missing."""
    spent = {"send": 0.0, "receive": 0.0}
    timed = None if open_bus is None else lambda robot: Timed(open_bus(robot), spent)
    with Swarm(settings, Wiring(timed, is_shared)) as swarm:
        swarm.tick()
        spent.update(dict.fromkeys(spent, 0.0))
        before, began = swarm.traffic.total("delivered"), time.process_time()
        while time.process_time() - began < seconds:
            swarm.tick()
        took, ticks = time.process_time() - began, swarm.ticks - 1
        delivered = swarm.traffic.total("delivered") - before
    shares = {name: each / took for name, each in spent.items()}
    shares["rest"] = 1 - sum(shares.values())
    return {
        "ticks/s": ticks / took,
        "robot-ticks/s": settings.robots * ticks / took,
        "delivered/s": delivered / took,
        "us a delivery": 1e6 * took / max(delivered, 1),
        **shares,
        "limited by": max(shares, key=lambda name: shares[name]),
    }


def alone(send: Callable[[int], object], read: Callable[[], object], robots: int, seconds: float) -> Row:
    """Figures of ticks in which one connection sends a frame of each robot and another reads them."""
    ticks, began = 0, time.process_time()
    while (took := time.process_time() - began) < seconds:
        for robot in range(robots):
            send(robot)
        for _ in range(robots):
            read()
        ticks += 1
    return {"ticks/s": ticks / took, "robot-ticks/s": robots * ticks / took}


def python_can_alone(open_bus: Callable[[], can.BusABC], robots: int, seconds: float) -> Row:
    """Figures of python-can."""
    frames = [encode(Message(robot, 0, 0, 0), FrameFormat()) for robot in range(robots)]
    with open_bus() as sender, open_bus() as listener:
        return alone(lambda robot: sender.send(frames[robot]), partial(listener.recv, 1.0), robots, seconds)


def sockets_alone(
    open_socket: Callable[[], socket.socket], frame: bytes, address: Any, robots: int, seconds: float
) -> Row:
    """Figures of plain sockets."""
    with open_socket() as sender, open_socket() as listener:
        listener.settimeout(1.0)
        return alone(lambda robot: sender.sendto(frame, address), partial(listener.recv, 64), robots, seconds)


def udp_socket() -> socket.socket:
    """A member of a multicast group."""
    one = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    one.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
    one.bind(GROUP)
    one.setsockopt(socket.IPPROTO_IP, socket.IP_ADD_MEMBERSHIP, socket.inet_aton(GROUP[0]) + bytes(4))
    one.setsockopt(socket.IPPROTO_IP, socket.IP_MULTICAST_TTL, 0)
    return one


def can_socket(channel: str) -> socket.socket:
    """A socket on a SocketCAN interface."""
    one = socket.socket(socket.PF_CAN, socket.SOCK_RAW, socket.CAN_RAW)
    one.bind((channel,))
    return one


def without_robots(robots: int, seconds: float, socketcan: str | None) -> dict[str, Row]:
    """Limits of the interfaces: python-can alone, sockets alone."""

    def udp() -> can.BusABC:
        return can.Bus(interface="udp_multicast", port=PORT + 129, hop_limit=0, ignore_config=True)

    def vcan() -> can.BusABC:
        return can.Bus(interface="socketcan", channel=socketcan, ignore_config=True)

    limits = {
        "udp_multicast, python-can alone": python_can_alone(udp, robots, seconds),
        "udp_multicast, sockets alone": sockets_alone(udp_socket, bytes(50), GROUP, robots, seconds),
    }
    if socketcan is not None:
        frame = CAN_FRAME.pack(FrameFormat().identifier(0) | socket.CAN_EFF_FLAG, 8, bytes(8))
        limits |= {
            f"socketcan {socketcan}, python-can alone": python_can_alone(vcan, robots, seconds),
            f"socketcan {socketcan}, sockets alone": sockets_alone(
                lambda: can_socket(socketcan), frame, (socketcan,), robots, seconds
            ),
        }
    return limits


def swarms(socketcan: str | None) -> dict[str, tuple[OpenBus | None, bool]]:
    """Swarms to measure: how to join each robot's bus, and whether that is one for all."""

    def virtual(name: str) -> can.BusABC:
        return can.Bus(interface="virtual", channel=name, ignore_config=True)

    def udp(port: int) -> can.BusABC:
        return WithoutEcho(can.Bus(interface="udp_multicast", port=port, hop_limit=0, ignore_config=True))

    chosen: dict[str, tuple[OpenBus | None, bool]] = {
        "virtual": (lambda robot: virtual("one"), True),
        "in process": (None, True),
        "virtual, a bus each": (lambda robot: virtual(f"own {robot}"), False),
        "udp_multicast": (lambda robot: udp(PORT), True),
        "udp_multicast, a bus each": (lambda robot: udp(PORT + 1 + robot), False),
    }
    if socketcan is not None:
        chosen[f"socketcan {socketcan}"] = (
            lambda robot: wrapped(
                "socketcan",
                can.Bus(interface="socketcan", channel=socketcan, ignore_config=True),
                socketcan,
            ),
            True,
        )
    return chosen


def table_of(rows: dict[str, Row]) -> Table:
    """The figures for people."""
    table = Table("interface", *COLUMNS, box=None)
    forms: dict[str, Callable[[Any], str]] = {
        **dict.fromkeys(COLUMNS, lambda value: f"{value:.0f}"),
        **dict.fromkeys(("send", "receive", "rest"), lambda value: f"{value:.0%}"),
        **dict.fromkeys(("us a delivery", "x virtual"), lambda value: f"{value:.1f}"),
        "limited by": str,
    }
    for name, row in rows.items():
        table.add_row(name, *(forms[column](row[column]) if column in row else "" for column in COLUMNS))
    return table


def main(arguments: Sequence[str] | None = None) -> int:
    """The command line; returns the exit code."""
    parser = argparse.ArgumentParser(
        description="Measure how fast a swarm's robots talk over each interface."
    )
    parser.add_argument("--robots", type=int, default=20, help="default: %(default)s")
    parser.add_argument(
        "--seconds", type=float, default=3.0, help="for each interface (default: %(default)s)"
    )
    parser.add_argument("--topology", default="fully-connected", help="default: %(default)s")
    parser.add_argument("--fault", action="append", default=[], help="as for mcp-asdf swarm, repeatable")
    parser.add_argument("--socketcan", metavar="CHANNEL", help="measure this one, too")
    parser.add_argument("--json", action="store_true", help="print the figures as JSON")
    args = parser.parse_args(arguments)
    settings = SwarmSettings(robots=args.robots, topology=args.topology, faults=tuple(args.fault))
    rows = {
        name: measure(settings, open_bus, is_shared, args.seconds)
        for name, (open_bus, is_shared) in swarms(args.socketcan).items()
    }
    rows |= without_robots(args.robots, args.seconds, args.socketcan)
    for row in rows.values():
        row["x virtual"] = row["ticks/s"] / rows["virtual"]["ticks/s"]
    if args.json:
        print(json.dumps({"robots": args.robots, "interfaces": rows}, indent=2))
    else:
        Console(width=140).print(table_of(rows))
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
