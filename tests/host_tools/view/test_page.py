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


def data_of(states: list[State], robots: int, **fields: Any) -> bytes:
    """Return the bytes of states in the web page. ``fields`` comes from their description."""
    block = encode_states(states, RunDescription("a run", list(range(robots)), **fields))
    return decompress(block["data"])


BYTES_PER_TICK = 4


def first_values(data: bytes, count: int, states: int = 1) -> list[int]:
    """Return the first 16-bit values in the bytes of states, which stand behind the ticks of all states."""
    values: list[int] = np.frombuffer(data, "<u2", count, offset=states * BYTES_PER_TICK).tolist()
    return values


def make_state(tick: int, values: Any, neighbours: Any = None, positions: Any = None) -> State:
    """Return a state of robots with these x, and 0 for all else; by default no robot receives another."""
    x = np.array(values, float)
    robots = len(x)
    all_values = np.stack([x, np.zeros(robots), np.zeros(robots), np.zeros(robots)])
    if neighbours is None:
        neighbours = np.zeros((robots, robots), np.bool_)
    return State(tick, all_values, np.array(neighbours), positions)


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
    floor = np.array([[1, 0, 0, 0, 0, 0, 0, 0, 1], [0, 1, 0, 0, 0, 0, 0, 0, 0]], np.bool_)
    encoded = encode_description(RunDescription("a run", [0], floor=floor))["floor"]
    assert (encoded["rows"], encoded["columns"]) == (2, 9)
    assert decompress(encoded["bits"]) == bytes([0b10000000, 0b10000000, 0b01000000, 0])


def test_states_are_counted_and_their_bytes_begin_with_their_numbers_of_steps() -> None:
    """Each number has four bytes, the lowest first: 300 = 44 + 1 * 256."""
    block = encode_states([make_state(5, [0]), make_state(300, [0])], RunDescription("a run", [0]))
    assert block["count"] == 2
    assert decompress(block["data"]).startswith(bytes([5, 0, 0, 0]) + bytes([44, 1, 0, 0]))


def test_each_robot_s_values_are_encoded_as_differences_to_the_state_before() -> None:
    """Differences compress better. Robot 0 has x = 0.5, 1, 1 and robot 1 has 0, 0, 0.25, where 1 is 65534."""
    states = [make_state(0, [0.5, 0]), make_state(1, [1, 0]), make_state(2, [1, 0.25])]
    data = data_of(states, robots=2)

    differences_of_robot_0 = [32767, 32767, 0]  # 0.5, another 0.5, nothing
    differences_of_robot_1 = [0, 0, 16384]  # nothing, nothing, 0.25
    assert first_values(data, count=6, states=3) == differences_of_robot_0 + differences_of_robot_1


@pytest.mark.parametrize(("x", "number"), [(0.5, 32767), (-0.1, 0), (1.1, 65534), (np.nan, 65535)])
def test_a_value_is_encoded_as_a_number_up_to_65534_and_an_unknown_one_as_65535(
    x: float, number: int
) -> None:
    """Values below 0 and above 1 are encoded as these limits. A state has NaN for what is unknown."""
    data = data_of([make_state(0, [x])], robots=1)
    assert first_values(data, count=1) == [number]


def test_a_position_is_encoded_as_shares_of_the_arena_s_width_and_height() -> None:
    """A robot is at the east end of an arena of 4 m x 2 m, half a metre south of the middle.

    So it has all of the width, which is encoded as 65534, and a quarter of the height.
    """
    state = make_state(0, [0], positions=np.array([[2.0, -0.5]]))
    data = data_of([state], robots=1, sides=(4.0, 2.0))

    _x, _x_hat, _b_hat, _true_accuracy, share_of_width, share_of_height = first_values(data, count=6)
    assert (share_of_width, share_of_height) == (65534, 16384)


def test_links_are_encoded_as_a_bit_for_each_pair_of_robots() -> None:
    """Robot 0 receives from 1, which is bit 1, and robot 2 from 0, bit 6.

    Nine bits of a state take two bytes.
    """
    neighbours = [[False, True, False], [False, False, False], [True, False, False]]
    data = data_of([make_state(tick, [0, 0, 0], neighbours) for tick in (0, 1)], robots=3)

    bytes_of_a_state = bytes([0b01000010, 0])
    assert data.endswith(bytes_of_a_state + bytes_of_a_state)


def test_links_between_more_than_128_robots_are_encoded_as_pairs_of_receiver_and_sender() -> None:
    """The last bytes are the numbers of links in the two states, and the ids of all receivers and senders."""
    two_links, one_link = [[0, 1], [128, 5]], [[7, 0]]  # each of a receiver and a sender
    states = [make_state(0, [0] * 129, two_links), make_state(1, [0] * 129, one_link)]
    data = data_of(states, robots=129)

    counts = np.array([2, 1], "<u4").tobytes()
    ids = np.array([0, 1, 128, 5, 7, 0], "<u2").tobytes()
    assert data.endswith(counts + ids)


# --- The page -----------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def exported_page() -> str:
    """The page of a history whose title tries to end the script that it is in."""
    return make_page(History(RunDescription("a </script> run", [0]), [make_state(0, [0.5])]))


def read_content(text: str) -> Any:
    """Return the JSON of a page."""
    (content,) = re.findall('<script id="history" type="application/json">(.*?)</script>', text)
    return json.loads(content)


def test_an_exported_page_holds_the_history_even_if_its_title_has_an_end_tag(exported_page: str) -> None:
    """The title contains "</script>", which would end the script element that holds the history."""
    content = read_content(exported_page)
    assert content["description"]["title"] == "a </script> run"
    assert content["block"]["count"] == 1


def test_a_served_page_holds_no_history() -> None:
    """It gets the states as events from the server."""
    assert read_content(make_page()) is None


def test_no_placeholder_of_the_template_is_left_in_an_exported_page(exported_page: str) -> None:
    """Scripts and styles replace placeholders, which are words such as __STYLE__."""
    assert re.findall("__[A-Z_]+__", exported_page) == []


def test_an_exported_page_contains_the_licence_of_its_chart_library(exported_page: str) -> None:
    assert "Permission is hereby granted" in exported_page


# --- In a notebook ------------------------------------------------------------------------------------

EXPERIMENT = Experiment(topology="dynamic", robots=4, steps=50, filter_period=20, trials=2, density=0.5)


def test_a_notebook_shows_a_trial_as_a_web_page_in_a_frame() -> None:
    """A notebook displays the HTML that the method ``_repr_html_`` of a cell's last value returns."""
    shown = show(EXPERIMENT, trial=1)
    displayed_html = shown._repr_html_()
    assert displayed_html.startswith("<iframe srcdoc=")
    assert html.escape(shown.page) in displayed_html


def test_the_web_page_that_a_notebook_shows_can_be_saved(tmp_path: Path) -> None:
    """The file has the text of the page in UTF-8."""
    shown = show(EXPERIMENT)
    shown.save(str(tmp_path / "run.html"))
    assert (tmp_path / "run.html").read_text(encoding="utf-8") == shown.page


def test_a_trial_in_results_is_shown_as_the_same_page_as_that_trial_of_the_experiment() -> None:
    """A trial of an experiment is simulated for the page, and so is one of results.

    The results have two experiments. ``where`` chooses one.
    """
    results = simulate([replace(EXPERIMENT, robots=5), EXPERIMENT])
    shown_results = show(results, trial=1, where={"robots": "4"})
    assert shown_results.page == show(EXPERIMENT, trial=1).page


def test_trial_1_is_not_shown_as_trial_0() -> None:
    """The two trials have other random numbers, so their web pages differ."""
    assert show(EXPERIMENT, trial=1).page != show(EXPERIMENT, trial=0).page


def test_a_notebook_cannot_show_a_trial_below_0() -> None:
    with pytest.raises(UsageError, match="trial is -1; give 0 or more"):
        show(EXPERIMENT, trial=-1)
