"""Run two firmwares through the same scenarios, and find the shortest scenario in which they differ."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from dataclasses import asdict, dataclass, replace
from functools import partial
from typing import Any, Protocol

from mcp_asdf.image_format import unpack_image
from mcp_asdf.robot import Config, FirmwareError, FixedPointRobot, Status
from mcp_asdf_tools.crosscheck.checked_filters import CHECKED_FILTERS, CheckedFilter
from mcp_asdf_tools.crosscheck.scenario import (
    CALLS_THAT_REPLACE_ROBOT,
    Call,
    CallRecord,
    CallResult,
    Scenario,
    Setup,
    State,
    edit_image,
    make_call,
)


class Firmware(Protocol):
    """A class of robots, such as ``MirrorRobot``."""

    def __call__(self, config: Config, robot_id: int, b_hat: float) -> FixedPointRobot:
        """Make a robot."""

    def restore(self, config: Config, image: bytes) -> FixedPointRobot:
        """Make a robot from an image."""


class RobotUnderTest:
    """A robot of one firmware on which the calls of a scenario are made.

    Attributes:
        last_result: Result of the last call; before any, of making the robot.
    """

    def __init__(self, firmware: Firmware, setup: Setup) -> None:
        """Make the robot of this setup. If the firmware refuses it, ``last_result`` says so."""
        self._firmware = firmware
        self._config = setup.config()
        self._robot: FixedPointRobot | None = None
        self.last_result = self._run_and_read(partial(self._make_robot, setup))

    def apply(self, call: Call) -> CallResult:
        """Make a call on the robot, and return its result, which is also kept as ``last_result``."""
        self.last_result = self._run_and_read(partial(self._make_call, call))
        return self.last_result

    def _run_and_read(self, action: Callable[[], str]) -> CallResult:
        """Run an action that returns an outcome, such as "OK", and return this with the robot after it.

        A FirmwareError is the firmware's way to refuse an action: its status is the outcome, and the robot's
        state and image follow as usual. Any other exception is a bug of the firmware. It is not raised here:
        its text is the outcome, and the state and the image are empty.
        """
        try:
            outcome = _outcome_of(action)
            # Reading the state may raise such an exception, too.
            return CallResult(outcome, self._state(), self._image())
        except Exception as error:
            return CallResult(f"{type(error).__name__}: {error}", {}, b"")

    def _make_robot(self, setup: Setup) -> str:
        """Make the robot, and return the name of the status: "OK", as a refusal raises a FirmwareError."""
        self._robot = self._firmware(self._config, setup.robot_id, setup.b_hat / 2**32)
        return Status.OK.name

    def _make_call(self, call: Call) -> str:
        """Make a call, which may replace the robot by one restored from its image; return its status's name.

        If an image is refused, a FirmwareError is raised and the robot stays.
        """
        assert self._robot is not None
        if call.name in CALLS_THAT_REPLACE_ROBOT:
            image = edit_image(self._robot.save(), call, self._config.filter)
            self._robot = self._firmware.restore(self._config, image)
            return Status.OK.name
        return make_call(self._robot, call).name

    def _state(self) -> State:
        """Return all that can be read of the robot, by name; an empty dictionary if there is no robot.

        Fields of the state have their names, such as "t"; results of methods and properties have names that
        end in "()".
        """
        robot = self._robot
        if robot is None:
            return {}
        results = {
            "t()": robot.t,
            "n()": robot.n,
            "b_hat()": robot.b_hat_raw,
            "x_hat()": robot.x_hat_raw,
            "alpha()": robot.alpha_raw,
            "x_bar()": robot.x_bar_raw,
            "beta()": robot.beta_raw,
            "x()": robot.x_raw,
            "holds_invariants()": robot.holds_invariants(),
        }
        for counter_name, count in asdict(robot.counters).items():
            results[f"{counter_name}()"] = count
        return robot.state() | results

    def _image(self) -> bytes:
        """Return the robot's state as ``save`` writes it; no bytes if there is no robot."""
        return b"" if self._robot is None else self._robot.save()


def _outcome_of(action: Callable[[], str]) -> str:
    """Run an action, and return what it returns or, if it raises a FirmwareError, the name of its status."""
    try:
        return action()
    except FirmwareError as error:
        return error.status.name


@dataclass(frozen=True)
class Failure:
    """A scenario in which something is wrong.

    Attributes:
        scenario: The robot and the calls up to the one that showed it; no calls if the robot itself did.
        problems: A line for each wrong thing.
    """

    scenario: Scenario
    problems: tuple[str, ...]

    def as_dict(self) -> dict[str, Any]:
        """Return the failure as plain data, with the line that replays it."""
        calls = [str(call) for call in self.scenario.calls]
        return {"problems": list(self.problems), "calls": calls, "replay": str(self.scenario)}

    def __str__(self) -> str:
        """Return lines for people: the setup, the calls, the problems, and the command that replays them."""
        setup, calls = self.scenario.setup, self.scenario.calls
        lines = [f"FAILED at call {len(calls)}; of two values that differ the first is native's"]
        # Number 0 is the robot itself.
        lines += [f"  {number:3d}  {item}" for number, item in enumerate([setup, *calls])]
        lines += [f"  wrong: {problem}" for problem in self.problems]
        lines.append(f"replay: mcp-asdf crosscheck --replay {self.scenario}")
        return "\n".join(lines)


CheckCall = Callable[[CallRecord], list[str]]
"""A function that checks a call by the results before and after it, and returns one line per problem."""

CheckScenario = Callable[[Scenario], Failure | None]
"""A function that runs a scenario, and returns what is wrong in it."""


def compare_firmwares(
    scenario: Scenario, first: Firmware, second: Firmware, check_call: CheckCall | None = None
) -> Failure | None:
    """Run a scenario on both firmwares, and return the first failure, or None if nothing is wrong.

    A failure is a difference between them or, if they agree, a problem that ``check_call`` reports. Its
    scenario ends with the call that showed it. If both firmwares refuse to make the robot, nothing is wrong
    and no call is made.
    """
    first_robot = RobotUnderTest(first, scenario.setup)
    second_robot = RobotUnderTest(second, scenario.setup)
    # Before any call: the states of the new robots, or the errors by which they were refused.
    problems = differences(first_robot.last_result, second_robot.last_result)
    if problems:
        return Failure(scenario.first_calls(0), tuple(problems))
    is_robot_refused = first_robot.last_result.state == {}
    if is_robot_refused:
        return None
    for call_count, call in enumerate(scenario.calls, start=1):
        before = first_robot.last_result
        after = first_robot.apply(call)
        problems = differences(after, second_robot.apply(call))
        if check_call is not None and not problems:
            problems = check_call(CallRecord(scenario.setup, call, before, after))
        if problems:
            return Failure(scenario.first_calls(call_count), tuple(problems))
    return None


def differences(first: CallResult, second: CallResult) -> list[str]:
    """Compare two results of the same call, and return one line per difference, with both values.

    Compared are the outcomes and, where both results have them, the fields of the states and the words of the
    images. An exception that no firmware may raise gets a line even if both have raised it.
    """
    lines = []
    if first.outcome != second.outcome:
        lines.append(f"status: {first.outcome}, {second.outcome}")
    elif first.outcome not in Status.__members__:
        lines.append(f"both: {first.outcome}")
    # Results are usually equal, and the loops below would only take time. Without a robot, or after an
    # exception, there is no state to compare.
    if first == second or not first.state or not second.state:
        return lines
    for name in first.state | second.state:
        first_value, second_value = first.state.get(name), second.state.get(name)
        if first_value != second_value:
            lines.append(f"{name}: {first_value}, {second_value}")
    word_pairs = zip(unpack_image(first.image), unpack_image(second.image), strict=True)
    for word_index, (first_word, second_word) in enumerate(word_pairs):
        if first_word != second_word:
            lines.append(f"save(), word {word_index}: {first_word:#010x}, {second_word:#010x}")
    return lines


@dataclass
class CrosscheckResult:
    """Result of a cross-check.

    Attributes:
        calls: Number of calls that were made and compared.
        scenarios: Number of scenarios to which they belong.
        failure: The failure at which the check ended, if there was one.
        interrupted: Whether Ctrl-C ended it early.
    """

    calls: int = 0
    scenarios: int = 0
    failure: Failure | None = None
    interrupted: bool = False


def run_crosscheck(
    check_scenario: CheckScenario, seed: int, calls: int, on_calls: Callable[[int], object]
) -> CrosscheckResult:
    """Check the random scenarios of ``seed`` until ``calls`` calls were made, a scenario fails, or Ctrl-C.

    ``on_calls`` is called after each scenario with the number of calls that were made in it. The last
    scenario is cut short, so that no more than ``calls`` calls are made. The result says how many calls and
    scenarios were checked, which scenario failed, and whether Ctrl-C ended the check.
    """
    result = CrosscheckResult()
    try:
        while result.calls < calls and result.failure is None:
            full_scenario = _generate_scenario(seed, result.scenarios)
            scenario = full_scenario.first_calls(calls - result.calls)
            result.failure = check_scenario(scenario)
            # The scenario of a failure ends with the call that showed it: no more calls were made.
            checked_scenario = scenario if result.failure is None else result.failure.scenario
            result.calls += len(checked_scenario.calls)
            result.scenarios += 1
            on_calls(len(checked_scenario.calls))
    except KeyboardInterrupt:
        result.interrupted = True
    return result


def _generate_scenario(seed: int, index: int) -> Scenario:
    """Return the scenario of a seed and an index; the filters of ``CHECKED_FILTERS`` take turns.

    Indexes 0 to 2 are of robots with the paper's filters, 3 of one with the robust filter, and so on.
    """
    filters_of_round: list[CheckedFilter] = []
    for checked_filter in CHECKED_FILTERS:
        filters_of_round += [checked_filter] * checked_filter.scenarios_in_turn
    filter_in_turn = filters_of_round[index % len(filters_of_round)]
    return filter_in_turn.make_scenario(seed, index)


def shrink(failure: Failure, check_scenario: CheckScenario) -> Failure:
    """Return the failure of a shorter scenario, by leaving out calls without which the check still fails.

    ``failure`` is one that the check has found. Nothing is left to leave out of the result: without any one
    of its calls, or any one number that a restore replaces, the check passes. For a scenario of a hundred
    calls this takes a few hundred runs of the check.
    """
    block_length = len(failure.scenario.calls)
    # Long blocks of calls are left out first, since most calls are not needed. When a failing scenario needs
    # all its blocks of this length, blocks of half the length are tried.
    while block_length > 0:
        shorter_scenarios = _shorter_scenarios(failure.scenario, block_length)
        shorter_failure = _first_failure(shorter_scenarios, check_scenario)
        if shorter_failure is None:
            block_length //= 2
        else:
            failure = shorter_failure
    return failure


def _first_failure(scenarios: Iterable[Scenario], check_scenario: CheckScenario) -> Failure | None:
    """Check scenarios up to the first that fails, and return its failure; None if all pass."""
    for scenario in scenarios:
        failure = check_scenario(scenario)
        if failure is not None:
            return failure
    return None


def _shorter_scenarios(scenario: Scenario, block_length: int) -> Iterator[Scenario]:
    """Yield shorter versions of a scenario, each without one block of ``block_length`` calls in a row.

    If ``block_length`` is 1, yield also versions in which a restore replaces one number less.
    """
    calls = scenario.calls
    for block_start in range(0, len(calls), block_length):
        block_end = block_start + block_length
        yield scenario.replace_calls(calls[:block_start] + calls[block_end:])
    if block_length > 1:
        return
    for call_index, call in enumerate(calls):
        for number_index in range(len(call.new_numbers)):
            fewer_numbers = call.new_numbers[:number_index] + call.new_numbers[number_index + 1 :]
            shorter_call = replace(call, new_numbers=fewer_numbers)
            yield scenario.replace_calls((*calls[:call_index], shorter_call, *calls[call_index + 1 :]))
