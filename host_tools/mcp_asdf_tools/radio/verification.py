"""Verification of a real controller, which must behave as a model of it does.

The controller is taken through phases (``phases``), in lockstep with the model, up to the first difference.
The verdict gives that difference with its likely cause (``causes``), or else what was put to the test and
what was not (``coverage``).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass, field, replace
from typing import Any

import can

from mcp_asdf_tools.common import UsageError
from mcp_asdf_tools.radio.causes import cause_of
from mcp_asdf_tools.radio.comparison import BUS, Symptom
from mcp_asdf_tools.radio.coverage import LONG_RUN, Coverage, is_halved, not_checked, not_exercised
from mcp_asdf_tools.radio.model import Model
from mcp_asdf_tools.radio.neighbourhood import RadioSettings
from mcp_asdf_tools.radio.phases import PHASES, Phase, among_neighbours
from mcp_asdf_tools.radio.stage import ControllerBench, Differs, Stage
from mcp_asdf_tools.radio.strangers import Disturbed
from mcp_asdf_tools.robots import LockstepError
from mcp_asdf_tools.swarm import Fault, parse_fault

PASSED, FAILED, NOT_EXERCISED, NOT_RUN = "passed", "failed", "not exercised", "not run"
DISTURBED = "disturbed"

LONGEST_ROUND = 1000
"""Ticks between the broadcasts of a controller that is verified."""


@dataclass
class PhaseResult:
    """Result of a phase.

    Attributes:
        name: Name of the phase.
        fault: The fault that struck, as text; None if none.
        ticks: Ticks done.
        frames: Frames that the controller was sent besides commands.
        injected: Number of disturbances by the fault.
        broadcasts: Estimates of the controller that equal the model's.
        answers: Telemetry frames of the controller that equal the model's.
        outcome: PASSED, FAILED, DISTURBED, NOT_EXERCISED (it passed, but nothing went wrong) or NOT_RUN.
    """

    name: str
    fault: str | None
    ticks: int = 0
    frames: int = 0
    injected: int = 0
    broadcasts: int = 0
    answers: int = 0
    outcome: str = NOT_RUN


@dataclass
class ControllerVerdict:
    """Verdict on a controller.

    Attributes:
        phases: Result of each phase, in order.
        coverage: What the controller was taken through.
        difference: First difference between the controller and the model; None if there is none.
        cause: The mistake that gives this difference, in words; None without a difference.
        disturbance: The stranger that ended the run, in words; None if there was none.
        strangers: Nodes that had no part in the run, in words.
        not_exercised: Claims about the controller that the run has not put to the test.
        not_checked: What no verdict on a controller of this configuration says.
        is_interrupted: Whether the verification was asked to stop before its end.
        other_frames: Frames of the controller that were not judged.
        repeated: Commands repeated because the controller had not answered.
    """

    phases: list[PhaseResult]
    coverage: Coverage
    difference: str | None = None
    cause: str | None = None
    disturbance: str | None = None
    strangers: list[str] = field(default_factory=list)
    not_exercised: list[str] = field(default_factory=list)
    not_checked: list[str] = field(default_factory=list)
    is_interrupted: bool = False
    other_frames: int = 0
    repeated: int = 0

    @property
    def has_passed(self) -> bool:
        """True if every phase has passed, and every claim was put to the test."""
        return all(phase.outcome == PASSED for phase in self.phases) and not self.not_exercised

    def plain(self) -> dict[str, Any]:
        """The verdict as plain values, for JSON."""
        return {
            "passed": self.has_passed,
            **vars(self),
            "phases": [asdict(phase) for phase in self.phases],
            "coverage": self.coverage.plain(),
        }


def planned(settings: RadioSettings, phases: Sequence[Phase], ticks: int) -> tuple[list[Phase], list[Fault]]:
    """The phases for this controller, with one more for each fault of the settings, and their faults.

    A phase among neighbours has ``ticks`` ticks, and its faults alone, from its first tick to its last.
    Raises UsageError if the controller broadcasts too rarely.
    """
    comms_period = settings.controller.config.comms_period
    if comms_period > LONGEST_ROUND:
        raise UsageError(
            f"comms-period is {comms_period}; a verification has hundreds of rounds, so "
            f"set the controller up with at most {LONGEST_ROUND} ticks"
        )
    ids = [str(neighbour.id) for neighbour in settings.neighbours]
    names = {"me": settings.controller.id, "them": "+".join(ids), "one": ids[0]}
    applying = [phase for phase in phases if phase.applies(settings.controller.config)]
    plan = [replace(phase, fault=phase.fault.format(**names)) for phase in applying]
    plan += [Phase(fault.kind.value, fault=str(fault)) for fault in settings.faults]
    faults = [
        replace(parse_fault(text), start=place * ticks, stop=(place + 1) * ticks)
        for place, phase in enumerate(each for each in plan if each.play is None)
        for text in phase.fault.split()
    ]
    return plan, faults


class Verification:
    """Verification of a controller that has just started and done nothing yet."""

    def __init__(
        self, settings: RadioSettings, bench: ControllerBench, phases: Sequence[Phase] = PHASES
    ) -> None:
        """Prepare the phases, with one more for each fault of the settings. Raises as ``planned``."""
        self._settings, self._bench = settings, bench
        # Everything that a fault may strike, a broadcast too, comes in each phase.
        self._phase_ticks = max(bench.ticks, 2 * settings.controller.config.comms_period)
        self._phases, faults = planned(settings, phases, self._phase_ticks)
        self._stage = Stage(replace(settings, faults=tuple(faults)), bench)
        results = [PhaseResult(phase.name, phase.fault or None) for phase in self._phases]
        self.verdict = ControllerVerdict(results, self._stage.model.coverage)

    @property
    def model(self) -> Model:
        """The model of the controller."""
        return self._stage.model

    @property
    def expected_ticks(self) -> int:
        """About how many ticks the run takes."""
        config = self._settings.controller.config
        waiting = sum(phase.tests for phase in self._phases) * config.filter_period
        observing = 3 * config.memory if is_halved(config) else LONG_RUN
        return max(waiting, observing) + self._phase_ticks * len(self._phases)

    def run(self) -> ControllerVerdict:
        """Go through the phases up to the first difference."""
        verdict, stage = self.verdict, self._stage
        phase, result = self._phases[0], verdict.phases[0]
        try:
            stage.begin()
            for phase, result in zip(self._phases, verdict.phases, strict=True):
                self._run_phase(phase, result)
            stage.listen_on()
            verdict.not_exercised = not_exercised(verdict.coverage)
        except KeyboardInterrupt:
            verdict.is_interrupted = True
        except Disturbed as stranger:
            result.outcome = DISTURBED
            verdict.disturbance = f"{self._place(phase)}: {stranger}"
        except (Differs, LockstepError, can.CanError) as error:
            result.outcome = FAILED
            self._explain(self._symptom(error), phase)
        verdict.not_checked = not_checked(verdict.coverage)
        verdict.strangers = stage.strangers.lines()
        verdict.other_frames = stage.comparison.others
        verdict.repeated = stage.lockstep.repeated
        return verdict

    def _run_phase(self, phase: Phase, result: PhaseResult) -> None:
        stage, before = self._stage, self._figures()
        stage.doing = phase.fault or phase.name
        try:
            if phase.play is not None:
                phase.play(stage)
            else:
                for _ in range(self._phase_ticks):
                    among_neighbours(stage)
        finally:
            for name, figure in self._figures().items():
                setattr(result, name, figure - before[name])
        result.outcome = NOT_EXERCISED if phase.fault and not result.injected else PASSED

    def _figures(self) -> dict[str, int]:
        """The figures of a ``PhaseResult`` so far, for all phases together."""
        stage, equal = self._stage, self.verdict.coverage.equal
        return {
            "ticks": stage.ticks,
            "frames": stage.frames,
            "injected": sum(figure["injected"] for figure in stage.neighbours.faults.figures()),
            "broadcasts": equal["estimate"],
            "answers": equal["telemetry"],
        }

    def _symptom(self, error: Exception) -> Symptom:
        """The symptom of what ended the run; who did not answer may have said something else."""
        if isinstance(error, Differs):
            return error.symptom
        if isinstance(error, can.CanError):
            return Symptom(BUS, "failed", str(error))
        found = self._stage.symptom()
        if found is None:
            return Symptom(BUS, "absent", str(error))
        return replace(found, text=str(error)) if found.field in ("missing", "never") else found

    def _explain(self, symptom: Symptom, phase: Phase) -> None:
        self.verdict.difference = f"{self._place(phase)}: {symptom.text}"
        self.verdict.cause = cause_of(symptom, phase.name, self._stage.doing)

    def _place(self, phase: Phase) -> str:
        doing = self._stage.doing
        also = f" ({doing})" if doing and doing not in (phase.name, phase.fault) else ""
        return f'phase "{phase.name}"{also}, tick {self._stage.place}'
