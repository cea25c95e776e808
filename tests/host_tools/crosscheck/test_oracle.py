"""The oracle of the cross-check is right: exact values, their limits, and what is collected of errors."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator
from dataclasses import replace
from fractions import Fraction

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from mcp_asdf.fixed_point import ONE, word_to_alpha
from mcp_asdf.mirror import MirrorRobot
from mcp_asdf.robot import Filter
from mcp_asdf_tools.crosscheck import oracle
from mcp_asdf_tools.crosscheck.compare import Look, Subject
from mcp_asdf_tools.crosscheck.exact import (
    HALF,
    UNINFORMATIVE,
    alpha_error,
    alpha_limits,
    b_hat_error,
    exact_b_hat,
    exact_estimate,
    is_informative,
    updates,
    x_hat_limits,
)
from mcp_asdf_tools.crosscheck.oracle import Audit, Errors
from mcp_asdf_tools.crosscheck.random_scenarios import robust_scenario
from mcp_asdf_tools.crosscheck.scenario import Call, Setup, parse_scenario
from support import draws

b_hats = st.fractions(Fraction(1, 2**20), 1 - Fraction(1, 2**20), max_denominator=2**32).filter(
    is_informative
)
counts = st.integers(1, 2**31).flatmap(lambda t: st.tuples(st.integers(0, t), st.just(t)))
draw = settings(deadline=None, database=None, derandomize=True, max_examples=draws(200))


@pytest.mark.random
@draw
@given(counts, b_hats)
def test_exact_estimates_are_those_of_the_paper(count: tuple[int, int], b: Fraction) -> None:
    """alpha is eq. 4 as printed; no x beside x_hat makes n black among t more likely, as P(black) is
    b x + (1 - b)(1 - x); and b_hat of x_hat, where that is inside the scale, is b."""
    (n, t), d = count, 2 * b - 1
    x_hat, alpha = exact_estimate(n, t, b)
    chance = b * x_hat + (1 - b) * (1 - x_hat)
    slope = (n - t * chance) * d  # of the log-likelihood, up to a positive factor
    if x_hat == 0:
        assert slope <= 0
        printed = d**2 * (t * b**2 - d * (t - n)) / (b**2 * (b - 1) ** 2)
    elif x_hat == 1:
        assert slope >= 0
        printed = d**2 * (t * b**2 - d * n) / (b**2 * (b - 1) ** 2)
    else:
        assert slope == 0 and (x_hat == HALF or exact_b_hat(n, t, x_hat) == b)
        printed = d**2 * Fraction(t**3, n * (t - n))
    assert alpha == min(printed, Fraction(2**31 - 2**7))


def test_exact_values_at_the_edges() -> None:
    assert exact_estimate(3, 7, HALF) == (HALF, Fraction(0))
    assert x_hat_limits(3, 7, HALF) == (HALF, HALF)
    assert exact_estimate(3, 7, HALF + UNINFORMATIVE / 2)[1] > 0
    assert exact_b_hat(0, 7, Fraction(1)) == 1 - exact_b_hat(7, 7, Fraction(1)) == Fraction(1, 2**20)


@pytest.mark.parametrize(
    ("n", "b", "alpha", "x_hat"),
    [
        (0, Fraction(19, 20), (66, 2), (0, 0)),
        (300_000, Fraction(19, 20), (3.125, 6.444), (2330168, 2330168)),
        (500_100, Fraction(1025, 2048), (3.125, 4098.002), (5053297, 5053298)),
        (499_900, Fraction(1025, 2048), (3.125, 4098.002), (3335310, 3335311)),
    ],
)
def test_limits_of_estimates(n: int, b: Fraction, alpha: tuple[float, float], x_hat: tuple[int, int]) -> None:
    """docs/design.md, section 11; in units of 2**-28 below, 2**-31 above, and 2**-23."""
    (below, above), (_, exact) = alpha_error(n, 10**6, b), exact_estimate(n, 10**6, b)
    assert (below * 2**28, above * 2**31) == pytest.approx(alpha, abs=1e-3)
    assert x_hat_limits(n, 10**6, b) == tuple(Fraction(each, 2**23) for each in x_hat)
    least = exact * (1 - below) * (1 - Fraction(1, 2**23)) - Fraction(1, 2**24)
    assert alpha_limits(n, 10**6, b) == (least, exact * (1 + above))


# design: R26
@pytest.mark.parametrize(
    ("x_bar", "units"), [(Fraction(11, 20), 59), (Fraction(9, 20), 45), (Fraction(0), 9), (Fraction(1), 14)]
)
def test_limits_of_b_hat(x_bar: Fraction, units: int) -> None:
    """What eq. 8 makes of 4 x_bar + 3, or 4 x_bar + 2 below 1/2, and 7 for itself; in units of 2**-32."""
    assert round(b_hat_error(x_bar) * 2**32) == units


# design: R25
@pytest.mark.parametrize("side", [1, -1])
@pytest.mark.parametrize(("errors", "answer"), [(-1.7, False), (2.01, True)])
def test_a_re_estimate_is_judged_but_next_to_the_limit(side: int, errors: float, answer: bool) -> None:
    """An x_bar of 1/2 and a little more is known to 1.25 units of 2**-30, which it may be too small."""
    distance = UNINFORMATIVE + Fraction(errors) * Fraction(5, 4) / 2**30
    assert updates(HALF + side * distance / 2) is answer
    assert updates(HALF + UNINFORMATIVE / 2 + Fraction(1, 2**31)) is None


# --- Judging ---------------------------------------------------------------------------------------------


def judged(text: str, audit: Audit) -> Iterator[tuple[Setup, Call, Look, Look]]:
    """Each call of a scenario, with the looks before and after it, in which nothing is wrong."""
    scenario = parse_scenario(text)
    subject = Subject(MirrorRobot, scenario.setup)
    for call in scenario.calls:
        before = subject.last
        after = subject.apply(call)
        assert audit.judge(scenario.setup, call, before, after) == []
        yield scenario.setup, call, before, after


def changed(look: Look, name: str, value: int) -> Look:
    """The look with another value of a word."""
    return replace(look, state=look.state | {name: value})


# design: R21
@pytest.mark.parametrize(
    ("name", "excess", "told"),
    [
        *(("x_hat", 2, "x_hat is"), ("x_hat", -2, "x_hat is"), ("alpha", 16 << 8, "alpha is")),
        *(("b_hat()", 50, "b_hat is"), ("b_hat()", -50, "b_hat is")),
        *(("x()", 1, "x() is"), ("x_bar()", -1, "x_bar() is")),
        *(("holds_invariants()", -1, "the invariants do not hold"), ("open_x", 1, "")),
    ],
)
def test_a_value_beyond_its_limit_is_told(name: str, excess: int, told: str) -> None:
    """In a state that is right otherwise, after a call that updates b_hat."""
    audit = Audit()
    text = "robot:1:1:64:0:3221225472,step:1,step:0,receive:1:3000000:2147483649,step:0"
    *_, (setup, call, before, after) = judged(text, audit)
    assert after.outcome == "UPDATED"
    problems = audit.judge(setup, call, before, changed(after, name, after.state[name] + excess))
    assert any(problem.startswith(told) for problem in problems) if told else problems == []


@pytest.mark.parametrize(
    ("mode", "heard", "told"),
    [
        *((Filter.OFF, 2, ""), (Filter.ALWAYS, 1, "not "), (Filter.ALWAYS, 0, "")),
        *((Filter.ADAPTIVE, 1, ""), (Filter.ADAPTIVE, 2, "not ")),
    ],
)
def test_a_re_estimate_without_cause_or_a_missing_one_is_told(mode: Filter, heard: int, told: str) -> None:
    audit, outcome = Audit(), "OK" if told else "UPDATED"
    messages = "".join(f"receive:{each}:{3_000_000 + each}:2147483649," for each in range(1, heard + 1))
    text = f"table:0.05:2,robot:{mode:d}:1:64:0:3221225472,{messages}step:1"
    *_, (setup, call, before, after) = judged(text, audit)
    assert after.outcome != outcome
    problems = audit.judge(setup, call, before, replace(after, outcome=outcome))
    assert problems == [f"b_hat is {told}re-estimated, wrongly"]
    assert audit.tests == 2 * (mode == Filter.ADAPTIVE and heard == 2)
    not_due = changed(before, "filter_left", 2)
    problems = audit.judge(setup, call, not_due, replace(after, outcome="UPDATED"))
    assert problems == ["b_hat is re-estimated, wrongly"]
    assert audit.judge(setup, call, before, replace(after, outcome="ERR_OBSERVATION")) == []


IDLE = {"crowd_votes": 1, "b_hat()": 1 << 29, "tests": 1}
DECIDED = {"crowd_votes": 1, "b_hat()": 1 << 29}
WHATEVER = {
    **{"voted": {"crowd_centre": 2, "crowd_spread": 2, "x()": 1}, "rejected": {"crowd_votes": 1}},
    **{"moving": IDLE, "too few": IDLE, "returned": DECIDED, "kept": DECIDED},
    "receive": {"crowd_centre": 1, "crowd_spread": 1, "crowd_voices": 1, "beta()": 1},
}
"""What the robust filter must not change by more, nor by less, in what it does; a message may be no vote."""


# design: R35, R37, R38
def test_whatever_the_robust_filter_does_wrongly_is_told() -> None:
    """In either sense, and also that b_hat is re-estimated or is not."""
    audit, reached = Audit(), Counter[str]()
    for number in range(35):
        for setup, call, before, after in judged(str(robust_scenario(1, number)), audit):
            way = next(iter(audit.robust), call.name)
            audit.robust.clear()
            wrong = [
                changed(after, name, after.state[name] + sign * excess)
                for name, excess in WHATEVER.get(way, {}).items()
                for sign in (1, -1)
            ]
            if "b_hat()" in WHATEVER.get(way, {}):
                wrong.append(replace(after, outcome="UPDATED" if after.outcome == "OK" else "OK"))
            assert all(Audit().judge(setup, call, before, each) for each in wrong), f"{way}: {call}"
            reached[way] += 1
    assert min(reached[way] for way in WHATEVER) > 5, reached


def test_what_the_robust_filter_does_is_judged_from_the_first_vote_and_tile() -> None:
    """One vote; a filter that is not due; one without a tile; and a test that rounding decides."""
    audit = Audit()
    list(judged("robot:3:2:64:0:3221225472,step:1,observe:1,receive:1:99:2147483649,observe:1,settle", audit))
    assert audit.robust == {"voted": 1, "too few": 1}
    blind = ",".join(f"receive:{sender}:99:2147483649" for sender in (1, 2, 3))
    list(judged(f"robot:3:2:64:0:3221225472,{blind},settle,settle,observe:1,settle", audit))
    assert audit.robust == {"voted": 4, "too few": 1}
    count = "restore:1:2124665746:2:2147483643:3:1085233319:7:3:8:262144:9:7:10:2124665746:11:2147500032"
    list(judged(f"robot:3:1:2147483648:0:3221225472,{count}:29:65536,settle", audit))
    assert audit.robust == {"voted": 4, "too few": 1, "undecided": 1} and audit.tests == 1


def test_errors_keep_the_largest() -> None:
    errors = Errors()
    for exact, reference in ((Fraction(-3, 4), 0.25), (Fraction(1, 4), -0.5)):
        errors.add(exact, reference)
    assert errors == Errors(samples=2, exact=0.75, float64=0.5)


def test_regions_cover_the_whole_range() -> None:
    names = [name for _, name in oracle.REGIONS]
    for value, expected in [(0, 0), (2**-12, 1), (-0.02, 2), (0.2, 3), (0.9, 4), (0.999, 5), (1, 5)]:
        assert oracle.region_of(Fraction(value)) == names[expected]


@pytest.mark.parametrize(
    ("b_hat", "x_bar", "own", "updated"),
    [
        (4252017623, 7549747, "0.9 to 0.999", "0.2 to 0.9"),  # 0.99 and 0.9
        (4252017623, 4236247, "0.9 to 0.999", "2^-12 to 0.02"),  # 0.99 and 0.505
        (2362232013, 7549747, "0.02 to 0.2", "0.2 to 0.9"),  # 0.55 and 0.9; alpha is below 1/2
    ],
)
def test_errors_are_collected_where_they_belong(b_hat: int, x_bar: int, own: str, updated: str) -> None:
    """A robot hears something at its third tile, the first that is white, and re-estimates its accuracy."""
    audit = Audit()
    text = f"robot:1:1:64:0:{b_hat},step:1,step:1,receive:1:{x_bar}:2147483649,step:0"
    for *_, after in judged(text, audit):
        last, state = audit.as_dict()["errors"], after.state
        audit.errors = Audit().errors
    x_hat, alpha = exact_estimate(2, 3, Fraction(b_hat, 2**32))
    errors = {
        ("x_hat", own): Fraction(state["x_hat"], ONE) - x_hat,
        ("alpha", own): Fraction(word_to_alpha(state["alpha"])) / alpha - 1,
        ("b_hat", updated): Fraction(state["b_hat()"], 2**32) - exact_b_hat(2, 3, Fraction(x_bar, ONE)),
    }
    if alpha < HALF:
        del errors["alpha", own]
    assert [(row["quantity"], row["region"], row["samples"]) for row in last] == [(*key, 1) for key in errors]
    for row, error in zip(last, errors.values(), strict=True):
        assert row["exact"] == abs(float(error)) and abs(row["float64"] - row["exact"]) < 2**-24
