"""The world: observations follow from the seed and the stated probabilities, and from nothing else."""

from __future__ import annotations

import math
from fractions import Fraction
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from golden import assert_equals_golden_file
from mcp_asdf.robot import Observation
from mcp_asdf_tools.common.errors import UsageError
from mcp_asdf_tools.common.parameters import ParameterError
from mcp_asdf_tools.robots.population import Population
from mcp_asdf_tools.world import _arena
from mcp_asdf_tools.world.arena import Arena, make_config
from mcp_asdf_tools.world.floor_code import make_floor_code
from mcp_asdf_tools.world.philox import OBSERVATION_STREAM, SENSOR_STREAM, Stream, arena_seed, philox
from mcp_asdf_tools.world.sensors import CheckedSensors, make_sensor_model
from mcp_asdf_tools.world.settings import WorldSettings
from mcp_asdf_tools.world.topology import CheckedTopology
from mcp_asdf_tools.world.world import Scene, SteppedWorld, World

SEED = 20241029
WORLDS: dict[str, dict[str, Any]] = {
    "fully connected": {},
    "graph": {"topology": "graph", "graph": "0 1; 1 > 2"},
    "dynamic": {"topology": "dynamic"},
    "drifting": {"drift": "linear", "drift_rate": -1e-3},
    "moving, drifting": {"topology": "dynamic", "drift": "linear", "drift_rate": -1e-3},
    "rare observations": {"observation_period": 3, "white_offset": -0.2},
}
in_each_world = pytest.mark.parametrize("changes", WORLDS.values(), ids=WORLDS)


def make_settings(**changes: Any) -> WorldSettings:
    """Return settings of four robots and 200 steps with some parameters changed."""
    return WorldSettings(**{"robots": 4, "steps": 200, "seed": SEED} | changes)


def make_world(**changes: Any) -> World:
    """Return a world of four robots and 200 steps with some parameters changed."""
    return World(make_settings(**changes))


# --- Draws -----------------------------------------------------------------------------------------------


def philox_words(counter: tuple[int, int, int, int], key: tuple[int, int]) -> list[int]:
    """Return the four random words of one counter, by the function that takes many counters."""
    first, second, third, fourth = [np.array([word], np.uint64) for word in counter]
    arrays_of_one_word = philox((first, second, third, fourth), key)
    return [int(word) for (word,) in arrays_of_one_word]


@pytest.mark.parametrize(
    ("counter", "key", "expected_words"),
    [
        ((0, 0, 0, 0), (0, 0), [0x6627E8D5, 0xE169C58D, 0xBC57AC4C, 0x9B00DBD8]),
        (
            (0x243F6A88, 0x85A308D3, 0x13198A2E, 0x03707344),
            (0xA4093822, 0x299F31D0),  # low word and high word
            [0xD16CFE09, 0x94FDCCEB, 0x5001E420, 0x24126EA1],
        ),
    ],
)
def test_random_numbers_are_those_of_the_generator_philox_4x32_10(
    counter: tuple[int, int, int, int], key: tuple[int, int], expected_words: list[int]
) -> None:
    """It turns a counter and a key into four words, here those that its authors state (Random123)."""
    assert philox_words(counter, key) == expected_words


def test_a_random_number_depends_on_seed_step_robot_trial_and_purpose_alone() -> None:
    """The generator makes the numbers of four steps from the counter (step // 4, robot, trial, purpose).

    Its key is the seed: the low 32 bits, and the high ones.
    """
    purpose, trial, robot = 1, 7, 2
    stream = Stream(purpose, seed=0x299F31D0_A4093822, trial=trial, robots=3)
    words_of_steps_0_to_3 = stream.draw_words(steps=4)[:, robot]  # from (steps, robots)

    key = (0xA4093822, 0x299F31D0)
    counter = (0, robot, trial, purpose)
    assert words_of_steps_0_to_3.tolist() == philox_words(counter, key)


@pytest.mark.parametrize("first_step", [0, 1, 3, 4, 6])
def test_random_numbers_of_a_step_do_not_depend_on_the_first_step_asked_for(first_step: int) -> None:
    """Nine steps have the same numbers as among all twenty, although they are made for four steps at once."""
    stream = Stream(OBSERVATION_STREAM, SEED, trial=0, robots=3)
    words_of_20_steps = stream.draw_words(steps=20)
    words_of_9_steps = stream.draw_words(steps=9, first_step=first_step)
    assert np.array_equal(words_of_9_steps, words_of_20_steps[first_step : first_step + 9])


def test_uniform_draws_are_the_middles_of_equal_intervals() -> None:
    """A draw is (word + 1/2) / 2**32, so that none is 0 or 1."""
    stream = Stream(SENSOR_STREAM, SEED, trial=0, robots=3)
    words = stream.draw_words(steps=5)
    assert np.array_equal(stream.draw_uniforms(steps=5), (words + 0.5) / 2.0**32)


# --- Observations ----------------------------------------------------------------------------------------


def draw_31_bits(steps: int, robots: int) -> NDArray[np.uint32]:
    """Return the random numbers by which robots observe in the first steps of trial 0, by step and robot."""
    words = Stream(OBSERVATION_STREAM, SEED, trial=0, robots=robots).draw_words(steps)
    return words // np.uint32(2)


@pytest.mark.parametrize(
    ("white_offset", "accuracy_on_white"),
    [(0.0, Fraction(7, 10)), (-0.125, Fraction(7, 10) - Fraction(1, 8))],
)
def test_each_random_number_becomes_black_with_the_probability_of_the_paper_s_equation_1(
    white_offset: float, accuracy_on_white: Fraction
) -> None:
    """A robot observes black on black tiles, 2/5 of the floor, and by mistake on white ones, 3/5.

    A number of 31 bits becomes black if it is below the sum of both probabilities, times 2**31. Four robots
    observe in 200 steps.
    """
    world = make_world(robots=4, fill_ratio=0.4, true_accuracy=0.7, white_offset=white_offset)
    rightly_black = Fraction(2, 5) * Fraction(7, 10)
    wrongly_black = Fraction(3, 5) * (1 - accuracy_on_white)
    random_numbers = draw_31_bits(steps=200, robots=4)
    expected_black = random_numbers < float((rightly_black + wrongly_black) * 2**31)

    assert np.array_equal(world.advance(steps=200).black, expected_black)


def test_the_reported_accuracy_of_a_sensor_is_the_mean_of_those_on_black_and_on_white() -> None:
    """The accuracy on black tiles is 0.7, and that on white ones is lower by the offset, 0.125."""
    world = make_world(true_accuracy=0.7, white_offset=-0.125)
    mean_of_both = (0.7 + (0.7 - 0.125)) / 2
    assert world.advance(steps=200).accuracy == pytest.approx(mean_of_both)


def test_moving_robots_observe_the_colour_under_them_with_the_accuracy_of_their_sensor() -> None:
    """Four robots observe in 200 steps. The accuracy is 0.75 on black tiles, and 0.125 more on white ones.

    A random number of 31 bits becomes black if it is below the probability of black, times 2**31.
    """
    settings = make_settings(topology="dynamic", fill_ratio=0.4, true_accuracy=0.75, white_offset=0.125)
    is_on_black_tile = Arena(settings, trial=0).record(ticks=200).black.astype(bool)  # by step and robot
    right_on_black, wrong_on_white = 0.75, 1 - (0.75 + 0.125)
    probability_of_black = np.where(is_on_black_tile, right_on_black, wrong_on_white)
    expected_black = draw_31_bits(steps=200, robots=4) < probability_of_black * 2**31

    assert np.array_equal(World(settings).advance(steps=200).black, expected_black)


@pytest.mark.parametrize("topology", ["fully-connected", "dynamic"])
@pytest.mark.parametrize(("true_accuracy", "is_black"), [(0.75, False), (0.75 + 2**-31, True)])
def test_a_draw_is_observed_as_black_only_if_it_is_below_the_probability_of_black(
    true_accuracy: float, is_black: bool, topology: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The floor is black, and all draws are 3/4. The accuracy of the sensor is 3/4, or a unit above.

    So the probability of black is the accuracy.
    """

    def draw_three_quarters(stream: Stream, steps: int, first_step: int = 0) -> NDArray[np.uint32]:
        return np.full((steps, stream.robots), 0.75 * 2**32, np.uint32)  # words are draws times 2**32

    monkeypatch.setattr(Stream, "draw_words", draw_three_quarters)
    world = make_world(topology=topology, fill_ratio=1.0, true_accuracy=true_accuracy)

    assert (world.advance(steps=20).black == is_black).all()


def test_robots_of_other_trials_and_seeds_observe_differently() -> None:
    """Twelve robots, four in each of three worlds, have twelve different sequences of observations."""
    worlds = [
        World(make_settings(seed=1), trial=0),
        World(make_settings(seed=1), trial=1),
        World(make_settings(seed=2), trial=0),
    ]
    sequences = set()
    for world in worlds:
        observations = world.advance(steps=200).black  # by step and robot
        for robot in range(4):
            sequences.add(tuple(observations[:, robot]))

    assert len(sequences) == 12


def test_what_a_robot_observes_does_not_depend_on_the_size_of_the_swarm() -> None:
    """The first four robots of thirty observe what four robots alone do."""
    black_in_small_swarm = make_world(robots=4).advance(steps=200).black  # by step and robot
    black_in_large_swarm = make_world(robots=30).advance(steps=200).black
    assert np.array_equal(black_in_small_swarm, black_in_large_swarm[:, :4])


# --- Steps -----------------------------------------------------------------------------------------------


@pytest.mark.parametrize("period", [1, 3])
def test_robots_observe_in_the_last_step_of_each_observation_period(period: int) -> None:
    """Steps are counted from 0, so with a period of 3 they observe in steps 2, 5, 8 and so on."""
    observes = make_world(observation_period=period).advance(steps=200).observes
    steps_with_observations = np.flatnonzero(observes).tolist()
    assert steps_with_observations == list(range(period - 1, 200, period))


@in_each_world
def test_a_world_is_the_same_however_many_steps_are_taken_at_once(changes: dict[str, Any]) -> None:
    """200 steps at once give the same four arrays as 7, 1, 130 and 62 steps, joined.

    The worlds differ in some settings, such as the topology.
    """
    scene_at_once = make_world(**changes).advance(steps=200)
    world = make_world(**changes)
    scenes = [world.advance(steps=steps) for steps in (7, 1, 130, 62)]
    for name in ("black", "observes", "neighbours", "accuracy"):
        joined_values = np.concatenate([getattr(scene, name) for scene in scenes])
        assert np.array_equal(joined_values, getattr(scene_at_once, name)), name


@in_each_world
def test_observations_after_skipped_steps_are_the_same_as_if_these_had_been_taken(
    changes: dict[str, Any],
) -> None:
    """The last 63 of 200 steps have the same observations. The first 137 are skipped in two parts."""
    scene_without_skipping = make_world(**changes).advance(steps=200)
    world = make_world(**changes)
    world.skip(steps=7)
    world.skip(steps=130)
    scene_after_skipping = world.advance(steps=63)

    assert np.array_equal(scene_after_skipping.black, scene_without_skipping.black[7 + 130 :])


def observations_by_step(scene: Scene) -> list[list[Observation | None]]:
    """Return the observations of all robots by step; None in steps without an observation."""
    observations: list[list[Observation | None]] = []
    for step, robots_observe in enumerate(scene.observes.tolist()):
        if robots_observe:
            observations.append([Observation(is_black) for is_black in scene.black[step].tolist()])
        else:
            observations.append([None] * scene.black.shape[1])
    return observations


@in_each_world
def test_a_world_taken_step_by_step_equals_a_world_of_all_steps_at_once(changes: dict[str, Any]) -> None:
    """In each of 200 steps both have the same observations, neighbours, accuracies and positions.

    Only moving robots have positions.
    """
    scene = make_world(**changes).advance(steps=200)
    stepped_world = SteppedWorld(make_settings(**changes))
    for step, expected_observations in enumerate(observations_by_step(scene)):
        assert list(stepped_world.step()) == expected_observations
        assert np.array_equal(stepped_world.current_neighbours, scene.neighbours[step])
        assert np.array_equal(stepped_world.accuracy, scene.accuracy[step])
        if scene.positions is not None:
            assert stepped_world.positions is not None
            assert np.array_equal(stepped_world.positions, scene.positions[step])


@pytest.mark.parametrize("topology", [{"topology": "fully-connected"}, {"topology": "graph", "graph": "0 1"}])
def test_robots_that_do_not_move_have_no_positions(topology: dict[str, str]) -> None:
    """``positions`` is None if 200 steps are taken at once, and step by step."""
    scene_at_once = make_world(**topology).advance(steps=200)
    stepped_world = SteppedWorld(make_settings(**topology))
    stepped_world.step()

    assert scene_at_once.positions is None
    assert stepped_world.positions is None


# --- Settings that are refused ---------------------------------------------------------------------------

MOVING_ROBOTS: dict[str, Any] = {"robots": 9, "topology": "dynamic", "density": 3}
CODE_FLOOR: dict[str, Any] = {**MOVING_ROBOTS, "floor": "code"}


@pytest.mark.parametrize(
    ("changes", "wrong_parameter", "expected_message"),
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
        ({"drift": "sideways"}, "drift", "choose one of none, linear"),
        ({"drift_rate": 0.1}, "drift_rate", "drift_rate is 0.1 but drift is none; choose a drift"),
        (
            {"drift": "linear", "true_accuracy": 0.6, "lowest_accuracy": 0.7},
            "lowest_accuracy",
            "lowest_accuracy is 0.7; it must be at most true_accuracy, 0.6",
        ),
        ({**MOVING_ROBOTS, "density": 60}, "density", "9 robots of 0.1408 m are too many for 0.4"),
        ({**MOVING_ROBOTS, "density": 1e-6, "radio_range": 100.0}, "density", "may be up to 1000 m"),
        ({**MOVING_ROBOTS, "width": 3.0}, "density", "give one of them"),
        ({**MOVING_ROBOTS, "width": 3.0, "density": 1}, "height", "give width and height"),
        ({**MOVING_ROBOTS, "height": 3.0, "density": 1}, "width", "give width and height"),
        ({**MOVING_ROBOTS, "width": 0.1408, "height": 9.0, "density": 1}, "width", "too many"),
        ({**MOVING_ROBOTS, "speed": 0.9}, "speed", "1e-06 to 0.814"),
        ({**MOVING_ROBOTS, "speed": 0.8, "steps_per_second": 9}, "steps_per_second", "must be 10 or more"),
        (
            {**MOVING_ROBOTS, "density": 1, "width": 5.0, "height": 1.0, "tile": 2e-5},
            "tile",
            "at most 100000",
        ),
        ({**CODE_FLOOR, "tile": 0.02}, "tile", "without tiles"),
        ({**CODE_FLOOR, "fill_ratio": 0.44801}, "fill_ratio", "multiple of 0.0001"),
        ({**CODE_FLOOR, "fill_ratio": 0.88}, "fill_ratio", "can have 0.0183 to 0.8799"),
        ({**CODE_FLOOR, "fill_ratio": 0.0182}, "fill_ratio", "can have 0.0183 to"),
        (
            {"robots": 129},
            "robots",
            "robots is 129, but each would hear 128 others, and a round of the firmw",
        ),
        (
            {**MOVING_ROBOTS, "robots": 129, "radio_range": 1.43},
            "radio_range",
            "robots is 129, but with radio_range 1.43 some could hear more than 127 others",
        ),
        ({**MOVING_ROBOTS, "width": 0.591, "height": 0.591, "density": 1}, "width", "too many for 0.591 x"),
    ],
)
def test_settings_of_a_world_that_contradict_each_other_are_refused(
    changes: dict[str, Any], wrong_parameter: str, expected_message: str
) -> None:
    """The ``key`` of the error is the parameter that is wrong, and the text says what would be right."""
    parameters: dict[str, Any] = {"robots": 4} | changes
    with pytest.raises(ParameterError) as raised:
        WorldSettings(**parameters)
    assert raised.value.key == wrong_parameter
    assert expected_message in str(raised.value)


@pytest.mark.parametrize(
    "parameters",
    [
        {"robots": 128},
        {"robots": 129, "topology": "graph", "graph": "0 128"},
        {"drift": "linear", "drift_rate": -1e-3, "true_accuracy": 0.6, "lowest_accuracy": 0.6},
        {"robots": 129, "topology": "dynamic", "radio_range": 1.42},
        {**MOVING_ROBOTS, "density": 1, "width": 0.593, "height": 0.593},
        {**MOVING_ROBOTS, "density": 1, "width": 1000.0, "height": 1000.0},
        {**MOVING_ROBOTS, "speed": 0.8, "steps_per_second": 10},
        {**CODE_FLOOR, "fill_ratio": 0.0183},
        {**CODE_FLOOR, "fill_ratio": 0.8799},
    ],
)
def test_settings_at_a_limit_are_accepted(parameters: dict[str, Any]) -> None:
    """They raise no error and are kept unchanged. Only a graph, which is given as a text, is parsed."""
    settings = WorldSettings(**parameters)
    for name, value in parameters.items():
        if name != "graph":
            assert getattr(settings, name) == value, name


@pytest.mark.parametrize(
    ("unknown_name", "expected_advice"),
    [("robotz", "did you mean robots"), ("zzz", "known are robots, topology, ")],
)
def test_an_unknown_parameter_is_refused_with_the_nearest_known_one_or_with_all(
    unknown_name: str, expected_advice: str
) -> None:
    """For "robotz" the error asks "did you mean robots"; for "zzz", like no parameter, it lists all."""
    with pytest.raises(ParameterError, match=f"unknown key '{unknown_name}'; {expected_advice}"):
        WorldSettings.from_parameters({unknown_name: 3})


# --- Recordings of earlier versions ----------------------------------------------------------------------


def test_a_recording_with_former_parameters_that_had_no_effect_opens() -> None:
    """The former parameters of drifting sensors are dropped, as there is no drift."""
    recorded_parameters = {"robots": 4, "drift_spread": 0.0, "drift_period": 1000, "drift_diffusion": 0.0}
    assert WorldSettings.from_recording(recorded_parameters) == WorldSettings(robots=4)


@pytest.mark.parametrize(
    ("recorded_parameters", "expected_message"),
    [
        (
            {"drift": "linear", "drift_rate": -1e-5, "drift_spread": 1e-6},
            "drift_spread is 1e-06, a parameter of earlier versions",
        ),
        ({"drift": "wiener", "drift_diffusion": 0.001}, "drift is 'wiener'; choose one of none, linear"),
    ],
)
def test_a_recording_with_former_parameters_that_had_an_effect_is_refused(
    recorded_parameters: dict[str, Any], expected_message: str
) -> None:
    """In earlier versions sensors drifted in several ways, which a replay could not compute any more."""
    with pytest.raises(ParameterError, match=expected_message):
        WorldSettings.from_recording(recorded_parameters)


# --- Moving worlds ---------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("parameters", "expected_sides"),
    [
        ({}, (5.5486, 5.5486)),  # the density of the paper
        ({"density": 1.0}, (math.sqrt(20 * math.pi * 0.7**2 / 1.0),) * 2),
        ({"density": 1.0, "width": 3.0, "height": 2.0}, (3.0, 2.0)),
    ],
)
def test_the_floor_of_20_moving_robots_is_a_square_of_their_density_unless_its_sides_are_given(
    parameters: dict[str, Any], expected_sides: tuple[float, float]
) -> None:
    """Density is the number of robots times the area of a radio's range, 0.7 m, by the area of the floor.

    ``sides`` are width and height in metres.
    """
    settings = WorldSettings(topology="dynamic", robots=20, **parameters)
    assert settings.sides == pytest.approx(expected_sides, abs=1e-4)


def test_every_setting_of_moving_robots_reaches_their_simulation_in_c() -> None:
    """Most have the same name there. A tick is a step in seconds, and the seed is derived for the trial."""
    same_in_c = {"robots": 2, "width": 2.0, "height": 1.5, "speed": 0.1, "tile": 0.02, "fill_ratio": 0.4}
    settings = make_settings(**same_in_c, topology="dynamic", radio_range=0.5, steps_per_second=20, seed=11)

    members_in_c, _picture_of_floor = make_config(settings, trial=0, ffi=_arena.ffi)

    other_members = {"range": 0.5, "tick": 1 / 20, "seed": arena_seed(seed=11, trial=0)}
    assert members_in_c == same_in_c | other_members


LEAST_FILL_RATIO_OF_CODES = (3 * 33 + 2 * 42) / 100**2
"""Share of black in three finder patterns, of 33 modules, and two timing lines, of 42, among 10^4 modules."""
FILL_RATIOS_OF_CODES = [0.448, 0.5001, 0.8, LEAST_FILL_RATIO_OF_CODES]


@pytest.mark.parametrize("fill_ratio", FILL_RATIOS_OF_CODES)
def test_a_floor_like_a_qr_code_has_exactly_the_chosen_share_of_black_and_a_white_middle(
    fill_ratio: float,
) -> None:
    """So many of its 100 x 100 modules are black. The 32 x 32 in the middle are all white, for a logo."""
    is_black = make_floor_code(fill_ratio)  # by row and column
    middle_of_code = is_black[34:66, 34:66]
    assert is_black.shape == (100, 100)
    assert is_black.sum() == round(fill_ratio * 100 * 100)
    assert not middle_of_code.any()


def test_a_floor_like_a_qr_code_is_always_the_same() -> None:
    """It equals the golden file, in which each character is a module: # is black."""
    lines = []
    for row in make_floor_code(fill_ratio=0.448):
        lines.append("".join("#" if is_black else "." for is_black in row))
    assert_equals_golden_file("floor_code.txt", lines)


# --- Extensions ------------------------------------------------------------------------------------------


def extension_whose_advance_returns(answer: object) -> Any:
    """Return a sensor model or a topology of a user, whose method ``advance`` returns this for any steps."""
    return SimpleNamespace(advance=lambda steps: answer)


@pytest.mark.parametrize("accuracies", [np.full((5, 4), 0.5), np.ones((1, 1)), np.zeros((1, 4))])
def test_accuracies_of_an_extension_may_be_alike_for_all_steps_or_robots(
    accuracies: NDArray[np.float64],
) -> None:
    """One row stands for all 5 steps, one column for all 4 robots. The arrays are returned unchanged."""
    one_accuracy = np.array([[0.5]])  # in all steps, of all robots
    extension = extension_whose_advance_returns((one_accuracy, accuracies))
    sensors = CheckedSensors(extension, make_settings(robots=4))
    on_black, on_white = sensors.advance(steps=5)
    assert on_black is one_accuracy
    assert on_white is accuracies


WRONG_SHAPE = r"gives shape .*; return \(5 or 1, 4 or 1\)"  # for 5 steps and 4 robots


@pytest.mark.parametrize("is_on_white", [False, True])
@pytest.mark.parametrize(
    ("shape", "accuracy", "expected_message"),
    [
        ((4,), 0.5, WRONG_SHAPE),
        ((2, 4), 0.5, WRONG_SHAPE),
        ((5, 3), 0.5, WRONG_SHAPE),
        ((5, 4), 1.01, "outside 0 to 1; clip"),
        ((5, 4), -0.01, "outside 0 to 1; clip"),
        ((5, 4), math.nan, "outside 0 to 1; clip"),
    ],
)
def test_accuracies_of_an_extension_of_a_wrong_shape_or_outside_0_to_1_are_refused(
    shape: tuple[int, ...], accuracy: float, expected_message: str, is_on_white: bool
) -> None:
    """A sensor model of the user's gives them for black or white tiles. The error says what to return.

    There are 4 robots and 5 steps.
    """
    right_accuracies = np.array([[0.5]])  # in all steps, of all robots
    wrong_accuracies = np.full(shape, accuracy)
    on_black = right_accuracies if is_on_white else wrong_accuracies
    on_white = wrong_accuracies if is_on_white else right_accuracies
    extension = extension_whose_advance_returns((on_black, on_white))
    sensors = CheckedSensors(extension, make_settings(robots=4))

    with pytest.raises(UsageError, match=expected_message):
        sensors.advance(steps=5)


def test_a_sensor_model_of_the_user_takes_the_place_of_the_built_in_one() -> None:
    """The user's model has the accuracies 1/4 on black tiles and 3/4 on white ones, in all of 5 steps."""

    def make_extension(settings: WorldSettings, trial: int) -> Any:
        on_black = np.array([[0.25]])  # in all steps, of all robots
        on_white = np.array([[0.75]])
        return extension_whose_advance_returns((on_black, on_white))

    sensor_model = make_sensor_model(make_settings(sensor=make_extension), trial=0)
    on_black, on_white = sensor_model.advance(steps=5)

    assert on_black.tolist() == [[0.25]]
    assert on_white.tolist() == [[0.75]]


def test_a_sensor_that_breaks_its_promise_of_one_accuracy_is_refused() -> None:
    """The sensor promises one accuracy for both colours, and returns two. The error names the attribute."""

    class Sensors:
        has_one_accuracy = True

        def __init__(self, settings: WorldSettings, trial: int) -> None:
            pass

        def advance(self, steps: int) -> Any:
            on_black = np.array([[0.9]])
            on_white = np.array([[0.8]])
            return on_black, on_white

    sensors = make_sensor_model(make_settings(sensor=Sensors), trial=0)
    with pytest.raises(UsageError, match="on white tiles that differ from those on black ones; remove has_"):
        sensors.advance(steps=5)


def test_right_neighbours_of_an_extension_are_passed_on_unchanged() -> None:
    """The array of a user's topology, by step, receiver and sender, comes out of the check itself."""
    neighbours = np.zeros((5, 4, 4), np.bool_)
    extension = extension_whose_advance_returns(neighbours)
    topology = CheckedTopology(extension, name="mine", robots=4)
    assert topology.advance(steps=5) is neighbours


@pytest.mark.parametrize(
    ("wrong_neighbours", "expected_message"),
    [
        (np.zeros((4, 4, 4), np.bool_), "gives bool of shape"),
        (np.zeros((5, 4, 4), np.int64), "gives int64 of shape"),
        (np.zeros((5, 4, 4), np.bool_) | np.eye(4, dtype=np.bool_), "a robot hears itself"),
    ],
    ids=["4 steps in place of 5", "numbers", "each robot its own neighbour"],
)
def test_wrong_neighbours_of_an_extension_are_refused(
    wrong_neighbours: NDArray[Any], expected_message: str
) -> None:
    """A topology gives truth values by step, receiver and sender. The error says what is wrong.

    There are 4 robots and 5 steps.
    """
    extension = extension_whose_advance_returns(wrong_neighbours)
    topology = CheckedTopology(extension, name="mine", robots=4)
    with pytest.raises(UsageError, match=expected_message):
        topology.advance(steps=5)


# --- Drifting sensors ------------------------------------------------------------------------------------


def accuracies_by_step_and_robot(settings: WorldSettings) -> NDArray[np.float64]:
    """Return the true accuracies of trial 0; they must be the same on both colours."""
    black, white = make_sensor_model(settings, 0).advance(settings.steps)
    assert white is black
    return black


def test_without_drift_the_accuracy_is_one_number_for_all_steps_and_robots() -> None:
    """The array has one row, which stands for all 1000 steps, and one column, for all robots."""
    settings = WorldSettings(steps=1000, true_accuracy=0.9)
    assert accuracies_by_step_and_robot(settings).tolist() == [[0.9]]


def test_a_linear_drift_ends_at_the_lowest_accuracy() -> None:
    """It begins at 0.9, loses a thousandth in each step, and stays 0.6 from step 300 on."""
    settings = WorldSettings(
        steps=1000, drift="linear", true_accuracy=0.9, drift_rate=-1e-3, lowest_accuracy=0.6
    )
    accuracies = accuracies_by_step_and_robot(settings)
    assert accuracies.shape == (1000, 1)  # one column stands for all robots

    expected_accuracies = [max(0.9 - step * 1e-3, 0.6) for step in range(1000)]
    assert accuracies[:, 0] == pytest.approx(expected_accuracies)


@pytest.mark.parametrize(
    ("choice", "expected_accuracies"),
    [
        ({"drift_of": "flawed"}, [0.95 - 99 * 1e-3, 0.95, 0.95, 0.95]),
        ({}, [0.95 - 99 * 1e-3]),  # one accuracy for all robots
    ],
)
def test_sensors_drift_in_all_robots_unless_only_flawed_robots_are_to_drift(
    choice: dict[str, Any], expected_accuracies: list[float]
) -> None:
    """The first of four robots is flawed. An accuracy of 0.95 loses a thousandth in each of 99 steps."""
    drift: dict[str, Any] = {"drift": "linear", "drift_rate": -1e-3, "true_accuracy": 0.95}
    settings = Population(robots=4, flawed=1, steps=100, **drift, **choice)
    *_, accuracies_in_last_step = accuracies_by_step_and_robot(settings)
    assert accuracies_in_last_step.tolist() == pytest.approx(expected_accuracies)
