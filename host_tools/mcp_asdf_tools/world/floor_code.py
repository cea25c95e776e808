"""The floor of the physical experiments: a pattern like a QR code's with an exact share of black."""

from __future__ import annotations

from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from mcp_asdf_tools.common.parameters import ParameterError

CODE_MODULES = 100
"""Modules along a side of the pattern; a module is its smallest square."""

_FINDER_MODULES = 7
"""Modules along a side of a finder pattern."""
_LAST_FINDER = CODE_MODULES - _FINDER_MODULES
"""First row of the finder pattern at the lower edge, and first column of the one at the right edge."""
_LOGO_MODULES = 32
"""Modules along a side of the logo. At this size half of the modules outside the fixed patterns are black
where the fill ratio is 0.448."""
_SEED = 448
"""Seed of the modules that are black outside the fixed patterns."""


@lru_cache(maxsize=8)
def make_floor_code(fill_ratio: float) -> NDArray[np.bool_]:
    """Return a pattern like a QR code's, True where black, shape (CODE_MODULES, CODE_MODULES).

    It has finder patterns in three corners, timing lines between them and a white logo in the middle. Of all
    modules exactly the share ``fill_ratio`` is black: those of the fixed patterns, and others that are always
    the same ones. Equal calls return the same array, so do not change it. Raises ParameterError if that share
    is no whole number of modules, or fewer or more than the fixed patterns leave open. O(modules).
    """
    black_modules = _count_black_modules(fill_ratio)
    pattern, is_fixed = _fixed_patterns()
    free_modules = np.flatnonzero(~is_fixed)
    fewest_black = int(pattern.sum())
    most_black = fewest_black + len(free_modules)
    if not fewest_black <= black_modules <= most_black:
        limits = f"{fewest_black / pattern.size:g} to {most_black / pattern.size:g}"
        raise ParameterError("fill_ratio", f"fill_ratio is {fill_ratio}; this floor can have {limits}")
    # The seed is not the experiment's, so that the same modules are black in all trials.
    random_generator = np.random.Generator(np.random.PCG64(_SEED))
    shuffled_modules = random_generator.permutation(free_modules)
    pattern.flat[shuffled_modules[: black_modules - fewest_black]] = True
    return pattern


def _count_black_modules(fill_ratio: float) -> int:
    """Return the number of black modules of a pattern in which the share ``fill_ratio`` is black.

    Raises ParameterError if that share is no whole number of modules.
    """
    modules = CODE_MODULES**2
    black_modules = round(fill_ratio * modules)
    # A share such as 0.448 is no exact float, so its product may be a little off the whole number.
    if abs(black_modules - fill_ratio * modules) > 1e-9 * modules:
        raise ParameterError(
            "fill_ratio",
            f"fill_ratio is {fill_ratio}; a floor of {modules} modules needs a multiple of {1 / modules:g}",
        )
    return black_modules


def _fixed_patterns() -> tuple[NDArray[np.bool_], NDArray[np.bool_]]:
    """Return which modules are black in the patterns that every code has, and which belong to them.

    The patterns are three finders, two timing lines and the logo. Both arrays have the shape (CODE_MODULES,
    CODE_MODULES).
    """
    is_black = np.zeros((CODE_MODULES, CODE_MODULES), np.bool_)
    is_fixed = np.zeros((CODE_MODULES, CODE_MODULES), np.bool_)
    finder = _finder()
    for row, column in ((0, 0), (0, _LAST_FINDER), (_LAST_FINDER, 0)):
        end_row = row + _FINDER_MODULES
        end_column = column + _FINDER_MODULES
        is_black[row:end_row, column:end_column] = finder
        # With the margin, which the edge of the code cuts off on two sides.
        is_fixed[max(0, row - 1) : end_row + 1, max(0, column - 1) : end_column + 1] = True
    # A timing line leads from margin to margin of two finders, level with their inner edges. Its modules are
    # black and white in turn, the first one black.
    inner_edge = _FINDER_MODULES - 1
    line = slice(_FINDER_MODULES + 1, _LAST_FINDER - 1)
    timing_line = np.arange(line.stop - line.start) % 2 == 0
    is_black[inner_edge, line] = timing_line
    is_black[line, inner_edge] = timing_line
    is_fixed[inner_edge, line] = True
    is_fixed[line, inner_edge] = True
    # The logo is white, as modules are from the start.
    logo = slice((CODE_MODULES - _LOGO_MODULES) // 2, (CODE_MODULES + _LOGO_MODULES) // 2)
    is_fixed[logo, logo] = True
    return is_black, is_fixed


def _finder() -> NDArray[np.bool_]:
    """Return a finder pattern, True where black: a frame around a square, with a white line between them."""
    finder = np.ones((_FINDER_MODULES, _FINDER_MODULES), np.bool_)
    finder[1:-1, 1:-1] = False
    finder[2:-2, 2:-2] = True
    return finder
