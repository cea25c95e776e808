"""Verification of a real controller: its frames must equal those of a model of it, bit for bit.

The controller is taken through phases (``phases``), in lockstep with the model, up to the first difference.
The verdict names the difference with its phase, tick and field, what was expected and what was received, and
lists what was not put to the test.
"""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import can

from mcp_asdf.robot import Filter
from mcp_asdf_tools.common.errors import UsageError
from mcp_asdf_tools.radio.bench import Bench
from mcp_asdf_tools.radio.controller_link import BenchOptions, BusDisturbed, ControllerDiffers
from mcp_asdf_tools.radio.filter_phases import SIZES_AT_THRESHOLD, required_updates
from mcp_asdf_tools.radio.neighbourhood import RadioSettings
from mcp_asdf_tools.radio.phases import PHASES, Phase, can_fill_memory, can_wait_for_tests
from mcp_asdf_tools.radio.protocol_phases import CROWDED_MESSAGES
from mcp_asdf_tools.radio.robust_phases import (
    can_contradict_extreme_estimate,
    can_estimates_decide_test,
    can_largest_spread_decide_test,
)
from mcp_asdf_tools.robots.lockstep import LockstepError
from mcp_asdf_tools.robots.robot_setup import RobotSetup
from mcp_asdf_tools.swarm.fault_injection.fault import Fault
from mcp_asdf_tools.swarm.fault_injection.parsing import parse_fault

PASSED, FAILED, NOT_EXERCISED, NOT_RUN = "passed", "failed", "not exercised", "not run"
DISTURBED = "disturbed"

_MAX_COMMS_PERIOD = 1000
"""Largest number of ticks between broadcasts of a controller that is verified."""


@dataclass
class PhaseResult:
    """Result of one phase.

    Attributes:
        name: Name of the phase.
        fault: The faults that were injected, as text; None if none.
        ticks: Number of ticks done.
        injected: Number of times that a fault affected a frame or a robot.
        equal: Number of the controller's frames that equal the model's.
        outcome: PASSED, FAILED, DISTURBED, NOT_EXERCISED (no difference, but its fault affected nothing) or
            NOT_RUN.
    """

    name: str
    fault: str | None
    ticks: int = 0
    injected: int = 0
    equal: int = 0
    outcome: str = NOT_RUN


@dataclass
class ControllerVerdict:
    """Verdict on a controller.

    Attributes:
        phases: Result of each phase, in order.
        difference: First difference between the controller and the model, with phase and tick; None if there
            is none.
        disturbance: The other node, or the failure of the bus, that ended the run, in words; None if none.
        not_exercised: Cases that the run should have brought about and has not; the controller has not passed
            without them.
        not_checked: Properties that the run did not check, in words, even if the controller has passed.
        is_interrupted: Whether the verification was asked to stop before its end.
        repeated: Number of commands that were sent again because the controller had not answered.
    """

    phases: list[PhaseResult]
    difference: str | None = None
    disturbance: str | None = None
    not_exercised: list[str] = field(default_factory=list)
    not_checked: list[str] = field(default_factory=list)
    is_interrupted: bool = False
    repeated: int = 0

    @property
    def has_passed(self) -> bool:
        """Whether every phase has passed and every case was brought about."""
        have_phases_passed = all(phase.outcome == PASSED for phase in self.phases)
        return have_phases_passed and not self.not_exercised

    @property
    def headline(self) -> str:
        """The verdict in a sentence or two, beginning with PASSED, FAILED, DISTURBED or the like."""
        passed_phases = [phase for phase in self.phases if phase.outcome == PASSED]
        count = f"{len(passed_phases)} of {len(self.phases)} phases passed"
        if self.has_passed:
            repetitions = f"; {self.repeated} commands were repeated" if self.repeated > 0 else ""
            return f"PASSED: {count}; every frame of the controller equals the model's{repetitions}"
        if self.difference is not None:
            return f"FAILED: {count}; first in {self.difference}"
        if self.disturbance is not None:
            return f"DISTURBED, no verdict: {count}; {self.disturbance}"
        if self.is_interrupted:
            return f"INTERRUPTED: {count}"
        # No difference has ended the run, so that a phase has not passed only if its fault affected nothing.
        faults_without_effect = [
            f'the fault of phase "{phase.name}"' for phase in self.phases if phase.outcome != PASSED
        ]
        untested_cases = "; ".join(faults_without_effect + self.not_exercised)
        return f"NOT EXERCISED: {count}, no difference, but never put to the test: {untested_cases}"

    def open_points(self) -> dict[str, list[str]]:
        """Return the lists of what is not exercised and not checked by title, those that are not empty."""
        lists = {"Not exercised": self.not_exercised, "Not checked": self.not_checked}
        return {title: entries for title, entries in lists.items() if entries}

    def plain(self) -> dict[str, Any]:
        """Return the attributes as plain values, for JSON, and under "passed" whether the controller has."""
        phases = [vars(phase) for phase in self.phases]
        return {"passed": self.has_passed, **vars(self), "phases": phases}


def plan_phases(
    settings: RadioSettings, phases: Sequence[Phase], ticks: int
) -> tuple[list[Phase], list[Fault]]:
    """Choose the phases that apply to this controller, and schedule their faults.

    Each fault of the settings adds one more phase among neighbours. A phase among neighbours has ``ticks``
    ticks, with its own faults alone. Raises UsageError if the controller broadcasts too rarely.

    Returns:
        The phases, with ids in place of {me}, {them} and {one}, and their faults. Faults begin and stop at
        ticks of the neighbours, which count only the phases among neighbours.
    """
    comms_period = settings.controller.comms_period
    if comms_period > _MAX_COMMS_PERIOD:
        raise UsageError(
            f"comms-period is {comms_period}; a verification has hundreds of rounds, so "
            f"set the controller up with at most {_MAX_COMMS_PERIOD} ticks"
        )
    chosen_phases = _choose_phases(settings, phases)
    return chosen_phases, _schedule_faults(chosen_phases, ticks)


def _choose_phases(settings: RadioSettings, phases: Sequence[Phase]) -> list[Phase]:
    """Return the phases that apply to this controller, and then one for each fault of the settings.

    In the texts of faults {me} becomes the controller's id, {them} all ids of neighbours, joined by "+", and
    {one} the id of the first neighbour.
    """
    neighbour_ids = [str(neighbour.id) for neighbour in settings.neighbours]
    all_neighbours = "+".join(neighbour_ids)
    chosen_phases = []
    for phase in phases:
        if phase.applies(settings.controller):
            # The user chooses all ids, so that the texts of faults cannot have them.
            fault = phase.fault.format(me=settings.controller.id, them=all_neighbours, one=neighbour_ids[0])
            chosen_phases.append(replace(phase, fault=fault))
    # The faults that the user has asked for come last.
    phases_of_settings = [Phase(fault.name, fault=str(fault)) for fault in settings.faults]
    return chosen_phases + phases_of_settings


def _schedule_faults(phases: Sequence[Phase], ticks: int) -> list[Fault]:
    """Return the faults of all phases. Each fault begins and stops with its phase.

    It does so at ticks that the neighbours count. They have ``ticks`` ticks in a phase among neighbours, and
    none in any other phase.
    """
    # The other phases have a function that plays them.
    phases_among_neighbours = [phase for phase in phases if phase.play is None]
    faults = []
    for index, phase in enumerate(phases_among_neighbours):
        first_tick = index * ticks
        for fault_text in phase.fault.split():  # one or more, with spaces in between
            fault = parse_fault(fault_text)
            faults.append(replace(fault, start=first_tick, stop=first_tick + ticks))
    return faults


def not_checked(setup: RobotSetup) -> list[str]:
    """Return the properties that no verification of a controller with this setup checks, as phrases.

    Such are thresholds of rounds of other sizes, its own clock and sensor, or forgetting in a long memory.
    """
    config = setup.config
    has_filter = config.filter is not Filter.OFF
    has_asdf_filter = config.filter in (Filter.ADAPTIVE, Filter.ALWAYS)
    has_robust_filter = config.filter is Filter.ROBUST
    sizes = ", ".join(map(str, SIZES_AT_THRESHOLD))
    # Each phrase stands behind the condition under which it applies to this controller.
    phrases_by_condition = (
        (config.filter is Filter.ADAPTIVE, f"thresholds of rounds of other sizes than {sizes}"),
        (not has_filter, "the test and re-estimates: it does not filter"),
        (config.filter is Filter.ALWAYS, "the test: it re-estimates always"),
        (has_filter and config.filter_period == 1, "rounds without a test: all have one"),
        (setup.comms_period == 1, "rounds longer than a tick: it broadcasts in each"),
        (not can_fill_memory(setup), f"forgetting: its memory is {config.memory}, too long for a run"),
        (has_asdf_filter, "a re-estimate before its first white tile"),
        (has_filter, f"a counter of more than {required_updates(setup)} updates"),
        (has_asdf_filter, "a re-estimate from tiles of both colours before some 200 observations"),
        (has_robust_filter, "rounding of its test below that of float64, and ties of those that support it"),
        (has_robust_filter, "the last step to the centre of its estimates, which seldom moves it"),
        (
            has_robust_filter and not can_estimates_decide_test(setup),
            "its test at the threshold: its b_hat is too close to 1/2",
        ),
        (
            has_robust_filter and not can_contradict_extreme_estimate(setup),
            "those that support it, and a b_hat of exactly 1/2: a run has too few observations",
        ),
        (
            has_robust_filter and not can_largest_spread_decide_test(setup),
            "the largest spread in its test: no observations of a run show it",
        ),
        (True, f"more than {CROWDED_MESSAGES} messages in a tick"),
        (True, "its own clock, sensor and telemetry period: commands replace them"),
        (True, "saving and restoring of its state"),
        (True, "its behaviour on a bus with error frames, CAN FD frames or a bus-off of its own"),
        (True, "vendor status and spare bits of heartbeats, and frames of other subjects"),
        (True, "the largest alpha of its own, which takes 46,341 observations or more"),
    )
    return [phrase for applies, phrase in phrases_by_condition if applies]


class Verification:
    """Verification of a controller that has just started and done nothing yet.

    Attributes:
        bench: The controller and its model, on which the phases run.
        verdict: The verdict, complete once ``run`` has returned.
    """

    def __init__(
        self, settings: RadioSettings, options: BenchOptions, phases: Sequence[Phase] = PHASES
    ) -> None:
        """Plan the phases and start the model. Raises UsageError if the controller broadcasts too rarely.

        A phase has at least two rounds, so that every fault has a broadcast to affect.
        """
        self._phase_ticks = max(options.ticks, 2 * settings.controller.comms_period)
        self._phases, faults = plan_phases(settings, phases, self._phase_ticks)
        self.bench = Bench(replace(settings, faults=tuple(faults)), options)
        self.verdict = ControllerVerdict(
            [PhaseResult(phase.name, phase.fault or None) for phase in self._phases],
            not_checked=not_checked(settings.controller),
        )
        # What goes wrong before the first phase, or after the last one, is reported in that phase.
        self._phase, self._result = self._phases[0], self.verdict.phases[0]

    def run(self) -> ControllerVerdict:
        """Run the phases up to the first difference, and return the verdict.

        A disturbed bus, a request to stop or a missing answer ends the run, too. If a wrong frame has come in
        place of the answer, the verdict names the frame. The controller's failures are never raised.
        """
        verdict = self.verdict
        try:
            self._run_phases()
            self._add_untested_cases()
        except KeyboardInterrupt:
            verdict.is_interrupted = True
        # These say nothing about the controller.
        except (BusDisturbed, can.CanError) as error:
            verdict.disturbance = self._end_phase(DISTURBED, str(error))
        except ControllerDiffers as error:
            verdict.difference = self._end_phase(FAILED, str(error))
        except LockstepError as error:
            verdict.difference = self._end_phase(FAILED, self._describe_missing_answer(error))
        verdict.repeated = self.bench.lockstep.repeated
        return verdict

    def _end_phase(self, outcome: str, reason: str) -> str:
        """Set the outcome of the present phase, and return the reason with phase, activity and tick."""
        self._result.outcome = outcome
        return f"{self._describe_time()}: {reason}"

    def _describe_missing_answer(self, error: LockstepError) -> str:
        """Return why an answer is missing: the wrong frame that came in its place, or else the error's text.

        A wrong frame says more than that the answer is missing.
        """
        difference = self.bench.pop_difference()
        if difference is None or difference.field == "missing":
            return str(error)
        return str(difference)

    def _run_phases(self) -> None:
        """Wait for the controller if asked to, run all phases, and compare what comes after the last."""
        bench = self.bench
        if bench.options.wait is not None:
            bench.lockstep.wait_until_up({bench.setup.id}, bench.options.wait)
        for phase, result in zip(self._phases, self.verdict.phases, strict=True):
            self._phase, self._result = phase, result
            self._run_phase(phase, result)
        bench.compare_late_frames()

    def _run_phase(self, phase: Phase, result: PhaseResult) -> None:
        """Run a phase and fill in its result: passed, or not exercised if its fault affected nothing.

        If an error ends the phase, its figures are filled in, too, and the error is raised.
        """
        bench = self.bench
        bench.activity = phase.fault or phase.name
        try:
            if phase.play is not None:
                phase.play(bench)
            else:
                for _ in range(self._phase_ticks):
                    bench.play_tick_among_neighbours()
        finally:
            self._fill_in_figures(result)
        has_fault = phase.fault != ""
        result.outcome = NOT_EXERCISED if has_fault and result.injected == 0 else PASSED

    def _fill_in_figures(self, result: PhaseResult) -> None:
        """Set the numbers of ticks, injected faults and equal frames of a phase that has just ended.

        The bench counts over all phases, so the numbers of the earlier phases are subtracted from its counts.
        """
        bench, phases = self.bench, self.verdict.phases
        injected = sum(figures["injected"] for figures in bench.neighbours.faults.figures())
        equal = bench.comparison.equal_frames.total()
        result.ticks = bench.ticks - sum(phase.ticks for phase in phases)
        result.injected = injected - sum(phase.injected for phase in phases)
        result.equal = equal - sum(phase.equal for phase in phases)

    def _add_untested_cases(self) -> None:
        """Add to the verdict, after all phases, the cases that they did not bring about or could not check.

        ``not_exercised`` gets those that the bench has listed, and the filter if its period is too long.
        ``not_checked`` gets larger counts of observations than this run has reached.
        """
        verdict, bench = self.verdict, self.bench
        has_filter = bench.config.filter is not Filter.OFF
        if has_filter and not can_wait_for_tests(bench.setup):
            verdict.not_exercised.append("the filter: its period is too long for a run")
        verdict.not_exercised += bench.not_exercised

        model_state = bench.model_state
        verdict.not_checked.append(f"counts above t = {model_state.t} and n = {model_state.n}")

    def _describe_time(self) -> str:
        """Return phase, activity and tick at present, as a difference is reported with them.

        The activity is left out if it is the name of the phase or its faults, or empty.
        """
        activity = self.bench.activity
        adds_nothing = activity in ("", self._phase.name, self._phase.fault)
        activity_in_brackets = "" if adds_nothing else f" ({activity})"
        return f'phase "{self._phase.name}"{activity_in_brackets}, tick {self.bench.tick_index}'


# --- Reports ---

_HEADINGS = {
    "name": "phase",
    "ticks": "ticks",
    "injected": "injected",
    "equal": "equal frames",
    "outcome": "outcome",
    "fault": "fault",
}
"""Columns of the table of phases: attributes of ``PhaseResult``, and their headings."""


def details(verdict: ControllerVerdict) -> str:
    """Return a table of the phases, and lists of what was not exercised or not checked, in Markdown.

    The table has one row per phase, with its name, ticks, injected faults, equal frames, outcome and fault.
    Figures that are 0 and faults that are None are left blank.
    """
    lines = _format_phases(verdict.phases)
    for title, entries in verdict.open_points().items():
        lines += ["", f"{title}:", "", *(f"- {entry}" for entry in entries)]
    return "\n".join(lines) + "\n"


def _format_phases(phases: Sequence[PhaseResult]) -> list[str]:
    """Return the lines of a Markdown table with aligned columns. It has one row per phase.

    The columns are name, ticks, injected faults, equal frames, outcome and fault.
    """
    rows = []
    for phase in phases:
        values = [getattr(phase, attribute) for attribute in _HEADINGS]
        rows.append([str(value or "") for value in values])  # 0 and None are left blank
    return _format_table(list(_HEADINGS.values()), rows)


def _format_table(headings: list[str], rows: list[list[str]]) -> list[str]:
    """Return the lines of a Markdown table. The columns are aligned, but for long cells of the last one."""
    columns = zip(headings, *rows, strict=True)
    widths = [max(len(cell) for cell in column) for column in columns]
    widths[-1] = len(headings[-1])
    rule = ["-" * width for width in widths]
    lines = []
    for row in [headings, rule, *rows]:
        padded_cells = [cell.ljust(width) for cell, width in zip(row, widths, strict=True)]
        lines.append(f"| {' | '.join(padded_cells)} |")
    return lines


def markdown(verdict: ControllerVerdict, report: dict[str, Any]) -> str:
    """Return the verdict in Markdown, with the parameters and versions that repeat the run.

    ``report`` is that of ``radio --json``: it needs the keys bus, parameters, versions, time and filter.
    """
    bus, robot = report["bus"], report["parameters"]["controller"]["id"]
    to_repeat = {key: report[key] for key in ("parameters", "versions")}
    return f"""# Verification of a controller

Robot {robot} on {bus["interface"]} {bus["channel"] or ""}, {report["time"]}. Filter: {report["filter"]}.

**{verdict.headline}**

{details(verdict)}
To repeat it:

```json
{json.dumps(to_repeat, indent=2)}
```
"""
