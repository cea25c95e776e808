"""The world: observations follow from the seed and the stated probabilities, and from nothing else."""

from __future__ import annotations

import hashlib
import math
from dataclasses import replace
from fractions import Fraction
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.special import ndtri  # type: ignore[import-untyped]

from mcp_asdf.robot import Observation
from mcp_asdf_tools.common.errors import UsageError
from mcp_asdf_tools.common.parameters import ParameterError
from mcp_asdf_tools.robots.population import Population
from mcp_asdf_tools.world import _arena
from mcp_asdf_tools.world.arena import Arena, config_values
from mcp_asdf_tools.world.floor_code import CODE_MODULES, code
from mcp_asdf_tools.world.philox import MOVES, OBSERVATIONS, Stream, philox, world_seed
from mcp_asdf_tools.world.sensors import CheckedSensors, sensor_model
from mcp_asdf_tools.world.settings import WorldSettings
from mcp_asdf_tools.world.topology import Checked
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


def test_draws_are_those_of_philox_4x32_10() -> None:
    """The known answers of its authors (Random123), and a seed's words as its key."""

    def drawn(counter: tuple[int, int, int, int], key: tuple[int, int]) -> list[int]:
        c0, c1, c2, c3 = (np.array([word], np.uint64) for word in counter)
        return [int(word[0]) for word in philox((c0, c1, c2, c3), key)]

    digits = (0x243F6A88, 0x85A308D3, 0x13198A2E, 0x03707344)
    low, high = 0xA4093822, 0x299F31D0
    assert drawn((0, 0, 0, 0), (0, 0)) == [0x6627E8D5, 0xE169C58D, 0xBC57AC4C, 0x9B00DBD8]
    assert drawn(digits, (low, high)) == [0xD16CFE09, 0x94FDCCEB, 0x5001E420, 0x24126EA1]
    assert Stream(1, high << 32 | low, 7, 3).words(4)[:, 2].tolist() == drawn((0, 2, 7, 1), (low, high))


@pytest.mark.parametrize(("white_offset", "white"), [(0.0, Fraction(7, 10)), (-0.125, Fraction(23, 40))])
def test_observations_follow_the_stated_scheme(white_offset: float, white: Fraction) -> None:
    """Draw by draw against the exact probability of eq. 1."""
    world = make(fill_ratio=0.4, true_accuracy=0.7, white_offset=white_offset)
    chance = Fraction(2, 5) * Fraction(7, 10) + Fraction(3, 5) * (1 - white)
    draws = Stream(OBSERVATIONS, SEED, 0, 4).words(200) >> 1
    exact = [[Fraction(draw, 2**31) < chance for draw in row] for row in draws.tolist()]
    scene = world.advance(200)
    assert scene.black.tolist() == exact
    assert scene.accuracy == pytest.approx(float(Fraction(7, 10) + white) / 2)


def test_robots_that_move_see_the_floor_through_their_sensors() -> None:
    """Against an arena of the same seed: black is seen with b, white taken for black with 1 - w."""
    world = make(topology="dynamic", fill_ratio=0.4, true_accuracy=0.75, white_offset=0.125)
    below = Arena(world.settings, 0).record(200).black.tolist()
    draws = (Stream(OBSERVATIONS, SEED, 0, 4).words(200) >> 1).tolist()
    for black, drawn, reported in zip(below, draws, world.advance(200).black.tolist(), strict=True):
        chances = [Fraction(3, 4) if each else Fraction(1, 8) for each in black]
        assert reported == [Fraction(d, 2**31) < p for d, p in zip(drawn, chances, strict=True)]


@pytest.mark.parametrize("kind", KINDS)
def test_how_many_steps_are_taken_at_once_changes_nothing(kind: str) -> None:
    """Also not if it is one by one, with what the world then shows."""
    whole, pieces, world = make(**KINDS[kind]).advance(200), make(**KINDS[kind]), make(**KINDS[kind])
    scenes, late = [pieces.advance(steps) for steps in (7, 1, 130, 62)], make(**KINDS[kind])
    late.skip(7)
    late.skip(130)
    assert np.array_equal(late.advance(63).black, whole.black[137:])
    for name in ("black", "observes", "hears", "accuracy"):
        joined = np.concatenate([getattr(scene, name) for scene in scenes])
        assert np.array_equal(joined, getattr(whole, name)), name
    period = world.settings.observation_period
    assert np.flatnonzero(whole.observes).tolist() == list(range(period - 1, 200, period))
    for step, expected in enumerate(seen(whole)):
        assert list(world.step()) == expected
        assert [list(world.neighbours(i)) for i in range(4)] == [
            np.flatnonzero(row).tolist() for row in whole.hears[step]
        ]
        assert np.array_equal(world.accuracy, whole.accuracy[step])
        assert (world.positions is None) == (whole.positions is None)
        if whole.positions is not None and world.positions is not None:
            assert np.array_equal(world.positions, whole.positions[step])


def test_trials_seeds_and_robots_differ_and_a_swarm_s_size_does_not_matter() -> None:
    settings = make().settings
    worlds = [World(settings, 0), World(settings, 1), World(replace(settings, seed=SEED + 1), 0)]
    columns = np.concatenate([world.advance(200).black for world in worlds], axis=1).T
    assert len({column.tobytes() for column in columns}) == 12
    large = make(robots=30).advance(200).black
    assert np.array_equal(columns[:4].T, large[:, :4])


MOVING_SWARM: dict[str, Any] = {"robots": 9, "topology": "dynamic", "density": 3}
CODE: dict[str, Any] = {**MOVING_SWARM, "floor": "code"}


@pytest.mark.parametrize(
    ("given", "key", "message"),
    [
        ({"fill_ratio": math.nan}, "fill_ratio", "fill_ratio is nan; give a number"),
        ({"robots": 2.5}, "robots", "robots is 2.5; give a whole number"),
        ({"topology": "star"}, "topology", "choose one of fully-connected, dynamic, graph"),
        ({"topology": "graph"}, "graph", "graph is '': give its edges"),
        ({"graph": "0 1"}, "graph", "graph is '0 1': choose topology graph"),
        ({"topology": "graph", "graph": "0 9"}, "graph", "graph names robot 9, but the ids of 4 robots"),
        ({"topology": "graph", "graph": "0 0"}, "graph", "graph, edge 1: robot 0 cannot be its own"),
        ({"topology": "graph", "graph": 5}, "graph", "graph is 5; give a file, edges such as"),
        ({"density": 2}, "density", "density is 2.0 but robots do not move; choose topology dynamic"),
        ({"sensor": "absent"}, "sensor", "sensor is 'absent'; choose an extension: "),
        ({"drift": "sideways"}, "drift", "choose one of none, linear, stepped, wiener"),
        ({"drift_rate": 0.1}, "drift_rate", "drift_rate is 0.1 but drift is none; choose a drift"),
        ({"drift_diffusion": 0.1}, "drift_diffusion", "but drift is none; choose a drift"),
        (
            {"drift": "linear", "true_accuracy": 0.6, "lowest_accuracy": 0.7},
            *("lowest_accuracy", "lowest_accuracy is 0.7; it must be at most true_accuracy, 0.6"),
        ),
        ({**MOVING_SWARM, "density": 60}, "density", "9 robots of 0.1408 m are too many for 0.4"),
        ({**MOVING_SWARM, "density": 1e-6, "radio_range": 100.0}, "density", "may be up to 1000 m"),
        ({**MOVING_SWARM, "width": 3.0}, "density", "give one of them"),
        ({**MOVING_SWARM, "width": 3.0, "density": 1}, "height", "give width and height"),
        ({**MOVING_SWARM, "height": 3.0, "density": 1}, "width", "give width and height"),
        ({**MOVING_SWARM, "width": 0.1408, "height": 9.0, "density": 1}, "width", "too many"),
        ({**MOVING_SWARM, "speed": 0.9}, "speed", "1e-06 to 0.814"),
        ({**MOVING_SWARM, "speed": 0.8, "steps_per_second": 9}, "steps_per_second", "must be 10 or more"),
        ({**MOVING_SWARM, "density": 1, "width": 5.0, "height": 1.0, "tile": 2e-5}, "tile", "at most 100000"),
        ({"robotz": 3}, "robotz", "unknown key 'robotz'; did you mean robots"),
        ({**CODE, "tile": 0.02}, "tile", "without tiles"),
        ({**CODE, "fill_ratio": 0.44801}, "fill_ratio", "multiple of 0.0001"),
        ({**CODE, "fill_ratio": 0.88}, "fill_ratio", "can have 0.0183 to 0.8799"),
        ({**CODE, "fill_ratio": 0.0182}, "fill_ratio", "can have 0.0183 to"),
        (
            {"robots": 129},
            "robots",
            "robots is 129, but each would hear 128 others, and a round of the firmw",
        ),
        (
            {**MOVING_SWARM, "robots": 129, "radio_range": 1.43},
            *("radio_range", "robots is 129, but with radio_range 1.43 some could hear more than 127 others"),
        ),
        ({**MOVING_SWARM, "width": 0.591, "height": 0.591, "density": 1}, "width", "too many for 0.591 x"),
    ],
)
def test_what_cannot_be_is_refused(given: dict[str, Any], key: str, message: str) -> None:
    with pytest.raises(ParameterError) as caught:
        WorldSettings(**{"robots": 4} | given)
    assert caught.value.key == key
    assert message in str(caught.value)


def test_what_is_just_possible_is_taken() -> None:
    WorldSettings(robots=128)
    WorldSettings(robots=129, topology="graph", graph="0 128")
    WorldSettings(robots=129, topology="dynamic", radio_range=1.42)
    for side in (0.593, 1000.0):
        WorldSettings(**MOVING_SWARM | {"density": 1, "width": side, "height": side})
    WorldSettings(**MOVING_SWARM, speed=0.8, steps_per_second=10)
    for fill_ratio in (0.0183, 0.8799):
        WorldSettings(**CODE, fill_ratio=fill_ratio)


# --- Moving worlds ---------------------------------------------------------------------------------------


def test_the_density_makes_the_square() -> None:
    paper = WorldSettings(topology="dynamic", robots=20)
    assert paper.sides == pytest.approx((5.5486, 5.5486), abs=1e-4)
    assert replace(paper, density=1.0, width=3.0, height=2.0).sides == (3.0, 2.0)


def test_every_setting_reaches_the_arena() -> None:
    given = {"robots": 2, "width": 2.0, "height": 1.5, "speed": 0.1, "tile": 0.02, "fill_ratio": 0.4}
    settings = make(**given, topology="dynamic", radio_range=0.5, steps_per_second=20).settings
    values, _ = config_values(settings, 0, _arena.ffi)
    assert values == {**given, "range": 0.5, "tick": 1 / 20, "seed": world_seed(SEED, 0)}


@pytest.mark.parametrize("fill_ratio", [0.448, 0.1, 0.5, 0.5001, 0.8, 3 * 33e-4 + 2 * 42e-4])
def test_a_code_has_exactly_its_share_of_black(fill_ratio: float) -> None:
    pattern = code(fill_ratio)
    assert pattern.shape == (CODE_MODULES, CODE_MODULES)
    assert pattern.sum() == round(fill_ratio * CODE_MODULES**2)
    assert not pattern[34:66, 34:66].any(), "the logo is white"
    for corner in (pattern[:7, :7], pattern[:7, -7:], pattern[-7:, :7]):
        assert corner.sum() == 33, "a finder pattern: 24 in its frame, 9 in its middle"
    for line in (pattern[6, 8:92], pattern[8:92, 6]):
        assert (line == (np.arange(84) % 2 == 0)).all(), "a timing line"


def test_the_code_is_always_the_same() -> None:
    digest = hashlib.sha256(np.packbits(code(0.448)).tobytes()).hexdigest()
    assert digest[:16] == "0f663b83c29ac0ea"


# --- Edges -----------------------------------------------------------------------------------------------


@pytest.mark.parametrize("given", [{}, {"topology": "dynamic"}])
def test_a_draw_equal_to_the_probability_is_not_below_it(
    given: dict[str, Any], monkeypatch: pytest.MonkeyPatch
) -> None:
    chance = 3 * 2**29  # b = 3/4 in units of 2**-31
    monkeypatch.setattr(
        Stream, "words", lambda self, steps, first=0: np.full((steps, self.robots), 2 * chance, np.uint32)
    )
    assert not make(**given, fill_ratio=1.0, true_accuracy=0.75).advance(20).black.any()
    assert make(**given, fill_ratio=1.0, true_accuracy=0.75 + 2**-31).advance(20).black.all()


def model(answer: object) -> Any:
    """An extension that answers this."""
    return SimpleNamespace(advance=lambda steps: answer)


def test_answers_of_installed_sensors_are_checked() -> None:
    right, settings = np.full((1, 1), 0.5), make().settings
    answers: list[Any] = [np.full((5, 4), 0.5), np.ones((1, 1)), np.zeros((1, 4))]
    for given in answers:
        found = CheckedSensors(model((right, given)), settings).advance(5)
        assert found[0] is right and found[1] is given
    wrong: list[Any] = [np.full(shape, 0.5) for shape in ((4,), (2, 4), (5, 3))]
    wrong += [np.full((5, 4), value) for value in (1.01, -0.01, math.nan)]
    for given in wrong:
        words = (
            "outside 0 to 1; clip" if given.shape == (5, 4) else r"gives shape .*; return \(5 or 1, 4 or 1\)"
        )
        for pair in ((right, given), (given, right)):
            with pytest.raises(UsageError, match=words):
                CheckedSensors(model(pair), settings).advance(5)


def test_an_installed_sensor_takes_the_place_of_the_built_in_one(monkeypatch: pytest.MonkeyPatch) -> None:
    settings, pair = make().settings, (np.full((1, 1), 0.25), np.full((1, 1), 0.75))
    object.__setattr__(settings, "sensor", "mine")
    monkeypatch.setattr("mcp_asdf_tools.common.extensions.load", lambda group, name: lambda *_: model(pair))
    assert sensor_model(settings, 0).advance(5) == pair


def test_answers_of_installed_topologies_are_checked() -> None:
    hears = np.zeros((5, 4, 4), np.bool_)
    assert Checked(model(hears), "mine", 4).advance(5) is hears
    for wrong, words in (
        (hears[:4], "gives bool of shape"),
        (hears.astype(int), "gives int64 of shape"),
        (hears | np.eye(4, dtype=np.bool_), "a robot hears itself"),
    ):
        with pytest.raises(UsageError, match=words):
            Checked(model(wrong), "mine", 4).advance(5)


# --- Drifting sensors ------------------------------------------------------------------------------------


def true_accuracies(settings: WorldSettings, trial: int) -> NDArray[np.float64]:
    black, white = sensor_model(settings, trial).advance(settings.steps)
    assert white is black
    return black


@pytest.mark.parametrize(
    ("given", "expected"),
    [
        ({}, {0: 0.95}),
        (
            {"drift": "linear", "drift_rate": -1e-3, "lowest_accuracy": 0.6},
            {0: 0.95, 100: 0.85, 349: 0.601, 999: 0.6},
        ),
        ({"drift": "linear", "true_accuracy": 0.6, "lowest_accuracy": 0.6}, {0: 0.6, 999: 0.6}),
        (
            {"drift": "stepped", "drift_rate": -1e-4, "drift_period": 300},
            {0: 0.95, 299: 0.95, 300: 0.92, 599: 0.92, 600: 0.89, 899: 0.89, 900: 0.86, 999: 0.86},
        ),
    ],
)
def test_accuracy_drifts_as_stated(given: dict[str, Any], expected: dict[int, float]) -> None:
    path = true_accuracies(WorldSettings(steps=1000, **given), 0)
    assert path.shape == (1000 if given else 1, 1)
    assert {step: path[step, 0] for step in expected} == pytest.approx(expected)


def test_robots_deviate_from_the_common_drift_by_rates_of_their_own() -> None:
    given: dict[str, Any] = {"drift": "stepped", "drift_rate": -1e-4, "drift_period": 10}
    settings = WorldSettings(robots=100, true_accuracy=0.75, steps=200, drift_spread=1e-5, **given)
    paths = np.stack([true_accuracies(settings, trial) for trial in range(5)])
    assert (paths[:, :10] == 0.75).all()
    rates = (paths[:, 10] - 0.75) / 10
    normal = ndtri([Stream(MOVES, 1, trial, 100).uniforms(1)[0] for trial in range(5)])
    assert rates == pytest.approx(-1e-4 + 1e-5 * normal)
    assert rates.std() == pytest.approx(1e-5, rel=0.1)
    assert paths[:, 195] == pytest.approx(0.75 + 190 * rates)


def test_of_the_flawed_robots_alone_the_sensors_drift() -> None:
    given: dict[str, Any] = {"drift": "linear", "drift_rate": -1e-3, "steps": 100}
    population = Population(robots=4, flawed=1, drift_of="flawed", **given)
    path = true_accuracies(population, 0)
    assert path[99].tolist() == pytest.approx([0.95 - 0.099, 0.95, 0.95, 0.95])
    assert (true_accuracies(Population(robots=4, flawed=1, **given), 0)[99] < 0.9).all()


def test_wiener_drift_adds_up_moves_of_its_own_for_every_robot() -> None:
    given: dict[str, Any] = {"drift": "wiener", "drift_rate": 1e-5, "drift_diffusion": 1e-3}
    path = true_accuracies(WorldSettings(robots=100, true_accuracy=0.75, steps=400, **given), 3)
    moves = np.diff(path, axis=0)
    assert (path[0] == 0.75).all()
    assert moves == pytest.approx(1e-5 + 1e-3 * ndtri(Stream(MOVES, 1, 3, 100).uniforms(399, 1)))
    assert moves.std() == pytest.approx(1e-3, rel=0.01)
