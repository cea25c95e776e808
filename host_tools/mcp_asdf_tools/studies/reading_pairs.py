"""Sensors that read every tile twice, and a robot that finds its accuracy from how often readings disagree.

A tile lasts two steps: in the first one a robot gets its first reading, in the second one the second. The
robot is an experiment and not part of the firmware; docs/internals/two_readings.md has its results.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from mcp_asdf import Config, ReferenceRobot, Status
from mcp_asdf.robot import B_HAT_MARGIN, Observation
from mcp_asdf_tools.world.philox import SENSOR_STREAM, Stream
from mcp_asdf_tools.world.sensors import Accuracies
from mcp_asdf_tools.world.settings import WorldSettings

READINGS_OF_TILE = 2
DRAWS_OF_TILE = 4

REJECTED_SIGMAS_SQUARED = 12
"""The test rejects beyond sqrt(12) standard deviations, as the robust filter's test does."""


# --- Sensors ---------------------------------------------------------------------------------------------


class IndependentReadings:
    """Sensors that read each tile twice, both times with the accuracy b, and every tile anew.

    Each robot's next tile is black with probability f, whatever the floor below it: so successive tiles are
    independent, and only the two readings of one tile have something in common.

    Attributes:
        repeated_share: Share of the second readings that are no new ones, but the first once more.
    """

    repeated_share = 0.0

    def __init__(self, settings: WorldSettings, trial: int) -> None:
        """Start before the first reading of the first tile."""
        self._settings = settings
        self._draws = Stream(SENSOR_STREAM, settings.seed, trial, settings.robots)
        self._next_step = 0

    def advance(self, steps: int) -> Accuracies:
        """Return accuracies of 0 and 1 for the next steps, by which each sensor gives the drawn reading.

        Those on black come first, then those on white; the shape of each is (steps, robots).
        """
        first_tile, readings_to_skip = divmod(self._next_step, READINGS_OF_TILE)
        self._next_step += steps
        # A step is a reading. The first tile may have had its first reading before these steps, and the last
        # tile may have its second reading after them.
        end_tile = math.ceil(self._next_step / READINGS_OF_TILE)
        readings = self._draw_readings(first_tile, end_tile - first_tile)
        is_black = readings[readings_to_skip : readings_to_skip + steps].astype(np.float64)
        # To read black, a sensor is always right on black tiles, and never on white ones.
        accuracies_on_black = is_black
        accuracies_on_white = 1 - is_black
        return accuracies_on_black, accuracies_on_white

    def _draw_readings(self, first_tile: int, tiles: int) -> NDArray[np.bool_]:
        """Return whether the readings of some tiles are black, in their order, shape (2 tiles, robots).

        A second reading repeats the first one with the probability ``repeated_share``.
        """
        colour_draws, first_draws, second_draws, repetition_draws = self._draw_tiles(first_tile, tiles)
        tile_is_black = colour_draws < self._settings.fill_ratio
        first_is_right = first_draws < self._settings.true_accuracy
        second_is_right = second_draws < self._settings.true_accuracy
        is_repeated = repetition_draws < self.repeated_share
        # A reading is black where it is right on a black tile, or wrong on a white one.
        first_is_black = tile_is_black == first_is_right
        second_would_be_black = tile_is_black == second_is_right
        second_is_black = np.where(is_repeated, first_is_black, second_would_be_black)
        # The readings of a tile follow each other.
        readings = np.stack([first_is_black, second_is_black], axis=1)  # shape (tiles, 2, robots)
        return readings.reshape(READINGS_OF_TILE * tiles, self._settings.robots)

    def _draw_tiles(self, first_tile: int, tiles: int) -> NDArray[np.float64]:
        """Return random numbers for some tiles, shape (4, tiles, robots).

        The four are for a tile's colour, for an error of the first reading and of the second one, and for a
        repetition.
        """
        # The stream counts draws as steps. Each tile takes four draws.
        uniforms = self._draws.draw_uniforms(DRAWS_OF_TILE * tiles, DRAWS_OF_TILE * first_tile)
        draws_by_tile = uniforms.reshape(tiles, DRAWS_OF_TILE, self._settings.robots)
        return draws_by_tile.swapaxes(0, 1)


class TenthRepeated(IndependentReadings):
    """Sensors that repeat the first reading of a tile as the second for one tile in ten."""

    repeated_share = 0.1


class HalfRepeated(IndependentReadings):
    """Sensors that repeat the first reading of a tile as the second for half of the tiles."""

    repeated_share = 0.5


# --- Robot -----------------------------------------------------------------------------------------------


class TwoReadingsRobot(ReferenceRobot):
    """A robot that finds its own accuracy by reading every tile twice, and x as the robust filter does.

    Two independent readings of a tile with the accuracy b disagree with probability 2 b (1 - b), whatever the
    tile's colour and f. So the robot counts disagreements. At each run of the filter it tests the count
    against the b_hat that it began with, and takes b_hat from the count if the test rejects.

    Only the first reading of a tile counts as an observation. A config with the robust filter is meant.
    """

    def __init__(self, config: Config, robot_id: int, b_hat: float) -> None:
        """Start before the first reading of a tile."""
        super().__init__(config, robot_id, b_hat)
        self._first_reading: Observation | None = None
        self._pairs, self._disagreements = 0, 0

    def observe(self, z: Observation) -> Status:
        """Count the first reading of a tile as an observation, in t and n, and compare the second with it.

        Every other call is the first reading of a tile, and the call after it the second reading. A second
        reading counts a pair, and also a disagreement if its colour differs from the first. Returns OK; or
        ERR_OBSERVATION, and changes nothing, if ``z`` is neither WHITE nor BLACK.
        """
        if z not in (Observation.WHITE, Observation.BLACK):
            return Status.ERR_OBSERVATION
        if self._first_reading is None:
            self._first_reading = z
            return super().observe(z)
        self._pairs += 1
        if z != self._first_reading:
            self._disagreements += 1
        self._first_reading = None
        return Status.OK

    def _update_b_hat(self) -> Status:
        """Run the robust filter, as x needs it, but take b_hat from the readings instead of from its test.

        Returns UPDATED if the readings disagree too often, or too rarely, for the b_hat at the start;
        otherwise OK, with b_hat as at the start.
        """
        super()._update_b_hat()  # it also sets b_hat, which is replaced below
        initial_b_hat = self._robust.initial_b_hat
        if disagreement_test_rejects(self._disagreements, self._pairs, initial_b_hat):
            self._b_hat = accuracy_of_disagreements(self._disagreements, self._pairs)
            return Status.UPDATED
        self._b_hat = initial_b_hat
        return Status.OK


def disagreement_test_rejects(disagreements: int, pairs: int, b_hat: float) -> bool:
    """Return whether so many pairs of readings disagree, or so few, that b_hat cannot be the accuracy.

    ``disagreements`` of ``pairs`` pairs disagree. With the accuracy b_hat that is a binomial count, of
    probability 2 b_hat (1 - b_hat). The test rejects if the count is more than sqrt(12) standard deviations
    from its mean, and never if there are no pairs.
    """
    expected_rate = 2 * b_hat * (1 - b_hat)
    deviation = disagreements - pairs * expected_rate
    variance = pairs * expected_rate * (1 - expected_rate)
    # Squares are compared, so that no root is needed.
    return deviation**2 > REJECTED_SIGMAS_SQUARED * variance


def accuracy_of_disagreements(disagreements: int, pairs: int) -> float:
    """Return the accuracy b >= 1/2 at which ``disagreements`` of ``pairs`` pairs are what is expected.

    It solves 2 b (1 - b) = disagreements / pairs, and is 1/2 if more than half of the pairs disagree. It
    stays below 1 by the firmware's margin for b_hat.
    """
    rate = disagreements / pairs
    discriminant = max(0.0, 1 - 2 * rate)  # 0 if more than half of the pairs disagree
    # The other solution, with a minus, is 1 - b: a sensor that is wrong more often than right.
    accuracy = (1 + math.sqrt(discriminant)) / 2
    return min(accuracy, 1 - B_HAT_MARGIN)
