"""Claims of section IV-C, and of VI on the same: swarms without a filter."""

from __future__ import annotations

import numpy as np

from mcp_asdf_tools.reproduction.comparisons import (
    ABOVE,
    BELOW,
    DYNAMIC,
    FULLY_CONNECTED,
    HARD,
    MUCH,
    NOT_BELOW,
    OVER,
    OVER_AMBIGUOUS,
    OVER_CLEAR,
    PARTLY,
    SAME,
    SIMILAR,
    UNDER,
    UNDER_AMBIGUOUS,
    UNDER_CLEAR,
    UP_TO_HALF,
    Claim,
    Difference,
    Fact,
    Question,
    Reading,
    cells,
    compare,
    falls,
    rises,
    versus_dynamic,
    versus_flawless,
    versus_percent,
)
from mcp_asdf_tools.reproduction.study import H_E, H_K, Cell, Part, Study, cells_of
from mcp_asdf_tools.reproduction.verdicts import Expectation, Place, Scope


def _only_slightly_less_accurate(part: Part) -> list[Question]:
    pairs = versus_flawless(cells(part, [OVER_AMBIGUOUS]))
    return [*compare(ABOVE.of(H_K), pairs), *compare(NOT_BELOW.of(H_E).by(MUCH), pairs)]


def _trade(part: Part) -> list[Question]:
    pairs = versus_flawless(cells(part, OVER))
    clear = [(cell, cell.but(fill_ratio=0.55)) for cell in cells(part, [OVER_CLEAR])]
    return [
        *compare(ABOVE.of(H_K), pairs),
        *compare(BELOW.of(H_E), pairs),
        *compare(BELOW.of(H_E), clear),
    ]


def _symmetric_errors(part: Part) -> list[Question]:
    pair = (Cell(part, 0.95, 0.55, 0.95, 100), Cell(part, 0.55, 0.95, 0.55, 100))
    return [
        *compare(ABOVE.of(H_K), [pair]),
        *compare(SAME.of(H_E).by(SIMILAR), [pair]),
        *compare(ABOVE, [pair]),
    ]


def _saturated(part: Part) -> list[Question]:
    pairs = versus_percent(cells(part, [UNDER_CLEAR], [100]), *PARTLY)
    return [*compare(ABOVE.of(H_K), pairs), *compare(ABOVE, pairs)]


def _on_top_of_each_other(part: Part) -> list[Question]:
    pair = (Cell(part, 0.95, 0.95, 0.55, 100), Cell(part, 0.95, 0.95, 0.75, 100))
    return [*compare(SAME.of(H_K), [pair]), *compare(SAME.of(H_E), [pair])]


def _identical(part: Part) -> list[Question]:
    def largest(study: Study, name: str) -> float:
        return max(float(np.ptp(getattr(trials, name), axis=1).max()) for trials in study.of(part))

    everything = cells_of(part)[:1]  # of the cells one is enough to say which part is needed
    return [
        Fact(
            Expectation.SAME,
            Place("all cells", f"largest {letter} in a trial less the smallest"),
            1e-9,
            lambda study, name=name: largest(study, name),  # type: ignore[misc]
            everything,
        )
        for letter, name in (("K", "convergence_steps"), ("e", "errors"))
    ]


def _losses(part: Part) -> list[Question]:
    """Loss from P = 0 to P = 50 %, less that of a fully connected swarm."""
    questions: list[Question] = []
    for cell in cells(part, HARD, [50]):
        there = cell.but(part=FULLY_CONNECTED)
        row = f"f {cell.fill_ratio:g}, b {cell.true_accuracy:g}, b_hat {cell.flawed_accuracy:g}"
        place = Place(row, "loss of H from P 0 to 50 %, no filter: dynamic less fully connected")
        plus, minus = (cell.but(percent=0), there), (cell, there.but(percent=0))
        questions.append(Difference(ABOVE, place, plus, minus))
    return questions


BASELINE = (
    Claim(
        "flawed_robots_harm",
        "IV-C, figure 3a",
        "Between P = 0% to 50% [...], a swarm's ability to provide accurate and timely estimates "
        "deteriorates with an increasing percentage of flawed robots. An exception to this is when f = "
        "0.55, b = 0.55",
        "H of each P against the next lower one, and of 50 % against 0, but for f = b = 0.55",
        lambda part: falls(cells(part, HARD, [0]), UP_TO_HALF),
        (DYNAMIC,),
    ),
    Claim(
        "flawed_robots_harm_substantially",
        "VI",
        "The overall estimation performance suffers substantially when robots have an incorrect assumed "
        "accuracy, though by pure chance an ambiguous environment allows overconfident robots to thrive",
        "H against a flawless swarm, P = 10 to 50 %, but for f = b = 0.55: lower by 10",
        lambda part: compare(BELOW.by(MUCH), versus_flawless(cells(part, HARD))),
        (DYNAMIC,),
        Scope.MOST,
    ),
    Claim(
        "overconfident_robots_help_where_easy",
        "IV-C, figure 3a",
        "where we observe performance improving with more overconfident robots",
        "H of each P against the next lower one, and of 50 % against 0, where f = b = 0.55",
        lambda part: rises(cells(part, [OVER_AMBIGUOUS], [0]), UP_TO_HALF),
        (DYNAMIC,),
    ),
    Claim(
        "any_flawed_robots_help_where_easy",
        "IV-C, figure 3a",
        "having any number of flawed robots improves performance over a flawless swarm",
        "H against a flawless swarm, P = 10 to 100 %, where f = b = 0.55",
        lambda part: compare(ABOVE, versus_flawless(cells(part, [OVER_AMBIGUOUS], (*PARTLY, 100)))),
        (DYNAMIC,),
    ),
    Claim(
        "speed_costs_little_accuracy_where_easy",
        "IV-C",
        "further enhances the speed of converging onto an estimate that is only slightly less accurate",
        "h_K against a flawless swarm: higher; h_e: lower by less than 10; where f = b = 0.55",
        _only_slightly_less_accurate,
        (DYNAMIC,),
    ),
    Claim(
        "overconfident_swarms_trade_accuracy_for_speed",
        "figure 4a",
        "In general, swarms with overconfident robots (blue dots) trade accuracy for convergence speed with "
        "the increase of flawed robots, though more so in an unambiguous environment (f = 0.95) than in an "
        "ambiguous one (f = 0.55)",
        "h_K against a flawless swarm: higher; h_e: lower; h_e at f = 0.95 against 0.55: lower",
        _trade,
        (DYNAMIC,),
        Scope.MOST,
    ),
    Claim(
        "underconfident_swarms_may_thrive",
        "figure 4a",
        "Swarms with underconfident robots (red/orange dots), however, may thrive with more flawed robots "
        "depending on environmental conditions",
        "H against a flawless swarm, P = 10 to 100 %: higher in some cell",
        lambda part: compare(ABOVE, versus_flawless(cells(part, UNDER, (*PARTLY, 100)))),
        (DYNAMIC,),
        Scope.SOME,
        readings=(
            Reading(
                "h_K alone, which figure 4 shows beside h_e",
                lambda part: compare(ABOVE.of(H_K), versus_flawless(cells(part, UNDER, (*PARTLY, 100)))),
                Scope.SOME,
            ),
        ),
    ),
    Claim(
        "entirely_flawed_swarms_do_better",
        "IV-C, figure 3b",
        "an entire swarm of flawed robots (P = 100%) performs better than in situations where only some or "
        "none of the robots are flawed (P < 100%), for almost all the cases",
        "H of P = 100 % against 0, 10, 30 and 50 %",
        lambda part: compare(ABOVE, versus_percent(cells(part, percents=[100]), *UP_TO_HALF)),
        (DYNAMIC,),
        Scope.MOST,
    ),
    Claim(
        "symmetric_errors_differ_in_speed",
        "IV-C, figure 4a",
        "the entire swarm of flawed, overconfident robots converges faster on an informed estimate than the "
        "underconfident ones [...]. Notice also that the estimate accuracy is comparable between the two",
        "f = 0.95, b_hat = b + 0.4 against f = 0.55, b_hat = b - 0.4: h_K and H higher, h_e within 5",
        _symmetric_errors,
        (DYNAMIC,),
    ),
    Claim(
        "entirely_underconfident_swarms_are_volatile",
        "IV-C",
        "when the entire swarm is underconfident at f = 0.55, the Volatility Factor dominates: the local "
        "estimate is more volatile with a lower b_hat",
        "h_K of P = 100 % against a flawless swarm: lower",
        lambda part: compare(BELOW.of(H_K), versus_flawless(cells(part, [UNDER_AMBIGUOUS], [100]))),
        (DYNAMIC,),
    ),
    Claim(
        "saturated_estimates_converge_fast",
        "IV-C, figure 4a",
        "this removes much of the volatility and accelerates convergence, hence the high performance score",
        "underconfident, f = 0.95: h_K and H of P = 100 % against 10, 30 and 50 %",
        _saturated,
        (DYNAMIC,),
    ),
    Claim(
        "saturated_estimates_coincide",
        "figure 4a",
        "in the bottom right panel data points for both underconfident cases are atop each other",
        "f = 0.95, P = 100 %: h_K and h_e of b_hat = 0.55 and 0.75, within 2",
        _on_top_of_each_other,
        (DYNAMIC,),
    ),
    Claim(
        "connected_overconfident_score_higher",
        "IV-C, figure 5a",
        "The performance of fully connected, overconfident robots are largely similar (besides the expected "
        "positive offset) to those in the dynamic topology experiments",
        "H against the dynamic swarm, P = 10 to 50 %: higher",
        lambda part: compare(ABOVE, versus_dynamic(cells(part, OVER))),
        (FULLY_CONNECTED,),
    ),
    Claim(
        "connected_overconfident_rise_where_easy",
        "IV-C, figure 5a",
        "it gradually increases when the environment is ambiguous (top left)",
        "H of each P against the next lower one, and of 50 % against 0",
        lambda part: rises(cells(part, [OVER_AMBIGUOUS], [0]), UP_TO_HALF),
        (FULLY_CONNECTED,),
    ),
    Claim(
        "connected_overconfident_fall_where_clear",
        "IV-C, figure 5a",
        "it falls with the rise of flawed robot proportions when the environment is unambiguous (bottom "
        "left)",
        "H of each P against the next lower one, and of 50 % against 0",
        lambda part: falls(cells(part, [OVER_CLEAR], [0]), UP_TO_HALF),
        (FULLY_CONNECTED,),
    ),
    Claim(
        "connected_underconfident_outdo_dynamic",
        "IV-C, figure 5a",
        "fully connected, underconfident robots outdo their dynamic topology counterparts substantially",
        "H against the dynamic swarm, P = 10 to 50 %: higher by 10",
        lambda part: compare(ABOVE.by(MUCH), versus_dynamic(cells(part, UNDER))),
        (FULLY_CONNECTED,),
    ),
    Claim(
        "connected_underconfident_do_no_harm",
        "IV-C, figure 5a",
        "the growing number of flawed robots does not weaken informed estimation performance in any way",
        "underconfident: H against a flawless swarm, P = 10 to 50 %: not lower",
        lambda part: compare(NOT_BELOW, versus_flawless(cells(part, UNDER))),
        (FULLY_CONNECTED,),
    ),
    Claim(
        "connected_underconfident_fail_together",
        "IV-C, figure 5a",
        "until when all robots are flawed",
        "underconfident: H of P = 100 % against a flawless swarm: lower",
        lambda part: compare(BELOW, versus_flawless(cells(part, UNDER, [100]))),
        (FULLY_CONNECTED,),
    ),
    Claim(
        "connected_estimates_are_identical",
        "IV-C",
        "the informed estimate computed in [eq. 6] is identical for every robot",
        "K and e of the robots of each trial",
        _identical,
        (FULLY_CONNECTED,),
    ),
    Claim(
        "localized_swarms_decline_more",
        "IV-C",
        "The performance decline is especially pronounced for swarms meant for field deployments: with only "
        "localized communication available",
        "what H loses from P = 0 to 50 %, against a fully connected swarm, but for f = b = 0.55",
        _losses,
        (DYNAMIC,),
    ),
)
