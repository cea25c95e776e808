"""Robots in images: living through what runs.py holds while every call's cost is noted."""

from __future__ import annotations

import random
from collections import defaultdict

from . import runs
from .machines import Argument, Cost, Machine, Way

Spans = dict[str, list[float]]
"""Least, mean and most by unit: "instructions" and "cycles"."""

UNITS = ("instructions", "cycles")
SHORT = "step, filter due, m < 2"
TESTED, UPDATED = "step with test", "step with test and update"
NEVER = 2**31
"""A filtering period that no run reaches."""


def is_quiet_step(name: str) -> bool:
    """True if a call is a step in which the filter is not due."""
    return name.startswith("step, m = ")


class Robot:
    """The robot of an image, of the firmware or the baseline.

    Attributes:
        deepest: Most stack that each function was seen to use, bytes.
        ways: Those that steps of every kind, and the other calls, were seen to take.
        by_age: Costs of a step by the robot's age, after ``suffer``.
        by_messages: Costs of a round's last message and of its end by the messages, after ``fill_rounds``.
    """

    def __init__(self, machine: Machine, prefix: str) -> None:
        self._machine, self._prefix = machine, prefix
        self._own: Argument = ("pointer", machine.image.address("robot"))
        self._size = machine.do("bench_size")
        self._new: dict[int, bytes] = {}
        self._lived: dict[str, list[Cost]] = defaultdict(list)
        self._extreme: dict[str, list[Cost]] = defaultdict(list)
        self._costs: dict[str, list[Cost]] = self._lived
        self.deepest: dict[str, int] = defaultdict(int)
        self.ways: dict[str, set[Way]] = defaultdict(set)
        self.by_age: dict[int, list[Cost]] = defaultdict(list)
        self.by_messages: dict[int, list[tuple[Cost, Cost]]] = defaultdict(list)

    def spans(self) -> dict[str, Spans]:
        """Of every call: the mean in lives, least and most in lives and situations."""
        return {name: {unit: self._span(name, unit) for unit in UNITS} for name in self._lived}

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

    def start(
        self, b_hat: int, period: int = NEVER, t: int = 0, n: int = 0, memory: int = runs.MEMORIES[1]
    ) -> None:
        """Make it new, then give it a past; it filters every ``period`` rounds."""
        own = self._own[1]
        if b_hat in self._new:
            self._machine.write(own, self._new[b_hat])
        else:
            self._machine.do("bench_start", ("word", b_hat))
            self._new[b_hat] = self._machine.read(own, self._size)
        past = (("word", value) for value in (period, memory, t, n))
        self._machine.do("bench_set", *past)

    def receive(self, message: runs.Message) -> Cost:
        """Take a message, whose confidence the baseline takes as the frame has it."""
        sender, x_hat, alpha = message
        if self._prefix != "mcp_asdf":
            alpha = runs.binary32(alpha)
        return self.call("receive", ("byte", sender), ("word", x_hat), ("word", alpha))

    def step(self, observation: int) -> Cost:
        """Take a whole tick."""
        return self.call("step", ("enum", observation))

    def _updates(self) -> int:
        return self._machine.do("bench_updates")

    def _note(self, name: str, cost: Cost) -> None:
        self._costs[name].append(cost)
        self.ways["step" if is_quiet_step(name) else name].add(cost.way)

    def _note_step(self, observation: int, messages: int, due: bool, audible: int) -> Cost:
        tests = due and audible >= 2
        before = self._updates() if tests else 0
        cost = self.step(observation)
        if tests:
            self._note(UPDATED if self._updates() != before else TESTED, cost)
        else:
            self._note(SHORT if due else f"step, m = {messages}", cost)
        return cost

    def _note_halves(self, observation: int, due: bool) -> None:
        self._note("observe", self.call("observe", ("enum", observation)))
        self._note("settle, filter due" if due else "settle", self.call("settle"))
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
                turn = number // life.period if tick.due else number
                if turn % 2 == 0:
                    self._note_step(tick.observation, life.neighbours, tick.due, len(tick.messages))
                else:
                    self._note_halves(tick.observation, tick.due)

    def suffer(self, samples: int, rng: random.Random) -> None:
        """Live through ``samples`` situations of every age."""
        self._costs = self._extreme
        for age in runs.AGES:
            for number in range(samples):
                messages = runs.NEIGHBOURS[3 if number % 40 == 0 else number % 3]
                quiet, testing = (runs.situation(rng, count, age) for count in (messages, rng.choice([2, 5])))
                self.by_age[age].append(self.step_in(quiet, NEVER))
                self.tick_in(quiet, NEVER)
                self.tick_in(testing, 1)

    def fill_rounds(self, samples: int, rng: random.Random) -> None:
        """Hear rounds of every size, and end them."""
        self._costs = self._extreme
        for messages in samples * runs.ROUNDS:
            last = self._begin(runs.situation(rng, messages, rng.choice(runs.AGES)))
            self.call("observe", ("enum", 1))
            self.by_messages[messages].append((last, self.call("settle")))

    def lead_usual_life(self) -> None:
        """Close a round and hear another."""
        self.start(0xF3333333, 1000, 1000, 600)
        for _ in range(2):
            for message in runs.usual_round(10):
                self.receive(message)
            self.step(1)
        for message in runs.usual_round(10):
            self.receive(message)

    def step_in(self, situation: runs.Situation, period: int) -> Cost:
        """Take the situation's tick."""
        self._begin(situation, period)
        return self._note_step(situation.observation, len(situation.messages), period == 1, situation.audible)

    def tick_in(self, situation: runs.Situation, period: int) -> None:
        """Take the situation's tick in halves, and form x."""
        self._begin(situation, period)
        self._note_halves(situation.observation, period == 1)

    def x_in(self, situation: runs.Situation) -> Cost:
        """Form x after the situation's tick."""
        self._begin(situation)
        self.step(situation.observation)
        cost = self.call("x")
        self._note("x", cost)
        return cost

    def _begin(self, situation: runs.Situation, period: int = NEVER) -> Cost:
        """Put the robot into a situation; returns the cost of its last message."""
        last = Cost(0, 0, 0, 0)
        self.start(situation.b_hat, period, situation.t, situation.n, situation.memory)
        for message in situation.messages:
            last = self.receive(message)
            self._note("receive", last)
        return last
