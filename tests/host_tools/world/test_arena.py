"""The moving world against independent oracles: geometry, rules of motion, floor, and statistics."""

from __future__ import annotations

import hashlib
import itertools
import json
import math
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from mcp_asdf_tools.common.errors import UsageError
from mcp_asdf_tools.world import _arena
from mcp_asdf_tools.world.arena import Arena, Motion, allocate_memory, make_config
from mcp_asdf_tools.world.floor_code import make_floor_code
from mcp_asdf_tools.world.settings import WorldSettings

RADIUS, WHEELS_APART, TICK = 0.0704, 0.1054, 0.1
DATA = Path(__file__).parents[2] / "data/motion_statistics.json"
REFERENCE = json.loads(DATA.read_text(encoding="utf-8"))["statistics"]


def moving(robots: int, width: float = 0, height: float = 0, **more: Any) -> WorldSettings:
    return WorldSettings(topology="dynamic", robots=robots, width=width, height=height, **more)


PAPER = moving(20, fill_ratio=0.5)
CROWD = moving(60, 1.7, 1.6, radio_range=0.5, fill_ratio=0.5)
"""A third of the floor is robots: contacts everywhere."""


def distances(position: NDArray[np.float64]) -> NDArray[np.float64]:
    """Distances of all pairs, shape (N, N); infinite between a robot and itself."""
    apart: NDArray[np.float64] = np.linalg.norm(position[:, None] - position[None], axis=2)
    np.fill_diagonal(apart, np.inf)
    return apart


def test_robots_without_room_are_refused() -> None:
    crowded = moving(60, 3, 3)
    for side in ("width", "height"):
        object.__setattr__(crowded, side, 0.6)  # which settings would have refused
    with pytest.raises(UsageError, match=r"60 robots found no room in 0\.6 x 0\.6 m; take fewer or a larger"):
        Arena(crowded)


# ---------------------------------------------------------------- determinism


@pytest.mark.parametrize(
    ("settings", "expected"),
    [
        (PAPER, "9da4ac4df8883d84"),
        (CROWD, "b076104f7f9d6271"),
        (moving(127, density=4.0), "036003a4cf6e9dcc"),
    ],
)
def test_a_seed_gives_the_same_bits_everywhere(settings: WorldSettings, expected: str) -> None:
    """The digest stands for every machine: the arena uses only operations that IEEE 754 rounds correctly."""
    motion = Arena(settings, 1).record(3000)
    digest = hashlib.sha256()
    linked = np.zeros((*motion.black.shape, 16), np.uint8)  # a bit for each of 128 robots
    bits = np.packbits(motion.adjacency, axis=2, bitorder="little")
    linked[:, :, : bits.shape[2]] = bits
    for values in (motion.position, motion.heading, linked, motion.black):
        digest.update(values.astype(values.dtype.newbyteorder("<")).tobytes())
    assert digest.hexdigest()[:16] == expected


def test_trials_differ() -> None:
    assert not np.array_equal(Arena(CROWD, 7).positions, Arena(CROWD, 8).positions)


def test_time_may_pass_in_any_portions() -> None:
    motion, arena = Arena(CROWD, 7).record(500), Arena(CROWD, 7)
    for ticks in (0, 1, 2, 97):
        arena.step(ticks)
    for name, values in vars(arena.record(400)).items():
        assert np.array_equal(values, getattr(motion, name)[100:]), name


def test_the_positions_are_those_after_the_last_tick() -> None:
    arena = Arena(CROWD, 7)
    assert np.array_equal(arena.record(50).position[-1], arena.positions)


# ---------------------------------------------------------------- bodies


FAST_CROWD = replace(CROWD, speed=0.8)


@pytest.fixture(
    scope="module", params=[(PAPER, 3), (CROWD, 4), (FAST_CROWD, 5)], ids=["paper", "crowd", "fast"]
)
def run(request: pytest.FixtureRequest) -> tuple[WorldSettings, Motion]:
    """The settings of an arena, and its motion in 3000 ticks."""
    settings, trial = request.param
    return settings, Arena(settings, trial).record(3000)


def nearest_distances(motion: Motion) -> NDArray[np.float64]:
    """Return the distance of the two nearest centres, in every third tick."""
    return np.array([distances(position).min() for position in motion.position[::3]])


def test_bodies_stay_inside_the_walls(run: tuple[WorldSettings, Motion]) -> None:
    settings, motion = run
    assert np.all(np.abs(motion.position) <= np.array(settings.sides) / 2 - RADIUS + 1e-6)


def test_bodies_do_not_overlap(run: tuple[WorldSettings, Motion]) -> None:
    _, motion = run
    assert nearest_distances(motion).min() >= 2 * RADIUS - 5e-4


def test_no_body_is_faster_than_its_wheels(run: tuple[WorldSettings, Motion]) -> None:
    settings, motion = run
    distances_in_tick = np.linalg.norm(np.diff(motion.position, axis=0), axis=2)
    assert distances_in_tick.max() <= settings.speed * TICK * (1 + 1e-9)


def test_headings_keep_their_length(run: tuple[WorldSettings, Motion]) -> None:
    _, motion = run
    assert np.abs(np.linalg.norm(motion.heading, axis=2) - 1).max() < 1e-9


def test_robots_in_a_crowd_touch_and_go_on() -> None:
    motion = Arena(CROWD, 4).record(3000)
    assert (nearest_distances(motion) < 2 * RADIUS + 1e-3).sum() > 20
    distances_in_a_minute = np.linalg.norm(motion.position[-1] - motion.position[-600], axis=1)
    assert np.median(distances_in_a_minute) > 0.1


# ---------------------------------------------------------------- links


def links_by_definition(position: NDArray[np.float64], settings: WorldSettings) -> NDArray[np.bool_]:
    """Return which pairs are linked: those in range without a third body on the line between them."""
    linked = distances(position) < settings.radio_range
    for i, j in np.argwhere(np.triu(linked)):
        line = position[j] - position[i]
        shares = np.clip((position - position[i]) @ line / (line @ line), 0, 1)
        nearest_points = position[i] + shares[:, None] * line
        gaps = np.linalg.norm(nearest_points - position, axis=1)
        gaps[[i, j]] = np.inf
        linked[i, j] = linked[j, i] = gaps.min() >= RADIUS
    return linked


@pytest.mark.parametrize(
    "settings", [PAPER, CROWD, moving(128, 6.0, 5.0, speed=0.4), moving(40, 2.0, 2.0, radio_range=0.17)]
)
def test_links_are_those_of_the_definition(settings: WorldSettings) -> None:
    """Before and after several searches for candidates, which come every 13 ticks."""
    arena, link_count = Arena(settings, 11), 0
    for ticks in (*itertools.repeat(1, 14), *itertools.repeat(37, 10)):
        motion = arena.record(ticks)
        expected = links_by_definition(motion.position[-1], settings)
        assert np.array_equal(motion.adjacency[-1], expected)
        link_count += int(expected.sum())
    assert link_count > 0


def test_bodies_cut_links_in_a_crowd() -> None:
    motion = Arena(CROWD, 11).record(200)
    in_range = distances(motion.position[-1]) < CROWD.radio_range
    assert 0 < motion.adjacency[-1].sum() < 0.8 * in_range.sum()


def candidates_by_definition(arena: Arena) -> list[list[int]]:
    """Return all pairs that could be linked, or see or touch each other, within 12 ticks, in order."""
    settings = arena.settings
    distance = max(settings.radio_range, 2 * RADIUS + max(0.12, 2 * settings.speed * TICK))
    is_candidate = distances(arena.positions) < distance + 12 * 2 * settings.speed * TICK
    pairs: list[list[int]] = np.argwhere(np.triu(is_candidate)).tolist()
    return pairs


def random_large_arena(density: float, seed: int) -> Arena:
    """Return an arena of so many robots that candidates are searched in a grid."""
    rng = np.random.default_rng([round(100 * density), seed])
    robots, aspect = int(rng.integers(129, 400)), rng.uniform(0.05, 1)
    side = 0.7 * math.sqrt(robots * math.pi / density / aspect)
    speed, radio_range = rng.choice([0.1414, 0.6]), rng.choice([0.3, 0.7])
    return Arena(moving(robots, side, aspect * side, speed=speed, radio_range=radio_range), 1)


@pytest.mark.parametrize("seed", [0, 1])
@pytest.mark.parametrize("density", [0.02, 0.3, 1.0, 4.0, 10.0])
def test_the_grid_of_many_robots_finds_the_pairs_of_all_compared(density: float, seed: int) -> None:
    arena = random_large_arena(density, seed)
    for _ in range(2):
        candidates = arena._arena.candidates[0 : arena._arena.candidate_count]
        assert [[pair.a, pair.b] for pair in candidates] == candidates_by_definition(arena), arena.settings
        arena.step(13)  # to the next search


@pytest.mark.parametrize("density", [0.3, 4.0])
def test_links_of_many_robots_are_those_of_the_definition(density: float) -> None:
    arena = random_large_arena(density, seed=0)
    motion = arena.record(27)
    assert np.array_equal(motion.adjacency[-1], links_by_definition(motion.position[-1], arena.settings))


@pytest.mark.parametrize(("size", "allocated"), [(1, 8), (8, 8), (9, 16)])
def test_memory_is_allocated_in_doubles(size: int, allocated: int) -> None:
    assert allocate_memory(size).nbytes == allocated


def bytes_per_robot(robots: int) -> float:
    members, _ = make_config(moving(robots), 0, _arena.ffi)
    config = _arena.ffi.new("mcp_asdf_arena_config_t *", members)
    return float(_arena.lib.mcp_asdf_arena_bytes(config)) / robots


def test_memory_grows_linearly_with_the_robots() -> None:
    assert 1000 < bytes_per_robot(10_000) < 2000
    assert bytes_per_robot(1000) == pytest.approx(bytes_per_robot(10_000), rel=0.01)


# ---------------------------------------------------------------- wheels


class Wheels:
    """The rules of turning as their source states them: a state, three transitions in turn, two speeds."""

    def __init__(self) -> None:
        self.state = "none"

    def steer(self, ahead: float, left: float, speed: float) -> tuple[float, float]:
        """Return speed and spin for an obstacle vector, after the transitions of the state."""
        is_weak = abs(math.degrees(math.atan2(left, ahead))) <= 5 and math.hypot(ahead, left) < 0.1
        heading = 0.0 if is_weak else math.degrees(math.atan2(-left, -ahead))
        angle = abs(heading)
        if self.state == "hard" and angle <= 70:
            self.state = "soft"
        if self.state in ("none", "soft"):
            self.state = self._state_without_hysteresis(angle)
        factors = {"none": (1.0, 1.0), "soft": (1 - angle / 90, 1.0), "hard": (-1.0, 1.0)}
        inner, outer = factors[self.state]
        side = 1 if heading > 0 else -1
        return speed * (inner + outer) / 2, side * speed * (outer - inner) / WHEELS_APART

    @staticmethod
    def _state_without_hysteresis(angle: float) -> str:
        if angle > 90:
            return "hard"
        return "soft" if angle > 10 else "none"


def test_wheels_follow_the_rules_with_their_two_thresholds() -> None:
    arena, rules, rng = Arena(moving(1, 5, 5), 0), Wheels(), np.random.default_rng(6)
    bearings = np.radians(np.cumsum(rng.normal(0, 25, 20000)) + rng.choice([0, 180], 20000))
    lengths = rng.choice([0.05, 0.0999, 0.1001, 1.7], 20000)
    pairs_of_states = set()
    for bearing, length in zip(bearings, lengths, strict=True):
        ahead, left = float(length * np.cos(bearing)), float(length * np.sin(bearing))
        _arena.lib.mcp_asdf_arena_steer(arena._arena, 0, ahead, left)
        speed, spin = arena._arena.target_speed[0], arena._arena.target_spin[0]
        assert (speed, spin) == pytest.approx(rules.steer(ahead, left, 0.1414), abs=1e-12), (ahead, left)
        pairs_of_states.add((rules.state, arena._arena.wheels[0]))
    assert pairs_of_states == {("none", 0), ("soft", 1), ("hard", 2)}


# ---------------------------------------------------------------- floor


def colours(arena: Arena, points: NDArray[np.float64]) -> NDArray[np.bool_]:
    return np.array([arena.is_black(x, y) for x, y in points])


def tile_middles(settings: WorldSettings, side: float) -> NDArray[np.float64]:
    """Return the middles of all tiles, shape (columns, rows, 2)."""
    middles = [np.arange(side / 2, length, side) - length / 2 for length in settings.sides]
    return np.stack(np.meshgrid(*middles, indexing="ij"), axis=2)


def tile_colours(fill_ratio: float) -> NDArray[np.bool_]:
    """Return whether the tiles of a floor of 2 x 1.5 m are black, shape (columns, rows)."""
    settings = moving(1, 2, 1.5, fill_ratio=fill_ratio)
    middles = tile_middles(settings, 0.01)
    return colours(Arena(settings, 3), middles.reshape(-1, 2)).reshape(middles.shape[:2])


@pytest.mark.parametrize("fill_ratio", [0.0, 0.05, 0.55, 0.95, 1.0])
def test_a_share_of_the_tiles_as_large_as_the_fill_ratio_is_black(fill_ratio: float) -> None:
    black = tile_colours(fill_ratio)
    deviation = math.sqrt(fill_ratio * (1 - fill_ratio) / black.size)
    assert abs(black.mean() - fill_ratio) <= 4 * deviation


@pytest.mark.parametrize("fill_ratio", [0.05, 0.55, 0.95])
def test_neighbouring_tiles_are_independent(fill_ratio: float) -> None:
    black = tile_colours(fill_ratio)
    deviation = math.sqrt(fill_ratio * (1 - fill_ratio) / black.size)
    for both_black in (black[1:] & black[:-1], black[:, 1:] & black[:, :-1], black[1:, 1:] & black[:-1, :-1]):
        assert abs(both_black.mean() - fill_ratio**2) <= 5 * deviation


MIXED_FLOOR = moving(1, 2, 1.5, fill_ratio=0.5)
SOME_MIDDLES = tile_middles(MIXED_FLOOR, 0.01).reshape(-1, 2)[::7]


def test_a_tile_has_one_colour() -> None:
    arena = Arena(MIXED_FLOOR, 3)
    points = SOME_MIDDLES + np.random.default_rng(1).uniform(-0.0049, 0.0049, SOME_MIDDLES.shape)
    assert np.array_equal(colours(arena, SOME_MIDDLES), colours(arena, points))


def test_the_seed_decides_the_colours() -> None:
    first, second = (colours(Arena(MIXED_FLOOR, trial), SOME_MIDDLES) for trial in (3, 4))
    assert (first == second).mean() == pytest.approx(0.5, abs=0.05)


CODE = make_floor_code(0.448)
CODE_FLOOR = moving(1, 3, 2, floor="code", fill_ratio=0.448)


def test_a_picture_of_the_floor_has_its_first_row_in_the_north() -> None:
    assert np.array_equal(Arena(CODE_FLOOR).pixels(*CODE.shape[::-1]), CODE)


def test_a_code_lies_with_its_first_row_in_the_north() -> None:
    rows, columns = np.indices(CODE.shape)
    middles = np.stack([(columns + 0.5) / 100 * 3 - 1.5, 1 - (rows + 0.5) / 100 * 2], axis=2)
    assert np.array_equal(colours(Arena(CODE_FLOOR), middles.reshape(-1, 2)), CODE.ravel())


def test_the_edge_of_the_floor_has_the_colour_of_the_nearest_pixel() -> None:
    corners = np.array([(-1.5, 1), (1.5, -1), (1.5, 1), (-1.5, -1)])
    assert colours(Arena(CODE_FLOOR), corners).tolist() == CODE[[0, -1, 0, -1], [0, -1, -1, 0]].tolist()


@pytest.mark.parametrize("floor", [{"fill_ratio": 0.4, "tile": 0.02}, {"fill_ratio": 0.448, "floor": "code"}])
def test_the_ground_sensor_is_in_the_right_front_of_a_robot(floor: dict[str, Any]) -> None:
    arena = Arena(moving(20, 3, 2, **floor), 9)
    motion = arena.record(150)
    for position, ahead, black in zip(motion.position, motion.heading, motion.black, strict=True):
        right = np.stack([ahead[:, 1], -ahead[:, 0]], axis=1)
        assert black.tolist() == colours(arena, position + 0.0614 * ahead + 0.01 * right).tolist()


# ---------------------------------------------------------------- statistics

MEAN_DEGREE = 0.867
"""Of all trials together. About the mean of each trial alone the degree would look less persistent: a trial
is too short to tell its mean from slow changes."""


def contact(adjacency: NDArray[np.bool_]) -> float:
    """Mean length of the runs of ticks in which a pair is linked, of those that begin and end within."""
    lengths: list[int] = []
    for linked in adjacency[:, *np.triu_indices(adjacency.shape[1], 1)].T:
        change = np.diff(linked.astype(np.int8))
        starts, ends = np.flatnonzero(change == 1), np.flatnonzero(change == -1)
        starts, ends = starts[starts < max(ends, default=0)], ends[ends > min(starts, default=len(linked))]
        lengths += (ends - starts).tolist()
    return float(np.mean(lengths))


def motion_statistics(motion: Motion) -> dict[str, float]:
    """Every statistic by its name in the reference; in metres, radians and ticks, but the speed in m/s."""
    adjacency, position, heading = motion.adjacency, motion.position, motion.heading
    degree = adjacency.sum(axis=2, dtype=np.float64)
    deviation = degree - MEAN_DEGREE
    found = {
        "degree": degree,
        "rounds with 0 neighbours": degree == 0,
        "rounds with 1 neighbour": degree == 1,
        "rounds with 2 or more neighbours": degree >= 2,
        "speed": np.linalg.norm(np.diff(position, axis=0), axis=2) / TICK,
        "ticks straight": motion.wheels == 0,
        "ticks in a soft turn": motion.wheels == 1,
        "ticks in a hard turn": motion.wheels == 2,
        "ticks avoiding": motion.avoids,
        "contact": np.array(contact(adjacency)),
    }
    for lag in (1, 10, 50, 100, 500):
        together, before = adjacency[lag:] & adjacency[:-lag], adjacency[:-lag]
        found[f"pairs persisting after {lag}"] = together.sum() / before.sum()
        correlation = (deviation[lag:] * deviation[:-lag]).mean() / (deviation**2).mean()
        found[f"degree autocorrelation after {lag}"] = correlation
        moved = position[lag:] - position[:-lag]
        found[f"squared displacement after {lag}"] = (moved**2).sum(axis=2)
        found[f"cosine of turn after {lag}"] = (heading[lag:] * heading[:-lag]).sum(axis=2)
    return {name: float(np.mean(values)) for name, values in found.items()}


@pytest.mark.slow
def test_the_motion_has_the_statistics_of_the_reference() -> None:
    """Within 5 %, and what the sampling error of short trials and the reference's last digit add to it."""
    with ThreadPoolExecutor(2) as pool:
        trials = list(pool.map(lambda seed: motion_statistics(Arena(PAPER, seed).record(10000)), range(12)))
    wrong = []
    for name in trials[0]:
        expected = REFERENCE[name]
        values = np.array([trial[name] for trial in trials])
        error = values.std(ddof=1) / math.sqrt(len(values))
        digit = 0.5 * 10.0 ** -len(str(expected).partition(".")[2])
        if abs(values.mean() - expected) > 0.05 * abs(expected) + 3 * error + digit:
            wrong.append(f"{name}: {values.mean():.4f} +- {error:.4f}, not {expected}")
    assert not wrong, "; ".join(wrong)
