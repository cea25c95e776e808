"""Two firmwares through the same scenario: do they agree in every bit, and if not, in which shortest one?"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import asdict, dataclass
from typing import Any, Protocol

from mcp_asdf.robot import Config, FirmwareError, FixedPointRobot, Status
from mcp_asdf_tools.crosscheck.random_scenarios import random_scenario, robust_scenario
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
            try:
                outcome = act()
            except FirmwareError as error:
                outcome = error.status.name
            return Look(outcome, *self._observed())
        except Exception as error:
            return Look(f"{type(error).__name__}: {error}", {}, b"")

    def _make(self, setup: Setup) -> str:
        self._robot = self._firmware(self._config, setup.robot_id, setup.b_hat / 2**32)
        return Status.OK.name

    def _observed(self) -> tuple[State, bytes]:
        robot = self._robot
        if robot is None:
            return {}, b""
        state = robot.state() | {
            "t()": robot.t,
            "n()": robot.n,
            "b_hat()": robot.b_hat_raw,
            "x_hat()": robot.x_hat_raw,
            "alpha()": robot.alpha_raw,
            "x_bar()": robot.x_bar_raw,
            "beta()": robot.beta_raw,
            "x()": robot.x_raw,
            "holds_invariants()": robot.holds_invariants(),
            **{f"{name}()": value for name, value in asdict(robot.counters).items()},
        }
        return state, robot.save()

    def _dispatch(self, call: Call) -> str:
        assert self._robot is not None
        if call.name not in REPLACING:
            return perform(self._robot, call).name
        self._robot = self._firmware.restore(self._config, edited_image(self._robot.save(), call))
        return Status.OK.name


@dataclass(frozen=True)
class Failure:
    """Something wrong in a scenario.

    Attributes:
        scenario: The robot and the calls made when it showed, if it was made at all.
        problems: One line for each.
    """

    scenario: Scenario
    problems: tuple[str, ...]

    def as_dict(self) -> dict[str, Any]:
        """As plain data."""
        calls = [str(call) for call in self.scenario.calls]
        return {"problems": list(self.problems), "calls": calls, "replay": str(self.scenario)}

    def __str__(self) -> str:
        calls = self.scenario.calls
        lines = [f"FAILED at call {len(calls)}; of two values that differ the first is native's"]
        lines += [f"  {number:3d}  {step}" for number, step in enumerate((self.scenario.setup, *calls))]
        lines += [f"  wrong: {problem}" for problem in self.problems]
        return "\n".join([*lines, f"replay: mcp-asdf crosscheck --replay {self.scenario}"])


Judge = Callable[[Setup, Call, Look, Look], list[str]]
"""Judges a call by the looks before and after it; returns problems."""

Check = Callable[[Scenario], Failure | None]


def compare_firmwares(
    scenario: Scenario, left: Firmware, right: Firmware, judge: Judge | None = None
) -> Failure | None:
    """Take both firmwares through the scenario and stop at the first difference or complaint of ``judge``."""
    one, other = Subject(left, scenario.setup), Subject(right, scenario.setup)
    problems = list(differences(one.last, other.last))
    if problems:
        return Failure(scenario.with_calls(()), tuple(problems))
    for made, call in enumerate(scenario.calls if one.last.state else (), start=1):
        before = one.last
        problems = list(differences(one.apply(call), other.apply(call)))
        if judge is not None and not problems:
            problems = judge(scenario.setup, call, before, one.last)
        if problems:
            return Failure(scenario.with_calls(scenario.calls[:made]), tuple(problems))
    return None


def differences(left: Look, right: Look) -> Iterator[str]:
    """Differences, a line each: the first firmware's value, then the second's; or an exception of both."""
    if left.outcome != right.outcome:
        yield f"status: {left.outcome}, {right.outcome}"
    elif left.outcome not in OUTCOMES:
        yield f"both: {left.outcome}"
    if left == right or not left.state or not right.state:
        return
    for name in left.state | right.state:
        one, other = left.state.get(name), right.state.get(name)
        if one != other:
            yield f"{name}: {one}, {other}"
    for index, words in enumerate(zip(IMAGE.unpack(left.image), IMAGE.unpack(right.image), strict=True)):
        if words[0] != words[1]:
            yield f"save(), word {index}: {words[0]:#010x}, {words[1]:#010x}"


@dataclass
class CrosscheckResult:
    """The result of a cross-check.

    Attributes:
        calls: Number of calls made and compared.
        scenarios: Number of scenarios they belonged to.
        failure: Something wrong, at which the check stopped.
        interrupted: Ctrl-C ended it early.
    """

    calls: int = 0
    scenarios: int = 0
    failure: Failure | None = None
    interrupted: bool = False


def crosscheck(check: Check, seed: int, calls: int, report: Callable[[int], object]) -> CrosscheckResult:
    """Check the random scenarios of ``seed`` until ``calls`` calls are made or something is found.

    ``report`` gets the number of calls made in every scenario.
    """
    outcome = CrosscheckResult()
    try:
        while outcome.calls < calls and outcome.failure is None:
            scenario = _scenario(seed, outcome.scenarios)
            scenario = scenario.with_calls(scenario.calls[: calls - outcome.calls])
            outcome.failure = check(scenario)
            made = len((outcome.failure or Failure(scenario, ())).scenario.calls)
            outcome.calls += made
            outcome.scenarios += 1
            report(made)
    except KeyboardInterrupt:
        outcome.interrupted = True
    return outcome


def _scenario(seed: int, number: int) -> Scenario:
    """Every fourth scenario is of a robot with the robust filter."""
    fours, place = divmod(number, 4)
    return robust_scenario(seed, fours) if place == 3 else random_scenario(seed, 3 * fours + place)


def shrink(failure: Failure, check: Check) -> Failure:
    """The failure without calls that ``check`` does not need to find something.

    The result is minimal: without any one of its calls, or any one word that a restore replaces, nothing is
    found. Needs a few hundred runs of the check for a scenario of a hundred calls.
    """
    size = len(failure.scenario.calls)
    while size:
        found = next(filter(None, map(check, _shorter(failure.scenario, size))), None)
        failure, size = (failure, size // 2) if found is None else (found, size)
    return failure


def _shorter(scenario: Scenario, size: int) -> Iterator[Scenario]:
    """The scenario without a run of ``size`` calls; where that is one, also without one word of a restore."""
    calls = scenario.calls
    for start in range(0, len(calls), size):
        yield scenario.with_calls(calls[:start] + calls[start + size :])
    for at, call in enumerate(calls if size == 1 else ()):
        for pair in range(0, len(call.numbers) if call.name == "restore" else 0, 2):
            fewer = Call("restore", call.numbers[:pair] + call.numbers[pair + 2 :])
            yield scenario.with_calls((*calls[:at], fewer, *calls[at + 1 :]))
