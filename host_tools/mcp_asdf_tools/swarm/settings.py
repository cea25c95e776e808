"""What defines an emulated swarm, and the robots and the world that follow from it."""

from __future__ import annotations

from dataclasses import asdict, dataclass, field
from decimal import Decimal
from enum import Enum
from typing import Any

from mcp_asdf.robot import (
    B_HAT_MARGIN,
    DEFAULT_FILTER_PERIOD,
    DEFAULT_MEMORY,
    MIN_MEMORY,
    Filter,
)
from mcp_asdf_tools.bus.frames import TELEMETRY, FrameFormat
from mcp_asdf_tools.common.errors import UsageError
from mcp_asdf_tools.robots.clock import ClockKind
from mcp_asdf_tools.robots.record import RobotRecord
from mcp_asdf_tools.robots.rounds import MAX_PERIOD, TickConfig
from mcp_asdf_tools.swarm.fault_spec import Fault
from mcp_asdf_tools.tables.thresholds import generate
from mcp_asdf_tools.world.arena import Arena, ArenaSettings, Tiles, square_side
from mcp_asdf_tools.world.swarm_world import World, arena_seed
from mcp_asdf_tools.world.topology import FullyConnected, Graph, Topology

MAX_ROBOTS = 128
"""Ids 0 .. 127."""
MAX_ROBOTS_AND_TOOLS = 126
"""Ids 0 .. 125: where tools join, 126 and 127 are theirs, as Cyphal has it."""


class Deployment(Enum):
    """Which robots run the filter."""

    PLUS = "plus"
    """All of them: the paper's ASDF+."""
    MINUS = "minus"
    """Only the flawed ones: ASDF-."""
    OFF = "off"
    """None."""


@dataclass(frozen=True)
class Settings:
    """What defines a run; equal settings give equal runs. Raises UsageError if one will not do.

    Attributes:
        robots: N, 1 .. 128, with ids 0 .. N - 1.
        flawed: P, the proportion of robots with a flawed assumed accuracy, 0 .. 1; they are the first
            ``flawed_robots`` ids.
        fill_ratio: f, 0 .. 1.
        true_accuracy: b of every sensor, 0 .. 1; robots that are not flawed assume it.
        flawed_accuracy: b_hat that flawed robots start with, 0 .. 1.
        filter: Which robots re-estimate their b_hat.
        ticks: Length of the run, 1 or more.
        comms_period: Ticks between broadcasts, 1 or more.
        filter_period: Nominal filtering period tau in ticks, a multiple of ``comms_period``.
        omega: Type II error probability, above 0 and at most 0.9; only where robots filter.
        memory: Observations at which t and n are halved, a multiple of 4, 64 .. 2**31.
        seed: Of everything random, 0 or more.
        firmware: Name of the robots' firmware, see ``mcp_asdf_tools.robots.firmwares``.
        frames: Where messages are on the bus.
        ticks_per_second: Of simulated time, or of real time if that is the clock; heartbeats are sent once a
            second, 1 or more.
        telemetry_period: Ticks between two telemetry frames of every robot; 0 for none.
        graph: Who hears whom, if not everybody hears everybody.
        density: Swarm density D of robots that move through a square and hear who is within radio_range;
            None if they do not move.
        radio_range: Of robots that move, in metres.
        faults: What goes wrong, in the order in which it acts.
        clock: What tells when a tick is over.
    """

    robots: int = 20
    flawed: float = 0.3
    fill_ratio: float = 0.55
    true_accuracy: float = 0.95
    flawed_accuracy: float = 0.55
    filter: Deployment = Deployment.PLUS
    ticks: int = 3500
    comms_period: int = 1
    filter_period: int = DEFAULT_FILTER_PERIOD
    omega: Decimal = Decimal("0.05")
    memory: int = DEFAULT_MEMORY
    seed: int = 1
    firmware: str = "native"
    frames: FrameFormat = field(default_factory=FrameFormat)
    ticks_per_second: int = 10
    telemetry_period: int = 0
    graph: Graph | None = None
    density: float | None = None
    radio_range: float = 0.7
    faults: tuple[Fault, ...] = ()
    clock: ClockKind = ClockKind.LOCKSTEP

    def __post_init__(self) -> None:
        for name, least, most in _RANGES:
            value = getattr(self, name)
            if not least <= value <= most:
                raise UsageError(f"{name.replace('_', '-')} is {value}; it must be {least} to {most}")
        if self.filter_period % self.comms_period:
            raise UsageError(
                f"filter-period is {self.filter_period}; it must be a multiple of comms-period, "
                f"{self.comms_period}"
            )
        if self.memory % 4:
            raise UsageError(f"memory is {self.memory}; it must be a multiple of 4")
        if self.telemetry_period and self.frames.subject == TELEMETRY.subject:
            raise UsageError(
                f"subject {TELEMETRY.subject} is that of telemetry; choose another for estimates"
            )
        if self.filter is Deployment.OFF and self.omega != Settings.omega:
            raise UsageError(
                f"omega is {self.omega}, but filter is off: leave out omega or let robots filter"
            )
        self._check_topology()
        self._check_faults()

    def _check_topology(self) -> None:
        if self.graph is not None and self.density is not None:
            raise UsageError("graph and density are both given; robots of a graph do not move, choose one")
        if self.density is None and self.radio_range != Settings.radio_range:
            raise UsageError(
                f"radio-range is {self.radio_range}, which needs robots that move: give a density"
            )
        if self.graph is not None:
            self.graph.check(self.robots)
        make_topology(self)

    def _check_faults(self) -> None:
        for fault in self.faults:
            named = {*(fault.robots or ()), *(fault.receivers or ())}
            if named and max(named) >= self.robots:
                raise UsageError(
                    f"fault {fault} names robot {max(named)}, but the ids of {self.robots} robots are 0 to "
                    f"{self.robots - 1}; take more robots or name another"
                )

    @property
    def flawed_robots(self) -> int:
        """How many robots are flawed: P N to the nearest whole number, halves up."""
        return int(self.flawed * self.robots + 0.5)

    def parameters(self) -> dict[str, Any]:
        """The settings as plain values, for JSON."""
        links = None if self.graph is None else sorted(self.graph.links)
        return asdict(self) | {
            "filter": self.filter.value,
            "omega": float(self.omega),
            "graph": None if self.graph is None else {"source": self.graph.source, "links": links},
            "faults": [str(fault) for fault in self.faults],
            "clock": self.clock.value,
        }


_RANGES: tuple[tuple[str, float, float], ...] = (
    ("robots", 1, MAX_ROBOTS),
    ("flawed", 0, 1),
    ("fill_ratio", 0, 1),
    ("true_accuracy", 0, 1),
    ("flawed_accuracy", 0, 1),
    ("ticks", 1, 10**9),
    ("comms_period", 1, MAX_PERIOD),
    ("filter_period", 1, MAX_PERIOD),
    ("memory", MIN_MEMORY, DEFAULT_MEMORY),
    ("seed", 0, 2**128 - 1),
    ("ticks_per_second", 1, 10**6),
    ("telemetry_period", 0, MAX_PERIOD),
)


def make_topology(settings: Settings) -> Topology:
    """Who can hear whom at tick 0. Raises UsageError if the arena cannot be."""
    if settings.graph is not None:
        return settings.graph
    if settings.density is None:
        return FullyConnected(settings.robots)
    side = square_side(settings.robots, settings.density, settings.radio_range)
    arena = ArenaSettings(
        settings.robots,
        side,
        side,
        Tiles(settings.fill_ratio),
        radio_range=settings.radio_range,
        ticks_per_second=settings.ticks_per_second,
    )
    try:
        return Arena(arena, arena_seed(settings.seed))
    except UsageError as error:
        raise UsageError(f"density is {settings.density:g}: {error}") from error


def make_world(settings: Settings) -> World:
    """The world at tick 0."""
    accuracies = [settings.true_accuracy] * settings.robots
    return World(settings.fill_ratio, accuracies, make_topology(settings), settings.seed)


def robot_records(settings: Settings) -> list[RobotRecord]:
    """How each robot starts, by id."""
    records = []
    for robot_id in range(settings.robots):
        is_flawed = robot_id < settings.flawed_robots
        filters = settings.filter is Deployment.PLUS or (settings.filter is Deployment.MINUS and is_flawed)
        accuracy = settings.flawed_accuracy if is_flawed else settings.true_accuracy
        b_hat = min(max(accuracy, B_HAT_MARGIN), 1 - B_HAT_MARGIN)
        records.append(RobotRecord(robot_id, settings.firmware, b_hat, _config(settings, filters)))
    return records


def _config(settings: Settings, filters: bool) -> TickConfig:
    return TickConfig(
        table=generate(settings.omega, max(2, settings.robots - 1)) if filters else None,
        filter=Filter.ADAPTIVE if filters else Filter.OFF,
        comms_period=settings.comms_period,
        filter_period=settings.filter_period,
        memory=settings.memory,
    )
