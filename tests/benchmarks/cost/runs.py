"""Runs of the measured robots: ordinary ones, and situations chosen to be expensive."""

from __future__ import annotations

import random
import struct
from dataclasses import dataclass, replace
from functools import cache

from mcp_asdf import Config, Filter, NativeRobot, Observation
from mcp_asdf.fixed_point import alpha_units, alpha_word, word_to_alpha

OWN_ID = 5
NEIGHBOURS = (0, 1, 10, 127)
"""Of the robots whose lives are measured."""
MEMORIES = (64, 2**31)
"""Of a robot: the least and the most, which is usual."""
AGES = tuple(2**k for k in range(32))
"""Observations counted by the steps that are looked at one by one; at the last one t is halved."""
ROUNDS = (1, 2, 4, 8, 16, 32, 64, 96, 127)
"""Messages in the rounds that are looked at one by one."""

_LENGTHS = {0: (150, 50), 1: (150, 50), 10: (240, 20), 127: (30, 10)}
"""Ticks, and the filtering period: shorter than the usual 1000, for enough tests."""
_BLACK = 0.545
"""p(z = 1) for a fill ratio of 0.55 and sensors right 95 times out of 100."""
_FLAWED, _SOUND = 0.55, 0.95

_B_HATS = (2**12, 2**32 - 2**12)
"""Least and most, units of 2**-32."""
_HALF, _INFORMATIVE = 2**31, 2**19
"""Accuracy 1/2, and how far from it a robot begins to learn; units of 2**-32."""
_ONE = 2**23
"""Of x_hat, units of 2**-23."""
_ALPHAS = tuple(map(alpha_word, (0, 1, 2, 2**24 - 1, 2**24, 2**32 - 2**8, 2**32, 2**54, 2**55)))
"""Where one way through the code gives way to another, and the numbers beside."""

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

    @property
    def audible(self) -> int:
        """Messages that say something: of alpha from one unit on."""
        return sum(alpha_units(alpha) > 0 for _, _, alpha in self.messages)


@dataclass(frozen=True)
class Tick:
    """Input of a robot in a tick: observation and messages, and whether its filter is due then."""

    observation: int
    messages: tuple[Message, ...]
    due: bool


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
        ticks.append(Tick(_see(rng), messages, number % period == 0))
    return Life(int(_FLAWED * 2**32), period, neighbours, tuple(ticks))


def _see(rng: random.Random) -> int:
    return int(rng.random() < _BLACK)


def senders(count: int) -> list[int]:
    """That many robots beside the own one; at most 127."""
    return [sender for sender in range(128) if sender != OWN_ID][:count]


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


def usual_round(messages: int) -> tuple[Message, ...]:
    """Messages of middling x_hat and confidence."""
    return tuple((sender, _ONE // 4 * 3, 0x80000012) for sender in senders(messages))


def binary32(alpha: int) -> int:
    """The bits of an alpha word's value as a float."""
    return int.from_bytes(struct.pack("<f", word_to_alpha(alpha)), "little")


# ---- Situations ----


def situation(rng: random.Random, messages: int, age: int | None = None) -> Situation:
    """Any one with that many messages, edges over-represented; at that age if one is given."""
    memory, t = _moment(rng) if age is None else (MEMORIES[1], age - 1)
    b_hat = _accuracy(rng)
    return Situation(b_hat, memory, t, _blacks(rng, t, b_hat), _round(rng, messages), rng.getrandbits(1))


def mutated(rng: random.Random, old: Situation) -> Situation:
    """The situation with one thing changed, a little or altogether; as many messages as before."""
    kind = rng.randrange(9 if old.messages else 7)
    if kind < 2:
        b_hat = _near(rng, old.b_hat, *_B_HATS) if kind else _accuracy(rng)
        return replace(old, b_hat=b_hat)
    if kind < 4:
        n = _near(rng, old.n, 0, old.t) if kind == 2 else _blacks(rng, old.t, old.b_hat)
        return replace(old, n=n)
    if kind == 4:
        memory, t = _moment(rng)
        return replace(old, memory=memory, t=t, n=old.n * t // max(old.t, 1))
    if kind == 5:
        b_hat = _accuracy(rng)
        return replace(old, b_hat=b_hat, n=_blacks(rng, old.t, b_hat))
    if kind == 6:
        return replace(old, observation=1 - old.observation)
    return replace(old, messages=_round(rng, len(old.messages)) if kind == 7 else _changed(rng, old.messages))


def _accuracy(rng: random.Random) -> int:
    """b_hat: the clamps, their neighbourhood and that of 1/2 on a logarithmic scale, or any."""
    kind, sign = rng.randrange(7), rng.choice((-1, 1))
    if kind == 0:
        return rng.choice((*_B_HATS, _HALF, _HALF + sign * _INFORMATIVE))
    if kind < 3:
        return sign * int(2 ** rng.uniform(12, 31)) % 2**32
    if kind < 5:
        return _clamped(_HALF + sign * int(2 ** rng.uniform(18, 31)), *_B_HATS)
    if kind == 5:
        return _HALF + sign * (_INFORMATIVE + int(2 ** rng.uniform(0, 16)))
    return rng.randint(*_B_HATS)


def _moment(rng: random.Random) -> tuple[int, int]:
    """A memory and t: mostly where the next observation halves it, else powers of two and any."""
    kind = rng.randrange(10)
    if kind < 3:
        return MEMORIES[1], MEMORIES[1] - 1
    if kind < 7:
        memory = (
            2 ** rng.randrange(6, 32) + 4 * rng.randint(-1, 1) if kind == 3 else int(2 ** rng.uniform(6, 31))
        )
        memory = _clamped(memory // 4 * 4, *MEMORIES)
        return memory, memory - 1
    t = 2 ** rng.randrange(31) + rng.randint(-1, 1) if kind == 7 else int(2 ** rng.uniform(0, 31))
    return MEMORIES[1], _clamped(rng.randint(1, 5) if kind == 8 else t, 1, MEMORIES[1] - 1) - 1


def _blacks(rng: random.Random, t: int, b_hat: int) -> int:
    """n: at the ends, in the middle, where x_hat leaves 0 or 1, or any, and the numbers beside."""
    b, small = b_hat / 2**32, 2 ** rng.uniform(-32, 0)
    share = rng.choice((0.0, 0.5, 1.0, b, 1 - b, rng.random(), small, 1 - small))
    return _clamped(int(t * share) + rng.randint(-3, 3), 0, t)


def _round(rng: random.Random, messages: int) -> tuple[Message, ...]:
    """Messages around any x_hat, 1/2 more often, close together or not; confidence of all kinds."""
    away = rng.choice((-1, 1)) * int(2 ** rng.uniform(0, 22))
    middle = rng.choice((_ONE // 2 + rng.randint(-3, 3), _ONE // 2 + away, rng.randint(0, _ONE), 0, _ONE))
    width, usual = rng.choice((0, 1, 3, 2 ** rng.randrange(1, 23))), rng.choice(_ALPHAS)
    common = rng.random() < 0.4
    return tuple(
        (sender, _clamped(middle + rng.randint(-width, width), 0, _ONE), usual if common else _alpha(rng))
        for sender in senders(messages)
    )


def _alpha(rng: random.Random) -> int:
    """Any word, or that of a confidence on a logarithmic scale."""
    return rng.choice((rng.choice(_ALPHAS), rng.getrandbits(32), alpha_word(int(2 ** rng.uniform(0, 55)))))


def _changed(rng: random.Random, messages: tuple[Message, ...]) -> tuple[Message, ...]:
    """The same with one of them changed."""
    at = rng.randrange(len(messages))
    sender, x_hat, alpha = messages[at]
    if rng.getrandbits(1):
        new = sender, _near(rng, x_hat, 0, _ONE), alpha
    else:
        new = sender, x_hat, rng.choice((_alpha(rng), _near(rng, alpha, 0, 2**32 - 1)))
    return (*messages[:at], new, *messages[at + 1 :])


def _near(rng: random.Random, value: int, least: int, most: int) -> int:
    """A value beside it, at any distance on a logarithmic scale."""
    away = int(2 ** rng.uniform(0, (most - least).bit_length()))
    return _clamped(value + rng.choice((-1, 1)) * away, least, most)


def _clamped(value: int, least: int, most: int) -> int:
    return max(least, min(value, most))
