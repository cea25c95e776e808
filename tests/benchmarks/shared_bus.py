"""What one connection for a swarm saves on a multicast bus: ``python tests/benchmarks/shared_bus.py``.

The same robots take the same ticks in two ways: as ``mcp-asdf swarm --interface udp_multicast`` has them,
with one connection for all, and with a connection for each robot, at which it takes the frames of all
others. Both end in the same bits. Each takes them three times, by turns, and the fastest counts.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Sequence
from contextlib import ExitStack

import can

from mcp_asdf_tools.bus.interfaces import BusChoice
from mcp_asdf_tools.robots.bus_robot import BusRobot
from mcp_asdf_tools.swarm.carrier import Wiring
from mcp_asdf_tools.swarm.settings import SwarmSettings
from mcp_asdf_tools.swarm.swarm import Swarm
from mcp_asdf_tools.world.world import SteppedWorld

GROUP = BusChoice("udp_multicast", {"channel": "239.74.163.249", "port": 43449, "hop_limit": 0})


def shared(settings: SwarmSettings) -> tuple[float, list[float]]:
    """Return the processor seconds of a swarm with one connection for all, and x of its robots."""
    with Swarm(settings, Wiring(lambda robot: GROUP.open(returns_own=True))) as swarm:
        began = time.process_time()
        for _ in range(settings.steps):
            swarm.tick()
        return time.process_time() - began, [node.robot.x for node in swarm.nodes]


def each(settings: SwarmSettings) -> tuple[float, list[float]]:
    """Return the processor seconds of a swarm with a connection for each robot, and x of its robots."""
    world = SteppedWorld(settings)
    robots = [BusRobot(setup, settings.frames) for setup in settings.robot_setups()]
    with ExitStack() as stack:
        buses = [stack.enter_context(GROUP.open()) for _ in robots]
        began = time.process_time()
        for tick in range(settings.steps):
            now, seen = tick / settings.steps_per_second, world.step()
            sent = [robot.heartbeat(now) for robot in robots] if tick % settings.steps_per_second == 0 else []
            heard: list[list[can.Message]] = [[] for _ in robots]
            frames = [*sent, *(robot.broadcast(now) for robot in robots if robot.observe(seen[robot.id]))]
            for start in range(0, len(frames), len(robots)):  # a socket holds about 200
                for bus, frame in zip(buses, frames[start : start + len(robots)], strict=True):
                    bus.send(frame)
                for bus, own in zip(buses, heard, strict=True):
                    own += [come for _ in robots[1:] if (come := bus.recv(2)) is not None]
            for robot, own in zip(robots, heard, strict=True):
                robot.receive_frames(own)
                robot.settle()
        return time.process_time() - began, [robot.robot.x for robot in robots]


def main(arguments: Sequence[str] | None = None) -> None:
    """Print processor time of each and their ratio, for swarms of each size."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--robots", type=int, nargs="+", default=[20, 127])
    parser.add_argument("--steps", type=int, default=40)
    args = parser.parse_args(arguments)
    for way in (shared, each):  # the first ticks of a process are slower
        way(SwarmSettings(robots=2, steps=args.steps))
    for robots in args.robots:
        settings = SwarmSettings(robots=robots, filter="asdf-plus", steps=args.steps, filter_period=10)
        runs = [(shared(settings), each(settings)) for _ in range(3)]
        assert all(ours[1] == theirs[1] for ours, theirs in runs), "the robots differ"
        one, many = (min(run[way][0] for run in runs) for way in (0, 1))
        print(
            f"{robots} robots: {one / args.steps * 1e3:.2f} ms a tick with one connection for all, ", end=""
        )
        print(f"{many / args.steps * 1e3:.2f} ms with one each: {many / one:.1f} times")


if __name__ == "__main__":
    main()
