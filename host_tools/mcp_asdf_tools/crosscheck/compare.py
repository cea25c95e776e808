"""Two firmwares through the same scenario: do they agree in every bit, and if not, in which shortest one?"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Protocol

from mcp_asdf.robot import Config, FirmwareError, FixedPointRobot, Status
from mcp_asdf_tools.crosscheck.random_scenarios import random_scenario
from mcp_asdf_tools.crosscheck.scenario import IMAGE, REPLACING, Call, Scenario, Setup, edited_image, perform

State = dict[str, int]
"""All that can be seen of a robot after a call, by name."""

OUTCOMES = frozenset(Status.__members__)
"""Outcomes that a firmware may have."""


class Firmware(Protocol):
    """A class of robots, such as ``MirrorRobot``."""

    def __call__(self, config: Config, robot_id: int, b_hat: float) -> FixedPointRobot:
        """Make a robot."""

    def restore(self, config: Config, image: bytes) -> FixedPointRobot:
        """Make a robot from an image."""


@dataclass(frozen=True)
class Look:
    """The result of a call.

    Attributes:
        outcome: One of OUTCOMES, or an exception that was raised instead.
        state: The robot afterwards; empty if there is none.
        image: Its state as saved.
    """

    outcome: str
    state: State
    image: bytes


class Subject:
    """A robot of one firmware on its way through a scenario."""

    def __init__(self, firmware: Firmware, setup: Setup) -> None:
        self._firmware = firmware
        self._config = setup.config()
        self._robot: FixedPointRobot | None = None
        self.last = self._look(lambda: self._make(setup))

    def apply(self, call: Call) -> Look:
        """Make a call; the result also stays as ``last``."""
        self.last = self._look(lambda: self._dispatch(call))
        return self.last

    def _look(self, act: Callable[[], str]) -> Look:
        """Act and look. An exception is an outcome, to be compared like any other."""
        try:
            outcome = act()
        except FirmwareError as error:
            outcome = error.status.name
        except Exception as error:
            outcome = f"{type(error).__name__}: {error}"
        try:
            return Look(outcome, *self._observed())
        except Exception as error:
            return Look(f"{outcome}, then {type(error).__name__}: {error}", {}, b"")

    def _make(self, setup: Setup) -> str:
        self._robot = self._firmware(self._config, setup.robot_id, setup.b_hat / 2**32)
        return Status.OK.name

    def _observed(self) -> tuple[State, bytes]:
        robot = self._robot
        if robot is None:
            return {}, b""
        counters = robot.counters
        state = robot.state() | {
            "t()": robot.t,
            "n()": robot.n,
            "b_hat()": robot.b_hat_raw,
            "x_hat()": robot.x_hat_raw,
            "alpha()": robot.alpha_raw,
            "x_bar()": robot.x_bar_raw,
            "beta()": robot.beta_raw,
            "x()": robot.x_raw,
            "accepted()": counters.accepted,
            "repeated()": counters.repeated,
            "rejected()": counters.rejected,
            "tests()": counters.tests,
            "updates()": counters.updates,
            "holds_invariants()": robot.holds_invariants(),
        }
        return state, robot.save()

    def _dispatch(self, call: Call) -> str:
        assert self._robot is not None
        if call.name not in REPLACING:
            return perform(self._robot, call).name
        self._robot = self._firmware.restore(self._config, edited_image(self._robot.save(), call))
        return Status.OK.name


@dataclass(frozen=True)
class Disagreement:
    """Something wrong in a scenario.

    Attributes:
        calls: Number of calls made when it showed; 0 is the making of the robot.
        problems: One line for each.
    """

    calls: int
    problems: tuple[str, ...]


Watcher = Callable[[Call, Look, Look], list[str]]
"""Judges a call by the looks before and after it; returns problems."""

Check = Callable[[Scenario], Disagreement | None]


def compare_firmwares(
    scenario: Scenario, left: Firmware, right: Firmware, watch: Watcher | None = None
) -> Disagreement | None:
    """Take both firmwares through the scenario and stop at the first difference or complaint of ``watch``."""
    one, other = Subject(left, scenario.setup), Subject(right, scenario.setup)
    if one.last != other.last:
        return Disagreement(0, tuple(differences(one.last, other.last)))
    if one.last.outcome not in OUTCOMES:
        return Disagreement(0, (f"both: {one.last.outcome}",))
    for made, call in enumerate(scenario.calls if one.last.state else (), start=1):
        before = one.last
        if one.apply(call) != other.apply(call):
            return Disagreement(made, tuple(differences(one.last, other.last)))
        if one.last.outcome not in OUTCOMES:
            return Disagreement(made, (f"both: {one.last.outcome}",))
        problems = watch(call, before, one.last) if watch is not None else []
        if problems:
            return Disagreement(made, tuple(problems))
    return None


def differences(left: Look, right: Look) -> Iterator[str]:
    """Differences, a line each: the first firmware's value, then the second's."""
    if left.outcome != right.outcome:
        yield f"status: {left.outcome}, {right.outcome}"
    if not left.state or not right.state:  # one has no robot; the status differs, too
        return
    for name in left.state | right.state:
        one, other = left.state.get(name), right.state.get(name)
        if one != other:
            yield f"{name}: {one}, {other}"
    words = zip(IMAGE.unpack(left.image), IMAGE.unpack(right.image), strict=True)
    for index, (one, other) in enumerate(words):
        if one != other:
            yield f"save(), word {index}: {one:#010x}, {other:#010x}"


@dataclass
class CrosscheckResult:
    """The result of a cross-check.

    Attributes:
        calls: Number of calls made and compared.
        scenarios: Number of scenarios they belonged to.
        failing: The scenario with something wrong, at which the check stopped.
        interrupted: Ctrl-C ended it early.
    """

    calls: int = 0
    scenarios: int = 0
    failing: Scenario | None = None
    interrupted: bool = False


def crosscheck(check: Check, seed: int, calls: int, report: Callable[[int], object]) -> CrosscheckResult:
    """Check the random scenarios of ``seed`` until ``calls`` calls are made or something is found.

    ``report`` gets the number of calls made after every scenario.
    """
    outcome = CrosscheckResult()
    try:
        while outcome.calls < calls and outcome.failing is None:
            scenario = random_scenario(seed, outcome.scenarios)
            scenario = scenario.with_calls(scenario.calls[: calls - outcome.calls])
            finding = check(scenario)
            if finding is not None:
                outcome.failing = scenario
            outcome.calls += len(scenario.calls) if finding is None else finding.calls
            outcome.scenarios += 1
            report(outcome.calls)
    except KeyboardInterrupt:
        outcome.interrupted = True
    return outcome


def shrink(scenario: Scenario, check: Check) -> Scenario:
    """The scenario without calls that ``check`` does not need to find something, or as it is if sound.

    The result is minimal: without any one of its calls, or any one word that a restore replaces, nothing is
    found. Needs a few hundred runs of the check for a scenario of a hundred calls.
    """
    calls = _cut(scenario, check)
    size = max(len(calls) // 2, 1)
    while True:
        shorter = _drop(scenario.with_calls(calls), size, check)
        if size == 1 and len(shorter) == len(calls):
            shorter = _simplify(scenario.with_calls(calls), check)
            if shorter == calls:
                return scenario.with_calls(calls)
        calls, size = shorter, max(size // 2, 1)


def _cut(scenario: Scenario, check: Check) -> tuple[Call, ...]:
    """The calls up to the finding, all of them if there is none."""
    finding = check(scenario)
    return scenario.calls if finding is None else scenario.calls[: finding.calls]


def _drop(scenario: Scenario, size: int, check: Check) -> tuple[Call, ...]:
    """The calls without every run of ``size`` calls that is not needed."""
    calls, start = scenario.calls, 0
    while start < len(calls):
        without = scenario.with_calls(calls[:start] + calls[start + size :])
        if check(without) is None:
            start += size
        else:
            calls = _cut(without, check)
    return calls


def _simplify(scenario: Scenario, check: Check) -> tuple[Call, ...]:
    """The calls without the first replaced word that is not needed."""
    for at, call in enumerate(scenario.calls):
        for pair in range(0, len(call.numbers) if call.name == "restore" else 0, 2):
            fewer = Call("restore", call.numbers[:pair] + call.numbers[pair + 2 :])
            calls = (*scenario.calls[:at], fewer, *scenario.calls[at + 1 :])
            if check(scenario.with_calls(calls)) is not None:
                return _cut(scenario.with_calls(calls), check)
    return scenario.calls
