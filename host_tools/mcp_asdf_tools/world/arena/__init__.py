"""A moving world: robots diffuse through a walled arena, see its floor and receive from those nearby.

The C files in this folder do the work; docs/internals/arena.md states their model and its sources. An
``Arena`` says which robots receive from which, and the colour under each robot; how well robots see it
depends on their sensors, and when a message arrives on what carries it.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mcp_asdf_tools.common.errors import UsageError
from mcp_asdf_tools.world import _arena
from mcp_asdf_tools.world.floor_code import make_floor_code
from mcp_asdf_tools.world.philox import arena_seed
from mcp_asdf_tools.world.settings import WorldSettings

_KIND_OF_MEMBER: dict[str, type[np.generic]] = {
    "x": np.float64,
    "y": np.float64,
    "cx": np.float64,
    "cy": np.float64,
    "black": np.uint8,
    "wheels": np.uint8,
    "avoids": np.uint8,
}
"""Members of the C struct that are arrays with one value per robot, and the types of these values.

The position of a robot is (x, y), and its heading is (cx, cy)."""


@dataclass(frozen=True, eq=False)
class Motion:
    """The state of an arena after each of some ticks.

    Attributes:
        position: Centres, shape (ticks, N, 2), in metres.
        heading: Cosine and sine, shape (ticks, N, 2).
        black: 1 if the floor under the ground sensor is black, shape (ticks, N).
        wheels: 0 straight, 1 soft turn, 2 hard turn in the coming tick, shape (ticks, N).
        avoids: 1 if heading away from an obstacle, shape (ticks, N).
        adjacency: Whether robot i receives from robot j, shape (ticks, N, N).
    """

    position: NDArray[np.float64]
    heading: NDArray[np.float64]
    black: NDArray[np.uint8]
    wheels: NDArray[np.uint8]
    avoids: NDArray[np.uint8]
    adjacency: NDArray[np.bool_]


class Arena:
    """The robots of one trial in motion. The same settings and trial give the same bits on any machine."""

    def __init__(self, settings: WorldSettings, trial: int = 0) -> None:
        """Put the robots on the floor: tick 0, all at rest. Raises UsageError if they find no room."""
        self.settings = settings
        self._arena = _arena.ffi.new("mcp_asdf_arena_t *")
        # The C code keeps pointers to the picture of the floor and to the memory: this object keeps both.
        members, self._floor_image = make_config(settings, trial, _arena.ffi)
        config = _arena.ffi.new("mcp_asdf_arena_config_t *", members)
        self._memory = allocate_memory(_arena.lib.mcp_asdf_arena_bytes(config))
        memory_pointer = _arena.ffi.from_buffer(self._memory)
        has_room = _arena.lib.mcp_asdf_arena_init(self._arena, config, memory_pointer)
        if not has_room:
            width, height = settings.sides  # all other settings have been checked
            problem = f"{settings.robots} robots found no room in {width} x {height} m"
            raise UsageError(f"{problem}; take fewer or a larger arena")

    @property
    def positions(self) -> NDArray[np.float64]:
        """Centres, shape (N, 2), in metres from the middle of the floor."""
        xs = self._values_now("x")
        ys = self._values_now("y")
        return np.stack([xs, ys], axis=1)

    def is_black(self, x: float, y: float) -> bool:
        """Return whether the floor is black at (x, y), in metres from its middle, which must be on it."""
        return bool(_arena.lib.mcp_asdf_arena_is_black(self._arena, x, y))

    def pixels(self, columns: int, rows: int) -> NDArray[np.bool_]:
        """Return the floor as a picture of shape (rows, columns), True where the middle of a pixel is black.

        The first row is the one in the north, where y is largest. O(pixels).
        """
        width, height = self.settings.sides
        # Middles of pixels as shares of a side, from 0 to 1. The arena's origin is in its middle, x grows to
        # the right with the columns, and y upwards, against the rows.
        column_shares = (np.arange(columns) + 0.5) / columns
        row_shares = (np.arange(rows) + 0.5) / rows
        xs = (width * (column_shares - 0.5)).tolist()
        ys = (height * (0.5 - row_shares)).tolist()
        pixel_rows = []
        for y in ys:
            pixel_rows.append([self.is_black(x, y) for x in xs])
        return np.array(pixel_rows)

    def step(self, ticks: int = 1) -> None:
        """Let ticks pass, one of which is a step of the run. O(ticks robots)."""
        arena_count = 1  # The engine in C steps several arenas side by side.
        for _ in range(ticks):
            _arena.lib.mcp_asdf_arena_step(self._arena, arena_count)

    def record(self, ticks: int) -> Motion:
        """Let ticks pass, and return the state after each. O(ticks N^2).

        The result has arrays whose first axis is the tick: positions and headings, the colour under each
        robot, how wheels turn, who avoids an obstacle, and who receives from whom.
        """
        robots = self.settings.robots
        # Views of the C struct's members, which show the new values after every step.
        values_now = {name: self._values_now(name) for name in _KIND_OF_MEMBER}
        rows = {name: np.empty((ticks, robots), kind) for name, kind in _KIND_OF_MEMBER.items()}
        adjacency = np.zeros((ticks, robots, robots), np.bool_)
        for tick in range(ticks):
            self.step()
            for name, values in values_now.items():
                rows[name][tick] = values
            lower_ids, higher_ids = self._linked_pairs()
            # Robots in range of each other receive both ways.
            adjacency[tick, lower_ids, higher_ids] = True
            adjacency[tick, higher_ids, lower_ids] = True
        return Motion(
            position=np.stack([rows["x"], rows["y"]], axis=2),
            heading=np.stack([rows["cx"], rows["cy"]], axis=2),
            black=rows["black"],
            wheels=rows["wheels"],
            avoids=rows["avoids"],
            adjacency=adjacency,
        )

    def _linked_pairs(self) -> tuple[NDArray[np.uint16], NDArray[np.uint16]]:
        """Return the lower ids and the higher ids of the pairs of robots that receive from each other now.

        Both arrays are views of the C memory, which hold until the next step.
        """
        bytes_in_pair = 4  # two ids of 16 bits
        links = _arena.ffi.buffer(self._arena.links, bytes_in_pair * self._arena.link_count)
        pairs = np.frombuffer(links, np.uint16).reshape(-1, 2)
        return pairs[:, 0], pairs[:, 1]

    def _values_now(self, name: str) -> NDArray[Any]:
        """Return a view of a member of the C struct, shape (N,), with the values of the present tick."""
        kind = np.dtype(_KIND_OF_MEMBER[name])
        byte_count = self.settings.robots * kind.itemsize
        return np.frombuffer(_arena.ffi.buffer(getattr(self._arena, name), byte_count), kind)


def allocate_memory(size: int) -> NDArray[np.float64]:
    """Return memory of at least ``size`` bytes, aligned for doubles, as the C code takes it."""
    bytes_in_double = 8
    return np.empty(math.ceil(size / bytes_in_double))


def make_config(settings: WorldSettings, trial: int, ffi: Any) -> tuple[dict[str, Any], object]:
    """Return the members of a trial's C ``mcp_asdf_arena_config_t``, and an object that must live as long.

    That object is the picture of the floor, to which a member points, for a floor of kind "code"; it is None
    for a floor of tiles, which C generates itself. ``ffi`` belongs to the extension module that the struct is
    for.
    """
    width, height = settings.sides
    members: dict[str, Any] = {
        "seed": arena_seed(settings.seed, trial),
        "robots": settings.robots,
        "width": width,
        "height": height,
        "speed": settings.speed,
        "range": settings.radio_range,
        "tick": 1 / settings.steps_per_second,  # in seconds
    }
    if settings.floor == "tiles":
        members["tile"] = settings.tile
        members["fill_ratio"] = settings.fill_ratio
        return members, None
    image = make_floor_code(settings.fill_ratio).astype(np.uint8)
    # The pointer does not keep the picture alive, so the caller has to hold it.
    members["image"] = ffi.cast("uint8_t *", image.ctypes.data)
    members["rows"], members["columns"] = image.shape
    return members, image
