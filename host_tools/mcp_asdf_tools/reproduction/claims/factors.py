"""Claims of sections III and IV-B: what follows from the equations, and the factors of the behaviour."""

from __future__ import annotations

from itertools import combinations, pairwise

import numpy as np

from mcp_asdf.reference import local_confidence, local_estimate
from mcp_asdf_tools.reproduction.comparisons import (
    ABOVE,
    BOTH,
    DYNAMIC,
    EVERYWHERE,
    MINUS,
    OVER_AMBIGUOUS,
    PLUS,
    SAME,
    UNDER_CLEAR,
    Claim,
    Question,
    Reading,
    cells,
    compare,
    fact,
    versus_period,
)
from mcp_asdf_tools.reproduction.study import FLAWED_ACCURACIES, H_E, H_K, PERIODS, Cell, Part
from mcp_asdf_tools.reproduction.verdicts import Scope

_MANY = 100_000
"""Observations of a robot, enough to make the share of black what it is on average."""

_PRINTED = SAME.by(0.0005 + 1e-9)
"""Equal to the digits of Table I."""

_LOW, *_, _HIGH = FLAWED_ACCURACIES
_WIDEST = 0.505, 0.995
"""Of figure 2, as we draw it."""


def _seen_black(f: float, b: float) -> float:
    """p(z = 1), eq. 1."""
    return f * b + (1 - f) * (1 - b)


_SHARES = sorted({round(_seen_black(f, b), 9) for f, b in EVERYWHERE})
"""n/t of Table I."""


def _x_hat(share: float, b_hat: float) -> float:
    return local_estimate(round(share * _MANY), _MANY, b_hat)


def _alpha(share: float, b_hat: float) -> float:
    return local_confidence(round(share * _MANY), _MANY, b_hat)


def _observations(part: Part) -> list[Question]:
    printed = dict(zip(EVERYWHERE, (0.505, 0.545, 0.545, 0.905), strict=True))
    return [
        fact(_PRINTED, f"f {f:g}, b {b:g}", f"p(z = 1) less {p:.3f}", _seen_black(f, b) - p)
        for (f, b), p in printed.items()
    ]


def _local_estimates(part: Part) -> list[Question]:
    printed = {
        (0.55, 0.55): {0.55: 0.550, 0.75: 0.510, 0.95: 0.506},
        (0.55, 0.95): {0.95: 0.550, 0.75: 0.590, 0.55: 0.950},
        (0.95, 0.55): {0.55: 0.950, 0.75: 0.590, 0.95: 0.550},
        (0.95, 0.95): {0.95: 0.950, 0.75: 1.000, 0.55: 1.000},
    }
    return [
        fact(
            _PRINTED,
            f"f {f:g}, b {b:g}, b_hat {b_hat:g}",
            f"x_hat less {x_hat:.3f}",
            _x_hat(_seen_black(f, b), b_hat) - x_hat,
        )
        for (f, b), row in printed.items()
        for b_hat, x_hat in row.items()
    ]


def _growth(shares: list[float]) -> list[Question]:
    """The least ratio of alpha from one of many b_hat to the next, for each n/t."""
    accuracies = np.linspace(0.505, 0.995, 99)
    return [
        fact(
            ABOVE.by(1e-9),
            f"n/t {share:g}",
            "least ratio of alpha to that of a b_hat 0.005 lower, less 1",
            least,
        )
        for share in shares
        for least in [min(_alpha(share, high) / _alpha(share, low) for low, high in pairwise(accuracies)) - 1]
    ]


def _ratios(pairs: list[tuple[float, float]], shares: list[float], times: int) -> list[Question]:
    """How many times the confidence of one b_hat is that of another, at each n/t."""
    return [
        fact(
            ABOVE.by(1e-9),
            f"n/t {share:g}",
            f"alpha of b_hat {high:g} over that of {low:g}, less {times}",
            _alpha(share, high) / _alpha(share, low) - times,
        )
        for low, high in pairs
        for share in shares
    ]


def _slopes(part: Part) -> list[Question]:
    """How far x_hat moves while n/t goes from 0.505 to 0.515, which saturates no estimate."""
    low, high = (_x_hat(0.515, b_hat) - _x_hat(0.505, b_hat) for b_hat in (_LOW, _HIGH))
    return [
        fact(ABOVE.by(1e-9), "n/t 0.505 to 0.515", "change of x_hat: b_hat 0.55 less b_hat 0.95", low - high)
    ]


def _easier(part: Part) -> list[tuple[Cell, Cell]]:
    """All flawed, no filter: where f = b against the other f."""
    easy = cells(part, (OVER_AMBIGUOUS, UNDER_CLEAR), [100])
    return [(cell, cell.but(fill_ratio=1.5 - cell.fill_ratio)) for cell in easy]


def _higher_b_hat(part: Part) -> list[tuple[Cell, Cell]]:
    """All robots alike, no filter: each b_hat against the next lower one."""
    return [
        (Cell(part, f, b, high, 100 * (high != b)), Cell(part, f, b, low, 100 * (low != b)))
        for f, b in EVERYWHERE
        for low, high in pairwise(FLAWED_ACCURACIES)
    ]


FACTORS = (
    Claim(
        "confidence_increases_with_b_hat",
        "III-A, IV-B",
        "For a fixed n_i and t, the confidence increases with the assumed sensor accuracies",
        "alpha at b_hat from 0.505 to 0.995 in steps of 0.005, at each n/t of Table I",
        lambda part: _growth(_SHARES),
        readings=(
            Reading("any n/t from 0.05 to 0.95", lambda part: _growth([k / 20 for k in range(1, 20)])),
        ),
    ),
    Claim(
        "confidence_grows_a_hundredfold",
        "III-A, figure 2",
        "With a constant n/t, a higher b_hat robot has a local confidence value >100x greater than that of a "
        "lower b_hat robot",
        "alpha of each of the study's b_hat over each lower one, and of 0.995 over 0.505, at each n/t of "
        "Table I",
        lambda part: _ratios([*combinations(FLAWED_ACCURACIES, 2), _WIDEST], _SHARES, 100),
        readings=(
            Reading(
                "the most distant pair of the study, 0.55 and 0.95",
                lambda part: _ratios([(_LOW, _HIGH)], _SHARES, 100),
            ),
            Reading(
                "some pair, such as 0.505 and 0.995",
                lambda part: _ratios([_WIDEST], _SHARES, 100),
                Scope.SOME,
            ),
        ),
    ),
    Claim(
        "environment_improves_accuracy",
        "IV-B",
        "the local estimates under certain conditions are extremely close to the environment fill ratio, "
        "which is likely to improve estimation accuracy and convergence",
        "h_e where f = b against the other f, all robots flawed, no filter",
        lambda part: compare(ABOVE.of(H_E), _easier(part)),
        BOTH,
        Scope.MOST,
    ),
    Claim(
        "environment_improves_convergence",
        "IV-B",
        "the local estimates under certain conditions are extremely close to the environment fill ratio, "
        "which is likely to improve estimation accuracy and convergence",
        "h_K where f = b against the other f, all robots flawed, no filter",
        lambda part: compare(ABOVE.of(H_K), _easier(part)),
        BOTH,
        Scope.MOST,
    ),
    Claim(
        "low_b_hat_is_volatile",
        "IV-B",
        "With a similar average number of black tiles observed n/t, the rate of change in x_hat is higher "
        "for the robot with a lower b_hat",
        "the change of x_hat with n/t, at b_hat = 0.55 against 0.95",
        _slopes,
    ),
    Claim(
        "low_b_hat_is_slow",
        "IV-B",
        "the robot with a more volatile local estimate would suffer from a slower informed estimate "
        "convergence with minimal neighbor contact",
        "h_K of each b_hat against the next lower one, all robots alike, no filter",
        lambda part: compare(ABOVE.of(H_K), _higher_b_hat(part)),
        (DYNAMIC,),
    ),
    Claim(
        "short_periods_are_better",
        "IV-B",
        "With shorter nominal filtering periods [...], the estimation performance performs better than "
        "longer periods overall",
        "H at tau = 1000 against 4000, both filters, P = 10 to 50 %",
        lambda part: compare(
            ABOVE,
            versus_period([cell for each in (MINUS, PLUS) for cell in cells(part, filter=each)], PERIODS[-1]),
        ),
        BOTH,
        Scope.MOST,
    ),
    Claim(
        "table_of_observations",
        "IV-B, table I",
        "p(z = 1) = n/t = 0.505 [...] 0.545 [...] 0.905",
        "eq. 1, to the printed digits",
        _observations,
    ),
    Claim(
        "table_of_local_estimates",
        "IV-B, table I",
        "x_hat = 0.550, b_hat = b; 0.510, b_hat = b + 0.2; 0.506, b_hat = b + 0.4 [...]",
        "eq. 3, to the printed digits",
        _local_estimates,
    ),
)
