"""The scenarios of the golden vectors: every edge of ``docs/design.md`` by name, then long runs.

Changing anything here changes the committed vectors; ``golden_vectors.py --output`` makes
them again. Scenarios are numbered in order, those of runs after those of edges; targets report the numbers.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import replace
from fractions import Fraction
from functools import cache
from math import isqrt
from typing import Any

from mcp_asdf.fixed_point import ALPHA_MAX, B_HAT_MAX, B_HAT_MIN, HALF, MANTISSA_MAX, ONE, SHIFT_MAX
from mcp_asdf.mirror import accuracy_of, estimate
from mcp_asdf.robot import DEFAULT_MEMORY, MAX_FILTER_PERIOD, MAX_ID, Filter
from mcp_asdf.table import FRACTION_BITS, Table
from mcp_asdf_tools.crosscheck.scenario import Call, Setup
from targets.golden_runs import SPOILT_TABLE, TABLE, Crowd, GoldenScenario, Run, Xorshift

_LARGEST = 2**32 - 1
_B_HALF = 1 << 31
_BAND = 1 << 19
"""How far from 1/2, in units of 2**-32, a probability begins to say something."""
_ALPHA_ONE = 0x80000001
_JUNK = 0xE0
"""The bits of a confidence's word that firmwares ignore."""

# Words of an image (docs/design.md, section 8).
_B_HAT, _T, _N, _X_HAT, _ALPHA, _FILTER_LEFT, _CLOSED, _OPEN, _X_SUM = 1, 2, 3, 4, 5, 6, 7, 13, 21
_COUNT, _HEARD, _COUNTERS, _LAST = 22, 23, 27, 29
_UPDATED = 1 << 16
"""In the last word: x_hat and alpha need not be those of t, n and b_hat."""

_USUAL = Setup(
    table=TABLE,
    filter=Filter.ADAPTIVE,
    filter_period=1,
    memory=DEFAULT_MEMORY,
    robot_id=0,
    b_hat=3 << 30,
)
"""The filter in every round and b_hat = 3/4, so that a scenario is short."""
_PATIENT = replace(_USUAL, filter_period=MAX_FILTER_PERIOD)
_ALWAYS = replace(_USUAL, table=None, filter=Filter.ALWAYS)
_PLAIN = replace(_USUAL, table=None, filter=Filter.OFF)

_ALPHAS = (
    *(0, SHIFT_MAX, _JUNK, _JUNK | SHIFT_MAX),
    *(0x100, 0x100 | _JUNK, 0x101, 0x200, 0x11F, 0x31F, 0x31F | _JUNK),
    *(_ALPHA_ONE, _ALPHA_ONE | _JUNK, 0x118, 0x7FFFFF01, 0x80000101, 0x40000002),
    *(0xFFFFFF00, 0xFFFFFFE0, 0xFFFFFF08, 0x80000009, 0x80000109),
    *(0x8000001F, ALPHA_MAX - 0x100, ALPHA_MAX, ALPHA_MAX | _JUNK),
)
"""Mantissas of 0; the smallest ones; around 1.0, above 2**24 units and about 2**32 units, where the sums are
divided; the largest. With bits that are ignored, and with shifts that a smaller mantissa would not need."""
_MISFITS = (
    *((_B_HAT, 0), (_B_HAT, B_HAT_MIN - 1), (_B_HAT, B_HAT_MAX + 1), (_B_HAT, 1 << 30)),
    *((_T, 1000), (_T, 2), (_N, 4), (_X_HAT, ONE + 1), (_X_HAT, 0), (_ALPHA, 0), (_ALPHA, _ALPHA_ONE)),
    *((_FILTER_LEFT, 0), (_FILTER_LEFT, 7), (_FILTER_LEFT, _LARGEST)),
    *((_CLOSED + 1, 1 << 30), (_CLOSED + 2, 1), (_CLOSED + 5, 1 << 21)),
    *((_OPEN + 1, 1 << 31), (_OPEN + 7, 0), (_OPEN + 7, 1 << 20), (_X_SUM, 0), (_X_SUM, _LARGEST)),
    *((_COUNT, 0), (_COUNT, 128), (_COUNT, _LARGEST), (_HEARD, 0), (_HEARD, 1 << 5), (_HEARD, _LARGEST)),
    *((_LAST, 128 << 24), (_LAST, 5 << 24 | 2 << 16)),
)
"""Words that do not fit into the image of a robot with id 5, filter period 6 and three observations."""
_CROWD = 150
"""Most messages in a run whose rounds meet every number of neighbours."""


@cache
def edge_scenarios() -> tuple[GoldenScenario, ...]:
    """The edges and a few short runs, for targets of every size. About 2 000 ticks."""
    edges = (*_observing(), *_receiving(), *_filtering(), *_refused(), *_images(), *_rounds())
    return edges + tuple(_random_scenario(index, 60) for index in range(6))


@cache
def run_scenarios() -> tuple[GoldenScenario, ...]:
    """Long runs. About 110 000 ticks."""
    return tuple(_random_scenario(index, 760) for index in range(6, 46))


def _scenario(name: str, setup: Setup, *calls: str) -> GoldenScenario:
    """A scenario from its calls, each of the texts one or several of them, crowds among them."""
    return GoldenScenario(name, setup, tuple(map(_item, " ".join(calls).split())))


def _item(text: str) -> Call | Crowd:
    name, *numbers = text.split(":")
    if name == "crowd":
        return Crowd(*map(int, numbers))
    return Call(name, tuple(int(number) for number in numbers))


def _restore(*pairs: int) -> str:
    return ":".join(map(str, ("restore", *pairs)))


def _at(setup: Setup, t: int, n: int) -> str:
    """Go on as a robot that has observed n black tiles among t."""
    x_hat, alpha = estimate(t, n, accuracy_of(setup.b_hat))
    return _restore(_T, t, _N, n, _X_HAT, x_hat, _ALPHA, alpha)


def _jump(setup: Setup, t: int, n: int, *words: int) -> str:
    """The same just after an update of b_hat, so that x_hat and alpha may be any; ``words``: more pairs."""
    return _restore(_T, t, _N, n, *words, _LAST, _UPDATED | setup.robot_id << 24)


def _receive(sender: int, x_hat: int, alpha: int = _ALPHA_ONE) -> str:
    return f"receive:{sender}:{x_hat}:{alpha}"


def _messages(x_hats: Iterable[int], alpha: int = _ALPHA_ONE) -> str:
    """One message for each, from senders 1, 2, ..."""
    return " ".join(_receive(sender, x_hat, alpha) for sender, x_hat in enumerate(x_hats, 1))


def _crowd(sender: int, count: int, x_hat: int, step: int = 1, alpha: int = 0xF4240000) -> str:
    return f"crowd:{sender}:{count}:{x_hat}:{step}:{alpha}"


# ---- t, n, the memory and the assumed accuracy ----


def _observing() -> Iterator[GoldenScenario]:
    yield _scenario(
        "nothing observed", _USUAL, "settle step:2 observe:2 settle", _messages((ONE, ONE)), "settle"
    )
    yield _scenario("no observation", _USUAL, "step:3 observe:3 step:255 step:1 step:2 settle observe:2")
    for name, b_hat in (("upright", 3 << 30), ("inverted", 1 << 30)):
        setup = replace(_PLAIN, b_hat=b_hat)
        yield _scenario(f"{name}, white to black", setup, "step:0 " * 6, "step:1 " * 7)
        yield _scenario(f"{name}, black to white", setup, "step:1 " * 7, "step:0 " * 6)
    yield from _halving()
    for power in (7, 8, 16, 23, 24, 30):
        t = 1 << power
        starts = (_at(_PLAIN, t - 2, n) for n in (0, t // 4 - 1, t // 2 - 1, t - 5))
        yield _scenario(
            f"t around 2**{power}", _PLAIN, *(f"{start} step:0 step:1 step:0" for start in starts)
        )
    for b_hat in _accuracies():
        setup = replace(_PLAIN, b_hat=b_hat)
        yield _scenario(f"b_hat = {b_hat} / 2**32", setup, *_around(setup))


def _halving() -> Iterator[GoldenScenario]:
    small = replace(_PLAIN, memory=64)
    halvings = (f"{_at(small, 63, n)} step:{z}" for n in (0, 1, 2, 3, 4, 5, 61, 62, 63) for z in (0, 1))
    yield _scenario("a memory of 64 halves, ties to even", small, *halvings)
    for memory in (68, 1000, DEFAULT_MEMORY - 4, DEFAULT_MEMORY):
        setup, last = replace(_PLAIN, memory=memory), memory - 3
        starts = (_at(setup, last, n) for n in (0, 1, memory // 2 - 1, last))
        yield _scenario(
            f"the memory {memory} halves", setup, *(f"{start} step:1 step:0 step:1" for start in starts)
        )
    for t in (2, 64, 1 << 24, DEFAULT_MEMORY - 2):
        halves = (f"{_jump(_PLAIN, t - 1, t // 2 - 1, _B_HAT, b)} observe:1" for b in _accuracies()[::3])
        yield _scenario(f"{t // 2} black among {t}", _PLAIN, *halves)


def _accuracies() -> list[int]:
    """Ends, where the odds' exponent changes sign, about 1/2, and where it begins to say something."""
    below = [B_HAT_MIN, B_HAT_MIN + 1, (1 << 16) - 1, (1 << 16) + 1, 1 << 30, 0x55555555, _B_HALF - 1]
    below += [_B_HALF - _BAND + offset for offset in (-1, 0, 1)]
    return [*below, _B_HALF, *((1 << 32) - b for b in below)]


def _around(setup: Setup) -> Iterator[str]:
    """Observations with a share of black at both ends, at one half, and where eq. 3 changes its case."""
    t = 1000003
    corners = [t * setup.b_hat >> 32, t * ((1 << 32) - setup.b_hat) >> 32]
    for n in (0, t, t // 2, *corners, *(min(corner + 1, t) for corner in corners)):
        yield f"{_jump(setup, t, n)} step:1"


# ---- Messages and what they add up to ----


def _receiving() -> Iterator[GoldenScenario]:
    ids = (_receive(sender, ONE - sender) for sender in (0, 1, 31, 32, 63, 64, 95, 96, 126, 127, 128, 255))
    again = (_receive(sender, 7) for sender in (1, 32, 127))
    yield _scenario("senders", replace(_PATIENT, robot_id=96), *ids, "observe:1", *again, "step:0")
    x_hats = (0, 1, HALF - 1, HALF, ONE, ONE + 1, _LARGEST)
    yield _scenario("estimates of neighbours", _PATIENT, _messages(x_hats), "step:1")
    words = list(enumerate(_ALPHAS, 1))
    together = (f"{_receive(i, ONE - 54321 * i, alpha)} observe:0" for i, alpha in words)
    yield _scenario("confidences of neighbours", _PATIENT, *together, "settle")
    alone = (f"{_receive(i, ONE - 54321 * i, alpha)} settle observe:0" for i, alpha in words)
    yield _scenario("confidences of one neighbour", _PATIENT, *alone)
    silent = " ".join(_receive(i, 12345, alpha) for i, alpha in enumerate(_ALPHAS[:4], 1))
    yield _scenario("messages that say nothing", _ALWAYS, "step:1", silent, "step:1", silent, "settle")
    certain, most = _receive(1, ONE - 1, ALPHA_MAX), _crowd(2, 126, ONE - 126, alpha=ALPHA_MAX)
    yield _scenario(
        "all neighbours, all certain", _USUAL, certain, most, "observe:1", certain, "settle settle"
    )
    sure = replace(_PLAIN, b_hat=B_HAT_MAX)
    late = _at(sure, DEFAULT_MEMORY - 4, DEFAULT_MEMORY - 4)
    yield _scenario(
        "own confidence at its largest", sure, late, "step:1", _receive(1, 5, ALPHA_MAX), "step:1"
    )
    yield _scenario("sums of a round", _PATIENT, *_sums_at_their_limits())


def _sums_at_their_limits() -> Iterator[str]:
    """Images with sums just beyond what three messages can give, and with sums just within."""
    most, x = MANTISSA_MAX << SHIFT_MAX, 2 * ONE
    yield f"{_crowd(1, 1, 0, 0, ALPHA_MAX)} {_crowd(2, 2, ONE, 0, ALPHA_MAX)}"
    for x_squared in (x * ONE + 1, x * x // 3, x * x // 3 + 1, x * ONE):
        yield _restore(*_double(_OPEN + 6, x_squared))
    for low in (x * _LARGEST + 1, x * _LARGEST):
        yield _restore(*_double(_OPEN + 2, low), *_double(_OPEN + 4, 0))
    for high in (x * (MANTISSA_MAX >> 1) + 1, x * (MANTISSA_MAX >> 1)):
        yield _restore(*_double(_OPEN + 2, 0), *_double(_OPEN + 4, high))
    for alpha in (3 * most + 1, 3 * most):
        yield _restore(*_double(_OPEN, alpha))
    for alpha in (2, 3):
        yield _restore(*_double(_OPEN, alpha), *_double(_OPEN + 2, 0), *_double(_OPEN + 4, 0))
    yield "settle"
    for alpha in (MAX_ID * most + 1, MAX_ID * most):
        yield _restore(*_double(_CLOSED, alpha))
    for low in (1 << 62, (1 << 62) - 1):
        yield _restore(*_double(_CLOSED + 2, low), *_double(_CLOSED + 4, 0))
    for alpha in (0x123456789AB, most):  # a mean a little above 1.0, and 1.0
        high, low = divmod(alpha * ONE, 1 << 32)
        for apart in (1, 0):
            yield _restore(
                *_double(_CLOSED, alpha), *_double(_CLOSED + 2, low + apart), *_double(_CLOSED + 4, high)
            )


def _double(index: int, value: int) -> tuple[int, int, int, int]:
    """A number of 64 bits as two words of an image."""
    return index, value & _LARGEST, index + 1, value >> 32


# ---- The test of eq. 12 and the re-estimate of eq. 8 ----


def _filtering() -> Iterator[GoldenScenario]:
    for m in (0, 1, 2, 3, 29, 30, 31, MAX_ID):
        above, below = _crowd(1, m, 3 * HALF // 2), _crowd(1, m, 9)
        yield _scenario(f"rounds of {m}", _USUAL, "step:1", above, "step:0", below, "step:1 step:1")
    for m in (2, 3, 4, 29, 30, 31, MAX_ID):
        yield _scenario(f"the threshold for {m}", _USUAL, *_at_threshold(TABLE.build(), m))
    same = _messages([ONE // 3] * 3)
    own = (_jump(_USUAL, 9, 3, _X_HAT, ONE // 3 + apart, _ALPHA, _ALPHA_ONE) for apart in (0, 1, -1))
    agreed = (f"{start} {same} settle" for start in own)
    yield _scenario("neighbours that agree with each other", _USUAL, *agreed)
    for x_bar in (0, 1, HALF - 1, HALF, HALF + 1, ONE - 1, ONE):
        starts = (_jump(_ALWAYS, 100, n) for n in (0, 1, 50, 100))
        calls = (f"{start} {_receive(1, x_bar)} settle step:1" for start in starts)
        yield _scenario(f"re-estimates from {x_bar} / 2**23", _ALWAYS, *calls)
    yield from _edges_of_the_band()
    t = DEFAULT_MEMORY - 9
    starts = (_jump(_ALWAYS, t, n) for n in (0, 1, 1 << 29, 1 << 30, t))
    calls = (f"{start} {_receive(1, x)} step:1" for start in starts for x in (5, HALF + 3000, 7 * ONE // 8))
    yield _scenario("re-estimates after years", _ALWAYS, *calls)


def _edges_of_the_band() -> Iterator[GoldenScenario]:
    """Rounds whose x_bar is within a few units of 2**-32 of saying something, on both sides of 1/2.

    Two x_hat that are 2 units apart have nearly the same weight: a 256th of it more on one of them moves
    their mean by 2**-32. With this weight the quotient leaves out no value at the edge.
    """
    weight = 0xC90FDA
    for name, middle, sign in (("below", HALF - (_BAND >> 9), -1), ("above", HALF + (_BAND >> 9), 1)):
        calls = (
            f"{_jump(_ALWAYS, 1000, 500 + 10 * sign)} {_receive(1, middle - sign, weight << 8)} "
            f"{_receive(2, middle + sign, weight + i * (weight >> 8) << 8)} settle step:1"
            for i in range(-3, 8)
        )
        yield _scenario(f"x_bar {name} 1/2 that hardly says something", _ALWAYS, *calls)


def _at_threshold(table: Table, m: int) -> Iterator[str]:
    """Two rounds of m messages that eq. 12 hardly decides, the first kept and the second rejected."""
    rounds = list(_close_decisions(table, m))
    for rejected in (False, True):
        on_this_side = (found for found in rounds if (found[0] > 0) == rejected)
        _, apart, p, own = min(on_this_side, key=lambda found: (abs(found[0]), -found[1]))
        start = max(0, -own)
        robot = _jump(_USUAL, 1000, 600, _X_HAT, start + own, _ALPHA, _ALPHA_ONE)
        yield f"{robot} {_crowd(1, p, start, 0)} {_crowd(1 + p, m - p, start + apart, 0)} settle"


def _close_decisions(table: Table, m: int) -> Iterator[tuple[int, int, int, int]]:
    """Rounds close to the threshold: by how much the left side of eq. 12 exceeds the right one, d, p and e.

    p messages are at 0, m - p at d and the own x_hat is at e. Eq. 12 is then (m e - (m - p) d)**2 >
    k p (m - p) d**2: the better a fraction approximates the root of k p (m - p), the closer are the sides.
    """
    scale = 60
    for p in range(1, m):
        factor = table.entry(m) * p * (m - p)
        root = Fraction(isqrt(factor << (2 * scale - FRACTION_BITS)), 1 << scale)
        for bits in range(1, 23):
            difference, apart = root.limit_denominator(1 << bits).as_integer_ratio()
            excess = difference**2 - (factor * apart**2 >> FRACTION_BITS)
            for own, rest in (divmod((m - p) * apart + side, m) for side in (difference, -difference)):
                if rest == 0 and abs(own) + apart <= ONE:
                    yield excess, apart, p, own


# ---- Settings and images ----


def _refused() -> Iterator[GoldenScenario]:
    """Settings of which no robot can be made, and those at their edge of which one can."""
    edges: dict[str, Any] = {
        "filter_period": (0, 1, MAX_FILTER_PERIOD),
        "memory": (0, 60, 62, 65, 66, DEFAULT_MEMORY - 2, DEFAULT_MEMORY + 4, _LARGEST),
        "filter": (3, 255),
        "robot_id": (127, 128, 255),
        "b_hat": (0, B_HAT_MIN - 1, B_HAT_MAX + 1, _LARGEST),
    }
    for member, values in edges.items():
        for value in values:
            yield _scenario(f"{member} = {value}", replace(_PLAIN, **{member: value}))
    yield _scenario("no table", replace(_USUAL, table=None))
    yield _scenario("what is no table", replace(_USUAL, table=SPOILT_TABLE))
    yield _scenario("what is no table, without need", replace(_ALWAYS, table=SPOILT_TABLE))


def _images() -> Iterator[GoldenScenario]:
    setup = replace(_PLAIN, filter_period=6, memory=1000, robot_id=5)
    messages = (_receive(1, 77), _receive(2, ONE, 0), _receive(3, HALF, ALPHA_MAX))
    some = ("step:1", "step:0", *messages, "observe:1")
    yield _scenario("saved and restored at any moment", setup, *(f"{call} restore" for call in some))
    edited = " ".join(_restore(*pair) for pair in _MISFITS)
    yield _scenario("images that do not fit", setup, *some, edited, "settle", edited, "step:1")
    bits = ((0, 1), (3, 128), (4, 1), (60, 16), (120, 1), (123, 128))
    damaged = (f"damage:{index}:{mask}" for index, mask in bits)
    yield _scenario("damaged images", setup, *some, *damaged, "damage:40:0 settle")
    yield _scenario("b_hat updated since the last observation", _ALWAYS, *_after_an_update())
    full = _restore(_COUNTERS, 0xFFFEFFFE, _COUNTERS + 1, 0xFFFEFFFE, _LAST, 0xFFFE)
    busy = f"{_messages((0, ONE, ONE - 1))} {_receive(1, 0)} {_receive(200, 0)} step:1 "
    yield _scenario("counters that wrap", _USUAL, "step:1 step:0", full, busy * 3)
    updates = (f"{_receive(1, x_hat)} step:1" for x_hat in (0, 9, 99))
    yield _scenario("updates that wrap", _ALWAYS, full, *updates)


def _after_an_update() -> Iterator[str]:
    """Until the next observation x_hat and alpha may be any that a robot forms, and before and after not."""
    odd = _restore(_X_HAT, 1, _ALPHA, 0x100)
    yield f"step:1 {odd} {_receive(1, 9)} settle restore {odd} {_restore(_T, 0, _N, 0)}"
    yield _restore(_X_HAT, ONE + 1)
    for alpha in (_JUNK | 0x100, 0x101, 0x7FFFFF01, 0, 0xFFFFFF00, 1 << 31, ALPHA_MAX):
        yield _restore(_ALPHA, alpha)
    for flag in (2, 255, 1, 0):
        yield f"{_restore(_LAST, flag << 16)} {odd}"
    yield f"observe:1 {odd}"


# ---- Rounds and the filter's period ----


def _rounds() -> Iterator[GoldenScenario]:
    some = _messages((ONE // 5, ONE // 4, ONE // 3))
    third = replace(_USUAL, filter_period=3)
    yield _scenario("a test in every third round", third, f"observe:1 {some} settle " * 7)
    yield _scenario("rounds of several ticks", third, f"observe:1 {some} " * 5, "settle settle step:0 settle")
    left = (f"{_restore(_FILTER_LEFT, left)} {some} step:1" for left in (2, 1, 1, MAX_FILTER_PERIOD))
    yield _scenario("the longest filter period", _PATIENT, *left)


# ---- Runs ----


def _random_scenario(index: int, ticks: int) -> GoldenScenario:
    """Four runs of one robot, which jumps to other times in between."""
    source = Xorshift(0x9E3779B1 * (index + 1) & _LARGEST)
    setup = _random_setup(source)
    items: list[Call | Crowd | Run] = []
    for part in range(4):
        if part > 0:
            items.append(_random_jump(source, setup))
        items.append(_random_run(source, ticks))
    return GoldenScenario(f"run {index}", setup, tuple(items))


def _random_setup(source: Xorshift) -> Setup:
    mode = source.pick(Filter.ADAPTIVE, Filter.ADAPTIVE, Filter.ADAPTIVE, Filter.ALWAYS, Filter.OFF)
    return Setup(
        table=TABLE if mode == Filter.ADAPTIVE else None,
        filter=mode,
        filter_period=source.pick(1, 1, 2, 10),
        memory=source.pick(64, 1000, DEFAULT_MEMORY, DEFAULT_MEMORY),
        robot_id=source.below(MAX_ID + 1),
        b_hat=_random_b_hat(source),
    )


def _random_b_hat(source: Xorshift) -> int:
    near_half = _B_HALF + source.pick(-1, 1) * (source.draw() >> source.pick(2, 6, 12))
    b_hat = source.pick(source.draw(), near_half, B_HAT_MIN, B_HAT_MAX, 3 << 30)
    return min(max(b_hat, B_HAT_MIN), B_HAT_MAX)


def _random_jump(source: Xorshift, setup: Setup) -> Call:
    t = source.pick(source.draw() >> source.below(32), setup.memory - 1 - source.below(50))
    t = min(max(t, 1), setup.memory - 1)
    b_hat = _random_b_hat(source)
    n = source.pick(0, t, t // 2, t * b_hat >> 32, t - (t * b_hat >> 32), t * source.draw() >> 32)
    call = _item(_jump(setup, t, n, _B_HAT, b_hat))
    assert isinstance(call, Call)
    return call


def _random_run(source: Xorshift, ticks: int) -> Run:
    messages = source.pick(0, 1, 3, 3, 5, 5, 10, _CROWD)
    return Run(
        seed=source.draw(),
        ticks=ticks // 10 if messages == _CROWD else ticks,
        black=source.pick(0, 20, 64, 128, 200, 255),
        settled=source.pick(36, 128, 240, 255, 255, 255),
        messages=messages,
        spread=source.pick(8, 9, 12, 20, 31),
        centre=source.pick(0, HALF, ONE, source.below(1 << 16) << 7, source.below(1 << 16) << 7),
    )
