"""What golden scenarios are made of: calls as the cross-check writes them, and runs.

A *run* is a few numbers from which ``tests/targets/player.c`` and this module draw the same ticks and
messages, so that a microcontroller's flash holds thousands of them.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

from firmware_py.robot import Observation
from host_tools.scenarios import Call, Setup, TableChoice

TABLE = TableChoice("0.05", 30)
"""The one table of an image."""
SPOILT_TABLE = TableChoice("0.05", 30, (2, 0))
"""Stands for any words that are no table."""

MASK = 0xFFFFFFFF


class Xorshift:
    """The generator of random numbers that targets have, too.

    Args:
        seed: 1 .. 2**32 - 1.
    """

    def __init__(self, seed: int) -> None:
        self._state = seed

    def draw(self) -> int:
        """The next 32 bits."""
        state = self._state
        state ^= state << 13 & MASK
        state ^= state >> 17
        state ^= state << 5 & MASK
        self._state = state
        return state

    def below(self, count: int) -> int:
        """A number from 0 to ``count`` - 1, ``count`` up to 2**16."""
        return (self.draw() >> 16) * count >> 16

    def pick(self, *values: int) -> int:
        """One of the values."""
        return values[self.below(len(values))]


@dataclass(frozen=True)
class Run:
    """Ticks and messages drawn from a few numbers.

    Attributes:
        seed: Start of the generator, 1 .. 2**32 - 1.
        ticks: How many, up to 65535.
        black: Share of black observations in 256ths, 0 .. 255.
        messages: The most messages between two ticks, 0 .. 255.
        spread: Messages' x_hat lie up to 2**(31 - spread) from ``centre`` on either side, 0 .. 31. Those out
            of range are invalid messages.
        centre: In units of 2**-23.
    """

    seed: int
    ticks: int
    black: int
    messages: int
    spread: int
    centre: int

    def calls(self) -> Iterator[Call]:
        """The calls, as ``play_run`` in the C makes them."""
        source = Xorshift(self.seed)
        for _ in range(self.ticks):
            for _ in range(source.below(self.messages + 1)):
                yield self._message(source)
            yield from self._tick(source)

    def _message(self, source: Xorshift) -> Call:
        who = source.draw()
        stranger = 128 if who & 31 == 0 else 0
        x_hat = self.centre + (source.draw() >> self.spread) - (1 << 31 >> self.spread)
        alpha = source.draw()
        anything = alpha & 7 == 0
        alpha = source.draw() if anything else 0x33000000 + (alpha >> 3)
        return Call("receive", (who >> 25 | stranger, x_hat & MASK, alpha))

    def _tick(self, source: Xorshift) -> Iterator[Call]:
        bits = source.draw()
        rare = bits >> 8 & 63
        z = Observation.NONE + rare if rare < 2 else int(bits & 255 < self.black)
        if bits >> 14 & 1:
            yield Call("step", (z,))
            return
        yield Call("observe", (z,))
        if bits >> 15 & 15:
            yield Call("settle")


@dataclass(frozen=True)
class GoldenScenario:
    """A robot and what happens to it, under a name that says what is looked at."""

    name: str
    setup: Setup
    items: tuple[Call | Run, ...]

    def calls(self) -> Iterator[Call]:
        """Every call, those of runs included."""
        for item in self.items:
            if isinstance(item, Run):
                yield from item.calls()
            else:
                yield item
