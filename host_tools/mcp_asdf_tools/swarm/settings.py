"""Parameters of an emulated swarm."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Any, Self, get_args

from mcp_asdf_tools.bus.frames import TELEMETRY_FORMAT, FrameFormat
from mcp_asdf_tools.common.parameters import ParameterError, naming_parameter, parameter
from mcp_asdf_tools.robots.clock import ClockKind
from mcp_asdf_tools.robots.population import Population
from mcp_asdf_tools.robots.robot_setup import RobotSetup, format_ids, parse_ids
from mcp_asdf_tools.world.graph import MAX_ON_BUS
from mcp_asdf_tools.world.settings import MAX_PERIOD

MAX_ROBOTS_AND_TOOLS = 126
"""Ids 0 .. 125: where tools join, 126 and 127 are theirs, as in Cyphal."""


@dataclass(frozen=True, kw_only=True)
class SwarmSettings(Population):
    """Parameters of a swarm on a bus; equal settings give equal runs.

    Raises ParameterError, naming the field, for a value that it cannot have.

    Attributes:
        telemetry_period: Ticks between two telemetry frames of a robot; 0 for none.
        allow: Ids whose estimates robots accept, such as ``0-19+30``; empty for all.
        frames: Format of estimates.
        faults: Faults in the order in which they act; texts such as ``loss=0.1`` are parsed.
        clock: Clock that ends ticks.
    """

    robots: int = parameter("number of robots (N)", 1, MAX_ON_BUS, default=20)
    telemetry_period: int = parameter(
        "steps between two telemetry frames of a robot; 0: send none", 0, MAX_PERIOD, default=0
    )
    allow: str = parameter("take estimates of these ids only, such as 0-19+30; all if left out", default="")
    frames: FrameFormat = field(default_factory=FrameFormat)
    faults: Any = ()
    clock: ClockKind = "lockstep"

    @classmethod
    def from_recording(cls, recorded: Mapping[str, Any]) -> Self:
        """Return the settings that ``plain`` has written, faults included.

        The format of frames and the clock have their defaults: they do not matter to a run that is over.
        Raises ParameterError for a value that a parameter cannot have, and for a parameter that an older
        program had, that this one lacks, and that changed the run.
        """
        faults = recorded.get("faults", [])
        if not isinstance(faults, list):
            raise ParameterError("faults", f"faults is {faults!r}; give several in a list")
        with naming_parameter("faults"):
            return replace(super().from_recording(recorded), faults=tuple(map(str, faults)))

    def __post_init__(self) -> None:
        """Check the values, parse the texts in ``faults``, and write the ids in ``allow`` in rising order.

        Raises ParameterError, naming the field, for a value that it cannot have, for a fault of a robot that
        the swarm does not have, and if robots send telemetry but estimates have its subject.
        """
        # The kinds of faults take as long to load as all else here, and only the help of swarm shows them.
        from mcp_asdf_tools.swarm.fault_injection.parsing import parse_fault  # noqa: PLC0415

        super().__post_init__()
        if self.clock not in get_args(ClockKind):
            raise ParameterError("clock", f"clock is {self.clock!r}; choose lockstep or real-time")
        if self.allow:
            # The text has ids in rising order, so that equal settings compare as equal.
            with naming_parameter("allow"):
                allowed_ids = parse_ids(self.allow, "allow")
            object.__setattr__(self, "allow", format_ids(allowed_ids))
        # The characters of a text would be taken for faults, one by one.
        if isinstance(self.faults, str):
            raise ParameterError("faults", f"faults is {self.faults!r}; give several in a list or tuple")
        object.__setattr__(self, "faults", tuple(parse_fault(str(fault)) for fault in self.faults))
        if self.telemetry_period and self.frames.subject == TELEMETRY_FORMAT.subject:
            raise ParameterError(
                "frames",
                f"subject {TELEMETRY_FORMAT.subject} is that of telemetry; choose another for estimates",
            )
        self._check_fault_ids()

    def _check_fault_ids(self) -> None:
        """Raise ParameterError if a fault names a robot that the swarm does not have."""
        for fault in self.faults:
            largest_id = max(fault.named_robots, default=0)
            if largest_id >= self.robots:
                raise ParameterError(
                    "faults",
                    f"fault {fault} names robot {largest_id}, but the ids of {self.robots} robots are "
                    f"0 to {self.robots - 1}; take more robots or name another",
                )

    def robot_setups(self) -> list[RobotSetup]:
        """Return the initial state of each robot, by id."""
        allowed_ids = parse_ids(self.allow, "allow") if self.allow else None
        return [replace(self.setup_of(robot), allow=allowed_ids) for robot in range(self.robots)]

    def plain(self) -> dict[str, Any]:
        """Return all settings as plain values, for JSON: the parameters, and frames, faults and clock."""
        return self.parameters() | {
            "frames": {"subject": self.frames.subject, "priority": self.frames.priority},
            "faults": [str(fault) for fault in self.faults],
            "clock": self.clock,
        }
