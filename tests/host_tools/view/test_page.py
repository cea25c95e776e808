"""The web page of a history: what is in it, and how a notebook shows it."""

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
from mcp_asdf_tools.view.history import NO_LINKS, History, RunDescription, State
from mcp_asdf_tools.view.notebook_page import show
from mcp_asdf_tools.view.page import encode_description, make_page


def decompress(text: str) -> bytes:
    return zlib.decompress(base64.b64decode(text))


# --- Descriptions as JSON -----------------------------------------------------------------------------


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
        "filter_term": None,
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


# --- The page -----------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def exported_page() -> str:
    """The page of a history whose title tries to end the script that it is in."""
    state = State(0, np.full((4, 1), 0.5), NO_LINKS, positions=None)
    return make_page(History(RunDescription("a </script> run", [0]), [state]))


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
