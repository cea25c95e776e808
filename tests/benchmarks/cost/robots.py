"""Robots in images: living through what runs.py holds while every call's cost is noted."""

from __future__ import annotations

import random
from collections import defaultdict

from . import runs
from .machines import Argument, Cost, Machine

Spans = dict[str, list[float]]
"""Least, mean and most by unit: "instructions" and "cycles"."""

_UNITS = ("instructions", "cycles")
TESTED, UPDATED = "step with test", "step with test and update"
_NEVER = 2**31
"""A filtering period that no run reaches."""
_CHANGES = 80
"""Tried in a search."""


def is_quiet_step(name: str) -> bool:
    """Whether a call is a step without test."""
    return name.startswith("step, m = ")


class Robot:
    """The robot of an image, of the firmware or the baseline.

    Attributes:
        deepest: Most stack that each function was seen to use, bytes.
        by_age: Costs of a step by the robot's age, after ``suffer``.
        by_messages: Costs of a round's last message and of its end by the messages, after ``fill_rounds``.
    """

    def __init__(self, machine: Machine, prefix: str) -> None:
        self._machine, self._prefix = machine, prefix
        self._own: Argument = ("pointer", machine.image.address("robot"))
        self._lived: dict[str, list[Cost]] = defaultdict(list)
        self._extreme: dict[str, list[Cost]] = defaultdict(list)
        self._costs: dict[str, list[Cost]] = self._lived
        self.deepest: dict[str, int] = defaultdict(int)
        self.by_age: dict[int, list[Cost]] = defaultdict(list)
        self.by_messages: dict[int, list[tuple[Cost, Cost]]] = defaultdict(list)

    def spans(self) -> dict[str, Spans]:
        """Of every call: the mean in lives, least and most in lives and situations."""
        return {name: {unit: self._span(name, unit) for unit in _UNITS} for name in self._lived}

    def _span(self, name: str, unit: str) -> list[float]:
        lived = [getattr(cost, unit) for cost in self._lived[name]]
        every = lived + [getattr(cost, unit) for cost in self._extreme[name]]
        return [min(every), round(sum(lived) / len(lived), 1), max(every)]

    # ---- Calls ----

    def call(self, name: str, *arguments: Argument) -> Cost:
        """Call one of the robot's functions."""
        cost = self._machine.call(f"{self._prefix}_{name}", self._own, *arguments)
        self.deepest[name] = max(self.deepest[name], cost.stack)
        return cost

    def start(self, b_hat: int, period: int = _NEVER, t: int = 0, n: int = 0) -> None:
        """Make it new, then give it a past; it filters every ``period`` ticks."""
        self._machine.call("bench_start", ("word", b_hat), ("word", period))
        self._machine.call("bench_set", ("word", t), ("word", n))

    def receive(self, message: runs.Message) -> Cost:
        """Take a message."""
        sender, x_hat, alpha = message
        return self.call("receive", ("byte", sender), ("word", x_hat), ("word", alpha))

    def step(self, observation: int) -> Cost:
        """Take a whole tick."""
        return self.call("step", ("enum", observation))

    def _updates(self) -> int:
        return self._machine.call("bench_updates").value

    def _note(self, name: str, cost: Cost) -> None:
        self._costs[name].append(cost)

    def _note_step(self, observation: int, messages: int, tests: bool) -> Cost:
        before = self._updates()
        cost = self.step(observation)
        untested = f"step, m = {messages}"
        self._note(UPDATED if self._updates() != before else TESTED if tests else untested, cost)
        return cost

    def _note_halves(self, observation: int, tests: bool) -> None:
        self._note("observe", self.call("observe", ("enum", observation)))
        self._note("settle with test" if tests else "settle", self.call("settle"))
        if self._prefix == "mcp_asdf":  # the baseline has x after settle
            self._note("x", self.call("x"))

    # ---- Lives and situations ----

    def live(self) -> None:
        """Live through every life; ticks are whole and in halves by turns."""
        self._costs = self._lived
        for life in runs.lives():
            self.start(life.b_hat, life.period)
            for number, tick in enumerate(life.ticks):
                for message in tick.messages:
                    self._note("receive", self.receive(message))
                turn = number // life.period if tick.tests else number
                if turn % 2 == 0:
                    self._note_step(tick.observation, life.neighbours, tick.tests)
                else:
                    self._note_halves(tick.observation, tick.tests)

    def suffer(self, samples: int, rng: random.Random) -> None:
        """Live through ``samples`` situations of every age."""
        self._costs = self._extreme
        for age in runs.AGES:
            for number in range(samples):
                messages = runs.NEIGHBOURS[3 if number % 40 == 0 else number % 3]
                quiet, testing = (runs.situation(rng, age, count) for count in (messages, rng.choice([2, 5])))
                self._begin(quiet)
                self._note_halves(quiet.observation, tests=False)
                self.by_age[age].append(self._step_in(quiet, _NEVER))
                self._step_in(testing, 1)
                self._begin(testing, 1)
                self._note_halves(testing.observation, tests=True)

    def seek(self, searches: int, rng: random.Random) -> None:
        """Look for the dearest steps: change situations, and keep the changes that do not make them cheaper.

        Half of the searches are at the last age, where halving comes on top of all else.
        """
        self._costs = self._extreme
        for number in range(2 * searches):
            period, messages = ((_NEVER, 0), (1, 3))[number % 2]
            age = rng.choice(runs.AGES) if number % 4 < 2 else runs.AGES[-1]
            worst = runs.situation(rng, age, messages)
            most = self._step_in(worst, period).instructions
            for _ in range(_CHANGES):
                changed = runs.mutated(rng, worst)
                cost = self._step_in(changed, period).instructions
                if cost >= most:
                    worst, most = changed, cost

    def fill_rounds(self, samples: int, rng: random.Random) -> None:
        """Hear rounds of every size, and end them."""
        self._costs = self._extreme
        for messages in samples * runs.ROUNDS:
            last = self._begin(runs.situation(rng, rng.choice(runs.AGES), messages))
            self.call("observe", ("enum", 1))
            self.by_messages[messages].append((last, self.call("settle")))

    def _step_in(self, situation: runs.Situation, period: int) -> Cost:
        self._begin(situation, period)
        return self._note_step(situation.observation, len(situation.messages), tests=period == 1)

    def _begin(self, situation: runs.Situation, period: int = _NEVER) -> Cost:
        """Put the robot into a situation; returns the cost of its last message."""
        last = Cost(0, 0, 0, 0)
        self.start(situation.b_hat, period, situation.t, situation.n)
        for message in situation.messages:
            last = self.receive(message)
            self._note("receive", last)
        return last
