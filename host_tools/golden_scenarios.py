"""The scenarios of the golden vectors: every edge of ``docs/design.md`` by name, then long runs.

Changing anything here changes the committed vectors; ``python -m host_tools.golden_vectors --output`` makes
them again. Scenarios are numbered in order, those of runs after those of edges; targets report the numbers.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import astuple, replace
from fractions import Fraction
from functools import cache
from math import isqrt
from typing import Any

from firmware_py.fixed_point import ALPHA_INFINITE, ALPHA_MAX, B_HAT_MAX, B_HAT_MIN, HALF, ONE
from firmware_py.mirror import sums_add
from firmware_py.robot import DEFAULT_MEMORY, MAX_ID, Filter, Sums
from firmware_py.table import Table
from host_tools.golden_runs import SPOILT_TABLE, TABLE, GoldenScenario, Run, Xorshift
from host_tools.scenarios import Call, Setup, build_table

_LARGEST = 2**32 - 1
_B_HALF = 1 << 31
_INFORMATIVE = 1 << 19
"""How far from 1/2, in units of 2**-32, b_hat says something."""
_ALPHA_ONE = 0x3F800000

# Words of an image (docs/design.md, section 8).
_T, _N, _B_HAT, _X_HAT, _ALPHA, _SETTLED_X_HAT, _CLOSED, _OPEN, _X_SUM = 1, 2, 3, 4, 5, 6, 8, 14, 22
_COUNT, _HEARD, _COMMS_LEFT, _FILTER_LEFT, _COUNTERS, _LAST = 23, 24, 28, 29, 30, 32

_USUAL = Setup(TABLE, Filter.ADAPTIVE, 1, 1, DEFAULT_MEMORY, 0, 3 << 30)
"""The filter in every tick and b_hat = 3/4, so that a scenario is short."""
_LISTENING = replace(_USUAL, comms_period=_LARGEST, filter_period=_LARGEST)
"""The round stays open, so that every call shows what it holds."""
_ALWAYS = replace(_USUAL, table=None, filter=Filter.ALWAYS)
_PLAIN = replace(_USUAL, table=None, filter=Filter.OFF)

_ALPHAS = (
    *(0x32FFFFFF, 0x33000000, 0x337FFFFF, 0x33800000, 0x33800001, 0x34000000, 0x34400001),
    *(0x3EFFFFFE, 0x3EFFFFFF, 0x3F000000, 0x3F000001, 0x4EFFFFFE, ALPHA_MAX, ALPHA_MAX + 1),
    *(0, 1, 0x007FFFFF, 0x00800000, ALPHA_INFINITE - 1, ALPHA_INFINITE, ALPHA_INFINITE + 1),
    *(0x7FC00000, 0x80000000, 0x80000001, 0xBF800000, 0xFF800000, _LARGEST),
)
"""The grid and its coarse part; the ends of the range and of binary32; what is no number, and signs."""
_MISFITS = (
    *((_T, 1000), (_T, 2), (_N, 4), (_B_HAT, 0), (_B_HAT, B_HAT_MIN - 1), (_B_HAT, B_HAT_MAX + 1)),
    *((_X_HAT, ONE + 1), (_ALPHA, 0x80000000), (_ALPHA, ALPHA_MAX + 1), (_ALPHA, 0x33800001)),
    *((_ALPHA, 0x33000000), (_ALPHA, 0), (_SETTLED_X_HAT, _LARGEST)),
    *((_CLOSED + 1, 1 << 30), (_CLOSED + 2, 1), (_CLOSED + 5, 1 << 21)),
    *((_OPEN + 1, 1 << 31), (_OPEN + 6, _LARGEST), (_OPEN + 7, 1 << 20), (_X_SUM, 0), (_X_SUM, _LARGEST)),
    *((_COUNT, 0), (_COUNT, 128), (_COUNT, _LARGEST), (_HEARD, 1 << 5), (_HEARD + 3, _LARGEST)),
    *((_COMMS_LEFT, 4), (_FILTER_LEFT, 0), (_FILTER_LEFT, 4), (_FILTER_LEFT, 9)),
    *((_LAST, 128 << 24), (_LAST, 5 << 24 | 127 << 16), (_LAST, 5 << 24)),
)
"""Words that do not fit into the image of a robot with id 5, periods 3 and 6 and three observations."""
_CROWD = 150
"""Most messages in a run whose rounds meet every number of neighbours."""


@cache
def edge_scenarios() -> tuple[GoldenScenario, ...]:
    """The edges and a few short runs, for targets of every size. About 2 000 ticks."""
    edges = (*_observing(), *_receiving(), *_filtering(), *_refused(), *_images(), *_ticking())
    return edges + tuple(_random_scenario(index, 60) for index in range(8))


@cache
def run_scenarios() -> tuple[GoldenScenario, ...]:
    """Long runs. About 110 000 ticks."""
    return tuple(_random_scenario(index, 760) for index in range(8, 48))


def _scenario(name: str, setup: Setup, *calls: str) -> GoldenScenario:
    """A scenario from its calls, each of the texts one or several of them."""
    return GoldenScenario(name, setup, tuple(map(_call, " ".join(calls).split())))


def _call(text: str) -> Call:
    name, *numbers = text.split(":")
    return Call(name, tuple(int(number) for number in numbers))


def _restore(*pairs: int) -> str:
    return ":".join(map(str, ("restore", *pairs)))


def _receive(sender: int, x_hat: int, alpha: int = _ALPHA_ONE) -> str:
    return f"receive:{sender}:{x_hat}:{alpha}"


def _messages(x_hats: Iterable[int], alpha: int = _ALPHA_ONE) -> str:
    """One message for each, from senders 1, 2, ..."""
    return " ".join(_receive(sender, x_hat, alpha) for sender, x_hat in enumerate(x_hats, 1))


def _add(messages: int, sums: Sums) -> str:
    return ":".join(map(str, ("add", messages, *astuple(sums))))


def _sums(count: int, x_hat: int = HALF + 1, alpha: int = 0x49742400) -> Sums:
    """Sums of messages whose x_hat go up by one unit from ``x_hat``."""
    sums = Sums()
    for index in range(count):
        sums_add(sums, x_hat + index, alpha)
    return sums


# ---- t, n, the memory and the assumed accuracy ----


def _observing() -> Iterator[GoldenScenario]:
    yield _scenario(
        "nothing observed", _USUAL, "settle step:2 observe:2 settle", _messages((ONE, ONE)), "step:2"
    )
    yield _scenario("no observation", _USUAL, "step:3 observe:3 step:255 step:1 step:3 step:2")
    for name, b_hat in (("upright", 3 << 30), ("inverted", 1 << 30)):
        setup = replace(_PLAIN, b_hat=b_hat)
        yield _scenario(f"{name}, white to black", setup, "step:0 " * 6, "step:1 " * 7)
        yield _scenario(f"{name}, black to white", setup, "step:1 " * 7, "step:0 " * 6)
    halvings = (f"{_restore(_T, 63, _N, n)} step:{z}" for n in (0, 1, 2, 3, 4, 5, 61, 62, 63) for z in (0, 1))
    yield _scenario("a memory of 64 halves, ties to even", replace(_PLAIN, memory=64), *halvings)
    last = DEFAULT_MEMORY - 3
    for n in (0, 1, DEFAULT_MEMORY // 2 - 1, last):
        yield _scenario(
            f"the longest memory, n = {n}", _PLAIN, _restore(_T, last, _N, n), "step:1 step:0 step:1"
        )
    for power in (7, 8, 16, 23, 24, 30, 31):
        t = 1 << power
        starts = (_restore(_T, t - 2, _N, n) for n in (0, t // 4 - 1, t // 2 - 1, t - 5))
        yield _scenario(
            f"t around 2**{power}", _PLAIN, *(f"{start} step:0 step:1 step:0" for start in starts)
        )
    for b_hat in _accuracies():
        yield _scenario(f"b_hat = {b_hat} / 2**32", replace(_PLAIN, b_hat=b_hat), *_around(b_hat))


def _accuracies() -> list[int]:
    """Ends, where the odds' exponent changes sign, about 1/2, and where it begins to say something."""
    below = [B_HAT_MIN, B_HAT_MIN + 1, (1 << 16) - 1, (1 << 16) + 1, 1 << 30, 0x55555555, _B_HALF - 1]
    below += [_B_HALF - _INFORMATIVE + offset for offset in (-1, 0, 1)]
    return [*below, _B_HALF, *((1 << 32) - b for b in below)]


def _around(b_hat: int) -> Iterator[str]:
    """Observations with a share of black at both ends, at one half, and where eq. 3 changes its case."""
    t = 1000003
    corners = [t * b_hat >> 32, t * ((1 << 32) - b_hat) >> 32]
    for n in (0, t, t // 2, *corners, *(min(corner + 1, t) for corner in corners)):
        yield f"{_restore(_T, t, _N, n)} step:1"


# ---- Messages and what they add up to ----


def _receiving() -> Iterator[GoldenScenario]:
    ids = (_receive(sender, ONE - sender) for sender in (0, 1, 31, 32, 63, 64, 95, 96, 126, 127, 128, 255))
    again = (_receive(sender, 7) for sender in (1, 32, 127))
    yield _scenario("senders", replace(_LISTENING, robot_id=96), *ids, "observe:1", *again, "step:0")
    x_hats = (0, 1, HALF - 1, HALF, ONE, ONE + 1, _LARGEST)
    yield _scenario("estimates of neighbours", _LISTENING, _messages(x_hats), "step:1")
    alphas = (f"{_receive(i, ONE - 54321 * i, alpha)} observe:2" for i, alpha in enumerate(_ALPHAS, 1))
    yield _scenario("confidences of neighbours", _LISTENING, *alphas, "settle")
    silent = " ".join(_receive(i, 12345, alpha) for i, alpha in enumerate((0, 1, 0x33000000, 0x337FFFFF), 1))
    yield _scenario("messages that say nothing", _ALWAYS, "step:1", silent, "step:1", silent, "step:2")
    certain, most = _receive(1, ONE - 1, ALPHA_MAX), _add(126, _sums(126, ONE - 126, ALPHA_MAX))
    yield _scenario(
        "all neighbours, all certain", _USUAL, certain, most, "observe:1", certain, "settle settle"
    )
    late = _restore(_T, DEFAULT_MEMORY - 4, _N, DEFAULT_MEMORY - 4)
    sure = replace(_PLAIN, b_hat=B_HAT_MAX)
    yield _scenario(
        "own confidence at its largest", sure, late, "step:1", _receive(1, 5, ALPHA_MAX), "step:1"
    )
    yield _scenario("sums of rounds", _LISTENING, *_additions())


def _additions() -> Iterator[str]:
    """Sums as large as messages can give, those a little larger, and more messages than there are ids."""
    three = _sums(3, ONE - 2, ALPHA_MAX)
    yield _add(5, three)
    largest = {"alpha": 3 * 0xFFFFFF << 31, "alpha_x_low": three.x * _LARGEST, "x": 3 * ONE}
    largest |= {"alpha_x_high": three.x * 0x7FFFFF, "x_squared": three.x * ONE}
    for name, most in largest.items():
        yield _add(3, replace(three, **{name: most + 1}))
    yield _add(2, three)
    yield _add(255, three)
    yield _add(122, _sums(122))
    yield _add(0, Sums())
    yield _add(1, Sums())


# ---- The test of eq. 12 and the re-estimate of eq. 8 ----


def _filtering() -> Iterator[GoldenScenario]:
    for m in (0, 1, 2, 3, 30, 31, MAX_ID):
        above, below = _add(m, _sums(m, 3 * HALF // 2)), _add(m, _sums(m, 9))
        yield _scenario(f"rounds of {m}", _USUAL, "step:1", above, "step:0", below, "step:1 step:1")
    for m in (2, 3, 4, 30, 31, MAX_ID):
        yield _scenario(f"the threshold for {m}", _USUAL, *_at_threshold(build_table(TABLE), m))
    same = _messages([ONE // 3] * 3)
    own = _restore(_T, 9, _N, 3, _X_HAT, ONE // 3, _ALPHA, _ALPHA_ONE, _COMMS_LEFT, 0)
    agreed = ("step:1", same, "step:1", own, same, "settle")
    yield _scenario("neighbours that agree with each other", _USUAL, *agreed)
    for x_bar in (0, 1, HALF - 1, HALF, HALF + 1, ONE - 1, ONE):
        starts = (_restore(_T, 100, _N, n) for n in (0, 1, 50, 99, 100))
        calls = (f"{start} {_receive(1, x_bar)} step:2 step:1" for start in starts)
        yield _scenario(f"re-estimates from {x_bar} / 2**23", _ALWAYS, *calls)
    t = DEFAULT_MEMORY - 9
    starts = (_restore(_T, t, _N, n) for n in (0, 1, 1 << 30, 1 << 31, t))
    calls = (f"{start} {_receive(1, x)} step:1" for start in starts for x in (5, HALF + 3, 7 * ONE // 8))
    yield _scenario("re-estimates after years", _ALWAYS, *calls)


def _at_threshold(table: Table, m: int) -> Iterator[str]:
    """Two rounds of m messages that eq. 12 hardly decides, the first kept and the second rejected."""
    rounds = list(_close_decisions(table, m))
    for rejected in (False, True):
        on_this_side = (found for found in rounds if (found[0] > 0) == rejected)
        _, apart, p, own = min(on_this_side, key=lambda found: (abs(found[0]), -found[1]))
        start = max(0, -own)
        sums = Sums()
        for index in range(m):
            sums_add(sums, start + (apart if index >= p else 0), _ALPHA_ONE)
        words = (_X_HAT, start + own, _ALPHA, _ALPHA_ONE, _COMMS_LEFT, 0)
        yield f"{_restore(_T, 1000, _N, 600, _B_HAT, _USUAL.b_hat, *words)} {_add(m, sums)} settle"


def _close_decisions(table: Table, m: int) -> Iterator[tuple[int, int, int, int]]:
    """Rounds close to the threshold: by how much the left side of eq. 12 exceeds the right one, d, p and e.

    p messages are at 0, m - p at d and the own x_hat is at e. Eq. 12 is then (m e - (m - p) d)**2 >
    k p (m - p) d**2: the better a fraction approximates the root of k p (m - p), the closer are the sides.
    """
    scale = 60
    for p in range(1, m):
        factor = table.entry(m) * p * (m - p)
        root = Fraction(isqrt(factor << (2 * scale - table.fraction_bits)), 1 << scale)
        for bits in range(1, 23):
            difference, apart = root.limit_denominator(1 << bits).as_integer_ratio()
            excess = difference**2 - (factor * apart**2 >> table.fraction_bits)
            for own, rest in (divmod((m - p) * apart + side, m) for side in (difference, -difference)):
                if rest == 0 and abs(own) + apart <= ONE:
                    yield excess, apart, p, own


# ---- Settings and images ----


def _refused() -> Iterator[GoldenScenario]:
    """Settings of which no robot can be made, and those at their edge of which one can."""
    wrong: dict[str, Any] = {
        "comms_period": (0,),
        "filter_period": (0,),
        "memory": (0, 62, 65, _LARGEST),
        "filter": (3, 255),
        "robot_id": (127, 128, 255),
        "b_hat": (0, B_HAT_MIN - 1, B_HAT_MAX + 1, _LARGEST),
    }
    for member, values in wrong.items():
        for value in values:
            yield _scenario(f"{member} = {value}", replace(_PLAIN, **{member: value}))
    yield _scenario("a filter period that is no multiple", replace(_PLAIN, comms_period=2, filter_period=3))
    yield _scenario("no table", replace(_USUAL, table=None))
    yield _scenario("what is no table", replace(_USUAL, table=SPOILT_TABLE))
    yield _scenario("what is no table, without need", replace(_ALWAYS, table=SPOILT_TABLE))


def _images() -> Iterator[GoldenScenario]:
    setup = replace(_PLAIN, comms_period=3, filter_period=6, memory=1000, robot_id=5)
    messages = (_receive(1, 77), _receive(2, ONE, 0), _receive(3, HALF, ALPHA_MAX))
    some = ("step:1", "step:0", *messages, "observe:1")
    yield _scenario("saved and restored at any moment", setup, *(f"{call} restore" for call in some))
    edited = " ".join(_restore(*pair) for pair in _MISFITS)
    yield _scenario("images that do not fit", setup, *some, edited, "settle", edited, "step:1")
    bits = ((0, 1), (3, 128), (4, 1), (66, 16), (132, 1), (135, 128))
    damaged = (f"damage:{index}:{mask}" for index, mask in bits)
    yield _scenario("damaged images", setup, *some, *damaged, "damage:40:0 settle")
    full = _restore(_COUNTERS, 0xFFFEFFFE, _COUNTERS + 1, 0xFFFEFFFE, _LAST, 0xFFFE)
    busy = f"{_messages((0, ONE, ONE - 1))} {_receive(1, 0)} {_receive(200, 0)} step:1 "
    yield _scenario("counters that are full", _USUAL, "step:1 step:0", full, busy * 3)
    updates = (f"{_receive(1, x_hat)} step:1" for x_hat in (0, 9, 99))
    yield _scenario("updates that are full", _ALWAYS, full, *updates)


# ---- Periods ----


def _ticking() -> Iterator[GoldenScenario]:
    setup = replace(_USUAL, comms_period=3, filter_period=6)
    some = _messages((ONE // 5, ONE // 4, ONE // 3))
    yield _scenario("a broadcast every third tick", setup, f"observe:1 {some} settle " * 7)
    yield _scenario("rounds that are settled late", setup, f"observe:1 {some} " * 5, "settle settle step:0")
    yield _scenario("the longest period", _LISTENING, _restore(_COMMS_LEFT, 1), f"{some} step:1 " * 2)


# ---- Runs ----


def _random_scenario(index: int, ticks: int) -> GoldenScenario:
    """Four runs of one robot, which jumps to other times in between."""
    source = Xorshift(0x9E3779B1 * (index + 1) & _LARGEST)
    setup = _random_setup(source)
    items: list[Call | Run] = []
    for part in range(4):
        if part > 0:
            items.append(_random_jump(source, setup))
        items.append(_random_run(source, ticks))
    return GoldenScenario(f"run {index}", setup, tuple(items))


def _random_setup(source: Xorshift) -> Setup:
    mode = source.pick(Filter.ADAPTIVE, Filter.ADAPTIVE, Filter.ADAPTIVE, Filter.ALWAYS, Filter.OFF)
    comms_period = source.pick(1, 1, 1, 2, 7)
    return Setup(
        TABLE if mode == Filter.ADAPTIVE else None,
        mode,
        comms_period,
        comms_period * source.pick(1, 1, 2, 10),
        source.pick(64, 1000, DEFAULT_MEMORY, DEFAULT_MEMORY),
        source.below(MAX_ID + 1),
        _random_b_hat(source),
    )


def _random_b_hat(source: Xorshift) -> int:
    near_half = _B_HALF + source.pick(-1, 1) * (source.draw() >> source.pick(2, 6, 12))
    b_hat = source.pick(source.draw(), near_half, B_HAT_MIN, B_HAT_MAX, 3 << 30)
    return min(max(b_hat, B_HAT_MIN), B_HAT_MAX)


def _random_jump(source: Xorshift, setup: Setup) -> Call:
    t = source.pick(source.draw() >> source.below(32), setup.memory - 1 - source.below(50))
    t = min(t, setup.memory - 1)
    b_hat = _random_b_hat(source)
    n = source.pick(0, t, t // 2, t * b_hat >> 32, t - (t * b_hat >> 32), t * source.draw() >> 32)
    return Call("restore", (_T, t, _N, n, _B_HAT, b_hat)[: source.pick(4, 6)])


def _random_run(source: Xorshift, ticks: int) -> Run:
    messages = source.pick(0, 1, 3, 3, 5, 5, 10, _CROWD)
    return Run(
        seed=source.draw(),
        ticks=ticks // 10 if messages == _CROWD else ticks,
        black=source.pick(0, 20, 64, 128, 200, 255),
        messages=messages,
        spread=source.pick(8, 9, 12, 20, 31),
        centre=source.pick(0, HALF, ONE, source.below(1 << 16) << 7, source.below(1 << 16) << 7),
    )
