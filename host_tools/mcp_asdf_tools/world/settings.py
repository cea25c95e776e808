"""The world of a swarm: floor, motion, sensors and who hears whom, as one set of parameters."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Literal, Self

from mcp_asdf_tools.common import extensions
from mcp_asdf_tools.common.errors import UsageError, offer
from mcp_asdf_tools.common.parameters import (
    ParameterError,
    check_parameters,
    parameter,
    parameters_of,
    value_of,
)
from mcp_asdf_tools.world.floor_code import code
from mcp_asdf_tools.world.topology import MAX_ON_BUS, MAX_ROBOTS, Graph, graph_of, graph_of_edges

MAX_STEPS = 10**9
MAX_PERIOD = 2**32 - 1
"""Steps."""
MAX_SIDE = 1000.0
"""Metres."""

_BODY_DIAMETER = 0.1408
_WHEEL_DISTANCE = 0.1054
_MOST_CROWDED = 0.4
"""Largest share of the arena under robots with which a place for each is found."""
_LARGEST_TURN = 1.6
"""Radians in one step."""
_MOST_TILES = 100_000
"""Most tiles along a side."""
_FARTHEST = 1.42
"""Radio range in metres with which a robot hears at most 127 others, a round of the firmware. Of two that it
hears, the nearer one must not stand in the other's way, so their directions differ by arcsin(radius / range)
at least."""


TOPOLOGIES = ("fully-connected", "dynamic", "graph")
"""Who hears whom: all; those nearby, while robots move through an arena; along the edges of a graph."""

Floor = Literal["tiles", "code"]
"""The floor that moving robots observe.

tiles: square tiles, each black with probability f; every trial has its own.
code: a pattern like a QR code's of which exactly the share f is black, the same in all trials.
"""

Drift = Literal["none", "linear", "stepped", "wiener"]
"""How the true accuracy changes, from b at the first step; ``k`` counts steps from 0.

linear: b + rate k.
stepped: b + rate k, with k rounded down to a multiple of drift_period.
wiener: b + rate k + drift_diffusion W(k): a Wiener process with drift of its own for every robot.

All robots have drift_rate in common; each has its own deviation from it, normal with drift_spread.
"""


_OBJECTS = {
    "firmware": extensions.FIRMWARES,
    "sensor": extensions.SENSORS,
    "topology": extensions.TOPOLOGIES,
}
"""Parameters that may be objects, and the groups of extensions that they stand for."""


@dataclass(frozen=True, kw_only=True)
class WorldSettings:
    """Ground truth around N robots; equal settings give equal worlds.

    Robots that do not move observe a black tile with probability f in every step anew, as in the paper's
    fully connected experiments; ``density`` to ``tile`` are for moving robots alone. Raises
    ParameterError, naming the field, for a value that is wrong or has no effect.
    """

    robots: int = parameter("number of robots N", 1, MAX_ROBOTS, default=20)
    topology: str = parameter(
        "who hears whom",
        default="fully-connected",
        choices=extensions.Names(TOPOLOGIES, extensions.TOPOLOGIES),
    )
    graph: Any = parameter("edges of topology graph: a file, or '3 5; 5 > 7' (7 hears 5)", default="")
    fill_ratio: float = parameter("f, share of black tiles", 0, 1, default=0.55)
    true_accuracy: float = parameter("b of every sensor", 0, 1, default=0.95)
    white_offset: float = parameter(
        "true accuracy on white tiles less that on black ones", -1, 1, default=0.0
    )
    sensor: str = parameter("installed sensor model, in place of the built-in one", default="")
    drift: Drift = parameter("how the true accuracy changes", default="none")
    drift_rate: float = parameter("change of the true accuracy per step", -1, 1, default=0.0)
    drift_spread: float = parameter("standard deviation of robots' rates around it", 0, 1, default=0.0)
    drift_period: int = parameter("steps between the changes of a stepped drift", 1, MAX_PERIOD, default=1000)
    drift_diffusion: float = parameter("standard deviation of a Wiener drift per step", 0, 1, default=0.0)
    lowest_accuracy: float = parameter("lower limit of a drifting accuracy", 0, 1, default=0.5)
    density: float = parameter("swarm density D = N pi r^2 / L^2 of a square arena", 1e-6, 1e6, default=1.0)
    width: float = parameter(
        "side of the arena along x in metres, in place of a density", 0, MAX_SIDE, default=0.0
    )
    height: float = parameter("side of the arena along y in metres", 0, MAX_SIDE, default=0.0)
    speed: float = parameter("speed limit of a wheel, m/s", 1e-6, 0.814, default=0.1414)
    radio_range: float = parameter(
        "distance below which robots hear each other, metres", 1e-3, MAX_SIDE, default=0.7
    )
    floor: Floor = parameter("floor that moving robots observe", default="tiles")
    tile: float = parameter("side of a tile, metres", 1e-6, MAX_SIDE, default=0.01)
    steps_per_second: int = parameter("steps per second of simulated time", 1, 1_000_000, default=10)
    observation_period: int = parameter("steps between observations", 1, MAX_PERIOD, default=1)
    steps: int = parameter("length of a run", 1, MAX_STEPS, default=10_000)
    seed: int = parameter("seed of everything random", 0, 2**64 - 1, default=1)

    def __new__(cls, *args: Any, **given: Any) -> Self:
        """Refuse names that are no parameters as values out of range are."""
        known = cls.__dataclass_fields__
        for name in given:
            if name not in known:
                fix = offer(name, known) or f"; known are {', '.join(known)}"
                raise ParameterError(name, f"unknown key {name!r}{fix}")
        if args:
            raise UsageError(f"{args[0]!r} has no name; give parameters by name, such as robots=20")
        return super().__new__(cls)

    def __post_init__(self) -> None:
        for name, group in _OBJECTS.items():
            if hasattr(self, name):
                object.__setattr__(self, name, extensions.name_of(group, getattr(self, name)))
        check_parameters(self)
        if not isinstance(self.graph, Graph) and not (isinstance(self.graph, str) and self.graph == ""):
            with value_of("graph"):
                object.__setattr__(self, "graph", graph_of(self.graph))
        self._check_topology()
        self._check_sensor()
        if self.is_dynamic:
            _check_sides(self)
            _check_arena(self)
            _check_floor(self)
        if self.robots > MAX_ON_BUS:
            _check_many(self)

    @classmethod
    def from_recording(cls, recorded: Mapping[str, Any]) -> Self:
        """Make settings of the parameters that a recording or a file of results states.

        A parameter that it lacks has its default: an older program wrote it. Other entries are left out.
        Raises ParameterError as the class, and for a graph that is not a text of edges: what others have
        written must not make this program open a file.
        """
        parameters = {name: recorded[name] for name in parameters_of(cls) if name in recorded}
        graph = parameters.get("graph", "")
        if graph != "":
            with value_of("graph"):
                parameters["graph"] = graph_of_edges(graph)
        return cls(**parameters)

    @property
    def is_dynamic(self) -> bool:
        """True if the robots move."""
        return self.topology == "dynamic"

    @property
    def drifting(self) -> int:
        """How many of the first robots have sensors that drift."""
        return self.robots

    @property
    def sides(self) -> tuple[float, float]:
        """Width and height of the arena in metres."""
        if self.width:
            return self.width, self.height
        side = self.radio_range * math.sqrt(self.robots * math.pi / self.density)
        return side, side

    def _check_topology(self) -> None:
        for name in () if self.is_dynamic else _OF_ARENA:
            value = getattr(self, name)
            if value != default_of(self, name):
                message = f"{name} is {value} but robots do not move; choose topology dynamic"
                raise ParameterError(name, message)
        if (self.topology == "graph") != isinstance(self.graph, Graph):
            fix = "give its edges" if self.topology == "graph" else "choose topology graph"
            raise ParameterError("graph", f"graph is {str(self.graph)!r}: {fix}")
        if isinstance(self.graph, Graph):
            with value_of("graph"):
                self.graph.check(self.robots)

    def _check_sensor(self) -> None:
        if self.sensor and self.sensor not in extensions.names(extensions.SENSORS):
            installed = ", ".join(extensions.names(extensions.SENSORS)) or "none is installed"
            raise ParameterError("sensor", f"sensor is {self.sensor!r}; choose an extension: {installed}")
        if self.drift == "none":
            for name in ("drift_rate", "drift_spread", "drift_diffusion"):
                if getattr(self, name):
                    raise ParameterError(
                        name, f"{name} is {getattr(self, name)} but drift is none; choose a drift"
                    )
        elif self.lowest_accuracy > self.true_accuracy:
            lowest, start = self.lowest_accuracy, self.true_accuracy
            message = f"lowest_accuracy is {lowest}; it must be at most true_accuracy, {start}"
            raise ParameterError("lowest_accuracy", message)


def _check_many(settings: WorldSettings) -> None:
    """Refuse worlds in which a robot could hear more than 127 others."""
    if settings.topology == "fully-connected":
        others = settings.robots - 1
        why = f"each would hear {others} others, and a round of the firmware holds {MAX_ON_BUS - 1}"
    elif settings.topology not in TOPOLOGIES:
        why = "an extension says who hears whom by a matrix of them for every step"
    elif settings.is_dynamic and settings.radio_range > _FARTHEST:
        why = f"with radio_range {settings.radio_range:g} some could hear more than {MAX_ON_BUS - 1} others"
        message = f"robots is {settings.robots}, but {why}; give at most {_FARTHEST}"
        raise ParameterError("radio_range", message)
    else:
        return
    fix = f"choose topology dynamic or graph, or at most {MAX_ON_BUS} robots"
    raise ParameterError("robots", f"robots is {settings.robots}, but {why}; {fix}")


_OF_ARENA = ("density", "width", "height", "speed", "radio_range", "floor", "tile")


def default_of(settings: Any, name: str) -> Any:
    """The default of a parameter."""
    return parameters_of(type(settings))[name].default


def _check_sides(settings: WorldSettings) -> None:
    if settings.width and settings.density != default_of(settings, "density"):
        raise ParameterError("density", "density and width say how large the arena is; give one of them")
    if (settings.width == 0) != (settings.height == 0):
        message = f"the arena is {settings.width} x {settings.height} m; give width and height, or neither"
        raise ParameterError("width" if settings.width == 0 else "height", message)


def _check_arena(settings: WorldSettings) -> None:
    width, height = settings.sides
    size = f"{width:.4g} x {height:.4g} m"
    key = "width" if settings.width else "density"
    bodies = settings.robots * math.pi * (_BODY_DIAMETER / 2) ** 2
    if min(width, height) <= _BODY_DIAMETER or bodies > _MOST_CROWDED * width * height:
        message = (
            f"{settings.robots} robots of {_BODY_DIAMETER} m are too many for {size}; take a larger arena"
        )
        raise ParameterError(key, message)
    if max(width, height) > MAX_SIDE:
        raise ParameterError(key, f"the arena is {size}; its sides may be up to {MAX_SIDE:g} m")
    if settings.tile * _MOST_TILES < max(width, height):
        message = f"tile is {settings.tile}; choose one with at most {_MOST_TILES} along {size}"
        raise ParameterError("tile", message)
    if 2 * settings.speed / _WHEEL_DISTANCE > _LARGEST_TURN * settings.steps_per_second:
        least = math.ceil(2 * settings.speed / _WHEEL_DISTANCE / _LARGEST_TURN)
        message = f"steps_per_second is {settings.steps_per_second}; at this speed it must be {least} or more"
        raise ParameterError("steps_per_second", message)


def _check_floor(settings: WorldSettings) -> None:
    if settings.floor == "code":
        if settings.tile != default_of(settings, "tile"):
            raise ParameterError("tile", f"tile is {settings.tile} but floor is code, without tiles")
        code(settings.fill_ratio)
