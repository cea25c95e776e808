"""Facts about the paper's claims that follow from the equations and are not subject to chance."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from itertools import combinations, pairwise
from math import pi

import numpy as np

from mcp_asdf.reference import local_confidence, local_estimate
from mcp_asdf_tools.reproduction.study import FLAWED_ACCURACIES

Fact = tuple[str, str, float]
"""Row and column of its place, and a number."""

_MANY = 100_000
"""Observations of a robot, enough to make the share of black what it is on average."""

_PANELS = ((0.55, 0.55), (0.95, 0.55), (0.55, 0.95), (0.95, 0.95))
_WIDEST = 0.505, 0.995
"""Range of b_hat in figure 2, as we draw it."""

_PRINTED_SHARES = (0.505, 0.545, 0.545, 0.905)
_PRINTED_ESTIMATES = {
    (0.55, 0.55): {0.55: 0.550, 0.75: 0.510, 0.95: 0.506},
    (0.55, 0.95): {0.95: 0.550, 0.75: 0.590, 0.55: 0.950},
    (0.95, 0.55): {0.55: 0.950, 0.75: 0.590, 0.95: 0.550},
    (0.95, 0.95): {0.95: 0.950, 0.75: 1.000, 0.55: 1.000},
}
"""Digits of Table I: n/t by panel, and x_hat by panel and b_hat."""


def _seen_black(f: float, b: float) -> float:
    """p(z = 1), eq. 1."""
    return f * b + (1 - f) * (1 - b)


def _table_shares() -> list[float]:
    """n/t of Table I, each once."""
    return sorted({round(_seen_black(f, b), 9) for f, b in _PANELS})


def _x_hat(share: float, b_hat: float) -> float:
    return local_estimate(round(share * _MANY), _MANY, b_hat)


def _alpha(share: float, b_hat: float) -> float:
    return local_confidence(round(share * _MANY), _MANY, b_hat)


def _observations() -> Iterable[Fact]:
    for (f, b), printed in zip(_PANELS, _PRINTED_SHARES, strict=True):
        yield f"f {f:g}, b {b:g}", f"p(z = 1) less {printed:.3f}", _seen_black(f, b) - printed


def _local_estimates() -> Iterable[Fact]:
    for (f, b), row in _PRINTED_ESTIMATES.items():
        for b_hat, printed in row.items():
            x_hat = _x_hat(_seen_black(f, b), b_hat)
            yield f"f {f:g}, b {b:g}, b_hat {b_hat:g}", f"x_hat less {printed:.3f}", x_hat - printed


def _growth(shares: Sequence[float]) -> Iterable[Fact]:
    """The least ratio of alpha from one of many b_hat to the next, for each n/t."""
    for share in shares:
        alphas = [_alpha(share, b_hat) for b_hat in np.linspace(0.505, 0.995, 99)]
        least = min(high / low for low, high in pairwise(alphas))
        yield f"n/t {share:g}", "least ratio of alpha to that of a b_hat 0.005 lower, less 1", least - 1


def _ratios(pairs: Iterable[tuple[float, float]], claimed: int = 100) -> Iterable[Fact]:
    """How many times the confidence of one b_hat is that of another, at each n/t of Table I."""
    for low, high in pairs:
        for share in _table_shares():
            ratio = _alpha(share, high) / _alpha(share, low)
            yield (
                f"n/t {share:g}",
                f"alpha of b_hat {high:g} over that of {low:g}, less {claimed}",
                ratio - claimed,
            )


def _slopes() -> Iterable[Fact]:
    """How far x_hat moves while n/t goes from 0.505 to 0.515, which saturates no estimate."""
    low, high = (_x_hat(0.515, b_hat) - _x_hat(0.505, b_hat) for b_hat in (0.55, 0.95))
    yield "n/t 0.505 to 0.515", "change of x_hat: b_hat 0.55 less b_hat 0.95", low - high


FACTS: Mapping[str, Callable[[], Iterable[Fact]]] = {
    "table I, observations": _observations,
    "table I, local estimates": _local_estimates,
    "growth of confidence, table I": lambda: _growth(_table_shares()),
    "growth of confidence, any n/t": lambda: _growth([k / 20 for k in range(1, 20)]),
    "ratios of confidence, all pairs": lambda: _ratios([*combinations(FLAWED_ACCURACIES, 2), _WIDEST]),
    "ratios of confidence, 0.55 and 0.95": lambda: _ratios([(0.55, 0.95)]),
    "ratios of confidence, 0.505 and 0.995": lambda: _ratios([_WIDEST]),
    "ratios of confidence, underconfident robots": lambda: _ratios([(0.55, 0.95), (0.75, 0.95)], 1),
    "change of x_hat": _slopes,
    "density of section V": lambda: [("", "D less 1.3", 8 * pi * 0.7**2 / (3.0353 * 3.0226) - 1.3)],
    "observations of section V": lambda: [("", "ratio less 20", 40_000 / (1000 * 2) - 20)],
}
"""Names as ``claims.toml`` has them."""
