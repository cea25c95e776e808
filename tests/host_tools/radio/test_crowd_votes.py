"""Votes that bring a crowd of the robust filter to an exact place."""

from __future__ import annotations

from copy import copy

import pytest
from hypothesis import given
from hypothesis import strategies as st

from mcp_asdf.fixed_point import ONE
from mcp_asdf.mirror import Crowd, update_crowd
from mcp_asdf_tools.radio.crowd_votes import moves_to_trend, votes_to_centre


@given(
    centre=st.integers(1 << 28, 3 << 28),
    offset=st.integers(-(1 << 18), 1 << 18),
    votes=st.integers(512, 1 << 13),
)
def test_votes_move_the_centre_to_the_unit_that_is_asked_for(centre: int, offset: int, votes: int) -> None:
    crowd = Crowd(centre=centre, spread=1 << 26, votes=votes)
    values = votes_to_centre(crowd, centre + offset)
    assert values is not None
    for value in values:
        update_crowd(crowd, 0, value)
    assert crowd.centre == centre + offset


def test_a_centre_beyond_the_reach_of_a_round_has_no_votes() -> None:
    crowd = Crowd(centre=1 << 29, spread=1 << 18, votes=1 << 14)
    assert votes_to_centre(crowd, 3 << 28) is None


def test_votes_to_a_centre_leave_the_crowd_as_it_is() -> None:
    crowd = Crowd(centre=1 << 29, spread=1 << 26, votes=1 << 10)
    before = copy(crowd)
    votes_to_centre(crowd, (1 << 29) + 12345)
    assert crowd == before


@pytest.mark.parametrize("target", [1 << 13, (1 << 13) - 1, (7 << 13) - 1, 7 << 13])
def test_moves_bring_the_trend_to_each_of_its_limits(target: int) -> None:
    crowd = Crowd(centre=1 << 29, spread=1 << 20, votes=1 << 10, trend=1 << 15)
    moves = moves_to_trend(crowd.trend, target)
    assert moves is not None
    for move in moves:
        update_crowd(crowd, 0, {1: ONE, 0: crowd.centre >> 7, -1: 0}[move])
    assert crowd.trend == target


def test_a_trend_that_no_votes_give_has_no_moves() -> None:
    assert moves_to_trend(1 << 15, 1 << 16) is None
