"""The moving world against independent oracles: geometry, rules of motion, floor, and statistics."""

from __future__ import annotations

import hashlib
import itertools
import json
import math
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from benchmarks import arena as comparison
from benchmarks.motion_statistics import bursts as motion_bursts
from benchmarks.motion_statistics import motion_statistics, runs
from mcp_asdf_tools.common.errors import UsageError
from mcp_asdf_tools.world import _arena
from mcp_asdf_tools.world.arena import Arena, ArenaSettings, Picture, Tiles, square_side

RADIUS, REACH, WHEELS_APART, TICK = 0.0704, 0.12, 0.1054, 0.1
DATA = Path(__file__).parents[2] / "data/motion_statistics.json"
REFERENCE = json.loads(DATA.read_text(encoding="utf-8"))["statistics"]
SIDE = square_side(20, 1)
PAPER = ArenaSettings(20, SIDE, SIDE)
CROWD = ArenaSettings(60, 1.7, 1.6, radio_range=0.5)
"""A third of the floor is robots: contacts everywhere."""


def distances(position: NDArray[np.float64]) -> NDArray[np.float64]:
    """Of all pairs, shape (N, N); infinite between a robot and itself."""
    apart: NDArray[np.float64] = np.linalg.norm(position[:, None] - position[None], axis=2)
    np.fill_diagonal(apart, np.inf)
    return apart


# ---------------------------------------------------------------- settings


def test_the_papers_arena_has_the_side_of_its_batch_scripts() -> None:
    assert square_side(20, 1) == pytest.approx(5.5486, abs=1e-4)
    assert 8 * math.pi * 0.7**2 / square_side(8, 1.3) ** 2 == pytest.approx(1.3)


@pytest.mark.parametrize(
    ("change", "named"),
    [
        ({"robots": 0}, "robots is 0"),
        ({"robots": 129}, "robots is 129"),
        ({"robots": -1}, "robots is -1"),
        ({"width": 0.14}, "0.14 x"),
        ({"height": math.nan}, "height is nan"),
        ({"width": 1001.0}, "1001"),
        ({"speed": 0.0}, "speed is 0.0"),
        ({"speed": 0.82}, "speed is 0.82"),
        ({"radio_range": -0.7}, "radio_range is -0.7"),
        ({"steps_per_second": 0}, "steps_per_second is 0"),
        ({"steps_per_second": -10}, "steps_per_second is -10"),
        ({"speed": 0.8, "steps_per_second": 9}, "steps_per_second is 9"),
        ({"radio_range": math.inf}, "radio_range is inf"),
        ({"floor": Tiles(1.1)}, "fill ratio is 1.1"),
        ({"floor": Tiles(0.5, 0.0)}, "tile is 0.0"),
        ({"floor": Tiles(0.5, 1e-6)}, "tile is 1e-06"),
        ({"floor": Tiles(0.5, math.inf)}, "tile is inf"),
        ({"robots": 128, "width": 1.0, "height": 1.0}, "no room"),
    ],
)
def test_a_bad_setting_is_named_with_its_value(change: dict[str, object], named: str) -> None:
    with pytest.raises(UsageError, match=named):
        Arena(replace(PAPER, **change), 0)  # type: ignore[arg-type]


def test_other_bad_input_is_named() -> None:
    for seed in (-1, 2**64):
        with pytest.raises(UsageError, match=f"seed is {seed}"):
            Arena(PAPER, seed)
    with pytest.raises(UsageError, match="ticks is -1"):
        Arena(PAPER, 0).step(-1)
    with pytest.raises(UsageError, match="outside the arena"):
        Arena(PAPER, 0).is_black(3, 0)
    with pytest.raises(UsageError, match="fill_ratio is nan"):
        Tiles(math.nan)
    with pytest.raises(UsageError, match=r"shape \(0, 3\)"):
        Picture(np.zeros((0, 3), np.bool_))
    with pytest.raises(UsageError, match="density 0"):
        square_side(20, 0)


# ---------------------------------------------------------------- determinism


@pytest.mark.parametrize(("settings", "expected"), [(PAPER, "007cd8ff6a26c874"), (CROWD, "e11f1b1eaaa963fd")])
def test_a_seed_gives_the_same_bits_everywhere(settings: ArenaSettings, expected: str) -> None:
    """The digest stands for every machine: the arena uses only operations that IEEE 754 rounds correctly."""
    motion = Arena(settings, 1).record(3000)
    digest = hashlib.sha256()
    for values in (motion.position, motion.heading, motion.linked, motion.black):
        digest.update(values.astype(values.dtype.newbyteorder("<")).tobytes())
    assert digest.hexdigest()[:16] == expected


def test_seeds_differ_and_time_may_pass_in_any_portions() -> None:
    whole, parts = Arena(CROWD, 7), Arena(CROWD, 7)
    assert not np.array_equal(whole.positions, Arena(CROWD, 8).positions)
    whole.step(500)
    for portion in (0, 1, 2, 97, 400):
        parts.step(portion)
    assert whole.ticks == parts.ticks == 500
    assert np.array_equal(whole.positions, parts.positions)
    assert np.array_equal(whole.headings, parts.headings)
    assert np.array_equal(whole.links, parts.links)


def test_a_record_ends_with_what_the_arena_shows() -> None:
    arena = Arena(PAPER, 2)
    motion = arena.record(300)
    assert np.array_equal(motion.position[-1], arena.positions)
    assert np.array_equal(motion.heading[-1], arena.headings)
    assert np.array_equal(motion.black[-1], arena.black)
    for robot in range(20):
        assert set(np.flatnonzero(motion.adjacency[-1, robot])) == arena.neighbours(robot)


def test_places_and_headings_at_the_start_are_uniform() -> None:
    starts = [Arena(PAPER, seed) for seed in range(300)]
    x, y = np.concatenate([arena.positions for arena in starts]).T / (SIDE - 2 * RADIUS)
    cx, cy = np.concatenate([arena.headings for arena in starts]).T
    limit = 4 / math.sqrt(len(x))
    for centred, deviation in ((x, 12**-0.5), (y, 12**-0.5), (cx, 0.5**0.5), (cy, 0.5**0.5)):
        assert abs(centred.mean()) < limit * deviation
        assert centred.std() == pytest.approx(deviation, rel=limit)
    assert abs((cx * cy).mean()) < limit


# ---------------------------------------------------------------- bodies


@pytest.mark.parametrize(("settings", "seed"), [(PAPER, 3), (CROWD, 4), (replace(CROWD, speed=0.8), 5)])
def test_bodies_are_rigid_stay_inside_and_keep_the_speed_limit(settings: ArenaSettings, seed: int) -> None:
    motion = Arena(settings, seed).record(3000)
    room = np.array([settings.width, settings.height]) / 2 - RADIUS
    assert np.all(np.abs(motion.position) <= room + 1e-6)
    assert min(distances(position).min() for position in motion.position[::3]) >= 2 * RADIUS - 5e-4
    steps = np.linalg.norm(np.diff(motion.position, axis=0), axis=2)
    assert steps.max() <= settings.speed * TICK * (1 + 1e-9)
    assert np.abs(np.linalg.norm(motion.heading, axis=2) - 1).max() < 1e-9


def test_a_crowd_does_touch_and_does_not_freeze() -> None:
    """Otherwise the test above says nothing."""
    motion = Arena(CROWD, 4).record(3000)
    assert sum(distances(position).min() < 2 * RADIUS + 1e-3 for position in motion.position[::3]) > 20
    moved = np.linalg.norm(motion.position[-1] - motion.position[-600], axis=1)
    assert np.median(moved) > 0.1


def test_a_lone_robot_drives_straight_at_full_speed_until_a_wall_is_in_reach() -> None:
    motion = Arena(ArenaSettings(1, 5, 5), 1).record(2000)
    position = motion.position[:, 0]
    free = np.abs(position).max(axis=1) < 2.5 - RADIUS - REACH - 0.015
    steps, turned = np.diff(position, axis=0), np.diff(motion.heading[:, 0], axis=0)
    long_free = np.convolve(free, np.ones(6), "valid")[:-1] == 6
    cruising = steps[5:][long_free[: len(steps) - 5]]
    assert len(cruising) > 1000
    assert np.linalg.norm(cruising, axis=1) == pytest.approx(0.01414)
    assert np.abs(turned[5:][long_free[: len(steps) - 5]]).max() == 0
    assert np.abs(position).max() > 2.2


def test_a_hard_turn_is_in_place_at_the_wheels_full_speed() -> None:
    motion = Arena(ArenaSettings(1, 2, 2), 1).record(3000)
    hard = motion.wheels[:, 0] == 2
    steady = np.flatnonzero(hard[:-1] & hard[1:] & np.roll(hard, 1)[:-1]) + 1
    angle = np.unwrap(np.arctan2(motion.heading[:, 0, 1], motion.heading[:, 0, 0]))
    turned = np.abs(angle[steady] - angle[steady - 1])
    assert len(turned) > 50
    assert turned == pytest.approx(2 * 0.1414 / WHEELS_APART * TICK)
    assert np.linalg.norm(motion.position[steady + 1] - motion.position[steady], axis=2).max() < 1e-12


def lean(spin: float) -> tuple[complex, complex]:
    """Velocities after a tick of a robot that only spins, and of one that drives against it, to the west."""
    arena = Arena(ArenaSettings(2, 5, 5), 0)
    state = arena._arena
    for robot, (x, cx, speed, turn) in enumerate([(-RADIUS, 1.0, 0.0, spin), (RADIUS, -1.0, 0.1414, 0.0)]):
        state.x[robot], state.y[robot], state.cx[robot], state.cy[robot] = x, 0.0, cx, 0.0
        state.wanted_speed[robot], state.wanted_spin[robot], state.may_touch[robot] = speed, turn, 1
    state.close_count, state.close[0].a, state.close[0].b = 1, 0, 1
    arena.step()
    return complex(state.vx[0], state.vy[0]), complex(state.vx[1], state.vy[1])


@pytest.mark.parametrize("spin", [2.0, -2.0])
def test_a_spinning_body_drags_the_one_that_leans_on_it_and_is_pushed_back(spin: float) -> None:
    still, leaning = lean(spin)
    assert math.copysign(1, spin) * leaning.imag > 0.002
    assert math.copysign(1, spin) * still.imag < -0.002
    assert abs(lean(0.0)[1].imag) < 1e-12


# ---------------------------------------------------------------- who hears whom


def links_by_definition(position: NDArray[np.float64], settings: ArenaSettings) -> NDArray[np.bool_]:
    """Every pair against every third body, by the distance of its centre from the line between the two."""
    linked = distances(position) < settings.radio_range
    for i, j in [] if settings.see_past else np.argwhere(np.triu(linked)):
        span = position[j] - position[i]
        shares = np.clip((position - position[i]) @ span / (span @ span), 0, 1)
        gaps = np.linalg.norm(position[i] + shares[:, None] * span - position, axis=1)
        gaps[[i, j]] = np.inf
        linked[i, j] = linked[j, i] = gaps.min() >= RADIUS
    return linked


@pytest.mark.parametrize(
    "settings",
    [
        PAPER,
        replace(PAPER, see_past=True),
        CROWD,
        ArenaSettings(128, 6.0, 5.0, speed=0.4),
        ArenaSettings(40, 2.0, 2.0, radio_range=0.17),
    ],
)
def test_links_are_those_of_the_definition(settings: ArenaSettings) -> None:
    arena = Arena(settings, 11)
    count = 0
    for portion in (0, *itertools.repeat(1, 14), *itertools.repeat(37, 10)):
        arena.step(portion)
        expected = links_by_definition(arena.positions, settings)
        found = np.zeros_like(expected)
        first, second = arena.links.T
        found[first, second] = found[second, first] = True
        assert np.array_equal(found, expected), f"seed 11, tick {arena.ticks}"
        count += len(first)
    assert count > 0


def test_a_body_between_does_cut_links() -> None:
    through = Arena(replace(CROWD, see_past=True), 4)
    assert 0 < len(Arena(CROWD, 4).links) < 0.8 * len(through.links)


# ---------------------------------------------------------------- proximity and wheels


def reading_by_definition(distance: float) -> float:
    if distance < 0.04:
        return 1.0
    return 0.0 if distance > REACH else min(max(4.14 * math.exp(-33 * distance) - 0.085, 0.0), 1.0)


def obstacle_by_marching(arena: Arena, robot: int) -> complex:
    """Walk along each ray in small strides until inside a body or a wall."""
    half = np.array([arena.settings.width, arena.settings.height]) / 2
    centre, others = arena.positions[robot], np.delete(arena.positions, robot, axis=0)
    others = others[np.linalg.norm(others - centre, axis=1) < 2 * RADIUS + REACH + 0.01]
    heading = complex(*arena.headings[robot])
    strides = np.linspace(0, REACH, 1201)
    total = 0j
    for k in range(8):
        own = complex(math.cos(k * math.pi / 4), math.sin(k * math.pi / 4))
        ray = heading * own
        points = centre + (RADIUS + strides)[:, None] * np.array([ray.real, ray.imag])
        hit = np.any(np.abs(points) > half, axis=1)
        hit |= np.any(np.linalg.norm(points[:, None] - others, axis=2) < RADIUS, axis=1)
        if hit.any():
            total += reading_by_definition(strides[hit.argmax()]) * own
    return total


def test_the_reading_is_that_of_the_sensors_data() -> None:
    read = _arena.lib.mcp_asdf_arena_reading
    for distance in [0, 0.0399999, 0.12, 0.1200001, 5, *np.linspace(0.03, 0.13, 2001)]:
        assert read(float(distance)) == pytest.approx(reading_by_definition(float(distance)), abs=1e-11)


@pytest.mark.parametrize("settings", [CROWD, ArenaSettings(2, 0.5, 0.5), ArenaSettings(3, 0.3, 2.0)])
def test_obstacle_vectors_agree_with_marching_along_the_rays(settings: ArenaSettings) -> None:
    arena = Arena(settings, 5)
    ahead, left, sees = (_arena.ffi.new(kind) for kind in ("double *", "double *", "uint8_t *"))
    strong = 0
    for _ in range(60):
        arena.step(5)
        for robot in range(min(settings.robots, 3)):
            _arena.lib.mcp_asdf_arena_obstacle(arena._arena, robot, ahead, left, sees)
            assert abs(complex(ahead[0], left[0]) - obstacle_by_marching(arena, robot)) < 0.03, (
                f"seed 5, tick {arena.ticks}, robot {robot}"
            )
            strong += abs(complex(ahead[0], left[0])) > 0.1
    assert strong > 10


class Wheels:
    """The rules of turning as their source states them: a state, three transitions in turn, two speeds."""

    def __init__(self) -> None:
        self.state = "none"

    def steer(self, ahead: float, left: float, speed: float) -> tuple[float, float]:
        """Speed and spin."""
        weak = abs(math.degrees(math.atan2(left, ahead))) <= 5 and math.hypot(ahead, left) < 0.1
        heading = 0.0 if weak else math.degrees(math.atan2(-left, -ahead))
        angle = abs(heading)
        if self.state == "hard" and angle <= 70:
            self.state = "soft"
        if self.state == "soft":
            self.state = "hard" if angle > 90 else "none" if angle <= 10 else "soft"
        if self.state == "none":
            self.state = "hard" if angle > 90 else "soft" if angle > 10 else "none"
        inner, outer = {"none": (1.0, 1.0), "soft": (1 - angle / 90, 1.0), "hard": (-1.0, 1.0)}[self.state]
        to_the_left = 1 if heading > 0 else -1
        return speed * (inner + outer) / 2, to_the_left * speed * (outer - inner) / WHEELS_APART


def test_wheels_follow_the_rules_with_their_two_thresholds() -> None:
    arena, rules, rng = Arena(ArenaSettings(1, 5, 5), 0), Wheels(), np.random.default_rng(6)
    bearings = np.cumsum(rng.normal(0, 25, 20000)) + rng.choice([0, 180], 20000)
    states = set()
    lengths = rng.choice([0.05, 0.0999, 0.1001, 1.7], 20000)
    for bearing, length in zip(np.radians(bearings), lengths, strict=True):
        ahead, left = float(length * np.cos(bearing)), float(length * np.sin(bearing))
        _arena.lib.mcp_asdf_arena_steer(arena._arena, 0, ahead, left)
        found = arena._arena.wanted_speed[0], arena._arena.wanted_spin[0]
        expected = rules.steer(ahead, left, 0.1414)
        assert found == pytest.approx(expected, abs=1e-12), f"{ahead}, {left}, {rules.state}"
        states.add((rules.state, arena._arena.wheels[0]))
    assert states == {("none", 0), ("soft", 1), ("hard", 2)}


@pytest.mark.parametrize(("ahead", "left", "turn"), [(0, 0.5, -1), (0, -0.5, 1), (0.5, 0, -1)])
def test_an_obstacle_at_the_side_or_ahead_calls_for_a_hard_turn(ahead: float, left: float, turn: int) -> None:
    """Away from it; to the right if it is ahead."""
    arena = Arena(ArenaSettings(1, 5, 5), 0)
    for _ in range(2):
        _arena.lib.mcp_asdf_arena_steer(arena._arena, 0, 0.0, 0.0)
        assert arena._arena.wheels[0] == 0
        _arena.lib.mcp_asdf_arena_steer(arena._arena, 0, ahead, left)
        assert arena._arena.wheels[0] == 2
        assert arena._arena.wanted_spin[0] == pytest.approx(turn * 2 * 0.1414 / WHEELS_APART)


# ---------------------------------------------------------------- floor


def colours(arena: Arena, points: NDArray[np.float64]) -> NDArray[np.bool_]:
    return np.array([arena.is_black(x, y) for x, y in points])


def tile_middles(settings: ArenaSettings, side: float) -> NDArray[np.float64]:
    middles = [np.arange(side / 2, length, side) - length / 2 for length in (settings.width, settings.height)]
    return np.stack(np.meshgrid(*middles, indexing="ij"), axis=2)


@pytest.mark.parametrize("fill_ratio", [0.0, 0.05, 0.55, 0.95, 1.0])
def test_tiles_are_black_by_chance_and_independent(fill_ratio: float) -> None:
    settings = ArenaSettings(1, 2, 1.5, Tiles(fill_ratio))
    grid = tile_middles(settings, 0.01)
    black = colours(Arena(settings, 3), grid.reshape(-1, 2)).reshape(grid.shape[:2])
    variance = fill_ratio * (1 - fill_ratio)
    assert abs(black.mean() - fill_ratio) <= 4 * math.sqrt(variance / black.size)
    for near in (black[1:] & black[:-1], black[:, 1:] & black[:, :-1], black[1:, 1:] & black[:-1, :-1]):
        assert abs(near.mean() - fill_ratio**2) <= 5 * math.sqrt(variance / near.size)


def test_a_tile_has_one_colour_and_the_seed_decides_it() -> None:
    settings = ArenaSettings(1, 2, 1.5, Tiles(0.5))
    middles = tile_middles(settings, 0.01).reshape(-1, 2)[::7]
    first = colours(Arena(settings, 3), middles)
    moved = middles + np.random.default_rng(1).uniform(-0.0049, 0.0049, middles.shape)
    assert np.array_equal(first, colours(Arena(settings, 3), moved))
    assert (first == colours(Arena(settings, 4), middles)).mean() == pytest.approx(0.5, abs=0.05)


def test_a_picture_lies_with_its_first_row_in_the_north() -> None:
    pixels = np.array([[True, False, False], [False, False, True]])
    arena = Arena(ArenaSettings(1, 3, 2, Picture(pixels)), 0)
    middles = [(x, y) for y in (0.5, -0.5) for x in (-1, 0, 1)]
    assert colours(arena, np.array(middles)).tolist() == pixels.ravel().tolist()
    corners = np.array([(-1.5, 1), (1.5, -1), (1.5, 1), (-1.5, -1)])
    assert colours(arena, corners).tolist() == [True, True, False, False]
    assert Picture(pixels).fill_ratio == pytest.approx(1 / 3)


PICTURE = Picture(np.random.default_rng(2).random((40, 50)) < 0.4)


@pytest.mark.parametrize("floor", [Tiles(0.4, 0.02), PICTURE])
def test_robots_look_at_the_floor_before_their_right_front(floor: Tiles | Picture) -> None:
    arena = Arena(ArenaSettings(20, 3, 2, floor), 9)
    for _ in range(50):
        arena.step(3)
        ahead = arena.headings
        right = np.stack([ahead[:, 1], -ahead[:, 0]], axis=1)
        expected = colours(arena, arena.positions + 0.0614 * ahead + 0.01 * right)
        assert arena.black.tolist() == expected.astype(int).tolist(), f"seed 9, tick {arena.ticks}"


# ---------------------------------------------------------------- statistics


def test_runs_are_those_that_begin_and_end_within() -> None:
    state = np.random.default_rng(3).random((60, 25)) < 0.6
    state[:, 0], state[:, 1] = True, False
    starts, lengths = runs(state)
    expected = []
    for column in range(25):
        tick = 0
        for value, group in itertools.groupby(state[:, column].tolist()):
            length = len(list(group))
            if value and tick > 0 and tick + length < 60:
                expected.append((column, tick - 1, length))
            tick += length
    assert [(c, t, n) for (c, t), n in zip(starts.tolist(), lengths.tolist(), strict=True)] == expected


def test_too_short_a_motion_has_no_statistics() -> None:
    with pytest.raises(ValueError, match="500 ticks are too few"):
        motion_statistics(Arena(PAPER, 0).record(500))


DIFFERENT = {"degree without blocking", "time between contacts", "largest coordinate"}
"""Not measured here, or measured otherwise: docs/arena.md."""


@pytest.mark.slow
def test_the_motion_has_the_statistics_of_the_reference() -> None:
    """Within 5 %, and what the sampling error of short trials and the reference's last digit add to it."""
    with ThreadPoolExecutor(2) as pool:
        trials = list(pool.map(lambda seed: motion_statistics(Arena(PAPER, seed).record(10000)), range(12)))
    wrong = []
    for name, expected in REFERENCE.items():
        if name in DIFFERENT:
            continue
        values = np.array([trial[name] for trial in trials])
        error = values.std(ddof=1) / math.sqrt(len(values))
        digit = 0.5 * 10.0 ** -len(str(expected).partition(".")[2])
        if abs(values.mean() - expected) > 0.05 * abs(expected) + 3 * error + digit:
            wrong.append(f"{name}: {values.mean():.4f} +- {error:.4f}, not {expected}")
    assert not wrong, "; ".join(wrong)


def test_bursts_join_avoidances_that_follow_at_once() -> None:
    """A run of False of nine ticks joins, of ten does not; what is cut off by an end counts for nothing."""
    avoids = np.zeros((60, 1), np.bool_)
    for start, end in ((0, 3), (10, 12), (21, 24), (34, 40), (55, 60)):
        avoids[start:end] = True
    found = motion_bursts(avoids)
    assert found == {"avoidance bursts in 1000 s": 1000 / 6, "ticks between bursts": (10 + 15) / 2}


def test_the_comparison_of_docs_can_be_made_again(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    page = tmp_path / "arena.md"
    page.write_text(f"before\n{comparison.START}\nold\n{comparison.END}\nafter\n", encoding="utf-8")
    monkeypatch.setattr(comparison, "SPEED_TICKS", 100)
    monkeypatch.setattr("sys.argv", ["arena", "--trials", "2", "--steps", "600", "--write", str(page)])
    assert comparison.main() in (0, 1)  # two short trials may differ from the reference
    assert "robot-ticks a second and core" in capsys.readouterr().out
    written = page.read_text(encoding="utf-8")
    assert "old" not in written
    assert all(f"| {name}" in written for name in REFERENCE)
