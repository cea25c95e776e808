"""The world: what robots see follows from the seed and the stated probabilities, and from nothing else."""

from __future__ import annotations

import math

import numpy as np
import pytest

from mcp_asdf_tools.world.swarm_world import FullyConnected, World

SEED = 20241029


def make(fill_ratio: float, accuracies: list[float], seed: int = SEED) -> World:
    return World(fill_ratio, accuracies, FullyConnected(len(accuracies)), seed)


def test_observations_follow_the_stated_scheme() -> None:
    """Recomputed tick by tick in plain Python from the documented streams."""
    fill_ratio, accuracies = 0.55, [0.95, 0.55, 0.8]
    seen = make(fill_ratio, accuracies).observe(40)
    for robot, accuracy in enumerate(accuracies):
        stream = np.random.Generator(np.random.PCG64(np.random.SeedSequence(SEED, spawn_key=(robot,))))
        for tick in range(40):
            is_black = stream.random() < fill_ratio
            is_right = stream.random() < accuracy
            assert seen[tick, robot] == (is_black if is_right else not is_black)


def test_the_first_observations_stay_what_they_are() -> None:
    """A published seed must mean the same run for ever; numpy must not change the streams unseen."""
    seen = make(0.5, [1.0] * 4, seed=1).observe(16)
    columns = ["".join(str(z) for z in column) for column in seen.T.tolist()]
    assert columns == ["0011110100000100", "1100100111011010", "1101001000111110", "1000010000111111"]


@pytest.mark.parametrize("blocks", [[1] * 60, [7, 13, 40], [59, 1]])
def test_how_many_ticks_are_drawn_at_once_changes_nothing(blocks: list[int]) -> None:
    world = make(0.3, [0.9, 0.6])
    pieces = [world.observe(ticks) for ticks in blocks]
    assert np.array_equal(np.concatenate(pieces), make(0.3, [0.9, 0.6]).observe(60))


def test_a_robot_sees_the_same_in_a_larger_swarm() -> None:
    small, large = make(0.4, [0.9] * 3).observe(200), make(0.4, [0.9] * 30).observe(200)
    assert np.array_equal(small, large[:, :3])


def test_seeds_and_robots_differ() -> None:
    seen, other = make(0.5, [0.9] * 5).observe(200), make(0.5, [0.9] * 5, SEED + 1).observe(200)
    columns = np.concatenate([seen, other], axis=1).T
    assert len({column.tobytes() for column in columns}) == 10


@pytest.mark.parametrize(
    ("fill_ratio", "accuracy"), [(0.55, 0.95), (0.95, 0.55), (0.95, 0.95), (0.2, 0.3), (0.5, 0.5)]
)
def test_the_share_of_black_is_as_in_the_paper(fill_ratio: float, accuracy: float) -> None:
    """p(z = 1) = f b + (1 - f)(1 - b), within five standard deviations; the seed is fixed."""
    ticks = 200_000
    p = fill_ratio * accuracy + (1 - fill_ratio) * (1 - accuracy)
    share = make(fill_ratio, [accuracy]).observe(ticks).mean()
    assert abs(share - p) < 5 * math.sqrt(p * (1 - p) / ticks)


def test_tile_and_sensor_are_independent_draws() -> None:
    """With one shared draw, black tiles below min(f, b) would always be read right."""
    world, ticks = make(0.5, [0.5]), 100_000
    assert abs(world.observe(ticks).mean() - 0.5) < 5 * 0.5 / math.sqrt(ticks)
    seen = make(0.9, [0.1]).observe(ticks).mean()
    assert abs(seen - 0.18) < 5 * math.sqrt(0.18 * 0.82 / ticks)


@pytest.mark.parametrize(("fill_ratio", "accuracy", "seen"), [(1, 1, 1), (1, 0, 0), (0, 1, 0), (0, 0, 1)])
def test_certainties(fill_ratio: float, accuracy: float, seen: int) -> None:
    assert (make(fill_ratio, [accuracy] * 3).observe(50) == seen).all()


def test_shape_and_type() -> None:
    world = make(0.5, [0.9] * 7)
    assert world.robots == 7
    assert world.observe().shape == (1, 7)
    assert world.observe(3).dtype == np.uint8


def test_fully_connected() -> None:
    topology = FullyConnected(4)
    assert [sorted(topology.neighbours(robot)) for robot in range(4)] == [
        [1, 2, 3],
        [0, 2, 3],
        [0, 1, 3],
        [0, 1, 2],
    ]


@pytest.mark.parametrize("value", [-0.1, 1.1, math.nan])
def test_impossible_probabilities_are_refused(value: float) -> None:
    with pytest.raises(ValueError, match=f"fill ratio is .*{value}"):
        make(value, [0.9])
    with pytest.raises(ValueError, match=f"true accuracy is .*{value}"):
        make(0.5, [0.9, value])


def test_a_negative_seed_is_refused() -> None:
    with pytest.raises(ValueError, match="non-negative"):
        make(0.5, [0.9], seed=-1)
