"""The parameters of a swarm's world: floor, motion, sensors, and which robots receive from which."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Literal, Self

from mcp_asdf.robot import MAX_ROUND_SIZE
from mcp_asdf_tools.common import extensions
from mcp_asdf_tools.common.errors import did_you_mean
from mcp_asdf_tools.common.parameters import (
    ParameterError,
    check_parameters,
    naming_parameter,
    parameter,
    parameters_of,
)
from mcp_asdf_tools.world.graph import MAX_ON_BUS, MAX_ROBOTS, Graph, parse_edges, parse_graph

MAX_STEPS = 10**9
MAX_PERIOD = 2**32 - 1
"""Longest period, in steps."""
MAX_SIDE = 1000.0
"""Longest side of an arena, in metres."""

_BODY_DIAMETER = 0.1408
"""Diameter of a Khepera IV, in metres."""
_WHEEL_DISTANCE = 0.1054
"""Distance between its wheels, in metres."""
_MAX_COVERED_SHARE = 0.4
"""Largest share of the arena under robots with which a place is found for each robot."""
_MAX_TURN_PER_STEP = 1.6
"""Angle in radians up to which the arena's sine is accurate."""
_MAX_TILES_PER_SIDE = 100_000
_MAX_RANGE_OF_MANY = 1.42
"""Radio range in metres with which a robot has at most 127 neighbours, as many as a round of the firmware
holds. Of two neighbours the nearer one must not stand in the other's line of sight, so their directions
differ by arcsin(radius / range) at least."""


TOPOLOGIES = ("fully-connected", "dynamic", "graph")
"""Which robots receive from which: from all others; from those nearby, while robots move through an arena;
along the edges of a graph."""

Floor = Literal["tiles", "code"]
"""The floor that moving robots observe.

tiles: square tiles, each black with probability f; every trial has its own.
code: a pattern like a QR code's of which exactly the share f is black, the same in all trials.
"""

Drift = Literal["none", "linear"]
"""How the true accuracy changes in step k, counted from 0: not at all, or as b + drift_rate k.

docs/platforms/extending.md shows how to write sensors that change otherwise.
"""

FORMER_PARAMETERS = {"drift_spread": 0.0}
"""Parameters of earlier versions that old recordings and results may state, with the value that had no
effect. (drift_period and drift_diffusion had one only with kinds of drift that are refused today.)"""

_EXTENSION_GROUPS = {
    "firmware": extensions.FIRMWARES,
    "sensor": extensions.SENSORS,
    "topology": extensions.TOPOLOGIES,
}
"""Parameters that may be objects instead of names, and the groups of extensions that these belong to."""

_ARENA_PARAMETERS = ("density", "width", "height", "speed", "radio_range", "floor", "tile")
"""Parameters that are for moving robots alone."""


@dataclass(frozen=True, kw_only=True)
class WorldSettings:
    """Parameters of the ground truth around N robots; equal settings give equal worlds.

    Robots that do not move observe a black tile with probability f in every step anew, as in the paper's
    fully connected experiments; ``density`` to ``tile`` are for moving robots alone. Raises
    ParameterError, naming the parameter, for a value that is wrong or has no effect.
    """

    robots: int = parameter("number of robots (N)", 1, MAX_ROBOTS, default=20)
    topology: str = parameter(
        "who hears whom",
        default="fully-connected",
        choices=extensions.Names(TOPOLOGIES, extensions.TOPOLOGIES),
    )
    graph: Any = parameter("edges of topology graph: a file, or '3 5; 5 > 7' (7 hears 5)", default="")
    fill_ratio: float = parameter("share of black tiles, 0 to 1 (f)", 0, 1, default=0.55)
    true_accuracy: float = parameter(
        "share of right readings of every sensor, 0 to 1 (b)", 0, 1, default=0.95
    )
    white_offset: float = parameter(
        "true accuracy on white tiles minus that on black tiles", -1, 1, default=0.0
    )
    sensor: str = parameter("installed sensor model, instead of the built-in one", default="")
    drift: Drift = parameter("how the true accuracy changes", default="none")
    drift_rate: float = parameter("change of the true accuracy per step", -1, 1, default=0.0)
    lowest_accuracy: float = parameter("lower limit of a drifting accuracy", 0, 1, default=0.5)
    density: float = parameter("swarm density of a square arena (D = N pi r^2 / L^2)", 1e-6, 1e6, default=1.0)
    width: float = parameter(
        "side of the arena along x in metres, instead of a density", 0, MAX_SIDE, default=0.0
    )
    height: float = parameter("side of the arena along y in metres", 0, MAX_SIDE, default=0.0)
    speed: float = parameter("speed limit of a wheel, m/s", 1e-6, 0.814, default=0.1414)
    radio_range: float = parameter(
        "distance below which robots hear each other, metres", 1e-3, MAX_SIDE, default=0.7
    )
    floor: Floor = parameter("floor that moving robots observe", default="tiles")
    tile: float = parameter("side of a tile, metres", 1e-6, MAX_SIDE, default=0.01)
    steps_per_second: int = parameter("steps in a second of simulated time", 1, 1_000_000, default=10)
    observation_period: int = parameter("steps between observations", 1, MAX_PERIOD, default=1)
    steps: int = parameter("length of a run in steps", 1, MAX_STEPS, default=10_000)
    seed: int = parameter("seed of all random numbers", 0, 2**64 - 1, default=1)

    def __post_init__(self) -> None:
        """Bring each value to its type, then check it alone and with those that it must fit.

        An extension's object is replaced by a name for it, and a description of a graph by the Graph. Raises
        ParameterError, naming the parameter, for a value that is wrong or has no effect.
        """
        for name in _EXTENSION_GROUPS:
            # An object is replaced by a name for it first, so that all checks see names.
            if hasattr(self, name):  # the firmware is a parameter of subclasses
                self._replace_value(name, extensions.name_object(getattr(self, name)))
        check_parameters(self)
        # A NumPy array cannot be compared with a text.
        is_empty_text = isinstance(self.graph, str) and self.graph == ""
        if not isinstance(self.graph, Graph) and not is_empty_text:
            with naming_parameter("graph"):
                self._replace_value("graph", parse_graph(self.graph))
        if not self.is_dynamic:
            self._check_no_arena()
        self._check_graph()
        self._check_sensor()
        if self.is_dynamic:
            _check_sides(self)
            _check_arena(self)
            _check_speed(self)
            _check_floor(self)
        if self.robots > MAX_ON_BUS:
            _check_neighbours_of_many(self)

    def _replace_value(self, name: str, value: Any) -> None:
        """Set a value of this frozen dataclass while it is being made."""
        object.__setattr__(self, name, value)

    @classmethod
    def from_parameters(cls, parameters: Mapping[str, Any]) -> Self:
        """Make settings of values by name, such as those of a file that somebody has written.

        A parameter that is not named has its default. Raises ParameterError for a value that is wrong or has
        no effect, and for a name that is no parameter: the message then names a similar one, or else all.
        """
        known_names = cls.__dataclass_fields__
        for name in parameters:
            if name not in known_names:
                # Either text continues the message, and begins with a semicolon.
                ending = did_you_mean(name, known_names) or f"; known are {', '.join(known_names)}"
                raise ParameterError(name, f"unknown key {name!r}{ending}")
        return cls(**parameters)

    @classmethod
    def from_recording(cls, recorded: Mapping[str, Any]) -> Self:
        """Make settings of the parameters that a recording or a file of results states.

        A parameter that it lacks has its default: an older program wrote it. Other entries are left out. The
        name of an extension that is not installed here is kept. Raises ParameterError for a value that is
        wrong or has no effect, for a parameter that only older programs have and that changed the run, and
        for a graph that is not a text of edges: what others have written must not make this program open a
        file.
        """
        for name, value_without_effect in FORMER_PARAMETERS.items():
            value = recorded.get(name, value_without_effect)
            if value != value_without_effect:
                raise ParameterError(
                    name, f"{name} is {value}, a parameter of earlier versions; use one of these versions"
                )
        parameters = {name: recorded[name] for name in parameters_of(cls) if name in recorded}
        cls._keep_unknown_extensions(parameters)
        graph = parameters.get("graph", "")
        if graph != "":
            with naming_parameter("graph"):
                parameters["graph"] = parse_edges(graph)
        return cls(**parameters)

    @classmethod
    def _keep_unknown_extensions(cls, parameters: dict[str, Any]) -> None:
        """Mark the names of extensions that are not installed here as recorded ones, which no check refuses.

        ``parameters`` are changed in place.
        """
        for name, group in _EXTENSION_GROUPS.items():
            value = parameters.get(name, "")
            if not isinstance(value, str) or value == "":
                continue  # there is no name; a value of another type is refused later
            # The parameter ``sensor`` lists no choices: only installed sensors have names.
            known_names = parameters_of(cls)[name].choices or extensions.Names((), group)
            if value not in known_names:
                parameters[name] = extensions.RecordedName(value)

    @property
    def is_dynamic(self) -> bool:
        """True if the robots move."""
        return self.topology == "dynamic"

    @property
    def drifting(self) -> int:
        """Number of robots whose sensors drift, those with the lowest ids; without a drift it has no effect.

        Here it is all of them; a subclass may choose fewer.
        """
        return self.robots

    @property
    def sides(self) -> tuple[float, float]:
        """Width and height of the arena in metres: those given, or a square of the given density."""
        has_sides = self.width != 0
        if has_sides:
            return self.width, self.height
        # The definition of density, D = N pi r^2 / L^2, solved for the side L.
        side = self.radio_range * math.sqrt(self.robots * math.pi / self.density)
        return side, side

    def _check_no_arena(self) -> None:
        """Raise ParameterError if a parameter of arenas is set, which would do nothing without an arena."""
        for name in _ARENA_PARAMETERS:
            value = getattr(self, name)
            if value != _default_of(self, name):
                message = f"{name} is {value} but robots do not move; choose topology dynamic"
                raise ParameterError(name, message)

    def _check_graph(self) -> None:
        """Raise ParameterError for edges without topology graph, and for topology graph without edges.

        It is also raised for a graph that does not suit the number of robots.
        """
        # Edges without the topology graph would have no effect, and that topology needs some. So one without
        # the other is an error.
        needs_graph = self.topology == "graph"
        has_graph = isinstance(self.graph, Graph)
        if needs_graph != has_graph:
            fix = "give its edges" if needs_graph else "choose topology graph"
            raise ParameterError("graph", f"graph is {str(self.graph)!r}: {fix}")
        if isinstance(self.graph, Graph):
            # An error of the check gets the parameter's name, which the check does not know.
            with naming_parameter("graph"):
                self.graph.check(self.robots)

    def _check_sensor(self) -> None:
        """Raise ParameterError for a sensor that is not installed, or parameters of a drift that do not fit.

        Without a drift there may be no rate of it, and a drift may not start below its lowest accuracy.
        """
        if self.sensor:
            # Only extensions have names here. The built-in sensor model is taken if ``sensor`` is empty.
            names_of_extensions = extensions.Names(built_in_names=(), group=extensions.SENSORS)
            if self.sensor not in names_of_extensions:
                choices = ", ".join(names_of_extensions) or "none is installed"
                raise ParameterError("sensor", f"sensor is {self.sensor!r}; choose an extension: {choices}")
        if self.drift == "none" and self.drift_rate:
            message = f"drift_rate is {self.drift_rate} but drift is none; choose a drift"
            raise ParameterError("drift_rate", message)
        if self.drift != "none" and self.lowest_accuracy > self.true_accuracy:
            message = (
                f"lowest_accuracy is {self.lowest_accuracy}; it must be at most true_accuracy, "
                f"{self.true_accuracy}"
            )
            raise ParameterError("lowest_accuracy", message)


def _check_neighbours_of_many(settings: WorldSettings) -> None:
    """Raise ParameterError for a swarm of more than 128 robots if one could have more than 127 neighbours.

    The topology of an extension is refused in any case.
    """
    if settings.is_dynamic:
        # Within a short range only some robots fit into a robot's line of sight, however many there are.
        if settings.radio_range > _MAX_RANGE_OF_MANY:
            raise ParameterError(
                "radio_range",
                f"robots is {settings.robots}, but with radio_range {settings.radio_range:g} some could hear "
                f"more than {MAX_ROUND_SIZE} others; give at most {_MAX_RANGE_OF_MANY}",
            )
        return
    if settings.topology == "graph":
        return  # Graph.check has counted the neighbours already.
    # Every other topology is refused. The lines below compose the message.
    if settings.topology == "fully-connected":
        neighbour_count = settings.robots - 1
        reason = (
            f"each would hear {neighbour_count} others, and a round of the firmware holds {MAX_ROUND_SIZE}"
        )
    else:
        reason = "an extension says who hears whom by a matrix of them for every step"
    fix = f"choose topology dynamic or graph, or at most {MAX_ON_BUS} robots"
    raise ParameterError("robots", f"robots is {settings.robots}, but {reason}; {fix}")


def _default_of(settings: Any, name: str) -> Any:
    """Return the default of the parameter ``name`` in the class of ``settings``."""
    return parameters_of(type(settings))[name].default


def _check_sides(settings: WorldSettings) -> None:
    """Raise ParameterError if both sides and a density are given, or one side without the other.

    A side of 0 is not given. Nor is a density of its default value, which is therefore let through beside
    the sides, and has no effect.
    """
    has_width = settings.width != 0
    has_height = settings.height != 0
    has_density = settings.density != _default_of(settings, "density")
    if has_width and has_density:
        raise ParameterError("density", "density and width say how large the arena is; give one of them")
    if has_width != has_height:
        # The error names the side that the user has to add.
        missing_side = "height" if has_width else "width"
        message = f"the arena is {settings.width} x {settings.height} m; give width and height, or neither"
        raise ParameterError(missing_side, message)


def _check_arena(settings: WorldSettings) -> None:
    """Raise ParameterError for an arena that is too small or too large.

    Too small is one without room for the robots, too large one with a side above MAX_SIDE or too many tiles
    along a side.
    """
    width, height = settings.sides
    size_text = f"{width:.4g} x {height:.4g} m"
    size_parameter = "width" if settings.width else "density"
    if not _has_room_for_robots(settings):
        message = (
            f"{settings.robots} robots of {_BODY_DIAMETER} m are too many for {size_text}; "
            "take a larger arena"
        )
        raise ParameterError(size_parameter, message)
    if max(width, height) > MAX_SIDE:
        message = f"the arena is {size_text}; its sides may be up to {MAX_SIDE:g} m"
        raise ParameterError(size_parameter, message)
    if settings.tile * _MAX_TILES_PER_SIDE < max(width, height):
        message = f"tile is {settings.tile}; choose one with at most {_MAX_TILES_PER_SIDE} along {size_text}"
        raise ParameterError("tile", message)


def _has_room_for_robots(settings: WorldSettings) -> bool:
    """Return whether robots can be placed in the arena at random so that none overlap.

    They cannot if a side is no longer than a robot, or if they cover too much of the floor.
    """
    width, height = settings.sides
    covered_area = settings.robots * math.pi * (_BODY_DIAMETER / 2) ** 2
    max_covered_area = _MAX_COVERED_SHARE * width * height
    return min(width, height) > _BODY_DIAMETER and covered_area <= max_covered_area


def _check_speed(settings: WorldSettings) -> None:
    """Raise ParameterError if a robot could turn by more than _MAX_TURN_PER_STEP in a step."""
    wheel_speed_difference = 2 * settings.speed
    # A robot turns fastest on the spot, with one wheel forwards and the other one backwards.
    radians_per_second = wheel_speed_difference / _WHEEL_DISTANCE
    if radians_per_second > _MAX_TURN_PER_STEP * settings.steps_per_second:
        min_steps_per_second = math.ceil(radians_per_second / _MAX_TURN_PER_STEP)
        message = (
            f"steps_per_second is {settings.steps_per_second}; at this speed it must be "
            f"{min_steps_per_second} or more"
        )
        raise ParameterError("steps_per_second", message)


def _check_floor(settings: WorldSettings) -> None:
    """Raise ParameterError if the floor is "code" and the settings do not suit it; tiles suit any settings.

    Code is a pattern like a QR code's. It has no side of a tile, so ``tile`` must be at its default. Its fill
    ratio must be a whole number of its modules, and leave the fixed parts of the pattern as they are.
    """
    if settings.floor != "code":
        return
    if settings.tile != _default_of(settings, "tile"):
        raise ParameterError("tile", f"tile is {settings.tile} but floor is code, without tiles")
    from mcp_asdf_tools.world.floor_code import make_floor_code  # noqa: PLC0415 (numpy loads slowly)

    # The pattern itself is not needed here: making it raises ParameterError for a fill ratio it cannot have.
    make_floor_code(settings.fill_ratio)
