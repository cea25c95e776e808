"""What one connection for a swarm saves on a multicast bus: ``python tests/benchmarks/shared_bus.py``.

The same robots take the same ticks in two ways: as ``mcp-asdf swarm --interface udp_multicast`` has them,
with one connection for all, and with a connection for each robot, at which it takes the frames of all
others. Both end in the same bits. Each takes them three times, by turns, and the fastest counts.
"""

from __future__ import annotations

import argparse
import math
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


def exchange_frames(buses: list[can.BusABC], frames: list[can.Message]) -> list[list[can.Message]]:
    """Send frames, each on the connection of its robot, and return what each connection receives."""
    received: list[list[can.Message]] = [[] for _ in buses]
    for start in range(0, len(frames), len(buses)):  # a socket holds about 200
        for bus, frame in zip(buses, frames[start : start + len(buses)], strict=True):
            bus.send(frame)
        for bus, received_frames in zip(buses, received, strict=True):
            for _ in range(len(buses) - 1):
                frame_of_another = bus.recv(2)
                if frame_of_another is not None:
                    received_frames.append(frame_of_another)
    return received


def separate(settings: SwarmSettings) -> tuple[float, list[float]]:
    """Return the processor seconds of a swarm with a connection for each robot, and x of its robots."""
    world = SteppedWorld(settings)
    robots = [BusRobot(setup, settings.frames) for setup in settings.robot_setups()]
    with ExitStack() as stack:
        buses = [stack.enter_context(GROUP.open()) for _ in robots]
        began = time.process_time()
        for tick in range(settings.steps):
            now, observations = tick / settings.steps_per_second, world.step()
            frames = []
            if tick % settings.steps_per_second == 0:
                frames += [robot.heartbeat(now) for robot in robots]
            for robot in robots:
                if robot.observe(observations[robot.id]):
                    frames.append(robot.broadcast(now))
            for robot, received_frames in zip(robots, exchange_frames(buses, frames), strict=True):
                robot.receive_frames(received_frames)
                robot.settle()
        return time.process_time() - began, [robot.robot.x for robot in robots]


def fastest_of_three(settings: SwarmSettings) -> tuple[float, float]:
    """Run a swarm three times with a shared connection and three times with separate ones, by turns.

    Returns the processor seconds of the fastest shared run and of the fastest separate one. Fails if the
    robots of a shared run end with another x than those of a separate one.
    """
    least_shared = least_separate = math.inf
    for _ in range(3):
        seconds_shared, x_shared = shared(settings)
        seconds_separate, x_separate = separate(settings)
        assert x_shared == x_separate, "the robots differ"
        least_shared = min(least_shared, seconds_shared)
        least_separate = min(least_separate, seconds_separate)
    return least_shared, least_separate


def main(arguments: Sequence[str] | None = None) -> None:
    """Print processor time of each and their ratio, for swarms of each size."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--robots", type=int, nargs="+", default=[20, 127])
    parser.add_argument("--steps", type=int, default=40)
    args = parser.parse_args(arguments)
    for run in (shared, separate):  # the first ticks of a process are slower
        run(SwarmSettings(robots=2, steps=args.steps))
    for robots in args.robots:
        settings = SwarmSettings(robots=robots, filter="asdf-plus", steps=args.steps, filter_period=10)
        seconds_shared, seconds_separate = fastest_of_three(settings)
        ms_shared, ms_separate = seconds_shared / args.steps * 1e3, seconds_separate / args.steps * 1e3
        print(f"{robots} robots: {ms_shared:.2f} ms a tick with one connection for all, ", end="")
        print(f"{ms_separate:.2f} ms with one each: {ms_separate / ms_shared:.1f} times")


if __name__ == "__main__":
    main()
