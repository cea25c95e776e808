"""Every kind of fault strikes where and as often as it should, by the seed alone, in any order of calls."""

from __future__ import annotations

import hashlib
import itertools
import math
import re
import struct
from collections import Counter
from typing import Any, NamedTuple

import can
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from mcp_asdf.fixed_point import alpha_to_word, alpha_word
from mcp_asdf_tools.bus.frames import (
    ONE,
    FrameFormat,
    Heartbeat,
    Message,
    alpha_bits,
    bits_of,
    decode,
    encode,
    encode_heartbeat,
    float_of,
)
from mcp_asdf_tools.common.errors import UsageError
from mcp_asdf_tools.swarm.delivery import Paths, SentFrame, flipped
from mcp_asdf_tools.swarm.fault_spec import Fault, FaultKind, parse_fault
from mcp_asdf_tools.swarm.faults import Faults
from mcp_asdf_tools.swarm.link_faults import choices
from support import draws

pytestmark = pytest.mark.random

SEED = 20241029
FORMAT = FrameFormat()

Link = tuple[int, int, int]
"""Tick, sender, receiver."""


def faults_of(*texts: str, seed: int = SEED) -> Faults:
    return Faults([parse_fault(text) for text in texts], seed)


def counts(faults: Faults) -> list[int]:
    return [figure["injected"] for figure in faults.figures()]


def estimate(sender: int, tick: int) -> can.Message:
    """A message whose content shows its origin."""
    alpha = alpha_word(7 * tick + sender)
    return encode(Message(sender, 1000 * sender + tick, alpha, tick % 32), FORMAT, tick / 10)


class Delivery(NamedTuple):
    """Frame on its way to one receiver."""

    frame: can.Message
    delay: int
    place: float


def all_ways(ways: list[Paths], number: int, sent: SentFrame, receiver: int) -> list[Delivery]:
    """Deliveries of one frame to one receiver, each kind of ways in turn."""
    return [
        Delivery(
            sent.frame if each.flips is None else flipped(sent.frame, int(each.flips[number, receiver])),
            each.delay,
            0.0 if each.places is None else float(each.places[number, receiver]),
        )
        for each in ways
        if each.reach[number, receiver]
    ]


def deliver(faults: Faults, sent: SentFrame, receiver: int) -> list[Delivery]:
    """Deliveries of one frame to one receiver."""
    in_range = np.zeros((1, receiver + 1), np.bool_)
    in_range[0, receiver] = True
    return all_ways(faults.paths(sent.tick, [sent], in_range), 0, sent, receiver)


def run(faults: Faults, robots: int = 4, ticks: int = 50) -> dict[Link, list[Delivery]]:
    """Deliveries of one message of every robot to every other in each tick."""
    heard: dict[Link, list[Delivery]] = {}
    everyone = ~np.eye(robots, dtype=np.bool_)
    for tick in range(ticks):
        sent = [each for k in range(robots) for each in faults.leave(estimate(k, tick), k, tick)]
        ways = faults.paths(tick, sent, everyone[[each.sender for each in sent]])
        for sender, receiver in itertools.permutations(range(robots), 2):
            heard[tick, sender, receiver] = [
                way
                for place, each in enumerate(sent)
                if each.sender == sender
                for way in all_ways(ways, place, each, receiver)
            ]
    return heard


def contents(heard: dict[Link, list[Delivery]]) -> dict[Link, list[tuple[int, float, int, bytes]]]:
    """The same in values that can be compared."""
    return {
        link: [(way.delay, way.place, way.frame.arbitration_id, bytes(way.frame.data)) for way in ways]
        for link, ways in heard.items()
    }


def struck(faults: Faults) -> set[Link]:
    """The links whose deliveries are not what they are without faults."""
    calm = contents(run(Faults([], SEED)))
    return {link for link, ways in contents(run(faults)).items() if ways != calm[link]}


def said(frame: can.Message) -> Message:
    message = decode(frame, FORMAT)
    assert isinstance(message, Message)
    return message


# Texts


@pytest.mark.parametrize(
    ("text", "fault"),
    [
        ("loss", Fault(FaultKind.LOSS)),
        (
            "loss=0.2,from=100,to=500,robots=3-5",
            Fault(FaultKind.LOSS, 0.2, 100, 500, robots=frozenset({3, 4, 5})),
        ),
        (
            " delay = 0.5, ticks=3 ,robots=0+7-8,receivers=1".replace(" = ", "="),
            Fault(FaultKind.DELAY, 0.5, robots=frozenset({0, 7, 8}), receivers=frozenset({1}), ticks=3),
        ),
        ("burst=0.1,length=2.5", Fault(FaultKind.BURST, 0.1, length=2.5)),
        ("crash=1e-3,ticks=50,rejoin=restored", Fault(FaultKind.CRASH, 0.001, ticks=50, rejoin="restored")),
        ("liar,x=0.25,alpha=1e9", Fault(FaultKind.LIAR, x=0.25, alpha=1e9)),
        ("collide,robots=1,id=2", Fault(FaultKind.COLLIDE, robots=frozenset({1}), id=2)),
        ("queue,frames=0", Fault(FaultKind.QUEUE, frames=0)),
    ],
)
def test_texts(text: str, fault: Fault) -> None:
    assert parse_fault(text) == fault


@pytest.mark.parametrize(
    ("text", "complaint"),
    [
        ("", "no kind is called ''; choose one of loss, burst, delay"),
        ("lose=0.2", "no kind is called 'lose'; choose"),
        ("loss=2", "rate of fault loss is 2.0; it must be 0 to 1"),
        ("loss=", "rate is ''; it must be a number"),
        ("loss=nan", "rate is 'nan'; it must be a number"),
        ("loss,ticks=3", "loss has no option 'ticks'; its options are from, to, robots, receivers"),
        ("liar,receivers=3", "liar has no option 'receivers'"),
        ("loss,from=1,from=2", "from is given twice; give it once"),
        ("loss,from=5,to=5", "to of fault loss is 5; it must be above from, 5"),
        ("loss,from=-1", "from of fault loss is -1; it must be 0 to"),
        ("delay,ticks=1.5", "ticks is '1.5'; it must be a whole number"),
        ("delay,ticks=0", "ticks of fault delay is 0; it must be at least 1"),
        ("loss,robots=5-3", "robots is '5-3'; it must be ids 0 to 127 such as 0+3-5"),
        ("loss,robots=128", "robots is '128'"),
        ("loss,robots=", "robots is ''"),
        ("burst=0.9", "rate of fault burst is 0.9; it must be at most length / (length + 1), 0.833333"),
        ("burst,length=0.5", "length of fault burst is 0.5; it must be 1 to"),
        ("corrupt,bits=65", "bits of fault corrupt is 65; it must be 1 to 64"),
        ("crash,rejoin=maybe", "rejoin of fault crash is maybe; it must be new or restored"),
        ("collide", "collide needs the id to send under, such as id=3"),
        ("collide,id=128", "id of fault collide is 128; it must be 0 to 127"),
        ("liar,x=1.1", "x of fault liar is 1.1; it must be 0 to 1"),
        ("liar,alpha=-1", "alpha of fault liar is -1.0; it must be 0 to 3.40282e"),
        ("babble,frames=10001", "frames of fault babble is 10001; it must be 0 to 10000"),
    ],
)
def test_bad_texts_get_a_clear_error(text: str, complaint: str) -> None:
    with pytest.raises(UsageError, match=re.escape(complaint)):
        parse_fault(text)


def test_an_option_of_another_kind_is_refused_in_python_too() -> None:
    with pytest.raises(UsageError, match="fault loss has no bits; its options are"):
        Fault(FaultKind.LOSS, bits=3)


def test_a_seed_out_of_range_is_refused() -> None:
    with pytest.raises(UsageError, match="seed is -1"):
        Faults([], -1)


_IDS = st.frozensets(st.integers(0, 127), min_size=1)
_OPTIONS = {
    "receivers": _IDS,
    "ticks": st.integers(1, 10**6),
    "length": st.floats(1, 1e6),
    "bits": st.integers(1, 64),
    "frames": st.integers(0, 10_000),
    "rejoin": st.sampled_from(["new", "restored"]),
    "x": st.floats(0, 1),
    "alpha": st.floats(0, 1e38),
    "id": st.integers(0, 127),
}


@st.composite
def any_fault(draw: st.DrawFn) -> Fault:
    kind = draw(st.sampled_from(list(FaultKind)))
    chosen: dict[str, Any] = {
        name: draw(_OPTIONS[name]) for name in kind.options if name == "id" or draw(st.booleans())
    }
    start = draw(st.integers(0, 1000))
    stop = draw(st.none() | st.integers(start + 1, 2000))
    rate = draw(st.floats(0, 0.5))
    return Fault(kind, rate, start, stop, robots=draw(st.none() | _IDS), **chosen)


@settings(max_examples=draws(200), derandomize=True, database=None)
@given(any_fault())
def test_the_text_of_a_fault_reads_back(fault: Fault) -> None:
    assert parse_fault(str(fault)) == fault


# Draws


def test_draws_follow_the_stated_scheme() -> None:
    """Recomputed with hashlib from the seed, the fault and the frame."""
    lost = struck(faults_of("loss=0", "loss=0.3"))
    for tick, sender, receiver in itertools.product(range(50), range(4), range(4)):
        key = struct.pack("<IIIBBBB", tick, 0, FORMAT.identifier(sender), sender, 0, 3, 0)
        drawn = hashlib.shake_128(SEED.to_bytes(16, "little") + b"loss 1" + key).digest(128 * 8)
        word = int.from_bytes(drawn[8 * receiver :][:8], "little")
        is_lost = sender != receiver and word < 0.3 * 2**64
        assert ((tick, sender, receiver) in lost) == is_lost


MIX = (
    *("burst=0.2,length=3", "corrupt=0.2,bits=3", "delay=0.3,ticks=2", "duplicate=0.3", "reorder=0.3"),
    *("freeze=0.2", "liar=0.1", "collide=0.1,id=2", "error=0.2", "crash=0.05,ticks=3", "busoff=0.05,ticks=2"),
)


def test_what_else_is_asked_changes_nothing() -> None:
    """With fewer receivers and senders, and another kind of frame, a link's fate is the same."""
    everything, alone = run(faults_of(*MIX), robots=5), faults_of(*MIX)
    link = {each: ways for each, ways in everything.items() if each[1:] == (1, 3)}
    heard: dict[Link, list[Delivery]] = {}
    for tick in range(50):
        alone.leave(encode_heartbeat(Heartbeat(1, tick, 0)), 1, tick)
        sent = alone.leave(estimate(1, tick), 1, tick)
        heard[tick, 1, 3] = [way for each in sent for way in deliver(alone, each, 3)]
    assert contents(heard) == contents(link)


@pytest.mark.parametrize(
    "kind",
    [
        kind
        for kind in FaultKind
        if kind not in (FaultKind.BURST, FaultKind.COLLIDE, FaultKind.BABBLE, FaultKind.QUEUE)
    ],
)
def test_a_larger_rate_strikes_wherever_a_smaller_one_does(kind: FaultKind) -> None:
    few, many = (struck(Faults([Fault(kind, rate)], SEED)) for rate in (0.1, 0.4))
    assert 0 < len(few) < len(many)
    assert few < many


def test_seeds_links_and_faults_differ() -> None:
    assert struck(faults_of("loss=0.5")) != struck(faults_of("loss=0.5", seed=SEED + 1))
    assert struck(faults_of("loss=0", "loss=0.5")) != struck(faults_of("loss=0.5"))
    lost = struck(faults_of("loss=0.5"))
    patterns = {frozenset(t for t, *link in lost if link == [a, b]) for a in range(4) for b in range(4)}
    assert len(patterns) == 4 * 3 + 1


@pytest.mark.parametrize("kind", [kind for kind in FaultKind if kind is not FaultKind.BURST])
def test_certain_and_impossible(kind: FaultKind) -> None:
    identifier = 3 if kind is FaultKind.COLLIDE else None
    never, always = (Faults([Fault(kind, rate, id=identifier)], SEED) for rate in (0.0, 1.0))
    assert struck(never) == set()
    assert counts(never) == [0]
    run(always)
    each_frame, each_delivery = 4 * 50, 4 * 3 * 50
    expected = dict.fromkeys(
        (FaultKind.CRASH, FaultKind.BUSOFF, FaultKind.LIAR, FaultKind.COLLIDE, FaultKind.ERROR), each_frame
    )
    expected |= {FaultKind.FREEZE: each_frame - 4, FaultKind.BABBLE: 0, FaultKind.QUEUE: 0}
    assert counts(always) == [expected.get(kind, each_delivery)]


@pytest.mark.parametrize(
    "kind",
    [FaultKind.LOSS, FaultKind.DELAY, FaultKind.REORDER, FaultKind.LIAR, FaultKind.ERROR, FaultKind.CRASH],
)
def test_a_schedule_says_when_and_whom(kind: FaultKind) -> None:
    fault = Fault(kind, 1.0, 10, 20, robots=frozenset({1, 3}))
    hit = struck(Faults([fault], SEED))
    pairs = {(a, b) for a in (1, 3) for b in range(4) if a != b}
    if kind is FaultKind.CRASH:
        pairs |= {(b, a) for a, b in pairs}
    assert hit == {(tick, *pair) for tick in range(10, 20) for pair in pairs}


def test_receivers_say_on_whose_way() -> None:
    assert struck(faults_of("loss,robots=0+1,receivers=1+2")) == {
        (tick, *pair) for tick in range(50) for pair in ((0, 1), (0, 2), (1, 2))
    }


# Kinds


def the_way(ways: list[Delivery]) -> Delivery:
    (way,) = ways
    return way


@pytest.mark.parametrize("rate", [0.05, 0.5, 0.9])
def test_loss_has_its_share(rate: float) -> None:
    """Within five standard deviations of the stated probability; the seed is fixed."""
    faults, trials = faults_of(f"loss={rate}"), 4 * 3 * 2000
    heard = run(faults, ticks=2000)
    lost = sum(not ways for ways in heard.values())
    assert abs(lost - rate * trials) < 5 * math.sqrt(trials * rate * (1 - rate))
    assert counts(faults) == [lost]


@pytest.mark.slow
@pytest.mark.parametrize(("rate", "length"), [(0.1, 5.0), (0.3, 20.0), (0.5, 1.0)])
def test_bursts_have_their_share_and_length(rate: float, length: float) -> None:
    """Runs of lost ticks on a link: their mean, and how much of the time they take (wide bounds)."""
    faults, ticks = faults_of(f"burst={rate},length={length}"), 5000
    heard = run(faults, ticks=ticks)
    runs = []
    for a, b in itertools.permutations(range(4), 2):
        lost = [not heard[tick, a, b] for tick in range(ticks)]
        runs += [len(list(group)) for is_lost, group in itertools.groupby(lost) if is_lost]
    assert sum(runs) == counts(faults)[0]
    assert sum(runs) / (12 * ticks) == pytest.approx(rate, rel=0.15)
    assert sum(runs) / len(runs) == pytest.approx(length, rel=0.15)
    # In Gilbert's chain the lengths are geometric, so a burst is longer than its mean this often.
    longer = sum(each > length for each in runs) / len(runs)
    assert longer == pytest.approx((1 - 1 / length) ** length, abs=0.05)


def test_delay_and_duplicates() -> None:
    for (tick, sender, _), ways in run(faults_of("delay,ticks=4", "duplicate,ticks=3")).items():
        assert [way.delay for way in ways] == [4, 7]
        assert {bytes(way.frame.data) for way in ways} == {bytes(estimate(sender, tick).data)}


def test_copies_have_fates_of_their_own() -> None:
    faults = faults_of("duplicate,ticks=0", "loss=0.5")
    found = [len(ways) for ways in run(faults, ticks=200).values()]
    assert {0, 1, 2} == set(found)
    assert counts(faults) == [len(found), 2 * len(found) - sum(found)]
    assert found.count(1) == pytest.approx(len(found) / 2, rel=0.1)


def test_reordered_frames_fall_behind_others_by_chance() -> None:
    ways = [the_way(ways) for ways in run(faults_of("reorder=0.5")).values()]
    places = [way.place for way in ways]
    moved = [place for place in places if place > 0]
    assert all(0 <= place < 1 for place in places)
    assert len(set(moved)) == len(moved)
    assert len(moved) == pytest.approx(len(ways) / 2, rel=0.1)
    assert sum(moved) / len(moved) == pytest.approx(0.5, abs=0.05)


@pytest.mark.parametrize("bits", [1, 3, 64])
def test_corruption_flips_so_many_bits_of_the_data_and_nothing_else(bits: int) -> None:
    flipped = [0] * 64
    for (tick, sender, _), ways in run(faults_of(f"corrupt,bits={bits}"), ticks=200).items():
        before, after = estimate(sender, tick), the_way(ways).frame
        difference = int.from_bytes(before.data, "little") ^ int.from_bytes(after.data, "little")
        assert difference.bit_count() == bits
        assert (after.arbitration_id, after.dlc) == (before.arbitration_id, 8)
        flipped = [count + (difference >> bit & 1) for bit, count in enumerate(flipped)]
    mean, trials = 2400 * bits / 64, 2400
    assert all(abs(count - mean) <= 5 * math.sqrt(mean * (1 - mean / trials)) for count in flipped)


@pytest.mark.parametrize(("width", "count"), [(5, 1), (5, 2), (6, 3), (5, 4), (4, 4), (3, 5), (0, 2)])
def test_all_choices_of_bits_are_equally_likely(width: int, count: int) -> None:
    """Each remainder of each word once."""
    divisors = [max(width - to_come + 1, 1) for to_come in range(count, 0, -1)]
    words = np.array(list(itertools.product(*map(range, divisors))), np.uint64)
    found = Counter(choices(np.full(len(words), width), words).tolist())
    subsets = itertools.combinations(range(width), min(count, width))
    expected = [sum(1 << bit for bit in subset) for subset in subsets]
    assert found == dict.fromkeys(expected, len(words) // len(expected))


def test_corruption_of_short_frames_stays_inside_them() -> None:
    faults = faults_of("corrupt,bits=12")
    for data in (b"", b"\0"):
        frame = can.Message(arbitration_id=5, data=data)
        (way,) = deliver(faults, SentFrame(frame, 0, 0), 1)
        assert bytes(way.frame.data) == b"\xff" * len(data)


def test_the_frame_sent_is_never_changed_in_place() -> None:
    frame = estimate(1, 2)
    before = bytes(frame.data)
    for sent in faults_of("liar", "collide,id=9", "corrupt").leave(frame, 1, 2):
        deliver(faults_of("corrupt"), sent, 2)
    assert (bytes(frame.data), frame.arbitration_id) == (before, FORMAT.identifier(1))


def test_babble_is_random_frames_under_the_own_identifier() -> None:
    faults = faults_of("babble=0.5,frames=20,robots=2")
    found = [faults.babble(2, tick) for tick in range(100)]
    sizes = [len(frames) for frames in found]
    assert set(sizes) == {0, 20}
    assert counts(faults) == [sum(sizes)]
    assert all(frame.arbitration_id == FORMAT.identifier(2) for frames in found for frame in frames)
    assert len({bytes(frame.data) for frames in found for frame in frames}) == sum(sizes)
    assert faults.babble(1, 100) == []


def test_each_babbled_frame_has_a_fate_of_its_own() -> None:
    faults = faults_of("babble,frames=20", "loss=0.5")
    sent = [each for frame in faults.babble(0, 0) for each in faults.leave(frame, 0, 0)]
    assert [each.number for each in sent] == list(range(20))
    arrived = [bool(deliver(faults, each, 1)) for each in sent]
    assert 3 < sum(arrived) < 17


def test_crashed_nodes_are_dead_for_the_stated_ticks() -> None:
    """Spells of exactly so many ticks, unless another begins at once."""
    faults = faults_of("crash=0.05,ticks=7")
    dead = [faults.crash(0, tick) is not None for tick in range(2000)]
    runs = [len(list(group)) for is_dead, group in itertools.groupby(dead) if is_dead]
    assert all(length % 7 == 0 for length in runs[:-1])
    assert 7 in runs
    assert counts(faults) == [sum(dead)]
    assert sum(dead) / 2000 == pytest.approx(7 / (7 + 19), abs=0.06)


def test_a_crash_may_last_beyond_the_schedule() -> None:
    faults = faults_of("crash,from=10,to=11,ticks=5,rejoin=restored")
    dead = [faults.crash(3, tick) for tick in range(30)]
    assert [tick for tick, fault in enumerate(dead) if fault] == [10, 11, 12, 13, 14]
    assert {fault.rejoin for fault in dead if fault} == {"restored"}


def test_bus_off_is_off_the_bus_but_no_crash() -> None:
    faults = faults_of("busoff,from=2,to=4,robots=1", "babble,frames=1")
    for tick in range(6):
        is_off = tick in (2, 3)
        assert faults.is_off(1, tick) == is_off
        assert faults.crash(1, tick) is None
        assert len(faults.babble(1, tick)) == (not is_off)
        assert bool(faults.leave(estimate(1, tick), 1, tick)) == (not is_off)
        (other,) = faults.leave(estimate(0, tick), 0, tick)
        assert bool(deliver(faults, other, 1)) == (not is_off)
        assert deliver(faults, other, 2)
    assert counts(faults) == [2, 4]


def test_a_frozen_robot_repeats_its_last_regular_estimate() -> None:
    faults = faults_of("freeze,from=3,to=6,robots=1")
    spoken = [said(sent.frame) for tick in range(8) for sent in faults.leave(estimate(1, tick), 1, tick)]
    sources = [0, 1, 2, 2, 2, 2, 6, 7]
    own = [said(estimate(1, tick)) for tick in sources]
    assert [(m.x_hat, m.alpha) for m in spoken] == [(m.x_hat, m.alpha) for m in own]
    assert [m.transfer_id for m in spoken] == list(range(8))
    assert counts(faults) == [3]


def test_a_robot_frozen_from_the_start_repeats_its_first_estimate() -> None:
    faults = faults_of("freeze")
    spoken = [said(sent.frame) for tick in range(4) for sent in faults.leave(estimate(1, tick), 1, tick)]
    assert {(m.x_hat, m.alpha) for m in spoken} == {(1000, alpha_word(1))}
    assert counts(faults) == [3]


@pytest.mark.parametrize("alpha", [1e9, 0.1, 1e-30, 3e38])
def test_a_liar_says_what_it_is_told(alpha: float) -> None:
    """Also confidences that no firmware can hold are on the bus as claimed."""
    faults = faults_of(f"liar,x=0.25,alpha={alpha}")
    (sent,) = faults.leave(estimate(1, 40), 1, 40)
    assert alpha_bits(sent.frame) == bits_of(alpha)
    assert said(sent.frame) == Message(1, ONE // 4, alpha_to_word(float_of(bits_of(alpha))), 40 % 32)
    assert sent.frame.timestamp == 4.0


@pytest.mark.parametrize("text", ["liar", "freeze"])
def test_frames_that_are_no_estimates_are_let_alone(text: str) -> None:
    faults = faults_of(text)
    for tick in range(3):
        beat = encode_heartbeat(Heartbeat(1, tick, tick))
        assert [sent.frame for sent in faults.leave(beat, 1, tick)] == [beat]
    assert counts(faults) == [0]


def test_a_collision_takes_the_others_id_in_every_frame() -> None:
    faults = faults_of("collide,robots=1,id=2")
    (sent,) = faults.leave(estimate(1, 0), 1, 0)
    assert said(sent.frame).sender == 2
    assert sent.sender == 1
    (beat,) = faults.leave(encode_heartbeat(Heartbeat(1, 0, 0)), 1, 0)
    assert beat.frame.arbitration_id & 127 == 2
    assert counts(faults) == [2]


def test_an_error_frame_reaches_all_and_the_frame_comes_again() -> None:
    faults = faults_of("error", "loss")
    error, again = faults.leave(estimate(1, 0), 1, 0)
    assert error.frame.is_error_frame
    assert bytes(again.frame.data) == bytes(estimate(1, 0).data)
    assert len(deliver(faults, error, 2)) == 1
    assert len(deliver(faults, again, 2)) == 0
    assert counts(faults) == [1, 1]


def test_a_short_queue_refuses_what_is_too_much_in_a_tick() -> None:
    faults = faults_of("queue,frames=3")
    for tick in range(5):
        sent = [len(faults.leave(estimate(node, tick), node, tick)) for node in (0, 1) for _ in range(5)]
        assert sent == [1, 1, 1, 0, 0] * 2
    assert counts(faults) == [2 * 2 * 5]


def test_faults_act_in_the_order_given() -> None:
    lying_first = faults_of("liar,x=0", "freeze,from=1")
    frozen_first = faults_of("freeze,from=1", "liar,x=0")
    for faults in (lying_first, frozen_first):
        for tick in range(3):
            faults.leave(estimate(1, tick), 1, tick)
    # A frozen robot repeats a lie if the liar comes before it; after it the liar has the last word.
    assert counts(lying_first) == [3, 2]
    assert counts(frozen_first) == [2, 3]


def test_time_must_not_run_backwards() -> None:
    faults = faults_of("crash=0.1")
    faults.crash(0, 10)
    faults.crash(1, 5)
    with pytest.raises(ValueError, match="tick 9 comes after tick 10"):
        faults.crash(0, 9)


def test_other_frames_on_the_wire_change_no_fate() -> None:
    """Telemetry and heartbeats next to the estimates draw numbers of their own."""
    plain, beside = faults_of("loss=0.5"), faults_of("loss=0.5")
    for tick in range(50):
        (alone,) = plain.leave(estimate(1, tick), 1, tick)
        beside.leave(encode_heartbeat(Heartbeat(1, tick, 0)), 1, tick)
        (after,) = beside.leave(estimate(1, tick), 1, tick)
        assert bool(deliver(plain, alone, 2)) == bool(deliver(beside, after, 2))
