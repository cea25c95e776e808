"""How many frames a second a swarm exchanges over each interface: ``python tests/benchmarks/radio.py``.

[--robots 20] [--seconds 3]: each swarm runs in lockstep in one process for so long after one tick to warm up.
Seconds are of processor time, that of the kernel included. The baseline is python-can's virtual bus in the
same run.
"""

from __future__ import annotations

import argparse
import os
import time
from collections.abc import Callable

import can

from mcp_asdf_tools.bus.interfaces import WithoutEcho
from mcp_asdf_tools.swarm.carrier import OpenBus, Wiring
from mcp_asdf_tools.swarm.settings import SwarmSettings
from mcp_asdf_tools.swarm.swarm import Swarm

PORT = 30_000 + os.getpid() % 100 * 130
"""And 127 more: of this process."""
BASELINE = "virtual"


def virtual(name: str) -> can.BusABC:
    """A bus of this process."""
    return can.Bus(interface="virtual", channel=name, ignore_config=True)


def udp(port: int) -> can.BusABC:
    """A multicast bus that stays on this machine."""
    return can.Bus(interface="udp_multicast", port=port, hop_limit=0, ignore_config=True)


SWARMS: dict[str, tuple[OpenBus | None, bool]] = {
    BASELINE: (lambda robot: virtual("one"), True),
    "in process": (None, True),
    "virtual, a bus each": (lambda robot: virtual(f"own {robot}"), False),
    "udp_multicast": (lambda robot: WithoutEcho(udp(PORT)), True),
    "udp_multicast, a bus each": (lambda robot: WithoutEcho(udp(PORT + 1 + robot)), False),
}
"""How to join each robot's bus, and whether that is one for all."""


def rate(tick: Callable[[], object], seconds: float) -> float:
    """Ticks per second of processor time."""
    tick()
    ticks, began = 0, time.process_time()
    while (took := time.process_time() - began) < seconds or ticks == 0:
        tick()
        ticks += 1
    return ticks / took


def of_swarm(settings: SwarmSettings, open_bus: OpenBus | None, is_shared: bool, seconds: float) -> float:
    """Ticks per second of a swarm."""
    with Swarm(settings, Wiring(open_bus, is_shared)) as swarm:
        return rate(swarm.tick, seconds)


def main() -> None:
    """Measure and print a table."""
    parser = argparse.ArgumentParser(description="How fast a swarm's robots talk over each interface.")
    parser.add_argument("--robots", type=int, default=20, help="default: %(default)s")
    parser.add_argument("--seconds", type=float, default=3.0, help="for each (default: %(default)s)")
    args = parser.parse_args()
    settings = SwarmSettings(robots=args.robots)
    rates = {name: of_swarm(settings, *wiring, args.seconds) for name, wiring in SWARMS.items()}
    print(f"{'interface':34}{'ticks/s':>10}{f'x {BASELINE}':>12}")
    for name, each in rates.items():
        print(f"{name:34}{each:10.0f}{each / rates[BASELINE]:12.2f}")


if __name__ == "__main__":
    main()
