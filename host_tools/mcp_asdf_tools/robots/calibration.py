"""A ground sensor's threshold and accuracy, from readings over tiles whose colour is known."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from itertools import pairwise

from mcp_asdf_tools.common.errors import UsageError

_MIN_READINGS = 10
"""Readings needed over each colour."""
_MAX_BIAS = 0.02
"""Error of estimates from which on the user is warned."""
_MIN_ACCURACY = 0.55
"""Mean accuracy below which the readings do not distinguish the colours; 0.5 would be chance."""
_SIGMAS_OF_95_PERCENT = 1.96
"""Standard deviations on either side of the mean in a 95 % interval."""


@dataclass(frozen=True)
class Calibration:
    """The best threshold of a ground sensor, and how accurate the sensor is with it.

    Attributes:
        threshold: Reading that separates the colours; a whole number if all readings are.
        black_is: The side on which a tile is taken for black, ``below`` or ``above``.
        accuracy: Share of the readings that are on the right side of it, over black and over white tiles.
        readings: Number of readings over black and over white tiles.
    """

    threshold: float
    black_is: str
    accuracy: dict[str, float]
    readings: dict[str, int]

    @property
    def b_hat(self) -> float:
        """Accuracy for the robot to assume at its start: the mean of both colours' accuracies.

        Each is taken as (right readings + 1) / (readings + 2), Laplace's rule, so it is never 0 or 1.
        """
        cautious_accuracies = []
        for accuracy, reading_count in self._accuracies_and_counts():
            right_readings = accuracy * reading_count
            cautious_accuracies.append((right_readings + 1) / (reading_count + 2))
        return sum(cautious_accuracies) / 2

    @property
    def uncertainty(self) -> float:
        """Half the width of the 95 % interval of ``b_hat``, at least as for one wrong reading a colour."""
        variance_of_sum = 0.0
        for accuracy, reading_count in self._accuracies_and_counts():
            # With a single wrong reading p (1 - p), the variance of a reading, is nearly 1 / n.
            variance_of_reading = max(accuracy * (1 - accuracy), 1 / reading_count)
            variance_of_sum += variance_of_reading / reading_count
        # b_hat is the mean of both accuracies, half their sum, and varies half as much as that.
        standard_deviation = math.sqrt(variance_of_sum) / 2
        return _SIGMAS_OF_95_PERCENT * standard_deviation

    @property
    def bias(self) -> float:
        """How much too black such sensors make every floor look, as a share of its tiles.

        It is not 0 if the colours' accuracies differ, since the method has one accuracy for both.
        """
        accuracy_of_black, accuracy_of_white = self.accuracy.values()
        # With the accuracies b + d on black and b - d on white, a reading is black with the probability
        # f b + (1 - f)(1 - b) + d. From that the method's estimate of f (eq. 3) becomes f + d / (2 b - 1).
        b = (accuracy_of_black + accuracy_of_white) / 2
        d = (accuracy_of_black - accuracy_of_white) / 2
        return d / (2 * b - 1)

    @property
    def warning(self) -> str | None:
        """Advice for the user if the bias exceeds 0.02 to either side; None if not."""
        if abs(self.bias) <= _MAX_BIAS:
            return None
        return (
            f"the colours differ too much: x_hat is off by {self.bias:+.3f} on every floor, whatever b_hat; "
            "change the sensor's height or the light, or paint the worse colour anew"
        )

    def _accuracies_and_counts(self) -> Iterable[tuple[float, int]]:
        """Return a pair for each colour: the accuracy and the number of readings."""
        return zip(self.accuracy.values(), self.readings.values(), strict=True)


def calibrate(rows: Sequence[tuple[float, bool]]) -> Calibration:
    """Return the calibration with the threshold at which the worse colour is recognised best.

    Each row is a reading and whether its tile was black. Among several such thresholds ``_rank`` decides.
    O(n log n). Raises UsageError for fewer than 10 readings over a colour, and for readings that do not
    distinguish the colours.
    """
    black_count = sum(is_black for _, is_black in rows)
    reading_counts = {"black": black_count, "white": len(rows) - black_count}
    _check_reading_counts(reading_counts)
    candidates = _candidates(sorted(rows), reading_counts)
    best_candidate = max(candidates, key=_rank, default=None)  # None if all readings are equal
    if best_candidate is not None:
        calibration, _gap = best_candidate
        mean_accuracy = sum(calibration.accuracy.values()) / 2
        if mean_accuracy >= _MIN_ACCURACY:
            return calibration
    raise UsageError("the readings do not tell black from white; does the sensor look at the floor?")


def _check_reading_counts(reading_counts: dict[str, int]) -> None:
    """Raise UsageError if there are fewer than 10 readings over a colour."""
    for colour, count in reading_counts.items():
        if count < _MIN_READINGS:
            raise UsageError(
                f"{count} readings over {colour} tiles; take {_MIN_READINGS} or more, better 1000"
            )


def _rank(candidate: tuple[Calibration, float]) -> tuple[float, float, float]:
    """Return what makes a calibration, which comes with the gap between its readings, better than another.

    That is the accuracy on the worse colour; if it is equal, the sum of both accuracies; and if that is
    equal, too, the width of the gap.
    """
    calibration, gap = candidate
    accuracies = calibration.accuracy.values()
    return min(accuracies), sum(accuracies), gap


def _candidates(
    sorted_rows: Sequence[tuple[float, bool]], reading_counts: dict[str, int]
) -> Iterator[tuple[Calibration, float]]:
    """Yield two calibrations, with black on either side, for each threshold that separates readings.

    Each comes with a width: the gap between the two readings on either side of its threshold.
    """
    has_whole_numbers = all(reading.is_integer() for reading, _ in sorted_rows)
    black_below = white_below = 0  # numbers of readings below the threshold
    # A threshold between two readings that follow each other has all readings up to the first below it.
    for (reading, is_black), (next_reading, _is_next_black) in pairwise(sorted_rows):
        if is_black:
            black_below += 1
        else:
            white_below += 1
        gap = next_reading - reading
        if gap == 0.0:  # No threshold fits between equal readings.
            continue
        middle = reading + gap / 2
        # Sensors with whole numbers compare with whole numbers: the threshold is one, too.
        threshold = math.ceil(middle) if has_whole_numbers else middle
        # If readings below the threshold are taken for black, these shares are right.
        black_accuracy = black_below / reading_counts["black"]
        white_accuracy = 1 - white_below / reading_counts["white"]
        accuracy_if_below = {"black": black_accuracy, "white": white_accuracy}
        yield Calibration(threshold, "below", accuracy_if_below, reading_counts), gap
        # If readings above it are taken for black, the others are right.
        accuracy_if_above = {"black": 1 - black_accuracy, "white": 1 - white_accuracy}
        yield Calibration(threshold, "above", accuracy_if_above, reading_counts), gap
