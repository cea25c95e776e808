"""Floors with a picture: one like a QR code with exactly the wanted share of black, and image files."""

from __future__ import annotations

import hashlib
from functools import lru_cache
from io import BytesIO
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from mcp_asdf_tools.common import UsageError

CODE_MODULES = 100
"""Modules along a side of ``code``."""

_FINDER, _LOGO = 7, 32
_BLACK_BELOW = 128
_SEED = 448


class ImageFile(NamedTuple):
    """A picture as read: True where black, shape (rows, columns), and the file's SHA-256."""

    pixels: NDArray[np.bool_]
    sha256: str


@lru_cache(maxsize=8)
def code(fill_ratio: float) -> NDArray[np.bool_]:
    """A pattern like a QR code's, True where black, shape (CODE_MODULES, CODE_MODULES).

    It has finder patterns in three corners, timing lines between them and a white logo in the middle, so
    large that half of the other modules are black where ``fill_ratio`` is 0.448. Of all modules exactly the
    share ``fill_ratio`` is black, at places that are always the same. Raises
    UsageError if that is no whole number of modules or leaves nothing to chance. O(modules).
    """
    size = CODE_MODULES**2
    blacks = round(fill_ratio * size)
    if abs(blacks - fill_ratio * size) > 1e-9 * size:
        raise UsageError(
            f"fill_ratio is {fill_ratio}; a floor of {size} modules needs a multiple of {1 / size:g}"
        )
    pattern, is_fixed = _fixed_patterns()
    free = np.flatnonzero(~is_fixed)
    missing = blacks - int(pattern.sum())
    if not 0 <= missing <= len(free):
        least, most = pattern.sum() / size, (pattern.sum() + len(free)) / size
        raise UsageError(f"fill_ratio is {fill_ratio}; this floor can have {least:g} to {most:g}")
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


def read_picture(path: str) -> ImageFile:
    """A picture in any common format; what is darker than a middle grey is black.

    Raises UsageError if it cannot be read.
    """
    from PIL import Image  # noqa: PLC0415 (loads slowly)

    try:
        content = Path(path).read_bytes()
        with Image.open(BytesIO(content)) as image:
            grey = np.asarray(image.convert("L"))
    except Exception as error:  # readers raise errors of any kind
        raise UsageError(f"cannot read the picture {path}: {error}") from error
    return ImageFile(grey < _BLACK_BELOW, hashlib.sha256(content).hexdigest())


def picture_of(path: str, sha256: str) -> NDArray[np.bool_]:
    """The pixels of a picture that must be the one with this SHA-256.

    Raises UsageError if it cannot be read or has changed.
    """
    image = read_picture(path)
    if image.sha256 != sha256:
        raise UsageError(f"{path} is not the picture of the experiment any more (SHA-256 {sha256[:12]}...)")
    return image.pixels
