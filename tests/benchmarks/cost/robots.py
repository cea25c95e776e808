"""Robots in images: what they live through, and what each call costs in it."""

from __future__ import annotations

import random
import struct
from collections import defaultdict
from dataclasses import dataclass

from mcp_asdf import Config, Filter, NativeRobot, Observation
from mcp_asdf.fixed_point import alpha_units, alpha_word, word_to_alpha

from .machines import Argument, Cost, Machine

OWN_ID = 5
SHORT, TESTED, UPDATED = "step, filter due, m < 2", "step with test", "step with test and update"
NEVER, MEMORY = 2**31, 2**31
"""A filtering period that no run reaches; the longest memory."""
AGES = tuple(2**k for k in range(32))
"""Observations counted by the steps that are looked at one by one; at the last one t is halved."""
ROUNDS = (1, 2, 4, 8, 16, 32, 64, 96, 127)
"""Messages in the rounds that are looked at one by one."""
SAMPLES = 40
"""Random situations of every age."""
_BLACK = 0.545
"""p(z = 1) for a fill ratio of 0.55 and sensors right 95 times out of 100."""
_B_HATS = (2**12, 2**32 - 2**12)
_ONE = 2**23
_ALPHAS = tuple(map(alpha_word, (0, 1, 2, 2**24 - 1, 2**24, 2**32 - 2**8, 2**32, 2**54, 2**55)))

Message = tuple[int, int, int]
"""Sender, x_hat in units of 2**-23, alpha as the firmware's word."""


@dataclass(frozen=True)
class Situation:
    """A robot before an observation: b_hat (unit 2**-32), memory, t, n, open round, and what it sees next."""

    b_hat: int
    memory: int
    t: int
    n: int
    messages: tuple[Message, ...]
    observation: int


DEAR = (
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
"""Results of long searches: a memory halved, b_hat beside 1/2 or at a clamp, n beside t/2 or c t."""


def situation(rng: random.Random, messages: int, age: int) -> Situation:
    """Any one of a robot that will have made ``age`` observations, edges over-represented."""
    half, sign = 2**31, rng.choice((-1, 1))
    b_hat = rng.choice(
        (
            rng.choice((*_B_HATS, half, half + sign * 2**19)),
            sign * int(2 ** rng.uniform(12, 31)) % 2**32,
            _clamped(half + sign * int(2 ** rng.uniform(18, 31)), *_B_HATS),
            rng.randint(*_B_HATS),
        )
    )
    b, small = b_hat / 2**32, 2 ** rng.uniform(-32, 0)
    share = rng.choice((0.0, 0.5, 1.0, b, 1 - b, rng.random(), small, 1 - small))
    t = age - 1
    n = _clamped(int(t * share) + rng.randint(-3, 3), 0, t)
    return Situation(b_hat, MEMORY, t, n, _round(rng, messages), rng.getrandbits(1))


def _round(rng: random.Random, messages: int) -> tuple[Message, ...]:
    """Messages around any x_hat, 1/2 more often, close together or not; confidence of all kinds."""
    away = rng.choice((-1, 1)) * int(2 ** rng.uniform(0, 22))
    middle = rng.choice((_ONE // 2, _ONE // 2 + away, rng.randint(0, _ONE), 0, _ONE))
    width, common = rng.choice((0, 1, 3, 2 ** rng.randrange(1, 23))), rng.choice((None, *_ALPHAS))
    return tuple(
        (sender, _clamped(middle + rng.randint(-width, width), 0, _ONE), _alpha(rng, common))
        for sender in senders(messages)
    )


def _alpha(rng: random.Random, common: int | None) -> int:
    any_size = alpha_word(int(2 ** rng.uniform(0, 55)))
    return rng.choice((rng.getrandbits(32), any_size)) if common is None else common


def _clamped(value: int, least: int, most: int) -> int:
    return max(least, min(value, most))


def senders(count: int) -> list[int]:
    """That many robots beside the own one; at most 127."""
    return [sender for sender in range(128) if sender != OWN_ID][:count]


class Robot:
    """The robot of an image, of the firmware ("mcp_asdf") or of the baseline ("plain_robot").

    Attributes:
        costs: Costs so far, by function and kind of step.
        by_age: Costs of a step by the robot's age.
        by_messages: Costs of a round's last message and of its end by the messages.
        deepest: Most stack that each function was seen to use, bytes.
    """

    def __init__(self, machine: Machine, prefix: str = "mcp_asdf") -> None:
        self.machine, self._prefix = machine, prefix
        self.own: Argument = ("pointer", machine.image.address("robot"))
        self.costs: dict[str, list[Cost]] = defaultdict(list)
        self.by_age: dict[int, list[Cost]] = defaultdict(list)
        self.by_messages: dict[int, list[tuple[Cost, Cost]]] = defaultdict(list)
        self.deepest: dict[str, int] = defaultdict(int)

    def call(self, name: str, *arguments: Argument) -> Cost:
        """Call one of the robot's functions."""
        cost = self.machine.call(f"{self._prefix}_{name}", self.own, *arguments)
        self.deepest[name] = max(self.deepest[name], cost.stack)
        self.costs[name].append(cost)
        return cost

    def start(self, b_hat: int, period: int = NEVER, t: int = 0, n: int = 0, memory: int = MEMORY) -> None:
        """Make it new, then give it a past; it filters every ``period`` rounds."""
        self.machine.call("bench_start", ("word", b_hat))
        self.machine.call("bench_set", *(("word", value) for value in (period, memory, t, n)))

    def receive(self, message: Message) -> Cost:
        """Take a message, whose confidence the baseline takes as the frame has it."""
        sender, x_hat, alpha = message
        if self._prefix != "mcp_asdf":
            alpha = int.from_bytes(struct.pack("<f", word_to_alpha(alpha)), "little")
        return self.call("receive", ("byte", sender), ("word", x_hat), ("word", alpha))

    def step(self, observation: int, due: bool, audible: int) -> Cost:
        """Take a whole tick, whose kind depends on whether the filter is due and how many were heard."""
        before = self.machine.call("bench_updates").value
        cost = self.machine.call(f"{self._prefix}_step", self.own, ("enum", observation))
        updates = self.machine.call("bench_updates").value != before
        kind = "step" if not due else SHORT if audible < 2 else UPDATED if updates else TESTED
        self.deepest["step"] = max(self.deepest["step"], cost.stack)
        self.costs[kind].append(cost)
        return cost

    def live(self, ticks: int = 240, period: int = 20) -> dict[str, float]:
        """Live among ten neighbours that know better than to take their sensors for 0.55 right; returns the
        mean instructions of each function and kind of step."""
        rng, config = random.Random(10), Config(filter=Filter.OFF)
        swarm = {sender: NativeRobot(config, sender, 0.95) for sender in senders(10)}
        self.start(int(0.55 * 2**32), period)
        for number in range(1, ticks + 1):
            for sender, other in swarm.items():
                other.step(Observation(int(rng.random() < _BLACK)))
                self.receive((sender, other.x_hat_raw, other.alpha_raw))
            self.step(int(rng.random() < _BLACK), number % period == 0, len(swarm))
            self.call("x")
        return {
            name: sum(cost.instructions for cost in costs) / len(costs) for name, costs in self.costs.items()
        }

    def suffer(self, seed: int) -> None:
        """Live through the dear situations, random ones of every age, and rounds of every size."""
        rng = random.Random(seed)
        for age in AGES:
            for _ in range(SAMPLES):
                self.by_age[age].append(self.tick(situation(rng, rng.choice((0, 1, 3)), age), NEVER))
                self.tick(situation(rng, rng.choice((2, 5)), age), 1)
        for each in DEAR:
            for period in (NEVER, 1):
                self.tick(each, period)
        for messages in 4 * ROUNDS:
            self._begin(situation(rng, messages, rng.choice(AGES)), NEVER)
            self.by_messages[messages].append((self.costs["receive"][-1], self.call("settle")))

    def tick(self, situation: Situation, period: int) -> Cost:
        """Take the situation's tick, and form x; returns the cost of the step."""
        self._begin(situation, period)
        audible = sum(alpha_units(alpha) > 0 for _, _, alpha in situation.messages)
        cost = self.step(situation.observation, period == 1, audible)
        self.call("x")
        self._begin(situation, period)
        self.call("observe", ("enum", situation.observation))
        return cost

    def _begin(self, situation: Situation, period: int) -> None:
        self.start(situation.b_hat, period, situation.t, situation.n, situation.memory)
        for message in situation.messages:
            self.receive(message)
