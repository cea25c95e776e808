"""The robust filter in mirror, C and float64: what it keeps, how it votes, and when it re-estimates b_hat.

docs/design.md, section 13, specifies it. Slot i keeps the estimate of the senders whose id is i modulo 32.
"""

from __future__ import annotations

import struct
from dataclasses import replace
from typing import Any

import pytest

from mcp_asdf.mirror import MirrorRobot
from mcp_asdf.reference import ReferenceRobot
from mcp_asdf.robot import Config, Counters, Filter, FirmwareError, Robot, Status
from mcp_asdf.robust_filter import RobustFilter, centre_after_huber_step, is_supported
from robots import (
    ALPHA_MIN,
    ALPHA_ONE,
    HALF,
    ONE,
    OWN_ID,
    ROBUST,
    Firmware,
    FixedPoint,
    FixedPointFirmware,
    for_every_firmware,
    for_fixed_point_firmwares,
    make_robot,
    observe_tiles,
    receive_estimates,
    restore_robust_robot,
)


def make_robust_robot(
    firmware: FixedPointFirmware, b_hat: float, filter_period: int, memory: int = 2**31
) -> FixedPoint:
    """Make a robot that runs the robust filter every ``filter_period`` rounds."""
    return firmware(Config(None, Filter.ROBUST, filter_period, memory), OWN_ID, b_hat)


def filter_memory(robot: FixedPoint) -> dict[str, int]:
    """Return what the robust filter of a robot remembers, by name, without the estimates in its slots."""
    return {
        name.removeprefix("robust_"): value
        for name, value in robot.state().items()
        if name.startswith("robust_")
    }


def filled_slots(robot: FixedPoint) -> dict[int, int]:
    """Return the neighbours' estimates that a robot remembers, in units of 2**-16, by slot."""
    state = robot.state()
    slots = [slot for slot in range(32) if state["robust_filled_slots"] >> slot & 1]
    return {slot: state[f"estimates_{slot}"] for slot in slots}


# --- Estimates -------------------------------------------------------------------------------------------


@for_fixed_point_firmwares
@pytest.mark.parametrize(("sender", "slot"), [(0, 0), (31, 31), (32, 0), (37, 5), (127, 31)])
def test_an_estimate_is_kept_in_the_slot_of_its_sender_modulo_32(
    firmware: FixedPointFirmware, sender: int, slot: int
) -> None:
    """A robot with the robust filter has 32 slots for the latest estimates of its neighbours, and these ids.

    It keeps an estimate in units of 2**-16.
    """
    robot = make_robust_robot(firmware, b_hat=0.95, filter_period=1)

    robot.receive(sender, x_hat=0.25, alpha=1.0)

    assert filled_slots(robot) == {slot: round(0.25 * 2**16)}


# design: R35
@for_fixed_point_firmwares
@pytest.mark.parametrize(
    "sender", [1, 1 + 32], ids=["the same sender", "a sender with an id equal modulo 32"]
)
def test_a_slot_keeps_the_estimate_that_was_received_last(firmware: FixedPointFirmware, sender: int) -> None:
    """A robot has kept an estimate of neighbour 1 in slot 1, in units of 2**-16, and receives another one."""
    robot = make_robust_robot(firmware, b_hat=0.95, filter_period=1)
    robot.receive(sender=1, x_hat=0.25, alpha=1.0)
    robot.settle()  # ends the round: after it a sender may be received again

    robot.receive(sender, x_hat=0.5, alpha=1.0)

    assert filled_slots(robot) == {1: round(0.5 * 2**16)}


@for_fixed_point_firmwares
def test_a_robot_remembers_its_neighbours_while_it_hears_nobody(firmware: FixedPointFirmware) -> None:
    """It keeps the latest estimate of neighbour 1 in slot 1, in units of 2**-16."""
    robot = make_robust_robot(firmware, b_hat=0.95, filter_period=1)
    robot.receive(sender=1, x_hat=0.25, alpha=1.0)
    robot.settle()  # ends the round of the message

    robot.settle()  # ends a round without messages

    assert filled_slots(robot) == {1: round(0.25 * 2**16)}


@for_fixed_point_firmwares
@pytest.mark.parametrize(
    ("x_hat", "slot_estimate"),
    [(63, 0), (64, 1), (HALF - 65, 32767), (HALF, 32768), (ONE - 65, 65535), (ONE - 64, 65535), (ONE, 65535)],
)
def test_an_estimate_is_rounded_to_the_nearest_that_a_slot_can_hold(
    firmware: FixedPointFirmware, x_hat: int, slot_estimate: int
) -> None:
    """The estimate x_hat has units of 2**-23. A slot has units of 2**-16, 128 times as large, up to 65535."""
    robot = make_robust_robot(firmware, b_hat=0.95, filter_period=1)
    robot.receive_raw(sender=1, x_hat=x_hat, alpha=ALPHA_ONE)
    assert filled_slots(robot) == {1: slot_estimate}


@for_fixed_point_firmwares
@pytest.mark.parametrize("alpha_word", [0, 0x1F, 0xFF])
def test_a_neighbour_without_confidence_is_accepted_but_not_remembered(
    firmware: FixedPointFirmware, alpha_word: int
) -> None:
    """A confidence is a word: a mantissa above 8 bits of a shift. With a mantissa of 0, as here, it is 0.

    The robot counts the message as accepted, but does not keep its estimate.
    """
    robot = make_robust_robot(firmware, b_hat=0.95, filter_period=1)

    robot.receive_raw(sender=1, x_hat=HALF, alpha=alpha_word)

    assert filled_slots(robot) == {}
    assert robot.counters == Counters(accepted=1)


# --- Votes -----------------------------------------------------------------------------------------------


# design: R36
@for_every_firmware
def test_before_the_first_vote_a_robot_believes_its_own_estimate(firmware: Firmware) -> None:
    """Votes are counted when a round ends: a neighbour whose message has just come has not voted."""
    robot = make_robot(firmware, ROBUST, b_hat=0.95)
    observe_tiles(robot, black=9, white=1)

    receive_estimates(robot, 0.25)

    assert robot.x == robot.x_hat
    assert robot.x_bar == 0.5, "what others estimate is unknown"


# design: R36
@for_fixed_point_firmwares
def test_x_and_x_bar_are_the_centre_of_the_votes(firmware: FixedPointFirmware) -> None:
    """The robot believes x, and takes x_bar for what its neighbours estimate: both are the votes' centre.

    The centre, here 3/4 and 127 units more, has units of 2**-30. x and x_bar have units of 2**-23, which are
    128 times as large, and are rounded down.
    """
    centre = 3 * 2**28 + 127
    robot = restore_robust_robot(firmware, estimates=[0], votes=1, centre=centre)

    three_quarters = 3 * 2**21
    assert robot.x_raw == three_quarters
    assert robot.x_bar_raw == three_quarters


@for_fixed_point_firmwares
def test_a_round_has_one_vote_however_many_neighbours_were_received(firmware: FixedPointFirmware) -> None:
    """The next neighbour votes in the next round. So a call takes the same time in any swarm."""
    robot = make_robust_robot(firmware, b_hat=0.95, filter_period=1)
    receive_estimates(robot, 0.25, 0.5, 0.75)

    robot.settle()  # ends the round

    vote_count = filter_memory(robot)["votes"]
    assert vote_count == 1


def turn_of(robot: Robot) -> int:
    """Return the slot of the next vote, which is 0 after the robot's own vote."""
    if isinstance(robot, ReferenceRobot):
        return robot._robust.turn
    assert isinstance(robot, FixedPoint)
    return filter_memory(robot)["turn"]


def voters_of_rounds(robot: Robot, rounds: int) -> list[int | str]:
    """Let so many rounds end, and return the voter of every round: the number of a slot, or "own estimate".

    After the vote of slot i it is the turn of slot i + 1, and after the robot's own vote that of slot 0.
    """
    voters: list[int | str] = []
    for _ in range(rounds):
        robot.settle()
        turn = turn_of(robot)
        voters.append("own estimate" if turn == 0 else turn - 1)
    return voters


@for_every_firmware
@pytest.mark.parametrize(
    ("senders", "black_tiles", "expected_voters"),
    [
        pytest.param([9, 6], 1, [6, 9, "own estimate", 6, 9], id="in ascending order"),
        pytest.param([31], 1, [31, "own estimate", 31, "own estimate"], id="after the last of 32 slots"),
        pytest.param([6, 31], 0, [6, 31, 6, 31], id="a robot that has observed nothing does not vote"),
    ],
)
def test_neighbours_vote_in_ascending_order_and_the_robot_itself_after_them(
    firmware: Firmware, senders: list[int], black_tiles: int, expected_voters: list[int | str]
) -> None:
    """Each round has one vote. Neighbours are named by their slots, here 6, 9 and 31 as their ids.

    The robot itself votes only if it has observed a tile.
    """
    robot = make_robot(firmware, replace(ROBUST, filter_period=1000), b_hat=0.95)
    observe_tiles(robot, black_tiles, white=0)
    for sender in senders:
        robot.receive(sender, x_hat=0.5, alpha=1.0)

    voters = voters_of_rounds(robot, rounds=len(expected_voters))

    assert voters == expected_voters


@for_fixed_point_firmwares
@pytest.mark.parametrize(("alpha", "expected_voter"), [(0, 0), (ALPHA_MIN, "own estimate")])
def test_the_smallest_confidence_is_enough_for_a_robot_to_vote(
    firmware: FixedPointFirmware, alpha: int, expected_voter: int | str
) -> None:
    """Slot 0 has voted, so it is the robot's own turn; without confidence slot 0 votes again.

    The confidence alpha is 0 or the smallest. No observation leads to the smallest, so it is written into a
    saved robot, which is restored only if its b_hat was just updated.
    """
    mirror = restore_robust_robot(MirrorRobot, t=1, estimates=[0], turn=1, votes=1)
    assert isinstance(mirror, MirrorRobot)
    mirror.s.alpha = alpha
    mirror.s.updated = 1  # b_hat was just updated
    robot = firmware.restore(ROBUST, mirror.save())

    [voter] = voters_of_rounds(robot, rounds=1)

    assert voter == expected_voter


@for_fixed_point_firmwares
def test_a_new_neighbour_votes_as_soon_as_its_slot_is_reached(firmware: FixedPointFirmware) -> None:
    """It need not wait until all that were there before it have voted. Slots here are the neighbours' ids."""
    robot = make_robust_robot(firmware, b_hat=0.95, filter_period=1000)
    robot.receive(sender=6, x_hat=0.5, alpha=1.0)
    robot.receive(sender=9, x_hat=0.5, alpha=1.0)
    robot.settle()  # slot 6 votes

    robot.receive(sender=7, x_hat=0.5, alpha=1.0)

    assert voters_of_rounds(robot, rounds=3) == [7, 9, 6]


@for_every_firmware
def test_a_robot_s_own_vote_moves_what_it_believes_towards_what_it_has_seen(
    firmware: Firmware,
) -> None:
    """It has seen black alone, and its neighbour says that half is black, as the robot believes at first.

    A vote far away moves what it believes by an eighth of the spread of the votes. That is 1/4 at first, and
    shrinks by a sixteenth with the neighbour's vote, which is where the robot expects it.
    """
    robot = make_robot(firmware, replace(ROBUST, filter_period=1000), b_hat=0.95)
    observe_tiles(robot, black=9, white=0)
    receive_estimates(robot, 0.5)
    robot.settle()  # the neighbour votes
    assert robot.x == 0.5

    robot.settle()  # the robot votes

    spread = 1 / 4 * (1 - 1 / 16)
    assert robot.x == 0.5 + spread / 8


@for_every_firmware
@pytest.mark.parametrize(
    ("vote", "counted_distance"),
    [(1.0, 1 / 4), (0.75, 1 / 4), (0.625, 1 / 8), (0.5, 0.0), (0.375, -1 / 8), (0.0, -1 / 4)],
)
def test_a_vote_far_away_moves_what_the_robot_believes_no_further_than_one_at_a_limit(
    firmware: Firmware, vote: float, counted_distance: float
) -> None:
    """A vote moves x, what the robot believes and 1/2 at first, by an eighth of the vote's distance from it.

    A longer distance than the limit, the spread, which is 1/4 at first, counts as 1/4. So the greatest lie, 0
    or 1, moves a robot no more than an error of a quarter.
    """
    robot = make_robot(firmware, ROBUST, b_hat=0.95)
    receive_estimates(robot, vote)

    robot.settle()  # the neighbour votes

    assert robot.x == 1 / 2 + counted_distance / 8


@for_fixed_point_firmwares
@pytest.mark.parametrize(
    ("earlier_votes", "gain"),
    [
        (0, 1 / 8),
        (62, 1 / 8),
        (63, 1 / 16),
        (126, 1 / 16),
        (127, 1 / 32),
        (255, 1 / 64),
        (510, 1 / 64),
        (511, 1 / 128),
        (512, 1 / 128),
    ],
)
def test_the_more_votes_there_were_the_less_one_more_counts(
    firmware: FixedPointFirmware, earlier_votes: int, gain: float
) -> None:
    """A vote moves the centre of the votes by the spread times the gain, which falls from 1/8 to 1/128.

    Here a neighbour votes 0, which is far below the centre. Centre and spread are in units of 2**-30.
    """
    centre, spread = 2**30 // 2, 2**30 // 4
    robot = restore_robust_robot(firmware, estimates=[0], votes=earlier_votes, centre=centre, spread=spread)

    robot.settle()  # the neighbour votes

    assert filter_memory(robot)["centre"] == centre - spread * gain


@for_fixed_point_firmwares
@pytest.mark.parametrize(
    ("slot_estimate", "new_spread"),
    [
        (2**15 + 2**12, 2**26 * 15 // 16),  # at 1/2 + 1/16, a spread away: inside
        (2**15 + 2**12 + 1, 2**26 * 17 // 16),
        (2**15 - 2**12 - 1, 2**26 * 17 // 16),
    ],
)
def test_a_vote_outside_the_spread_widens_it_by_a_sixteenth_and_one_inside_narrows_it(
    firmware: FixedPointFirmware, slot_estimate: int, new_spread: int
) -> None:
    """The spread is 1/16 around 1/2. The neighbour's estimate is at the very distance of 1/16, or beyond it.

    Centre and spread are in units of 2**-30, and estimates of neighbours in units of 2**-16.
    """
    half, sixteenth = 2**29, 2**26
    robot = restore_robust_robot(firmware, estimates=[slot_estimate], votes=1, centre=half, spread=sixteenth)

    robot.settle()  # the neighbour votes

    assert filter_memory(robot)["spread"] == new_spread


@for_fixed_point_firmwares
def test_no_more_than_512_votes_are_counted(firmware: FixedPointFirmware) -> None:
    """The more were counted, the less one more weighs. So the weight of a vote never falls to 0."""
    robot = restore_robust_robot(firmware, estimates=[0], votes=511)

    robot.settle()  # the neighbour's estimate is vote 512
    robot.settle()  # the neighbour votes again

    vote_count = filter_memory(robot)["votes"]
    assert vote_count == 512


@for_every_firmware
def test_a_neighbour_that_sends_more_often_has_no_more_influence(firmware: Firmware) -> None:
    """Robot 6 sends in every round that 3/4 are black. Robots 7 and 8, a majority, have sent 1/4 once."""
    robot = make_robot(firmware, replace(ROBUST, filter_period=1000), b_hat=0.95)
    robot.receive(sender=7, x_hat=0.25, alpha=1.0)
    robot.receive(sender=8, x_hat=0.25, alpha=1.0)

    for _ in range(900):
        robot.receive(sender=6, x_hat=0.75, alpha=1.0)
        robot.settle()  # ends the round: one of the three neighbours votes

    assert robot.x == pytest.approx(0.25, abs=0.01)  # what the majority estimates


# --- The filter ------------------------------------------------------------------------------------------


@for_every_firmware
@pytest.mark.parametrize(("estimate_count", "expected_tests"), [(4, 0), (5, 1)])
def test_a_robot_tests_itself_only_against_five_neighbours_or_more(
    firmware: Firmware, estimate_count: int, expected_tests: int
) -> None:
    """In a test it compares what it has observed with what its neighbours estimate.

    Four neighbours lead to no test, and five to one.
    """
    robot = make_robot(firmware, ROBUST, b_hat=0.95)
    observe_tiles(robot, black=9, white=1)
    receive_estimates(robot, *[0.25] * estimate_count)

    robot.settle()  # ends the round, in which the filter runs

    assert robot.counters.tests == expected_tests


# design: R37
@for_every_firmware
def test_a_robot_whose_observations_contradict_the_others_estimates_its_accuracy_anew(
    firmware: Firmware,
) -> None:
    """It sees a share of 0.545 black, but all others estimate that the share is 0.95.

    With its b_hat of 0.95 it would see 0.95 * 0.95 + 0.05 * 0.05 = 0.905 black. Its new b_hat is the
    accuracy that explains what it sees (eq. 8 of the paper): (0.545 + 0.95 - 1) / (2 * 0.95 - 1) = 0.55.
    """
    robot = make_robot(firmware, ROBUST, b_hat=0.95)
    observe_tiles(robot, black=545, white=455)
    receive_estimates(robot, 0.95, 0.95, 0.95, 0.95, 0.95)

    status = robot.settle()  # ends the round, in which the filter runs

    assert status == Status.UPDATED
    assert robot.b_hat == pytest.approx(0.55, abs=1e-4)
    assert robot.counters.tests == 1
    assert robot.counters.updates == 1


# design: R37
@for_every_firmware
def test_a_robot_that_was_misled_trusts_its_sensor_again_when_the_others_agree_with_it(
    firmware: Firmware,
) -> None:
    """Estimates of 0.25 mislead it to another b_hat, and estimates of 0.95 bring the initial b_hat back.

    0.905 of its observations are black. A sensor with an accuracy of 0.95 sees that where 0.95 of the tiles
    are black: 0.95 * 0.95 + 0.05 * 0.05.
    """
    robot = make_robot(firmware, ROBUST, b_hat=0.95)
    initial_b_hat = robot.b_hat
    observe_tiles(robot, black=905, white=95)
    receive_estimates(robot, 0.25, 0.25, 0.25, 0.25, 0.25)
    assert robot.settle() == Status.UPDATED
    assert robot.b_hat != initial_b_hat

    receive_estimates(robot, 0.95, 0.95, 0.95, 0.95, 0.95)
    status = robot.settle()

    assert status == Status.UPDATED
    assert robot.b_hat == initial_b_hat


@for_every_firmware
def test_a_robot_tests_the_accuracy_that_it_had_at_the_start(firmware: Firmware) -> None:
    """It sees a share of 0.545 black, and all others estimate 0.95. An accuracy of 0.55 explains both.

    If it tested that one in the next round, it would return to the old one, and so forth and back for ever.
    """
    robot = make_robot(firmware, ROBUST, b_hat=0.95)
    observe_tiles(robot, black=545, white=455)
    receive_estimates(robot, 0.95, 0.95, 0.95, 0.95, 0.95)
    robot.settle()  # the filter runs, and finds another accuracy
    new_accuracy = robot.b_hat
    assert new_accuracy == pytest.approx(0.55, abs=1e-4)

    status = robot.settle()  # the filter runs again, on the same observations and estimates

    assert status == Status.UPDATED, "the accuracy was computed again, with the same result"
    assert robot.b_hat == new_accuracy


# design: R25
@for_every_firmware
def test_others_that_estimate_a_half_say_nothing_about_a_robot_s_accuracy(
    firmware: Firmware,
) -> None:
    """Where half of the tiles are black, every sensor, good or bad, sees half of them black."""
    robot = make_robot(firmware, ROBUST, b_hat=0.95)
    observe_tiles(robot, black=100, white=0)
    receive_estimates(robot, 0.5, 0.5, 0.5, 0.5, 0.5)

    status = robot.settle()  # ends the round, in which the filter runs

    assert status == Status.OK
    assert robot.counters.tests == 1
    assert robot.b_hat == pytest.approx(0.95)


@for_every_firmware
@pytest.mark.parametrize(
    ("supporters", "opponents", "expected_status"),
    [
        pytest.param(2, 3, Status.UPDATED, id="2 of 5 are two fifths"),
        pytest.param(3, 4, Status.OK, id="3 of 7 are more"),
        pytest.param(3, 5, Status.UPDATED, id="3 of 8 are fewer"),
    ],
)
def test_a_robot_that_more_than_two_fifths_support_keeps_its_accuracy(
    firmware: Firmware, supporters: int, opponents: int, expected_status: Status
) -> None:
    """It sees a share of 0.545 black, and 0.95 * 0.55 + 0.05 * 0.45 is 0.545.

    So with its b_hat of 0.95 it infers that 0.55 of the tiles are black, which supporters estimate, too, and
    opponents estimate 0.95. The status is UPDATED where it changes its accuracy, and OK where it does not.
    """
    robot = make_robot(firmware, ROBUST, b_hat=0.95)
    observe_tiles(robot, black=545, white=455)
    receive_estimates(robot, *[0.55] * supporters, *[0.95] * opponents)

    status = robot.settle()  # ends the round, in which the filter runs

    assert status == expected_status


@for_every_firmware
def test_one_liar_among_five_neighbours_does_not_make_a_robot_doubt_its_sensor(
    firmware: Firmware,
) -> None:
    """It sees a share of 0.905 black: what a sensor with an accuracy of 0.95 sees where 0.95 are black.

    For 0.95 * 0.95 + 0.05 * 0.05 is 0.905. Four neighbours agree with that.
    """
    robot = make_robot(firmware, ROBUST, b_hat=0.95)
    observe_tiles(robot, black=905, white=95)
    receive_estimates(robot, 0.94, 0.95, 0.95, 0.96, 0.0)  # 0.0 is a lie

    status = robot.settle()  # ends the round, in which the filter runs

    assert status == Status.OK
    assert robot.counters.tests == 1


# design: R37
@for_fixed_point_firmwares
@pytest.mark.parametrize(("t", "expected_status"), [(3_804_264, Status.OK), (3_804_263, Status.UPDATED)])
def test_a_robot_keeps_its_accuracy_at_the_very_limit_of_its_test(
    firmware: FixedPointFirmware, t: int, expected_status: Status
) -> None:
    """The test compares a deviation with a limit. After one observation less the robot changes its accuracy.

    3227 of t tiles were black, and five neighbours say that none is. Numbers for which deviation and limit
    are equal are rare. These were found by a search: with a t of 3804264 both are 43681824. The firmware
    returns UPDATED if it has changed the accuracy, and OK if not.
    """
    largest_b_hat = 2**32 - 2**12  # 1 - 2**-20 in units of 2**-32
    robot = restore_robust_robot(
        firmware,
        t=t,
        n=3227,
        batch_t=t,  # a new batch has just begun
        batch_n=3227,
        b_hat=largest_b_hat,
        initial_b_hat=largest_b_hat,
        estimates=[0, 0, 0, 0, 0],
    )

    status = robot.settle()  # ends a round, in which the filter runs

    assert status == expected_status


@for_every_firmware
@pytest.mark.parametrize(("filter_period", "expected_tests"), [(1, 3), (2, 1), (3, 1), (4, 0)])
def test_a_robot_tests_itself_once_in_each_filter_period(
    firmware: Firmware, filter_period: int, expected_tests: int
) -> None:
    """The period is a number of rounds; here three rounds end."""
    robot = make_robot(firmware, replace(ROBUST, filter_period=filter_period), b_hat=0.95)
    observe_tiles(robot, black=9, white=1)
    receive_estimates(robot, 0.9, 0.9, 0.9, 0.9, 0.9)

    for _ in range(3):
        robot.settle()  # ends a round

    assert robot.counters.tests == expected_tests


# --- Centre and spread of the estimates ------------------------------------------------------------------


@pytest.mark.parametrize(("end", "centre"), [(0xFFFF00, 0xFFFF00 - 5000), (0, 5000)])
def test_the_centre_of_neighbours_at_an_end_of_the_range_stays_within_it(end: int, centre: int) -> None:
    """Estimates are 16 bits in units of 2**-16, so 0 to 0xFFFF00 in the filter's units of 2**-24.

    Five estimates are 5000 units away from the centre, at an end. Each draws it by the spread, 4096 units;
    their sum would draw it beyond the end.
    """
    estimates = [end] * 5
    assert centre_after_huber_step(estimates, centre, spread=4096) == end


def test_an_estimate_that_is_as_near_to_the_centre_as_to_the_robot_does_not_support_the_robot() -> None:
    """With b_hat 3/4 and a centre of 1/16, 9 of 32 observations are black: 3/4 * 1/16 + 1/4 * 15/16."""
    robust = RobustFilter(initial_b_hat=3 * 2**30)
    centre, half = 2**20, 2**23

    assert not is_supported(robust, t=32, n=9, estimates=[half] * 5, centre=centre)


def test_an_estimate_at_the_distance_of_the_spread_is_inside() -> None:
    """So a step of the search for the centre, the sum of all distances, is divided by 2, the number inside.

    The distances are 1/8, which is the spread, and 0. All are in units of 2**-24, and the step is rounded.
    """
    half, eighth = 2**23, 2**21
    centre = centre_after_huber_step([half + eighth, half], centre=half, spread=eighth)
    assert centre == pytest.approx(half + eighth / 2, abs=2)


# --- The dispersion --------------------------------------------------------------------------------------


def dispersion_after_batch(robot: FixedPoint, black: int, white: int) -> int:
    """Let a robot observe a batch and run its filter, and return the dispersion, in units of 2**-8.

    The dispersion says how much more batches of observations vary than independent ones would.
    """
    observe_tiles(robot, black, white)
    robot.settle()
    return filter_memory(robot)["dispersion"]


@for_fixed_point_firmwares
def test_a_batch_that_is_off_raises_the_dispersion_by_an_eighth_of_its_ratio(
    firmware: FixedPointFirmware,
) -> None:
    """The dispersion says how much more batches vary than independent tiles would; it is 1 at first.

    Of 200 tiles so far 80 are black, so of the second batch's 100 it should be 40, with a variance of
    100 * 0.4 * 0.6 = 24.
    """
    robot = make_robust_robot(firmware, b_hat=0.95, filter_period=1)
    dispersion_after_batch(robot, black=50, white=50)  # the first batch

    dispersion = dispersion_after_batch(robot, black=30, white=70)  # the second one

    ratio = (40 - 30) ** 2 / 24
    expected_dispersion = 7 / 8 * 1 + 1 / 8 * ratio
    assert dispersion == int(expected_dispersion * 2**8)  # in units of 2**-8, rounded down


@for_fixed_point_firmwares
def test_a_batch_that_is_far_off_counts_as_12_times_the_dispersion(firmware: FixedPointFirmware) -> None:
    """The dispersion says how much more batches vary than independent tiles would; it is 1 at first.

    Here a white batch follows a black one, so of its 100 tiles 50 should be black, with a variance of 25. The
    squared deviation is 100 times that, and counts as 12 times. The new dispersion has an eighth of it.
    """
    robot = make_robust_robot(firmware, b_hat=0.95, filter_period=1)
    dispersion_after_batch(robot, black=100, white=0)  # the first batch

    dispersion = dispersion_after_batch(robot, black=0, white=100)  # the second one

    expected_dispersion = 7 / 8 * 1 + 1 / 8 * 12
    rounding = 1  # integers are rounded down
    assert dispersion == expected_dispersion * 2**8 - rounding  # in units of 2**-8


@for_fixed_point_firmwares
def test_a_run_of_the_filter_begins_a_new_batch_of_observations(firmware: FixedPointFirmware) -> None:
    """A batch is what a robot observes between two runs; the counts at its beginning are remembered.

    This run decides nothing, as there are no neighbours.
    """
    robot = make_robust_robot(firmware, b_hat=0.95, filter_period=1)
    observe_tiles(robot, black=3, white=4)

    robot.settle()  # the filter runs

    memory = filter_memory(robot)
    assert memory["batch_t"] == 3 + 4
    assert memory["batch_n"] == 3


@for_fixed_point_firmwares
def test_a_new_batch_begins_where_the_robot_halves_its_counts(firmware: FixedPointFirmware) -> None:
    """With a memory of 64 it halves t and n after 64 observations, to forget old ones.

    A batch is what it has observed since its filter ran, or since the halving. batch_t and batch_n are the
    counts at its beginning. Here no round ends, and so the filter does not run.
    """
    robot = make_robust_robot(firmware, b_hat=0.95, filter_period=1000, memory=64)

    observe_tiles(robot, black=40, white=24)

    memory = filter_memory(robot)
    assert robot.t == 64 / 2
    assert memory["batch_t"] == 64 / 2
    assert memory["batch_n"] == 40 / 2


@for_fixed_point_firmwares
@pytest.mark.parametrize(("dispersion", "expected_status"), [(1, Status.UPDATED), (10, Status.OK)])
def test_a_robot_whose_observations_vary_more_than_chance_forgives_a_larger_deviation(
    firmware: FixedPointFirmware, dispersion: int, expected_status: Status
) -> None:
    """By its accuracy, 0.95, and five neighbours who estimate 0.95, it should see 905 of 1000 tiles black.

    850 are 4.9 standard deviations of independent tiles too few, which is sqrt(1000 * 0.85 * 0.15) = 11.3. It
    forgives 3.5 of them, the root of 12, times the root of the dispersion. The status is UPDATED where the
    robot changes its accuracy, and OK where it does not.
    """
    b_hat = round(0.95 * 2**32)  # in units of 2**-32
    estimate = int(0.95 * 2**16)  # in units of 2**-16
    robot = restore_robust_robot(
        firmware,
        t=1000,
        n=850,
        batch_t=1000,  # a new batch has just begun
        batch_n=850,
        b_hat=b_hat,
        initial_b_hat=b_hat,
        estimates=[estimate] * 5,
        dispersion=dispersion * 2**8,  # in units of 2**-8
    )

    status = robot.settle()  # ends a round, in which the filter runs

    assert status == expected_status


# --- Images ----------------------------------------------------------------------------------------------


# design: R29
def test_a_saved_robot_has_the_memory_of_its_filter_in_the_documented_order() -> None:
    """An image, a saved robot, has 39 words of 32 bits. Words 7 to 14 are this memory (docs/design.md).

    In another order, older images could not be restored. The votes and the dispersion share a word.
    """
    robot = MirrorRobot(Config(filter=Filter.ROBUST), OWN_ID, b_hat=0.95)
    votes, dispersion = 27, 28
    # Each member gets another number. No calls lead to these numbers, so they are written into the state.
    robot.s.robust = RobustFilter(
        centre=21,
        spread=22,
        initial_b_hat=23,
        filled_slots=24,
        batch_t=25,
        batch_n=26,
        votes=votes,
        dispersion=dispersion,
        turn=29,
    )

    words = words_of(robot)

    shared_word = (dispersion << 16) | votes
    assert words[7:15] == [21, 22, 23, 24, 25, 26, shared_word, 29]


# design: R29
def test_a_saved_robot_begins_with_a_mark_of_the_robust_filter_and_the_version() -> None:
    """The first word is "MCS" and a byte: the version of images, 3, and 128 for the robust filter."""
    robot = MirrorRobot(ROBUST, OWN_ID, b_hat=0.95)

    first_word, *_ = words_of(robot)

    *letters, filter_and_version = first_word.to_bytes(4, "big")
    assert bytes(letters) == b"MCS"
    assert filter_and_version == 128 + 3


def words_of(robot: MirrorRobot) -> list[int]:
    """Return the words of a saved robot with the robust filter; a word has 4 bytes, the lowest first."""
    return list(struct.unpack("<39I", robot.save()))


# design: R29
def test_a_saved_robot_has_the_estimates_of_two_slots_in_each_word() -> None:
    """A robot has 32 slots for estimates, in words 15 to 30 of its image (docs/design.md).

    The lower half of a word has the slot with the lower number.
    """
    robot = MirrorRobot(ROBUST, OWN_ID, b_hat=0.95)
    robot.receive(sender=0, x_hat=0.25, alpha=1.0)
    robot.receive(sender=1, x_hat=0.5, alpha=1.0)
    robot.receive(sender=2, x_hat=0.75, alpha=1.0)

    words = words_of(robot)

    quarter, half, three_quarters = 1 << 14, 2 << 14, 3 << 14  # in units of 2**-16
    first_word = (half << 16) | quarter
    second_word = three_quarters  # slot 3 is empty
    fourteen_empty_words = [0] * 14
    assert words[15:31] == [first_word, second_word, *fourteen_empty_words]


def status_of_restoring_with(firmware: FixedPointFirmware, members: dict[str, Any]) -> Status:
    """Restore a robot with these members of its filter, after 4 black of 10 observations; return the status.

    ``b_hat`` is the present one, in units of 2**-32; by default it is the initial one, 0.95.
    """
    default_members: dict[str, Any] = {"t": 10, "n": 4, "votes": 1, "estimates": [0]}
    try:
        restore_robust_robot(firmware, **(default_members | members))
    except FirmwareError as error:
        return error.status
    return Status.OK


OTHER_B_HAT = 3 << 30
"""A present b_hat that is not the initial one."""


# design: R30
@for_fixed_point_firmwares
@pytest.mark.parametrize(
    "members",
    [
        {"initial_b_hat": 2**12, "b_hat": 2**12},
        {"initial_b_hat": 2**32 - 2**12, "b_hat": 2**32 - 2**12},
        {"dispersion": 2**8},
        {"dispersion": 2**16 - 1, "batch_t": 1},
        {"batch_t": 10, "batch_n": 4},
        {"batch_t": 4, "batch_n": 4},
        {"batch_t": 6, "batch_n": 0},
        {"b_hat": OTHER_B_HAT, "estimates": [0] * 5, "batch_t": 1},
        {"votes": 0, "turn": 0},
        {"votes": 0, "estimates": []},
        {"votes": 2**9},
        {"centre": 2**30},
        {"centre": 0},
        {"spread": 2**18},
        {"spread": 2**28},
        {"turn": 1},
        {"turn": 32, "estimates": [0] * 32},
    ],
)
def test_a_robot_with_members_at_an_end_of_their_range_is_restored(
    firmware: FixedPointFirmware, members: dict[str, Any]
) -> None:
    """``members`` are numbers of a saved robot with the robust filter that are at an end of their range.

    All other members have usual values. Accuracies are in units of 2**-32, centre and spread in units of
    2**-30, the dispersion in units of 2**-8.
    """
    assert status_of_restoring_with(firmware, members) == Status.OK


# design: R30
@for_fixed_point_firmwares
@pytest.mark.parametrize(
    "members",
    [
        # b_hat is at least 2**-20, and at most 1 - 2**-20.
        {"initial_b_hat": 2**12 - 1, "b_hat": 2**12, "estimates": [0] * 5, "batch_t": 1},
        {"initial_b_hat": 2**32 - 2**12 + 1, "b_hat": 2**12, "estimates": [0] * 5, "batch_t": 1},
        {"dispersion": 2**8 - 1, "batch_t": 1},  # below 1
        {"dispersion": 2**8 + 1, "batch_t": 0},  # above 1 before the end of a batch
        {"batch_t": 3, "batch_n": 4},  # more black observations than all
        {"batch_t": 10, "batch_n": 5},  # more black ones than the 4 there are now
        {"batch_t": 7, "batch_n": 0},  # more white ones than the 6 there are now
        {"batch_t": 11, "batch_n": 4},  # more than the 10 there are now
        {"b_hat": OTHER_B_HAT, "estimates": [0] * 4, "batch_t": 1},  # too few estimates for a test
        {"b_hat": OTHER_B_HAT, "estimates": [0] * 5, "batch_t": 0},  # no run of the filter
        {"votes": 0, "centre": 2**29 + 1},  # not 1/2 before the first vote
        {"votes": 0, "spread": 2**28 - 1},  # not 1/4 before the first vote
        {"votes": 0, "turn": 1},
        {"votes": 1, "estimates": []},
        {"votes": 2**9 + 1},
        {"centre": 2**30 + 1},  # above 1
        {"spread": 2**18 - 1},  # below 2**-12
        {"spread": 2**28 + 1},  # above 1/4
        {"turn": 2},  # after slot 1, which is empty
        {"turn": 33, "estimates": [0] * 32},  # after slot 32, which is none
        {"turn": 256, "estimates": [0] * 32},
        {"filled_slots": 0b10, "estimates": [1, 1]},  # an estimate in slot 0, which is not filled
    ],
)
def test_a_robot_with_members_that_no_calls_lead_to_is_not_restored(
    firmware: FixedPointFirmware, members: dict[str, Any]
) -> None:
    """``members`` are damaged numbers of a saved robot with the robust filter: no robot can have them.

    All other members have usual values. Accuracies are in units of 2**-32, centre and spread in units of
    2**-30, the dispersion in units of 2**-8.
    """
    assert status_of_restoring_with(firmware, members) == Status.ERR_IMAGE
