"""The web page of a history: the bytes that its scripts decode, and how a notebook shows it."""

from __future__ import annotations

import base64
import html
import json
import re
import zlib
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from mcp_asdf_tools.common.errors import UsageError
from mcp_asdf_tools.experiments.experiment import Experiment
from mcp_asdf_tools.library import simulate
from mcp_asdf_tools.view.history import History, RunDescription, State
from mcp_asdf_tools.view.notebook_page import show
from mcp_asdf_tools.view.page import encode_description, encode_states, make_page


def decompress(text: str) -> bytes:
    return zlib.decompress(base64.b64decode(text))


def bytes_of_states(states: list[State], robots: int, **fields: Any) -> bytes:
    """Return the bytes of states in the web page. ``fields`` comes from their description."""
    block = encode_states(states, RunDescription("a run", list(range(robots)), **fields))
    return decompress(block["data"])


BYTES_PER_STEP_NUMBER = 4


def numbers_behind_step_numbers(data: bytes, count: int, states: int) -> list[int]:
    """Return the first 16-bit numbers in the bytes of states behind the numbers of steps of all states."""
    offset = states * BYTES_PER_STEP_NUMBER
    numbers: list[int] = np.frombuffer(data, "<u2", count, offset).tolist()
    return numbers


def make_state(tick: int, x: list[float], neighbours: Any = None, positions: Any = None) -> State:
    """Return a state of robots with these x, and 0 for all else; by default no robot receives another."""
    robots = len(x)
    zeros = [0.0] * robots
    x_x_hat_b_hat_and_accuracy = np.array([x, zeros, zeros, zeros])
    if neighbours is None:
        neighbours = np.zeros((robots, robots), np.bool_)
    return State(tick, x_x_hat_b_hat_and_accuracy, np.array(neighbours), positions)


# --- Descriptions and states as JSON ------------------------------------------------------------------


def test_a_description_becomes_a_json_object_with_the_names_of_its_attributes() -> None:
    """The scripts of the web page read it; "quantities" are the values that each state has of a robot."""
    description = RunDescription("a run", [3, 8], flawed=range(1), fill_ratio=0.5, unfiltered_errors=[0.1])
    assert encode_description(description) == {
        "title": "a run",
        "robots": [3, 8],
        "flawed": [0],
        "fill_ratio": 0.5,
        "steps": None,
        "steps_per_second": 10,
        "sides": None,
        "radio_range": None,
        "floor": None,
        "filter": None,
        "unfiltered_errors": [0.1],
        "faults": (),
        "quantities": ("x", "x_hat", "b_hat", "b"),
    }


def test_a_floor_is_encoded_as_a_bit_for_each_pixel_and_each_row_begins_at_a_byte() -> None:
    """Two rows of nine pixels take two bytes each, and 1 is black."""
    first_row = [1, 0, 0, 0, 0, 0, 0, 0, 1]
    second_row = [0, 1, 0, 0, 0, 0, 0, 0, 0]
    floor = np.array([first_row, second_row], np.bool_)
    encoded_floor = encode_description(RunDescription("a run", [0], floor=floor))["floor"]

    bytes_of_first_row, bytes_of_second_row = [0b10000000, 0b10000000], [0b01000000, 0b00000000]
    assert encoded_floor["rows"] == 2
    assert encoded_floor["columns"] == 9
    assert decompress(encoded_floor["bits"]) == bytes(bytes_of_first_row + bytes_of_second_row)


def test_states_are_counted_and_their_bytes_begin_with_their_numbers_of_steps() -> None:
    """States are after 5 and 300 steps. Each number has four bytes, the lowest first: 300 = 44 + 1 * 256."""
    states = [make_state(tick=5, x=[0]), make_state(tick=300, x=[0])]
    block = encode_states(states, RunDescription("a run", [0]))
    assert block["count"] == 2
    assert decompress(block["data"]).startswith(bytes([5, 0, 0, 0]) + bytes([44, 1, 0, 0]))


def test_each_robot_s_values_are_encoded_as_differences_to_the_state_before() -> None:
    """Differences compress better. Robot 0 has x = 0.5, 1, 1 and robot 1 has 0, 0, 0.25.

    A value of 1 is encoded as 65534, so 0.5 is 32767 and 0.25 is 16384. The values of x stand behind the
    numbers of steps of all states: first those of robot 0, then those of robot 1.
    """
    states = [make_state(tick=0, x=[0.5, 0]), make_state(tick=1, x=[1, 0]), make_state(tick=2, x=[1, 0.25])]
    data = bytes_of_states(states, robots=2)

    differences_of_robot_0 = [32767, 32767, 0]  # 0.5, another 0.5, nothing
    differences_of_robot_1 = [0, 0, 16384]  # nothing, nothing, 0.25
    numbers = numbers_behind_step_numbers(data, count=3 + 3, states=3)
    assert numbers == differences_of_robot_0 + differences_of_robot_1


@pytest.mark.parametrize(("x", "expected_number"), [(0.5, 32767), (-0.1, 0), (1.1, 65534), (np.nan, 65535)])
def test_a_value_is_encoded_as_a_number_up_to_65534_and_an_unknown_one_as_65535(
    x: float, expected_number: int
) -> None:
    """Values below 0 and above 1 are encoded as these limits. A state has NaN for what is unknown."""
    data = bytes_of_states([make_state(tick=0, x=[x])], robots=1)
    assert numbers_behind_step_numbers(data, count=1, states=1) == [expected_number]


def test_a_position_is_encoded_as_shares_of_the_arena_s_width_and_height() -> None:
    """A robot is at the east end of an arena of 4 m x 2 m, half a metre south of the middle.

    So it has all of the width, which is encoded as 65534, and a quarter of the height, which is encoded as
    16384. These numbers stand behind the robot's four values.
    """
    state = make_state(tick=0, x=[0], positions=np.array([[2.0, -0.5]]))
    data = bytes_of_states([state], robots=1, sides=(4.0, 2.0))

    numbers = numbers_behind_step_numbers(data, count=4 + 2, states=1)
    _x, _x_hat, _b_hat, _true_accuracy, share_of_width, share_of_height = numbers
    assert share_of_width == 65534
    assert share_of_height == 16384


def test_links_are_encoded_as_a_bit_for_each_pair_of_robots() -> None:
    """Of three robots, robot 0 receives from 1, which is bit 1, and robot 2 receives from 0, bit 6.

    The number of a bit is 3 * receiver + sender. The nine bits of a state take two bytes, the lowest bit
    first. These bytes are the last ones.
    """
    neighbours = [[False, True, False], [False, False, False], [True, False, False]]
    first_state = make_state(tick=0, x=[0, 0, 0], neighbours=neighbours)
    second_state = make_state(tick=1, x=[0, 0, 0], neighbours=neighbours)
    data = bytes_of_states([first_state, second_state], robots=3)

    bytes_of_a_state = bytes([0b01000010, 0])
    assert data.endswith(bytes_of_a_state + bytes_of_a_state)


def test_links_between_more_than_128_robots_are_encoded_as_pairs_of_receiver_and_sender() -> None:
    """The last bytes are the numbers of links in the two states, and the ids of all receivers and senders.

    A number of links has four bytes (u4), and an id has two (u2); the lowest byte comes first (<).
    """
    zeros = [0.0] * 129
    first_state = make_state(tick=0, x=zeros, neighbours=[[0, 1], [128, 5]])  # 0 receives from 1, 128 from 5
    second_state = make_state(tick=1, x=zeros, neighbours=[[7, 0]])
    data = bytes_of_states([first_state, second_state], robots=129)

    numbers_of_links = np.array([2, 1], "<u4").tobytes()
    ids_of_receivers_and_senders = np.array([0, 1, 128, 5, 7, 0], "<u2").tobytes()
    assert data.endswith(numbers_of_links + ids_of_receivers_and_senders)


# --- The page -----------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def exported_page() -> str:
    """The page of a history whose title tries to end the script that it is in."""
    return make_page(History(RunDescription("a </script> run", [0]), [make_state(tick=0, x=[0.5])]))


def history_in(page: str) -> Any:
    """Return the history in a page, as JSON has it."""
    (history_text,) = re.findall('<script id="history" type="application/json">(.*?)</script>', page)
    return json.loads(history_text)


def test_an_exported_page_holds_the_history_even_if_its_title_has_an_end_tag(exported_page: str) -> None:
    """The title contains "</script>", which would end the script element that holds the history.

    The history has one state.
    """
    history = history_in(exported_page)
    assert history["description"]["title"] == "a </script> run"
    assert history["block"]["count"] == 1


def test_a_served_page_holds_no_history() -> None:
    """``make_page`` without a history makes the page of a server, which gets the states as events."""
    assert history_in(make_page()) is None


def test_no_placeholder_of_the_template_is_left_in_an_exported_page(exported_page: str) -> None:
    """Scripts and styles replace placeholders, which are words such as __STYLE__."""
    assert re.findall("__[A-Z_]+__", exported_page) == []


def test_an_exported_page_contains_the_licence_of_its_chart_library(exported_page: str) -> None:
    """The page contains the library, whose licence (MIT) must come with it; the licence has these words."""
    assert "Permission is hereby granted" in exported_page


# --- In a notebook ------------------------------------------------------------------------------------

EXPERIMENT_WITH_4_ROBOTS = Experiment(
    topology="dynamic", robots=4, steps=50, filter_period=20, trials=2, density=0.5
)


def test_a_notebook_shows_a_trial_as_a_web_page_in_a_frame() -> None:
    """A notebook displays the HTML that the method ``_repr_html_`` of a cell's last value returns.

    The page is an attribute of an iframe, so its quotes and angle brackets are escaped.
    """
    shown_trial = show(EXPERIMENT_WITH_4_ROBOTS, trial=1)
    displayed_html = shown_trial._repr_html_()
    assert displayed_html.startswith("<iframe srcdoc=")
    assert html.escape(shown_trial.page) in displayed_html


def test_the_web_page_that_a_notebook_shows_can_be_saved(tmp_path: Path) -> None:
    """The file has the text of the page in UTF-8."""
    shown_trial = show(EXPERIMENT_WITH_4_ROBOTS)
    shown_trial.save(str(tmp_path / "run.html"))
    assert (tmp_path / "run.html").read_text(encoding="utf-8") == shown_trial.page


def test_a_trial_in_results_is_shown_as_the_same_page_as_that_trial_of_the_experiment() -> None:
    """A trial of an experiment is simulated for the page, and so is one of results.

    The results are of two experiments, with 5 and with 4 robots. ``where`` chooses that with 4.
    """
    experiment_with_5_robots = replace(EXPERIMENT_WITH_4_ROBOTS, robots=5)
    results = simulate([experiment_with_5_robots, EXPERIMENT_WITH_4_ROBOTS])
    trial_of_results = show(results, trial=1, where={"robots": "4"})
    trial_of_experiment = show(EXPERIMENT_WITH_4_ROBOTS, trial=1)
    assert trial_of_results.page == trial_of_experiment.page


def test_trial_1_is_not_shown_as_trial_0() -> None:
    """The two trials have other random numbers, so their web pages differ."""
    trial_0 = show(EXPERIMENT_WITH_4_ROBOTS, trial=0)
    trial_1 = show(EXPERIMENT_WITH_4_ROBOTS, trial=1)
    assert trial_1.page != trial_0.page


def test_a_notebook_cannot_show_a_trial_below_0() -> None:
    """Trials are numbered from 0 on, and trial -1 is refused."""
    with pytest.raises(UsageError, match="trial is -1; give 0 or more"):
        show(EXPERIMENT_WITH_4_ROBOTS, trial=-1)
