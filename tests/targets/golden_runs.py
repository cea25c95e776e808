"""Parts of golden scenarios: calls as the cross-check writes them, crowds of messages, and runs.

A *crowd* and a *run* are a few numbers from which ``tests/targets/player.c`` and this module make the same
calls, so that a microcontroller's flash holds rounds of 127 messages and thousands of ticks.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace

from mcp_asdf.table import Table
from mcp_asdf_tools.crosscheck.scenario import Call, Setup, TableChoice

TABLE = TableChoice("0.05", 30)
"""The one table of an image."""


class _SpoiltTable(TableChoice):
    """Stands for any words that are no table."""

    def build(self) -> Table:
        """A table of an impossible omega."""
        return replace(super().build(), omega_word=0)


SPOILT_TABLE = _SpoiltTable(TABLE.omega, TABLE.q)

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
class Crowd:
    """Messages of senders whose ids follow each other, all with the same confidence.

    Attributes:
        sender: Id of the first one, 0 .. 255; ids are counted modulo 256.
        count: How many there are, 0 .. 255.
        x_hat: That of the first one, in units of 2**-23.
        step: By how much each x_hat is above the one before, modulo 2**32.
        alpha: As the firmware's word.
    """

    sender: int
    count: int
    x_hat: int
    step: int
    alpha: int

    def calls(self) -> Iterator[Call]:
        """The calls, as ``play_crowd`` in the C makes them."""
        for i in range(self.count):
            yield Call("receive", (self.sender + i & 0xFF, self.x_hat + i * self.step & MASK, self.alpha))


@dataclass(frozen=True)
class Run:
    """Ticks and messages drawn from a few numbers.

    Attributes:
        seed: Start of the generator, 1 .. 2**32 - 1.
        ticks: How many, up to 65535.
        black: Share of black observations in 256ths, 0 .. 255.
        settled: Share of ticks that end a round in 256ths, 0 .. 255.
        messages: The most messages between two ticks, 0 .. 255.
        spread: Messages' x_hat lie up to 2**(31 - spread) from ``centre`` on either side, 0 .. 31. Those out
            of range are invalid messages.
        centre: In units of 2**-23.
    """

    seed: int
    ticks: int
    black: int
    settled: int
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
        return Call("receive", (who >> 25 | stranger, x_hat & MASK, _alpha(source)))

    def _tick(self, source: Xorshift) -> Iterator[Call]:
        bits = source.draw()
        rare, settles = bits >> 8 & 63, bits >> 14 & 255 < self.settled
        z = 2 if rare == 1 else int(bits & 255 < self.black)  # 2 is an error
        if rare != 0 and settles and bits >> 22 & 1:
            yield Call("step", (z,))
            return
        if rare != 0:
            yield Call("observe", (z,))
        if settles:
            yield Call("settle")


def _alpha(source: Xorshift) -> int:
    """A confidence: mostly a canonical word of any magnitude, sometimes a small mantissa, or any bits."""
    word = source.draw()
    kind = word >> 5 & 7
    if kind == 0:
        return source.draw()
    if kind == 1:
        return word >> (word & 31)
    return (word | 1 << 31) & ~0xE0


@dataclass(frozen=True)
class GoldenScenario:
    """A robot and what happens to it, under a name that says what is looked at."""

    name: str
    setup: Setup
    items: tuple[Call | Crowd | Run, ...]

    def calls(self) -> Iterator[Call]:
        """Every call, those of crowds and runs included."""
        for item in self.items:
            if isinstance(item, Call):
                yield item
            else:
                yield from item.calls()
