"""Models of controllers with one known mistake each, which run beside the right model of a controller.

They show which mistakes the frames of a run tell apart from the right firmware, and which mistake a
controller that differs seems to have. A mistake is an entry of ``KNOWN_MISTAKES``: add one there to have it
searched for.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Set
from copy import deepcopy
from dataclasses import dataclass, field, replace
from functools import partial
from math import frexp, ldexp
from typing import NamedTuple

from mcp_asdf.fixed_point import alpha_from_word
from mcp_asdf.mirror import MirrorRobot, reestimate, round_mean
from mcp_asdf.robot import Filter, Observation, Status
from mcp_asdf.robust_filter import REJECTED_SIGMAS_SQUARED, RobustFilter, robust_test_rejects
from mcp_asdf_tools.crosscheck.crafted_rounds import limit_in_float64
from mcp_asdf_tools.crosscheck.crafted_slots import RobustTest
from mcp_asdf_tools.robots.robot_setup import RobotSetup

# --- Tests in other arithmetic ---


@dataclass(frozen=True)
class FloatTest:
    """The robust filter's test in floating point, or with single values of too few bits.

    Attributes:
        significant_bits: Significant bits of every intermediate result.
        prediction_bits: Bits after the point to which the predicted share of black is cut; None if it is not.
        observed_bits: The same of the observed share, n/t.
    """

    significant_bits: int = 53
    prediction_bits: int | None = None
    observed_bits: int | None = None

    def __call__(self, robust: RobustFilter, t: int, n: int, centre: int, spread: int) -> bool:
        """Return whether n black of t observations contradict the initial b_hat; see ``robust_test_rejects``.

        ``centre`` and ``spread`` are in units of 2**-24.
        """
        fit = self._round  # rounds every intermediate result to the significant bits
        # The divisions by powers of two are conversions from the integers that the firmware has.
        b_hat = fit(robust.initial_b_hat / 2**32)
        fill_ratio = fit(centre / 2**24)
        black_observed_as_black = fit(b_hat * fill_ratio)
        white_observed_as_black = fit(fit(1 - b_hat) * fit(1 - fill_ratio))
        predicted = fit(black_observed_as_black + white_observed_as_black)
        predicted = _cut_fraction(predicted, self.prediction_bits)
        observed = _cut_fraction(fit(n / t), self.observed_bits)
        variance_of_observed = fit(observed * fit(1 - observed))
        variance_of_predicted = fit(predicted * fit(1 - predicted))
        variance = max(variance_of_observed, variance_of_predicted)
        dispersed_variance = fit(fit(robust.dispersion / 2**8) * variance)
        # The uncertainty of the prediction, which changes by g = 2 b_hat - 1 where the centre changes by 1.
        g_spread = fit(fit(2 * b_hat - 1) * fit(spread / 2**24))
        uncertainty = fit(fit(dispersed_variance / t) + fit(g_spread * g_spread))
        difference = fit(observed - predicted)
        return fit(difference * difference) > fit(REJECTED_SIGMAS_SQUARED * uncertainty)

    def _round(self, value: float) -> float:
        """Return ``value`` rounded to the significant bits."""
        mantissa, exponent = frexp(value)  # value = mantissa * 2**exponent, with a mantissa below 1
        digits = round(ldexp(mantissa, self.significant_bits))
        return ldexp(digits, exponent - self.significant_bits)


def _cut_fraction(value: float, bits: int | None) -> float:
    """Return ``value``, which is not negative, rounded down to ``bits`` bits after the point.

    It is returned unchanged if ``bits`` is None.
    """
    if bits is None:
        return value
    # ldexp(number, exponent) is number * 2**exponent, and int rounds down.
    units = int(ldexp(value, bits))
    return ldexp(units, -bits)


def test_with_t_of_14_bits(robust: RobustFilter, t: int, n: int, centre: int, spread: int) -> bool:
    """Return whether the robust filter's test rejects if it keeps only the lowest 14 bits of t.

    The result is False if these are 0, which a test cannot divide by. ``centre`` and ``spread`` are in units
    of 2**-24.
    """
    short_t = t % 2**14
    if short_t == 0:
        return False
    return robust_test_rejects(robust, short_t, n, centre, spread)


# --- Models with a mistake ---


class RobotWithOtherTest(MirrorRobot):
    """The firmware's model with another test in its robust filter."""

    # A default of the class, as models are copies of another robot and are not initialised.
    robust_test: RobustTest = staticmethod(robust_test_rejects)

    def _rejects_initial_b_hat(self, centre: int, spread: int) -> bool:
        """Return whether ``robust_test``, in place of the firmware's test, rejects the initial b_hat."""
        return self.robust_test(self.s.robust, self.s.t, self.s.n, centre, spread)


class RobotThatTestsInFloat64(MirrorRobot):
    """The firmware's model with the paper's test in float64."""

    def _run_asdf_filter(self) -> int | None:
        """Return the new b_hat, in units of 2**-32, if the test (eq. 12) in float64 rejects x_hat, or None.

        It is None, too, if the round has fewer than two messages, or if their mean carries no information.
        """
        table = self.config.table
        sums = self.s.open  # over the round that is ending
        m = sums.count
        # The variance of a single estimate is not defined, so that the test needs two.
        if table is None or m < 2:
            return None
        difference = sums.x - m * self.s.x_hat
        scatter = m * sums.x_squared - sums.x * sums.x  # m Sum x**2 - (Sum x)**2
        is_rejected = float(difference) ** 2 > limit_in_float64(table, m, scatter)
        if not is_rejected:
            return None
        x_bar = round_mean(self.s.closed)
        return reestimate(self.s.t, self.s.n, x_bar)


def copy_as(model_class: type[MirrorRobot], robot: MirrorRobot) -> MirrorRobot:
    """Return a robot of this class with the settings and a copy of the state of ``robot``."""
    model = model_class.__new__(model_class)  # without __init__, whose new state would be replaced
    model.config = robot.config
    model.s = deepcopy(robot.s)
    return model


def copy_with_filter(robot_filter: Filter, robot: MirrorRobot) -> MirrorRobot:
    """Return a copy of a robot that has this filter in place of its own."""
    model = copy_as(MirrorRobot, robot)
    model.config = replace(robot.config, filter=robot_filter)
    return model


def copy_with_robust_test(robust_test: RobustTest, robot: MirrorRobot) -> MirrorRobot:
    """Return a copy of a robot whose robust filter has this test."""
    model = copy_as(RobotWithOtherTest, robot)
    assert isinstance(model, RobotWithOtherTest)
    model.robust_test = robust_test
    return model


# --- The mistakes ---


@dataclass(frozen=True)
class KnownMistake:
    """A mistake that a controller may have.

    Attributes:
        name: What such a controller does, as a verb phrase.
        filters: Filters with which a controller may have this mistake.
        make_model: Returns a model with this mistake, in the state of the right model that it is given.
    """

    name: str
    filters: Set[Filter]
    make_model: Callable[[MirrorRobot], MirrorRobot]


_WRONG_ROBUST_TESTS: dict[str, RobustTest] = {
    "tests in float32": FloatTest(significant_bits=24),
    "tests a prediction of 23 bits": FloatTest(prediction_bits=23),
    "tests a share n/t of 23 bits": FloatTest(observed_bits=23),
    "tests with a t of 14 bits": test_with_t_of_14_bits,
}

KNOWN_MISTAKES = (
    KnownMistake(
        "re-estimates without a test",
        {Filter.ADAPTIVE, Filter.OFF},
        partial(copy_with_filter, Filter.ALWAYS),
    ),
    KnownMistake(
        "never re-estimates", {Filter.ADAPTIVE, Filter.ALWAYS}, partial(copy_with_filter, Filter.OFF)
    ),
    KnownMistake("tests in float64", {Filter.ADAPTIVE}, partial(copy_as, RobotThatTestsInFloat64)),
    *(
        KnownMistake(name, {Filter.ROBUST}, partial(copy_with_robust_test, robust_test))
        for name, robust_test in _WRONG_ROBUST_TESTS.items()
    ),
)


class TelemetryFields(NamedTuple):
    """Fields of telemetry: x in units of 2**-23, b_hat in units of 2**-24, and the updates modulo 2**8."""

    x: int
    b_hat: int
    updates: int


@dataclass
class MistakenModels:
    """Models with a mistake whose frames have all equalled the right model's so far.

    A model is dropped at its first frame that differs: a controller with its mistake would have been found
    out. Models that are left at the end have mistakes that no frame of the run shows.

    Attributes:
        models: Models by the name of the mistake.
    """

    models: dict[str, MirrorRobot] = field(default_factory=dict)
    _right_broadcast: tuple[int, float] | None = None
    _broadcast_by_mistake: dict[str, tuple[int, float]] = field(default_factory=dict)

    @classmethod
    def beside(
        cls, right_model: MirrorRobot, setup: RobotSetup, mistakes: Iterable[KnownMistake] = KNOWN_MISTAKES
    ) -> MistakenModels:
        """Return a model for each of the mistakes that a controller of this setup can have.

        All are in the state of ``right_model``.
        """
        models = {}
        for mistake in mistakes:
            if setup.config.filter in mistake.filters:
                models[mistake.name] = mistake.make_model(right_model)
        return cls(models)

    @property
    def robust_tests(self) -> list[RobustTest]:
        """The wrong tests of those models that differ from the right one in the robust filter's test."""
        return [model.robust_test for model in self.models.values() if isinstance(model, RobotWithOtherTest)]

    def keep_broadcasts(self, right_model: MirrorRobot) -> None:
        """Keep what each model, and the right one, broadcasts now; ``drop_different`` compares it later."""
        self._right_broadcast = _broadcast_of(right_model)
        self._broadcast_by_mistake = {name: _broadcast_of(model) for name, model in self.models.items()}

    def mistakes_with_telemetry(
        self, telemetry: TelemetryFields | None, right_model: MirrorRobot
    ) -> list[str]:
        """Return the names of the mistakes with which a controller would send this telemetry.

        There is no name if ``telemetry`` equals the right model's, or is None because no telemetry came.
        """
        if telemetry is None or telemetry == telemetry_of(right_model):
            return []
        return [name for name, model in self.models.items() if telemetry_of(model) == telemetry]

    def drop_different(self, right_model: MirrorRobot) -> None:
        """Leave out the models whose present telemetry or last broadcast differs from the right model's."""
        right_telemetry = telemetry_of(right_model)
        remaining_models = {}
        for name, model in self.models.items():
            is_telemetry_equal = telemetry_of(model) == right_telemetry
            # Before the first broadcast both are None.
            is_broadcast_equal = self._broadcast_by_mistake.get(name) == self._right_broadcast
            if is_telemetry_equal and is_broadcast_equal:
                remaining_models[name] = model
        self.models = remaining_models


def telemetry_of(robot: MirrorRobot) -> TelemetryFields:
    """Return the fields that a robot would send in telemetry now."""
    b_hat_in_24_bits = robot.b_hat_raw >> 8  # from units of 2**-32 to 2**-24
    return TelemetryFields(robot.x_raw, b_hat_in_24_bits, robot.counters.updates % 256)


def _broadcast_of(robot: MirrorRobot) -> tuple[int, float]:
    """Return what a robot would broadcast now: x_hat in units of 2**-23, and its confidence alpha."""
    return robot.x_hat_raw, alpha_from_word(robot.alpha_raw)


class RightModel(MirrorRobot):
    """The right model of a controller; the models with a mistake get the same calls."""

    mistaken_models: MistakenModels

    def observe(self, z: Observation) -> Status:
        """Observe ``z``, also with every model that has a mistake; return the right model's status."""
        for model in self.mistaken_models.models.values():
            model.observe(z)
        return super().observe(z)

    def _receive(self, sender: int, x_hat: int, alpha: int) -> Status:
        """Receive an estimate, also with every model that has a mistake; return the right model's status."""
        for model in self.mistaken_models.models.values():
            model.receive_raw(sender, x_hat, alpha)
        return super()._receive(sender, x_hat, alpha)

    def settle(self) -> Status:
        """End the round, also of every model that has a mistake; return the right model's status."""
        for model in self.mistaken_models.models.values():
            model.settle()
        return super().settle()
