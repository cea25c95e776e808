"""Coverage of a verification: the claims that a run has put to the test, and those that it has not.

A claim that was never put to the test fails the verdict as "not exercised". What no run can check of a
controller that is set up in this way is listed, and fails nothing.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass, field
from enum import Enum
from typing import Any

from mcp_asdf.robot import MAX_ID, Filter
from mcp_asdf_tools.radio.invalid_frames import INVALID, STRAY
from mcp_asdf_tools.radio.unusual_frames import UNUSUAL
from mcp_asdf_tools.robots import TickConfig

CRAFTED_SIZES = (2, 3, 5, 10, 30, 126)
"""Messages of the rounds that lie just inside and just outside their threshold."""

FULL_ROUND = 126
LONG_RUN = 10_000
"""Observations after which a controller must not have forgotten any, unless its memory is shorter."""

TESTS = 20
"""Tests of the filter that a run waits for at most."""
MOST_TICKS = 400_000
"""Ticks that a run waits for them at most: on a bus of 500 kbit/s these are 4 minutes."""
LONGEST_MEMORY = 20_000
"""Memories up to this length are filled until they are halved."""


class Update(Enum):
    """Effect on b_hat of a test that rejects; the value describes it."""

    ABOVE = "b_hat above 1/2, off the limit"
    BELOW = "b_hat below 1/2, off the limit"
    MAXIMUM = "b_hat at its upper limit"
    MINIMUM = "b_hat at its lower limit"
    HALF = "b_hat at 1/2, where the robot knows nothing"
    KEPT = "b_hat kept, as x_bar is 1/2"


@dataclass
class Latency:
    """Time from a command to its answer, in seconds.

    Attributes:
        answers: Answers timed.
        total: Sum of their times.
        maximum: Longest time.
    """

    answers: int = 0
    total: float = 0.0
    maximum: float = 0.0

    def note(self, seconds: float) -> None:
        """Take the time of one answer."""
        self.answers += 1
        self.total += seconds
        self.maximum = max(self.maximum, seconds)

    @property
    def mean(self) -> float:
        """Mean time; 0 without any answer."""
        return self.total / max(self.answers, 1)


@dataclass
class Coverage:
    """Counts of what a run has put to the test.

    Attributes:
        robot: The controller's id.
        config: Its configuration.
        observations: Observations made.
        halvings: Halvings of the memory by n modulo 4 before them: 1 rounds down, 3 up, 0 and 2 are exact.
        tests: Tests run, by the number of messages.
        rejections: Those among them that rejected.
        updates: Tests that rejected, by what they did to b_hat.
        quiet_rounds: Rounds without a test whose messages a test would have rejected.
        senders: Ids whose messages the model accepted.
        most_messages: Messages of the largest round.
        equal: Frames of the controller that equal the model's, by kind.
        invalid: Frames sent that are no estimates, by what is wrong with them.
        commands: Commands sent that must not be obeyed, by what is wrong with them.
        unusual: Frames sent that must be taken like any others, by what is unusual about them.
        latency: Times to the controller's answers.
    """

    robot: int
    config: TickConfig
    observations: int = 0
    halvings: Counter[int] = field(default_factory=Counter)
    tests: Counter[int] = field(default_factory=Counter)
    rejections: Counter[int] = field(default_factory=Counter)
    updates: Counter[Update] = field(default_factory=Counter)
    quiet_rounds: int = 0
    senders: set[int] = field(default_factory=set)
    most_messages: int = 0
    equal: Counter[str] = field(default_factory=Counter)
    invalid: Counter[str] = field(default_factory=Counter)
    commands: Counter[str] = field(default_factory=Counter)
    unusual: Counter[str] = field(default_factory=Counter)
    latency: Latency = field(default_factory=Latency)

    @property
    def re_estimates(self) -> int:
        """Re-estimates that changed b_hat."""
        return self.updates.total() - self.updates[Update.KEPT]

    def plain(self) -> dict[str, Any]:
        """The counts as plain values, for JSON."""
        return {
            "observations": self.observations,
            "tests": {str(m): [self.tests[m], self.rejections[m]] for m in sorted(self.tests)},
            "updates": {update.value: self.updates[update] for update in Update},
            "rounds_without_a_test": self.quiet_rounds,
            "halvings": sum(self.halvings.values()),
            "ids_heard": sorted(self.senders),
            "most_messages": self.most_messages,
            "equal_frames": dict(sorted(self.equal.items())),
            "invalid_frames": dict(self.invalid),
            "stray_commands": dict(self.commands),
            "unusual_frames": dict(self.unusual),
            "answers": self.latency.answers,
            "latency_mean": self.latency.mean,
            "latency_maximum": self.latency.maximum,
        }


def filters(config: TickConfig) -> bool:
    """True if the robot re-estimates b_hat at all."""
    return config.filter is not Filter.OFF


def is_adaptive(config: TickConfig) -> bool:
    """True if the robot runs the hypothesis test."""
    return config.filter is Filter.ADAPTIVE


def is_in_reach(config: TickConfig) -> bool:
    """True if the tests of the filter come often enough for a run."""
    return TESTS * config.filter_period <= MOST_TICKS


def has_quiet_rounds(config: TickConfig) -> bool:
    """True if some rounds end without a test."""
    return filters(config) and config.filter_period > config.comms_period


def is_halved(config: TickConfig) -> bool:
    """True if the memory is short enough for a run to fill it."""
    return config.memory <= LONGEST_MEMORY


@dataclass(frozen=True)
class Claim:
    """Statement that a passed verdict makes.

    Attributes:
        text: The statement.
        is_tested: Whether a run has put it to the test.
        applies: Whether it is made of a controller with this configuration.
    """

    text: str
    is_tested: Callable[[Coverage], bool]
    applies: Callable[[TickConfig], bool] = lambda config: True


def _is_tested_both_ways(m: int) -> Callable[[Coverage], bool]:
    return lambda run: 0 < run.rejections[m] < run.tests[m]


def _has_update(update: Update) -> Callable[[Coverage], bool]:
    return lambda run: run.updates[update] > 0


CLAIMS: tuple[Claim, ...] = (
    Claim("broadcasts", lambda run: run.equal["estimate"] > 0),
    Claim("answers to settle", lambda run: run.equal["telemetry"] > 0),
    Claim("heartbeats after the first", lambda run: run.equal["heartbeat"] > 1),
    Claim(
        f"a message of every id 0 to {MAX_ID}",
        lambda run: run.senders | {run.robot} >= set(range(MAX_ID + 1)),
    ),
    Claim(f"a round of {FULL_ROUND} messages", lambda run: run.most_messages >= FULL_ROUND),
    Claim("every kind of invalid frame", lambda run: run.invalid.keys() >= set(INVALID)),
    Claim("every kind of stray command", lambda run: run.commands.keys() >= set(STRAY)),
    Claim("every kind of unusual frame", lambda run: run.unusual.keys() >= set(UNUSUAL)),
    *(
        Claim(f"the test of {m} messages, passed and rejected", _is_tested_both_ways(m), is_adaptive)
        for m in CRAFTED_SIZES
    ),
    *(Claim(f"a re-estimate: {update.value}", _has_update(update), filters) for update in Update),
    Claim("a round without a test", lambda run: run.quiet_rounds > 0, has_quiet_rounds),
    Claim("halvings that round down and up", lambda run: run.halvings.keys() >= {1, 3}, is_halved),
    Claim(
        f"a run of {LONG_RUN} observations",
        lambda run: run.observations >= LONG_RUN,
        lambda config: not is_halved(config),
    ),
)


def not_exercised(run: Coverage) -> list[str]:
    """Claims about the controller that the run has not put to the test."""
    return [claim.text for claim in CLAIMS if claim.applies(run.config) and not claim.is_tested(run)]


def not_checked(run: Coverage) -> list[str]:
    """Properties that a verdict on a controller of this configuration leaves open."""
    config = run.config
    sizes = ", ".join(map(str, CRAFTED_SIZES))
    limits = (
        (is_adaptive(config), f"thresholds of rounds of other sizes than {sizes}"),
        (not filters(config), "the test and re-estimates: it does not filter"),
        (config.filter is Filter.ALWAYS, "the test: it re-estimates always"),
        (not has_quiet_rounds(config) and filters(config), "rounds without a test: it tests in each"),
        (config.comms_period == 1, "rounds longer than a tick: it broadcasts in each"),
        (
            not is_halved(config),
            f"forgetting: its memory is {config.memory}, of which {run.observations} observations were made",
        ),
        (
            True,
            f"counts above {run.re_estimates} re-estimates and {run.equal['heartbeat']} seconds of uptime",
        ),
        (True, "its own clock, sensor and telemetry period: commands replace them"),
        (True, "saving and restoring of its state"),
        (True, "its behaviour on a bus with error frames, CAN FD frames or a bus-off of its own"),
        (True, "vendor status and spare bits of heartbeats, and frames of other subjects"),
    )
    return [text for holds, text in limits if holds]
