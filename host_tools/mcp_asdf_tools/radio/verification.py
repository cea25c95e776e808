"""Verification of a real controller, which must behave as a model of it does while faults strike around it.

The controller is driven in lockstep by command frames. Its broadcasts and answers are compared, bit for bit,
with those of a model that gets the same observations and the very frames that go over the bus. The controller
survives a fault class if they are equal while it strikes.
"""

from __future__ import annotations

import random
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import asdict, dataclass, replace
from typing import Any, NamedTuple

import can

from mcp_asdf_tools.bus import (
    MAX_NODE_ID,
    Message,
    Rejection,
    Telemetry,
    alpha_bits,
    decode,
    decode_telemetry,
    float_of,
)
from mcp_asdf_tools.radio.invalid_frames import malformed, stray_commands
from mcp_asdf_tools.radio.neighbourhood import Neighbourhood, RadioSettings
from mcp_asdf_tools.robots import (
    Lockstep,
    LockstepError,
    LockstepSettings,
    NodeSettings,
    Recorder,
    RobotNode,
    send_all,
)
from mcp_asdf_tools.swarm import Fault, parse_fault

SEND_TIMEOUT = 2.0

PASSED, FAILED, EMPTY, NOT_RUN = "passed", "failed", "nothing happened", "not run"


@dataclass(frozen=True)
class Phase:
    """Ticks with one kind of disturbance.

    Attributes:
        name: Name in reports.
        fault: Faults in the texts of ``parse_fault``, separated by spaces, with {me} for the controller's id,
            {them} for all neighbours and {one} for one of them; None for no fault.
        is_blind: Whether the controller observes nothing.
        invalid: Invalid frames sent besides the regular ones, "malformed" or "commands"; empty for none.
        loses_settles: Whether the *settle* of every other tick is not sent.
    """

    name: str
    fault: str | None = None
    is_blind: bool = False
    invalid: str = ""
    loses_settles: bool = False


PHASES = (
    Phase("nothing wrong"),
    Phase("no observations", is_blind=True),
    Phase("loss", "loss=0.5,receivers={me}"),
    Phase("silence", "loss=1,receivers={me}"),
    Phase("burst loss", "burst=0.5,length=5,receivers={me}"),
    Phase("delay", "delay=0.5,ticks=3,receivers={me}"),
    Phase("repeated messages", "duplicate=0.7,ticks=0,receivers={me}"),
    Phase("reordered messages", "reorder=1,receivers={me}"),
    Phase("corrupted bits", "corrupt=0.5,bits=3,receivers={me}"),
    # In random order, so that a controller that is deaf after a flood misses something.
    Phase("flood", "babble=1,frames=10,robots={them} reorder=1,receivers={me}"),
    Phase("crash and rejoin", "crash=0.05,ticks=5,robots={them}"),
    Phase("frozen neighbours", "freeze=0.8,robots={them}"),
    Phase("liar", "liar=1,x=1,alpha=1e38,robots={one}"),
    Phase("node-id conflict", "collide=0.5,id={me},robots={them}"),
    Phase("bus-off", "busoff=0.1,ticks=5,robots={them}"),
    Phase("full send queues", "queue=0.5,frames=0,robots={them}"),
    Phase("malformed frames", invalid="malformed"),
    Phase("lost commands", loses_settles=True),
    Phase("commands out of order", invalid="commands"),
)


@dataclass
class PhaseResult:
    """Result of a phase.

    Attributes:
        name: Name of the phase.
        fault: The fault that struck, as text; None if none.
        ticks: Ticks done.
        frames: Frames that the controller was sent.
        injected: Number of disturbances.
        broadcasts: Estimates of the controller that equal the model's.
        answers: Telemetry frames of the controller that equal the model's.
        outcome: PASSED, FAILED, EMPTY (it passed, but nothing went wrong) or NOT_RUN.
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
        difference: First difference between the controller and the model; None if there is none.
        is_interrupted: Whether the verification was asked to stop before its end.
        other_frames: Other frames of the controller, such as heartbeats.
        repeated: Commands repeated because the controller had not answered.
    """

    phases: list[PhaseResult]
    difference: str | None = None
    is_interrupted: bool = False
    other_frames: int = 0
    repeated: int = 0

    @property
    def has_passed(self) -> bool:
        """True if every phase has passed."""
        return all(phase.outcome == PASSED for phase in self.phases)

    def plain(self) -> dict[str, Any]:
        """The verdict as plain values, for JSON."""
        return {"passed": self.has_passed} | asdict(self)


class _Differs(Exception):  # noqa: N818 (an outcome, no error)
    """The controller differs from the model."""


def planned(settings: RadioSettings, phases: Sequence[Phase], ticks: int) -> tuple[list[Phase], list[Fault]]:
    """The phases, of ``ticks`` ticks each, with one more for each fault of the settings, and their faults.

    A phase with a fault has it alone, from its first tick to its last.
    """
    ids = [str(neighbour.id) for neighbour in settings.neighbours]
    names = {"me": settings.controller.id, "them": "+".join(ids), "one": ids[0]}
    plan = [replace(phase, fault=phase.fault and phase.fault.format(**names)) for phase in phases]
    plan += [Phase(fault.kind.value, str(fault)) for fault in settings.faults]
    faults = [
        replace(parse_fault(text), start=place * ticks, stop=(place + 1) * ticks)
        for place, phase in enumerate(plan)
        for text in (phase.fault or "").split()
    ]
    return plan, faults


@dataclass
class ControllerBench:
    """Test bench of a controller.

    Attributes:
        bus: Connection to the controller.
        ticks: Ticks of a phase.
        timeout: Seconds that the controller has to answer.
        wait: Seconds to wait for the heartbeat with which it starts; None to begin at once.
        recorder: Takes the controller's events; None if they are not recorded.
        log: Takes all frames, sent and heard.
        progress: Called after each tick with the number of ticks done.
        should_stop: Checked before each tick.
    """

    bus: can.BusABC
    ticks: int
    timeout: float
    wait: float | None = None
    recorder: Recorder | None = None
    log: Callable[[can.Message], None] = lambda frame: None
    progress: Callable[[int], None] = lambda ticks: None
    should_stop: Callable[[], bool] = lambda: False


class Verification:
    """Verification of a controller that has just started and done nothing yet."""

    def __init__(
        self, settings: RadioSettings, bench: ControllerBench, phases: Sequence[Phase] = PHASES
    ) -> None:
        """Prepare the phases, with one more for each fault of the settings."""
        self._phases, faults = planned(settings, phases, bench.ticks)
        self._bench = bench
        self._id = settings.controller.id
        self._subjects = settings.subjects
        self._neighbours = Neighbourhood(replace(settings, faults=tuple(faults)))
        self.model = RobotNode(
            settings.controller.make(),
            NodeSettings(self._id, settings.subjects, settings.swarm.steps_per_second),
            bench.recorder,
        )
        self._lockstep = Lockstep(
            bench.bus, LockstepSettings(settings.subjects), bench.timeout, watch=self._note
        )
        self._draw = random.Random(settings.swarm.seed)
        self._said: list[can.Message] = []
        self._expected: list[can.Message] = []
        self._tick_number = 0
        self.verdict = ControllerVerdict([PhaseResult(phase.name, phase.fault) for phase in self._phases])

    def run(self) -> ControllerVerdict:
        """Go through the phases up to the first difference."""
        phase, result = self._phases[0], self.verdict.phases[0]
        try:
            if self._bench.wait is not None:
                self._lockstep.wait_until_up({self._id}, self._bench.wait)
            for phase, result in zip(self._phases, self.verdict.phases, strict=True):
                self._run_phase(phase, result)
            self._listen_on(result)
        except (_Differs, LockstepError, can.CanError) as error:
            result.outcome = FAILED
            what = self._malformed() or error
            self.verdict.difference = f'phase "{phase.name}", tick {self._tick_number}: {what}'
        except KeyboardInterrupt:
            self.verdict.is_interrupted = True
        self.verdict.repeated = self._lockstep.repeated
        return self.verdict

    def _run_phase(self, phase: Phase, result: PhaseResult) -> None:
        before = self._injected()
        while result.ticks < self._bench.ticks:
            if self._bench.should_stop():
                raise KeyboardInterrupt
            self._tick(phase, result)
            result.ticks += 1
            self._bench.progress(self._neighbours.tick)
        result.injected += self._injected() - before
        has_nothing = phase.fault is not None and not result.injected
        result.outcome = EMPTY if has_nothing else PASSED

    def _injected(self) -> int:
        return sum(figure["injected"] for figure in self._neighbours.faults.figures())

    def _tick(self, phase: Phase, result: PhaseResult) -> None:
        self._tick_number = self._neighbours.tick
        seen = self._neighbours.begin()
        self._lockstep.observe({self._id: None if phase.is_blind else seen})
        if any(isinstance(decode(frame, self._subjects.estimates), Message) for frame in self._expected):
            self._lockstep.estimates({self._id})
        # Invalid frames first: from a sender that was heard already a robot ignores valid ones, too.
        invalid = self._invalid(phase)
        frames = invalid + self._neighbours.finish(self._said)
        result.injected += len(invalid) + phase.is_blind
        result.frames += len(frames)
        send_all(self._bench.bus, frames, SEND_TIMEOUT)
        for frame in frames:
            self._note(frame)
        if phase.loses_settles and result.ticks % 2 == 0:
            self._lockstep.leave_open()
            result.injected += 1
        else:
            self._lockstep.settle({self._id})
        self._compare(result)

    def _invalid(self, phase: Phase) -> list[can.Message]:
        """The invalid frames of this tick."""
        other = self._draw.choice(list(self._neighbours.nodes))
        if phase.invalid == "malformed":
            return malformed(self._draw, self._subjects, other)
        if phase.invalid == "commands":
            tick = self._lockstep.tick
            return stray_commands(self._draw, self._subjects.commands, self._id, other, tick)
        return []

    def _note(self, frame: can.Message) -> None:
        """Take a frame on the bus, in either direction; the model hears those sent to the controller."""
        if not frame.is_rx:
            frame.timestamp = time.time()
            self._expected += self.model.hear(frame)
        self._bench.log(frame)
        if frame.is_rx and frame.is_extended_id and frame.arbitration_id & MAX_NODE_ID == self._id:
            self._said.append(frame)

    def _listen_on(self, result: PhaseResult) -> None:
        """Check that nothing comes after the last answer."""
        end = time.monotonic() + _AFTERMATH
        while (frame := self._bench.bus.recv(max(0.0, end - time.monotonic()))) is not None:
            if frame.is_rx:
                self._note(frame)
            if time.monotonic() > end:
                break
        self._compare(result)

    def _compare(self, result: PhaseResult) -> None:
        """Compare the frames of controller and model since the last comparison."""
        said, wanted = list(self._meaning(self._said)), list(self._meaning(self._expected))
        self.verdict.other_frames += len(self._said) - len(said)
        self._said.clear()
        self._expected.clear()
        for kind, name in ((Message, "estimate"), (Telemetry, "telemetry")):
            own = [each for each in said if isinstance(each.content, kind)]
            models = [each for each in wanted if isinstance(each.content, kind)]
            if own != models:
                raise _Differs(f"{name}: the controller sent {_texts(own)}, the model {_texts(models)}")
        result.broadcasts += sum(isinstance(each.content, Message) for each in said)
        result.answers += sum(isinstance(each.content, Telemetry) for each in said)

    def _malformed(self) -> _Differs | None:
        """The error in a malformed frame of the controller since the last comparison, if there is one."""
        try:
            list(self._meaning(self._said))
        except _Differs as difference:
            return difference
        return None

    def _meaning(self, frames: Sequence[can.Message]) -> Iterator[_Said]:
        """The estimates and telemetry among ``frames``; other kinds are skipped, malformed frames fail."""
        for frame in frames:
            estimate = decode(frame, self._subjects.estimates)
            telemetry = decode_telemetry(frame, self._subjects.telemetry)
            if isinstance(estimate, Message):
                yield _Said(estimate, alpha_bits(frame))
            elif isinstance(telemetry, Telemetry):
                yield _Said(telemetry)
            elif estimate is not Rejection.SUBJECT or telemetry is not Rejection.SUBJECT:
                reason = estimate if estimate is not Rejection.SUBJECT else telemetry
                raise _Differs(f"the controller sent a malformed frame ({reason.text}): {frame}")


_AFTERMATH = 0.1
"""Seconds to listen after the last answer."""


class _Said(NamedTuple):
    """Content of a frame with the exact bits of alpha, which decoding may round."""

    content: Message | Telemetry
    alpha_bits: int = 0


def _texts(messages: Sequence[_Said]) -> str:
    return " and ".join(map(_text, messages)) or "nothing"


def _text(said: _Said) -> str:
    content, bits = said
    if isinstance(content, Message):
        return (
            f"x_hat {content.x_hat:#08x} ({content.x_hat / 2**23:.7f}), alpha {bits:#010x} "
            f"({float_of(bits):.7g}), transfer_id {content.transfer_id}"
        )
    return (
        f"x {content.x:#08x} ({content.x / 2**23:.7f}), b_hat {content.b_hat:#08x} "
        f"({content.b_hat / 2**24:.7f}), updates {content.updates}, transfer_id {content.transfer_id}"
    )
