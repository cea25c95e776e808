"""A moving world: robots diffuse through a walled arena, see its floor and hear those near.

The C files in this folder do the work; docs/arena.md states their model and its sources. An ``Arena`` is the
``Topology`` of its robots and gives the colour under each; how well they see it depends on their
sensors, and when a message arrives that of what carries it.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mcp_asdf_tools.common import UsageError, check_types
from mcp_asdf_tools.world import _arena

MAX_ROBOTS: int = _arena.lib.MCP_ASDF_ARENA_MAX_ROBOTS
MAX_TICKS = 2**32 - 1
"""At most so many in one call."""

_REASONS = {
    "SIDE": "the arena is {0.width} x {0.height} m; choose sides above 0.1408 (a robot), up to 1000",
    "SPEED": "speed is {0.speed} m/s; choose one above 0, up to 0.814, the Khepera IV's limit",
    "TICK": "steps_per_second is {0.steps_per_second}; choose at least 11.86 times the speed, {0.speed} m/s",
    "RANGE": "radio_range is {0.radio_range} m; choose one above 0, up to 1000",
    "TILE": "the side of a tile is {0.floor.side} m; choose one with at most 100000 tiles along the arena",
    "FILL_RATIO": "fill ratio is {0.floor.fill_ratio}; it must be within 0 to 1",
    "CROWDED": "{0.robots} robots found no room in {0.width} x {0.height} m; take fewer or a larger arena",
}
_FIXES = {getattr(_arena.lib, f"MCP_ASDF_ARENA_ERR_{name}"): reason for name, reason in _REASONS.items()}


@dataclass(frozen=True)
class Tiles:
    """A floor of square tiles, each black by chance and independent of the others; the seed decides.

    Attributes:
        fill_ratio: f, the chance that a tile is black, 0 .. 1.
        side: Of a tile, in metres.
    """

    fill_ratio: float
    side: float = 0.01

    def __post_init__(self) -> None:
        """Raises UsageError for a field of another type; ``Arena`` checks ranges."""
        check_types(self)


@dataclass(frozen=True, eq=False)
class Picture:
    """A floor with a black and white picture, stretched over all of it.

    Attributes:
        pixels: True where black, shape (rows, columns), the first row in the north. At least one pixel.
    """

    pixels: NDArray[np.bool_]

    def __post_init__(self) -> None:
        """Raises UsageError unless it is an array of the shape of a picture."""
        if not (isinstance(self.pixels, np.ndarray) and self.pixels.dtype == np.bool_):
            raise UsageError(f"pixels is {self.pixels!r}; give an array of bool")
        if self.pixels.ndim != 2 or self.pixels.size == 0:
            raise UsageError(f"the picture has shape {self.pixels.shape}; give rows and columns of pixels")

    @property
    def fill_ratio(self) -> float:
        """f, the share of black pixels."""
        return float(np.mean(self.pixels, dtype=np.float64))


@dataclass(frozen=True)
class ArenaSettings:
    """Parameters of an arena; defaults are the paper's.

    Attributes:
        robots: N, 1 .. 128.
        width: Inner side along x, in metres.
        height: Inner side along y, in metres.
        floor: What the robots stand on.
        speed: Limit of a wheel, in m/s.
        radio_range: Distance of centres below which two robots hear each other, in metres.
        see_past: Whether two robots hear each other in spite of a body between them.
        steps_per_second: At least 11.86 a metre times ``speed``, so that no robot turns by more than 1.6 in
            one.
    """

    robots: int
    width: float
    height: float
    floor: Tiles | Picture = field(default_factory=lambda: Tiles(0.5))
    speed: float = 0.1414
    radio_range: float = 0.7
    see_past: bool = False
    steps_per_second: int = 10

    def __post_init__(self) -> None:
        """Raises UsageError for a field of another type; ``Arena`` checks ranges."""
        check_types(self)


def square_side(robots: int, density: float, radio_range: float = 0.7) -> float:
    """L of the square in which the swarm density D = N pi r^2 / L^2 is ``density``.

    Raises UsageError if a value is not positive and finite.
    """
    if not all(0 < value < math.inf for value in (robots, density, radio_range)):
        raise UsageError(
            f"robots {robots}, density {density}, radio_range {radio_range}: all must be positive and finite"
        )
    return radio_range * math.sqrt(robots * math.pi / density)


@dataclass(frozen=True, eq=False)
class Motion:
    """State after each of some ticks.

    Attributes:
        position: Centres, shape (ticks, N, 2), in metres.
        heading: Cosine and sine, shape (ticks, N, 2).
        black: 1 if the floor under the ground sensor is black, shape (ticks, N).
        wheels: 0 straight, 1 soft turn, 2 hard turn in the coming tick, shape (ticks, N).
        avoids: 1 if heading away from an obstacle, shape (ticks, N).
        sees_robot: 1 if a proximity sensor meets a robot, shape (ticks, N).
        linked: Links as bits, shape (ticks, N, 2): bit j % 64 of word j // 64 is set if j is heard.
    """

    position: NDArray[np.float64]
    heading: NDArray[np.float64]
    black: NDArray[np.uint8]
    wheels: NDArray[np.uint8]
    avoids: NDArray[np.uint8]
    sees_robot: NDArray[np.uint8]
    linked: NDArray[np.uint64]

    @property
    def adjacency(self) -> NDArray[np.bool_]:
        """Who hears whom, shape (ticks, N, N)."""
        octets = self.linked.astype("<u8").view(np.uint8)
        bits = np.unpackbits(octets, axis=2, count=self.linked.shape[1], bitorder="little")
        return bits.astype(np.bool_)


class Arena:
    """Robots in motion; a ``Topology``. The same settings and seed give the same bits anywhere."""

    def __init__(self, settings: ArenaSettings, seed: int) -> None:
        """Put the robots on the floor: tick 0, all at rest.

        Raises UsageError if a setting is out of its range, or the seed not in 0 .. 2**64 - 1.
        """
        if not 0 <= seed < 2**64:
            raise UsageError(f"seed is {seed}; choose 0 .. 2**64 - 1")
        if not 1 <= settings.robots <= MAX_ROBOTS:
            raise UsageError(f"robots is {settings.robots}; choose 1 to {MAX_ROBOTS}")
        self.settings = settings
        self._arena = _arena.ffi.new("mcp_asdf_arena_t *")
        values, self._image = config_values(settings, seed, _arena.ffi)
        config = _arena.ffi.new("mcp_asdf_arena_config_t *", values)
        status = _arena.lib.mcp_asdf_arena_init(self._arena, config)
        if status != _arena.lib.MCP_ASDF_ARENA_OK:
            raise UsageError(_FIXES[status].format(settings))

    @property
    def ticks(self) -> int:
        """Number of ticks passed."""
        return int(self._arena.ticks)

    @property
    def positions(self) -> NDArray[np.float64]:
        """Centres, shape (N, 2), in metres from the middle of the floor."""
        return np.stack([self._column("x"), self._column("y")], axis=1)

    @property
    def headings(self) -> NDArray[np.float64]:
        """Cosine and sine, shape (N, 2)."""
        return np.stack([self._column("cx"), self._column("cy")], axis=1)

    @property
    def black(self) -> NDArray[np.uint8]:
        """1 where the floor under a robot's ground sensor is black, shape (N,)."""
        return self._column("black", np.uint8)

    @property
    def links(self) -> NDArray[np.uint8]:
        """Pairs of robots that hear each other, the lower id first, shape (links, 2)."""
        pairs = np.frombuffer(_arena.ffi.buffer(self._arena.links), np.uint8).reshape(-1, 2)
        return pairs[: self._arena.link_count].copy()

    def neighbours(self, robot: int) -> frozenset[int]:
        """Ids of the robots that ``robot`` hears. O(links)."""
        return frozenset(int(b if a == robot else a) for a, b in self.links if robot in (a, b))

    def is_black(self, x: float, y: float) -> bool:
        """The colour of the floor. Raises UsageError if (x, y) is not on it."""
        if not (abs(x) <= self.settings.width / 2 and abs(y) <= self.settings.height / 2):
            raise UsageError(f"({x}, {y}) is outside the arena, whose middle is (0, 0)")
        return bool(_arena.lib.mcp_asdf_arena_is_black(self._arena, x, y))

    def pixels(self, columns: int, rows: int) -> NDArray[np.bool_]:
        """The floor as a picture: True where it is black, the first row in the north. O(pixels)."""
        is_black, arena = _arena.lib.mcp_asdf_arena_is_black, self._arena
        across = (np.arange(columns) + 0.5) / columns - 0.5
        down = 0.5 - (np.arange(rows) + 0.5) / rows
        xs, ys = (self.settings.width * across).tolist(), (self.settings.height * down).tolist()
        return np.array([[is_black(arena, x, y) for x in xs] for y in ys], np.bool_)

    def step(self, ticks: int = 1) -> None:
        """Let time pass. Raises UsageError if ``ticks`` is not in 0 .. MAX_TICKS. O(ticks robots)."""
        self._run(ticks, {})

    def record(self, ticks: int) -> Motion:
        """Let time pass and say what each tick left. Raises as ``step``. Takes 52 bytes a robot and tick."""
        shape = (_check_ticks(ticks), self.settings.robots)
        columns: dict[str, NDArray[Any]] = {
            name: np.empty(shape, np.uint8) for name in ("black", "wheels", "avoids", "sees_robot")
        }
        columns |= {name: np.empty((*shape, 2), np.float64) for name in ("position", "heading")}
        columns["linked"] = np.empty((*shape, 2), np.uint64)
        self._run(ticks, columns)
        return Motion(**columns)

    def _run(self, ticks: int, columns: dict[str, NDArray[Any]]) -> None:
        pointers = {name: _arena.ffi.cast("void *", values.ctypes.data) for name, values in columns.items()}
        record = _arena.ffi.new("mcp_asdf_arena_record_t *", pointers)
        _arena.lib.mcp_asdf_arena_run(self._arena, _check_ticks(ticks), record)

    def _column(self, name: str, kind: type[Any] = np.float64) -> NDArray[Any]:
        values = np.frombuffer(_arena.ffi.buffer(getattr(self._arena, name)), kind)
        return values[: self.settings.robots].copy()


def _check_ticks(ticks: int) -> int:
    if not 0 <= ticks <= MAX_TICKS:
        raise UsageError(f"ticks is {ticks}; choose 0 .. {MAX_TICKS}")
    return ticks


def config_values(settings: ArenaSettings, seed: int, ffi: Any) -> tuple[dict[str, Any], object]:
    """The members of a C ``mcp_asdf_arena_config_t``, and what they point to and that must live as long.

    ``ffi`` is that of the extension module which the struct is for.
    """
    values = {
        "seed": seed,
        "robots": settings.robots,
        "see_past": settings.see_past,
        "width": settings.width,
        "height": settings.height,
        "speed": settings.speed,
        "range": settings.radio_range,
        "tick": 1 / settings.steps_per_second if settings.steps_per_second > 0 else 0.0,
    }
    floor = settings.floor
    if isinstance(floor, Tiles):
        return values | {"tile": floor.side, "fill_ratio": floor.fill_ratio}, None
    image = np.ascontiguousarray(floor.pixels, dtype=np.uint8)
    rows, columns = image.shape
    pointer = ffi.cast("uint8_t *", image.ctypes.data)
    return values | {"image": pointer, "rows": rows, "columns": columns}, image
