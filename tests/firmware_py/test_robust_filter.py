"""The robust filter in mirror and C: what it keeps, how it votes, and when it re-estimates b_hat.

docs/design.md, section 13, specifies it. Slot i keeps the estimate of the senders whose id is i modulo 32.
"""

from __future__ import annotations

import struct
from dataclasses import replace
from typing import Any

import pytest

from mcp_asdf.mirror import MirrorRobot
from mcp_asdf.robot import Config, Counters, Filter, FirmwareError, Observation, Status
from mcp_asdf.robust_filter import (
    RobustFilter,
    centre_after_huber_step,
    huber_centre,
    median_of,
    spread_of,
)
from mcp_asdf_tools.crosscheck.scenario import Call, edited_image
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

LARGEST_ESTIMATE = (1 << 24) - (1 << 8)
"""The largest estimate of a slot in units of 2**-24."""
INDEPENDENT = 256
"""The dispersion of independent observations: 1 in units of 2**-8."""


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
    robot = firmware(ROBUST, OWN_ID, b_hat=0.95)

    robot.receive(sender, x_hat=0.25, alpha=1.0)

    assert filled_slots(robot) == {slot: round(0.25 * 2**16)}


# design: R35
@for_fixed_point_firmwares
def test_senders_with_ids_equal_modulo_32_share_a_slot(firmware: FixedPointFirmware) -> None:
    """Of two such neighbours the robot remembers the one that was received last."""
    robot = firmware(ROBUST, OWN_ID, b_hat=0.95)

    robot.receive(sender=1, x_hat=0.25, alpha=1.0)
    robot.receive(sender=1 + 32, x_hat=0.5, alpha=1.0)

    assert filled_slots(robot) == {1: round(0.5 * 2**16)}


@for_fixed_point_firmwares
def test_a_neighbour_s_newer_estimate_replaces_its_older_one(firmware: FixedPointFirmware) -> None:
    robot = firmware(ROBUST, OWN_ID, b_hat=0.95)
    robot.receive(sender=1, x_hat=0.25, alpha=1.0)
    robot.settle()  # ends the round: after it a sender may be received again

    robot.receive(sender=1, x_hat=0.5, alpha=1.0)

    assert filled_slots(robot) == {1: round(0.5 * 2**16)}


@for_fixed_point_firmwares
def test_a_second_message_of_a_neighbour_in_the_same_round_is_ignored(firmware: FixedPointFirmware) -> None:
    robot = firmware(ROBUST, OWN_ID, b_hat=0.95)
    robot.receive(sender=1, x_hat=0.25, alpha=1.0)

    status = robot.receive(sender=1, x_hat=0.5, alpha=1.0)

    assert status == Status.REPEATED
    assert filled_slots(robot) == {1: round(0.25 * 2**16)}


@for_fixed_point_firmwares
def test_a_robot_remembers_its_neighbours_while_it_hears_nobody(firmware: FixedPointFirmware) -> None:
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
    """x_hat is in units of 2**-23, and a slot has 16 bits: multiples of 2**-16, the largest below 1."""
    robot = firmware(ROBUST, OWN_ID, b_hat=0.95)
    robot.receive_raw(1, x_hat, ALPHA_ONE)
    assert filled_slots(robot) == {1: slot_estimate}


@for_fixed_point_firmwares
@pytest.mark.parametrize("alpha_word", [0, 0x1F, 0xFF])
def test_a_neighbour_without_confidence_is_accepted_but_not_remembered(
    firmware: FixedPointFirmware, alpha_word: int
) -> None:
    """The robot counts its message, and its estimate, which is worth nothing, has no vote."""
    robot = firmware(ROBUST, OWN_ID, b_hat=0.95)

    assert robot.receive_raw(1, HALF, alpha_word) == Status.OK

    assert filled_slots(robot) == {}
    assert robot.counters == Counters(accepted=1)


@for_fixed_point_firmwares
def test_the_robust_filter_does_not_sum_the_estimates_of_a_round(firmware: FixedPointFirmware) -> None:
    """Sums are for the paper's filter; a sum gives a single liar too much weight."""
    robot = firmware(ROBUST, OWN_ID, b_hat=0.95)
    receive_estimates(robot, 0.25, 0.5)
    robot.settle()  # ends a round with two messages
    receive_estimates(robot, 0.25, 0.5)

    sums = {name: value for name, value in robot.state().items() if name.startswith(("open_", "closed_"))}

    assert len(sums) == 9
    assert set(sums.values()) == {0}
    assert robot.beta == 0


@for_fixed_point_firmwares
def test_without_the_robust_filter_no_estimates_of_neighbours_are_remembered(
    firmware: FixedPointFirmware,
) -> None:
    robot = firmware(Config(filter=Filter.OFF), OWN_ID, b_hat=0.95)

    receive_estimates(robot, 0.25, 0.5)
    robot.settle()

    remembered = {value for name, value in robot.state().items() if name.startswith("estimates_")}
    assert remembered == {0}
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
    """The centre, 3/4, is in units of 2**-30, and x and x_bar are in units of 2**-23, rounded down."""
    three_quarters = 3 * 2**28
    robot = restore_robust_robot(firmware, estimates=[0], votes=1, centre=three_quarters + 127)

    assert robot.x_raw == 3 * 2**21
    assert robot.x_bar_raw == 3 * 2**21


@for_fixed_point_firmwares
def test_a_round_has_one_vote_however_many_neighbours_were_received(firmware: FixedPointFirmware) -> None:
    robot = firmware(ROBUST, OWN_ID, b_hat=0.95)
    receive_estimates(robot, 0.25, 0.5, 0.75)

    robot.settle()  # ends the round

    assert filter_memory(robot)["votes"] == 1


@for_fixed_point_firmwares
def test_without_estimates_of_others_there_is_no_vote(firmware: FixedPointFirmware) -> None:
    robot = firmware(ROBUST, OWN_ID, b_hat=0.95)
    robot.step(Observation.BLACK)
    assert filter_memory(robot)["votes"] == 0


def turns_of_rounds(robot: FixedPoint, rounds: int) -> list[int]:
    """Let so many rounds end, in each of which one slot or the robot votes, and return whose turn is next.

    After the vote of slot i it is the turn of slot i + 1, and after the robot's own vote that of slot 0.
    """
    turns = []
    for _ in range(rounds):
        robot.settle()
        turns.append(filter_memory(robot)["turn"])
    return turns


def voters_of_rounds(robot: FixedPoint, rounds: int) -> list[int | str]:
    """Let so many rounds end, and return who voted in each: the number of a slot, or "own estimate"."""
    return ["own estimate" if turn == 0 else turn - 1 for turn in turns_of_rounds(robot, rounds)]


@for_fixed_point_firmwares
def test_neighbours_vote_in_ascending_order_and_the_robot_itself_after_them(
    firmware: FixedPointFirmware,
) -> None:
    """One of them votes in each round. Neighbour 39 has slot 39 - 32 = 7."""
    robot = firmware(ONLY_VOTES, OWN_ID, b_hat=0.95)
    robot.observe(Observation.BLACK)
    for sender in (9, 6, 39):
        robot.receive(sender, x_hat=0.5, alpha=1.0)

    assert voters_of_rounds(robot, 6) == [6, 7, 9, "own estimate", 6, 7]


@for_fixed_point_firmwares
def test_a_robot_that_has_observed_nothing_does_not_vote(firmware: FixedPointFirmware) -> None:
    robot = firmware(ONLY_VOTES, OWN_ID, b_hat=0.95)
    for sender in (6, 31):
        robot.receive(sender, x_hat=0.5, alpha=1.0)

    assert voters_of_rounds(robot, 4) == [6, 31, 6, 31]


@for_fixed_point_firmwares
@pytest.mark.parametrize(("alpha", "voter"), [(0, 0), (ALPHA_MIN, "own estimate")])
def test_the_smallest_confidence_is_enough_for_a_robot_to_vote(
    firmware: FixedPointFirmware, alpha: int, voter: int | str
) -> None:
    """Slot 0 has voted, so it is the robot's own turn; without confidence slot 0 votes again.

    The confidence is written into a saved robot. That its b_hat was re-estimated just now is written, too:
    otherwise the confidence would have to follow from its observations, and the robot could not be restored.
    """
    image = restore_robust_robot(firmware, t=1, estimates=[0], turn=1, votes=1).save()
    alpha_word, id_word, is_updated = 5, 37, 1 << 16
    changes = (alpha_word, alpha, id_word, OWN_ID << 24 | is_updated)
    robot = firmware.restore(ROBUST, edited_image(image, Call("restore", changes)))

    assert voters_of_rounds(robot, 1) == [voter]


@for_fixed_point_firmwares
def test_after_the_last_of_32_slots_it_is_the_robot_s_own_turn(firmware: FixedPointFirmware) -> None:
    robot = firmware(ONLY_VOTES, OWN_ID, b_hat=0.95)
    robot.observe(Observation.BLACK)
    robot.receive(sender=31, x_hat=0.5, alpha=1.0)

    assert voters_of_rounds(robot, 3) == [31, "own estimate", 31]


@for_fixed_point_firmwares
def test_a_new_neighbour_votes_as_soon_as_its_slot_is_reached(firmware: FixedPointFirmware) -> None:
    """It need not wait until all that were there before it have voted."""
    robot = firmware(ONLY_VOTES, OWN_ID, b_hat=0.95)
    robot.receive(sender=6, x_hat=0.5, alpha=1.0)
    robot.receive(sender=9, x_hat=0.5, alpha=1.0)
    robot.settle()  # slot 6 votes

    robot.receive(sender=7, x_hat=0.5, alpha=1.0)

    assert voters_of_rounds(robot, 3) == [7, 9, 6]


@for_fixed_point_firmwares
def test_a_robot_s_own_vote_moves_what_it_believes_towards_what_it_has_seen(
    firmware: FixedPointFirmware,
) -> None:
    robot = firmware(ONLY_VOTES, OWN_ID, b_hat=0.95)
    observe_tiles(robot, black=9, white=0)  # the robot's own estimate is 1
    receive_estimates(robot, 0.5)
    robot.settle()  # the neighbour votes
    assert robot.x == 0.5

    robot.settle()  # the robot votes

    # The vote counts an eighth of the spread, which the neighbour's has narrowed from 1/4 by a sixteenth.
    spread = 1 / 4 * (1 - 1 / 16)
    assert robot.x == 0.5 + spread / 8


@for_fixed_point_firmwares
@pytest.mark.parametrize("vote", [1.0, 0.75, 0.625, 0.5, 0.375, 0.0])
def test_a_vote_far_away_moves_what_the_robot_believes_no_further_than_one_at_a_limit(
    firmware: FixedPointFirmware, vote: float
) -> None:
    """A vote counts an eighth of its distance, and at most an eighth of the spread, which is 1/4 at first.

    A neighbour that lies as much as it can moves a robot no more than one that is off by a quarter.
    """
    robot = firmware(ROBUST, OWN_ID, b_hat=0.95)
    receive_estimates(robot, vote)

    robot.settle()  # the neighbour votes

    limited_distance = min(max(vote - 0.5, -1 / 4), 1 / 4)
    assert robot.x == 0.5 + limited_distance / 8


@for_fixed_point_firmwares
@pytest.mark.parametrize(
    ("votes", "gain"),
    [
        *((0, 1 / 8), (62, 1 / 8), (63, 1 / 16), (126, 1 / 16), (127, 1 / 32)),
        *((255, 1 / 64), (510, 1 / 64), (511, 1 / 128), (512, 1 / 128)),
    ],
)
def test_the_more_votes_there_were_the_less_one_more_counts(
    firmware: FixedPointFirmware, votes: int, gain: float
) -> None:
    """From an eighth of the spread, 2**28, at first, to 1/128 of it. The centre of the votes starts at 2**29.

    Both are in units of 2**-30.
    """
    robot = restore_robust_robot(firmware, estimates=[0], votes=votes)

    robot.settle()  # a neighbour whose estimate is 0 votes

    assert filter_memory(robot)["centre"] == 2**29 - 2**28 * gain


@for_fixed_point_firmwares
@pytest.mark.parametrize(
    ("slot_estimate", "sixteenths"),
    [
        (0x8000 + (1 << 12), 15),  # the distance is the spread
        (0x8000 + (1 << 12) + 1, 17),
        (0x8000 - (1 << 12) - 1, 17),
    ],
)
def test_a_vote_outside_the_spread_widens_it_by_a_sixteenth_and_one_inside_narrows_it(
    firmware: FixedPointFirmware, slot_estimate: int, sixteenths: int
) -> None:
    """The spread is 1/16 around 1/2, in units of 2**-30; estimates of neighbours are in units of 2**-16."""
    spread = 2**30 // 16
    robot = restore_robust_robot(firmware, estimates=[slot_estimate], votes=1, spread=spread)

    robot.settle()  # the neighbour votes

    assert filter_memory(robot)["spread"] == spread * sixteenths // 16


@for_fixed_point_firmwares
@pytest.mark.parametrize(
    ("limit", "slot_estimate"),
    [
        pytest.param(2**18, 0x8000, id="narrowed by a vote in the middle"),
        pytest.param(2**28, 0, id="widened by a vote at the end"),
    ],
)
def test_no_vote_brings_the_spread_beyond_its_limits(
    firmware: FixedPointFirmware, limit: int, slot_estimate: int
) -> None:
    """They are 2**-12 and 1/4, in units of 2**-30."""
    robot = restore_robust_robot(firmware, estimates=[slot_estimate], votes=1, spread=limit)

    robot.settle()  # the neighbour votes

    assert filter_memory(robot)["spread"] == limit


@for_fixed_point_firmwares
def test_no_more_than_512_votes_are_counted(firmware: FixedPointFirmware) -> None:
    """So that the last votes always count something, and a changed floor is noticed."""
    robot = restore_robust_robot(firmware, estimates=[0x8000], votes=511)

    robot.settle()  # vote 512
    robot.settle()

    assert filter_memory(robot)["votes"] == 512


@for_fixed_point_firmwares
def test_a_neighbour_that_sends_more_often_has_no_more_influence(firmware: FixedPointFirmware) -> None:
    """Robot 6 sends in every round that three quarters are black; robots 7 and 8 sent a quarter once."""
    robot = firmware(ONLY_VOTES, OWN_ID, b_hat=0.95)
    robot.receive(sender=7, x_hat=0.25, alpha=1.0)
    robot.receive(sender=8, x_hat=0.25, alpha=1.0)

    for _ in range(3000):
        robot.receive(sender=6, x_hat=0.75, alpha=1.0)
        robot.settle()

    assert robot.x == pytest.approx(0.25, abs=0.01)


# --- The filter ------------------------------------------------------------------------------------------


@for_fixed_point_firmwares
@pytest.mark.parametrize(("estimate_count", "tests"), [(4, 0), (5, 1)])
def test_a_robot_tests_itself_only_against_five_neighbours_or_more(
    firmware: FixedPointFirmware, estimate_count: int, tests: int
) -> None:
    robot = firmware(ROBUST, OWN_ID, b_hat=0.95)
    observe_tiles(robot, black=9, white=1)
    receive_estimates(robot, *[0.25] * estimate_count)

    robot.settle()  # ends the round, in which the filter runs

    assert robot.counters.tests == tests


@for_fixed_point_firmwares
def test_a_robot_that_has_observed_nothing_does_not_test_itself(firmware: FixedPointFirmware) -> None:
    robot = firmware(ROBUST, OWN_ID, b_hat=0.95)
    receive_estimates(robot, *[0.25] * 5)

    status = robot.settle()  # ends the round, in which the filter runs

    assert status == Status.OK
    assert robot.counters.tests == 0


# design: R37
@for_fixed_point_firmwares
def test_a_robot_whose_observations_contradict_the_others_estimates_its_accuracy_anew(
    firmware: FixedPointFirmware,
) -> None:
    """It sees 0.545 of the tiles black, but all others estimate that 0.95 of them are.

    With its b_hat of 0.95 it would see 0.95 * 0.95 + 0.05 * 0.05 = 0.905 of them black. Its new b_hat is the
    accuracy that explains what it sees (eq. 8 of the paper): (0.545 + 0.95 - 1) / (2 * 0.95 - 1) = 0.55.
    """
    fill_ratio_of_others = 0.95
    robot = firmware(ROBUST, OWN_ID, b_hat=0.95)
    observe_tiles(robot, black=545, white=455)
    receive_estimates(robot, *[fill_ratio_of_others] * 5)

    status = robot.settle()  # ends the round, in which the filter runs

    assert status == Status.UPDATED
    assert robot.b_hat == pytest.approx(0.55, abs=1e-4)
    assert robot.counters.tests == 1
    assert robot.counters.updates == 1


@for_fixed_point_firmwares
def test_a_robot_that_agrees_with_the_others_trusts_its_sensor(
    firmware: FixedPointFirmware,
) -> None:
    """It sees 0.905 of the tiles black: what a sensor that is right in 0.95 sees where 0.95 are black."""
    robot = firmware(ROBUST, OWN_ID, b_hat=0.95)
    observe_tiles(robot, black=905, white=95)
    receive_estimates(robot, *[0.95] * 5)

    status = robot.settle()  # ends the round, in which the filter runs

    assert status == Status.OK
    assert robot.counters.tests == 1
    assert robot.b_hat_raw == ROBUST_B_HAT


# design: R37
@for_fixed_point_firmwares
def test_a_robot_that_was_misled_trusts_its_sensor_again_when_the_others_agree_with_it(
    firmware: FixedPointFirmware,
) -> None:
    """It sees 0.905 of the tiles black: what a sensor that is right in 0.95 sees where 0.95 are black."""
    robot = firmware(ROBUST, OWN_ID, b_hat=0.95)
    observe_tiles(robot, black=905, white=95)
    receive_estimates(robot, *[0.25] * 5)
    assert robot.settle() == Status.UPDATED

    receive_estimates(robot, *[0.95] * 5)
    assert robot.settle() == Status.UPDATED

    assert robot.b_hat_raw == ROBUST_B_HAT
    assert robot.counters.updates == 2


@for_fixed_point_firmwares
def test_a_robot_tests_the_accuracy_that_it_had_at_the_start(firmware: FixedPointFirmware) -> None:
    """With its new accuracy it agrees with the others, which must not bring the old one back."""
    robot = firmware(ROBUST, OWN_ID, b_hat=0.95)
    observe_tiles(robot, black=545, white=455)
    receive_estimates(robot, *[0.95] * 5)
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
    receive_estimates(robot, *[0.5] * 5)

    status = robot.settle()  # ends the round, in which the filter runs

    assert status == Status.OK
    assert robot.counters.tests == 1
    assert robot.b_hat_raw == ROBUST_B_HAT


@for_fixed_point_firmwares
@pytest.mark.parametrize(
    ("supporters", "opponents", "status"), [(2, 3, Status.UPDATED), (3, 4, Status.OK), (3, 5, Status.UPDATED)]
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
    lie = 0.0
    receive_estimates(robot, 0.94, 0.95, 0.95, 0.96, lie)

    status = robot.settle()  # ends the round, in which the filter runs

    assert status == Status.OK
    assert robot.counters.tests == 1


# design: R37
@for_fixed_point_firmwares
@pytest.mark.parametrize(("t", "status"), [(3_804_264, Status.OK), (3_804_263, Status.UPDATED)])
def test_a_robot_keeps_its_accuracy_at_the_very_limit_of_its_test(
    firmware: FixedPointFirmware, t: int, status: Status
) -> None:
    """After one observation less it would change it. The test compares a deviation with a limit.

    Counts for which both are equal are rare, so they were searched for: both sides are 43681824.
    """
    largest_b_hat = 2**32 - 2**12
    robot = restore_robust_robot(
        firmware,
        t=t,
        n=3227,
        batch_t=t,
        batch_n=3227,
        b_hat=largest_b_hat,
        initial_b_hat=largest_b_hat,
        estimates=[0] * 5,
    )

    assert robot.settle() == status


@for_fixed_point_firmwares
@pytest.mark.parametrize(("filter_period", "tests"), [(1, 3), (2, 1), (3, 1), (4, 0)])
def test_a_robot_tests_itself_once_in_each_filter_period(
    firmware: FixedPointFirmware, filter_period: int, tests: int
) -> None:
    """The period is a number of rounds; here three rounds end."""
    robot = firmware(replace(ROBUST, filter_period=filter_period), OWN_ID, b_hat=0.95)
    observe_tiles(robot, black=9, white=1)
    receive_estimates(robot, *[0.9] * 5)

    for _ in range(3):
        robot.settle()  # ends a round

    assert robot.counters.tests == tests


# --- Centre and spread of the estimates ------------------------------------------------------------------


@pytest.mark.parametrize(
    ("values", "median"), [([1, 2, 9], 2), ([1, 2, 6, 9], 4), ([1, 2, 5, 9], 3), ([0, 1, 7, 8, 9, 9], 7)]
)
def test_the_median_of_an_even_number_is_the_mean_of_the_middle_two_rounded_down(
    values: list[int], median: int
) -> None:
    """And that of an odd number is the middle one. The values are in ascending order."""
    assert median_of(values) == median


SIXTEENTH = 2**20
"""An estimate of 1/16 in units of 2**-24."""


@pytest.mark.parametrize(
    ("sixteenths", "spread"),
    [
        ([1, 2, 4, 5, 15], 2 * SIXTEENTH),
        ([0, 0, 4, 15, 15], 4 * SIXTEENTH),
        pytest.param([4, 4, 4, 4, 4], 2**12, id="all distances are 0, and the spread is at least 2**-12"),
        pytest.param([0, 0, 8, 15, 15], 4 * SIXTEENTH, id="the median distance is 7/16, but 1/4 is the most"),
    ],
)
def test_the_spread_is_the_median_distance_from_the_median_within_limits(
    sixteenths: list[int], spread: int
) -> None:
    """Estimates and spread are in units of 2**-24. The third of five ascending estimates is the median."""
    estimates = [number * SIXTEENTH for number in sixteenths]
    assert spread_of(estimates, median=estimates[2]) == spread


def slot_estimates(*numbers: int) -> list[int]:
    """Return estimates in the units of a slot, 2**-16, as the filter computes with them: units of 2**-24."""
    return [number * 2**8 for number in numbers]


def test_an_estimate_far_away_counts_as_one_at_the_distance_of_the_spread() -> None:
    """Two lie below by a spread or more, and two above: they balance, however far one of them is."""
    estimates = slot_estimates(1000, 2000, 3000, 4000, 60000)
    [median, spread] = slot_estimates(3000, 1000)
    assert huber_centre(estimates, median, spread) == median


def test_the_centre_of_estimates_within_the_spread_is_their_mean() -> None:
    """It is found step by step, and may be wrong by two units of 2**-24."""
    estimates = slot_estimates(1000, 2000, 6000)
    [median, mean, spread] = slot_estimates(2000, 3000, 5000)
    assert huber_centre(estimates, median, spread) == pytest.approx(mean, abs=2)


@pytest.mark.parametrize(
    ("estimate_of_all", "centre"), [(LARGEST_ESTIMATE, LARGEST_ESTIMATE - 5000), (0, 5000)]
)
def test_the_centre_of_neighbours_at_an_end_of_the_range_stays_within_it(
    estimate_of_all: int, centre: int
) -> None:
    """No estimate is within the spread, so the centre would move by five spreads, which is too far."""
    spread = 2**12
    assert 5 * spread > 5000, "beyond the range"

    new_centre = centre_after_huber_step([estimate_of_all] * 5, centre, spread)

    assert new_centre == estimate_of_all


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
    assert [dispersion_after_batch(robot, black=60, white=40) for _ in range(3)] == [INDEPENDENT] * 3


@for_fixed_point_firmwares
def test_a_batch_that_is_off_raises_the_dispersion_by_an_eighth_of_its_ratio(
    firmware: FixedPointFirmware,
) -> None:
    """The dispersion says how much more batches vary than independent tiles would; it is 1 at first.

    Of 200 tiles so far 80 are black, so of the second batch's 100 it should be 40, with a variance of 24.
    """
    robot = firmware(ROBUST, OWN_ID, b_hat=0.95)
    dispersion_after_batch(robot, black=50, white=50)

    dispersion = dispersion_after_batch(robot, black=30, white=70)

    ratio = (40 - 30) ** 2 / 24
    units = 256
    assert dispersion == int((7 * 1 + ratio) / 8 * units)


@for_fixed_point_firmwares
def test_a_batch_that_is_far_off_counts_as_12_times_the_dispersion(firmware: FixedPointFirmware) -> None:
    """The dispersion says how much more batches vary than independent tiles would; it is 1 at first.

    Here a white batch follows a black one: that is 100 times the variance of independent tiles.
    """
    robot = firmware(ROBUST, OWN_ID, b_hat=0.95)
    dispersion_after_batch(robot, black=100, white=0)

    dispersion = dispersion_after_batch(robot, black=0, white=100)

    units, a_rounding = 256, 1
    assert dispersion == (7 * 1 + 12) / 8 * units - a_rounding


@for_fixed_point_firmwares
def test_the_dispersion_falls_by_an_eighth_with_each_batch_that_is_as_expected(
    firmware: FixedPointFirmware,
) -> None:
    """It says how much more batches of tiles vary than independent ones would, in units of 2**-8.

    Half of 100 tiles were black so far, and of each further batch it is half, too.
    """
    robot = restore_robust_robot(firmware, t=100, n=50, batch_t=100, batch_n=50, dispersion=1000)

    dispersions = [dispersion_after_batch(robot, black=50, white=50) for _ in range(3)]

    assert dispersions == [1000 * 7 // 8, 875 * 7 // 8, 765 * 7 // 8]


@for_fixed_point_firmwares
def test_the_dispersion_does_not_overflow_its_16_bits(firmware: FixedPointFirmware) -> None:
    """It says how much more batches of tiles vary than independent ones would, in units of 2**-8.

    5000 white tiles after a million, of which all but one were black, would raise it.
    """
    robot = restore_robust_robot(
        firmware, t=10**6, n=10**6 - 1, batch_t=999_900, batch_n=999_900, dispersion=2**16 - 1
    )

    assert dispersion_after_batch(robot, black=0, white=5000) == 2**16 - 1


@for_fixed_point_firmwares
def test_a_batch_without_observations_does_not_change_the_dispersion(firmware: FixedPointFirmware) -> None:
    robot = restore_robust_robot(firmware, t=100, n=50, batch_t=100, batch_n=50, dispersion=1000)
    assert dispersion_after_batch(robot, black=0, white=0) == 1000


@for_fixed_point_firmwares
def test_white_observations_alone_do_not_change_the_dispersion(firmware: FixedPointFirmware) -> None:
    """As many black tiles are expected as were seen, none, so there is no deviation to be measured."""
    robot = restore_robust_robot(firmware, t=100, n=0, batch_t=50, batch_n=0, dispersion=1000)
    assert dispersion_after_batch(robot, black=0, white=10) == 1000


@for_fixed_point_firmwares
def test_a_run_of_the_filter_begins_a_new_batch_of_observations(firmware: FixedPointFirmware) -> None:
    """Also one that decides nothing, since there are no neighbours. A batch begins with the counts so far."""
    robot = firmware(ROBUST, OWN_ID, b_hat=0.95)
    observe_tiles(robot, black=3, white=4)

    robot.settle()  # the filter runs

    memory = filter_memory(robot)
    assert memory["batch_t"] == 3 + 4
    assert memory["batch_n"] == 3


@for_fixed_point_firmwares
def test_a_new_batch_begins_where_the_robot_halves_its_counts(firmware: FixedPointFirmware) -> None:
    """It does so after as many observations as its memory holds, to forget old ones."""
    robot = firmware(replace(ONLY_VOTES, memory=64), OWN_ID, b_hat=0.95)

    observe_tiles(robot, black=40, white=24)

    memory = filter_memory(robot)
    assert robot.t == memory["batch_t"] == 64 // 2
    assert memory["batch_n"] == 40 // 2


@for_fixed_point_firmwares
@pytest.mark.parametrize(("dispersion", "status"), [(1, Status.UPDATED), (10, Status.OK)])
def test_a_robot_whose_observations_vary_more_than_chance_forgives_a_larger_deviation(
    firmware: FixedPointFirmware, dispersion: int, status: Status
) -> None:
    """850 of 1000 tiles black instead of 905 are 4.9 standard deviations of independent tiles too few.

    The status is UPDATED where the robot changes its accuracy, and OK where it does not.
    """
    neighbours = [int(0.95 * 2**16)] * 5
    robot = restore_robust_robot(
        firmware,
        t=1000,
        n=850,
        batch_t=1000,
        batch_n=850,
        estimates=neighbours,
        dispersion=dispersion * INDEPENDENT,
    )

    assert robot.settle() == status


# --- Images ----------------------------------------------------------------------------------------------


@pytest.mark.parametrize(("mode", "size"), [(Filter.ROBUST, 156), (Filter.OFF, 124), (Filter.ALWAYS, 124)])
@for_fixed_point_firmwares
def test_an_image_has_39_words_with_the_robust_filter_and_31_with_another(
    firmware: FixedPointFirmware, mode: Filter, size: int
) -> None:
    assert len(firmware(Config(filter=mode), OWN_ID, 0.95).save()) == size


# design: R29
def test_a_saved_robot_has_the_memory_of_its_filter_in_the_documented_order() -> None:
    """docs/design.md lists the 39 words of 32 bits; in another order saved robots could not be restored.

    Words 7 to 14 are the filter's, and words 15 to 30 the estimates of the neighbours, two in each word.
    """
    robot = MirrorRobot(ROBUST, OWN_ID, 0.95)
    # No robot that calls lead to has a different value in each field.
    robot.s.robust = RobustFilter(
        centre=7,
        spread=2**20,
        initial_b_hat=11,
        filled_slots=0b111,
        batch_t=5,
        batch_n=3,
        votes=9,
        dispersion=300,
        turn=2,
    )
    robot.s.estimates[:3] = [0x1111, 0x2222, 0x3333]

    words = struct.unpack("<39I", robot.save())

    magic, *_ = words
    filter_words, estimate_words = words[7:15], words[15:31]
    votes, dispersion = 9, 300
    assert magic == 0x4D435383, '"MCS" and, as there is a robust filter, 128 + version 3'
    assert filter_words == (7, 2**20, 11, 0b111, 5, 3, dispersion << 16 | votes, 2)
    assert estimate_words == (0x2222_1111, 0x0000_3333, *[0] * 14)


def status_of_restore(firmware: FixedPointFirmware, members: dict[str, Any]) -> Status:
    """Save a robot, after 4 black of 10 observations, with these members of its filter, and restore it.

    Returns OK, or the error. ``b_hat`` is the present one, in units of 2**-32; by default it is the initial
    one, 0.95.
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
def test_an_image_at_a_limit_is_accepted(firmware: FixedPointFirmware, members: dict[str, Any]) -> None:
    """An image is a saved robot. Each case has members of its robust filter at an end of their range.

    Accuracies are in units of 2**-32, centre and spread in units of 2**-30, the dispersion in units of 2**-8.
    """
    assert status_of_restore(firmware, members) == Status.OK


# design: R30
@for_fixed_point_firmwares
@pytest.mark.parametrize(
    "members",
    [
        {"initial_b_hat": 2**12 - 1, "b_hat": 2**12, "estimates": [0] * 5, "batch_t": 1},
        {"initial_b_hat": 2**32 - 2**12 + 1, "b_hat": 2**12, "estimates": [0] * 5, "batch_t": 1},
        {"dispersion": 2**8 - 1, "batch_t": 1},
        {"dispersion": 2**8 + 1, "batch_t": 0},
        {"batch_t": 3, "batch_n": 4},
        {"batch_t": 10, "batch_n": 5},
        {"batch_t": 7, "batch_n": 0},
        {"batch_t": 11, "batch_n": 4},
        {"b_hat": OTHER_B_HAT, "estimates": [0] * 4, "batch_t": 1},
        {"b_hat": OTHER_B_HAT, "estimates": [0] * 5, "batch_t": 0},
        {"votes": 0, "centre": 2**29 + 1},
        {"votes": 0, "spread": 2**28 - 1},
        {"votes": 0, "turn": 1},
        {"votes": 1, "estimates": []},
        {"votes": 2**9 + 1},
        {"centre": 2**30 + 1},
        {"spread": 2**18 - 1},
        {"spread": 2**28 + 1},
        {"turn": 2},
        {"turn": 33, "estimates": [0] * 32},
        {"turn": 256, "estimates": [0] * 32},
        {"filled_slots": 0b10, "estimates": [1, 1]},
    ],
)
def test_an_image_beyond_a_limit_is_refused(firmware: FixedPointFirmware, members: dict[str, Any]) -> None:
    """An image is a saved robot. Each case has members of its robust filter that no robot can have.

    Accuracies are in units of 2**-32, centre and spread in units of 2**-30, the dispersion in units of 2**-8.
    """
    assert status_of_restore(firmware, members) == Status.ERR_IMAGE
