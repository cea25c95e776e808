"""The page of a history as its scripts read it, and in a notebook."""

from __future__ import annotations

import base64
import html
import json
import re
import zlib
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


def decode_data(block: dict[str, Any]) -> bytes:
    return decompress(block["data"])


def make_state(tick: int, values: Any, neighbours: Any = None, positions: Any = None) -> State:
    """Return a state of robots with these x, and 0 for all else; by default no robot receives another."""
    x = np.array(values, float)
    robots = len(x)
    all_values = np.stack([x, np.zeros(robots), np.zeros(robots), np.zeros(robots)])
    if neighbours is None:
        neighbours = np.zeros((robots, robots), np.bool_)
    return State(tick, all_values, np.array(neighbours), positions)


# --- Descriptions and states as JSON ------------------------------------------------------------------


def test_a_description_has_the_names_of_its_attributes() -> None:
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


def test_each_row_of_the_floor_begins_at_a_byte() -> None:
    floor = np.array([[1, 0, 0, 0, 0, 0, 0, 0, 1], [0, 1, 0, 0, 0, 0, 0, 0, 0]], np.bool_)
    encoded = encode_description(RunDescription("a run", [0], floor=floor))["floor"]
    assert (encoded["rows"], encoded["columns"]) == (2, 9)
    assert decompress(encoded["bits"]) == bytes([0b10000000, 0b10000000, 0b01000000, 0])


def test_the_data_of_states_begin_with_their_ticks() -> None:
    block = encode_states([make_state(5, [0]), make_state(300, [0])], RunDescription("a run", [0]))
    assert block["count"] == 2
    two_ticks = decode_data(block)[: 2 * 4]  # four bytes each, the lowest first
    assert two_ticks == bytes([5, 0, 0, 0]) + bytes([300 - 256, 1, 0, 0])


def test_values_are_differences_along_each_robots_series() -> None:
    """They compress better. Robot 0 has x = 0.5, 1, 1 and robot 1 has 0, 0, 0.25, where 1 is 65534."""
    states = [make_state(0, [0.5, 0]), make_state(1, [1, 0]), make_state(2, [1, 0.25])]
    data = decode_data(encode_states(states, RunDescription("a run", [0, 1])))

    bytes_of_ticks = 3 * 4
    series_of_x = np.frombuffer(data, "<u2", count=3 * 2, offset=bytes_of_ticks)
    assert series_of_x.tolist() == [32767, 32767, 0, 0, 0, 16384]


def test_a_value_that_is_unknown_is_65535() -> None:
    data = decode_data(encode_states([make_state(0, [np.nan])], RunDescription("a run", [0])))
    assert np.frombuffer(data, "<u2", count=1, offset=4).tolist() == [65535]


def test_values_are_limited_to_0_and_1() -> None:
    data = decode_data(encode_states([make_state(0, [-0.1, 1.1])], RunDescription("a run", [0, 1])))
    assert np.frombuffer(data, "<u2", count=2, offset=4).tolist() == [0, 65534]


def test_positions_are_shares_of_the_sides_after_the_quantities() -> None:
    """A robot at the east end of an arena of 4 m x 2 m, half a metre south of the middle."""
    state = make_state(0, [0], positions=np.array([[2.0, -0.5]]))
    description = RunDescription("a run", [0], sides=(4.0, 2.0))
    data = decode_data(encode_states([state], description))
    assert np.frombuffer(data, "<u2", count=2, offset=4 + 4 * 2).tolist() == [65534, 16384]


def test_links_are_a_bit_for_each_pair_of_robots() -> None:
    """Robot 0 receives from 1, and 2 from 0: bits 1 and 6, and each state begins at a byte."""
    neighbours = [[False, True, False], [False, False, False], [True, False, False]]
    states = [make_state(tick, [0, 0, 0], neighbours) for tick in (0, 1)]
    data = decode_data(encode_states(states, RunDescription("a run", [0, 1, 2])))
    assert data[-4:] == bytes([0b01000010, 0, 0b01000010, 0])


def test_links_of_more_than_128_robots_are_pairs() -> None:
    """A state with two links, receiver and sender of each, and one with a single link."""
    robots = list(range(129))
    states = [make_state(0, [0] * 129, [[0, 1], [128, 5]]), make_state(1, [0] * 129, [[7, 0]])]
    data = decode_data(encode_states(states, RunDescription("a run", robots)))

    # At the end stand the number of links of each state, of 4 bytes, and then all ids, of 2 bytes each.
    bytes_of_ids = 2 * 6
    bytes_of_counts = 4 * 2
    counts = np.frombuffer(data[-bytes_of_counts - bytes_of_ids : -bytes_of_ids], "<u4")
    ids = np.frombuffer(data[-bytes_of_ids:], "<u2")
    assert counts.tolist() == [2, 1]
    assert ids.tolist() == [0, 1, 128, 5, 7, 0]


# --- The page -----------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def exported_page() -> str:
    """The page of a history whose title tries to end the script that it is in."""
    return make_page(History(RunDescription("a </script> run", [0]), [make_state(0, [0.5])]))


def read_content(text: str) -> Any:
    """Return the JSON of a page."""
    (content,) = re.findall('<script id="history" type="application/json">(.*?)</script>', text)
    return json.loads(content)


def test_an_exported_page_holds_the_history(exported_page: str) -> None:
    content = read_content(exported_page)
    assert content["description"]["title"] == "a </script> run"
    assert content["block"]["count"] == 1


def test_a_page_that_is_served_holds_no_history() -> None:
    assert read_content(make_page()) is None


def test_a_page_has_no_placeholder_left(exported_page: str) -> None:
    assert re.findall("__[A-Z_]+__", exported_page) == []


def test_a_page_has_the_licence_of_the_library_in_it(exported_page: str) -> None:
    assert "Permission is hereby granted" in exported_page


# --- In a notebook ------------------------------------------------------------------------------------

MOVING = Experiment(topology="dynamic", robots=4, steps=50, filter_period=20, trials=2, density=0.5)


def test_a_notebook_shows_the_page_in_a_frame() -> None:
    shown = show(MOVING, trial=1)
    assert shown._repr_html_().startswith("<iframe srcdoc=")
    assert html.escape(shown.page) in shown._repr_html_()


def test_a_page_of_a_notebook_can_be_saved(tmp_path: Path) -> None:
    shown = show(MOVING)
    shown.save(str(tmp_path / "run.html"))
    assert (tmp_path / "run.html").read_text(encoding="utf-8") == shown.page


def test_results_and_experiment_have_the_same_page() -> None:
    assert show(simulate(MOVING), trial=1, where={"robots": "4"}).page == show(MOVING, trial=1).page


def test_each_trial_has_a_page_of_its_own() -> None:
    assert show(MOVING, trial=1).page != show(MOVING).page


def test_a_trial_below_0_is_refused() -> None:
    with pytest.raises(UsageError, match="trial is -1; give 0 or more"):
        show(MOVING, trial=-1)
