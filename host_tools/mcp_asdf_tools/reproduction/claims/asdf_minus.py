"""Claims of section IV-D, and of IV-E and VI on the same: only flawed robots filter."""

from __future__ import annotations

from mcp_asdf_tools.reproduction.comparisons import (
    ABOVE,
    ALMOST_PERFECT,
    BELOW,
    BOTH,
    DYNAMIC,
    EVERYWHERE,
    FULLY_CONNECTED,
    HARD,
    MINUS,
    MUCH,
    NONE,
    NOT_BELOW,
    OVER,
    OVER_AMBIGUOUS,
    OVER_CLEAR,
    PARTLY,
    QUITE_HIGH,
    SAME,
    SIMILAR,
    UNDER,
    UNDER_CLEAR,
    Claim,
    Question,
    Reading,
    against,
    cells,
    compare,
    versus,
    versus_dynamic,
    versus_flawless,
    versus_period,
)
from mcp_asdf_tools.reproduction.study import H_K, PERIODS, Part
from mcp_asdf_tools.reproduction.verdicts import Scope

_LONGEST = PERIODS[-1]


def _only_few_underconfident(part: Part) -> list[Question]:
    few, many = (versus_flawless(cells(part, UNDER, some, MINUS)) for some in ([10], [30, 50]))
    return [*compare(NOT_BELOW, few), *compare(BELOW, many)]


def _slower(part: Part) -> list[Question]:
    each = cells(part, [OVER_AMBIGUOUS], filter=MINUS)
    return [*compare(BELOW.of(H_K), versus(each, NONE)), *compare(BELOW, versus_period(each, _LONGEST))]


def _trends(part: Part) -> list[Question]:
    better, worse = (
        versus(cells(part, [panel], filter=MINUS), NONE) for panel in (OVER_CLEAR, OVER_AMBIGUOUS)
    )
    return [*compare(ABOVE, better), *compare(BELOW, worse)]


ASDF_MINUS = (
    Claim(
        "minus_improves_remarkably",
        "IV-D, figure 3a",
        "Apart from when the environment is ambiguous and the true accuracy is low, there is a remarkable "
        "improvement in the estimation performance by robots with the ASDF-. This is most noticeable at the "
        "lowest nominal filtering period",
        "H at tau = 1000 against no filter, P = 10 to 50 %, but for f = b = 0.55: higher by 10",
        lambda part: compare(ABOVE.by(MUCH), versus(cells(part, HARD, filter=MINUS), NONE)),
        (DYNAMIC,),
        readings=(
            Reading(
                "any improvement", lambda part: compare(ABOVE, versus(cells(part, HARD, filter=MINUS), NONE))
            ),
        ),
    ),
    Claim(
        "minus_prevents_decline_in_some_cases",
        "IV-D, figure 3a",
        "the ASDF- drastically reduces performance degradation---even preventing any decline in some cases",
        "H of P = 50 % at tau = 1000 against a flawless swarm, but for f = b = 0.55: not lower in some cell",
        lambda part: compare(NOT_BELOW, versus_flawless(cells(part, HARD, [50], MINUS))),
        (DYNAMIC,),
        Scope.SOME,
    ),
    Claim(
        "minus_weakens_with_period",
        "IV-D, figure 3a",
        "As the nominal filtering period lengthens, the magnitude of degradation mitigated reduces",
        "H at tau = 1000 against 4000, P = 10 to 50 %, but for f = b = 0.55",
        lambda part: compare(ABOVE, versus_period(cells(part, HARD, filter=MINUS), _LONGEST)),
        (DYNAMIC,),
    ),
    Claim(
        "minus_improves_at_any_period",
        "IV-D, figure 3a",
        "estimation performance with the filter is better than without it in general",
        "H at any tau against no filter, P = 10 to 50 %, but for f = b = 0.55",
        lambda part: compare(ABOVE, versus(cells(part, HARD, filter=MINUS, periods=PERIODS), NONE)),
        (DYNAMIC,),
        Scope.MOST,
        readings=(
            Reading(
                "in all environments",
                lambda part: compare(ABOVE, versus(cells(part, filter=MINUS, periods=PERIODS), NONE)),
                Scope.MOST,
            ),
        ),
    ),
    Claim(
        "minus_at_long_periods_is_no_filter",
        "IV-D, figure 3a",
        "At f = 0.95, the score difference for 50%-flawed swarms without filtering and filtering at tau = "
        "4000 is not discernible",
        "H against no filter, within 5",
        lambda part: compare(
            SAME.by(SIMILAR), versus(cells(part, (OVER_CLEAR, UNDER_CLEAR), [50], MINUS, [_LONGEST]), NONE)
        ),
        (DYNAMIC,),
    ),
    Claim(
        "minus_holds_the_level_where_easy",
        "IV-D, figure 3a",
        "running the ASDF- at tau = 1000 maintains the performance level set by a flawless swarm (P = 0%)",
        "H against a flawless swarm, P = 10 to 50 %, where f = b = 0.55: within 2",
        lambda part: compare(SAME, versus_flawless(cells(part, [OVER_AMBIGUOUS], filter=MINUS))),
        (DYNAMIC,),
    ),
    Claim(
        "minus_slows_where_easy",
        "IV-D, figure 3a",
        "reducing b_hat closer to b, thus slowing down convergence. With a lower tau, the convergence "
        "decelerates further, leading to the case where tau = 1000 underperforming that at tau = 4000",
        "where f = b = 0.55: h_K against no filter: lower; H at tau = 1000 against 4000: lower",
        _slower,
        (DYNAMIC,),
    ),
    Claim(
        "minus_keeps_overconfident_flawless",
        "figure 3a, IV-E, VI",
        "Filtering at tau = 1000 (orange), overconfident swarms are just as effective as a flawless one "
        "[...]. regardless of the communication topology [...], the ASDF- is able to maintain the baseline "
        "performance of a flawless swarm [...]. swarms that constitute at most 50% overconfident robots "
        "achieve performance on par with that of flawless robots",
        "H at tau = 1000 against a flawless swarm, P = 10 to 50 %: not lower",
        lambda part: compare(NOT_BELOW, versus_flawless(cells(part, OVER, filter=MINUS))),
        BOTH,
    ),
    Claim(
        "minus_keeps_few_underconfident_flawless",
        "figure 3a",
        "though such robustness extends only to swarms with at most 10% underconfident robots",
        "H at tau = 1000 against a flawless swarm: not lower at P = 10 %, lower at 30 and 50 %",
        _only_few_underconfident,
        (DYNAMIC,),
    ),
    Claim(
        "minus_gains_from_connection",
        "IV-D, figure 5a",
        "a fully connected swarm with the ASDF- achieves a much better estimation performance than the "
        "dynamic swarm",
        "H at tau = 1000 against the dynamic swarm, P = 10 to 50 %: higher by 10",
        lambda part: compare(ABOVE.by(MUCH), versus_dynamic(cells(part, filter=MINUS))),
        (FULLY_CONNECTED,),
        readings=(
            Reading(
                "but for underconfident robots at P = 10 %, which figure 5a excepts",
                lambda part: compare(
                    ABOVE.by(MUCH),
                    versus_dynamic(
                        [*cells(part, OVER, filter=MINUS), *cells(part, UNDER, [30, 50], filter=MINUS)]
                    ),
                ),
            ),
        ),
    ),
    Claim(
        "dynamic_minus_fares_quite_well",
        "figure 5a",
        "in some cases the dynamic robots fare quite well (underconfident robots at P = 10%)",
        "H at tau = 1000: 80 or more",
        lambda part: against(NOT_BELOW, cells(part, UNDER, [10], MINUS), QUITE_HIGH),
        (DYNAMIC,),
    ),
    Claim(
        "connected_minus_follows_dynamic_trends",
        "IV-D, figure 5a",
        "The trends between the no-filtering and ASDF- cases are similar as well, barring the experiments "
        "with underconfident robots (right column)",
        "overconfident: H against no filter: higher where f = 0.95, lower where f = 0.55, as in dynamic "
        "swarms",
        _trends,
        (FULLY_CONNECTED,),
    ),
    Claim(
        "underconfident_connected_are_almost_perfect",
        "IV-D, figure 5a",
        "performance is almost perfect even without filtering",
        "underconfident, P = 10 to 50 %: H of 95 or more",
        lambda part: against(NOT_BELOW, cells(part, UNDER), ALMOST_PERFECT),
        (FULLY_CONNECTED,),
    ),
    Claim(
        "minus_outperforms_the_baseline",
        "IV-D",
        "by identifying flawed robots to execute the filter, the estimation performance by swarms with the "
        "ASDF- outperforms the baseline",
        "H at tau = 1000 against no filter, P = 10 to 50 %",
        lambda part: compare(ABOVE, versus(cells(part, EVERYWHERE, PARTLY, MINUS), NONE)),
        BOTH,
        readings=(
            Reading(
                "but for f = b = 0.55, which the section excepts before",
                lambda part: compare(ABOVE, versus(cells(part, HARD, PARTLY, MINUS), NONE)),
            ),
        ),
    ),
)
