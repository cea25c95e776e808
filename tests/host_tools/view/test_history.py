"""A history: how states are added, read by several readers, and kept few."""

from __future__ import annotations

import numpy as np
import pytest

from mcp_asdf_tools.view import history as history_module
from mcp_asdf_tools.view.history import History, RunDescription, State, steps_between_states


def make_state(tick: int) -> State:
    """Return a state of two robots that receive each other."""
    return State(tick, np.full((4, 2), 0.5), np.array([(0, 1), (1, 0)], np.uint16), positions=None)


@pytest.fixture
def history() -> History:
    """The history of a run of two robots that goes on, after ticks 0, 1 and 2."""
    history = History(RunDescription("two robots", [0, 1]))
    for tick in range(3):
        history.add(make_state(tick))
    return history


@pytest.mark.parametrize(("states_of_reader", "expected_ticks"), [(2, [2]), (3, [])])
def test_a_reader_gets_the_states_that_it_does_not_have(
    states_of_reader: int, expected_ticks: list[int], history: History
) -> None:
    """There are states after 0, 1 and 2 steps. The reader already has the first 2, or all 3, of them.

    It also says of which generation its states are: the history's present one, 0.
    """
    update = history.states_since(generation=0, index=states_of_reader)
    assert [state.tick for state in update.states] == expected_ticks


def test_a_reader_whose_states_are_of_another_generation_gets_all_states(history: History) -> None:
    """The generation is a number that goes up when a robot joins or when states are thinned out.

    The history has the generation 0 and three states. The reader has three states of another generation.
    """
    update = history.states_since(generation=7, index=3)
    assert [state.tick for state in update.states] == [0, 1, 2]


def test_a_robot_that_joins_has_neither_values_nor_links_in_earlier_states(history: History) -> None:
    """Robot 7 joins the robots 0 and 1, which receive from each other.

    Its unknown values are NaN. All readers read all states again, as there is a new generation.
    """
    history.add_robot(7)
    *_, last_state = history.states_since().states
    values_by_robot = last_state.values.T
    _robot_0, _robot_1, values_of_robot_7 = values_by_robot

    assert history.generation == 1
    assert history.description.robots == [0, 1, 7]
    assert np.isnan(values_of_robot_7).all()
    assert last_state.links.tolist() == [[0, 1], [1, 0]]


def test_a_swarm_without_an_end_keeps_at_most_a_hundred_states(monkeypatch: pytest.MonkeyPatch) -> None:
    """The limit is set to 100 here. At 101 states, every second one is left out: a new generation of states.

    That happens four times in 1000 steps, so every 2**4th state, or every 16th, is left.
    """
    monkeypatch.setattr(history_module, "MAX_STATES", 100)
    history = History(RunDescription("endless", [0, 1]))
    numbers_of_states = []
    for tick in range(1000):
        history.add(make_state(tick))
        numbers_of_states.append(len(history.states_since().states))

    assert max(numbers_of_states) == 100
    assert history.generation == 4
    assert [state.tick for state in history.states_since().states] == list(range(0, 1000, 16))


@pytest.mark.parametrize(
    ("steps", "robots", "expected_spacing"),
    [
        (1, 128, 1),
        (10_000, 20, 1),
        (40_000, 20, 4),  # there are at most 10,000 states
        (20_000, 60, 19),  # links: 60 x 60 links x 1111 states = 4 million
        (10**6, 128, 4099),  # links: 128 x 128 links x 244 states = 4 million
        (10**9, 1, 100_000),
        (10_000, 2000, 80),  # 16 links x 2000 robots x 125 states = 4 million
    ],
)
def test_a_web_page_keeps_fewer_states_of_a_swarm_with_more_steps_and_robots(
    steps: int, robots: int, expected_spacing: int
) -> None:
    """The spacing is the number of steps from one kept state to the next.

    Of 10,000 steps of 20 robots each is kept, for example, and of 40,000 steps every fourth: there are at
    most 10,000 states, with about four million links between robots in them.
    """
    assert steps_between_states(steps, robots) == expected_spacing
