"""Claims of section IV-E, and of VI on the same: all robots filter."""

from __future__ import annotations

from mcp_asdf_tools.reproduction.comparisons import (
    ABOVE,
    BELOW,
    BOTH,
    DYNAMIC,
    EXCELLENT,
    FULLY_CONNECTED,
    HARD,
    MINUS,
    MUCH,
    NONE,
    NOT_ABOVE,
    NOT_BELOW,
    OVER,
    OVER_AMBIGUOUS,
    OVER_CLEAR,
    OVERWHELMING,
    PARTLY,
    PLUS,
    QUITE_HIGH,
    SAME,
    SIMILAR,
    UNDER,
    UNDER_CLEAR,
    UP_TO_HALF,
    Claim,
    Correlation,
    Question,
    Reading,
    against,
    cells,
    compare,
    rises,
    versus,
    versus_dynamic,
    versus_flawless,
    versus_percent,
)
from mcp_asdf_tools.reproduction.resampling import BEST_OF_30
from mcp_asdf_tools.reproduction.study import H_E, H_K, PERIODS, Cell, Measure, Part
from mcp_asdf_tools.reproduction.verdicts import Expectation, Scope

CORRUPTION = Measure(
    "b_hat of robots that began with the right one, in the end",
    lambda trials, scores: trials.b_hat[:, -1, trials.experiment.flawed :].mean(axis=1),
)
CORRUPTED = 0.05
"""From which b_hat counts as corrupted."""


def _exception(part: Part) -> list[Cell]:
    """Of figure 3b."""
    return cells(part, [UNDER_CLEAR], [50], PLUS, PERIODS[1:])


def _improved(part: Part) -> list[Question]:
    each = cells(part, filter=PLUS, periods=PERIODS)
    return compare(ABOVE, versus([cell for cell in each if cell not in _exception(part)], NONE))


def _moderately_worse(part: Part) -> list[Question]:
    pairs = versus(cells(part, HARD, [10, 30], PLUS), MINUS)
    return [*compare(BELOW, pairs), *compare(NOT_BELOW.by(MUCH), pairs)]


def _speed_for_little_accuracy(part: Part) -> list[Question]:
    pairs = versus(cells(part, [OVER_AMBIGUOUS], filter=PLUS), MINUS)
    return [*compare(ABOVE.of(H_K), pairs), *compare(NOT_BELOW.of(H_E).by(MUCH), pairs)]


def _trade_offs(part: Part) -> list[Question]:
    return [
        Correlation(
            Expectation.BELOW
            if (cell.fill_ratio, cell.true_accuracy) == OVER_CLEAR
            else Expectation.NOT_BELOW,
            cell,
        )
        for cell in cells(part, percents=[50], filter=PLUS)
    ]


def _all_flawed(part: Part) -> list[tuple[Cell, Cell]]:
    return versus(cells(part, percents=[100], filter=PLUS, periods=PERIODS), NONE)


def _corrupted(part: Part) -> list[Question]:
    each = cells(part, [OVER_CLEAR], [50], PLUS)
    return [
        *against(ABOVE.of(CORRUPTION).by(CORRUPTED), each, 0.55),
        *compare(BELOW.of(H_E), versus_percent(each, 10)),
    ]


def _similar(part: Part) -> list[Question]:
    panels = (OVER_AMBIGUOUS, *UNDER)
    each = [*cells(part, panels, filter=PLUS), *cells(part, [OVER_CLEAR], [10], PLUS)]
    return compare(SAME.by(SIMILAR), versus(each, MINUS))


def _milder(part: Part) -> list[Question]:
    """A flawless swarm is the same with and without filter, so that less decline is a higher score."""
    each = [cell for some in (MINUS, PLUS) for cell in cells(part, HARD, filter=some)]
    return compare(ABOVE, versus(each, NONE))


def _retained(part: Part) -> list[Question]:
    each = [cell for some in (MINUS, PLUS) for cell in cells(part, HARD, filter=some)]
    return compare(NOT_BELOW, versus_flawless(each))


def _underconfident_improved(part: Part) -> list[Question]:
    each = [cell for some in (MINUS, PLUS) for cell in cells(part, UNDER, filter=some)]
    return compare(ABOVE.by(MUCH), versus(each, NONE))


ASDF_PLUS = (
    Claim(
        "plus_spreads_wider",
        "IV-E, figure 3",
        "we see a wider spread of estimation performances by the ASDF+ when compared to the ASDF- [...]. In "
        "comparing the ASDF+ against the ASDF-, we see the wider performance spread analogous to the dynamic "
        "topology experiments",
        "interquartile range of H over the trials against ASDF-, tau = 1000, P = 10 to 50 %",
        lambda part: compare(ABOVE.in_spread(), versus(cells(part, filter=PLUS), MINUS)),
        BOTH,
    ),
    Claim(
        "plus_improves_significantly",
        "IV-E, figure 3b",
        "Similar to the ASDF-, the ASDF+ significantly enhances the estimation performance over the "
        "no-filtering swarm",
        "H at tau = 1000 against no filter, P = 10 to 50 %, but for f = b = 0.55 as for ASDF-: higher by 10",
        lambda part: compare(ABOVE.by(MUCH), versus(cells(part, HARD, filter=PLUS), NONE)),
        (DYNAMIC,),
        readings=(
            Reading(
                "any improvement, in all environments",
                lambda part: compare(ABOVE, versus(cells(part, filter=PLUS), NONE)),
            ),
        ),
    ),
    Claim(
        "plus_is_moderately_worse_than_minus",
        "IV-E, figure 3",
        "the ASDF+ is moderately worse than the ASDF- [...]. The only exception is when f = 0.55, b = 0.55",
        "H against ASDF-, tau = 1000, P = 10 and 30 %, but for f = b = 0.55: lower",
        lambda part: compare(BELOW, versus(cells(part, HARD, [10, 30], PLUS), MINUS)),
        (DYNAMIC,),
        readings=(Reading("lower, and by no more than 10", _moderately_worse),),
    ),
    Claim(
        "plus_is_inferior_to_minus_at_half",
        "IV-E, figure 3",
        "performance is undeniably inferior when the proportion of flawed robots is high (P = 50%)",
        "H against ASDF-, tau = 1000, but for f = b = 0.55: lower",
        lambda part: compare(BELOW, versus(cells(part, HARD, [50], PLUS), MINUS)),
        (DYNAMIC,),
    ),
    Claim(
        "plus_beats_the_best_minus_where_easy",
        "IV-E, figure 3b",
        "the median score is consistently higher than the maximum score of the ASDF- experiments",
        "median H against what the best of 30 trials with ASDF- reaches, where f = b = 0.55, any tau",
        lambda part: compare(
            ABOVE.versus(BEST_OF_30),
            versus(cells(part, [OVER_AMBIGUOUS], filter=PLUS, periods=PERIODS), MINUS),
        ),
        (DYNAMIC,),
    ),
    Claim(
        "plus_gains_speed_where_easy",
        "IV-E, figure 4b",
        "this is detrimental to the estimate accuracy, but the decline is minor as opposed to the gain in "
        "convergence speed",
        "where f = b = 0.55, against ASDF-: h_K higher, h_e lower by less than 10",
        _speed_for_little_accuracy,
        (DYNAMIC,),
    ),
    Claim(
        "plus_rises_where_easy",
        "IV-E, figure 3b",
        "the estimation performance as a whole rises steadily with the increase of P",
        "H of each P against the next lower one, and of 50 % against 0, where f = b = 0.55",
        lambda part: rises(cells(part, [OVER_AMBIGUOUS], [0], PLUS), UP_TO_HALF),
        (DYNAMIC,),
    ),
    Claim(
        "plus_improves_at_any_period",
        "figure 3b",
        "Except for a swarm of P = 50% underconfident robots filtering at tau >= 2000 at f = 0.95 (bottom "
        "right), the filter successfully improves estimation over no-filtering robots",
        "H against no filter, P = 10 to 50 %, any tau",
        _improved,
        (DYNAMIC,),
    ),
    Claim(
        "plus_does_not_improve_the_exception",
        "figure 3b",
        "Except for a swarm of P = 50% underconfident robots filtering at tau >= 2000 at f = 0.95 (bottom "
        "right)",
        "H against no filter there: not higher",
        lambda part: compare(NOT_ABOVE, versus(_exception(part), NONE)),
        (DYNAMIC,),
    ),
    Claim(
        "only_overconfident_trade_off_at_half",
        "IV-E, figure 4b",
        "The scores for the overconfident robots at f = 0.95 spread out in a speed-accuracy tradeoff curve, "
        "but not for the underconfident robots, nor for both cases at f = 0.55",
        "rank correlation of h_K and h_e over the trials at P = 50 %: below -0.2 there and nowhere else",
        _trade_offs,
        (DYNAMIC,),
    ),
    Claim(
        "filters_are_accurate",
        "figure 4b",
        "For partially flawed swarms, both filters exhibit similar trends whereby estimation accuracy is "
        "excellent generally",
        "h_e of 90 or more, tau = 1000, P = 10 to 50 %",
        lambda part: against(
            NOT_BELOW.of(H_E),
            [cell for some in (MINUS, PLUS) for cell in cells(part, filter=some)],
            EXCELLENT,
        ),
        (DYNAMIC,),
        Scope.MOST,
    ),
    Claim(
        "overconfident_plus_loses_accuracy",
        "figure 4b",
        "overconfident ASDF+ robots (blue dots) are susceptible to adopting incorrect assumed accuracies "
        "that degrade accuracy scores",
        "h_e against ASDF-, tau = 1000, P = 30 and 50 %: lower",
        lambda part: compare(BELOW.of(H_E), versus(cells(part, OVER, [30, 50], PLUS), MINUS)),
        (DYNAMIC,),
        readings=(
            Reading(
                "it happens in some cells, which is all that susceptible says",
                lambda part: compare(BELOW.of(H_E), versus(cells(part, OVER, filter=PLUS), MINUS)),
                Scope.SOME,
            ),
        ),
    ),
    Claim(
        "dynamic_plus_comes_close",
        "figure 5b",
        "some of the dynamic robot performances come close to those of fully connected robots",
        "H of the fully connected swarm less that of the dynamic one, tau = 1000: at most 5 in some cell",
        lambda part: compare(NOT_ABOVE.by(SIMILAR), versus_dynamic(cells(FULLY_CONNECTED, filter=PLUS))),
        (DYNAMIC,),
        Scope.SOME,
    ),
    Claim(
        "dynamic_plus_spreads_wider",
        "figure 5b",
        "albeit with a wider spread",
        "interquartile range of H, fully connected less dynamic, underconfident robots at P = 10 %",
        lambda part: compare(BELOW.in_spread(), versus_dynamic(cells(FULLY_CONNECTED, UNDER, [10], PLUS))),
        (DYNAMIC,),
        readings=(
            Reading(
                "in all cells",
                lambda part: compare(BELOW.in_spread(), versus_dynamic(cells(FULLY_CONNECTED, filter=PLUS))),
            ),
        ),
    ),
    Claim(
        "filters_do_not_help_entirely_flawed_swarms",
        "IV-E, VI, figure 3b",
        "the filter's performance fails to surpass baseline results in all P = 100% cases [...]. If the "
        "entire swarm has a flawed assumed accuracy, however, the advantage of using the ASDF vanishes",
        "H against no filter, any tau: not higher",
        lambda part: compare(NOT_ABOVE, _all_flawed(part)),
        BOTH,
    ),
    Claim(
        "filters_mostly_harm_entirely_flawed_swarms",
        "IV-E, figure 3b",
        "At best, the ASDF maintains the estimation performance but is mostly worse than the baseline",
        "H of P = 100 % against no filter, any tau: lower",
        lambda part: compare(BELOW, _all_flawed(part)),
        (DYNAMIC,),
        Scope.MOST,
    ),
    Claim(
        "entirely_flawed_swarms_lose_speed_only",
        "IV-E, figure 4",
        "The inferiority comes solely from lower ASDF convergence scores as compared to the no-filtering "
        "case",
        "h_e of P = 100 % against no filter, any tau: not lower",
        lambda part: compare(NOT_BELOW.of(H_E), _all_flawed(part)),
        (DYNAMIC,),
    ),
    Claim(
        "plus_gains_from_connection",
        "IV-E, figure 5b",
        "The estimation performance by the fully connected robots is overwhelmingly better than that of the "
        "dynamic robots",
        "H at tau = 1000 against the dynamic swarm, P = 10 to 50 %: higher by 20",
        lambda part: compare(ABOVE.by(OVERWHELMING), versus_dynamic(cells(part, filter=PLUS))),
        (FULLY_CONNECTED,),
        readings=(
            Reading(
                "much better, but for underconfident robots at P = 10 %, as figure 5 says",
                lambda part: compare(
                    ABOVE.by(MUCH),
                    versus_dynamic(
                        [*cells(part, OVER, filter=PLUS), *cells(part, UNDER, [30, 50], filter=PLUS)]
                    ),
                ),
            ),
        ),
    ),
    Claim(
        "plus_does_not_improve_overconfident",
        "IV-E, figure 5b",
        "In general, fully connected swarms with overconfident robots that run the ASDF+ do not improve "
        "upon their baseline performance",
        "H at tau = 1000 against no filter, P = 10 to 50 %: not higher",
        lambda part: compare(NOT_ABOVE, versus(cells(part, OVER, filter=PLUS), NONE)),
        (FULLY_CONNECTED,),
        Scope.MOST,
    ),
    Claim(
        "plus_improves_few_overconfident",
        "IV-E, figure 5b",
        "albeit when f = 0.95 the trend is consistent for P <= 10%",
        "overconfident, f = 0.95, P = 10 %: H against no filter: higher, as in dynamic swarms",
        lambda part: compare(ABOVE, versus(cells(part, [OVER_CLEAR], [10], PLUS), NONE)),
        (FULLY_CONNECTED,),
    ),
    Claim(
        "overconfident_are_accurate_where_easy",
        "IV-E",
        "the Environment Factor ensures that informed estimation is quite accurate to begin with "
        "(regardless of b_hat)",
        "f = b = 0.55, P = 10 to 100 %, no filter: h_e of 80 or more",
        lambda part: against(NOT_BELOW.of(H_E), cells(part, [OVER_AMBIGUOUS], (*PARTLY, 100)), QUITE_HIGH),
        (FULLY_CONNECTED,),
    ),
    Claim(
        "few_overconfident_settle_late",
        "IV-E",
        "Fewer overconfident robots thus result in a situation where [...] ultimately prolonging the "
        "estimates' settling time",
        "f = b = 0.55, ASDF+: h_K of each P against the next lower one, and of 50 % against 10 %",
        lambda part: rises(cells(part, [OVER_AMBIGUOUS], [10], PLUS), PARTLY, H_K),
        (FULLY_CONNECTED,),
    ),
    Claim(
        "overconfident_robots_corrupt_correct_ones",
        "IV-E, figure 6",
        "the correct robots' assumed accuracy is corrupted by the overconfident robots [...]. Eventually, "
        "the informed estimates of the entire swarm become inaccurate",
        "overconfident, f = 0.95, P = 50 %: b_hat of correct robots in the end: 0.05 too high; h_e against "
        "P = 10 %: lower",
        _corrupted,
        (FULLY_CONNECTED,),
    ),
    Claim(
        "few_overconfident_do_not_mislead",
        "IV-E",
        "this can still be mitigated as long as only a tiny fraction of the swarm is flawed (P <= 10%)",
        "overconfident, f = 0.95, P = 10 %: h_e against no filter: higher",
        lambda part: compare(ABOVE.of(H_E), versus(cells(part, [OVER_CLEAR], [10], PLUS), NONE)),
        (FULLY_CONNECTED,),
    ),
    Claim(
        "plus_is_similar_to_minus",
        "IV-E, figure 5",
        "Their performance levels are also similar, apart from the overconfident robots at higher P when f "
        "= 0.95",
        "H against ASDF-, tau = 1000: within 5, but for P = 30 and 50 % overconfident robots at f = 0.95",
        _similar,
        (FULLY_CONNECTED,),
    ),
    Claim(
        "plus_is_worse_than_minus_where_clear",
        "IV-E, figure 5",
        "the Neighbor Factor tempers the benefit of the filter in the ASDF+ case, but here it is less "
        "effectual when correct assumed accuracies are unmovable in the ASDF- case",
        "overconfident, f = 0.95, P = 30 and 50 %: H against ASDF-: lower",
        lambda part: compare(BELOW, versus(cells(part, [OVER_CLEAR], [30, 50], PLUS), MINUS)),
        (FULLY_CONNECTED,),
    ),
    Claim(
        "minus_still_improves_where_clear",
        "IV-E, figure 5a",
        "we continue to see the ASDF- improving upon baseline performance even with more flawed robots",
        "overconfident, f = 0.95, P = 30 and 50 %: H of ASDF- against no filter: higher",
        lambda part: compare(ABOVE, versus(cells(part, [OVER_CLEAR], [30, 50], MINUS), NONE)),
        (FULLY_CONNECTED,),
    ),
    Claim(
        "plus_improves_overconfident_swarms",
        "IV-E, VI",
        "regardless of the communication topology [...]. Even without the targeted approach to filter "
        "execution, estimation performance with the ASDF+ is better than without it",
        "overconfident, tau = 1000, P = 10 to 50 %: H against no filter: higher",
        lambda part: compare(ABOVE, versus(cells(part, OVER, filter=PLUS), NONE)),
        BOTH,
    ),
    Claim(
        "filters_can_improve_underconfident_swarms",
        "IV-E",
        "regardless of the communication topology [...], when some robots are miscalibrated to a lower "
        "assumed accuracy (b_hat < b), the ASDF can significantly improve the estimation performance of the "
        "same swarm without the filter",
        "both filters, tau = 1000, P = 10 to 50 %: H against no filter: higher by 10 in some cell",
        _underconfident_improved,
        BOTH,
        Scope.SOME,
    ),
    Claim(
        "filters_make_the_decline_milder",
        "VI",
        "estimation performance has a milder decline",
        "both filters, tau = 1000, P = 10 to 50 %, but for f = b = 0.55: H against no filter: higher",
        _milder,
        BOTH,
    ),
    Claim(
        "filters_retain_the_level_somewhere",
        "VI",
        "even retaining the levels produced by flawless swarms in certain conditions",
        "the same against a flawless swarm: not lower in some cell",
        _retained,
        BOTH,
        Scope.SOME,
    ),
)
