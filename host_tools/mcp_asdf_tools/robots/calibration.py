"""A ground sensor's threshold and accuracy, from readings over tiles whose colour is known."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from itertools import pairwise

from mcp_asdf_tools.common.errors import UsageError

_FEWEST = 10
_MOST_BIAS = 0.02
_LEAST_ACCURACY = 0.55


@dataclass(frozen=True)
class Calibration:
    """What a sensor is worth with its best threshold.

    Attributes:
        threshold: Readings below it are on one side; a whole number if all readings are.
        black_is: The side on which a tile is taken for black, ``below`` or ``above``.
        accuracy: Share of the readings that are on the right side, over black and over white tiles.
        readings: How many there are over each.
    """

    threshold: float
    black_is: str
    accuracy: dict[str, float]
    readings: dict[str, int]

    @property
    def b_hat(self) -> float:
        """To start with: the mean of both accuracies, each (right + 1) / (readings + 2), so never 1."""
        return sum((p * n + 1) / (n + 2) for p, n in self._colours()) / 2

    @property
    def uncertainty(self) -> float:
        """Half the width of the 95 % interval of ``b_hat``, at least that of one wrong reading a colour."""
        return 0.98 * math.sqrt(sum(max(p * (1 - p), 1 / n) / n for p, n in self._colours()))

    @property
    def bias(self) -> float:
        """How much too black such sensors show every floor, since the method knows one accuracy.

        With b + d on black and b - d on white, black is seen with probability f b + (1 - f)(1 - b) + d, from
        which eq. 3 makes f + d / (2 b - 1).
        """
        black, white = self.accuracy.values()
        return (black - white) / 2 / (black + white - 1)

    @property
    def warning(self) -> str | None:
        """What to do where the colours differ so much that estimates are off by more than 0.02."""
        if abs(self.bias) <= _MOST_BIAS:
            return None
        return (
            f"the colours differ too much: x_hat is off by {self.bias:+.3f} on every floor, whatever b_hat; "
            "change the sensor's height or the light, or paint the worse colour anew"
        )

    def _colours(self) -> Iterable[tuple[float, int]]:
        return zip(self.accuracy.values(), self.readings.values(), strict=True)


def calibrate(rows: Sequence[tuple[float, bool]]) -> Calibration:
    """The threshold with which the worse colour is seen best; of several the one in the widest gap.

    O(n log n). Raises UsageError for too few readings, and for some that do not tell the colours apart.
    """
    black = sum(is_black for _, is_black in rows)
    readings = {"black": black, "white": len(rows) - black}
    for colour, count in readings.items():
        if count < _FEWEST:
            raise UsageError(f"{count} readings over {colour} tiles; take {_FEWEST} or more, better 1000")
    is_whole = all(reading.is_integer() for reading, _ in rows)
    best, found, below = (0.0, 0.0, 0.0), None, [0, 0]
    for (low, is_black), (high, _) in pairwise(sorted(rows)):
        below[is_black] += 1
        threshold = math.ceil((low + high) / 2) if is_whole else low + (high - low) / 2
        right = below[1] / black, 1 - below[0] / readings["white"]
        for side, pair in (("below", right), ("above", (1 - right[0], 1 - right[1]))):
            rank = (min(pair), sum(pair), high - low)
            if low < high and rank > best:
                accuracy = dict(zip(readings, pair, strict=True))
                best, found = rank, Calibration(threshold, side, accuracy, readings)
    if found is None or best[1] < 2 * _LEAST_ACCURACY:
        raise UsageError("the readings do not tell black from white; does the sensor look at the floor?")
    return found
