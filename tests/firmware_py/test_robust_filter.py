"""The robust filter in mirror and C: what it keeps, how it votes, and when it re-estimates b_hat.

docs/design.md, section 13, specifies it. Slot i keeps the estimate of the senders whose id is i modulo 32.
"""

from __future__ import annotations

import struct
from dataclasses import dataclass, replace
from typing import Any

import pytest

from mcp_asdf.mirror import MirrorRobot
from mcp_asdf.robot import Config, Counters, Filter, FirmwareError, Observation, Status
from mcp_asdf.robust_filter import RobustFilter, centre_after_huber_step, huber_centre, median_of, spread_of
from robots import (
    ALPHA_MIN,
    ALPHA_ONE,
    HALF,
    ONE,
    OWN_ID,
    ROBUST,
    ROBUST_B_HAT,
    FixedPoint,
    FixedPointFirmware,
    for_fixed_point_firmwares,
    observe_tiles,
    receive_estimates,
    restore_robust_robot,
)

ONLY_VOTES = replace(ROBUST, filter_period=1000)
"""Parameters of a robot whose rounds have votes, but no test of its accuracy in these short tests."""


def filter_memory(robot: FixedPoint) -> dict[str, int]:
    """Return what the robust filter of a robot remembers, by name, without the estimates in its slots."""
    return {
        name.removeprefix("robust_"): value
        for name, value in robot.state().items()
        if name.startswith("robust_")
    }


def filled_slots(robot: FixedPoint) -> dict[int, int]:
    """Return the estimates in the slots that have one, in units of 2**-16, by slot."""
    state = robot.state()
    slots = [slot for slot in range(32) if state["robust_filled_slots"] >> slot & 1]
    return {slot: state[f"estimates_{slot}"] for slot in slots}


# --- Estimates -------------------------------------------------------------------------------------------


@for_fixed_point_firmwares
@pytest.mark.parametrize(("sender", "slot"), [(0, 0), (31, 31), (32, 0), (37, 5), (127, 31)])
def test_an_estimate_is_kept_in_the_slot_of_its_sender_modulo_32(
    firmware: FixedPointFirmware, sender: int, slot: int
) -> None:
    """A robot with the robust filter has 32 slots for the latest estimates of its neighbours."""
    robot = firmware(ROBUST, OWN_ID, b_hat=0.95)

    robot.receive(sender, x_hat=0.25, alpha=1.0)

    assert filled_slots(robot) == {slot: round(0.25 * 2**16)}


# design: R35
@for_fixed_point_firmwares
def test_senders_with_ids_equal_modulo_32_share_a_slot(firmware: FixedPointFirmware) -> None:
    """The robot remembers only the estimate that it received last from two such neighbours."""
    robot = firmware(ROBUST, OWN_ID, b_hat=0.95)

    robot.receive(sender=1, x_hat=0.25, alpha=1.0)
    robot.receive(sender=1 + 32, x_hat=0.5, alpha=1.0)

    assert filled_slots(robot) == {1: round(0.5 * 2**16)}


@for_fixed_point_firmwares
def test_a_neighbour_s_newer_estimate_replaces_its_older_one(firmware: FixedPointFirmware) -> None:
    """A robot keeps the latest estimate of neighbour 1 in slot 1, in units of 2**-16."""
    robot = firmware(ROBUST, OWN_ID, b_hat=0.95)
    robot.receive(sender=1, x_hat=0.25, alpha=1.0)
    robot.settle()  # ends the round: after it a sender may be received again

    robot.receive(sender=1, x_hat=0.5, alpha=1.0)

    assert filled_slots(robot) == {1: round(0.5 * 2**16)}


@for_fixed_point_firmwares
def test_a_second_message_of_a_neighbour_in_the_same_round_is_ignored(firmware: FixedPointFirmware) -> None:
    """A robot keeps the first estimate of neighbour 1 in a round, in slot 1 and in units of 2**-16."""
    robot = firmware(ROBUST, OWN_ID, b_hat=0.95)
    robot.receive(sender=1, x_hat=0.25, alpha=1.0)

    status = robot.receive(sender=1, x_hat=0.5, alpha=1.0)

    assert status == Status.REPEATED
    assert filled_slots(robot) == {1: round(0.25 * 2**16)}


@for_fixed_point_firmwares
def test_a_robot_remembers_its_neighbours_while_it_hears_nobody(firmware: FixedPointFirmware) -> None:
    """It keeps the latest estimate of neighbour 1 in slot 1, in units of 2**-16."""
    robot = firmware(ROBUST, OWN_ID, b_hat=0.95)
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
    """x_hat has units of 2**-23. A slot has units of 2**-16, 128 times as large, and at most 65535."""
    robot = firmware(ROBUST, OWN_ID, b_hat=0.95)
    robot.receive_raw(sender=1, x_hat=x_hat, alpha=ALPHA_ONE)
    assert filled_slots(robot) == {1: slot_estimate}


@for_fixed_point_firmwares
@pytest.mark.parametrize("alpha_word", [0, 0x1F, 0xFF])
def test_a_neighbour_without_confidence_is_accepted_but_not_remembered(
    firmware: FixedPointFirmware, alpha_word: int
) -> None:
    """A confidence is a word: a mantissa above 8 bits of a shift. With a mantissa of 0, as here, it is 0.

    The robot counts the message, but does not keep its estimate.
    """
    robot = firmware(ROBUST, OWN_ID, b_hat=0.95)

    robot.receive_raw(sender=1, x_hat=HALF, alpha=alpha_word)

    assert filled_slots(robot) == {}
    assert robot.counters == Counters(accepted=1)


@for_fixed_point_firmwares
def test_the_robust_filter_does_not_sum_the_estimates_of_a_round(firmware: FixedPointFirmware) -> None:
    """Sums are for the paper's filter; a sum gives a single liar too much weight.

    The sums of the round that goes on are called open, those of the last one closed.
    """
    robot = firmware(ROBUST, OWN_ID, b_hat=0.95)
    receive_estimates(robot, 0.25, 0.5)
    robot.settle()  # ends a round with two messages
    receive_estimates(robot, 0.25, 0.5)

    sums = [value for name, value in robot.state().items() if name.startswith(("open_", "closed_"))]

    assert sums == [0] * 9, "a robot has nine numbers for them"
    assert robot.beta == 0, "the sum of the neighbours' confidences"


@for_fixed_point_firmwares
def test_without_the_robust_filter_no_estimates_of_neighbours_are_remembered(
    firmware: FixedPointFirmware,
) -> None:
    """Its 32 slots for estimates of neighbours, which only the robust filter needs, stay empty."""
    robot = firmware(Config(filter=Filter.OFF), OWN_ID, b_hat=0.95)

    receive_estimates(robot, 0.25, 0.5)
    robot.settle()  # ends the round

    remembered = [value for name, value in robot.state().items() if name.startswith("estimates_")]
    assert remembered == [0] * 32
    assert filled_slots(robot) == {}


# --- Votes -----------------------------------------------------------------------------------------------


# design: R36
@for_fixed_point_firmwares
def test_before_the_first_vote_a_robot_believes_its_own_estimate(firmware: FixedPointFirmware) -> None:
    """Votes are counted when a round ends: a message that has just come has not voted."""
    robot = firmware(ROBUST, OWN_ID, b_hat=0.95)
    observe_tiles(robot, black=9, white=1)

    receive_estimates(robot, 0.25)

    assert robot.x == robot.x_hat
    assert robot.x_bar == 0.5, "what others estimate is unknown"


# design: R36
@for_fixed_point_firmwares
def test_x_and_x_bar_are_the_centre_of_the_votes(firmware: FixedPointFirmware) -> None:
    """The robot believes x, and takes x_bar for what its neighbours estimate: both are the votes' centre.

    The centre is in units of 2**-30, and x and x_bar, which are rounded down, in units of 2**-23.
    """
    three_quarters_and_less_than_a_unit_of_x = 3 * 2**28 + 127
    robot = restore_robust_robot(
        firmware, estimates=[0], votes=1, centre=three_quarters_and_less_than_a_unit_of_x
    )

    three_quarters = 3 * 2**21
    assert robot.x_raw == three_quarters
    assert robot.x_bar_raw == three_quarters


@for_fixed_point_firmwares
def test_a_round_has_one_vote_however_many_neighbours_were_received(firmware: FixedPointFirmware) -> None:
    """The next neighbour votes in the next round. So a call takes the same time in any swarm."""
    robot = firmware(ROBUST, OWN_ID, b_hat=0.95)
    receive_estimates(robot, 0.25, 0.5, 0.75)

    robot.settle()  # ends the round

    assert filter_memory(robot)["votes"] == 1


@for_fixed_point_firmwares
def test_without_estimates_of_others_there_is_no_vote(firmware: FixedPointFirmware) -> None:
    """A robot that is alone believes its own estimate anyway."""
    robot = firmware(ROBUST, OWN_ID, b_hat=0.95)
    robot.step(Observation.BLACK)  # observes a tile and ends a round
    assert filter_memory(robot)["votes"] == 0


def voters_of_rounds(robot: FixedPoint, rounds: int) -> list[int | str]:
    """Let so many rounds end, and return who voted in each: the number of a slot, or "own estimate".

    After the vote of slot i it is the turn of slot i + 1, and after the robot's own vote that of slot 0.
    """
    voters: list[int | str] = []
    for _ in range(rounds):
        robot.settle()
        turn = filter_memory(robot)["turn"]
        voters.append("own estimate" if turn == 0 else turn - 1)
    return voters


@for_fixed_point_firmwares
@pytest.mark.parametrize(
    ("senders", "black", "voters"),
    [
        pytest.param([9, 6], 1, [6, 9, "own estimate", 6, 9], id="in ascending order"),
        pytest.param([31], 1, [31, "own estimate", 31, "own estimate"], id="after the last of 32 slots"),
        pytest.param([6, 31], 0, [6, 31, 6, 31], id="a robot that has observed nothing does not vote"),
    ],
)
def test_neighbours_vote_in_ascending_order_and_the_robot_itself_after_them(
    firmware: FixedPointFirmware, senders: list[int], black: int, voters: list[int | str]
) -> None:
    """One voter votes in each round. The estimates of neighbours 6, 9 and 31 are in slots 6, 9 and 31.

    The robot has observed ``black`` tiles, and all were black.
    """
    robot = firmware(ONLY_VOTES, OWN_ID, b_hat=0.95)
    observe_tiles(robot, black, white=0)
    for sender in senders:
        robot.receive(sender, x_hat=0.5, alpha=1.0)

    assert voters_of_rounds(robot, len(voters)) == voters


@for_fixed_point_firmwares
@pytest.mark.parametrize(("alpha", "voter"), [(0, 0), (ALPHA_MIN, "own estimate")])
def test_the_smallest_confidence_is_enough_for_a_robot_to_vote(
    firmware: FixedPointFirmware, alpha: int, voter: int | str
) -> None:
    """Slot 0 has voted, so it is the robot's own turn; without confidence slot 0 votes again.

    No observation leads to such a confidence. Only a robot whose b_hat was just updated may be restored so.
    """
    mirror = restore_robust_robot(MirrorRobot, t=1, estimates=[0], turn=1, votes=1)
    assert isinstance(mirror, MirrorRobot)
    mirror.s.alpha, mirror.s.updated = alpha, 1
    robot = firmware.restore(ROBUST, mirror.save())

    assert voters_of_rounds(robot, rounds=1) == [voter]


@for_fixed_point_firmwares
def test_a_new_neighbour_votes_as_soon_as_its_slot_is_reached(firmware: FixedPointFirmware) -> None:
    """It need not wait until all that were there before it have voted."""
    robot = firmware(ONLY_VOTES, OWN_ID, b_hat=0.95)
    robot.receive(sender=6, x_hat=0.5, alpha=1.0)
    robot.receive(sender=9, x_hat=0.5, alpha=1.0)
    robot.settle()  # slot 6 votes

    robot.receive(sender=7, x_hat=0.5, alpha=1.0)

    assert voters_of_rounds(robot, rounds=3) == [7, 9, 6]


@for_fixed_point_firmwares
def test_a_robot_s_own_vote_moves_what_it_believes_towards_what_it_has_seen(
    firmware: FixedPointFirmware,
) -> None:
    """It has seen black alone, and its neighbour says that half is black.

    A vote moves what it believes by an eighth of the spread at most. That is 1/4 at first, and a sixteenth of
    it less after the neighbour's vote, which is where the robot expects it.
    """
    robot = firmware(ONLY_VOTES, OWN_ID, b_hat=0.95)
    observe_tiles(robot, black=9, white=0)
    receive_estimates(robot, 0.5)
    robot.settle()  # the neighbour votes
    assert robot.x == 0.5

    robot.settle()  # the robot votes

    spread = 1 / 4 * (1 - 1 / 16)
    assert robot.x == 0.5 + spread / 8


@for_fixed_point_firmwares
@pytest.mark.parametrize(
    ("vote", "counted_distance"),
    [(1.0, 1 / 4), (0.75, 1 / 4), (0.625, 1 / 8), (0.5, 0.0), (0.375, -1 / 8), (0.0, -1 / 4)],
)
def test_a_vote_far_away_moves_what_the_robot_believes_no_further_than_one_at_a_limit(
    firmware: FixedPointFirmware, vote: float, counted_distance: float
) -> None:
    """A vote moves the centre of the votes, 1/2 at first, by an eighth of the vote's distance from it.

    A longer distance than the spread, 1/4 at first, counts as 1/4. So the greatest lie, 0 or 1, moves a robot
    no more than an error of a quarter.
    """
    robot = firmware(ROBUST, OWN_ID, b_hat=0.95)
    receive_estimates(robot, vote)

    robot.settle()  # the neighbour votes

    assert robot.x == 1 / 2 + counted_distance / 8


@for_fixed_point_firmwares
@pytest.mark.parametrize(
    ("votes", "gain"),
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
    firmware: FixedPointFirmware, votes: int, gain: float
) -> None:
    """A vote moves the centre of the votes by the spread times the gain, which falls from 1/8 to 1/128.

    Here a neighbour votes 0, which is far below the centre. Centre and spread are in units of 2**-30.
    """
    centre, spread = 2**30 // 2, 2**30 // 4
    robot = restore_robust_robot(firmware, estimates=[0], votes=votes, centre=centre, spread=spread)

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
    """The spread is 1/16 around 1/2, in units of 2**-30. Estimates of neighbours are in units of 2**-16."""
    robot = restore_robust_robot(firmware, estimates=[slot_estimate], votes=1, spread=2**26)

    robot.settle()  # the neighbour votes

    assert filter_memory(robot)["spread"] == new_spread


@for_fixed_point_firmwares
@pytest.mark.parametrize(
    ("limit", "slot_estimate"),
    [
        pytest.param(2**18, 2**15, id="narrowed by a vote in the middle"),
        pytest.param(2**28, 0, id="widened by a vote at the end"),
    ],
)
def test_no_vote_brings_the_spread_beyond_its_limits(
    firmware: FixedPointFirmware, limit: int, slot_estimate: int
) -> None:
    """They are 2**-12 and 1/4, in units of 2**-30. An estimate of 1/2 in units of 2**-16 is 2**15."""
    robot = restore_robust_robot(firmware, estimates=[slot_estimate], votes=1, spread=limit)

    robot.settle()  # the neighbour votes

    assert filter_memory(robot)["spread"] == limit


@for_fixed_point_firmwares
def test_no_more_than_512_votes_are_counted(firmware: FixedPointFirmware) -> None:
    """The more were counted, the less one more weighs. So the weight of a vote never falls to 0."""
    robot = restore_robust_robot(firmware, estimates=[0], votes=511)

    robot.settle()  # the neighbour's estimate is vote 512
    robot.settle()  # it votes again

    assert filter_memory(robot)["votes"] == 512


@for_fixed_point_firmwares
def test_a_neighbour_that_sends_more_often_has_no_more_influence(firmware: FixedPointFirmware) -> None:
    """Robot 6 sends in every round that 3/4 are black. Robots 7 and 8, a majority, have sent 1/4 once."""
    robot = firmware(ONLY_VOTES, OWN_ID, b_hat=0.95)
    robot.receive(sender=7, x_hat=0.25, alpha=1.0)
    robot.receive(sender=8, x_hat=0.25, alpha=1.0)

    for _ in range(900):
        robot.receive(sender=6, x_hat=0.75, alpha=1.0)
        robot.settle()  # ends the round: one of the three votes

    assert robot.x == pytest.approx(0.25, abs=0.01)


# --- The filter ------------------------------------------------------------------------------------------


@for_fixed_point_firmwares
@pytest.mark.parametrize(("estimate_count", "tests"), [(4, 0), (5, 1)])
def test_a_robot_tests_itself_only_against_five_neighbours_or_more(
    firmware: FixedPointFirmware, estimate_count: int, tests: int
) -> None:
    """In a test it compares what it has observed with what its neighbours estimate."""
    robot = firmware(ROBUST, OWN_ID, b_hat=0.95)
    observe_tiles(robot, black=9, white=1)
    receive_estimates(robot, *[0.25] * estimate_count)

    robot.settle()  # ends the round, in which the filter runs

    assert robot.counters.tests == tests


# design: R37
@for_fixed_point_firmwares
def test_a_robot_whose_observations_contradict_the_others_estimates_its_accuracy_anew(
    firmware: FixedPointFirmware,
) -> None:
    """It sees a share of 0.545 black, but all others estimate that the share is 0.95.

    With its b_hat of 0.95 it would see 0.95 * 0.95 + 0.05 * 0.05 = 0.905 black. Its new b_hat is the
    accuracy that explains what it sees (eq. 8 of the paper): (0.545 + 0.95 - 1) / (2 * 0.95 - 1) = 0.55.
    """
    robot = firmware(ROBUST, OWN_ID, b_hat=0.95)
    observe_tiles(robot, black=545, white=455)
    receive_estimates(robot, 0.95, 0.95, 0.95, 0.95, 0.95)

    status = robot.settle()  # ends the round, in which the filter runs

    assert status == Status.UPDATED
    assert robot.b_hat == pytest.approx(0.55, abs=1e-4)
    assert robot.counters.tests == 1
    assert robot.counters.updates == 1


# design: R37
@for_fixed_point_firmwares
def test_a_robot_that_was_misled_trusts_its_sensor_again_when_the_others_agree_with_it(
    firmware: FixedPointFirmware,
) -> None:
    """Estimates of 0.25 mislead it to another b_hat, and estimates of 0.95 bring the initial b_hat back.

    0.905 of its observations are black. A sensor with an accuracy of 0.95 sees that where 0.95 of the tiles
    are black: 0.95 * 0.95 + 0.05 * 0.05.
    """
    robot = firmware(ROBUST, OWN_ID, b_hat=0.95)
    observe_tiles(robot, black=905, white=95)
    receive_estimates(robot, 0.25, 0.25, 0.25, 0.25, 0.25)
    assert robot.settle() == Status.UPDATED
    assert robot.b_hat_raw != ROBUST_B_HAT

    receive_estimates(robot, 0.95, 0.95, 0.95, 0.95, 0.95)
    status = robot.settle()

    assert status == Status.UPDATED
    assert robot.b_hat_raw == ROBUST_B_HAT


@for_fixed_point_firmwares
def test_a_robot_tests_the_accuracy_that_it_had_at_the_start(firmware: FixedPointFirmware) -> None:
    """Its new accuracy agrees with the others. A test of that would lead it back to the old accuracy."""
    robot = firmware(ROBUST, OWN_ID, b_hat=0.95)
    observe_tiles(robot, black=545, white=455)
    receive_estimates(robot, 0.95, 0.95, 0.95, 0.95, 0.95)
    robot.settle()  # the filter runs, and finds another accuracy
    new_accuracy = robot.b_hat
    assert new_accuracy != 0.95

    status = robot.settle()  # the filter runs again, and nothing has changed

    assert status == Status.UPDATED
    assert robot.b_hat == new_accuracy


# design: R25
@for_fixed_point_firmwares
def test_others_that_estimate_a_half_say_nothing_about_a_robot_s_accuracy(
    firmware: FixedPointFirmware,
) -> None:
    """Where half of the tiles are black, every sensor, good or bad, sees half of them black."""
    robot = firmware(ROBUST, OWN_ID, b_hat=0.95)
    observe_tiles(robot, black=100, white=0)
    receive_estimates(robot, 0.5, 0.5, 0.5, 0.5, 0.5)

    status = robot.settle()  # ends the round, in which the filter runs

    assert status == Status.OK
    assert robot.counters.tests == 1
    assert robot.b_hat_raw == ROBUST_B_HAT


@for_fixed_point_firmwares
@pytest.mark.parametrize(
    ("supporters", "opponents", "status"),
    [
        pytest.param(2, 3, Status.UPDATED, id="2 of 5 are two fifths"),
        pytest.param(3, 4, Status.OK, id="3 of 7 are more"),
        pytest.param(3, 5, Status.UPDATED, id="3 of 8 are fewer"),
    ],
)
def test_a_robot_that_more_than_two_fifths_support_keeps_its_accuracy(
    firmware: FixedPointFirmware, supporters: int, opponents: int, status: Status
) -> None:
    """It sees 0.545 black and infers that 0.55 of the tiles are, so those who send 0.55 support it.

    The status is UPDATED where the robot changes its accuracy, and OK where it does not.
    """
    robot = firmware(ROBUST, OWN_ID, b_hat=0.95)
    observe_tiles(robot, black=545, white=455)
    receive_estimates(robot, *[0.55] * supporters, *[0.95] * opponents)

    assert robot.settle() == status


@for_fixed_point_firmwares
def test_one_liar_among_five_neighbours_does_not_make_a_robot_doubt_its_sensor(
    firmware: FixedPointFirmware,
) -> None:
    """It sees 0.905 of the tiles black: what a sensor that is right in 0.95 sees where 0.95 are black."""
    robot = firmware(ROBUST, OWN_ID, b_hat=0.95)
    observe_tiles(robot, black=905, white=95)
    receive_estimates(robot, 0.94, 0.95, 0.95, 0.96, 0.0)  # 0.0 is a lie

    status = robot.settle()  # ends the round, in which the filter runs

    assert status == Status.OK
    assert robot.counters.tests == 1


# design: R37
@for_fixed_point_firmwares
@pytest.mark.parametrize(("t", "status"), [(3_804_264, Status.OK), (3_804_263, Status.UPDATED)])
def test_a_robot_keeps_its_accuracy_at_the_very_limit_of_its_test(
    firmware: FixedPointFirmware, t: int, status: Status
) -> None:
    """The test compares a deviation with a limit. After one observation less the robot changes its accuracy.

    Counts for which both are equal are rare, and were searched for. Here both are 43681824.
    """
    largest_b_hat = 2**32 - 2**12  # 1 - 2**-20 in units of 2**-32
    counts = {"t": t, "n": 3227, "batch_t": t, "batch_n": 3227}
    b_hats = {"b_hat": largest_b_hat, "initial_b_hat": largest_b_hat}
    robot = restore_robust_robot(firmware, **counts, **b_hats, estimates=[0] * 5)

    assert robot.settle() == status


@for_fixed_point_firmwares
@pytest.mark.parametrize(("filter_period", "tests"), [(1, 3), (2, 1), (3, 1), (4, 0)])
def test_a_robot_tests_itself_once_in_each_filter_period(
    firmware: FixedPointFirmware, filter_period: int, tests: int
) -> None:
    """The period is a number of rounds; here three rounds end."""
    robot = firmware(replace(ROBUST, filter_period=filter_period), OWN_ID, b_hat=0.95)
    observe_tiles(robot, black=9, white=1)
    receive_estimates(robot, 0.9, 0.9, 0.9, 0.9, 0.9)

    for _ in range(3):
        robot.settle()  # ends a round

    assert robot.counters.tests == tests


# --- Centre and spread of the estimates ------------------------------------------------------------------


@pytest.mark.parametrize(
    ("values", "median"),
    [([1, 2, 9], 2), ([1, 2, 6, 9], 4), ([1, 2, 5, 9], 3), ([0, 1, 7, 8, 9, 9], 7)],
)
def test_the_median_of_an_even_number_is_the_mean_of_the_middle_two_rounded_down(
    values: list[int], median: int
) -> None:
    """The values are in ascending order. If their number is odd, the median is the middle value."""
    assert median_of(values) == median


@pytest.mark.parametrize(
    ("sixteenths", "median", "spread"),
    [
        ([1, 2, 4, 5, 15], 4, 2 * 2**20),
        ([0, 0, 4, 15, 15], 4, 4 * 2**20),
        pytest.param([4, 4, 4, 4, 4], 4, 2**12, id="all distances are 0, but 2**-12 is the least"),
        pytest.param([0, 0, 8, 15, 15], 8, 4 * 2**20, id="the median distance is 7/16, but 1/4 is the most"),
    ],
)
def test_the_spread_is_the_median_distance_from_the_median_within_limits(
    sixteenths: list[int], median: int, spread: int
) -> None:
    """The filter computes in units of 2**-24, so a sixteenth is 2**20 units."""
    estimates = [number * 2**20 for number in sixteenths]
    assert spread_of(estimates, median * 2**20) == spread


def test_an_estimate_far_away_counts_as_one_at_the_distance_of_the_spread() -> None:
    """Two estimates lie below by a spread or more, and two above. They balance, at any distance."""
    estimates = [256_000, 512_000, 768_000, 1_024_000, 15_360_000]
    assert huber_centre(estimates, median=768_000, spread=256_000) == 768_000


def test_the_centre_of_estimates_within_the_spread_is_their_mean() -> None:
    """It is found step by step, and may be wrong by two units of 2**-24."""
    estimates = [256_000, 512_000, 1_536_000]
    centre = huber_centre(estimates, median=512_000, spread=1_280_000)
    assert centre == pytest.approx(sum(estimates) / 3, abs=2)


@pytest.mark.parametrize(("end", "centre"), [(0xFFFF00, 0xFFFF00 - 5000), (0, 5000)])
def test_the_centre_of_neighbours_at_an_end_of_the_range_stays_within_it(end: int, centre: int) -> None:
    """Estimates are 16 bits in units of 2**-16, so 0 to 0xFFFF00 in the filter's units of 2**-24.

    Five estimates are 5000 away from the centre. Each draws it by the spread, 4096; the sum is too far.
    """
    assert centre_after_huber_step([end] * 5, centre, spread=4096) == end


# --- The dispersion --------------------------------------------------------------------------------------


def dispersion_after_batch(robot: FixedPoint, black: int, white: int) -> int:
    """Let a robot observe a batch and run its filter, and return the dispersion, in units of 2**-8.

    The dispersion says how much more batches of observations vary than independent ones would.
    """
    observe_tiles(robot, black, white)
    robot.settle()
    return filter_memory(robot)["dispersion"]


@for_fixed_point_firmwares
def test_batches_with_equal_shares_of_black_keep_the_dispersion_at_1(firmware: FixedPointFirmware) -> None:
    """The dispersion says how much more batches vary than independent tiles would; it is at least 1."""
    robot = firmware(ROBUST, OWN_ID, b_hat=0.95)
    dispersion_after_batch(robot, black=60, white=40)
    assert dispersion_after_batch(robot, black=60, white=40) == 2**8  # 1 in units of 2**-8


@for_fixed_point_firmwares
def test_a_batch_that_is_off_raises_the_dispersion_by_an_eighth_of_its_ratio(
    firmware: FixedPointFirmware,
) -> None:
    """The dispersion says how much more batches vary than independent tiles would; it is 1 at first.

    Of 200 tiles so far 80 are black, so of the second batch's 100 it should be 40, with a variance of
    100 * 0.4 * 0.6 = 24.
    """
    robot = firmware(ROBUST, OWN_ID, b_hat=0.95)
    dispersion_after_batch(robot, black=50, white=50)

    dispersion = dispersion_after_batch(robot, black=30, white=70)

    ratio = (40 - 30) ** 2 / 24
    assert dispersion == int((7 / 8 * 1 + 1 / 8 * ratio) * 256)  # in units of 2**-8


@for_fixed_point_firmwares
def test_a_batch_that_is_far_off_counts_as_12_times_the_dispersion(firmware: FixedPointFirmware) -> None:
    """The dispersion says how much more batches vary than independent tiles would; it is 1 at first.

    Here a white batch follows a black one: that is 100 times the variance of independent tiles.
    """
    robot = firmware(ROBUST, OWN_ID, b_hat=0.95)
    dispersion_after_batch(robot, black=100, white=0)

    dispersion = dispersion_after_batch(robot, black=0, white=100)

    a_rounding = 1
    assert dispersion == (7 / 8 * 1 + 1 / 8 * 12) * 256 - a_rounding  # in units of 2**-8


@for_fixed_point_firmwares
def test_the_dispersion_falls_by_an_eighth_with_each_batch_that_is_as_expected(
    firmware: FixedPointFirmware,
) -> None:
    """It says how much more batches of tiles vary than independent ones would, in units of 2**-8.

    Half of 100 tiles were black so far, and half of the next 100 are black, too.
    """
    robot = restore_robust_robot(firmware, t=100, n=50, batch_t=100, batch_n=50, dispersion=1000)
    assert dispersion_after_batch(robot, black=50, white=50) == 1000 * 7 // 8


@for_fixed_point_firmwares
def test_the_dispersion_does_not_overflow_its_16_bits(firmware: FixedPointFirmware) -> None:
    """It says how much more batches of tiles vary than independent ones would; here it is the largest.

    Of a million tiles all were black but the last one, and 5000 white ones follow, which would raise it.
    """
    robot = restore_robust_robot(
        firmware, t=10**6, n=999_999, batch_t=999_999, batch_n=999_999, dispersion=2**16 - 1
    )
    assert dispersion_after_batch(robot, black=0, white=5000) == 2**16 - 1


@for_fixed_point_firmwares
def test_a_batch_without_observations_does_not_change_the_dispersion(firmware: FixedPointFirmware) -> None:
    """The dispersion says how much more batches of tiles vary than independent tiles would."""
    robot = restore_robust_robot(firmware, t=100, n=50, batch_t=100, batch_n=50, dispersion=1000)
    assert dispersion_after_batch(robot, black=0, white=0) == 1000


@for_fixed_point_firmwares
def test_white_observations_alone_do_not_change_the_dispersion(firmware: FixedPointFirmware) -> None:
    """No black tile is expected, and none was seen, so there is no deviation to be measured."""
    robot = restore_robust_robot(firmware, t=100, n=0, batch_t=50, batch_n=0, dispersion=1000)
    assert dispersion_after_batch(robot, black=0, white=10) == 1000


@for_fixed_point_firmwares
def test_a_run_of_the_filter_begins_a_new_batch_of_observations(firmware: FixedPointFirmware) -> None:
    """A batch is what a robot observes between two runs; the counts at its beginning are remembered.

    This run decides nothing, as there are no neighbours.
    """
    robot = firmware(ROBUST, OWN_ID, b_hat=0.95)
    observe_tiles(robot, black=3, white=4)

    robot.settle()  # the filter runs

    memory = filter_memory(robot)
    assert memory["batch_t"] == 3 + 4
    assert memory["batch_n"] == 3


@for_fixed_point_firmwares
def test_a_new_batch_begins_where_the_robot_halves_its_counts(firmware: FixedPointFirmware) -> None:
    """It halves t and n after 64 observations here, its memory, to forget old ones.

    A batch is what it has observed since its filter ran, or since then. batch_t and batch_n are the counts at
    its beginning.
    """
    robot = firmware(replace(ONLY_VOTES, memory=64), OWN_ID, b_hat=0.95)

    observe_tiles(robot, black=40, white=24)

    memory = filter_memory(robot)
    assert robot.t == 64 // 2
    assert memory["batch_t"] == 64 // 2
    assert memory["batch_n"] == 40 // 2


@for_fixed_point_firmwares
@pytest.mark.parametrize(("dispersion", "status"), [(1, Status.UPDATED), (10, Status.OK)])
def test_a_robot_whose_observations_vary_more_than_chance_forgives_a_larger_deviation(
    firmware: FixedPointFirmware, dispersion: int, status: Status
) -> None:
    """850 of 1000 tiles black instead of 905 are 4.9 standard deviations of independent tiles too few.

    It forgives 3.5 of them, the root of 12, times the root of the dispersion. The status is UPDATED where the
    robot changes its accuracy, and OK where it does not.
    """
    counts = {"t": 1000, "n": 850, "batch_t": 1000, "batch_n": 850}
    estimates = [int(0.95 * 2**16)] * 5
    robot = restore_robust_robot(firmware, **counts, estimates=estimates, dispersion=dispersion * 2**8)

    assert robot.settle() == status


# --- Images ----------------------------------------------------------------------------------------------


@pytest.mark.parametrize(("mode", "size"), [(Filter.ROBUST, 156), (Filter.OFF, 124), (Filter.ALWAYS, 124)])
@for_fixed_point_firmwares
def test_an_image_has_39_words_with_the_robust_filter_and_31_with_another(
    firmware: FixedPointFirmware, mode: Filter, size: int
) -> None:
    """An image is a saved robot, and a word has 4 bytes."""
    assert len(firmware(Config(filter=mode), OWN_ID, 0.95).save()) == size


# design: R29
def test_a_saved_robot_has_the_memory_of_its_filter_in_the_documented_order() -> None:
    """An image, a saved robot, has 39 words of 32 bits. Eight words are this memory (docs/design.md).

    In another order, older images could not be restored. The votes and the dispersion share a word.
    """
    robot = MirrorRobot(ROBUST, OWN_ID, b_hat=0.95)
    votes, dispersion = 27, 28
    # Each member gets a different number. No calls lead to these numbers, so they are written into the state.
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

    image = split_image(robot.save())

    shared_word = dispersion << 16 | votes
    assert image.filter_words == [21, 22, 23, 24, 25, 26, shared_word, 29]


# design: R29
def test_a_saved_robot_begins_with_a_mark_of_the_robust_filter_and_the_version() -> None:
    """The first word is "MCS" and a byte: the version of images, 3, and 128 for the robust filter."""
    robot = MirrorRobot(ROBUST, OWN_ID, b_hat=0.95)
    *mcs, filter_and_version = split_image(robot.save()).first_word.to_bytes(4, "big")
    assert bytes(mcs) == b"MCS"
    assert filter_and_version == 128 + 3


@dataclass(frozen=True)
class SplitImage:
    """Words of a saved robot by what they hold: by docs/design.md word 0, words 7 to 14, and 15 to 30."""

    first_word: int
    filter_words: list[int]
    estimate_words: list[int]


def split_image(image: bytes) -> SplitImage:
    """Split the bytes of a saved robot with the robust filter; a word has 4 of them, the lowest first."""
    words = list(struct.unpack("<39I", image))
    return SplitImage(words[0], filter_words=words[7:15], estimate_words=words[15:31])


# design: R29
def test_a_saved_robot_has_the_estimates_of_two_slots_in_each_word() -> None:
    """A robot has 32 slots for estimates. The lower half of a word has the slot with the lower number."""
    robot = MirrorRobot(ROBUST, OWN_ID, b_hat=0.95)
    robot.receive(sender=0, x_hat=0.25, alpha=1.0)
    robot.receive(sender=1, x_hat=0.5, alpha=1.0)
    robot.receive(sender=2, x_hat=0.75, alpha=1.0)

    image = split_image(robot.save())

    quarter, half, three_quarters = 1 << 14, 2 << 14, 3 << 14  # in units of 2**-16
    assert image.estimate_words == [half << 16 | quarter, three_quarters, *[0] * 14]


def status_of_restore(firmware: FixedPointFirmware, members: dict[str, Any]) -> Status:
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
    """Each case has members of the robust filter of a saved robot at an end of their range.

    ``status_of_restore`` has values for the others. Accuracies are in units of 2**-32, centre and spread in
    units of 2**-30, the dispersion in units of 2**-8.
    """
    assert status_of_restore(firmware, members) == Status.OK


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
    """Each case has members of the robust filter of a saved robot that are damaged: no robot can have them.

    Accuracies are in units of 2**-32, centre and spread in units of 2**-30, the dispersion in units of 2**-8.
    """
    assert status_of_restore(firmware, members) == Status.ERR_IMAGE
