"""A history: how states are added, read by several readers, and kept few."""

from __future__ import annotations

import numpy as np
import pytest

from mcp_asdf_tools.view import history as history_module
from mcp_asdf_tools.view.history import History, RunDescription, State, steps_between_states


def make_state(tick: int) -> State:
    """Return a state of two robots that receive each other."""
    return State(tick, np.full((4, 2), 0.5), np.ones((2, 2), np.bool_), None)


@pytest.fixture
def history() -> History:
    """The history of a run of two robots that goes on, after ticks 0, 1 and 2."""
    history = History(RunDescription("two robots", [0, 1]))
    for tick in range(3):
        history.add(make_state(tick))
    return history


def test_a_reader_gets_the_states_that_it_does_not_have(history: History) -> None:
    update = history.states_since(generation=0, index=2)
    assert [state.tick for state in update.states] == [2]


def test_a_reader_of_all_states_gets_none(history: History) -> None:
    assert history.states_since(generation=0, index=3).states == []


def test_a_reader_that_missed_the_joining_of_a_robot_gets_all_states(history: History) -> None:
    """It names another generation, a number that goes up when a robot joins or states are thinned out."""
    assert len(history.states_since(generation=7, index=3).states) == 3


def test_a_robot_that_joins_has_no_values_and_no_links_before(history: History) -> None:
    history.add_robot(7)
    last_state = history.states_since().states[-1]

    assert history.description.robots == [0, 1, 7]
    assert np.isnan(last_state.values[:, 2]).all()
    assert last_state.neighbours.tolist() == [[True, True, False], [True, True, False], [False] * 3]


def test_a_robot_that_joins_begins_a_new_generation_of_states(history: History) -> None:
    history.add_robot(7)
    assert history.states_since(generation=0, index=3).generation == 1


def test_a_run_without_an_end_keeps_at_most_a_hundred_states(monkeypatch: pytest.MonkeyPatch) -> None:
    """Every second one is left out whenever there are more; the real limit is larger."""
    monkeypatch.setattr(history_module, "MAX_STATES", 100)
    history = History(RunDescription("endless", [0, 1]))
    largest_count = 0
    for tick in range(1000):
        history.add(make_state(tick))
        largest_count = max(largest_count, len(history.states_since().states))

    assert largest_count == 100
    assert [state.tick for state in history.states_since().states] == list(range(0, 1000, 16))
    assert history.generation == 4, "its states were thinned out four times"


@pytest.mark.parametrize(
    ("steps", "robots", "spacing"),
    [
        (10_000, 20, 1),
        (40_000, 20, 4),
        (20_000, 60, 19),
        (1, 128, 1),
        (10**6, 128, 4099),
        (10**9, 1, 100_000),
        (10_000, 2000, 80),
    ],
)
def test_the_spacing_of_states_keeps_a_page_small(steps: int, robots: int, spacing: int) -> None:
    """``spacing`` is the number of steps from one state that a page keeps to the next.

    It is 1 where all states together are small enough, and grows with the steps and robots of a run.
    """
    assert steps_between_states(steps, robots) == spacing
