"""The floor of the physical experiments: like a QR code, with exactly the wanted share of black."""

from __future__ import annotations

from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from mcp_asdf_tools.common.parameters import ParameterError

CODE_MODULES = 100
"""Modules along a side of ``code``."""

_FINDER, _LOGO = 7, 32
_SEED = 448


@lru_cache(maxsize=8)
def code(fill_ratio: float) -> NDArray[np.bool_]:
    """A pattern like a QR code's, True where black, shape (CODE_MODULES, CODE_MODULES).

    It has finder patterns in three corners, timing lines between them and a white logo in the middle, so
    large that half of the other modules are black where ``fill_ratio`` is 0.448. Of all modules exactly the
    share ``fill_ratio`` is black, at places that are always the same. Raises
    ParameterError if that is no whole number of modules or leaves nothing to chance. O(modules).
    """
    size = CODE_MODULES**2
    blacks = round(fill_ratio * size)
    if abs(blacks - fill_ratio * size) > 1e-9 * size:
        raise ParameterError(
            "fill_ratio",
            f"fill_ratio is {fill_ratio}; a floor of {size} modules needs a multiple of {1 / size:g}",
        )
    pattern, is_fixed = _fixed_patterns()
    free = np.flatnonzero(~is_fixed)
    missing = blacks - int(pattern.sum())
    if not 0 <= missing <= len(free):
        least, most = pattern.sum() / size, (pattern.sum() + len(free)) / size
        message = f"fill_ratio is {fill_ratio}; this floor can have {least:g} to {most:g}"
        raise ParameterError("fill_ratio", message)
    chosen = np.random.Generator(np.random.PCG64(_SEED)).permutation(free)[:missing]
    pattern.flat[chosen] = True
    return pattern


def _fixed_patterns() -> tuple[NDArray[np.bool_], NDArray[np.bool_]]:
    """Patterns that every code has, and their places."""
    n, far = CODE_MODULES, CODE_MODULES - _FINDER
    black, fixed = np.zeros((n, n), np.bool_), np.zeros((n, n), np.bool_)
    finder = np.ones((_FINDER, _FINDER), np.bool_)
    finder[1:-1, 1:-1] = False
    finder[2:-2, 2:-2] = True
    for row, column in ((0, 0), (0, far), (far, 0)):
        black[row : row + _FINDER, column : column + _FINDER] = finder
        fixed[max(0, row - 1) : row + _FINDER + 1, max(0, column - 1) : column + _FINDER + 1] = True
    line, between = _FINDER - 1, slice(_FINDER + 1, far - 1)
    black[line, between] = black[between, line] = np.arange(between.stop - between.start) % 2 == 0
    fixed[line, between] = fixed[between, line] = True
    middle = slice((n - _LOGO) // 2, (n + _LOGO) // 2)
    fixed[middle, middle] = True
    return black, fixed
