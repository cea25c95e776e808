"""What the measured robots live through: ordinary lives, and situations that are to be expensive."""

from __future__ import annotations

import random
import struct
from dataclasses import dataclass, replace
from functools import cache

from firmware_py import Config, Filter, NativeRobot, Observation

OWN_ID = 5
NEIGHBOURS = (0, 1, 10, 127)
"""Of the robots whose lives are measured."""
AGES = (*(2**k for k in range(32)), 2**32 - 2)
"""Observations counted by the steps of all situations; at the last one t is halved."""
ROUNDS = (1, 2, 4, 8, 16, 32, 64, 96, 127)
"""Messages in the rounds that are looked at one by one."""

_LENGTHS = {0: (150, 50), 1: (150, 50), 10: (240, 20), 127: (30, 10)}
"""Ticks, and the filtering period: shorter than the usual 1000, for enough tests."""
_BLACK = 0.545
"""p(z = 1) for a fill ratio of 0.55 and sensors right 95 times out of 100."""
_FLAWED, _SOUND = 0.55, 0.95

Message = tuple[int, int, int]
"""Sender, x_hat in units of 2**-23, alpha as binary32 bits."""


@dataclass(frozen=True)
class Situation:
    """A robot before an observation: b_hat (unit 2**-32), t, n, the open round, and what it sees next."""

    b_hat: int
    t: int
    n: int
    messages: tuple[Message, ...]
    observation: int


@dataclass(frozen=True)
class Tick:
    """What a robot sees and hears in a tick, and whether it then tests (eq. 12)."""

    observation: int
    messages: tuple[Message, ...]
    tests: bool


@dataclass(frozen=True)
class Life:
    """A robot from its start: b_hat in units of 2**-32, filtering period, number of neighbours, ticks."""

    b_hat: int
    period: int
    neighbours: int
    ticks: tuple[Tick, ...]


@cache
def lives() -> tuple[Life, ...]:
    """One life for each of NEIGHBOURS, the same at every call."""
    return tuple(_life(neighbours) for neighbours in NEIGHBOURS)


def _life(neighbours: int) -> Life:
    """That of a robot that takes its sensor for worse than it is, among neighbours that know better."""
    length, period = _LENGTHS[neighbours]
    rng = random.Random(neighbours)
    settings = Config(filter=Filter.OFF)
    swarm = {sender: NativeRobot(settings, sender, _SOUND) for sender in senders(neighbours)}
    ticks = []
    for number in range(1, length + 1):
        for robot in swarm.values():
            robot.step(Observation(_see(rng)))
        messages = tuple((sender, robot.x_hat_raw, robot.alpha_raw) for sender, robot in swarm.items())
        ticks.append(Tick(_see(rng), messages, number % period == 0 and neighbours >= 2))
    return Life(int(_FLAWED * 2**32), period, neighbours, tuple(ticks))


def _see(rng: random.Random) -> int:
    return int(rng.random() < _BLACK)


def senders(count: int) -> list[int]:
    """That many robots beside the own one; at most 127."""
    return [sender for sender in range(128) if sender != OWN_ID][:count]


def situation(rng: random.Random, age: int, messages: int) -> Situation:
    """Any one of that age with that many messages, edges over-represented."""
    b = rng.choice(
        [0.55, 0.75, 0.95, 0.999999, 0.02, rng.uniform(0.5001, 0.9999), rng.uniform(0.0001, 0.4999)]
    )
    share = rng.choice([0.0, 0.5, 1.0, 1 - b, b, rng.random(), rng.uniform(min(b, 1 - b), max(b, 1 - b))])
    n = min(int((age - 1) * share), age - 1)
    heard = tuple(_message(rng, sender) for sender in senders(messages))
    return Situation(int(b * 2**32), age - 1, n, heard, rng.getrandbits(1))


def mutated(rng: random.Random, old: Situation) -> Situation:
    """The situation with another accuracy, share of black, observation or message, at the same age."""
    new = situation(rng, old.t + 1, len(old.messages))
    kind = rng.randrange(3 + len(old.messages))
    if kind == 0:
        return replace(old, b_hat=new.b_hat)
    if kind == 1:
        return replace(old, n=new.n)
    if kind == 2:
        return replace(old, observation=1 - old.observation)
    heard = list(old.messages)
    heard[kind - 3] = new.messages[kind - 3]
    return replace(old, messages=tuple(heard))


def _message(rng: random.Random, sender: int) -> Message:
    """Any valid message, its alpha off the firmware's grid, too."""
    alpha = rng.choice([1.0, 1e4, 1e9, 3e9, 0.3, 1e-9, 2 ** rng.uniform(-30, 40)])
    return sender, rng.getrandbits(23), int(struct.unpack("<I", struct.pack("<f", alpha))[0])
