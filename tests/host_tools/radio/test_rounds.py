"""Rounds crafted for the filter, against exact arithmetic of our own."""

from __future__ import annotations

import random
from fractions import Fraction

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from mcp_asdf.fixed_point import HALF, ONE, alpha_units
from mcp_asdf_tools.radio.rounds import (
    CRAFTED_SIZES,
    Content,
    Situation,
    Update,
    at_threshold,
    for_update,
    update_of,
)
from mcp_asdf_tools.tables.thresholds import generate, parse_omega

OMEGAS = ("0.05", "0.000000001", "0.5", "0.9")


def is_rejected(contents: list[Content], x_hat: int, k: Fraction) -> bool:
    """Eq. 12 as the paper has it, squared: (mean - x_hat)^2 > k times the variance over m."""
    m, total = len(contents), sum(x for x, _ in contents)
    return m * (total - m * x_hat) ** 2 > k * sum((m * x - total) ** 2 for x, _ in contents)


def situations(omega: str) -> st.SearchStrategy[Situation]:
    """Robots with any own estimate."""
    table = generate(parse_omega(omega), 127)
    return st.builds(Situation, st.just(500), st.just(300), st.integers(0, ONE), st.just(table))


@pytest.mark.parametrize("omega", OMEGAS)
@given(data=st.data(), m=st.sampled_from(CRAFTED_SIZES), seed=st.integers(0, 2**32))
@settings(max_examples=15, deadline=None)
def test_two_rounds_lie_on_either_side_of_the_threshold(
    omega: str, data: st.DataObject, m: int, seed: int
) -> None:
    """Exactly, and so close that a threshold that is wrong by a ten-thousandth is seen."""
    situation = data.draw(situations(omega))
    inside, outside = at_threshold(situation, m, Update.ABOVE, random.Random(seed))
    assert situation.table is not None
    assert len(inside) == len(outside) == m
    assert all(0 <= x <= ONE for x, _ in inside + outside)
    k = Fraction(situation.table.entry(m), 1 << 26)
    assert not is_rejected(inside, situation.x_hat, k)
    assert is_rejected(outside, situation.x_hat, k)
    assert is_rejected(inside, situation.x_hat, k * Fraction(9999, 10000))
    assert not is_rejected(outside, situation.x_hat, k * Fraction(10001, 10000))


def test_near_one_half_a_robot_knows_nothing() -> None:
    """And a bit away from it hardly anything."""
    half, near, faint = 1 << 31, 1 << 19, 1 << 27
    steps = [-faint, 1 - faint, -near, 1 - near, 0, near - 1, near, faint - 1, faint]
    found = [update_of(half + each) for each in steps]
    hardly = [Update.FAINT] * 2
    assert found == [Update.BELOW, *hardly, *[Update.HALF] * 3, *hardly, Update.ABOVE]


def test_a_round_that_the_test_does_not_reject_changes_nothing() -> None:
    table, alpha = generate(parse_omega("0.05"), 127), 0x8000_0001
    own = ONE // 4
    for tested, expected in ((table, None), (None, Update.BELOW)):
        situation = Situation(100, 60, own, tested)
        assert situation.update([(own + 1, alpha), (own - 1, alpha), (own + 1, alpha)]) is expected
        assert situation.update([(own + 1, alpha)]) is expected


def test_the_first_rounds_serve_where_the_wanted_update_is_not_to_be_had() -> None:
    situation = Situation(500, 300, ONE // 3, generate(parse_omega("0.05"), 127))
    for seed in range(5):
        found = at_threshold(situation, 3, Update.HALF, random.Random(seed))
        update = situation.update(found[1])
        assert update is not None
        assert at_threshold(situation, 3, update, random.Random(seed)) == found, seed


@given(
    share=st.floats(0.55, 0.63),
    x_hat=st.integers(0, ONE).filter(lambda x: abs(x - HALF) > ONE // 8),
    wanted=st.sampled_from(sorted({*Update} - {Update.HALF, Update.FAINT}, key=str)),
    seed=st.integers(0, 2**32),
)
@settings(deadline=None)
def test_every_kind_of_re_estimate_can_be_had(share: float, x_hat: int, wanted: Update, seed: int) -> None:
    t = 997
    n = round(share * t)
    situation = Situation(t, n, x_hat, generate(parse_omega("0.05"), 127))
    contents = for_update(situation, wanted, random.Random(seed))
    assert contents is not None
    x_bar = sum(alpha_units(a) * x for x, a in contents) / sum(alpha_units(a) for _, a in contents) / ONE
    if wanted is Update.KEPT:
        assert x_bar == 0.5
        return
    b_hat = (n / t + x_bar - 1) / (2 * x_bar - 1)
    kinds = {
        Update.ABOVE: 0.5 < b_hat < 1,
        Update.BELOW: 0 < b_hat < 0.5,
        Update.MAXIMUM: b_hat >= 1,
        Update.MINIMUM: b_hat <= 0,
    }
    assert kinds[wanted]
