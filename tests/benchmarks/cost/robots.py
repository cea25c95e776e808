"""Robots in images: the situations in which they are called, and what each call costs."""

from __future__ import annotations

import random
import struct
from dataclasses import dataclass

from mcp_asdf import Filter

from .machines import Argument, Cost, Machine

OWN_ID = 5
SHORT, TESTED, UPDATED = "step, filter due, m < 2", "step with test", "step with test and update"
NEVER, MEMORY = 2**31, 2**31
"""A filter period that no run reaches, and the longest memory that a robot may have."""
ROUNDS = (1, 2, 4, 8, 16, 32, 64, 96, 127)
"""The numbers of messages in the rounds whose end is measured by itself."""
_ONE = 2**23

Message = tuple[int, int, int]
"""A sender's id, its x_hat in units of 2**-23, and its alpha as the firmware's word."""


@dataclass(frozen=True)
class Situation:
    """The state of a robot, and what happens to it next.

    Attributes:
        b_hat: Its b_hat in units of 2**-32.
        memory: The number of observations at which t and n are halved.
        t: The number of its observations.
        n: The number of black ones among them.
        messages: The messages that it receives in the open round.
        observation: What it observes at the end of the round, 0 or 1.
    """

    b_hat: int
    memory: int
    t: int
    n: int
    messages: tuple[Message, ...]
    observation: int


EXPENSIVE_SITUATIONS = (
    Situation(2151478824, 400, 399, 199, (), 0),
    Situation(2190624173, 88, 87, 44, (), 0),
    Situation(4096, 221264, 221263, 3, (), 0),
    Situation(2148008077, 860, 859, 429, (), 1),
    Situation(2145240280, 158480, 158479, 79219, (), 0),
    Situation(2165418860, 1232, 1231, 620, (), 1),
    Situation(2145276522, 131072, 131071, 65524, ((0, 2429867, 0x80000001),), 0),
    Situation(2146997536, 4636, 4635, 4125, ((0, 4187684, 0x80000001),), 1),
    Situation(2118891038, 408, 407, 201, ((0, 4202300, 0x100), (1, 4183491, 0x100)), 1),
    Situation(2145728125, 266560, 266559, 133270, ((0, 2**23, 0x100), (1, 8374204, 0x100)), 1),
    Situation(2149672830, 88, 87, 43, ((0, 4200436, 0x100), (1, 4200365, 0x100), (2, 5114038, 0)), 1),
)
"""Situations that long searches for the largest cost have found.

In them t and n are halved, b_hat is beside 1/2 or at an end of its range, or n is beside t/2 or c t.
"""


def situation(rng: random.Random, messages: int, t: int) -> Situation:
    """Draw the situation of a robot that will have made ``t`` observations.

    b_hat may be close to 1/2 or a clamp, the share of black beside 0, 1/2, 1 or c, messages close together or
    not, and of any confidence.
    """
    b_hat = _clamp(2**12, 2**31 + rng.choice((-1, 1)) * int(2 ** rng.uniform(12, 31)), 2**32 - 2**12)
    share = rng.choice((0.0, 0.5, 1.0, b_hat / 2**32, 1 - b_hat / 2**32, rng.random()))
    n = _clamp(0, int((t - 1) * share) + rng.randint(-3, 3), t - 1)
    middle, width = rng.choice((0, _ONE // 2, _ONE, rng.randint(0, _ONE))), rng.choice((0, 3, 2**22))
    # All messages have the same confidence, or each one any.
    common_alpha = rng.choice((0, 0x100, 0x80000001, None))
    drawn_messages = []
    for sender in senders(messages):
        x_hat = _clamp(0, middle + rng.randint(-width, width), _ONE)
        alpha = rng.getrandbits(32) if common_alpha is None else common_alpha
        drawn_messages.append((sender, x_hat, alpha))
    return Situation(b_hat, MEMORY, t - 1, n, tuple(drawn_messages), rng.getrandbits(1))


def robust_state(rng: random.Random, situation: Situation) -> list[int]:
    """Draw what a robot with the robust filter keeps before the messages of a situation.

    It has the order of the last members of ``bench_state`` in firmware.c.

    Votes and estimates are beside the messages or anywhere. In half of the cases all slots have an estimate,
    in descending order, which takes longest to sort.
    """
    centres = [x_hat * 2**7 + rng.randint(-(2**20), 2**20) for _, x_hat, _ in situation.messages]
    centre = _clamp(0, rng.choice((*centres, rng.randint(0, 2**30), 0, 2**30)), 2**30)
    width = int(2 ** rng.uniform(0, 16))
    estimates = [_clamp(0, (centre >> 14) + rng.randint(-width, width), 2**16 - 1) for _ in range(32)]
    filled_slots = rng.choice((1, 0x1F, rng.getrandbits(32) | 1, 2**32 - 1))
    if rng.random() < 0.5:
        estimates.sort(reverse=True)
        filled_slots = 2**32 - 1
    batch_n = rng.randint(0, situation.n)
    spread = _clamp(2**18, int(2 ** rng.uniform(17.9, 28.1)), 2**28)
    votes = rng.choice((1, 2**9 - 1, 2**9, rng.randrange(1, 2**9)))
    turn = rng.choice((0, 1, 31, 32))
    batch_t = batch_n + rng.randint(0, situation.t - situation.n)
    dispersion = rng.choice((2**8, 2**16 - 1, rng.randint(2**8, 2**16 - 1)))
    estimates = [estimate if filled_slots >> slot & 1 else 0 for slot, estimate in enumerate(estimates)]
    return [centre, spread, votes, turn, batch_t, batch_n, dispersion, filled_slots, *estimates]


def _clamp(smallest: int, value: int, largest: int) -> int:
    """Return the value, or the nearer limit if it is outside."""
    return max(smallest, min(value, largest))


def senders(count: int) -> list[int]:
    """Return the ids of so many robots beside the own one; at most 127."""
    return [sender for sender in range(128) if sender != OWN_ID][:count]


@dataclass(frozen=True)
class ObservedCall:
    """A call of the firmware that was measured.

    Attributes:
        kind: The name of the function, or the kind of a step in which the filter was due.
        t: The number of observations before the call.
        m: The number of messages that the round had before the call.
        cost: The cost of the call.
    """

    kind: str
    t: int
    m: int
    cost: Cost


class Robot:
    """The robot of an image.

    Attributes:
        machine: The processor that the image runs on.
        filter: The filter of the robot's configuration.
        observed_calls: All calls of the robot so far.
    """

    def __init__(self, machine: Machine, filter: Filter) -> None:
        self.machine, self.filter = machine, filter
        self.observed_calls: list[ObservedCall] = []
        self._t = self._m = 0

    def call(self, name: str, *arguments: Argument) -> Cost:
        """Call one of the robot's functions."""
        pointer_to_robot = self.machine.image.address("robot"), 2
        cost = self.machine.call(f"mcp_asdf_{name}", pointer_to_robot, *arguments)
        self.observed_calls.append(ObservedCall(name, self._t, self._m, cost))
        return cost

    def start(self, situation: Situation, period: int) -> None:
        """Make the robot anew, let it filter every ``period`` rounds, and let it hear the messages."""
        state = [situation.b_hat, self.filter.value, period, situation.memory, situation.t, situation.n]
        if self.filter == Filter.ROBUST:
            state += robust_state(random.Random(repr(situation)), situation)
        words = struct.pack(f"<{len(state)}I", *state)
        self.machine.write(self.machine.image.address("bench_state"), words)
        self.machine.call("bench_start")
        self._t, self._m = situation.t, 0
        for sender, x_hat, alpha in situation.messages:
            self.call("receive", (sender, 1), (x_hat, 4), (alpha, 4))
            self._m += 1

    def tick(self, situation: Situation, period: int) -> None:
        """Take the situation's tick, whose kind depends on what the filter does, and form x."""
        self.start(situation, period)
        cost = self.call("step", (situation.observation, 2))
        if period == 1:  # the filter is due
            # The number of tests is in the upper half of the word, and that of updates in the lower one.
            tests, updates = divmod(self.machine.call("bench_filtered").value, 2**16)
            kind = SHORT
            if tests:
                kind = UPDATED if updates else TESTED
            self.observed_calls[-1] = ObservedCall(kind, self._t, self._m, cost)
        self._m = 0
        self.call("x")

    def run_situations(self, seed: int, samples: int) -> None:
        """Run random situations of every age, the expensive ones, and rounds of every size."""
        rng = random.Random(seed)
        for age in range(32):
            for _ in range(samples):
                self.tick(situation(rng, rng.choice((0, 1, 3)), 2**age), NEVER)
                self.tick(situation(rng, rng.choice((2, 5)), 2**age), 1)
        for expensive_situation in EXPENSIVE_SITUATIONS:
            for period in (NEVER, 1):
                self.tick(expensive_situation, period)
        for messages in 4 * ROUNDS:
            self.start(situation(rng, messages, 2 ** rng.randrange(32)), NEVER)
            self.call("settle")
