"""A history: how states are added, read by several readers, and kept few."""

from __future__ import annotations

import numpy as np
import pytest

from mcp_asdf_tools.view import history as history_module
from mcp_asdf_tools.view.history import History, RunDescription, State, steps_between_states


def make_state(tick: int) -> State:
    """Return a state of two robots that receive each other."""
    return State(tick, np.full((4, 2), 0.5), np.ones((2, 2), np.bool_), positions=None)


@pytest.fixture
def history() -> History:
    """The history of a run of two robots that goes on, after ticks 0, 1 and 2."""
    history = History(RunDescription("two robots", [0, 1]))
    for tick in range(3):
        history.add(make_state(tick))
    return history


def test_a_reader_that_has_two_of_three_states_gets_the_third(history: History) -> None:
    """The states are those after 0, 1 and 2 steps."""
    update = history.states_since(generation=0, index=2)
    assert [state.tick for state in update.states] == [2]


def test_a_reader_that_has_all_three_states_gets_none(history: History) -> None:
    assert history.states_since(generation=0, index=3).states == []


def test_a_reader_of_another_generation_gets_all_three_states_again(history: History) -> None:
    """The generation is a number that goes up when a robot joins or when states are thinned out."""
    assert len(history.states_since(generation=7, index=3).states) == 3


def test_a_robot_that_joins_has_unknown_values_in_earlier_states(history: History) -> None:
    """Robot 7 joins the robots 0 and 1. Its unknown values are NaN."""
    history.add_robot(7)
    last_state = history.states_since().states[-1]
    _robot_0, _robot_1, robot_7 = last_state.values.T

    assert history.description.robots == [0, 1, 7]
    assert np.isnan(robot_7).all()


def test_a_robot_that_joins_has_no_links_in_earlier_states(history: History) -> None:
    """Robots 0 and 1 receive from each other (and are marked as receiving from themselves)."""
    history.add_robot(7)
    last_state = history.states_since().states[-1]

    assert last_state.neighbours.tolist() == [
        [True, True, False],
        [True, True, False],
        [False, False, False],
    ]


def test_a_robot_that_joins_begins_a_new_generation_of_states(history: History) -> None:
    """The generation begins at 0. A reader that has another one reads all states again."""
    history.add_robot(7)
    assert history.states_since(generation=0, index=3).generation == 1


def test_a_swarm_without_an_end_keeps_at_most_a_hundred_states(monkeypatch: pytest.MonkeyPatch) -> None:
    """The limit is set to 100 here. At 101 states, every second one is left out."""
    monkeypatch.setattr(history_module, "MAX_STATES", 100)
    history = History(RunDescription("endless", [0, 1]))
    counts = []
    for tick in range(1000):
        history.add(make_state(tick))
        counts.append(len(history.states_since().states))

    assert max(counts) == 100


def test_states_that_are_thinned_out_four_times_are_those_of_every_16th_step(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """At most 100 of 1000 states are kept, so every second one is left out four times: 2**4 is 16."""
    monkeypatch.setattr(history_module, "MAX_STATES", 100)
    history = History(RunDescription("endless", [0, 1]))
    for tick in range(1000):
        history.add(make_state(tick))

    assert history.generation == 4
    assert [state.tick for state in history.states_since().states] == list(range(0, 1000, 16))


@pytest.mark.parametrize(
    ("steps", "robots", "spacing"),
    [
        (1, 128, 1),
        (10_000, 20, 1),
        (40_000, 20, 4),
        (20_000, 60, 19),
        (10**6, 128, 4099),
        (10**9, 1, 100_000),
        (10_000, 2000, 80),
    ],
)
def test_a_web_page_keeps_fewer_states_of_a_swarm_with_more_steps_and_robots(
    steps: int, robots: int, spacing: int
) -> None:
    """``spacing`` is the number of steps from one kept state to the next.

    Of 10,000 steps of 20 robots each is kept, for example, and of 40,000 steps every fourth.
    """
    assert steps_between_states(steps, robots) == spacing
