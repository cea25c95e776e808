"""The oracles of the cross-check are right: exact values, their limits, and what is collected of errors."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import replace
from fractions import Fraction

import pytest
from hypothesis import assume, example, given, settings
from hypothesis import strategies as st

import exact
from mcp_asdf.fixed_point import ONE, word_to_alpha
from mcp_asdf.mirror import MirrorRobot
from mcp_asdf.robot import Filter
from mcp_asdf.table import FRACTION_BITS
from mcp_asdf_tools.crosscheck import oracle
from mcp_asdf_tools.crosscheck.compare import Look, Subject, Watcher
from mcp_asdf_tools.crosscheck.exact import (
    THRESHOLD_SCALE,
    UNINFORMATIVE,
    alpha_limit,
    b_hat_limit,
    exact_b_hat,
    exact_estimate,
    threshold_limit,
    true_threshold,
    updates,
    x_hat_limit,
)
from mcp_asdf_tools.crosscheck.oracle import QUANTITIES, REGIONS, Audit, Decisions, Errors
from mcp_asdf_tools.crosscheck.random_scenarios import random_scenario
from mcp_asdf_tools.crosscheck.scenario import Call, TableChoice, build_table, parse_scenario
from support import draws

b_hats = st.fractions(Fraction(1, 2**20), 1 - Fraction(1, 2**20), max_denominator=2**32)
counts = st.integers(1, 2**31).flatmap(lambda t: st.tuples(st.integers(0, t), st.just(t)))
draw = settings(deadline=None, database=None, derandomize=True, max_examples=draws(200))


@pytest.mark.random
@draw
@given(counts, b_hats)
def test_exact_alpha_is_the_papers_formula(count: tuple[int, int], b: Fraction) -> None:
    """Eq. 4 as printed, with its differences in the first two cases."""
    (n, t), d = count, 2 * b - 1
    assume(abs(d) >= Fraction(1, 2**12))
    x_hat, alpha = exact_estimate(n, t, b)
    if x_hat == 0:
        printed = d**2 * (t * b**2 - d * (t - n)) / (b**2 * (b - 1) ** 2)
    elif x_hat == 1:
        printed = d**2 * (t * b**2 - d * n) / (b**2 * (b - 1) ** 2)
    else:
        printed = d**2 * Fraction(t**3, n * (t - n))
    assert alpha == min(printed, Fraction(2**31 - 2**7))


@pytest.mark.random
@draw
@given(counts, b_hats)
def test_exact_estimates_maximise_the_likelihood(count: tuple[int, int], b: Fraction) -> None:
    """No x beside x_hat makes n black among t more likely; P(black) = b x + (1 - b)(1 - x)."""
    n, t = count
    assume(abs(2 * b - 1) >= Fraction(1, 2**12))
    x_hat, _ = exact_estimate(n, t, b)
    chance = b * x_hat + (1 - b) * (1 - x_hat)
    slope = (n - t * chance) * (2 * b - 1)  # of the log-likelihood, up to a positive factor
    assert slope == 0 if 0 < x_hat < 1 else slope <= 0 if x_hat == 0 else slope >= 0


@pytest.mark.random
@draw
@given(counts, b_hats)
def test_exact_re_estimate_inverts_the_estimate(count: tuple[int, int], b: Fraction) -> None:
    n, t = count
    assume(abs(2 * b - 1) >= Fraction(1, 2**12))
    x_hat, _ = exact_estimate(n, t, b)
    assume(0 < x_hat < 1 and x_hat != Fraction(1, 2))
    assert exact_b_hat(n, t, x_hat) == b


def test_exact_values_where_nothing_is_known() -> None:
    assert exact_estimate(3, 7, Fraction(1, 2)) == (Fraction(1, 2), Fraction(0))
    assert exact_estimate(3, 7, Fraction(1, 2) + Fraction(1, 2**13))[1] > 0


def followed(text: str, audit: Audit) -> Iterator[tuple[Call, Look, Look, Watcher]]:
    """Each call of a scenario, the looks before and after it, and the watcher that judges it."""
    scenario = parse_scenario(text)
    subject, follow = Subject(MirrorRobot, scenario.setup), audit.follow(scenario.setup)
    for call in scenario.calls:
        before = subject.last
        yield call, before, subject.apply(call), follow


def changed(look: Look, name: str, value: int) -> Look:
    """The look with another value of a word."""
    return replace(look, state=look.state | {name: value})


@pytest.mark.parametrize(
    ("name", "excess"), [("x_hat", 2), ("x_hat", -2), ("alpha", 16 << 8), ("b_hat()", 50), ("b_hat()", -50)]
)
def test_a_value_beyond_its_limit_is_told(name: str, excess: int) -> None:
    """Some units more than the right value, in a state that is right otherwise."""
    updates = 0
    text = "robot:1:1:64:0:3221225472,receive:1:3000000:2147483649,step:1,step:0,step:0"
    for call, before, after, follow in followed(text, Audit()):
        problems = follow(call, before, changed(after, name, after.state[name] + excess))
        told = any(problem.startswith(f"{name.strip('()')} is off") for problem in problems)
        updates += after.outcome == "UPDATED"
        assert told == (call.name == "step" and (name != "b_hat()" or after.outcome == "UPDATED"))
    assert updates == 1


@pytest.mark.parametrize("name", ["x()", "x_bar()"])
def test_the_last_bit_of_a_mean_is_told(name: str) -> None:
    heard = "receive:1:3000000:2147483649,receive:2:3000001:2147483905"
    *_, (call, before, after, follow) = followed(f"robot:2:1:64:0:2147483648,{heard},settle", Audit())
    assert follow(call, before, after) == []
    problems = follow(call, before, changed(after, name, after.state[name] ^ 1))
    assert [problem.split()[0] for problem in problems] == [name]


CALLS = "step:1 receive:3:7549747:2147483649 receive:3:5:5 receive:200:5:5 observe:7 observe:1 settle step:0"


FOLLOWING = ("accuracy_c", "accuracy_common", "accuracy_rare", "accuracy_g_shift", "accuracy_rare_shift")
"""Words that are functions of b_hat."""


def test_each_wrong_word_is_told() -> None:
    """Alone and with its reader. What follows from b_hat, the firmware's own invariants compare."""
    text = f"table:0.05:30,robot:0:2:64:0:4252017623,{CALLS.replace(' ', ',')}"
    for call, before, after, follow in followed(text, Audit()):
        assert follow(call, before, after) == []
        is_left_alone = call.name == "receive" or after.outcome.startswith("ERR")
        for name in (name for name in after.state if is_left_alone or name not in FOLLOWING):
            wrong = changed(after, name, after.state[name] ^ 1)
            assert follow(call, before, wrong), (call, name)
            reader = {"accuracy_b_hat": "b_hat()", "closed_alpha": "beta()"}.get(name, f"{name}()")
            if reader in after.state:
                assert follow(call, before, changed(wrong, reader, wrong.state[name])), (call, name, reader)


@pytest.mark.parametrize(
    ("mode", "outcome", "told"), [("off", "UPDATED", "re-estimated"), ("always", "OK", "not re-estimated")]
)
def test_a_re_estimate_without_cause_or_a_missing_one_is_told(mode: str, outcome: str, told: str) -> None:
    robot = f"robot:{Filter[mode.upper()]:d}:1:64:0:3221225472"
    *_, (call, before, after, follow) = followed(f"{robot},receive:1:3000000:2147483649,step:1", Audit())
    assert follow(call, before, after) == []
    assert f"b_hat is {told}, wrongly" in follow(call, before, replace(after, outcome=outcome))


def test_a_robot_without_observations_is_told() -> None:
    """It has no estimate to compare."""
    [(call, before, after, follow)] = followed("robot:2:1:64:0:4252017623,observe:1", Audit())
    assert "t is 0, exactly 1" in follow(call, before, changed(after, "t", 0))


@pytest.mark.parametrize("side", [1, -1])
@pytest.mark.parametrize(
    ("errors", "answer"), [(-2.01, False), (-1.99, None), (0, None), (1.99, None), (2.01, True)]
)
def test_a_re_estimate_is_judged_but_next_to_the_limit(side: int, errors: float, answer: bool | None) -> None:
    """An x_bar of 1/2 and a little more or less is known to 1.25 units of 2**-30."""
    distance = UNINFORMATIVE + Fraction(errors) * Fraction(5, 4) / 2**30
    assert updates(Fraction(1, 2) + side * distance / 2) is answer


@pytest.mark.random
@draw
@example((1, 4), Fraction(1, 4))
@example((2**30, 2**31 - 1), Fraction(1, 2) + Fraction(1, 2**13))
@example((2**30, 2**31 - 1), Fraction(1, 2) + Fraction(1, 2**14))
@example((2**30, 2**31 - 1), Fraction(1, 2) + Fraction(1, 2**8))
@given(counts, b_hats)
def test_limits_of_an_estimate_are_those_derived(count: tuple[int, int], b: Fraction) -> None:
    """Each is one number: of alpha inside the scale a little more than what follows from the roundings."""
    (n, t), near = count, exact_estimate(*count, b)[0]
    if not exact.is_informative(b):
        assert x_hat_limit(b) == 0
        return
    least, most = exact.x_hat_limits(n, t, b)
    assert max(near - least, most - near) <= x_hat_limit(b)
    below, above = exact.alpha_error(n, t, b)
    derived = max(below + exact.Q23, above)
    assert alpha_limit(n, t, b, Fraction(0)) == exact.Q24
    relative = alpha_limit(n, t, b, Fraction(1)) - exact.Q24
    slack = Fraction(3, 100) if abs(2 * b - 1) > Fraction(1, 100) else Fraction(1, 200)
    if near in (0, 1):
        slack = Fraction(0)
    assert derived <= relative <= derived * (1 + slack)


@pytest.mark.parametrize("r", [5, 2**12])
def test_the_limit_of_x_hat_is_met(r: int) -> None:
    """Almost, next to an end of the scale."""
    b, t = exact.HALF + Fraction(1, 2 * r), 2**31 - 1
    first = math.ceil(t * (1 - b))
    worst = Fraction(0)
    for n in range(first, first + 64):
        near, (least, most) = exact_estimate(n, t, b)[0], exact.x_hat_limits(n, t, b)
        worst = max(worst, near - least, most - near)
    assert Fraction(9, 10) < worst / x_hat_limit(b) <= 1


@pytest.mark.random
@draw
@given(counts, b_hats)
def test_the_limit_of_b_hat_is_the_one_derived(count: tuple[int, int], x_bar: Fraction) -> None:
    assume(exact.updates(x_bar))
    assert b_hat_limit(x_bar) >= exact.b_hat_error(x_bar)
    assert b_hat_limit(x_bar) == exact.b_hat_error(x_bar) or x_bar < exact.HALF


@pytest.mark.parametrize(("omega", "q"), [("0.05", 30), ("0.05", 127), ("0.05", 2), ("0.2", 5), ("0.9", 2)])
def test_limits_of_a_table_are_half_a_unit_and_what_its_last_entry_lacks(omega: str, q: int) -> None:
    choice = TableChoice(omega, q)
    scale = 2 ** (THRESHOLD_SCALE - FRACTION_BITS)
    true = {m: Fraction(true_threshold(choice, m), scale) for m in range(2, 128)}
    errors = {m: abs(build_table(choice).entry(m) / true[m] - 1) for m in true}
    for m in range(2, q + 1):
        assert errors[m] <= threshold_limit(choice, m)
        assert threshold_limit(choice, m) == pytest.approx(float(1 / (2 * true[m])), abs=0)
    beyond = [errors[m] for m in range(q + 1, 128)]
    for m in range(q + 1, 128):
        assert max(beyond) <= threshold_limit(choice, m) < max(beyond) * Fraction(101, 100)


def test_limits_are_not_idle() -> None:
    """The errors of some x_hat and of some alpha come within a factor of four of what they may be."""
    shares: dict[str, list[Fraction]] = {"x_hat": [], "alpha": []}
    for number in range(100):
        scenario = random_scenario(1, number)
        subject = Subject(MirrorRobot, scenario.setup)
        for call in scenario.calls if subject.last.state else ():
            before, state = subject.last.state, subject.apply(call).state
            if call.name in ("observe", "step") and call.numbers[0] < 2:
                b, n, t = Fraction(before["b_hat()"], 2**32), state["n"], state["t"]
                x_hat, alpha = exact_estimate(n, t, b)
                if alpha:
                    error = abs(Fraction(state["x_hat"], ONE) - x_hat)
                    shares["x_hat"].append(error / x_hat_limit(b))
                    error = abs(Fraction(word_to_alpha(state["alpha"])) - alpha)
                    shares["alpha"].append(error / alpha_limit(n, t, b, alpha))
    for name, found in shares.items():
        assert Fraction(1, 4) < max(found) <= 1, name


@pytest.mark.random
@draw
@example([8.0, *[1.0] * 998])
@example([8.0, 4.0, *[1.0] * 1998])
@given(st.lists(st.one_of(st.just(0.0), st.floats(1e-12, 1e3)), min_size=1, max_size=3000))
def test_percentiles_are_within_a_bin(errors: list[float]) -> None:
    tally = Errors()
    for error in errors:
        tally.add(-error)
    true = sorted(errors)[len(errors) - 1 - len(errors) // 1000]
    assert tally.count == len(errors)
    assert tally.largest == max(errors)
    assert true <= tally.percentile * (1 + 1e-12)
    assert tally.percentile <= true * 2 ** (1 / 16) * (1 + 1e-12)


def test_decisions_are_counted() -> None:
    decisions = Decisions()
    decisions.count(True, 0.5, 2.0**-26)
    decisions.count(False, 0.25, 2.0**-25)
    decisions.count(True, 0.75, 2.0**-27)
    assert decisions == Decisions(tests=3, disagreements=1, nearest=0.25, limit=2.0**-25)


@pytest.mark.parametrize(
    ("replaced", "messages", "counted"),
    [("", 2, (1, 0)), ("", 3, (0, 1)), (":2:4227858432", 2, (0, 0)), (":2:4227858432", 3, (0, 0))],
)
def test_tests_are_counted_by_entry(replaced: str, messages: int, counted: tuple[int, int]) -> None:
    """The table has an entry for two messages; no true threshold belongs to one with another in its place."""
    audit = Audit()
    heard = ",".join(f"receive:{each}:{2_000_000 * each}:2147483649" for each in range(1, messages + 1))
    text = f"table:0.05:2{replaced},robot:0:1:64:0:3221225472,{heard},step:1"
    for call, before, after, follow in followed(text, audit):
        assert follow(call, before, after) == []
    assert (after.state["tests"], after.outcome == "UPDATED") == (1, not replaced or messages == 3)
    assert tuple(tally.tests for tally in audit.decisions.values()) == counted


def test_a_decision_is_excused_up_to_the_limit(monkeypatch: pytest.MonkeyPatch) -> None:
    """The table rejects, and a threshold that is said to be the true one is above."""
    audit = Audit()
    heard = "receive:1:2000000:2147483649,receive:2:4000000:2147483649"

    def problems(limit: float) -> list[str]:
        monkeypatch.setattr(oracle, "threshold_limit", lambda choice, m: limit)
        *_, (call, before, after, follow) = followed(
            f"table:0.05:2,robot:0:1:64:0:3221225472,{heard},step:1", audit
        )
        assert after.outcome == "UPDATED"
        return follow(call, before, after)

    monkeypatch.setattr(oracle, "true_threshold", lambda choice, m: 100 << THRESHOLD_SCALE)
    [problem] = problems(0.0)
    assert "the true threshold" in problem and "decides otherwise" in problem
    distance = audit.decisions["m <= q"].nearest
    assert (len(problems(math.nextafter(distance, 0))), problems(distance)) == (1, [])


def test_regions_cover_the_whole_range() -> None:
    for value, expected in [(0, 0), (2**-12, 1), (-0.02, 2), (0.2, 3), (0.9, 4), (0.999, 5), (1, 5)]:
        assert oracle.region_of(Fraction(value)) == expected
    assert REGIONS[-1][0] == math.inf


def test_errors_are_told_by_key_in_order() -> None:
    audit = Audit()
    audit.add(oracle.Key(3, 1, 1), Fraction(1, 8), 0.25)
    audit.add(oracle.Key(0, 5, 0), Fraction(-3, 4), -0.5)
    audit.add(oracle.Key(0, 5, 0), Fraction(1, 4), 0.125)
    rows = audit.as_dict()["errors"]
    assert [list(row.values())[:4] for row in rows] == [
        ["x_hat", "0.999 to 1", "inside", 2],
        ["x", "2^-12 to 0.02", "end", 1],
    ]
    assert [(row["exact"]["max"], row["float64"]["max"]) for row in rows] == [(0.75, 0.5), (0.125, 0.25)]
    assert [(row["exact"]["p99.9"], row["float64"]["p99.9"]) for row in rows] == [(0.75, 0.5), (0.125, 0.25)]


class Told(Audit):
    """Remembers each error that it is given, in order."""

    def __init__(self) -> None:
        super().__init__()
        self.told: list[tuple[tuple[str, int, int], Fraction, float]] = []

    def add(self, key: oracle.Key, exact: Fraction, reference: float) -> None:
        self.told.append(((QUANTITIES[key.quantity], key.region, key.place), exact, reference))


@pytest.mark.parametrize(
    ("b_hat", "x_bar", "own", "updated"),
    [
        ("4252017623", "7549747", ("x_hat", "alpha", 4, 0), ("b_hat", 3, 0)),  # 0.99 and 0.9
        ("4252017623", "4236247", ("x_hat", "alpha", 4, 0), ("b_hat", 1, 1)),  # 0.99 and 0.505
        ("2362232013", "7549747", ("x_hat", "small alpha", 2, 1), ("b_hat", 3, 0)),  # 0.55 and 0.9
        ("1932735283", "7549747", ("x_hat", "small alpha", 2, 1), ("b_hat", 3, 0)),  # 0.45 and 0.9
    ],
)
def test_errors_are_collected_where_they_belong(
    b_hat: str, x_bar: str, own: tuple[str, str, int, int], updated: tuple[str, int, int]
) -> None:
    """A robot hears something at its third tile, the first that is white, and re-estimates its accuracy."""
    audit = Told()
    text = f"robot:1:1:64:0:{b_hat},step:1,step:1,receive:1:{x_bar}:2147483649,step:0"
    for call, before, after, follow in followed(text, audit):
        audit.told.clear()
        assert follow(call, before, after) == []
    assert after.outcome == "UPDATED"

    x_hat, alpha = exact_estimate(2, 3, Fraction(int(b_hat), 2**32))
    heard, weight = Fraction(int(x_bar), ONE), Fraction(word_to_alpha(2147483649))
    x = (alpha * x_hat + weight * heard) / (alpha + weight)
    state, (first, second, region, place) = after.state, own
    found = Fraction(word_to_alpha(state["alpha"]))
    of_alpha = found / alpha - 1 if second == "alpha" else (found - alpha) * 2**24
    errors = [
        ((first, region, place), Fraction(state["x_hat"], ONE) - x_hat),
        ((second, region, place), of_alpha),
        (updated, Fraction(state["b_hat()"], 2**32) - exact_b_hat(2, 3, heard)),
        (("x", region, place), Fraction(state["x()"], ONE) - x),
    ]
    assert [(key, error) for key, error, _ in audit.told] == errors
    assert all(abs(reference - error) < 2**-24 for _, error, reference in audit.told)


def test_alphas_of_one_half() -> None:
    """A black tile, a white one and a b_hat of 5/8 give it exactly; less has a coarser grid."""
    audit = Told()
    text = "robot:2:1:64:0:2684354560,step:1,receive:3:7549747:2147483648,step:0"
    for call, before, after, follow in followed(text, audit):
        audit.told.clear()
        assert follow(call, before, after) == []
    assert [key for key, _, _ in audit.told] == [(name, 3, 0) for name in ("x_hat", "alpha", "x")]
    assert abs(audit.told[-1][1]) < 2**-23, "x is half-way between the robot's x_hat and its neighbour's"


@pytest.mark.parametrize(("restored", "told"), [("29:0", ["x"]), ("29:65536:4:1234567", [])])
def test_x_is_compared_as_long_as_the_estimate_is_one(restored: str, told: list[str]) -> None:
    """Not with an x_hat that no observation gave, which an image may have if b_hat is newer."""
    audit = Told()
    text = f"robot:2:1:64:0:4252017623,step:1,receive:3:7549747:2147483649,restore:{restored},settle"
    for call, before, after, follow in followed(text, audit):
        audit.told.clear()
        assert (follow(call, before, after), after.outcome) == ([], "OK")
    assert [quantity for (quantity, _, _), _, _ in audit.told] == told
