"""Verification of a real controller, which must behave as a model of it does.

The controller is taken through phases (``phases``), in lockstep with the model, up to the first difference.
The verdict gives that difference, phase, tick, field, expected and got, and what was not put to the test.
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
from mcp_asdf_tools.radio.filter_phases import updates_to_see
from mcp_asdf_tools.radio.neighbourhood import RadioSettings
from mcp_asdf_tools.radio.phases import PHASES, Phase, is_halved, is_in_reach
from mcp_asdf_tools.radio.protocol_phases import CROWDED_MESSAGES
from mcp_asdf_tools.radio.rounds import CRAFTED_SIZES
from mcp_asdf_tools.robots.lockstep import LockstepError
from mcp_asdf_tools.robots.robot_setup import RobotSetup
from mcp_asdf_tools.swarm.fault_injection.fault import Fault
from mcp_asdf_tools.swarm.fault_injection.parsing import parse_fault

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
        injected: Number of disturbances by the fault.
        equal: Frames of the controller that equal the model's.
        outcome: PASSED, FAILED, DISTURBED, NOT_EXERCISED (it passed, but nothing went wrong) or NOT_RUN.
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
        difference: First difference between the controller and the model; None if there is none.
        disturbance: The other node, or the failure of the bus, that ended the run, in words; None if none.
        not_exercised: Claims about the controller that the run has not put to the test.
        not_checked: What no verdict on a controller of this configuration says.
        is_interrupted: Whether the verification was asked to stop before its end.
        repeated: Commands repeated because the controller had not answered.
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
        """True if every phase has passed, and every claim was put to the test."""
        return all(phase.outcome == PASSED for phase in self.phases) and not self.not_exercised

    @property
    def headline(self) -> str:
        """The verdict in a sentence or two."""
        passed = sum(phase.outcome == PASSED for phase in self.phases)
        count = f"{passed} of {len(self.phases)} phases passed"
        if self.has_passed:
            repeated = f"; {self.repeated} commands were repeated" * bool(self.repeated)
            return f"PASSED: {count}; every frame of the controller equals the model's{repeated}"
        if self.difference is not None:
            return f"FAILED: {count}; first in {self.difference}"
        if self.disturbance is not None:
            return f"DISTURBED, no verdict: {count}; {self.disturbance}"
        if self.is_interrupted:
            return f"INTERRUPTED: {count}"
        empty = [f'the fault of phase "{phase.name}"' for phase in self.phases if phase.outcome != PASSED]
        missing = "; ".join(empty + self.not_exercised)
        return f"NOT EXERCISED: {count}, no difference, but never put to the test: {missing}"

    def lists(self) -> dict[str, list[str]]:
        """What the verdict leaves open, by title; empty lists are left out."""
        lists = {"Not exercised": self.not_exercised, "Not checked": self.not_checked}
        return {title: entries for title, entries in lists.items() if entries}

    def plain(self) -> dict[str, Any]:
        """The verdict as plain values, for JSON."""
        return {"passed": self.has_passed, **vars(self), "phases": [vars(phase) for phase in self.phases]}


def planned(settings: RadioSettings, phases: Sequence[Phase], ticks: int) -> tuple[list[Phase], list[Fault]]:
    """The phases for this controller, with one more for each fault of the settings, and their faults.

    A phase among neighbours has ``ticks`` ticks, and its faults alone, from its first tick to its last.
    Raises UsageError if the controller broadcasts too rarely.
    """
    comms_period = settings.controller.comms_period
    if comms_period > LONGEST_ROUND:
        raise UsageError(
            f"comms-period is {comms_period}; a verification has hundreds of rounds, so "
            f"set the controller up with at most {LONGEST_ROUND} ticks"
        )
    ids = [str(neighbour.id) for neighbour in settings.neighbours]
    names = {"me": settings.controller.id, "them": "+".join(ids), "one": ids[0]}
    applying = [phase for phase in phases if phase.applies(settings.controller)]
    plan = [replace(phase, fault=phase.fault.format(**names)) for phase in applying]
    plan += [Phase(fault.name, fault=str(fault)) for fault in settings.faults]
    faults = [
        replace(parse_fault(text), start=place * ticks, stop=(place + 1) * ticks)
        for place, phase in enumerate(each for each in plan if each.play is None)
        for text in phase.fault.split()
    ]
    return plan, faults


def not_checked(record: RobotSetup) -> list[str]:
    """Properties that a verdict on a controller of this configuration leaves open."""
    config = record.config
    filters = config.filter is not Filter.OFF
    sizes = ", ".join(map(str, CRAFTED_SIZES))
    limits = (
        (config.filter is Filter.ADAPTIVE, f"thresholds of rounds of other sizes than {sizes}"),
        (not filters, "the test and re-estimates: it does not filter"),
        (config.filter is Filter.ALWAYS, "the test: it re-estimates always"),
        (filters and config.filter_period == 1, "rounds without a test: all have one"),
        (record.comms_period == 1, "rounds longer than a tick: it broadcasts in each"),
        (not is_halved(record), f"forgetting: its memory is {config.memory}, too long for a run"),
        (filters and config.filter is not Filter.ROBUST, "a re-estimate before its first white tile"),
        (filters, f"a counter of more than {updates_to_see(record)} updates"),
        (
            filters and config.filter is not Filter.ROBUST,
            "a re-estimate from tiles of both colours before some 200 observations",
        ),
        (True, f"more than {CROWDED_MESSAGES} messages in a tick"),
        (True, "its own clock, sensor and telemetry period: commands replace them"),
        (True, "saving and restoring of its state"),
        (True, "its behaviour on a bus with error frames, CAN FD frames or a bus-off of its own"),
        (True, "vendor status and spare bits of heartbeats, and frames of other subjects"),
        (True, "the largest alpha of its own, which takes 46,341 observations or more"),
    )
    return [text for holds, text in limits if holds]


class Verification:
    """Verification of a controller that has just started and done nothing yet."""

    def __init__(
        self, settings: RadioSettings, options: BenchOptions, phases: Sequence[Phase] = PHASES
    ) -> None:
        """Prepare the phases, with one more for each fault of the settings. Raises as ``planned``."""
        # Everything that a fault may strike, a broadcast too, comes in each phase.
        self._phase_ticks = max(options.ticks, 2 * settings.controller.comms_period)
        self._phases, faults = planned(settings, phases, self._phase_ticks)
        self.bench = Bench(replace(settings, faults=tuple(faults)), options)
        self.verdict = ControllerVerdict(
            [PhaseResult(phase.name, phase.fault or None) for phase in self._phases],
            not_checked=not_checked(settings.controller),
        )

    def run(self) -> ControllerVerdict:
        """Go through the phases up to the first difference."""
        verdict, bench = self.verdict, self.bench
        phase, result = self._phases[0], verdict.phases[0]
        try:
            if bench.options.wait is not None:
                bench.lockstep.wait_until_up({bench.setup.id}, bench.options.wait)
            for phase, result in zip(self._phases, verdict.phases, strict=True):
                self._run_phase(phase, result)
            bench.compare_late_frames()
            verdict.not_exercised = self._not_exercised()
            counts = bench.firmware.s
            verdict.not_checked.append(f"counts above t = {counts.t} and n = {counts.n}")
            verdict.not_checked += [
                f"whether it {mistake}: no frame of this run would have shown it"
                for mistake in bench.lineup.models
            ]
        except KeyboardInterrupt:
            verdict.is_interrupted = True
        except (BusDisturbed, can.CanError) as error:
            result.outcome = DISTURBED
            verdict.disturbance = f"{self._place(phase)}: {error}"
        except ControllerDiffers as error:
            result.outcome = FAILED
            verdict.difference = f"{self._place(phase)}: {error}"
        except LockstepError as error:
            result.outcome = FAILED
            said = bench.take_difference()  # who did not answer may have said something else
            told = error if said is None or said.field == "missing" else said
            verdict.difference = f"{self._place(phase)}: {told}"
        verdict.repeated = bench.lockstep.repeated
        return verdict

    def _not_exercised(self) -> list[str]:
        config = self.bench.config
        if config.filter is not Filter.OFF and not is_in_reach(self.bench.setup):
            return ["the filter: its period is too long for a run", *self.bench.not_exercised]
        return self.bench.not_exercised

    def _run_phase(self, phase: Phase, result: PhaseResult) -> None:
        bench, before = self.bench, self._figures()
        bench.activity = phase.fault or phase.name
        try:
            if phase.play is not None:
                phase.play(bench)
            else:
                for _ in range(self._phase_ticks):
                    bench.play_tick_among_neighbours()
        finally:
            for name, figure in self._figures().items():
                setattr(result, name, figure - before[name])
        result.outcome = NOT_EXERCISED if phase.fault and not result.injected else PASSED

    def _figures(self) -> dict[str, int]:
        """The figures of a ``PhaseResult`` so far, for all phases together."""
        bench = self.bench
        injected = sum(figure["injected"] for figure in bench.neighbours.faults.figures())
        return {"ticks": bench.ticks, "injected": injected, "equal": bench.comparison.equal_frames.total()}

    def _place(self, phase: Phase) -> str:
        doing = self.bench.activity
        also = f" ({doing})" if doing and doing not in (phase.name, phase.fault) else ""
        return f'phase "{phase.name}"{also}, tick {self.bench.tick_index}'


# --- Reports ---

COLUMNS = {
    "name": "phase",
    "ticks": "ticks",
    "injected": "injected",
    "equal": "equal frames",
    "outcome": "outcome",
    "fault": "fault",
}
"""Figures of each phase, and their headings."""


def details(verdict: ControllerVerdict) -> str:
    """The table of the phases, its columns aligned, and what the verdict leaves open, in Markdown."""
    rows = [tuple(COLUMNS.values())]
    rows += [tuple(str(getattr(phase, name) or "") for name in COLUMNS) for phase in verdict.phases]
    widths = [max(map(len, column)) for column in zip(*rows, strict=True)]
    widths[-1] = len(COLUMNS["fault"])
    rows.insert(1, tuple("-" * width for width in widths))
    lines = ["| " + " | ".join(map(str.ljust, row, widths)) + " |" for row in rows]
    for title, entries in verdict.lists().items():
        lines += ["", f"{title}:", "", *(f"- {entry}" for entry in entries)]
    return "\n".join(lines) + "\n"


def markdown(verdict: ControllerVerdict, report: dict[str, Any]) -> str:
    """The verdict in Markdown, with what is needed to repeat the run."""
    bus, robot = report["bus"], report["parameters"]["controller"]["id"]
    everything = {key: report[key] for key in ("parameters", "versions")}
    return f"""# Verification of a controller

Robot {robot} on {bus["interface"]} {bus["channel"] or ""}, {report["time"]}. Filter: {report["filter"]}.

**{verdict.headline}**

{details(verdict)}
To repeat it:

```json
{json.dumps(everything, indent=2)}
```
"""
