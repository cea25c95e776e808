"""A moving world: robots diffuse through a walled arena, see its floor and hear those near.

The C files in this folder do the work; docs/arena.md states their model and its sources. An ``Arena`` gives
who hears whom and the colour under each robot; how well robots see it depends on their sensors, and when a
message arrives on what carries it.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mcp_asdf_tools.common.errors import UsageError
from mcp_asdf_tools.world import _arena
from mcp_asdf_tools.world.floor_code import code
from mcp_asdf_tools.world.philox import world_seed
from mcp_asdf_tools.world.settings import WorldSettings


@dataclass(frozen=True, eq=False)
class Motion:
    """State after each of some ticks.

    Attributes:
        position: Centres, shape (ticks, N, 2), in metres.
        heading: Cosine and sine, shape (ticks, N, 2).
        black: 1 if the floor under the ground sensor is black, shape (ticks, N).
        wheels: 0 straight, 1 soft turn, 2 hard turn in the coming tick, shape (ticks, N).
        avoids: 1 if heading away from an obstacle, shape (ticks, N).
        adjacency: Who hears whom, shape (ticks, N, N).
    """

    position: NDArray[np.float64]
    heading: NDArray[np.float64]
    black: NDArray[np.uint8]
    wheels: NDArray[np.uint8]
    avoids: NDArray[np.uint8]
    adjacency: NDArray[np.bool_]


class Arena:
    """The robots of one trial in motion. The same settings and trial give the same bits anywhere."""

    def __init__(self, settings: WorldSettings, trial: int = 0) -> None:
        """Put the robots on the floor: tick 0, all at rest. Raises UsageError if they find no room."""
        self.settings = settings
        self._arena = _arena.ffi.new("mcp_asdf_arena_t *")
        values, self._image = config_values(settings, trial, _arena.ffi)
        config = _arena.ffi.new("mcp_asdf_arena_config_t *", values)
        self._memory = memory_of(_arena.lib.mcp_asdf_arena_bytes(config))
        memory = _arena.ffi.from_buffer(self._memory)
        if not _arena.lib.mcp_asdf_arena_init(self._arena, config, memory):
            width, height = settings.sides  # all else has been checked
            where = f"{settings.robots} robots found no room in {width} x {height} m"
            raise UsageError(f"{where}; take fewer or a larger arena")

    @property
    def positions(self) -> NDArray[np.float64]:
        """Centres, shape (N, 2), in metres from the middle of the floor."""
        return np.stack([self._column(name, np.dtype(np.float64)) for name in "xy"], axis=1)

    def is_black(self, x: float, y: float) -> bool:
        """The colour of the floor at (x, y), which must be on it."""
        return bool(_arena.lib.mcp_asdf_arena_is_black(self._arena, x, y))

    def pixels(self, columns: int, rows: int) -> NDArray[np.bool_]:
        """The floor as a picture: True where it is black, the first row in the north. O(pixels)."""
        width, height = self.settings.sides
        xs = (width * ((np.arange(columns) + 0.5) / columns - 0.5)).tolist()
        ys = (height * (0.5 - (np.arange(rows) + 0.5) / rows)).tolist()
        return np.array([[self.is_black(x, y) for x in xs] for y in ys])

    def step(self, ticks: int = 1) -> None:
        """Let time pass. O(ticks robots)."""
        for _ in range(ticks):
            _arena.lib.mcp_asdf_arena_step(self._arena, 1)

    def record(self, ticks: int) -> Motion:
        """Let time pass and say what each tick left. O(ticks N^2)."""
        shape = (ticks, self.settings.robots)
        position, heading = np.empty((2, *shape, 2))
        black, wheels, avoids = np.empty((3, *shape), np.uint8)
        adjacency = np.zeros((*shape, self.settings.robots), np.bool_)
        columns: dict[str, NDArray[Any]] = {"black": black, "wheels": wheels, "avoids": avoids}
        columns |= {"x": position[:, :, 0], "y": position[:, :, 1]}
        columns |= {"cx": heading[:, :, 0], "cy": heading[:, :, 1]}
        now = {name: self._column(name, values.dtype) for name, values in columns.items()}
        for tick in range(ticks):
            self.step()
            for name, values in columns.items():
                values[tick] = now[name]
            links = _arena.ffi.buffer(self._arena.links, 4 * self._arena.link_count)
            a, b = np.frombuffer(links, np.uint16).reshape(-1, 2).T
            adjacency[tick, a, b] = adjacency[tick, b, a] = True
        return Motion(position, heading, black, wheels, avoids, adjacency)

    def _column(self, name: str, kind: np.dtype[Any]) -> NDArray[Any]:
        """The robots' values, shape (N,), which the next tick overwrites."""
        size = self.settings.robots * kind.itemsize
        return np.frombuffer(_arena.ffi.buffer(getattr(self._arena, name), size), kind)


def memory_of(size: int) -> NDArray[np.float64]:
    """Memory of at least ``size`` bytes, as C code takes it: aligned for doubles."""
    return np.empty(-(-size // 8))


def config_values(settings: WorldSettings, trial: int, ffi: Any) -> tuple[dict[str, Any], object]:
    """The members of a trial's C ``mcp_asdf_arena_config_t``, and what they point to and that must live as
    long. ``ffi`` is that of the extension module which the struct is for.
    """
    width, height = settings.sides
    values = {
        "seed": world_seed(settings.seed, trial),
        "robots": settings.robots,
        "width": width,
        "height": height,
        "speed": settings.speed,
        "range": settings.radio_range,
        "tick": 1 / settings.steps_per_second,
    }
    if settings.floor == "tiles":
        return values | {"tile": settings.tile, "fill_ratio": settings.fill_ratio}, None
    image = code(settings.fill_ratio).astype(np.uint8)
    rows, columns = image.shape
    pointer = ffi.cast("uint8_t *", image.ctypes.data)
    return values | {"image": pointer, "rows": rows, "columns": columns}, image
