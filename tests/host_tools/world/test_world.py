"""The world: observations follow from the seed and the stated probabilities, and from nothing else."""

from __future__ import annotations

import math
from dataclasses import replace
from fractions import Fraction
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from mcp_asdf.robot import Observation
from mcp_asdf_tools.common.parameters import ParameterError
from mcp_asdf_tools.world.arena import Arena
from mcp_asdf_tools.world.philox import OBSERVATIONS, Stream
from mcp_asdf_tools.world.settings import WorldSettings
from mcp_asdf_tools.world.world import Scene, World

SEED = 20241029
KINDS: dict[str, dict[str, Any]] = {
    "fully connected": {},
    "graph": {"topology": "graph", "graph": "0 1; 1 > 2"},
    "dynamic": {"topology": "dynamic"},
    "wiener": {"drift": "wiener", "drift_diffusion": 0.01},
    "moving wiener": {"topology": "dynamic", "drift": "wiener", "drift_diffusion": 0.01},
    "stepped": {"drift": "stepped", "drift_rate": -1e-3, "drift_period": 7},
    "now and then": {"observation_period": 3, "white_offset": -0.2},
}


def make(**given: Any) -> World:
    return World(WorldSettings(**{"robots": 4, "steps": 200, "seed": SEED} | given))


def seen(scene: Scene) -> list[list[Observation | None]]:
    colours = (Observation.WHITE, Observation.BLACK)
    return [
        [colours[black] if observes else None for black in row]
        for row, observes in zip(scene.black.tolist(), scene.observes.tolist(), strict=True)
    ]


@pytest.mark.parametrize(("white_offset", "white"), [(0.0, Fraction(7, 10)), (-0.125, Fraction(23, 40))])
def test_observations_follow_the_stated_scheme(white_offset: float, white: Fraction) -> None:
    """Draw by draw against the exact probability of eq. 1."""
    world = make(fill_ratio=0.4, true_accuracy=0.7, white_offset=white_offset)
    chance = Fraction(2, 5) * Fraction(7, 10) + Fraction(3, 5) * (1 - white)
    draws = Stream(OBSERVATIONS, SEED, 0, 4).words(200) >> 1
    exact = [[Fraction(draw, 2**31) < chance for draw in row] for row in draws.tolist()]
    assert world.advance(200).black.tolist() == exact


def test_robots_that_move_see_the_floor_through_their_sensors() -> None:
    """Against an arena of the same seed: black is seen with b, white taken for black with 1 - w."""
    world = make(topology="dynamic", fill_ratio=0.4, true_accuracy=0.75, white_offset=0.125)
    below = Arena(world.settings, 0).record(200).black.tolist()
    draws = (Stream(OBSERVATIONS, SEED, 0, 4).words(200) >> 1).tolist()
    for black, drawn, reported in zip(below, draws, world.advance(200).black.tolist(), strict=True):
        chances = [Fraction(3, 4) if each else Fraction(1, 8) for each in black]
        assert reported == [Fraction(d, 2**31) < p for d, p in zip(drawn, chances, strict=True)]


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("blocks", [[1] * 200, [7, 1, 130, 62]])
def test_how_many_steps_are_taken_at_once_changes_nothing(kind: str, blocks: list[int]) -> None:
    whole, pieces = make(**KINDS[kind]).advance(200), make(**KINDS[kind])
    scenes = [pieces.advance(steps) for steps in blocks]
    for name in ("black", "observes", "hears"):
        joined = np.concatenate([getattr(scene, name) for scene in scenes])
        assert np.array_equal(joined, getattr(whole, name)), name


@pytest.mark.parametrize("kind", KINDS)
def test_steps_one_by_one_are_those_taken_at_once(kind: str) -> None:
    whole, world = make(**KINDS[kind]).advance(200), make(**KINDS[kind])
    for step, expected in enumerate(seen(whole)):
        assert list(world.step()) == expected
        assert [list(world.neighbours(i)) for i in range(4)] == [
            np.flatnonzero(row).tolist() for row in whole.hears[step]
        ]
        assert (world.positions is None) == (whole.positions is None)
        if whole.positions is not None and world.positions is not None:
            assert np.array_equal(world.positions, whole.positions[step])


def test_a_robot_sees_the_same_in_a_larger_swarm() -> None:
    small, large = make(robots=3).advance(200).black, make(robots=30).advance(200).black
    assert np.array_equal(small, large[:, :3])


def test_trials_seeds_and_robots_differ() -> None:
    settings = make().settings
    worlds = [World(settings, 0), World(settings, 1), World(replace(settings, seed=SEED + 1), 0)]
    columns = np.concatenate([world.advance(200).black for world in worlds], axis=1).T
    assert len({column.tobytes() for column in columns}) == 12


@pytest.mark.parametrize(
    ("fill_ratio", "accuracy"), [(0.55, 0.95), (0.95, 0.55), (0.95, 0.95), (0.2, 0.3), (0.5, 0.5)]
)
def test_the_share_of_black_is_as_in_the_paper(fill_ratio: float, accuracy: float) -> None:
    """p(z = 1) = f b + (1 - f)(1 - b), within five standard deviations; the seed is fixed."""
    steps = 200_000
    p = fill_ratio * accuracy + (1 - fill_ratio) * (1 - accuracy)
    share = make(robots=1, fill_ratio=fill_ratio, true_accuracy=accuracy).advance(steps).black.mean()
    assert abs(share - p) < 5 * math.sqrt(p * (1 - p) / steps)


@pytest.mark.parametrize(("fill_ratio", "accuracy", "black"), [(1, 1, 1), (1, 0, 0), (0, 1, 0), (0, 0, 1)])
def test_certainties(fill_ratio: float, accuracy: float, black: int) -> None:
    assert (make(fill_ratio=fill_ratio, true_accuracy=accuracy).advance(50).black == black).all()


def test_who_hears_whom_in_a_graph(tmp_path: Path) -> None:
    (tmp_path / "g").write_text("# edges\n0 1\n3 > 2\n")
    world = make(topology="graph", graph=tmp_path / "g")
    world.step()
    assert [list(world.neighbours(robot)) for robot in range(4)] == [[1], [0], [3], []]
    assert make(topology="graph", graph=str(world.settings.graph)).settings == world.settings


@pytest.mark.parametrize(
    ("given", "key", "message"),
    [
        ({"fill_ratio": 1.1}, "fill_ratio", "fill_ratio is 1.1; it must be 0 to 1"),
        ({"fill_ratio": math.nan}, "fill_ratio", "fill_ratio is nan; give a number"),
        ({"fill_ratio": "0.5"}, "fill_ratio", "fill_ratio is '0.5'; give a number"),
        ({"robots": 2.5}, "robots", "robots is 2.5; give a whole number"),
        ({"robots": True}, "robots", "robots is True; give a number"),
        ({"seed": -1}, "seed", "seed is -1; it must be 0 to"),
        ({"topology": "star"}, "topology", "choose one of fully-connected, dynamic, graph"),
        ({"topology": "graph"}, "graph", "graph is '': give its edges"),
        ({"graph": "0 1"}, "graph", "graph is '0 1': choose topology graph"),
        ({"topology": "graph", "graph": "0 9"}, "graph", "graph names robot 9, but the ids of 4 robots"),
        ({"topology": "graph", "graph": "0 0"}, "graph", "graph, edge 1: robot 0 cannot be its own"),
        ({"topology": "graph", "graph": 5}, "graph", "graph is 5; give a file or edges"),
        ({"density": 2}, "density", "density is 2.0 but robots do not move; choose topology dynamic"),
        ({"sensor": "absent"}, "sensor", "sensor is 'absent'; choose one of an extension: none is installed"),
        ({"drift": "sideways"}, "drift", "choose one of none, linear, stepped, wiener"),
        ({"drift_rate": 0.1}, "drift_rate", "drift_rate is 0.1 but drift is none; choose a drift"),
    ],
)
def test_what_cannot_be_is_refused(given: dict[str, Any], key: str, message: str) -> None:
    with pytest.raises(ParameterError) as caught:
        make(**given)
    assert caught.value.key == key
    assert message in str(caught.value)
