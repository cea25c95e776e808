"""Faults are read from text, and disturb frames and nodes as a plain reference computes it.

The reference takes one frame, node and receiver at a time, in whole numbers and lists.
"""

from __future__ import annotations

import hashlib
import itertools
import struct
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, replace
from fractions import Fraction
from typing import Any

import can
import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

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
from mcp_asdf_tools.swarm.delivery import DeliveryQueue, SentFrame
from mcp_asdf_tools.swarm.fault_injection.fault import Fault
from mcp_asdf_tools.swarm.fault_injection.fault_run import choose_bits
from mcp_asdf_tools.swarm.fault_injection.faults import Faults
from mcp_asdf_tools.swarm.fault_injection.kinds import (
    FAULT_KINDS,
    Babble,
    BusOff,
    Collide,
    Corrupt,
    Crash,
    Delay,
    Duplicate,
    Freeze,
    Liar,
    LinkFault,
    Loss,
    OutageFault,
    Sybil,
)
from mcp_asdf_tools.swarm.fault_injection.parsing import parse_fault
from messages import IdentifierAndData, identifier_and_data
from support import draws

pytestmark = pytest.mark.random

FORMAT = FrameFormat()
ROBOTS, TICKS = 4, 12


# Texts


@pytest.mark.parametrize(
    ("text", "expected_fault"),
    [
        ("loss", Loss(rate=1.0)),
        (
            "delay=0.5,from=100,to=500,ticks=3,robots=0+7-8,receivers=1",
            Delay(
                rate=0.5, start=100, stop=500, robots=frozenset({0, 7, 8}), receivers=frozenset({1}), ticks=3
            ),
        ),
        # There may be spaces after commas.
        ("corrupt=0, robots=126-127, bits=64", Corrupt(rate=0.0, robots=frozenset({126, 127}), bits=64)),
    ],
)
def test_a_fault_has_the_options_of_its_text(text: str, expected_fault: Fault) -> None:
    """The number behind its kind is the rate, the probability with which it hits; without one it is 1."""
    assert parse_fault(text) == expected_fault


def test_the_text_of_a_fault_has_its_rate_and_the_options_that_are_not_the_default() -> None:
    """The fault sends estimates under made-up ids, here 30 and 31. Its end and its alpha are the default."""
    fault = Sybil(rate=0.1, start=5, robots=frozenset({4}), x=0.0, ids=frozenset({30, 31}))
    assert str(fault) == "sybil=0.1,from=5,robots=4,x=0.0,ids=30-31"


BAD_TEXTS = {
    "": "no kind is called ''; choose one of loss, delay, duplicate",
    "lose=0.2": "no kind is called 'lose'; did you mean loss?",
    "loss=2": "rate is '2'; it must be a number, 0 to 1",
    "loss=nan": "rate is 'nan'; it must be a number",
    "loss,ticks=3": "loss has no option 'ticks'; its options are from, to, robots, receivers",
    "loss,from=1,from=2": "from is given twice; give it once",
    "loss,from=5,to=5": "to is 5; it must be above from, 5",
    "loss,from=-1": "from is '-1'; it must be a whole number, 0 to",
    "delay,ticks=1.5": "ticks is '1.5'; it must be a whole number",
    "delay,ticks=0": "ticks is '0'; it must be a whole number, 1 to",
    "loss,robots=5-3": "robots is '5-3'; it must be ids 0 to 127 such as 0+3-5",
    "loss,robots=128": "robots is '128'",
    "corrupt,bits=65": "bits is '65'; it must be a whole number, 1 to 64",
    "crash,rejoin=maybe": "rejoin is 'maybe'; it must be new or restored",
    "collide": "collide needs the id to send under, such as id=3",
    "sybil,x=0": "sybil needs the ids to send under, such as ids=30-39",
    "liar,alpha=-1": "alpha is '-1'; it must be a number, 0 to 3.40282e",
}


@pytest.mark.parametrize(("wrong_text", "expected_message"), BAD_TEXTS.items())
def test_a_wrong_text_of_a_fault_is_refused_with_the_error_and_its_fix(
    wrong_text: str, expected_message: str
) -> None:
    """For example, "loss=2" is refused, as a rate is a probability: "it must be a number, 0 to 1"."""
    with pytest.raises(UsageError) as raised:
        parse_fault(wrong_text)
    assert expected_message in str(raised.value)


def sets_of_ids(maximum: int) -> st.SearchStrategy[frozenset[int]]:
    return st.frozensets(st.integers(0, maximum), min_size=1)


@st.composite
def any_fault(draw: st.DrawFn, max_robot: int = 127, last_tick: int = 2**32 - 1) -> Fault:
    """A fault of any kind, of robots up to ``max_robot`` in ticks up to ``last_tick``."""
    strategies = {
        "receivers": sets_of_ids(max_robot),
        "ticks": st.integers(1, min(last_tick, 5)),
        "bits": st.integers(1, 64),
        "frames": st.integers(0, 3),
        "rejoin": st.sampled_from(["new", "restored"]),
        "x": st.floats(0, 1),
        "alpha": st.floats(0, 1e38),
        "id": st.integers(0, 127),
        "ids": sets_of_ids(127),
    }
    kind = draw(st.sampled_from(FAULT_KINDS))
    options: dict[str, Any] = {
        name: draw(strategies[name])
        for name in kind.own_options()
        if name in ("id", "ids", "frames") or draw(st.booleans())
    }
    start = draw(st.integers(0, last_tick - 1))
    stop = draw(st.none() | st.integers(start + 1, last_tick))
    rate = draw(st.sampled_from([0.0, 1.0]) | st.floats(0, 1))
    robots = draw(st.none() | sets_of_ids(max_robot))
    return kind(rate=rate, start=start, stop=stop, robots=robots, **options)


@settings(max_examples=draws(200), derandomize=True, database=None)
@given(any_fault())
def test_the_text_of_any_fault_is_read_as_the_same_fault(fault: Fault) -> None:
    """Reports and recordings have such texts, and a user can give them to another run."""
    assert parse_fault(str(fault)) == fault


# What is hit, and when


def estimate_data(x: float, alpha: float, tail_byte: int) -> bytes:
    """Return an estimate's data: 3 bytes of x in units of 2**-23, 4 of alpha as a float, and the tail."""
    x_bytes = round(x * Q23_ONE).to_bytes(3, "little")
    return x_bytes + struct.pack("<f", alpha) + bytes([tail_byte])


@dataclass(frozen=True)
class Copy:
    """A copy of a frame on its way to one receiver.

    Attributes:
        data: Its data, maybe with flipped bits.
        path: A number for each fault so far: 0 if it spared the copy, 1 if it hit it, 2 if the copy is the
            duplicate that it made. Copies that arrive in one tick are ordered by it.
        delay: Ticks from sending to arrival.
        copy_number: Has a bit for each duplicating fault that made it; random words depend on it.
    """

    data: bytes
    path: tuple[int, ...] = ()
    delay: int = 0
    copy_number: int = 0


class Reference:
    """All faults of a run, as docs/swarm.md describes them."""

    def __init__(self, faults: list[Fault], seed: int) -> None:
        kinds = [fault.name for fault in faults]
        self.faults = faults
        self.fault_numbers = [kinds[:index].count(kind) for index, kind in enumerate(kinds)]
        self.hit_counts = [0] * len(faults)
        self.seed = seed
        self.ticks_left: dict[tuple[int, int], int] = {}
        self.last_regular: dict[tuple[int, int], Estimate] = {}

    def random_word(self, fault_index: int, word_index: int, *key: int) -> int:
        """Return 64 random bits of a fault: a word of the SHAKE-128 hash of seed, fault and key.

        The key is tick, repetition, identifier, sender or node, copy number, purpose and 0. The purpose is 0
        for a node, 2 for a frame, and 3 for its receivers.
        """
        name = f"{self.faults[fault_index].name} {self.fault_numbers[fault_index]}".encode()
        hashed = self.seed.to_bytes(16, "little") + name + struct.pack("<IIIBBBB", *key)
        first_byte = 8 * word_index
        digest = hashlib.shake_128(hashed).digest(first_byte + 8)
        return int.from_bytes(digest[first_byte:], "little")

    def is_hit(self, fault_index: int, tick: int, sender: int, word: int) -> bool:
        """Return whether a fault is active for a sender, and the random word hits at its rate."""
        fault = self.faults[fault_index]
        has_ended = fault.stop is not None and tick >= fault.stop
        is_active = tick >= fault.start and not has_ended
        is_affected = fault.robots is None or sender in fault.robots
        return is_active and is_affected and word < Fraction(fault.rate) * 2**64

    def is_node_hit(self, fault_index: int, tick: int, node: int) -> bool:
        """Return whether a fault hits a node itself, not one of its frames, in a tick."""
        word = self.random_word(fault_index, 0, tick, 0, 0, node, 0, 0, 0)
        return self.is_hit(fault_index, tick, node, word)

    def begin_tick(self, tick: int) -> None:
        """Begin and end the outages of all nodes."""
        for index, fault in enumerate(self.faults):
            if not isinstance(fault, OutageFault):
                continue
            for node in range(ROBOTS):
                ticks_left = max(self.ticks_left.get((index, node), 0) - 1, 0)
                if ticks_left == 0 and self.is_node_hit(index, tick, node):
                    ticks_left = fault.ticks
                self.ticks_left[index, node] = ticks_left
                self.hit_counts[index] += ticks_left > 0

    def is_off(self, node: int, kind: type[OutageFault] = OutageFault) -> bool:
        """Return whether an outage of this kind, or of any, keeps a node off the bus."""
        return any(
            ticks_left > 0 and off_node == node and isinstance(self.faults[index], kind)
            for (index, off_node), ticks_left in self.ticks_left.items()
        )

    def extra_frames(self, node: int, tick: int, kind: type[Fault]) -> list[IdentifierAndData]:
        """Return the frames that a node sends besides its own because of faults of this kind."""
        all_frames = []
        for index, fault in enumerate(self.faults):
            if self.is_off(node) or not isinstance(fault, kind) or not self.is_node_hit(index, tick, node):
                continue
            if isinstance(fault, Babble):
                words = [self.random_word(index, 1, tick, k, 0, node, 0, 0, 0) for k in range(fault.frames)]
                frames = [(FORMAT.identifier(node), word.to_bytes(8, "little")) for word in words]
            else:
                assert isinstance(fault, Sybil) and fault.ids is not None
                data = estimate_data(fault.x, fault.alpha, tail_byte=0xE0 | tick)  # E0: a single frame
                frames = [(FORMAT.identifier(robot), data) for robot in range(128) if robot in fault.ids]
            all_frames += frames
            self.hit_counts[index] += len(frames)
        return all_frames

    def sent(self, frame: IdentifierAndData, node: int, tick: int, repetition: int) -> IdentifierAndData:
        """Return the frame that gets onto the bus instead of one that a node sends.

        ``repetition`` is the number of frames with this identifier that the node has sent in the tick before.
        """
        for index, fault in enumerate(self.faults):
            identifier, data = frame
            word = self.random_word(index, 0, tick, repetition, identifier, node, 0, 2, 0)
            is_hit = self.is_hit(index, tick, node, word)
            estimate = decode_estimate(can.Message(arbitration_id=identifier, data=data), FORMAT)
            if isinstance(fault, Collide) and is_hit:
                assert fault.id is not None
                frame = (identifier // 128 * 128 + fault.id, data)  # the lowest 7 bits are the sender
            elif isinstance(fault, Liar) and is_hit and isinstance(estimate, Estimate):
                frame = (identifier, estimate_data(fault.x, fault.alpha, tail_byte=data[7]))
            elif isinstance(fault, Freeze) and isinstance(estimate, Estimate):
                last_regular = self.last_regular.get((index, node))
                if is_hit and last_regular is not None:
                    repeated = replace(last_regular, sender=estimate.sender, transfer_id=estimate.transfer_id)
                    frame = identifier_and_data(encode_estimate(repeated, FORMAT))
                else:
                    self.last_regular[index, node], is_hit = estimate, False
            else:
                is_hit = False
            self.hit_counts[index] += is_hit
        return frame

    def copies_received(self, frame: IdentifierAndData, sent_frame: SentFrame, receiver: int) -> list[Copy]:
        """Return the copies of a sent frame that reach a receiver."""
        _, data = frame
        copies = [Copy(data)]
        for index, fault in enumerate(self.faults):
            if isinstance(fault, LinkFault):
                copies_after_fault: list[Copy] = []
                for copy in copies:
                    copies_after_fault += self.after_link_fault(index, copy, sent_frame, receiver)
                copies = copies_after_fault
        return copies

    def after_link_fault(self, index: int, copy: Copy, sent_frame: SentFrame, receiver: int) -> list[Copy]:
        """Return what a fault makes of one copy: none, one or two copies."""
        fault = self.faults[index]
        assert isinstance(fault, LinkFault)
        frame_key = (sent_frame.tick, sent_frame.repetition, sent_frame.frame.arbitration_id)
        key = (*frame_key, sent_frame.sender, copy.copy_number % 256, 3, 0)
        word_count = 1 + (fault.bits if isinstance(fault, Corrupt) else 0)
        words = [self.random_word(index, receiver * word_count + k, *key) for k in range(word_count)]
        is_for_receiver = fault.receivers is None or receiver in fault.receivers
        if not is_for_receiver or not self.is_hit(index, sent_frame.tick, sent_frame.sender, words[0]):
            return [replace(copy, path=(*copy.path, 0))]
        self.hit_counts[index] += 1
        hit = replace(copy, path=(*copy.path, 1))
        if isinstance(fault, Loss):
            return []
        if isinstance(fault, Delay):
            return [replace(hit, delay=copy.delay + fault.ticks)]
        if isinstance(fault, Corrupt):
            return [replace(hit, data=with_bits_flipped(copy.data, words[1:]))]
        assert isinstance(fault, Duplicate)
        copy_number = copy.copy_number | (1 << self.fault_numbers[index])
        return [hit, Copy(copy.data, (*copy.path, 2), copy.delay + fault.ticks, copy_number)]


def with_bits_flipped(data: bytes, words: list[int]) -> bytes:
    """Return the data with different bits flipped, one for each word, or all if there are fewer bits.

    This is Floyd's algorithm: the k-th last word chooses among all bits but the last k - 1; it takes the last
    of these if it chooses a bit that is flipped already.
    """
    bit_count = 8 * len(data)
    flipped_bits: set[int] = set()
    for turns_left, word in zip(range(len(words), 0, -1), words, strict=True):
        if bit_count < turns_left:
            continue
        last_bit = bit_count - turns_left
        bit = word % (last_bit + 1)
        flipped_bits.add(last_bit if bit in flipped_bits else bit)
    number = int.from_bytes(data, "little")
    for bit in flipped_bits:
        number ^= 1 << bit
    return number.to_bytes(len(data), "little")


FAULTS_OF_ALL_KINDS = (
    "loss=0.1",
    "delay=0.5",
    "duplicate=0.5,ticks=2",
    "corrupt=0.5,bits=3",
    "babble=0.5,frames=2",
    "crash=0.1",
    "freeze=0.5",
    "liar=0.3",
    "collide=0.2,id=3",
    "busoff=0.1,ticks=2",
    "sybil=0.2,ids=4-6",
)


@dataclass(frozen=True, order=True)
class Arrival:
    """A copy of a frame that the reference expects; in one tick a receiver gets copies in this order.

    Attributes:
        sending_tick: Tick in which the frame was sent, or left its latency behind.
        path: Path of the copy.
        frame_index: Index of the frame among those that began to travel in the same tick.
        tick: Tick of the arrival.
        receiver: Robot that gets the copy.
        frame: Identifier and data that arrive.
    """

    sending_tick: int
    path: tuple[int, ...]
    frame_index: int
    tick: int
    receiver: int
    frame: IdentifierAndData


def expected_arrivals(
    reference: Reference,
    tick: int,
    travelling: list[tuple[SentFrame, IdentifierAndData]],
    neighbours: NDArray[np.bool_],
) -> list[Arrival]:
    """Return where and when copies of frames arrive that set out in a tick."""
    arrivals = []
    for frame_index, (sent_frame, frame) in enumerate(travelling):
        for receiver in range(ROBOTS):
            if not neighbours[receiver, sent_frame.sender] or reference.is_off(receiver):
                continue
            identifier, _ = frame
            for copy in reference.copies_received(frame, sent_frame, receiver):
                received_frame = (identifier, copy.data)
                arrival_tick = tick + copy.delay
                arrivals.append(Arrival(tick, copy.path, frame_index, arrival_tick, receiver, received_frame))
    return arrivals


def random_neighbours(random: np.random.Generator) -> NDArray[np.bool_]:
    """Draw which robots receive from which, [receiver, sender]: four in five, and no robot from itself."""
    is_in_range = random.random((ROBOTS, ROBOTS)) < 0.8
    is_itself = np.eye(ROBOTS, dtype=np.bool_)
    return is_in_range & ~is_itself


@settings(max_examples=draws(250), derandomize=True, database=None, deadline=None)
@given(st.lists(any_fault(ROBOTS - 1, TICKS), max_size=6), st.integers(0, 2**128 - 1), st.booleans())
@example([parse_fault(text) for text in FAULTS_OF_ALL_KINDS], 7, False)
@example([parse_fault("duplicate=0.9,from=3,to=4,robots=0,receivers=1")] * 9, 7, False)
def test_faults_disturb_frames_as_a_plain_program_of_the_same_rules_does(
    all_faults: list[Fault], seed: int, has_latency: bool
) -> None:
    """The plain program, Reference, takes one frame, node and receiver at a time.

    In each tick, the frames that four robots send are compared, and what each robot receives, in order. In
    the end the numbers of hits and of frames delivered are.
    """
    texts_of_faults = [str(fault) for fault in all_faults]
    failing_case = f"{texts_of_faults}, seed {seed}, latency {has_latency}"  # shown if a comparison fails
    swarms = TwoDisturbedSwarms(all_faults, seed, has_latency)
    for _tick in range(TICKS):
        sent_frames, expected_sent_frames = swarms.send()
        assert sent_frames == expected_sent_frames, failing_case
        received_frames, expected_received_frames = swarms.receive()
        assert received_frames == expected_received_frames, failing_case

    assert swarms.hit_counts == swarms.reference.hit_counts, failing_case
    assert swarms.queue.delivered_count == swarms.expected_delivered_count, failing_case


def test_a_swarm_with_faults_of_all_kinds_shows_each_of_them() -> None:
    """So the comparison with the plain program reaches every kind: each fault hits at least once."""
    faults_of_all_kinds = [parse_fault(text) for text in FAULTS_OF_ALL_KINDS]
    swarms = TwoDisturbedSwarms(faults_of_all_kinds, seed=7, has_latency=False)
    for _tick in range(TICKS):
        swarms.send()
        swarms.receive()

    assert min(swarms.reference.hit_counts) > 0


class TwoDisturbedSwarms:
    """Four robots that send random estimates under faults, by the product and by the plain program.

    Attributes:
        faults: The faults of the product.
        queue: The frames on their way, by the product.
        reference: The faults of the plain program.
    """

    def __init__(self, all_faults: list[Fault], seed: int, has_latency: bool) -> None:
        self.faults = Faults(all_faults, seed, FORMAT)
        self.reference = Reference(all_faults, seed)
        self.queue = DeliveryQueue(lambda: self._neighbours, self.faults.on_delivery, int(has_latency))
        self._random = np.random.default_rng(seed % 2**32)
        self._has_latency = has_latency
        self._tick = -1
        self._neighbours = np.zeros((ROBOTS, ROBOTS), np.bool_)
        self._sent: list[SentFrame] = []
        self._travelling: list[tuple[SentFrame, IdentifierAndData]] = []
        self._frames_of_last_tick: list[tuple[SentFrame, IdentifierAndData]] = []
        self._arrivals: list[Arrival] = []

    def send(self) -> tuple[list[IdentifierAndData], list[IdentifierAndData]]:
        """Begin a tick, and return the frames that get onto the bus by both programs."""
        self._tick += 1
        self._neighbours[:] = random_neighbours(self._random)
        self.faults.begin_tick(self._tick, range(ROBOTS))
        self.reference.begin_tick(self._tick)
        self._sent, expected = frames_of_tick(self.faults, self.reference, self._tick, self._random)
        frames_of_this_tick = list(zip(self._sent, expected, strict=True))
        self._travelling = self._frames_of_last_tick if self._has_latency else frames_of_this_tick
        self._frames_of_last_tick = frames_of_this_tick
        return [identifier_and_data(sent_frame.frame) for sent_frame in self._sent], expected

    def receive(self) -> tuple[list[list[IdentifierAndData]], list[list[IdentifierAndData]]]:
        """Return the frames that each robot receives in the tick, in their order, by both programs."""
        self._arrivals += expected_arrivals(self.reference, self._tick, self._travelling, self._neighbours)
        arrivals_now = sorted(arrival for arrival in self._arrivals if arrival.tick == self._tick)
        deliveries = self.queue.deliver(self._tick, self._sent)
        received, expected = [], []
        for receiver in range(ROBOTS):
            received.append([identifier_and_data(frame) for frame in deliveries.frames_for(receiver)])
            expected.append([arrival.frame for arrival in arrivals_now if arrival.receiver == receiver])
        return received, expected

    @property
    def hit_counts(self) -> list[int]:
        """How often each fault has hit, by the product."""
        return [figure["injected"] for figure in self.faults.figures()]

    @property
    def expected_delivered_count(self) -> int:
        """How many copies have arrived by the plain program; some are still on their way."""
        return sum(arrival.tick < TICKS for arrival in self._arrivals)


def frames_of_tick(
    faults: Faults, reference: Reference, tick: int, random: np.random.Generator
) -> tuple[list[SentFrame], list[IdentifierAndData]]:
    """Return the frames of all nodes that get onto the bus in a tick, and those that the reference expects.

    Each node sends an estimate, a heartbeat, and what its faults add before and behind them.
    """
    sent: list[SentFrame] = []
    expected: list[IdentifierAndData] = []
    for node in range(ROBOTS):
        assert (faults.robot_outage(node) is not None) == reference.is_off(node, Crash)
        x_hat, alpha = int(random.integers(Q23_ONE)), int(random.integers(1, 1 << 24))
        estimate = encode_estimate(Estimate(node, x_hat, alpha, tick % 32), FORMAT)
        heartbeat = encode_heartbeat(Heartbeat(node, tick, tick % 32))
        frames_of_node = [
            *faults.extra_frames(node, tick / 10, before_others=True),
            estimate,
            heartbeat,
            *faults.extra_frames(node, tick / 10, before_others=False),
        ]
        for frame in frames_of_node:
            sent_frame = faults.on_send(frame, node)
            if sent_frame is not None:
                sent.append(sent_frame)
        expected += expected_on_bus(reference, node, tick, [estimate, heartbeat])
    assert all(sent_frame.tick == tick for sent_frame in sent)
    return sent, expected


def expected_on_bus(
    reference: Reference, node: int, tick: int, regular_frames: Sequence[can.Message]
) -> list[IdentifierAndData]:
    """Return what the reference makes of the frames of a node in a tick, with those that faults add."""
    frames = [
        *reference.extra_frames(node, tick, Sybil),
        *(identifier_and_data(frame) for frame in regular_frames),
        *reference.extra_frames(node, tick, Babble),
    ]
    if reference.is_off(node):
        return []
    repetitions: Counter[int] = Counter()
    frames_on_bus = []
    for frame in frames:
        identifier, _ = frame
        frames_on_bus.append(reference.sent(frame, node, tick, repetitions[identifier]))
        repetitions[identifier] += 1
    return frames_on_bus


# What a fault reports of a frame that it has changed


def send_under_fault(estimate: Estimate, fault: str) -> SentFrame | None:
    """Return the frame that a fault makes of an estimate; None if it is not sent."""
    faults = Faults([parse_fault(fault)], seed=1, frame_format=FORMAT)
    faults.begin_tick(0, range(ROBOTS))
    return faults.on_send(encode_estimate(estimate, FORMAT), sender=estimate.sender)


@pytest.mark.parametrize(
    ("fault", "is_falsified", "is_under_own_id"),
    [
        ("liar,x=0.5,alpha=0", True, True),
        ("liar,x=0,alpha=0", False, True),  # happens to be the truth
        ("collide,id=2", False, False),
    ],
)
def test_a_frame_with_another_estimate_or_the_id_of_another_robot_is_marked_as_such(
    fault: str, is_falsified: bool, is_under_own_id: bool
) -> None:
    """Robot 3 has an estimate of 0 with an alpha, the confidence, of 0. The fault may change it or its id."""
    sent_frame = send_under_fault(Estimate(sender=3, x_hat=0, alpha=0, transfer_id=0), fault)
    assert sent_frame is not None
    assert sent_frame.is_falsified == is_falsified
    assert sent_frame.is_under_own_id == is_under_own_id


def test_a_robot_whose_bus_is_off_sends_nothing() -> None:
    """None stands for a frame that has not got onto the bus."""
    estimate = Estimate(sender=3, x_hat=0, alpha=0, transfer_id=0)
    assert send_under_fault(estimate, "busoff,robots=3") is None


def test_a_robot_whose_bus_is_off_goes_on_observing() -> None:
    """Robot 3 is off the bus, but has no outage of its own, as it would have after a crash."""
    bus_off = BusOff(rate=1.0, robots=frozenset({3}))
    faults = Faults([bus_off], seed=1, frame_format=FORMAT)
    faults.begin_tick(tick=0, nodes=[3])
    assert faults.is_off_bus(node=3)
    assert faults.robot_outage(node=3) is None


# Bits


@pytest.mark.parametrize(("width", "count"), [(5, 1), (5, 2), (6, 3), (5, 4), (4, 4), (3, 5), (0, 2)])
def test_each_choice_of_bits_to_flip_is_equally_likely(width: int, count: int) -> None:
    """``choose_bits`` takes ``count`` random words. Their remainders choose ``count`` of ``width`` bits.

    With one case for each combination of remainders, each choice comes up equally often. A choice is a mask:
    a number with these bits. If there are fewer bits than words, all bits are chosen.
    """
    words_of_cases = words_with_all_remainders(width, count)
    number_of_cases = len(words_of_cases)
    chosen_masks = [choose_bits(width, words) for words in words_of_cases]

    number_of_chosen_bits = min(count, width)
    possible_masks = []
    for bits in itertools.combinations(range(width), number_of_chosen_bits):
        possible_masks.append(sum(1 << bit for bit in bits))
    times_of_each_mask = number_of_cases // len(possible_masks)
    assert Counter(chosen_masks) == dict.fromkeys(possible_masks, times_of_each_mask)


def words_with_all_remainders(width: int, count: int) -> list[tuple[int, ...]]:
    """Return rows of ``count`` words that have all combinations of remainders.

    The k-th last word counts modulo width - k + 1, the number of bits from which it chooses.
    """
    numbers_of_remainders = [max(width - turns_left + 1, 1) for turns_left in range(count, 0, -1)]
    return list(itertools.product(*(range(number) for number in numbers_of_remainders)))
