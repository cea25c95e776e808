"""Claims of sections IV and V of the paper, each a function that decides it from results.

A function's docstring is the claim, in our words; docs/reproduce.md says how comparisons are decided. Where
the paper names no size, the sizes here are ours.
"""

from __future__ import annotations

from collections.abc import Iterable
from itertools import pairwise
from math import pi

import numpy as np

from mcp_asdf.reference import local_confidence, local_estimate
from mcp_asdf_tools.reproduction.comparisons import (
    ABOVE,
    BELOW,
    BOTH,
    CLAIMS,
    DYNAMIC,
    EVERYWHERE,
    FULLY_CONNECTED,
    HARD,
    MINUS,
    NONE,
    NOT_ABOVE,
    NOT_BELOW,
    OVER,
    OVER_AMBIGUOUS,
    OVER_CLEAR,
    PARTLY,
    PHYSICAL,
    PLUS,
    SAME,
    UNDER,
    UNDER_AMBIGUOUS,
    UNDER_CLEAR,
    against,
    cells,
    claim,
    compare,
    equation,
    falls,
    physical_cells,
    rises,
    versus,
    versus_dynamic,
    versus_flawless,
    words_of,
)
from mcp_asdf_tools.reproduction.study import (
    FLAWED_ACCURACIES,
    H_E,
    H_K,
    PERIODS,
    Cell,
    H,
    Measure,
    Part,
    Study,
)
from mcp_asdf_tools.reproduction.verdicts import (
    MARGIN,
    Comparison,
    Expectation,
    Finding,
    Scope,
    estimate,
    exactly,
    rank_correlation,
)

__all__ = ["CLAIMS"]

ALIKE = 5.0
"""Points within which "similar" and "not discernible" scores may differ."""

SLIGHT = 10.0
"""Points up to which a loss of accuracy is "slight" or "minor", and from which a lead is "substantial"."""

WEAK_CORRELATION = 0.2
"""Up to which it is called small."""

UP_TO_HALF = (0, *PARTLY)


# --- IV-B: factors ---------------------------------------------------------------------------------------


@equation("IV-B")
def table_of_local_estimates() -> Finding:
    """Table I: the local estimates that follow from f, b and b_hat, to the printed digits."""
    printed = {
        (0.55, 0.55): {0.55: 0.550, 0.75: 0.510, 0.95: 0.506},
        (0.55, 0.95): {0.95: 0.550, 0.75: 0.590, 0.55: 0.950},
        (0.95, 0.55): {0.55: 0.950, 0.75: 0.590, 0.95: 0.550},
        (0.95, 0.95): {0.95: 0.950, 0.75: 1.000, 0.55: 1.000},
    }
    return Finding(
        [
            Comparison(
                f"x_hat, f {f:g}, b {b:g}, b_hat {b_hat:g}: less {x_hat:.3f}",
                exactly(local_estimate(_seen_black(f, b), _MANY, b_hat) - x_hat),
                Expectation.SAME,
                0.0005 + 1e-9,
            )
            for (f, b), row in printed.items()
            for b_hat, x_hat in row.items()
        ]
    )


@equation("III, IV-E")
def confidence_grows_by_orders_of_magnitude() -> Finding:
    """At the same n/t the confidence of a robot with a high b_hat is more than 100 times that of a robot with
    a low one (here b_hat = 0.95 against 0.55, at the n/t of Table I)."""
    seen = {_seen_black(f, b) for f, b in EVERYWHERE}
    ratios = {n: local_confidence(n, _MANY, 0.95) / local_confidence(n, _MANY, 0.55) for n in sorted(seen)}
    return Finding(
        [
            Comparison(
                f"ratio of alpha, n/t {n / _MANY:g}: less 100", exactly(ratio - 100), Expectation.ABOVE, 1e-9
            )
            for n, ratio in ratios.items()
        ]
    )


_MANY = 100_000


def _seen_black(f: float, b: float) -> int:
    """Black among _MANY observations (eq. 1)."""
    return round(_MANY * (f * b + (1 - f) * (1 - b)))


@claim("IV-B", *BOTH)
def environment_matters(study: Study, part: Part) -> Finding:
    """Environment factor: estimation is more accurate where f = b, whatever b_hat robots assume (all flawed,
    no filter)."""
    easy = cells(part, (OVER_AMBIGUOUS, UNDER_CLEAR), [100])
    pairs = [(cell, cell.but(fill_ratio=1.5 - cell.fill_ratio)) for cell in easy]
    return Finding(compare(study, ABOVE.of(H_E), pairs))


@claim("IV-B", *BOTH)
def low_b_hat_is_volatile(study: Study, part: Part) -> Finding:
    """Volatility factor: the lower the assumed accuracy, the slower the convergence (all robots alike, no
    filter)."""
    pairs = [
        (Cell(part, f, b, high, 100 if high != b else 0), Cell(part, f, b, low, 100 if low != b else 0))
        for f, b in EVERYWHERE
        for low, high in pairwise(FLAWED_ACCURACIES)
    ]
    return Finding(compare(study, ABOVE.of(H_K), pairs), Scope.MOST)


@claim("IV-B", *BOTH)
def short_periods_are_better(study: Study, part: Part) -> Finding:
    """Period factor: shorter filtering periods perform better overall (tau = 1000 against 4000)."""
    each = [cell for mode in (MINUS, PLUS) for cell in cells(part, mode=mode)]
    return Finding(compare(study, ABOVE, _against_longest(each)), Scope.MOST)


def _against_longest(each: Iterable[Cell]) -> list[tuple[Cell, Cell]]:
    return [(cell, cell.but(period=PERIODS[-1])) for cell in each]


# --- IV-C: no filter, dynamic ----------------------------------------------------------------------------


@claim("IV-C", DYNAMIC)
def flawed_robots_harm(study: Study, part: Part) -> Finding:
    """Up to P = 50 % performance falls with more flawed robots, except where f = b = 0.55."""
    return Finding(falls(study, cells(part, HARD, [0]), UP_TO_HALF))


@claim("IV-C", DYNAMIC)
def overconfident_robots_help_where_easy(study: Study, part: Part) -> Finding:
    """Where f = b = 0.55, performance improves with more overconfident robots."""
    return Finding(rises(study, cells(part, [OVER_AMBIGUOUS], [0]), UP_TO_HALF))


@claim("IV-C", DYNAMIC)
def any_flawed_robots_help_where_easy(study: Study, part: Part) -> Finding:
    """Where f = b = 0.55, any number of flawed robots improves on a flawless swarm."""
    each = cells(part, [OVER_AMBIGUOUS], (*PARTLY, 100))
    return Finding(compare(study, ABOVE, versus_flawless(each)))


@claim("IV-C", DYNAMIC)
def speed_costs_little_accuracy_where_easy(study: Study, part: Part) -> Finding:
    """Where f = b = 0.55, overconfident robots make the swarm converge faster and only slightly less
    accurate."""
    pairs = versus_flawless(cells(part, [OVER_AMBIGUOUS]))
    return Finding(
        [*compare(study, ABOVE.of(H_K), pairs), *compare(study, NOT_BELOW.of(H_E).by(SLIGHT), pairs)]
    )


@claim("IV-C, fig. 5a", DYNAMIC)
def overconfident_swarms_trade_accuracy_for_speed(study: Study, part: Part) -> Finding:
    """With more overconfident robots swarms converge faster and less accurately, more so where f = 0.95 than
    where f = 0.55."""
    each = cells(part, OVER)
    clear = [(cell, cell.but(fill_ratio=0.55)) for cell in cells(part, [OVER_CLEAR])]
    return Finding(
        [
            *compare(study, ABOVE.of(H_K), versus_flawless(each)),
            *compare(study, BELOW.of(H_E), versus_flawless(each)),
            *compare(study, BELOW.of(H_E), clear),
        ]
    )


@claim("IV-C", DYNAMIC)
def entirely_flawed_swarms_do_better(study: Study, part: Part) -> Finding:
    """A swarm of flawed robots only (P = 100 %) performs better than one with P < 100 % in almost all
    cases."""
    pairs = [(cell, cell.but(percent=p)) for cell in cells(part, percents=[100]) for p in UP_TO_HALF]
    return Finding(compare(study, ABOVE, pairs), Scope.MOST)


@claim("IV-C", DYNAMIC)
def entirely_underconfident_swarms_are_volatile(study: Study, part: Part) -> Finding:
    """At f = 0.55 a swarm of underconfident robots only suffers from volatile estimates: it converges later
    than a flawless one."""
    return Finding(compare(study, BELOW.of(H_K), versus_flawless(cells(part, [UNDER_AMBIGUOUS], [100]))))


@claim("IV-C", DYNAMIC)
def symmetric_errors_differ_in_speed(study: Study, part: Part) -> Finding:
    """All overconfident at f = 0.95 (b_hat = b + 0.4) converge faster than all underconfident at f = 0.55
    (b_hat = b - 0.4), comparably accurate, and so score higher."""
    pair = (Cell(part, 0.95, 0.55, 0.95, 100), Cell(part, 0.55, 0.95, 0.55, 100))
    return Finding(
        [
            *compare(study, ABOVE.of(H_K), [pair]),
            *compare(study, SAME.of(H_E).by(ALIKE), [pair]),
            *compare(study, ABOVE, [pair]),
        ]
    )


@claim("IV-C", DYNAMIC)
def saturated_estimates_converge_fast(study: Study, part: Part) -> Finding:
    """At f = 0.95 a swarm of underconfident robots only saturates at x_hat = 1, which makes it converge fast
    and score high, above all partially flawed ones."""
    pairs = [(cell, cell.but(percent=p)) for cell in cells(part, [UNDER_CLEAR], [100]) for p in PARTLY]
    return Finding([*compare(study, ABOVE.of(H_K), pairs), *compare(study, ABOVE, pairs)])


@claim("IV-C, fig. 5a", DYNAMIC)
def saturated_estimates_coincide(study: Study, part: Part) -> Finding:
    """There both flawed accuracies give the same scores."""
    pair = (Cell(part, 0.95, 0.95, 0.55, 100), Cell(part, 0.95, 0.95, 0.75, 100))
    return Finding([*compare(study, SAME.of(H_K), [pair]), *compare(study, SAME.of(H_E), [pair])])


# --- IV-C: no filter, fully connected --------------------------------------------------------------------


@claim("IV-C", FULLY_CONNECTED, beside=[DYNAMIC])
def overconfident_swarms_gain_from_connection(study: Study, part: Part) -> Finding:
    """Fully connected overconfident swarms score higher than dynamic ones throughout."""
    return Finding(compare(study, ABOVE, versus_dynamic(cells(part, OVER))))


@claim("IV-C", FULLY_CONNECTED)
def connected_overconfident_rise_where_easy(study: Study, part: Part) -> Finding:
    """Overconfident, f = 0.55: performance increases gradually with P, as in the dynamic topology."""
    return Finding(rises(study, cells(part, [OVER_AMBIGUOUS], [0]), UP_TO_HALF))


@claim("IV-C", FULLY_CONNECTED)
def connected_overconfident_fall_where_clear(study: Study, part: Part) -> Finding:
    """Overconfident, f = 0.95: performance falls with P, as in the dynamic topology."""
    return Finding(falls(study, cells(part, [OVER_CLEAR], [0]), UP_TO_HALF))


@claim("IV-C", FULLY_CONNECTED, beside=[DYNAMIC])
def connected_underconfident_outdo_dynamic(study: Study, part: Part) -> Finding:
    """Underconfident: fully connected swarms outdo dynamic ones substantially."""
    return Finding(compare(study, ABOVE.by(SLIGHT), versus_dynamic(cells(part, UNDER))))


@claim("IV-C", FULLY_CONNECTED)
def connected_underconfident_do_no_harm(study: Study, part: Part) -> Finding:
    """Underconfident: up to P = 50 % the number of flawed robots does not weaken performance in any way."""
    return Finding(compare(study, NOT_BELOW, versus_flawless(cells(part, UNDER))))


@claim("IV-C", FULLY_CONNECTED)
def connected_underconfident_fail_together(study: Study, part: Part) -> Finding:
    """Underconfident: performance is weaker when all robots are flawed."""
    return Finding(compare(study, BELOW, versus_flawless(cells(part, UNDER, [100]))))


@claim("IV-C", FULLY_CONNECTED)
def connected_estimates_are_identical(study: Study, part: Part) -> Finding:
    """The informed estimate is identical for all robots (K and e of the robots of a trial, largest
    difference)."""
    swarms = [trials for trials in study.of(part)]
    largest = {
        "K": max(float(np.ptp(trials.convergence_steps, axis=1).max()) for trials in swarms),
        "e": max(float(np.ptp(trials.errors, axis=1).max()) for trials in swarms),
    }
    return Finding(
        [
            Comparison(
                f"{name}, all cells: largest less smallest of a trial", exactly(value), Expectation.SAME, 1e-9
            )
            for name, value in largest.items()
        ]
    )


@claim("IV-C", DYNAMIC, beside=[FULLY_CONNECTED])
def localized_swarms_decline_more(study: Study, part: Part) -> Finding:
    """With localized communication the decline by flawed robots is especially pronounced: P = 50 % loses more
    against P = 0 than in a fully connected swarm, except where f = b = 0.55."""
    comparisons = []
    for cell in cells(part, HARD, [50]):
        here, flawless = study.sample(cell, H), study.sample(cell.but(percent=0), H)
        there = cell.but(part=FULLY_CONNECTED)
        connected, best = study.sample(there, H), study.sample(there.but(percent=0), H)
        words = f"f {cell.fill_ratio:g}, b {cell.true_accuracy:g}, b_hat {cell.flawed_accuracy:g}"
        comparisons.append(
            Comparison(
                f"loss of H from P 0 to 50 %, no filter, {words}: dynamic less fully connected",
                estimate([flawless, connected], [here, best]),
                Expectation.ABOVE,
                MARGIN,
            )
        )
    return Finding(comparisons)


# --- IV-D: ASDF- -----------------------------------------------------------------------------------------


@claim("IV-D", DYNAMIC)
def minus_improves(study: Study, part: Part) -> Finding:
    """ASDF- at tau = 1000 improves remarkably on no filter, except where f = b = 0.55."""
    return Finding(compare(study, ABOVE, versus(cells(part, HARD, mode=MINUS), NONE)))


@claim("IV-D", DYNAMIC)
def minus_prevents_decline_in_some_cases(study: Study, part: Part) -> Finding:
    """ASDF- at tau = 1000 prevents any decline in some cases (P = 50 % against no flawed robots)."""
    return Finding(
        compare(study, NOT_BELOW, versus_flawless(cells(part, HARD, [50], MINUS))),
        Scope.SOME,
    )


@claim("IV-D, fig. 4a, VI", *BOTH)
def minus_keeps_overconfident_flawless(study: Study, part: Part) -> Finding:
    """Up to P = 50 % overconfident swarms with ASDF- at tau = 1000 are as effective as a flawless one."""
    return Finding(compare(study, NOT_BELOW, versus_flawless(cells(part, OVER, mode=MINUS))))


@claim("IV-D, fig. 4a", DYNAMIC)
def minus_keeps_few_underconfident_flawless(study: Study, part: Part) -> Finding:
    """Underconfident swarms with ASDF- at tau = 1000 are as effective as a flawless one up to P = 10 %
    only."""
    few, many = cells(part, UNDER, [10], MINUS), cells(part, UNDER, [30, 50], MINUS)
    return Finding(
        [
            *compare(study, NOT_BELOW, versus_flawless(few)),
            *compare(study, BELOW, versus_flawless(many)),
        ]
    )


@claim("IV-D", DYNAMIC)
def minus_weakens_with_period(study: Study, part: Part) -> Finding:
    """The longer tau, the less ASDF- mitigates, except where f = b = 0.55 (tau = 1000 against 4000)."""
    return Finding(compare(study, ABOVE, _against_longest(cells(part, HARD, mode=MINUS))))


@claim("IV-D", DYNAMIC)
def minus_improves_at_any_period(study: Study, part: Part) -> Finding:
    """ASDF- is better than no filter in general, at any tau, except where f = b = 0.55."""
    each = cells(part, HARD, mode=MINUS, periods=PERIODS)
    return Finding(compare(study, ABOVE, versus(each, NONE)), Scope.MOST)


@claim("IV-D", DYNAMIC)
def minus_at_long_periods_is_no_filter(study: Study, part: Part) -> Finding:
    """At f = 0.95, P = 50 % and tau = 4000 ASDF- cannot be told from no filter."""
    each = cells(part, (OVER_CLEAR, UNDER_CLEAR), [50], MINUS, PERIODS[-1:])
    return Finding(compare(study, SAME.by(ALIKE), versus(each, NONE)))


@claim("IV-D", DYNAMIC)
def minus_holds_the_level_where_easy(study: Study, part: Part) -> Finding:
    """Where f = b = 0.55, ASDF- at tau = 1000 keeps the level of a flawless swarm."""
    each = cells(part, [OVER_AMBIGUOUS], mode=MINUS)
    return Finding(compare(study, SAME.by(ALIKE), versus_flawless(each)))


@claim("IV-D", DYNAMIC)
def minus_slows_where_easy(study: Study, part: Part) -> Finding:
    """Where f = b = 0.55, ASDF- slows convergence, so that tau = 1000 underperforms tau = 4000."""
    each = cells(part, [OVER_AMBIGUOUS], mode=MINUS)
    return Finding(
        [
            *compare(study, BELOW.of(H_K), versus(each, NONE)),
            *compare(study, BELOW, _against_longest(each)),
        ]
    )


@claim("IV-D", FULLY_CONNECTED, beside=[DYNAMIC])
def minus_gains_from_connection(study: Study, part: Part) -> Finding:
    """Fully connected swarms with ASDF- do much better than dynamic ones."""
    pairs = versus_dynamic(cells(part, mode=MINUS))
    return Finding(compare(study, ABOVE.by(ALIKE), pairs), Scope.MOST)


@claim("IV-D, fig. 6a", DYNAMIC, beside=[FULLY_CONNECTED])
def dynamic_minus_comes_close(study: Study, part: Part) -> Finding:
    """With 10 % underconfident robots, dynamic swarms with ASDF- come close to fully connected ones."""
    each = cells(FULLY_CONNECTED, UNDER, [10], MINUS)
    return Finding(compare(study, NOT_ABOVE.by(SLIGHT), versus_dynamic(each)))


@claim("IV-D", FULLY_CONNECTED)
def underconfident_connected_are_almost_perfect(study: Study, part: Part) -> Finding:
    """Underconfident swarms up to P = 50 % are almost perfect without a filter (H of 95 or more)."""
    return Finding(against(study, NOT_BELOW, cells(part, UNDER), 95))


@claim("IV-D", FULLY_CONNECTED)
def connected_minus_follows_dynamic_trends(study: Study, part: Part) -> Finding:
    """Overconfident swarms: ASDF- against no filter is as in the dynamic topology, better where f = 0.95 and
    worse where f = 0.55."""
    better, worse = (versus(cells(part, [panel], mode=MINUS), NONE) for panel in (OVER_CLEAR, OVER_AMBIGUOUS))
    return Finding([*compare(study, ABOVE, better), *compare(study, BELOW, worse)])


@claim("IV-D", *BOTH)
def minus_outperforms_the_baseline(study: Study, part: Part) -> Finding:
    """In sum, swarms with ASDF- outperform the baseline."""
    return Finding(compare(study, ABOVE, versus(cells(part, mode=MINUS), NONE)), Scope.MOST)


# --- IV-E: ASDF+, dynamic --------------------------------------------------------------------------------


@claim("IV-E", *BOTH)
def plus_spreads_wider(study: Study, part: Part) -> Finding:
    """Scores with ASDF+ spread wider than with ASDF- (interquartile range over the trials, tau = 1000)."""
    pairs = versus(cells(part, mode=PLUS), MINUS)
    return Finding(compare(study, ABOVE.in_spread(0.5), pairs), Scope.MOST)


@claim("IV-E", DYNAMIC)
def plus_improves(study: Study, part: Part) -> Finding:
    """ASDF+ at tau = 1000 enhances performance over no filter significantly, except where f = b = 0.55."""
    return Finding(compare(study, ABOVE, versus(cells(part, HARD, mode=PLUS), NONE)))


@claim("IV-E", DYNAMIC)
def plus_is_moderately_worse_than_minus(study: Study, part: Part) -> Finding:
    """ASDF+ is moderately worse than ASDF-, except where f = b = 0.55 (P = 10 and 30 %)."""
    pairs = versus(cells(part, HARD, [10, 30], PLUS), MINUS)
    return Finding(compare(study, BELOW, pairs), Scope.MOST)


@claim("IV-E", DYNAMIC)
def plus_is_inferior_to_minus_at_half(study: Study, part: Part) -> Finding:
    """At P = 50 % ASDF+ is undeniably inferior to ASDF-, except where f = b = 0.55."""
    return Finding(compare(study, BELOW, versus(cells(part, HARD, [50], PLUS), MINUS)))


@claim("IV-E", DYNAMIC)
def plus_beats_the_best_minus_where_easy(study: Study, part: Part) -> Finding:
    """Where f = b = 0.55, the median with ASDF+ is above the best trial with ASDF-."""
    comparisons = []
    for cell in cells(part, [OVER_AMBIGUOUS], mode=PLUS, periods=PERIODS):
        best = float(study.sample(cell.but(mode=MINUS), H).max())
        comparisons += against(study, ABOVE, [cell], best)
    return Finding(comparisons)


@claim("IV-E", DYNAMIC)
def plus_gains_speed_where_easy(study: Study, part: Part) -> Finding:
    """There ASDF+ gains speed over ASDF- and loses little accuracy."""
    pairs = versus(cells(part, [OVER_AMBIGUOUS], mode=PLUS), MINUS)
    return Finding(
        [*compare(study, ABOVE.of(H_K), pairs), *compare(study, NOT_BELOW.of(H_E).by(SLIGHT), pairs)]
    )


@claim("IV-E", DYNAMIC)
def plus_rises_where_easy(study: Study, part: Part) -> Finding:
    """There performance with ASDF+ rises steadily with P."""
    return Finding(rises(study, cells(part, [OVER_AMBIGUOUS], [0], PLUS), UP_TO_HALF))


@claim("IV-E, fig. 4b", DYNAMIC)
def plus_improves_at_any_period(study: Study, part: Part) -> Finding:
    """ASDF+ improves on no filter at every tau, but for P = 50 % underconfident robots with tau >= 2000 at f
    = 0.95."""
    each = [
        cell
        for cell in cells(part, mode=PLUS, periods=PERIODS)
        if cell not in _underconfident_exception(part)
    ]
    return Finding(compare(study, ABOVE, versus(each, NONE)))


@claim("IV-E, fig. 4b", DYNAMIC)
def plus_does_not_improve_the_exception(study: Study, part: Part) -> Finding:
    """In that exception it does not."""
    return Finding(compare(study, NOT_ABOVE, versus(_underconfident_exception(part), NONE)))


def _underconfident_exception(part: Part) -> list[Cell]:
    return cells(part, [UNDER_CLEAR], [50], PLUS, PERIODS[1:])


@claim("IV-E", DYNAMIC)
def only_overconfident_trade_off_at_half(study: Study, part: Part) -> Finding:
    """At P = 50 % with ASDF+ trials trade speed for accuracy where overconfident robots are at f = 0.95 and
    nowhere else (rank correlation of h_K and h_e over the trials)."""
    comparisons = []
    for cell in cells(part, percents=[50], mode=PLUS):
        is_there = (cell.fill_ratio, cell.true_accuracy) == OVER_CLEAR
        expected = Expectation.BELOW if is_there else Expectation.NOT_BELOW
        found = rank_correlation(study.sample(cell, H_K), study.sample(cell, H_E))
        words = f"rank correlation, {words_of(cell)}"
        comparisons.append(Comparison(words, found, expected, WEAK_CORRELATION))
    return Finding(comparisons)


@claim("IV-E, VI", *BOTH)
def filters_do_not_help_entirely_flawed_swarms(study: Study, part: Part) -> Finding:
    """At P = 100 % the filter fails to surpass no filter in all cases, at any tau."""
    each = cells(part, percents=[100], mode=PLUS, periods=PERIODS)
    return Finding(compare(study, NOT_ABOVE, versus(each, NONE)))


@claim("IV-E", DYNAMIC)
def filters_mostly_harm_entirely_flawed_swarms(study: Study, part: Part) -> Finding:
    """At P = 100 % the filter is mostly worse than no filter."""
    each = cells(part, percents=[100], mode=PLUS, periods=PERIODS)
    return Finding(compare(study, BELOW, versus(each, NONE)), Scope.MOST)


@claim("IV-E", DYNAMIC)
def entirely_flawed_swarms_lose_speed_only(study: Study, part: Part) -> Finding:
    """That comes from slower convergence alone: accuracy does not suffer."""
    each = cells(part, percents=[100], mode=PLUS, periods=PERIODS)
    return Finding(compare(study, NOT_BELOW.of(H_E), versus(each, NONE)))


@claim("IV-E, fig. 5b", DYNAMIC)
def filters_are_accurate(study: Study, part: Part) -> Finding:
    """In partially flawed swarms both filters are generally of excellent accuracy (h_e of 90 or more, tau =
    1000)."""
    each = [cell for mode in (MINUS, PLUS) for cell in cells(part, mode=mode)]
    return Finding(against(study, NOT_BELOW.of(H_E), each, 90), Scope.MOST)


@claim("IV-E, fig. 5b", DYNAMIC)
def overconfident_plus_loses_accuracy(study: Study, part: Part) -> Finding:
    """Overconfident swarms with ASDF+ adopt wrong accuracies and are less accurate than with ASDF- (P = 30
    and 50 %)."""
    return Finding(compare(study, BELOW.of(H_E), versus(cells(part, OVER, [30, 50], PLUS), MINUS)))


# --- IV-E: ASDF+, fully connected ------------------------------------------------------------------------


@claim("IV-E", FULLY_CONNECTED, beside=[DYNAMIC])
def plus_gains_from_connection(study: Study, part: Part) -> Finding:
    """Fully connected swarms with ASDF+ are overwhelmingly better than dynamic ones."""
    return Finding(compare(study, ABOVE.by(ALIKE), versus_dynamic(cells(part, mode=PLUS))), Scope.MOST)


@claim("IV-E", FULLY_CONNECTED)
def plus_does_not_improve_overconfident(study: Study, part: Part) -> Finding:
    """Overconfident swarms with ASDF+ in general do not improve on no filter."""
    return Finding(compare(study, NOT_ABOVE, versus(cells(part, OVER, mode=PLUS), NONE)), Scope.MOST)


@claim("IV-E", FULLY_CONNECTED)
def plus_improves_few_overconfident(study: Study, part: Part) -> Finding:
    """At f = 0.95 they do improve while P is at most 10 %."""
    return Finding(compare(study, ABOVE, versus(cells(part, [OVER_CLEAR], [10], PLUS), NONE)))


@claim("IV-E", FULLY_CONNECTED)
def few_overconfident_settle_late(study: Study, part: Part) -> Finding:
    """At f = 0.55 fewer overconfident robots mean a longer time to settle (ASDF+, P = 10 to 50 %)."""
    return Finding(rises(study, cells(part, [OVER_AMBIGUOUS], [10], PLUS), PARTLY, H_K))


CORRUPTION = Measure(
    "b_hat of robots that began with the right one, in the end",
    lambda trials, scores: trials.b_hat[:, -1, trials.experiment.flawed :].mean(axis=1),
)


@claim("IV-E, fig. 7", FULLY_CONNECTED)
def overconfident_robots_corrupt_correct_ones(study: Study, part: Part) -> Finding:
    """At f = 0.95 and P = 50 % overconfident robots with ASDF+ corrupt the b_hat of correct ones (by 0.05 or
    more) and the swarm's estimate becomes inaccurate (h_e against P = 10 %)."""
    each = cells(part, [OVER_CLEAR], [50], PLUS)
    return Finding(
        [
            *against(study, ABOVE.of(CORRUPTION).by(0.05), each, 0.55),
            *compare(study, BELOW.of(H_E), [(cell, cell.but(percent=10)) for cell in each]),
        ]
    )


@claim("IV-E", FULLY_CONNECTED)
def few_overconfident_do_not_mislead(study: Study, part: Part) -> Finding:
    """That can still be mitigated while P is at most 10 %: there ASDF+ is more accurate than no filter."""
    return Finding(compare(study, ABOVE.of(H_E), versus(cells(part, [OVER_CLEAR], [10], PLUS), NONE)))


@claim("IV-E", FULLY_CONNECTED)
def plus_is_similar_to_minus(study: Study, part: Part) -> Finding:
    """ASDF+ and ASDF- perform similarly, apart from overconfident robots at higher P and f = 0.95."""
    panels = (OVER_AMBIGUOUS, *UNDER)
    each = [*cells(part, panels, mode=PLUS), *cells(part, [OVER_CLEAR], [10], PLUS)]
    return Finding(compare(study, SAME.by(ALIKE), versus(each, MINUS)))


@claim("IV-E", FULLY_CONNECTED)
def plus_is_worse_than_minus_where_clear(study: Study, part: Part) -> Finding:
    """For these, ASDF- does better than ASDF+ (P = 30 and 50 %)."""
    return Finding(compare(study, BELOW, versus(cells(part, [OVER_CLEAR], [30, 50], PLUS), MINUS)))


@claim("IV-E", FULLY_CONNECTED)
def minus_still_improves_where_clear(study: Study, part: Part) -> Finding:
    """And ASDF- improves on no filter there even with more flawed robots."""
    return Finding(compare(study, ABOVE, versus(cells(part, [OVER_CLEAR], [30, 50], MINUS), NONE)))


# --- IV-E: summary, for any topology ---------------------------------------------------------------------


@claim("IV-E", *BOTH)
def plus_improves_overconfident_swarms(study: Study, part: Part) -> Finding:
    """Regardless of the topology: with some overconfident robots ASDF+ is better than no filter."""
    return Finding(compare(study, ABOVE, versus(cells(part, OVER, mode=PLUS), NONE)))


@claim("IV-E", *BOTH)
def filters_improve_underconfident_swarms(study: Study, part: Part) -> Finding:
    """Regardless of the topology: with some underconfident robots the filter improves on no filter
    significantly."""
    each = [cell for mode in (MINUS, PLUS) for cell in cells(part, UNDER, mode=mode)]
    return Finding(compare(study, ABOVE, versus(each, NONE)))


# --- V: physical -----------------------------------------------------------------------------------------


@equation("V-A")
def physical_density() -> Finding:
    """The swarm density is about 1.3."""
    density = 8 * pi * 0.7**2 / (3.0353 * 3.0226)
    return Finding([Comparison("D: less 1.3", exactly(density - 1.3), Expectation.SAME, 0.05)])


@claim("V-B", PHYSICAL)
def plus_has_no_effect_in_short_runs(study: Study, part: Part) -> Finding:
    """ASDF+ has no effect on H for any P and b_hat, bar P = 100 % with b_hat = 0.55."""
    each = [cell for cell in physical_cells(PLUS) if not _is_physical_exception(cell)]
    return Finding(compare(study, SAME.by(ALIKE), versus(each, NONE)))


@claim("V-B", PHYSICAL)
def plus_speeds_up_the_exception(study: Study, part: Part) -> Finding:
    """There it improves convergence slightly while accuracy is similar."""
    pairs = versus(filter(_is_physical_exception, physical_cells(PLUS)), NONE)
    return Finding([*compare(study, ABOVE.of(H_K), pairs), *compare(study, SAME.of(H_E).by(ALIKE), pairs)])


def _is_physical_exception(cell: Cell) -> bool:
    return cell.percent == 100 and cell.flawed_accuracy == 0.55


@claim("V-B", PHYSICAL)
def short_runs_are_accurate(study: Study, part: Part) -> Finding:
    """Accuracy is quite high in all cases (h_e of 80 or more)."""
    each = [*physical_cells(), *physical_cells(PLUS)]
    return Finding(against(study, NOT_BELOW.of(H_E), each, 80))


@claim("V-B", PHYSICAL)
def short_runs_converge_poorly(study: Study, part: Part) -> Finding:
    """Convergence is poor in all cases (h_K of 50 or less)."""
    each = [*physical_cells(), *physical_cells(PLUS)]
    return Finding(against(study, NOT_ABOVE.of(H_K), each, 50))


@claim("V-B", PHYSICAL)
def short_runs_do_not_depend_on_p(study: Study, part: Part) -> Finding:
    """Performance is largely the same across P (against P = 0)."""
    pairs = [
        (cell, cell.but(percent=0)) for cell in (*physical_cells(), *physical_cells(PLUS)) if cell.percent
    ]
    return Finding(compare(study, SAME.by(ALIKE), pairs), Scope.MOST)


@claim("V-B", PHYSICAL, beside=[DYNAMIC])
def longer_runs_converge_better(study: Study, part: Part) -> Finding:
    """Simulated underconfident swarms at f = 0.55 with ASDF+ have significantly higher convergence scores."""
    pairs = [
        (Cell(DYNAMIC, 0.55, 0.95, cell.flawed_accuracy, cell.percent, PLUS), cell)
        for cell in physical_cells(PLUS)
        if cell.percent in (0, 50, 100) and cell.flawed_accuracy < 0.95
    ]
    return Finding(compare(study, ABOVE.of(H_K), pairs))


@claim("V-B", PHYSICAL)
def plus_does_no_harm_in_short_runs(study: Study, part: Part) -> Finding:
    """ASDF+ does not harm in the short term."""
    return Finding(compare(study, NOT_BELOW, versus(physical_cells(PLUS), NONE)))
