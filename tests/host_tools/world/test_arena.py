"""The moving world against independent oracles: geometry, rules of motion, floor, and statistics."""

from __future__ import annotations

import json
import math
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from golden import assert_equals_golden_file
from mcp_asdf_tools.common.errors import UsageError
from mcp_asdf_tools.world import _arena
from mcp_asdf_tools.world.arena import Arena, Motion, allocate_memory, make_config
from mcp_asdf_tools.world.floor_code import make_floor_code
from mcp_asdf_tools.world.settings import WorldSettings

RADIUS = 0.0704
"""Radius of a robot's body in metres."""
WHEELS_APART = 0.1054
TICK = 0.1
"""Length of a tick in seconds."""


def moving(robots: int, width: float = 0, height: float = 0, **parameters: Any) -> WorldSettings:
    """Return settings of moving robots. By default the floor's size gives the paper's density."""
    return WorldSettings(topology="dynamic", robots=robots, width=width, height=height, **parameters)


PAPER = moving(20, fill_ratio=0.5)
"""The paper's 20 robots."""
CROWD = moving(60, 1.7, 1.6, radio_range=0.5, fill_ratio=0.5)
"""60 robots that cover a third of the floor, so that there are contacts everywhere."""


def distances_of_pairs(position: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the distances of all pairs, shape (N, N); infinite between a robot and itself."""
    differences = position[:, None] - position[None]  # by robot, robot and coordinate
    distances: NDArray[np.float64] = np.linalg.norm(differences, axis=2)
    np.fill_diagonal(distances, np.inf)
    return distances


def test_robots_without_room_are_refused() -> None:
    """The error names the size of the floor, 0.6 x 0.6 m.

    Settings refuse so small a floor for 60 robots, and are frozen. So it is set behind their back.
    """
    settings = moving(robots=60, width=3, height=3)
    object.__setattr__(settings, "width", 0.6)
    object.__setattr__(settings, "height", 0.6)

    with pytest.raises(UsageError, match=r"60 robots found no room in 0\.6 x 0\.6 m; take fewer or a larger"):
        Arena(settings)


# ---------------------------------------------------------------- determinism


def describe_motion(motion: Motion) -> Iterator[str]:
    """Describe ten robots, one line each: exact numbers of the last tick, and sums over all ticks."""
    for robot in range(10):
        x, y = motion.position[-1, robot]
        cosine, sine = motion.heading[-1, robot]
        black_ticks = motion.black[:, robot].sum()
        links = motion.adjacency[:, robot].sum()
        yield (
            f"robot {robot}: x {x.hex()} y {y.hex()} heading {cosine.hex()} {sine.hex()}, "
            f"black in {black_ticks} ticks, {links} links in all ticks"
        )


@pytest.mark.parametrize(
    ("settings", "name"), [(PAPER, "paper"), (CROWD, "crowd"), (moving(127, density=4.0), "largest_round")]
)
def test_a_seed_gives_the_same_bits_everywhere(settings: WorldSettings, name: str) -> None:
    """Positions and headings after 3000 ticks equal a golden file, as each operation is rounded by IEEE 754.

    A difference in any tick changes all later positions, as robots meet and turn.
    """
    motion = Arena(settings, trial=1).record(ticks=3000)
    lines = list(describe_motion(motion))
    assert_equals_golden_file(f"motion_{name}.txt", lines)


def test_robots_of_another_trial_start_elsewhere() -> None:
    """The settings of both trials are the same, those of 60 robots in a crowd."""
    positions_of_trial_7 = Arena(CROWD, trial=7).positions
    positions_of_trial_8 = Arena(CROWD, trial=8).positions
    assert not np.array_equal(positions_of_trial_7, positions_of_trial_8)


def test_robots_move_the_same_way_however_many_ticks_are_taken_at_once() -> None:
    """An arena takes 500 ticks at once, and another one 0, 1, 2, 97 and 400 ticks.

    All arrays of the motion, such as the positions by tick, are the same in the last 400 ticks.
    """
    motion_in_500_ticks = Arena(CROWD, trial=7).record(ticks=500)
    arena = Arena(CROWD, trial=7)
    for ticks in (0, 1, 2, 97):
        arena.step(ticks)
    motion_in_last_400 = arena.record(ticks=400)
    for name, values_by_tick in vars(motion_in_500_ticks).items():
        assert np.array_equal(getattr(motion_in_last_400, name), values_by_tick[100:]), name


def test_the_present_positions_are_those_after_the_last_tick() -> None:
    """They are compared with those that have been recorded in 50 ticks."""
    arena = Arena(CROWD, trial=7)
    *_, positions_after_last_tick = arena.record(ticks=50).position
    assert np.array_equal(arena.positions, positions_after_last_tick)


# ---------------------------------------------------------------- bodies


FAST_CROWD = replace(CROWD, speed=0.8)


@cache
def motion_in_2000_ticks(settings: WorldSettings, trial: int) -> Motion:
    """Return the motion of robots in 2000 ticks, 200 s. Positions and headings are (ticks, robots, 2)."""
    return Arena(settings, trial).record(ticks=2000)


@cache
def nearest_distances(settings: WorldSettings, trial: int) -> NDArray[np.float64]:
    """Return the distance in metres of the two nearest centres of robots, in every fourth tick."""
    positions = motion_in_2000_ticks(settings, trial=trial).position[::4]
    return np.array([distances_of_pairs(position).min() for position in positions])


ARENAS = pytest.mark.parametrize(
    ("settings", "trial"), [(PAPER, 3), (CROWD, 4), (FAST_CROWD, 5)], ids=["paper", "crowd", "fast"]
)


@ARENAS
def test_bodies_stay_inside_the_walls(settings: WorldSettings, trial: int) -> None:
    """No centre is nearer to a wall than the radius of a robot. The origin is in the middle of the floor."""
    radius = 0.0704
    position = motion_in_2000_ticks(settings, trial=trial).position  # by tick, robot and coordinate
    farthest_from_middle = np.array(settings.sides) / 2 - radius
    rounding = 1e-6
    assert np.all(np.abs(position) <= farthest_from_middle + rounding)


@ARENAS
def test_bodies_of_robots_overlap_by_less_than_half_a_millimetre(settings: WorldSettings, trial: int) -> None:
    """The nearest centres are at least two radii less 0.5 mm apart."""
    radius = 0.0704
    half_a_millimetre = 0.0005
    distance_of_nearest_centres = nearest_distances(settings, trial=trial).min()
    assert distance_of_nearest_centres >= 2 * radius - half_a_millimetre


@ARENAS
def test_no_body_is_faster_than_its_wheels(settings: WorldSettings, trial: int) -> None:
    """No centre moves farther in a tick of 0.1 s than the wheels, which have the speed of the settings."""
    position = motion_in_2000_ticks(settings, trial=trial).position
    moves = np.diff(position, axis=0)  # by tick, robot and coordinate
    distances_in_tick = np.linalg.norm(moves, axis=2)
    rounding = 1e-9
    assert distances_in_tick.max() <= settings.speed * 0.1 * (1 + rounding)


@ARENAS
def test_directions_of_robots_stay_vectors_of_length_one(settings: WorldSettings, trial: int) -> None:
    """The length is 1 to within 1e-9 after each of 2000 ticks. A direction is a cosine and a sine."""
    heading = motion_in_2000_ticks(settings, trial=trial).heading
    lengths = np.linalg.norm(heading, axis=2)  # by tick and robot
    assert np.abs(lengths - 1).max() < 1e-9


def test_robots_in_a_crowd_touch_each_other() -> None:
    """In more than twenty of 500 ticks the two nearest bodies are less than a millimetre apart."""
    radius, millimetre = 0.0704, 0.001
    is_touching = nearest_distances(CROWD, trial=4) < 2 * radius + millimetre  # by tick
    assert is_touching.sum() > 20


def test_half_of_the_robots_in_a_crowd_get_farther_than_a_decimetre_in_a_minute() -> None:
    """So robots that touch each other get away again. The minute is the last 600 of 2000 ticks."""
    positions_by_tick = motion_in_2000_ticks(CROWD, trial=4).position
    position_at_end = positions_by_tick[1999]
    position_a_minute_before = positions_by_tick[1999 - 600]
    distances_travelled = np.linalg.norm(position_at_end - position_a_minute_before, axis=1)
    assert np.median(distances_travelled) > 0.1


# ---------------------------------------------------------------- links


def links_by_definition(position: NDArray[np.float64], settings: WorldSettings) -> NDArray[np.bool_]:
    """Return which pairs are linked: those in range without a third body on the line between them."""
    is_linked = distances_of_pairs(position) < settings.radio_range
    for i, j in np.argwhere(np.triu(is_linked)):  # each pair in range once
        line = position[j] - position[i]
        # The point of the line that is nearest to each robot, as a share of the way from i to j.
        shares = np.clip((position - position[i]) @ line / (line @ line), 0, 1)
        nearest_points = position[i] + shares[:, None] * line
        gaps = np.linalg.norm(nearest_points - position, axis=1)
        gaps[[i, j]] = np.inf  # the ends of the line are no third bodies
        is_linked[i, j] = is_linked[j, i] = gaps.min() >= RADIUS
    return is_linked


@pytest.mark.parametrize(
    "settings", [PAPER, CROWD, moving(128, 6.0, 5.0, speed=0.4), moving(40, 2.0, 2.0, radio_range=0.17)]
)
def test_robots_hear_each_other_if_they_are_in_range_and_no_third_stands_between(
    settings: WorldSettings,
) -> None:
    """Links agree with their definition in 14 successive ticks, and in 5 ticks that are far apart.

    The arena searches for pairs that may be linked every 13 ticks, so this is before and after searches.
    """
    arena = Arena(settings, trial=11)
    has_links_in_any_tick = False
    for ticks in [1] * 14 + [37] * 5:
        position, is_linked = positions_and_links_after(ticks, arena)
        assert np.array_equal(is_linked, links_by_definition(position, settings))
        has_links_in_any_tick |= bool(is_linked.any())

    assert has_links_in_any_tick


def positions_and_links_after(ticks: int, arena: Arena) -> tuple[NDArray[np.float64], NDArray[np.bool_]]:
    """Let an arena take some ticks; return the positions of its robots then, and which pairs are linked."""
    motion = arena.record(ticks)
    return motion.position[-1], motion.adjacency[-1].astype(np.bool_)


def test_robots_in_between_cut_more_than_a_fifth_of_the_links_in_a_crowd() -> None:
    """After 200 ticks fewer than 0.8 of the pairs in range of each other's radio, 0.5 m, are linked."""
    position, is_linked = positions_and_links_after(ticks=200, arena=Arena(CROWD, trial=11))
    is_in_range = distances_of_pairs(position) < 0.5
    assert is_linked.any()
    assert is_linked.sum() < 0.8 * is_in_range.sum()


def candidates_by_definition(arena: Arena) -> list[list[int]]:
    """Return all pairs that could be linked, or see or touch each other, within 12 ticks, in order."""
    settings = arena.settings
    approach_in_tick = 2 * settings.speed * TICK  # of two robots that drive towards each other
    sensor_range = 2 * RADIUS + max(0.12, approach_in_tick)
    relevant_distance = max(settings.radio_range, sensor_range)
    is_candidate = distances_of_pairs(arena.positions) < relevant_distance + 12 * approach_in_tick
    pairs: list[list[int]] = np.argwhere(np.triu(is_candidate)).tolist()
    return pairs


def random_large_arena(density: float) -> Arena:
    """Return an arena of so many robots that candidates are searched in a grid."""
    rng = np.random.default_rng([round(100 * density), 0])
    robots, aspect = int(rng.integers(129, 400)), rng.uniform(0.05, 1)
    side = 0.7 * math.sqrt(robots * math.pi / density / aspect)
    speed, radio_range = rng.choice([0.1414, 0.6]), rng.choice([0.3, 0.7])
    return Arena(moving(robots, side, aspect * side, speed=speed, radio_range=radio_range), 1)


def candidates_of_search(arena: Arena) -> list[list[int]]:
    """Return the pairs of robots that the last search in C has found, in order."""
    arena_in_c = arena._arena
    return [[pair.a, pair.b] for pair in arena_in_c.candidates[0 : arena_in_c.candidate_count]]


@pytest.mark.parametrize("density", [0.02, 0.3, 1.0, 4.0, 10.0])
def test_a_search_in_a_grid_finds_the_same_pairs_of_robots_as_comparing_all(density: float) -> None:
    """Every 13 ticks the arena searches for candidates: pairs that could be linked before the next search.

    More than 128 robots are searched in a grid. The first two searches are compared.
    """
    arena = random_large_arena(density)
    assert candidates_of_search(arena) == candidates_by_definition(arena), arena.settings
    arena.step(ticks=13)
    assert candidates_of_search(arena) == candidates_by_definition(arena), arena.settings


@pytest.mark.parametrize("density", [0.3, 4.0])
def test_hundreds_of_robots_hear_each_other_if_they_are_in_range_and_no_third_stands_between(
    density: float,
) -> None:
    """The links equal those by definition. Those of more than 128 robots are searched in a grid."""
    arena = random_large_arena(density)
    # A search for pairs that may be linked is every 13 ticks, so two of them are in 27 ticks.
    position, is_linked = positions_and_links_after(27, arena)
    assert np.array_equal(is_linked, links_by_definition(position, arena.settings))


@pytest.mark.parametrize(("requested_bytes", "allocated_bytes"), [(1, 8), (8, 8), (9, 16)])
def test_memory_is_allocated_in_whole_units_of_8_bytes(requested_bytes: int, allocated_bytes: int) -> None:
    """A size is rounded up to a multiple of 8, so that what the C puts there is aligned."""
    assert allocate_memory(requested_bytes).nbytes == allocated_bytes


def bytes_per_robot(robots: int) -> float:
    """Return the memory that an arena needs for each of its robots."""
    members, _ = make_config(moving(robots), 0, _arena.ffi)
    config = _arena.ffi.new("mcp_asdf_arena_config_t *", members)
    return float(_arena.lib.mcp_asdf_arena_bytes(config)) / robots


def test_an_arena_needs_as_much_memory_for_each_of_10000_robots_as_for_each_of_1000() -> None:
    """A robot takes 1000 to 2000 bytes. With stored pairs this would grow with the number of robots."""
    assert 1000 < bytes_per_robot(robots=10_000) < 2000
    assert bytes_per_robot(robots=1000) == pytest.approx(bytes_per_robot(robots=10_000), rel=0.01)


# ---------------------------------------------------------------- wheels


class WheelsByTheRules:
    """The rules of turning as their source states them: a state, three transitions in turn, two speeds."""

    def __init__(self) -> None:
        self.state = "none"

    def steer(self, ahead: float, left: float, speed: float) -> tuple[float, float]:
        """Return speed and spin for a vector of obstacles, after the transitions of the state.

        The vector points to the obstacles, and a robot turns to the opposite direction unless a short vector
        points straight ahead.
        """
        is_straight_ahead = abs(math.degrees(math.atan2(left, ahead))) <= 5
        is_ignored = is_straight_ahead and math.hypot(ahead, left) < 0.1
        heading = 0.0 if is_ignored else math.degrees(math.atan2(-left, -ahead))
        angle = abs(heading)
        if self.state == "hard" and angle <= 70:
            self.state = "soft"
        if self.state in ("none", "soft"):
            self.state = self._state_without_hysteresis(angle)
        inner_wheels = {"none": speed, "soft": speed * (1 - angle / 90), "hard": -speed}
        inner_wheel, outer_wheel = inner_wheels[self.state], speed
        side = 1 if heading > 0 else -1
        spin = side * (outer_wheel - inner_wheel) / WHEELS_APART
        return (inner_wheel + outer_wheel) / 2, spin

    @staticmethod
    def _state_without_hysteresis(angle: float) -> str:
        """Return the state that an angle in degrees leads to, unless the robot is in a hard turn."""
        if angle > 90:
            return "hard"
        if angle > 10:
            return "soft"
        return "none"


class WheelsInC:
    """The wheels of the only robot of an arena."""

    def __init__(self) -> None:
        self._owner = Arena(moving(1, 5, 5))  # has the memory of the arena in C
        self._arena = self._owner._arena

    def steer(self, ahead: float, left: float) -> tuple[float, float]:
        """Return speed and spin for a vector of obstacles, at the default speed of the wheels."""
        _arena.lib.mcp_asdf_arena_steer(self._arena, 0, ahead, left)
        return self._arena.target_speed[0], self._arena.target_spin[0]

    @property
    def state(self) -> str:
        """The state of the turn, by the name that `WheelsByTheRules` gives it."""
        return ("none", "soft", "hard")[self._arena.wheels[0]]


def random_vectors(count: int) -> Iterator[tuple[float, float]]:
    """Yield vectors to obstacles, whose direction wanders by 25 degrees, or is on the opposite side.

    Their lengths are around 0.1, below which a vector is short, and far above. A vector points so far ahead,
    and so far to the left.
    """
    rng = np.random.default_rng(6)
    bearings = np.radians(np.cumsum(rng.normal(0, 25, count)) + rng.choice([0, 180], count))
    lengths = rng.choice([0.05, 0.0999, 0.1001, 1.7], count)
    for bearing, length in zip(bearings, lengths, strict=True):
        yield float(length * np.cos(bearing)), float(length * np.sin(bearing))


def test_robots_turn_away_from_obstacles_as_the_authors_controller_does() -> None:
    """Speed, spin and state in C equal those by the rules of the authors' source, for 4000 random obstacles.

    A vector to the obstacles points so far ahead of the robot, and so far to its left. Robots are in a hard
    turn, a soft one, or none, and each of these states occurs.
    """
    default_speed = 0.1414  # metres a second, which the arena in C has, too
    wheels, expected_wheels = WheelsInC(), WheelsByTheRules()
    states = set()
    for ahead, left in random_vectors(count=4000):
        expected_speed_and_spin = expected_wheels.steer(ahead, left, default_speed)
        assert wheels.steer(ahead, left) == pytest.approx(expected_speed_and_spin, abs=1e-12), (ahead, left)
        assert wheels.state == expected_wheels.state
        states.add(wheels.state)

    assert states == {"none", "soft", "hard"}


# ---------------------------------------------------------------- floor


def colours(arena: Arena, points: NDArray[np.float64]) -> NDArray[np.bool_]:
    """Return whether the floor is black at each of the points, shape (points, 2)."""
    return np.array([arena.is_black(x, y) for x, y in points])


def tile_middles(settings: WorldSettings, side: float) -> NDArray[np.float64]:
    """Return the middles of all tiles, shape (columns, rows, 2)."""
    middles = [np.arange(side / 2, length, side) - length / 2 for length in settings.sides]
    return np.stack(np.meshgrid(*middles, indexing="ij"), axis=2)


def tile_colours(fill_ratio: float) -> NDArray[np.bool_]:
    """Return whether the tiles of a floor of 2 x 1.5 m are black, shape (columns, rows)."""
    settings = moving(1, 2, 1.5, fill_ratio=fill_ratio)
    middles = tile_middles(settings, side=0.01)
    columns, rows, _ = middles.shape
    return colours(Arena(settings, 3), middles.reshape(-1, 2)).reshape(columns, rows)


@pytest.mark.parametrize("fill_ratio", [0.0, 0.05, 0.55, 0.95, 1.0])
def test_a_share_of_the_tiles_as_large_as_the_fill_ratio_is_black(fill_ratio: float) -> None:
    """Each of 200 x 150 tiles has a random colour. The share is off by at most four standard deviations."""
    is_black = tile_colours(fill_ratio)  # by column and row
    share_of_black_tiles = is_black.mean()
    standard_deviation = math.sqrt(fill_ratio * (1 - fill_ratio) / (200 * 150))
    assert abs(share_of_black_tiles - fill_ratio) <= 4 * standard_deviation


@pytest.mark.parametrize("fill_ratio", [0.05, 0.55, 0.95])
def test_the_colour_of_a_tile_does_not_depend_on_its_neighbours(fill_ratio: float) -> None:
    """Both tiles of a pair are black with a probability of the fill ratio's square.

    The share among 200 x 150 pairs is off by at most five standard deviations of the share of black tiles.
    """
    is_black = tile_colours(fill_ratio)  # by column and row
    standard_deviation = math.sqrt(fill_ratio * (1 - fill_ratio) / (200 * 150))
    to_the_right, above, diagonally_above = (1, 0), (0, 1), (1, 1)
    for shift in (to_the_right, above, diagonally_above):
        neighbour_is_black = np.roll(is_black, shift, axis=(0, 1))  # beyond an edge lies the opposite edge
        share_of_black_pairs = (is_black & neighbour_is_black).mean()
        assert abs(share_of_black_pairs - fill_ratio**2) <= 5 * standard_deviation, shift


HALF_BLACK_FLOOR = moving(1, 2, 1.5, fill_ratio=0.5)
MIDDLES_OF_TILES = tile_middles(HALF_BLACK_FLOOR, side=0.01).reshape(-1, 2)[::7]
"""The middle of every seventh tile."""


def test_a_tile_has_one_colour() -> None:
    """Points anywhere in a tile of 0.01 m, up to 0.0049 m from its middle, have the colour of its middle."""
    arena = Arena(HALF_BLACK_FLOOR, trial=3)
    offsets = np.random.default_rng(1).uniform(-0.0049, 0.0049, MIDDLES_OF_TILES.shape)
    other_points_of_tiles = MIDDLES_OF_TILES + offsets
    assert np.array_equal(colours(arena, other_points_of_tiles), colours(arena, MIDDLES_OF_TILES))


def test_floors_of_two_trials_have_the_same_colour_in_half_of_the_places() -> None:
    """The share of equal colours is between 0.45 and 0.55. Both floors are half black."""
    colours_of_trial_3 = colours(Arena(HALF_BLACK_FLOOR, trial=3), MIDDLES_OF_TILES)
    colours_of_trial_4 = colours(Arena(HALF_BLACK_FLOOR, trial=4), MIDDLES_OF_TILES)
    is_equal = colours_of_trial_3 == colours_of_trial_4
    assert 0.45 <= is_equal.mean() <= 0.55


def floor_like_a_qr_code(width: float, height: float) -> Arena:
    """Return an arena of this size whose floor is the code of the fill ratio 0.448."""
    return Arena(moving(1, width, height, floor="code", fill_ratio=0.448))


def test_a_picture_of_a_floor_like_a_qr_code_is_the_code() -> None:
    """A picture with a pixel for each of 100 x 100 modules, first row in the north, is the same array."""
    picture = floor_like_a_qr_code(width=3, height=2).pixels(columns=100, rows=100)
    assert np.array_equal(picture, make_floor_code(fill_ratio=0.448))


@pytest.mark.parametrize(
    ("x", "y", "row", "column"), [(-1.5, 1, 0, 0), (1.5, 1, 0, 99), (-1.5, -1, 99, 0), (1.5, -1, 99, 99)]
)
def test_a_corner_of_the_floor_has_the_colour_of_the_nearest_module(
    x: float, y: float, row: int, column: int
) -> None:
    """The floor is 3 m wide and 2 m high with its origin in the middle, and has 100 x 100 modules."""
    code = make_floor_code(fill_ratio=0.448)
    floor = floor_like_a_qr_code(width=3, height=2)
    assert floor.is_black(x, y) == code[row, column]


@pytest.mark.parametrize("floor", [{"fill_ratio": 0.4, "tile": 0.02}, {"fill_ratio": 0.448, "floor": "code"}])
def test_the_ground_sensor_is_in_the_right_front_of_a_robot(floor: dict[str, Any]) -> None:
    """In each of 100 ticks it sees the colour 61.4 mm ahead of a robot's centre, and 10 mm to the right.

    ``heading`` is the direction ahead as a vector of length 1, and ``black`` is what a robot sees.
    """
    arena = Arena(moving(robots=20, width=3, height=2, **floor), trial=9)
    motion = arena.record(ticks=100)
    for tick in range(100):
        for robot in range(20):
            x, y = motion.position[tick, robot]
            x_ahead, y_ahead = motion.heading[tick, robot]
            x_right, y_right = y_ahead, -x_ahead  # the direction ahead, turned clockwise by 90 degrees
            sensor_x = x + 0.0614 * x_ahead + 0.01 * x_right
            sensor_y = y + 0.0614 * y_ahead + 0.01 * y_right
            assert motion.black[tick, robot] == arena.is_black(sensor_x, sensor_y), (tick, robot)


# ---------------------------------------------------------------- statistics

MEAN_DEGREE = 0.867
"""Mean number of neighbours in all trials together. About the mean of each trial alone the degree would look
less persistent: a trial is too short to tell its mean from slow changes."""


def contact_lengths(is_linked: NDArray[np.bool_]) -> NDArray[np.intp]:
    """Return for how many ticks a pair was linked each time, of the times that begin and end within."""
    changes = np.diff(is_linked.astype(np.int8))
    starts = np.flatnonzero(changes == 1)
    ends = np.flatnonzero(changes == -1)
    if is_linked[0]:
        ends = ends[1:]  # the first end belongs to a contact that began before
    if is_linked[-1]:
        starts = starts[:-1]  # the last contact goes on
    return ends - starts


def mean_contact(adjacency: NDArray[np.bool_]) -> float:
    """Return the mean length in ticks of the contacts of all pairs; adjacency is by tick, robot and robot."""
    first_robots, second_robots = np.triu_indices(adjacency.shape[1], k=1)
    links_by_pair = adjacency[:, first_robots, second_robots].T
    return float(np.mean(np.concatenate([contact_lengths(is_linked) for is_linked in links_by_pair])))


def motion_statistics(motion: Motion) -> dict[str, float]:
    """Return every statistic by its name in the reference; in metres, radians and ticks, but speed in m/s."""
    position = motion.position
    degree = motion.adjacency.sum(axis=2, dtype=np.float64)
    distances_in_tick = np.linalg.norm(np.diff(position, axis=0), axis=2)
    statistics = {
        "degree": degree,
        "rounds with 0 neighbours": degree == 0,
        "rounds with 1 neighbour": degree == 1,
        "rounds with 2 or more neighbours": degree >= 2,
        "speed": distances_in_tick / TICK,
        "ticks straight": motion.wheels == 0,
        "ticks in a soft turn": motion.wheels == 1,
        "ticks in a hard turn": motion.wheels == 2,
        "ticks avoiding": motion.avoids,
        "contact": np.array(mean_contact(motion.adjacency)),
    }
    for lag in (1, 10, 50, 100, 500):
        statistics |= statistics_after(lag, motion, deviation=degree - MEAN_DEGREE)
    return {name: float(np.mean(values)) for name, values in statistics.items()}


def statistics_after(lag: int, motion: Motion, deviation: NDArray[np.float64]) -> dict[str, Any]:
    """Return the statistics that compare each tick with the tick ``lag`` ticks later."""
    links_before, links_after = motion.adjacency[:-lag], motion.adjacency[lag:]
    covariance = (deviation[:-lag] * deviation[lag:]).mean()
    moved = motion.position[lag:] - motion.position[:-lag]
    return {
        f"pairs persisting after {lag}": (links_before & links_after).sum() / links_before.sum(),
        f"degree autocorrelation after {lag}": covariance / (deviation**2).mean(),
        f"squared displacement after {lag}": (moved**2).sum(axis=2),
        f"cosine of turn after {lag}": (motion.heading[:-lag] * motion.heading[lag:]).sum(axis=2),
    }


def half_of_last_digit(value: float) -> float:
    """Return half a unit of the last decimal place in which a number is written."""
    _, _, decimals = str(value).partition(".")
    return 0.5 * 10.0 ** -len(decimals)


REFERENCE = Path(__file__).parents[2] / "data/motion_statistics.json"
"""Statistics of the authors' simulation by their names."""
STATISTICS_OF_AUTHORS: dict[str, float] = json.loads(REFERENCE.read_text(encoding="utf-8"))["statistics"]


@pytest.fixture(scope="module")
def statistics_of_trials() -> list[dict[str, float]]:
    """The statistics of twelve trials of 10,000 ticks, by their names."""

    def statistics_of_trial(trial: int) -> dict[str, float]:
        return motion_statistics(Arena(PAPER, trial).record(10_000))

    with ThreadPoolExecutor(2) as pool:
        return list(pool.map(statistics_of_trial, range(12)))


NOT_COMPARED = {
    *("degree without blocking", "avoidance bursts in 1000 s", "ticks between bursts"),
    *("avoidances of a robot", "turn of an avoidance", "time between contacts", "largest coordinate"),
}
"""Statistics of the authors' simulation that are not taken here."""


@pytest.mark.slow
@pytest.mark.parametrize("name", [name for name in STATISTICS_OF_AUTHORS if name not in NOT_COMPARED])
def test_robots_move_and_meet_as_often_as_in_the_authors_simulation(
    name: str, statistics_of_trials: list[dict[str, float]]
) -> None:
    """The mean of twelve trials is within 5 % of the figure of the authors' simulation.

    It may be off by three sampling errors of short trials, and half of the last digit of that figure, more.
    """
    expected_mean = STATISTICS_OF_AUTHORS[name]
    values = np.array([statistics[name] for statistics in statistics_of_trials])  # by trial
    five_percent = 0.05 * abs(expected_mean)
    sampling_error = values.std(ddof=1) / math.sqrt(12)  # ddof=1: of a sample
    tolerance = five_percent + 3 * sampling_error + half_of_last_digit(expected_mean)

    assert len(values) == 12
    assert values.mean() == pytest.approx(expected_mean, abs=tolerance)
