"""Models with one known mistake each, which run beside the right model of a controller.

They show which mistakes the frames of a run tell apart from the right firmware, and which mistake a
controller that differs seems to have. A mistake is an entry of ``SUSPECTS``: add one there to have it
searched for.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from copy import deepcopy
from dataclasses import dataclass, field, replace
from math import frexp, ldexp

from mcp_asdf.fixed_point import B_HAT_MAX, alpha_from_word
from mcp_asdf.mirror import (
    INFORMATIVE_G,
    VOTES_MIN_WHILE_MOVING,
    Crowd,
    MirrorRobot,
    crowd_fill_ratio,
    reestimate,
    robust_test_rejects,
)
from mcp_asdf.robot import Config, Filter, Observation, Status, Sums
from mcp_asdf.table import FRACTION_BITS, MAX_WORD, Table
from mcp_asdf_tools.robots.robot_setup import RobotSetup

Decision = Callable[[Crowd, int, int], bool]
"""Whether the robust filter's test rejects a crowd, t and n."""

# --- Tests in other arithmetic ---


def rounded(value: float, bits: int) -> float:
    """Return ``value`` rounded to so many significant bits."""
    mantissa, exponent = frexp(value)
    return ldexp(round(ldexp(mantissa, bits)), exponent - bits)


@dataclass(frozen=True)
class FloatTest:
    """The robust filter's test in floating point, or with single values of too few bits.

    Attributes:
        bits: Significant bits of every intermediate result.
        p_bits: Bits after the point to which the prediction is cut; None if it is not cut.
        seen_bits: The same of n/t.
        t_bits: Bits of t.
    """

    bits: int = 53
    p_bits: int | None = None
    seen_bits: int | None = None
    t_bits: int = 32

    def __call__(self, crowd: Crowd, t: int, n: int) -> bool:
        """Return True if this test rejects."""

        def fit(value: float) -> float:
            return rounded(value, self.bits)

        t %= 1 << self.t_bits
        if t == 0:
            return False
        r, b_hat, spread = (
            fit(crowd_fill_ratio(crowd) / 2**32),
            fit(crowd.first / 2**32),
            fit(crowd.spread / 2**30),
        )
        p = _cut(fit(fit(b_hat * r) + fit(fit(1 - b_hat) * fit(1 - r))), self.p_bits)
        seen = _cut(fit(n / t), self.seen_bits)
        variance = max(fit(seen * fit(1 - seen)), fit(p * fit(1 - p)))
        g_spread = fit(fit(2 * b_hat - 1) * spread)
        difference = fit(seen - p)
        limit = fit(12 * fit(fit(variance / t) + fit(g_spread * g_spread)))
        return fit(difference * difference) > limit


def _cut(value: float, bits: int | None) -> float:
    """Return ``value`` rounded down to so many bits after the point; unchanged for None."""
    return value if bits is None else ldexp(int(ldexp(value, bits)), -bits)


def with_t_of(bits: int) -> Decision:
    """Return the firmware's test with a t of so many bits."""
    return lambda crowd, t, n: t % (1 << bits) != 0 and robust_test_rejects(crowd, t % (1 << bits), n)


# --- Models with a mistake ---


@dataclass(frozen=True)
class RobustRules:
    """Rules of the robust filter that a controller may get wrong; the defaults are right.

    Attributes:
        least_trend: Least trend of a crowd that stays.
        largest_trend: Largest trend of a crowd that stays.
        halved_from: Votes from which they are halved while the crowd moves.
        trend_after_halving: Trend that a halving leaves; None if it stays.
        voice_modulus: Senders whose ids are equal modulo this are one voice.
        halves_for_few: Whether votes are halved before three voices were heard.
        rejects: The test.
        informative_g: |2 r - 1| from which r is informative, in units of 2**-32.
    """

    least_trend: int = 1 << 13
    largest_trend: int = (7 << 13) - 1
    halved_from: int = 2 * VOTES_MIN_WHILE_MOVING
    trend_after_halving: int | None = None
    voice_modulus: int = 32
    halves_for_few: bool = True
    rejects: Decision = robust_test_rejects
    informative_g: int = INFORMATIVE_G


class WrongRobust(MirrorRobot):
    """The firmware's model with other rules in its robust filter."""

    rules = RobustRules()
    senders: frozenset[int] = frozenset()
    """Voices heard, by the rules."""

    def _receive(self, sender: int, x_hat: int, alpha: int) -> Status:
        status = super()._receive(sender, x_hat, alpha)
        if status == Status.OK and alpha >> 8:
            self.senders |= {sender % self.rules.voice_modulus}
        return status

    def _run_robust_filter(self) -> int | None:
        s, crowd, rules = self.s, self.s.crowd, self.rules
        has_voices = len(self.senders) >= 3
        if not rules.least_trend <= crowd.trend <= rules.largest_trend:
            if crowd.votes >= rules.halved_from and (has_voices or rules.halves_for_few):
                crowd.votes >>= 1
                if rules.trend_after_halving is not None:
                    crowd.trend = rules.trend_after_halving
            return None
        if not has_voices:
            return None
        if rules.rejects(crowd, s.t, s.n):
            r = crowd_fill_ratio(crowd)
            g = 2 * max(r, MAX_WORD - r) - (1 << 32)
            if g < rules.informative_g:
                return None
            # Where the firmware has no b_hat, r is so near 1/2 that b_hat is at a limit, whichever.
            return reestimate(s.t, s.n, r) or B_HAT_MAX
        return crowd.first if s.accuracy.b_hat != crowd.first else None


class FloatAdaptive(MirrorRobot):
    """The firmware's model with the paper's test in float64."""

    def _run_asdf_filter(self) -> int | None:
        table, sums = self.config.table, self.s.open
        if table is None or sums.count < 2 or not rejects_in_float64(table, sums, self.s.x_hat):
            return None
        return self._always_b_hat()

    def _always_b_hat(self) -> int | None:
        """Return the b_hat of a re-estimate without a test."""
        always = model_of(MirrorRobot, self, replace(self.config, filter=Filter.ALWAYS))
        return always._run_asdf_filter()


def rejects_in_float64(table: Table, sums: Sums, x_hat: int) -> bool:
    """Return whether eq. 12 rejects, computed in float64 from the exact sums."""
    m = sums.count
    difference = float(sums.x - m * x_hat)
    scatter = float(m * sums.x_squared - sums.x * sums.x)
    factor: float = table.entry(m) / 2**FRACTION_BITS
    return difference * difference > factor * scatter


def model_of(kind: type[MirrorRobot], robot: MirrorRobot, config: Config | None = None) -> MirrorRobot:
    """Return a robot of this kind with a copy of another one's state, and its configuration by default."""
    model = kind.__new__(kind)
    model.config = robot.config if config is None else config
    model.s = deepcopy(robot.s)
    return model


# --- The suspects ---


@dataclass(frozen=True)
class Suspect:
    """A mistake that a controller may have.

    Attributes:
        name: What such a controller does, as a verb phrase.
        said: Filters that the controller is said to have for it to be suspected.
        rules: Its rules, if its robust filter is wrong.
        filter: The filter that it has in truth, if it has another one.
        kind: Its model, if neither.
    """

    name: str
    said: frozenset[Filter]
    rules: RobustRules | None = None
    filter: Filter | None = None
    kind: type[MirrorRobot] = MirrorRobot

    def model(self, record: RobotSetup, model: MirrorRobot) -> MirrorRobot:
        """Return a model of the controller of ``record`` with this mistake, in the state of ``model``."""
        if self.filter is not None:
            return model_of(MirrorRobot, model, replace(record.config, filter=self.filter))
        if self.rules is None:
            return model_of(self.kind, model)
        robot = model_of(WrongRobust, model)
        assert isinstance(robot, WrongRobust)
        robot.rules = self.rules
        return robot


_ROBUST = frozenset({Filter.ROBUST})

SUSPECTS = (
    Suspect("re-estimates without a test", frozenset({Filter.ADAPTIVE, Filter.OFF}), filter=Filter.ALWAYS),
    Suspect("never re-estimates", frozenset({Filter.ADAPTIVE, Filter.ALWAYS}), filter=Filter.OFF),
    Suspect("tests in float64", frozenset({Filter.ADAPTIVE}), kind=FloatAdaptive),
    *(
        Suspect(name, _ROBUST, rules)
        for name, rules in {
            "halves the votes below 2^8": RobustRules(halved_from=VOTES_MIN_WHILE_MOVING),
            "does not halve the votes down to 2^8": RobustRules(halved_from=2 * VOTES_MIN_WHILE_MOVING + 1),
            "halves the votes from 2^9 - 1 on": RobustRules(halved_from=2 * VOTES_MIN_WHILE_MOVING - 1),
            "sets the trend back when it halves the votes": RobustRules(trend_after_halving=1 << 15),
            "does not halve the votes before three voices": RobustRules(halves_for_few=False),
            "counts voices modulo 16": RobustRules(voice_modulus=16),
            "counts voices modulo 128": RobustRules(voice_modulus=128),
            "takes a trend of 2^13 for a move": RobustRules(least_trend=(1 << 13) + 1),
            "takes no trend of 2^13 - 1 for a move": RobustRules(least_trend=(1 << 13) - 1),
            "takes a trend of 7/8 - 2^-16 for a move": RobustRules(largest_trend=(7 << 13) - 2),
            "takes no trend of 7/8 for a move": RobustRules(largest_trend=7 << 13),
            "takes r for uninformative too near 1/2 only": RobustRules(informative_g=INFORMATIVE_G - 8),
            "takes r for uninformative too far from 1/2": RobustRules(informative_g=INFORMATIVE_G + 8),
            "tests in float32": RobustRules(rejects=FloatTest(24)),
            "tests in float64": RobustRules(rejects=FloatTest(53)),
            "tests a prediction of 23 bits": RobustRules(rejects=FloatTest(p_bits=23)),
            "tests a share n/t of 23 bits": RobustRules(rejects=FloatTest(seen_bits=23)),
            "tests with a t of 14 bits": RobustRules(rejects=with_t_of(14)),
        }.items()
    ),
)


@dataclass
class Lineup:
    """The models with a mistake that have shown nothing but what the right model has.

    Attributes:
        models: Models by what they do.
        rules: Rules of those whose robust filter is wrong, by the same names.
    """

    models: dict[str, MirrorRobot] = field(default_factory=dict)
    rules: dict[str, RobustRules] = field(default_factory=dict)
    _broadcasts: dict[str, tuple[int, float]] = field(default_factory=dict)

    @classmethod
    def beside(cls, right: MirrorRobot, record: RobotSetup, suspects: Iterable[Suspect] = SUSPECTS) -> Lineup:
        """Return the models of the mistakes that a controller of ``record`` can have."""
        suspected = [suspect for suspect in suspects if record.config.filter in suspect.said]
        return cls(
            {suspect.name: suspect.model(record, right) for suspect in suspected},
            {suspect.name: suspect.rules for suspect in suspected if suspect.rules is not None},
        )

    def note_broadcast(self, right: MirrorRobot) -> None:
        """Keep what each model, and ``right``, broadcasts now."""
        self._broadcasts = {name: _broadcast(model) for name, model in self.models.items()}
        self._broadcasts[""] = _broadcast(right)

    def answers_like(self, telemetry: tuple[int, int, int] | None, right: MirrorRobot) -> list[str]:
        """Return what a controller that sent this telemetry does, among the mistakes that show now.

        It is empty if no telemetry came.
        """
        if telemetry is None:
            return []
        return [
            name
            for name, model in self.models.items()
            if shown_in_telemetry(model) == telemetry != shown_in_telemetry(right)
        ]

    def drop_different(self, right: MirrorRobot) -> None:
        """Leave out the models whose last frames differ from those of ``right``."""
        telemetry, broadcast = shown_in_telemetry(right), self._broadcasts.get("")
        for name, model in list(self.models.items()):
            if shown_in_telemetry(model) != telemetry or self._broadcasts.get(name) != broadcast:
                del self.models[name]
                self.rules.pop(name, None)


def shown_in_telemetry(robot: MirrorRobot) -> tuple[int, int, int]:
    """Return x, b_hat in units of 2**-24 and the updates modulo 2**8."""
    return robot.x_raw, robot.b_hat_raw >> 8, robot.counters.updates % 256


def _broadcast(robot: MirrorRobot) -> tuple[int, float]:
    return robot.x_hat_raw, alpha_from_word(robot.alpha_raw)


class FollowedRobot(MirrorRobot):
    """The right model, whose calls a lineup's models get, too."""

    lineup: Lineup

    def observe(self, z: Observation) -> Status:
        """Observe, as every model of the lineup does."""
        for model in self.lineup.models.values():
            model.observe(z)
        return super().observe(z)

    def _receive(self, sender: int, x_hat: int, alpha: int) -> Status:
        for model in self.lineup.models.values():
            model.receive_raw(sender, x_hat, alpha)
        return super()._receive(sender, x_hat, alpha)

    def settle(self) -> Status:
        """Close the round, as every model of the lineup does."""
        for model in self.lineup.models.values():
            model.settle()
        return super().settle()
