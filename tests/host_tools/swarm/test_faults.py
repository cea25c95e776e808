"""Faults are what their texts say, and strike as a reference says that takes one frame at a time."""

from __future__ import annotations

import hashlib
import itertools
import re
import struct
from collections import Counter
from fractions import Fraction
from typing import Any

import can
import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

from mcp_asdf_tools.bus.frame_layout import Q23_ONE
from mcp_asdf_tools.bus.frames import (
    Estimate,
    FrameFormat,
    Heartbeat,
    decode_estimate,
    encode_estimate,
    encode_heartbeat,
)
from mcp_asdf_tools.common.errors import UsageError
from mcp_asdf_tools.swarm.delivery import Delivery, SentFrame
from mcp_asdf_tools.swarm.fault_spec import Fault, FaultKind, parse_fault
from mcp_asdf_tools.swarm.faults import Faults
from mcp_asdf_tools.swarm.link_faults import choices
from support import draws

pytestmark = pytest.mark.random

FORMAT = FrameFormat()
ROBOTS, TICKS = 4, 12


# Texts


def test_a_text_may_have_spaces_and_lists_of_ids() -> None:
    fault = Fault(FaultKind.DELAY, 0.5, 100, 500, frozenset({0, 7, 8}), frozenset({1}), ticks=3)
    assert parse_fault("delay=0.5, from=100,to=500, ticks=3,robots=0+7-8,receivers=1") == fault
    assert parse_fault("loss") == Fault(FaultKind.LOSS, 1.0)
    assert parse_fault("corrupt=0,robots=126-127,bits=64") == Fault(
        FaultKind.CORRUPT, 0.0, robots=frozenset({126, 127}), bits=64
    )


BAD = {
    "": "no kind is called ''; choose one of loss, delay, duplicate",
    "lose=0.2": "no kind is called 'lose'; did you mean loss?",
    "loss=2": "rate is '2'; it must be a number, 0 to 1",
    "loss=nan": "rate is 'nan'; it must be a number",
    "loss,ticks=3": "loss has no option 'ticks'; its options are from, to, robots, receivers",
    "loss,from=1,from=2": "from is given twice; give it once",
    "loss,from=5,to=5": "to is 5; it must be above from, 5",
    "loss,from=-1": "from is '-1'; it must be a whole number, 0 to",
    "delay,ticks=1.5": "ticks is '1.5'; it must be a whole number",
    "delay,ticks=0": "ticks is 0; it must be at least 1",
    "loss,robots=5-3": "robots is '5-3'; it must be ids 0 to 127 such as 0+3-5",
    "loss,robots=128": "robots is '128'",
    "corrupt,bits=65": "bits is '65'; it must be a whole number, 1 to 64",
    "crash,rejoin=maybe": "rejoin is 'maybe'; it must be new or restored",
    "collide": "collide needs the id to send under, such as id=3",
    "sybil,x=0": "sybil needs the ids to send under, such as ids=30-39",
    "liar,alpha=-1": "alpha is '-1'; it must be a number, 0 to 3.40282e",
}


@pytest.mark.parametrize("text", BAD)
def test_bad_texts_get_a_clear_error(text: str) -> None:
    with pytest.raises(UsageError, match=re.escape(BAD[text])):
        parse_fault(text)


def test_time_does_not_run_backwards() -> None:
    faults = Faults([parse_fault("crash=0.1")], 5, FORMAT)
    faults.crash(0, 10)
    faults.crash(1, 5)
    with pytest.raises(ValueError, match="tick 9 comes after tick 10"):
        faults.crash(0, 9)


def ids(most: int) -> st.SearchStrategy[frozenset[int]]:
    return st.frozensets(st.integers(0, most), min_size=1)


@st.composite
def any_fault(draw: st.DrawFn, most: int = 127, ticks: int = 2**32 - 1) -> Fault:
    """A fault of any kind, of robots up to ``most`` in ticks up to ``ticks``."""
    options = {
        "receivers": ids(most),
        "ticks": st.integers(1, min(ticks, 5)),
        "bits": st.integers(1, 64),
        "frames": st.integers(0, 3),
        "rejoin": st.sampled_from(["new", "restored"]),
        "x": st.floats(0, 1),
        "alpha": st.floats(0, 1e38),
        "id": st.integers(0, 127),
        "ids": ids(127),
    }
    kind = draw(st.sampled_from(list(FaultKind)))
    chosen: dict[str, Any] = {
        name: draw(options[name])
        for name in kind.options
        if name in ("id", "ids", "frames") or draw(st.booleans())
    }
    start = draw(st.integers(0, ticks - 1))
    stop = draw(st.none() | st.integers(start + 1, ticks))
    rate = draw(st.sampled_from([0.0, 1.0]) | st.floats(0, 1))
    return Fault(kind, rate, start, stop, robots=draw(st.none() | ids(most)), **chosen)


@settings(max_examples=draws(200), derandomize=True, database=None)
@given(any_fault())
def test_the_text_of_a_fault_reads_back(fault: Fault) -> None:
    assert parse_fault(str(fault)) == fault


# What strikes whom, and when

Frame = tuple[int, bytes]
"""Identifier and data."""


def content(frame: can.Message) -> Frame:
    return frame.arbitration_id, bytes(frame.data)


class Reference:
    """The documented scheme, in whole numbers and lists: one frame, node and receiver at a time."""

    def __init__(self, faults: list[Fault], seed: int) -> None:
        kinds = [fault.kind for fault in faults]
        self.faults = faults
        self.numbers = [kinds[:place].count(kind) for place, kind in enumerate(kinds)]
        self.injected = [0] * len(faults)
        self.seed = seed
        self.left: dict[tuple[int, int], int] = {}
        self.regular: dict[tuple[int, int], Estimate] = {}

    def word(self, place: int, index: int, *key: int) -> int:
        """A word of the fault at ``place``: SHAKE-128 of seed, fault and key."""
        name = f"{self.faults[place].kind.value} {self.numbers[place]}".encode()
        seeded = self.seed.to_bytes(16, "little") + name + struct.pack("<IIIBBBB", *key)
        return int.from_bytes(hashlib.shake_128(seeded).digest(8 * index + 8)[8 * index :], "little")

    def begin(self, tick: int) -> None:
        """Begin and end the spells of all nodes; to be called for every tick."""
        for place, fault in enumerate(self.faults):
            for node in range(ROBOTS) if fault.kind in (FaultKind.CRASH, FaultKind.BUSOFF) else ():
                left = max(self.left.get((place, node), 0) - 1, 0)
                word = self.word(place, 0, tick, 0, 0, node, 0, 0, 0)
                if left == 0 and self.on(fault, tick, node) and word < Fraction(fault.rate) * 2**64:
                    left = fault.ticks
                self.left[place, node] = left
                self.injected[place] += left > 0

    def on(self, fault: Fault, tick: int, node: int) -> bool:
        stop = 2**40 if fault.stop is None else fault.stop
        return fault.start <= tick < stop and (fault.robots is None or node in fault.robots)

    def off(self, node: int, kind: FaultKind | None = None) -> bool:
        """Whether a spell of this kind, or any, lasts for a node."""
        return any(
            left and self.faults[place].kind in ([kind] if kind else list(FaultKind))
            for (place, who), left in self.left.items()
            if who == node
        )

    def babble(self, node: int, tick: int, kind: FaultKind) -> list[Frame]:
        found = []
        for place, fault in enumerate([] if self.off(node) else self.faults):
            struck = self.word(place, 0, tick, 0, 0, node, 0, 0, 0) < Fraction(fault.rate) * 2**64
            if fault.kind is not kind or not (self.on(fault, tick, node) and struck):
                continue
            if fault.ids is None:
                words = [self.word(place, 1, tick, k, 0, node, 0, 0, 0) for k in range(fault.frames)]
                frames = [(FORMAT.identifier(node), word.to_bytes(8, "little")) for word in words]
            else:
                said = struct.pack("<I", round(fault.x * Q23_ONE))[:3] + struct.pack(
                    "<fB", fault.alpha, 224 + tick
                )
                frames = [(FORMAT.identifier(each), said) for each in range(128) if each in fault.ids]
            found += frames
            self.injected[place] += len(frames)
        return found

    def leave(self, frame: Frame, node: int, tick: int, number: int) -> Frame:
        """What gets onto the bus of a frame, the ``number``-th with its identifier; the node is not off."""
        for place, fault in enumerate(self.faults):
            said = decode_estimate(can.Message(arbitration_id=frame[0], data=frame[1]), FORMAT)
            struck = self.word(place, 0, tick, number, frame[0], node, 0, 2, 0) < Fraction(fault.rate) * 2**64
            struck = struck and self.on(fault, tick, node)
            if fault.kind is FaultKind.COLLIDE and struck:
                assert fault.id is not None
                frame = (frame[0] // 128 * 128 + fault.id, frame[1])
            elif fault.kind is FaultKind.LIAR and struck and isinstance(said, Estimate):
                x = content(
                    encode_estimate(
                        Estimate(said.sender, round(fault.x * Q23_ONE), 0, said.transfer_id), FORMAT
                    )
                )
                frame = (frame[0], x[1][:3] + struct.pack("<f", fault.alpha) + x[1][7:])
            elif fault.kind is FaultKind.FREEZE and isinstance(said, Estimate):
                held = self.regular.get((place, node))
                if struck and held is not None:
                    again = Estimate(said.sender, held.x_hat, held.alpha, said.transfer_id)
                    frame = content(encode_estimate(again, FORMAT))
                else:
                    self.regular[place, node], struck = said, False
            else:
                struck = False
            self.injected[place] += struck
        return frame

    def ways(self, frame: Frame, sent: SentFrame, receiver: int) -> list[tuple[tuple[int, ...], int, bytes]]:
        """Turn, delay and data of each copy that reaches a receiver."""
        copies = [((), 0, 0, frame[1])]
        for place, fault in enumerate(self.faults):
            after: list[Any] = []
            for turn, delay, version, data in copies:
                words = 1 + (fault.bits if fault.kind is FaultKind.CORRUPT else 0)
                key = (sent.tick, sent.number, frame[0], sent.sender, version % 256, 3, 0)
                first = self.word(place, receiver * words, *key)
                is_on = self.on(fault, sent.tick, sent.sender)
                is_for = fault.receivers is None or receiver in fault.receivers
                hit = is_on and is_for and first < Fraction(fault.rate) * 2**64
                spared, struck = ((*turn, 0), delay, version, data), (*turn, 1)
                if not hit:
                    after.append(spared)
                elif fault.kind is FaultKind.DELAY:
                    after.append((struck, delay + fault.ticks, version, data))
                elif fault.kind is FaultKind.DUPLICATE:
                    copy = version | 1 << self.numbers[place]
                    after += [(struck, delay, version, data)]
                    after += [((*turn, 2), delay + fault.ticks, copy, data)]
                elif fault.kind is FaultKind.CORRUPT:
                    flips = [self.word(place, receiver * words + 1 + k, *key) for k in range(fault.bits)]
                    after.append((struck, delay, version, flipped(data, flips)))
                elif fault.kind is not FaultKind.LOSS:
                    after.append(spared)
                    hit = False
                self.injected[place] += hit
            copies = after
        return [(turn, delay, data) for turn, delay, _, data in copies]


def flipped(data: bytes, words: list[int]) -> bytes:
    """The data with a bit more flipped for each word: Floyd's choice of some of all bits."""
    width, chosen = 8 * len(data), set[int]()
    for to_come, word in zip(range(len(words), 0, -1), words, strict=True):
        if width >= to_come:
            bit = word % (width - to_come + 1)
            chosen.add(width - to_come if bit in chosen else bit)
    number = int.from_bytes(data, "little") ^ sum(1 << bit for bit in chosen)
    return number.to_bytes(len(data), "little")


EVERY_KIND = (
    *("loss=0.1", "delay=0.5", "duplicate=0.5,ticks=2", "corrupt=0.5,bits=3", "babble=0.5,frames=2"),
    *("crash=0.1", "freeze=0.5", "liar=0.3", "collide=0.2,id=3", "busoff=0.1,ticks=2", "sybil=0.2,ids=4-6"),
)


@settings(max_examples=draws(400), derandomize=True, database=None, deadline=None)
@given(st.lists(any_fault(ROBOTS - 1, TICKS), max_size=6), st.integers(0, 2**128 - 1), st.booleans())
@example([parse_fault(text) for text in EVERY_KIND], 7, False)
@example([parse_fault("duplicate=0.9,from=3,to=4,robots=0,receivers=1")] * 9, 7, False)
def test_every_frame_meets_the_fate_that_the_reference_says(
    kinds: list[Fault], seed: int, is_late: bool
) -> None:
    """All that is sent, all that each robot hears in each tick, in order, and all counts."""
    replay = f"{[str(fault) for fault in kinds]}, seed {seed}, late {is_late}"
    chance = np.random.default_rng(seed % 2**32)
    faults, reference = Faults(kinds, seed, FORMAT), Reference(kinds, seed)
    delivery = Delivery(lambda: hears, faults.paths, int(is_late))
    under_way: list[tuple[int, int, tuple[int, ...], int, int, Frame]] = []
    last: list[tuple[SentFrame, Frame]] = []
    for tick in range(TICKS):
        hears = (chance.random((ROBOTS, ROBOTS)) < 0.8) & ~np.eye(ROBOTS, dtype=np.bool_)
        reference.begin(tick)
        sent: list[SentFrame] = []
        expected: list[Frame] = []
        for node in range(ROBOTS):
            lasting = faults.crash(node, tick)
            assert (lasting is not None) == reference.off(node, FaultKind.CRASH), replay
            own = Estimate(node, int(chance.integers(Q23_ONE)), int(chance.integers(1, 1 << 24)), tick % 32)
            early, late = (faults.babble(node, tick, tick / 10, is_early) for is_early in (True, False))
            heartbeat = encode_heartbeat(Heartbeat(node, tick, tick % 32))
            before = [*early, encode_estimate(own, FORMAT), heartbeat, *late]
            leaving = [each for frame in before for each in faults.leave(frame, node, tick)]
            first, last_ones = (
                reference.babble(node, tick, kind) for kind in (FaultKind.SYBIL, FaultKind.BABBLE)
            )
            frames = [*first, content(encode_estimate(own, FORMAT)), content(heartbeat), *last_ones]
            counts = Counter[int]()
            for frame in [] if reference.off(node) else frames:
                expected.append(reference.leave(frame, node, tick, counts[frame[0]]))
                counts[frame[0]] += 1
            assert [each.tick for each in leaving] == [tick] * len(leaving)
            sent += leaving
        assert [content(each.frame) for each in sent] == expected, replay
        pairs = list(zip(sent, expected, strict=True))
        pairs, last = (last, pairs) if is_late else (pairs, last)
        for (place, (each, frame)), receiver in itertools.product(enumerate(pairs), range(ROBOTS)):
            if hears[receiver, each.sender] and not reference.off(receiver):
                for turn, delay, data in reference.ways(frame, each, receiver):
                    under_way.append((tick + delay, tick, turn, place, receiver, (frame[0], data)))
        arrivals = delivery.arrivals(tick, sent)
        for receiver in range(ROBOTS):
            due = sorted(each for each in under_way if each[0] == tick and each[4] == receiver)
            assert list(map(content, arrivals.of(receiver))) == [each[-1] for each in due], replay
    assert [each["injected"] for each in faults.figures()] == reference.injected, replay
    assert all(reference.injected) or len(kinds) < len(EVERY_KIND), replay
    assert delivery.arrived == sum(due < TICKS for due, *_ in under_way)


@pytest.mark.parametrize(("width", "count"), [(5, 1), (5, 2), (6, 3), (5, 4), (4, 4), (3, 5), (0, 2)])
def test_all_choices_of_bits_are_equally_likely(width: int, count: int) -> None:
    """Each remainder of each word once."""
    divisors = [max(width - to_come + 1, 1) for to_come in range(count, 0, -1)]
    words = np.array(list(itertools.product(*map(range, divisors))), np.uint64)
    found = Counter(choices(np.full(len(words), width), words).tolist())
    subsets = itertools.combinations(range(width), min(count, width))
    expected = [sum(1 << bit for bit in subset) for subset in subsets]
    assert found == dict.fromkeys(expected, len(words) // len(expected))
