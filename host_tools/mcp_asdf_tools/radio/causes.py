"""Kinds of mistake that give a symptom, in words.

One table: a row holds for symptoms of its kind and field, in its phases. The first that holds is the cause.
Since each phase adds one thing to those before it, a symptom in it points at the thing added.
"""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass
from fnmatch import fnmatch

from mcp_asdf_tools.radio.comparison import BUS, ESTIMATE, HEARTBEAT, TELEMETRY, Symptom

_ANY = "*"


@dataclass(frozen=True)
class Cause:
    """Kind of mistake.

    Attributes:
        text: Its description; ``{doing}`` stands for what was done.
        kind: Kind of frame that shows it, or ``*``.
        fields: Fields that show it, as patterns.
        phases: Phases in which it shows, as patterns.
        doing: What was done then, as a pattern.
    """

    text: str
    kind: str = _ANY
    fields: Collection[str] = (_ANY,)
    phases: Collection[str] = (_ANY,)
    doing: str = _ANY

    def explains(self, symptom: Symptom, phase: str, doing: str) -> bool:
        """True if this mistake gives the symptom when this is done in this phase."""
        return (
            self.kind in (_ANY, symptom.kind)
            and any(fnmatch(symptom.field, field) for field in self.fields)
            and any(fnmatch(phase, each) for each in self.phases)
            and fnmatch(doing, self.doing)
        )


def cause_of(symptom: Symptom, phase: str, doing: str) -> str:
    """The mistake that gives a symptom when something is done in a phase."""
    cause = next(each for each in CAUSES if each.explains(symptom, phase, doing))
    return cause.text.format(doing=doing)


_IN_A_ROW = (
    "heartbeats",
    "no information",
    "threshold*",
    "own estimate",
    "re-estimates",
    "halvings",
    "long run",
)
_FAULTS = "frames are lost by its receive buffer, or their order or number matters to it, which it must not"

CAUSES: tuple[Cause, ...] = (
    # --- The bus ---
    Cause("the connection to the bus failed, which says nothing about the controller", BUS, ("failed",)),
    Cause(
        "the controller is not there, is not reset while we wait, or sends no heartbeat when it starts",
        BUS,
        ("absent",),
    ),
    # --- Any frame ---
    Cause(
        "its frames are not classic CAN data frames with 29-bit identifiers: FD or remote", _ANY, ("frame",)
    ),
    Cause("its frames have another DLC than 8", _ANY, ("length",)),
    Cause("its tail byte lacks start, end or toggle bit: not a single-frame transfer", _ANY, ("tail",)),
    Cause("its frames have another priority than agreed", _ANY, ("priority",)),
    Cause("it sets reserved bits of the identifier wrongly (docs/frame.md)", _ANY, ("identifier",)),
    Cause("it sends each frame twice, or a second node has its id", _ANY, ("twice",)),
    # --- Heartbeats ---
    Cause(
        "it sends no heartbeats, or too few: one is due in every second of ticks",
        HEARTBEAT,
        ("never", "missing"),
    ),
    Cause("it sends heartbeats by another clock than its ticks, or too often", HEARTBEAT, ("extra",)),
    Cause("its uptime does not count the seconds of its ticks", HEARTBEAT, ("uptime",)),
    Cause(
        "it reports a health other than nominal: a fault of its own, or a wrong field", HEARTBEAT, ("health",)
    ),
    Cause("it reports another mode than operational", HEARTBEAT, ("mode",)),
    # --- The filter, wherever it shows ---
    Cause(
        "it rejects where k_m does not: a threshold too small (t-table of a smaller omega, of other "
        "degrees of freedom than m - 1 or of another q, variance over m instead of m - 1), or it updates "
        "without a test",
        TELEMETRY,
        ("more updates",),
        ("threshold*",),
        "*inside*",
    ),
    Cause(
        "it does not reject where k_m does: a threshold too large (t-table of a larger omega, of other "
        "degrees of freedom or of another q), messages lost from the round, a test of another estimate "
        "than its own x_hat, or no filter at all",
        TELEMETRY,
        ("fewer updates",),
        ("threshold*",),
    ),
    Cause(
        "its test rejects at equality: it compares with >= instead of >",
        TELEMETRY,
        ("more updates",),
        ("own estimate",),
    ),
    Cause(
        "it filters at other times than every filter period, counts messages without confidence into m, "
        "tests fewer than two messages, or updates without a test",
        TELEMETRY,
        ("more updates",),
        ("rounds without a test",),
    ),
    Cause(
        "it updates b_hat where x_bar is 1/2 and says nothing about it",
        TELEMETRY,
        ("more updates",),
        ("re-estimates",),
        "*kept*",
    ),
    Cause(
        "it filters when it must not: at other times than every filter period, without the test, or "
        "though it is set up not to",
        TELEMETRY,
        ("more updates",),
    ),
    Cause(
        "it never filters, or at other times than every filter period, or its test is of another estimate"
        " than its own x_hat",
        TELEMETRY,
        ("fewer updates",),
    ),
    # --- Commands ---
    Cause(
        "after a tick without settle it waits for that settle, instead of beginning the next tick",
        ESTIMATE,
        ("missing",),
        ("lost commands",),
    ),
    Cause(
        "it answers ticks whose settle never came", TELEMETRY, ("extra", "transfer_id"), ("lost commands",)
    ),
    Cause(
        "it does not end the open tick and its round when the next observe comes", phases=("lost commands",)
    ),
    Cause("it obeys {doing}, or hangs at it", phases=("stray commands",)),
    Cause(
        "it does not obey {doing}: it looks at what is to be ignored, or at a part of the number",
        phases=("unusual commands",),
    ),
    Cause(
        "it does not broadcast: it is not there or not in lockstep, has another id, other subjects or a "
        "longer broadcast period, or sends no 29-bit identifiers",
        ESTIMATE,
        ("never",),
    ),
    Cause(
        "it does not answer settle: not in lockstep, or with another subject of telemetry",
        TELEMETRY,
        ("never",),
    ),
    Cause(
        "it hangs, restarts or loses commands that come in a row: its receive buffer is too small",
        _ANY,
        ("missing",),
        _IN_A_ROW,
    ),
    Cause("it hangs or restarts, or its broadcast period is another", _ANY, ("missing",)),
    Cause("it broadcasts more often than its broadcast period", ESTIMATE, ("extra",)),
    Cause(
        "it sends telemetry that was not asked for, answers twice, or a second node has its id",
        TELEMETRY,
        ("extra",),
    ),
    Cause(
        "it has run before (reset it), restarts, or does not count the messages of each kind by "
        "themselves, from 0, modulo 32",
        _ANY,
        ("transfer_id",),
    ),
    # --- Alone ---
    Cause(
        "it takes a tick without an observation for a white or a black tile, or has run before",
        ESTIMATE,
        ("x_hat",),
        phases=("alone",),
        doing="no observation",
    ),
    Cause(
        "its x_hat (eq. 3) is wrong: another b_hat at the start, colours exchanged, observations before "
        "this run, or an estimator that is not exact",
        ESTIMATE,
        ("x_hat",),
        ("alone",),
    ),
    Cause(
        "its alpha (eq. 4) is wrong, or not rounded to the firmware's word; or it forgets sooner than its"
        " memory",
        ESTIMATE,
        ("alpha",),
        ("alone",),
    ),
    Cause(
        "its b_hat is another at the start, or telemetry cuts it wrongly", TELEMETRY, ("b_hat",), ("alone",)
    ),
    Cause(
        "telemetry does not carry its x, b_hat or updates as docs/frame.md has them",
        TELEMETRY,
        phases=("alone",),
    ),
    # --- The memory: only observations change it ---
    Cause(
        "its memory is shorter than said, or it rounds otherwise when it halves: t and n are halved at "
        "the memory, n to nearest, ties to even",
        ESTIMATE,
        ("x_hat", "alpha"),
        ("halvings", "long run"),
    ),
    Cause(
        "after many observations its estimate is wrong: it forgets after fewer than its memory, loses "
        "some that come in a row, or x_hat (eq. 3) or alpha (eq. 4) is not exact",
        ESTIMATE,
        ("x_hat", "alpha"),
        doing="many observations*",
    ),
    Cause(
        "its re-estimate of b_hat (eq. 8) is wrong: its formula or precision, other n and t (a shorter "
        "memory), or the limits 2^-20 and 1 - 2^-20",
        TELEMETRY,
        ("b_hat",),
    ),
    Cause(
        "its own estimate after a re-estimate is wrong: b_hat = 1/2 must give x_hat = 1/2 and alpha = 0, "
        "and a new b_hat shows at the next observation",
        ESTIMATE,
        ("x_hat", "alpha"),
        ("no information", "threshold*", "own estimate", "re-estimates", "rounds without a test"),
    ),
    Cause(
        "a re-estimate changes its own estimate at once: it must do so at the next observation",
        TELEMETRY,
        ("x",),
        ("no information", "re-estimates", "threshold*"),
    ),
    # --- Messages ---
    Cause(
        "it does not hear {doing}: ids above some bound are lost, or taken for others",
        phases=("every sender",),
    ),
    Cause(
        "it takes two senders for one: its bitmap of senders heard is too narrow ({doing})",
        phases=("alike ids",),
    ),
    Cause(
        "it does not take all messages of {doing}: a bound on messages, a receive buffer too small, or "
        "sums (eq. 5 to 7) that are not exact",
        phases=("growing rounds",),
    ),
    Cause(
        "it keeps messages or x_bar of the last round when a round brings none: beta must be 0 then",
        kind=TELEMETRY,
        phases=("messages and silence",),
        doing="no messages",
    ),
    Cause(
        "its informed estimate x (eq. 5 to 7) is wrong: messages not weighted by alpha, sums that are not"
        " exact, or rounds that it closes at other times than after its broadcasts",
        TELEMETRY,
        ("x",),
        ("messages and silence",),
    ),
    Cause(
        "it loses messages that come between settle and observe, or counts them into another round",
        phases=("between ticks",),
    ),
    Cause(
        "it does not take {doing} as it should: a sum that overflows, or another range of alpha",
        phases=("extreme messages",),
    ),
    Cause(
        "it counts several messages of one sender in a round, or the last one instead of the first",
        phases=("same sender",),
    ),
    Cause("it hears messages under its own id, or restarts at them", phases=("its own id",)),
    Cause(
        "it does not hear {doing}: it compares bits of the identifier that a receiver ignores",
        phases=("unusual identifiers",),
    ),
    Cause("it accepts {doing} as an estimate", phases=("invalid frames",)),
    Cause(
        "a fault shows what the rounds made for the purpose did not: " + _FAULTS,
        TELEMETRY,
        ("x", "b_hat"),
    ),
    Cause("its own estimate is disturbed: only its observations and re-estimates may change it", ESTIMATE),
)
