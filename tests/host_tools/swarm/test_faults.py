"""Faults are read from text, hit at their rate, and do to frames and robots what they say."""

from __future__ import annotations

import functools
import itertools
import math
import operator
from collections import Counter
from dataclasses import dataclass, field

import can
import numpy as np
import pytest

from mcp_asdf_tools.bus.alpha_words import float32_value
from mcp_asdf_tools.bus.frame_layout import Q23_ONE
from mcp_asdf_tools.bus.frames import (
    Estimate,
    FrameFormat,
    Heartbeat,
    alpha_float32_bits,
    decode_estimate,
    encode_estimate,
    encode_heartbeat,
    sender_of,
)
from mcp_asdf_tools.common.errors import UsageError
from mcp_asdf_tools.swarm.delivery import DeliveryQueue
from mcp_asdf_tools.swarm.fault_injection.fault import Fault, Outage
from mcp_asdf_tools.swarm.fault_injection.fault_run import choose_bits
from mcp_asdf_tools.swarm.fault_injection.faults import Faults
from mcp_asdf_tools.swarm.fault_injection.kinds import FAULT_KINDS, Corrupt, Delay, Loss
from mcp_asdf_tools.swarm.fault_injection.parsing import parse_fault

FORMAT = FrameFormat()


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


TEXTS_WITH_ALL_OPTIONS = (
    "loss=0.1,from=5,to=7,robots=0+7-8,receivers=1",
    "delay=0.1,receivers=1,ticks=3",
    "duplicate=0.1,receivers=1,ticks=3",
    "corrupt=0.1,receivers=1,bits=3",
    "babble=0.1,frames=3",
    "crash=0.1,ticks=3,rejoin=restored",
    "freeze=0.1",
    "liar=0.1,x=0.25,alpha=0.5",
    "collide=0.1,id=3",
    "sybil=0.1,x=0.25,alpha=0.5,ids=30-31",
    "busoff=0.1,ticks=3",
)


@pytest.mark.parametrize("text", TEXTS_WITH_ALL_OPTIONS)
def test_the_text_of_a_fault_is_the_text_that_it_was_read_from(text: str) -> None:
    """Reports and recordings have such texts, and a user can give them to another run."""
    assert str(parse_fault(text)) == text


def test_a_text_with_all_options_of_each_kind_of_fault_is_read() -> None:
    """So the test above has each kind. Options that have their default are not in the text of a fault."""
    assert [parse_fault(text).name for text in TEXTS_WITH_ALL_OPTIONS] == [kind.name for kind in FAULT_KINDS]
    assert str(parse_fault("delay=0.5,ticks=1")) == "delay=0.5"


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


# What is hit, and how often


ROBOTS = 4
EVERY_ROBOT_BUT_ITSELF = ~np.eye(ROBOTS, dtype=np.bool_)
PATHS = ROBOTS * (ROBOTS - 1)
"""Pairs of a sender and a receiver."""


def estimate_of(node: int, tick: int) -> can.Message:
    """Return the estimate that a robot broadcasts in a tick; its x_hat says which: 1000 * node + tick."""
    estimate = Estimate(sender=node, x_hat=1000 * node + tick, alpha=0, transfer_id=tick % 32)
    return encode_estimate(estimate, FORMAT)


def decoded(frame: can.Message) -> Estimate:
    """Return the estimate in a frame that has one."""
    estimate = decode_estimate(frame, FORMAT)
    assert isinstance(estimate, Estimate)
    return estimate


@dataclass
class DisturbedRun:
    """What faults make of the estimates of four robots, all of which hear each other.

    Attributes:
        faults: The faults, after the last tick.
        sent: By tick, the frames that get onto the bus.
        received: By tick and robot, the frames that the robot receives, in order.
    """

    faults: Faults
    sent: list[list[can.Message]] = field(default_factory=list)
    received: list[list[list[can.Message]]] = field(default_factory=list)

    @property
    def hit_counts(self) -> list[int]:
        """How often each fault has hit."""
        return [figures["injected"] for figures in self.faults.figures()]

    def estimates_received(self, tick: int, robot: int) -> list[int]:
        """Return the x_hat of each estimate that a robot receives in a tick, in order."""
        return [decoded(frame).x_hat for frame in self.received[tick][robot]]

    @property
    def copies_by_path(self) -> Counter[tuple[int, int]]:
        """How many copies of each estimate each robot has received, by the x_hat and the robot."""
        return Counter(
            (decoded(frame).x_hat, robot)
            for frames_by_robot in self.received
            for robot, frames in enumerate(frames_by_robot)
            for frame in frames
        )


def run_under(*fault_texts: str, ticks: int = 1, seed: int = 7) -> DisturbedRun:
    """Let each of four robots broadcast an estimate in each tick under these faults."""
    faults = Faults([parse_fault(text) for text in fault_texts], seed, FORMAT)
    queue = DeliveryQueue(lambda: EVERY_ROBOT_BUT_ITSELF, faults.on_delivery, latency=0)
    run = DisturbedRun(faults)
    for tick in range(ticks):
        faults.begin_tick(tick, range(ROBOTS))
        estimates = [(node, estimate_of(node, tick)) for node in range(ROBOTS)]
        frames = extra_frames(faults, tick, True) + estimates + extra_frames(faults, tick, False)
        all_sent = [faults.on_send(frame, node) for node, frame in frames]
        sent_frames = [sent_frame for sent_frame in all_sent if sent_frame is not None]
        deliveries = queue.deliver(tick, sent_frames)
        run.sent.append([sent_frame.frame for sent_frame in sent_frames])
        frames_by_robot = []
        for robot in range(ROBOTS):
            frames_by_robot.append([sent_frame.frame for sent_frame in deliveries.frames_for(robot)])
        run.received.append(frames_by_robot)
    return run


def extra_frames(faults: Faults, tick: int, before_others: bool) -> list[tuple[int, can.Message]]:
    """Return the frames that nodes send in a tick in addition to their estimates, as pairs of node and frame.

    With ``before_others`` these are the frames that come before the estimates, and otherwise those that come
    after them. A second has ten ticks.
    """
    frames = []
    for node in range(ROBOTS):
        for frame in faults.extra_frames(node, tick / 10, before_others=before_others):
            frames.append((node, frame))
    return frames


@pytest.mark.parametrize(
    ("fault", "occasions"),
    [
        ("loss=0.3", PATHS),
        ("liar=0.3", ROBOTS),
        ("busoff=0.3", ROBOTS),
        ("babble=0.3,frames=1", ROBOTS),
    ],
)
def test_a_fault_hits_at_its_rate(fault: str, occasions: int) -> None:
    """The rate is the probability per frame and receiver, per frame, or per robot and tick.

    Of n occasions in 500 ticks 0.3 n are hit, up to five standard deviations.
    """
    n = 500 * occasions
    [hit_count] = run_under(fault, ticks=500).hit_counts
    assert abs(hit_count - 0.3 * n) < 5 * math.sqrt(0.3 * 0.7 * n)


def test_a_fault_with_a_larger_rate_hits_wherever_one_with_a_smaller_rate_does() -> None:
    """So runs with different rates can be compared. A fault of rate 0.6 leaves fewer frames than of 0.3."""
    left_at_60_percent = run_under("loss=0.6", ticks=20).copies_by_path.keys()
    left_at_30_percent = run_under("loss=0.3", ticks=20).copies_by_path.keys()
    assert left_at_60_percent < left_at_30_percent


def test_losses_of_a_seed_are_the_same_in_every_version_of_the_program() -> None:
    """A user repeats a run by its seed. The frames that are left of two ticks have these x_hat."""
    lossy_run = run_under("loss=0.5", ticks=2)
    left_by_tick_and_robot = [
        [lossy_run.estimates_received(tick, robot) for robot in range(ROBOTS)] for tick in range(2)
    ]
    assert left_by_tick_and_robot == [
        [[2000, 3000], [0], [1000], [1000]],
        [[1001, 3001], [2001], [1, 3001], [1]],
    ]


def test_liars_and_outages_of_a_seed_are_the_same_in_every_version_of_the_program() -> None:
    """In three ticks robots lie, or are off the bus, with a rate of one half each."""
    frames_of_liars = run_under("liar=0.5,x=1", ticks=3).sent
    liars = [
        [node for node in range(ROBOTS) if decoded(frames[node]).x_hat == Q23_ONE]
        for frames in frames_of_liars
    ]
    assert liars == [[2], [0], [0, 3]]

    frames_on_bus = run_under("busoff=0.5", ticks=3).sent
    assert [[decoded(frame).sender for frame in frames] for frames in frames_on_bus] == [[3], [0, 3], [2, 3]]


@pytest.mark.parametrize(
    "faults",
    [
        ("loss=0.5", "loss=0.5"),  # two of one kind
        ("loss=0.5", "delay=0.5,ticks=100"),  # of two kinds
    ],
)
def test_two_faults_hit_independently_of_each_other(faults: tuple[str, str]) -> None:
    """A quarter of the frames is left. If both hit the same frames, a half of them would be left.

    A frame that is 100 ticks late does not arrive in this run, as if it were lost.
    """
    run = run_under(*faults, ticks=100)
    share_left = run.copies_by_path.total() / (100 * PATHS)
    assert 0.2 < share_left < 0.3


def test_another_seed_hits_other_frames() -> None:
    run, other_run = run_under("loss=0.5", ticks=20), run_under("loss=0.5", ticks=20, seed=8)
    assert run.copies_by_path != other_run.copies_by_path


def test_every_frame_is_hit_by_itself_for_each_receiver() -> None:
    """In 100 ticks a frame of robot 0 reaches each subset of its three neighbours.

    It would not if all receivers, or all ticks, were hit alike. Nor are the frames of two robots hit alike.
    """
    copies = run_under("loss=0.5", ticks=100).copies_by_path
    paths_left = copies.keys()
    subsets = {tuple((tick, robot) in paths_left for robot in (1, 2, 3)) for tick in range(100)}
    assert len(subsets) == 2**3
    frames_of_0_for_2 = [(tick, 2) in paths_left for tick in range(100)]
    frames_of_1_for_2 = [(1000 + tick, 2) in paths_left for tick in range(100)]
    assert frames_of_0_for_2 != frames_of_1_for_2


def test_equal_frames_of_a_robot_in_a_tick_are_hit_one_by_one() -> None:
    """Robot 3 sends 20 times under one identifier in a tick. Of these a fault hits some, but not all."""
    run = run_under("sybil,robots=3,ids=0", *["sybil,robots=3,ids=0"] * 19, "collide=0.5,robots=3,id=1")
    senders = [decoded(frame).sender for frame in run.sent[0][:20]]
    assert 4 < senders.count(1) < 16


@pytest.mark.parametrize(("duplicates", "ticks"), [(1, 100), (3, 100), (10, 2)])
def test_each_copy_of_a_frame_is_hit_by_itself(duplicates: int, ticks: int) -> None:
    """Each fault doubles the copies of a frame. Half of all copies are lost; some frames lose only a part."""
    faults = ["duplicate,ticks=0,robots=0,receivers=1"] * duplicates
    copies = run_under(*faults, "loss=0.5", ticks=ticks).copies_by_path
    numbers_left = [copies[tick, 1] for tick in range(ticks)]  # of the frames of robot 0, for robot 1
    assert 0.4 < sum(numbers_left) / (ticks * 2**duplicates) < 0.6
    assert any(0 < number < 2**duplicates for number in numbers_left)


def test_copies_that_two_faults_have_made_are_hit_one_by_one() -> None:
    """Without losses robot 1 gets each frame four times, 0 to 3 ticks late.

    Half of these copies are lost. For each set of the four there is a frame of which that set arrives.
    """
    duplicates = [f"duplicate,ticks={ticks},robots=0,receivers=1" for ticks in (1, 2)]
    run = run_under(*duplicates, "loss=0.5", ticks=200)
    numbers_by_tick = [run.estimates_received(tick, robot=1) for tick in range(200)]
    subsets = {tuple(number in numbers_by_tick[number + late] for late in range(4)) for number in range(196)}
    assert len(subsets) == 2**4


def test_a_fault_acts_on_its_senders_and_receivers_between_its_ticks_only() -> None:
    """In ticks 1 and 2 the frames of robot 0 do not reach robot 1. All others arrive."""
    run = run_under("loss,robots=0,receivers=1,from=1,to=3", ticks=4)
    all_copies = run_under(ticks=4).copies_by_path
    assert all_copies - run.copies_by_path == {(1, 1): 1, (2, 1): 1}  # x_hat is the tick for robot 0


# What a hit does


def test_late_frames_come_before_those_of_the_tick_in_which_they_arrive() -> None:
    """The frames of robot 0 are two ticks late; they have the x_hat 0 in tick 0, and so on."""
    run = run_under("delay,ticks=2,robots=0", ticks=4)
    assert [run.estimates_received(tick, 1) for tick in range(4)] == [
        [2000, 3000],
        [2001, 3001],
        [0, 2002, 3002],
        [1, 2003, 3003],
    ]


def test_frames_that_are_hit_come_behind_the_spared_ones_and_copies_behind_them() -> None:
    """The frame of robot 2 comes twice in its tick. To the robust filter the order matters."""
    run = run_under("duplicate,ticks=0,robots=2")
    assert run.estimates_received(tick=0, robot=1) == [0, 3000, 2000, 2000]


def test_copies_come_by_their_number_of_ticks_later() -> None:
    run = run_under("duplicate,ticks=1,robots=0", ticks=2)
    assert [run.estimates_received(tick, 1) for tick in range(2)] == [[2000, 3000, 0], [0, 2001, 3001, 1]]


def test_delays_of_several_faults_add_up() -> None:
    """A frame of robot 0 is late by two ticks, and its copy by three."""
    run = run_under("delay,robots=0", "duplicate,robots=0", "delay,robots=0", ticks=4)
    assert [run.estimates_received(tick, 1) for tick in range(4)] == [
        [2000, 3000],
        [2001, 3001],
        [0, 2002, 3002],
        [0, 1, 2003, 3003],
    ]


def flipped_bits(frame: can.Message, sent_frame: can.Message) -> int:
    """Return the bits in which the data of two frames differ, as a mask."""
    return int.from_bytes(frame.data, "little") ^ int.from_bytes(sent_frame.data, "little")


def test_flipped_bits_and_random_data_of_a_seed_are_the_same_in_every_version_of_the_program() -> None:
    """A fault corrupts the frames of robot 0 for robot 1 in three of eight ticks; then robot 3 babbles."""
    run = run_under("corrupt=0.5,bits=2,robots=0", ticks=8)
    masks = [
        flipped_bits(frame, estimate_of(0, tick))
        for tick, frames_by_robot in enumerate(run.received)
        for frame in frames_by_robot[1]
        if sender_of(frame) == 0
    ]
    assert masks == [0, 0, 0, 0, 0, 0x84000000, 0x44000000, 0x1000200000]

    babble = run_under("babble,robots=3,frames=2").sent[0][ROBOTS:]
    assert [frame.data.hex() for frame in babble] == ["4b7b79c8633e28b1", "703afc5a25666e89"]


@pytest.mark.parametrize("bits", [1, 3, 64])
def test_corruption_flips_as_many_bits_as_it_says_and_others_for_each_receiver(bits: int) -> None:
    """In 600 ticks each of the 64 bits of a frame's data is flipped for robot 1 at least once."""
    run = run_under(f"corrupt,bits={bits},robots=0", ticks=600)
    masks: dict[int, list[int]] = {1: [], 2: []}  # by receiver
    for tick, frames_by_robot in enumerate(run.received):
        for robot, masks_of_robot in masks.items():
            *_, frame_of_robot_0 = frames_by_robot[robot]  # behind the spared ones
            masks_of_robot.append(flipped_bits(frame_of_robot_0, estimate_of(0, tick)))
    assert {mask.bit_count() for mask in masks[1] + masks[2]} == {bits}
    assert functools.reduce(operator.or_, masks[1]) == 2**64 - 1
    if bits < 64:
        assert masks[1] != masks[2]


def test_all_bits_of_a_frame_that_has_fewer_are_flipped() -> None:
    faults = Faults([parse_fault("corrupt,bits=64")], 7, FORMAT)
    faults.begin_tick(0, [0])
    sent_frame = faults.on_send(can.Message(arbitration_id=5, data=b"\x0f"), sender=0)
    assert sent_frame is not None
    [hit] = faults.on_delivery([sent_frame], np.array([[False, True]]))
    assert hit.sent_frames[0].frame.data == b"\xf0"


def test_a_bit_that_two_faults_flip_is_as_it_was() -> None:
    """Each of them flips all 64 bits."""
    run = run_under("corrupt,bits=64", "corrupt,bits=64")
    assert run.estimates_received(tick=0, robot=1) == [0, 2000, 3000]


@pytest.mark.parametrize("kind", ["crash", "busoff"])
def test_an_outage_lasts_for_its_ticks_in_which_it_cannot_begin_anew(kind: str) -> None:
    """Robot 1 is hit in ticks 1 and 2, and an outage lasts for two ticks: it is on again in tick 3.

    A robot that is off neither sends nor receives. Each of its ticks counts as a hit.
    """
    run = run_under(f"{kind},ticks=2,from=1,to=3,robots=1", ticks=4)
    is_on = [True, False, False, True]
    assert [any(decoded(frame).sender == 1 for frame in frames) for frames in run.sent] == is_on
    assert [len(frames_by_robot[1]) > 0 for frames_by_robot in run.received] == is_on
    assert run.hit_counts == [2]


def test_a_robot_that_is_off_the_bus_adds_no_frames() -> None:
    """The figures count the crash of robot 2, and none of the random frames that it would send."""
    assert run_under("crash,robots=2", "babble,robots=2").hit_counts == [1, 0]


def test_only_a_crash_stops_the_robot_of_a_node_that_is_off_the_bus() -> None:
    """``robot_outage`` is None for robot 3, which is cut off from the bus, as for robot 0, which is not."""
    faults = run_under("busoff,robots=3", "crash,robots=2,rejoin=restored").faults
    assert [faults.is_off_bus(node) for node in range(ROBOTS)] == [False, False, True, True]
    assert [faults.robot_outage(node) for node in range(ROBOTS)] == [
        None,
        None,
        Outage(stops_robot=True, loses_state=False),
        None,
    ]


def test_a_frozen_robot_repeats_its_last_regular_estimate_with_new_numbers() -> None:
    """Robot 0 is frozen in ticks 2 and 3. Its x_hat is 0 in tick 0, 1 in tick 1, and so on."""
    run = run_under("freeze,robots=0,from=2,to=4", ticks=5)
    estimates = [decoded(frames[0]) for frames in run.sent]
    assert [estimate.x_hat for estimate in estimates] == [0, 1, 1, 1, 4]
    assert [estimate.transfer_id for estimate in estimates] == [0, 1, 2, 3, 4]
    assert run.hit_counts == [2]


def test_each_robot_that_is_frozen_from_the_start_repeats_its_first_estimate() -> None:
    run = run_under("freeze", ticks=3)
    x_hat_by_tick = [[decoded(frame).x_hat for frame in frames] for frames in run.sent]
    assert x_hat_by_tick == [[0, 1000, 2000, 3000]] * 3
    assert run.hit_counts == [2 * ROBOTS], "the first ones are no repetitions"


def test_a_liar_claims_what_it_is_told_to_under_the_id_that_its_frame_has() -> None:
    """Robot 0, which sends as robot 3, claims that half of the floor is black, with an alpha of 1e6."""
    run = run_under("collide,robots=0,id=3", "liar,robots=0,x=0.5,alpha=1e6")
    frame_of_robot_0 = run.sent[0][0]
    estimate = decoded(frame_of_robot_0)
    assert (estimate.sender, estimate.x_hat, estimate.transfer_id) == (3, Q23_ONE // 2, 0)
    assert float32_value(alpha_float32_bits(frame_of_robot_0)) == 1e6


def test_faults_act_in_the_order_in_which_they_are_given() -> None:
    """In tick 1 robot 0 is frozen at the 0 of tick 0, and lies that all is black: the last fault decides."""
    frozen, liar = "freeze,robots=0,from=1", "liar,robots=0,from=1,x=1"
    last_frames = [run_under(*faults, ticks=2).sent[1][0] for faults in ((frozen, liar), (liar, frozen))]
    assert [decoded(frame).x_hat for frame in last_frames] == [Q23_ONE, 0]


@pytest.mark.parametrize("fault", ["freeze", "liar"])
def test_a_heartbeat_is_neither_frozen_nor_falsified(fault: str) -> None:
    faults = Faults([parse_fault(fault)], 7, FORMAT)
    heartbeat = encode_heartbeat(Heartbeat(sender=0, uptime=0, transfer_id=0))
    for tick in range(2):
        faults.begin_tick(tick, [0])
        sent_frame = faults.on_send(heartbeat, sender=0)
        assert sent_frame is not None
        assert sent_frame.frame is heartbeat
    assert faults.figures()[0]["injected"] == 0


def test_made_up_ids_send_false_estimates_before_all_others() -> None:
    """Robot 2 sends as robots 9 and 100, too, in tick 33; transfer_ids count modulo 32."""
    run = run_under("sybil,robots=2,ids=100+9,x=1,alpha=0,from=33", ticks=34)
    estimates = [decoded(frame) for frame in run.sent[33]]
    assert [estimate.sender for estimate in estimates] == [9, 100, 0, 1, 2, 3]
    assert estimates[0] == Estimate(sender=9, x_hat=Q23_ONE, alpha=0, transfer_id=33 % 32)
    assert run.hit_counts == [2]


def test_a_babbling_robot_sends_random_data_under_its_identifier_behind_all_others() -> None:
    """Robot 2 sends three frames of 8 bytes in each of two ticks, all of which differ."""
    run = run_under("babble,robots=2,frames=3", ticks=2)
    babble = [frame for frames in run.sent for frame in frames[ROBOTS:]]
    assert {frame.arbitration_id for frame in babble} == {FORMAT.identifier(2)}
    assert len({bytes(frame.data) for frame in babble}) == 3 * 2
    assert {len(frame.data) for frame in babble} == {8}
    assert run.hit_counts == [3 * 2]


# What a fault reports of a frame that it has changed


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
    faults = Faults([parse_fault(fault)], seed=1, frame_format=FORMAT)
    faults.begin_tick(0, range(ROBOTS))
    estimate = Estimate(sender=3, x_hat=0, alpha=0, transfer_id=0)
    sent_frame = faults.on_send(encode_estimate(estimate, FORMAT), sender=3)
    assert sent_frame is not None
    assert sent_frame.is_falsified == is_falsified
    assert sent_frame.is_under_own_id == is_under_own_id


# Bits


@pytest.mark.parametrize(("width", "count"), [(5, 1), (5, 2), (6, 3), (4, 4), (3, 5)])
def test_each_choice_of_bits_to_flip_is_equally_likely(width: int, count: int) -> None:
    """``choose_bits`` takes ``count`` random words. Their remainders choose ``count`` of ``width`` bits.

    With one case for each combination of remainders, each choice comes up equally often. A choice is a mask:
    a number with these bits. If there are fewer bits than words, all bits are chosen.
    """
    # The k-th last word counts modulo width - k + 1, the number of bits from which it chooses.
    numbers_of_remainders = [max(width - turns_left + 1, 1) for turns_left in range(count, 0, -1)]
    cases = list(itertools.product(*(range(number) for number in numbers_of_remainders)))
    chosen_masks = Counter(choose_bits(width, words) for words in cases)

    possible_masks = [mask for mask in range(2**width) if mask.bit_count() == min(count, width)]
    assert chosen_masks == dict.fromkeys(possible_masks, len(cases) // len(possible_masks))
