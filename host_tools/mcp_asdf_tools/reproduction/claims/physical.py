"""Claims of section V: eight robots on a code, for 1000 s."""

from __future__ import annotations

from math import pi

from mcp_asdf_tools.reproduction.comparisons import (
    ABOVE,
    DYNAMIC,
    MUCH,
    NONE,
    NOT_ABOVE,
    NOT_BELOW,
    PHYSICAL,
    PLUS,
    POOR,
    QUITE_HIGH,
    SAME,
    SIMILAR,
    Claim,
    Question,
    against,
    compare,
    fact,
    physical_cells,
    versus,
    versus_percent,
)
from mcp_asdf_tools.reproduction.study import H_E, H_K, Cell, Part
from mcp_asdf_tools.reproduction.verdicts import Scope


def _is_exception(cell: Cell) -> bool:
    return cell.percent == 100 and cell.flawed_accuracy == 0.55


def _no_effect(part: Part) -> list[Question]:
    """Similar scores, and a slight difference at most in the exception."""
    pairs = versus(physical_cells(PLUS), NONE)
    return [
        *compare(SAME.by(SIMILAR), [pair for pair in pairs if not _is_exception(pair[0])]),
        *compare(SAME.by(MUCH), [pair for pair in pairs if _is_exception(pair[0])]),
    ]


def _distinction(part: Part) -> list[Question]:
    pairs = versus(filter(_is_exception, physical_cells(PLUS)), NONE)
    return [*compare(ABOVE.of(H_K), pairs), *compare(SAME.of(H_E).by(SIMILAR), pairs)]


def _comparable(part: Part) -> list[Question]:
    pairs = versus([cell for cell in physical_cells(PLUS) if cell.percent < 100], NONE)
    return [*compare(SAME.of(H_K).by(SIMILAR), pairs), *compare(SAME.of(H_E).by(SIMILAR), pairs)]


def _longer(part: Part) -> list[Question]:
    return compare(
        ABOVE.of(H_K).by(MUCH),
        [
            (Cell(DYNAMIC, 0.55, 0.95, cell.flawed_accuracy, cell.percent, PLUS), cell)
            for cell in physical_cells(PLUS)
            if cell.percent in (0, 50, 100) and (not cell.percent or cell.flawed_accuracy < 0.95)
        ],
    )


PHYSICAL_EXPERIMENT = (
    Claim(
        "physical_density",
        "V-A",
        "the swarm density is D ~ 1.3",
        "N pi r^2 over the platform's area, to the printed digit",
        lambda part: [fact(SAME.by(0.05), "", "D less 1.3", 8 * pi * 0.7**2 / (3.0353 * 3.0226) - 1.3)],
    ),
    Claim(
        "physical_observations",
        "V-B",
        "the amount of observations t made by the robots in the physical experiments is 20 times fewer than "
        "those in the simulated experiments",
        "40 000 steps over 1000 s at 2 Hz",
        lambda part: [fact(SAME.by(0.5), "", "ratio less 20", 40_000 / (1000 * 2) - 20)],
    ),
    Claim(
        "plus_has_no_effect_in_short_runs",
        "V-B, figure 8a",
        "the filter usage has no effect on the estimation performance [...] across all proportions of "
        "flawed robots P and flawed assumed accuracies b_hat that we tested, bar a slight difference in the "
        "P = 100%, b_hat = 0.55 case",
        "H against no filter: within 5, there within 10",
        _no_effect,
        (PHYSICAL,),
    ),
    Claim(
        "plus_speeds_up_the_exception",
        "V-B, figure 8b",
        "this minor distinction is due to the improved convergence performance, but accuracy levels are "
        "similar",
        "P = 100 %, b_hat = 0.55, against no filter: h_K higher, h_e within 5",
        _distinction,
        (PHYSICAL,),
    ),
    Claim(
        "short_runs_are_comparable_with_and_without_filter",
        "figure 8b",
        "their convergence (h_K) scores and accuracy (h_e) scores are comparable, except at P = 100%",
        "h_K and h_e against no filter: within 5",
        _comparable,
        (PHYSICAL,),
    ),
    Claim(
        "short_runs_are_accurate",
        "V-B, figure 8b",
        "accuracy scores are quite high for all the baseline and ASDF+ cases",
        "h_e of 80 or more",
        lambda part: against(NOT_BELOW.of(H_E), physical_cells(NONE, PLUS), QUITE_HIGH),
        (PHYSICAL,),
    ),
    Claim(
        "short_runs_converge_poorly",
        "V-B, figure 8b",
        "but convergence scores are poor",
        "h_K of 50 or less",
        lambda part: against(NOT_ABOVE.of(H_K), physical_cells(NONE, PLUS), POOR),
        (PHYSICAL,),
    ),
    Claim(
        "longer_runs_converge_better",
        "V-B, figure 4b",
        "the underconfident robots' convergence scores at f = 0.55 are significantly higher",
        "h_K of the simulated swarm with ASDF+ and the same b_hat and P: higher by 10",
        _longer,
        (PHYSICAL,),
    ),
    Claim(
        "short_runs_do_not_depend_on_p",
        "V-B, figure 8a",
        "the largely identical performance across increasing P",
        "H against P = 0, with and without filter: within 5",
        lambda part: compare(
            SAME.by(SIMILAR),
            versus_percent([cell for cell in physical_cells(NONE, PLUS) if cell.percent], 0),
        ),
        (PHYSICAL,),
        Scope.MOST,
    ),
    Claim(
        "plus_does_no_harm_in_short_runs",
        "V-B, VI",
        "these results show that the application of the ASDF+ does not harm a swarm's estimation "
        "performance in the short term",
        "H against no filter: not lower",
        lambda part: compare(NOT_BELOW, versus(physical_cells(PLUS), NONE)),
        (PHYSICAL,),
    ),
)
