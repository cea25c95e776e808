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

WITHOUT_TEST = replace(ROBUST, filter_period=1000)

LARGEST_ESTIMATE = (1 << 24) - (1 << 8)
"""The largest estimate of a slot in units of 2**-24."""
INDEPENDENT = 256
"""The dispersion of independent observations: 1 in units of 2**-8."""


def robust_members(robot: FixedPoint) -> dict[str, int]:
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
    robot = firmware(ROBUST, OWN_ID, 0.95)
    robot.receive(sender, 0.25, 1.0)
    assert filled_slots(robot) == {slot: 0x4000}


# design: R35
@for_fixed_point_firmwares
def test_senders_with_ids_equal_modulo_32_share_a_slot(firmware: FixedPointFirmware) -> None:
    robot = firmware(ROBUST, OWN_ID, 0.95)
    robot.receive(1, 0.25, 1.0)
    robot.receive(33, 0.5, 1.0)
    assert filled_slots(robot) == {1: 0x8000}


@for_fixed_point_firmwares
def test_the_estimate_of_a_later_round_replaces_an_earlier_one(firmware: FixedPointFirmware) -> None:
    robot = firmware(ROBUST, OWN_ID, 0.95)
    robot.receive(1, 0.25, 1.0)
    robot.settle()
    robot.receive(1, 0.5, 1.0)
    assert filled_slots(robot) == {1: 0x8000}


@for_fixed_point_firmwares
def test_a_repeated_message_does_not_replace_the_estimate(firmware: FixedPointFirmware) -> None:
    robot = firmware(ROBUST, OWN_ID, 0.95)
    robot.receive(1, 0.25, 1.0)
    assert robot.receive(1, 0.5, 1.0) == Status.REPEATED
    assert filled_slots(robot) == {1: 0x4000}


@for_fixed_point_firmwares
def test_a_round_without_messages_keeps_the_estimates(firmware: FixedPointFirmware) -> None:
    robot = firmware(ROBUST, OWN_ID, 0.95)
    robot.receive(1, 0.25, 1.0)
    robot.settle()
    robot.settle()
    assert filled_slots(robot) == {1: 0x4000}


@for_fixed_point_firmwares
@pytest.mark.parametrize(
    ("x_hat", "slot_estimate"),
    [(63, 0), (64, 1), (HALF - 65, 32767), (HALF, 32768), (ONE - 65, 65535), (ONE - 64, 65535), (ONE, 65535)],
)
def test_an_estimate_is_rounded_to_the_nearest_that_a_slot_can_hold(
    firmware: FixedPointFirmware, x_hat: int, slot_estimate: int
) -> None:
    robot = firmware(ROBUST, OWN_ID, 0.95)
    robot.receive_raw(1, x_hat, ALPHA_ONE)
    assert filled_slots(robot) == {1: slot_estimate}


@for_fixed_point_firmwares
@pytest.mark.parametrize("alpha", [0, 0x1F, 0xFF])
def test_a_message_without_confidence_is_accepted_but_not_kept(
    firmware: FixedPointFirmware, alpha: int
) -> None:
    robot = firmware(ROBUST, OWN_ID, 0.95)
    assert robot.receive_raw(1, HALF, alpha) == Status.OK
    assert filled_slots(robot) == {}
    assert robot.counters == Counters(accepted=1)


@for_fixed_point_firmwares
def test_a_robot_with_the_robust_filter_has_no_sums_of_rounds(firmware: FixedPointFirmware) -> None:
    robot = firmware(ROBUST, OWN_ID, 0.95)
    receive_estimates(robot, 0.25, 0.5)
    robot.settle()
    receive_estimates(robot, 0.25, 0.5)
    sums = [value for name, value in robot.state().items() if name.startswith(("open_", "closed_"))]
    assert sums == [0] * 9
    assert robot.beta == 0


@for_fixed_point_firmwares
def test_a_robot_with_another_filter_keeps_no_estimates(firmware: FixedPointFirmware) -> None:
    robot = firmware(Config(filter=Filter.OFF), OWN_ID, 0.95)
    receive_estimates(robot, 0.25, 0.5)
    robot.settle()
    assert filled_slots(robot) == {}
    assert {value for name, value in robot.state().items() if name.startswith("estimates_")} == {0}


# --- Votes -----------------------------------------------------------------------------------------------


# design: R36
@for_fixed_point_firmwares
def test_before_the_first_vote_x_is_the_own_estimate(firmware: FixedPointFirmware) -> None:
    robot = firmware(ROBUST, OWN_ID, 0.95)
    observe_tiles(robot, black=9, white=1)
    receive_estimates(robot, 0.25)
    assert (robot.x, robot.x_bar) == (robot.x_hat, 0.5)


# design: R36
@for_fixed_point_firmwares
def test_x_and_x_bar_are_the_centre_of_the_votes(firmware: FixedPointFirmware) -> None:
    robot = restore_robust_robot(firmware, estimates=[0], votes=1, centre=(3 << 28) + 127)
    assert (robot.x_raw, robot.x_bar_raw) == (3 << 21, 3 << 21)


@for_fixed_point_firmwares
def test_a_round_has_one_vote_however_many_estimates_there_are(firmware: FixedPointFirmware) -> None:
    robot = firmware(ROBUST, OWN_ID, 0.95)
    receive_estimates(robot, 0.25, 0.5, 0.75)
    robot.settle()
    assert robust_members(robot)["votes"] == 1


@for_fixed_point_firmwares
def test_without_estimates_of_others_there_is_no_vote(firmware: FixedPointFirmware) -> None:
    robot = firmware(ROBUST, OWN_ID, 0.95)
    robot.step(Observation.BLACK)
    assert robust_members(robot)["votes"] == 0


def turns_of_rounds(robot: FixedPoint, rounds: int) -> list[int]:
    """Return the turn after each of so many rounds."""
    turns = []
    for _ in range(rounds):
        robot.settle()
        turns.append(robust_members(robot)["turn"])
    return turns


@for_fixed_point_firmwares
def test_slots_vote_in_ascending_order_and_the_own_estimate_after_them(firmware: FixedPointFirmware) -> None:
    robot = firmware(WITHOUT_TEST, OWN_ID, 0.95)
    robot.observe(Observation.BLACK)
    for sender in (9, 6, 39):  # slots 9, 6 and 7
        robot.receive(sender, 0.5, 1.0)
    assert turns_of_rounds(robot, 6) == [7, 8, 10, 0, 7, 8]


@for_fixed_point_firmwares
def test_the_own_estimate_without_confidence_is_passed_over(firmware: FixedPointFirmware) -> None:
    robot = firmware(WITHOUT_TEST, OWN_ID, 0.95)
    for sender in (6, 31):
        robot.receive(sender, 0.5, 1.0)
    assert turns_of_rounds(robot, 4) == [7, 32, 7, 32]


@for_fixed_point_firmwares
@pytest.mark.parametrize(("alpha", "turn"), [(0, 1), (ALPHA_MIN, 0)])
def test_the_smallest_confidence_is_enough_for_the_own_estimate_to_vote(
    firmware: FixedPointFirmware, alpha: int, turn: int
) -> None:
    """The slot has voted, so it is the robot's own turn. After its vote the turn is 0.

    Any alpha is possible in a robot whose b_hat has just been re-estimated (word 37 of the image).
    """
    image = restore_robust_robot(firmware, t=1, estimates=[0], turn=1, votes=1).save()
    words = (5, alpha, 37, OWN_ID << 24 | 1 << 16)
    robot = firmware.restore(ROBUST, edited_image(image, Call("restore", words)))
    robot.settle()
    assert robust_members(robot)["turn"] == turn


@for_fixed_point_firmwares
def test_after_slot_31_it_is_the_turn_of_the_own_estimate(firmware: FixedPointFirmware) -> None:
    robot = firmware(WITHOUT_TEST, OWN_ID, 0.95)
    robot.observe(Observation.BLACK)
    robot.receive(31, 0.5, 1.0)
    assert turns_of_rounds(robot, 3) == [32, 0, 32]


@for_fixed_point_firmwares
def test_a_slot_that_is_filled_ahead_of_the_turn_votes_next(firmware: FixedPointFirmware) -> None:
    robot = firmware(WITHOUT_TEST, OWN_ID, 0.95)
    for sender in (6, 9):
        robot.receive(sender, 0.5, 1.0)
    robot.settle()
    robot.receive(7, 0.5, 1.0)
    assert turns_of_rounds(robot, 3) == [8, 10, 7]


@for_fixed_point_firmwares
def test_the_vote_of_the_own_estimate_moves_x_towards_x_hat(firmware: FixedPointFirmware) -> None:
    robot = firmware(WITHOUT_TEST, OWN_ID, 0.95)
    observe_tiles(robot, black=9, white=0)  # x_hat = 1
    receive_estimates(robot, 0.5)
    robot.settle()
    assert robot.x == 0.5
    robot.settle()
    # An eighth of the spread, which the first vote has narrowed from 1/4 to 15/64.
    assert robot.x == 0.5 + 15 / 512


@for_fixed_point_firmwares
@pytest.mark.parametrize(
    ("vote", "x"),
    [(1.0, 0.53125), (0.75, 0.53125), (0.625, 0.515625), (0.5, 0.5), (0.375, 0.484375), (0.0, 0.46875)],
)
def test_the_first_vote_moves_x_by_an_eighth_of_its_distance_up_to_the_spread(
    firmware: FixedPointFirmware, vote: float, x: float
) -> None:
    """The spread is 1/4 before the first vote."""
    robot = firmware(ROBUST, OWN_ID, 0.95)
    receive_estimates(robot, vote)
    robot.settle()
    assert robot.x == x


@for_fixed_point_firmwares
@pytest.mark.parametrize(
    ("votes", "step"),
    [
        *((0, 2**25), (62, 2**25), (63, 2**24), (126, 2**24), (127, 2**23)),
        *((255, 2**22), (510, 2**22), (511, 2**21), (512, 2**21)),
    ],
)
def test_the_gain_falls_with_the_votes_from_an_eighth_to_one_in_128(
    firmware: FixedPointFirmware, votes: int, step: int
) -> None:
    """The spread is 2**28."""
    robot = restore_robust_robot(firmware, estimates=[0], votes=votes)
    robot.settle()
    assert robust_members(robot)["centre"] == 2**29 - step


@for_fixed_point_firmwares
@pytest.mark.parametrize(
    ("spread", "slot_estimate", "new_spread"),
    [
        (1 << 26, 0x8000 + (1 << 12), (1 << 26) - (1 << 22)),  # at the distance of the spread: narrower
        (1 << 26, 0x8000 + (1 << 12) + 1, (1 << 26) + (1 << 22)),
        (1 << 26, 0x8000 - (1 << 12) - 1, (1 << 26) + (1 << 22)),
        (1 << 18, 0x8000, 1 << 18),
        (1 << 28, 0, 1 << 28),
    ],
)
def test_a_vote_outside_widens_the_spread_and_one_inside_narrows_it_within_limits(
    firmware: FixedPointFirmware, spread: int, slot_estimate: int, new_spread: int
) -> None:
    robot = restore_robust_robot(firmware, estimates=[slot_estimate], votes=1, spread=spread)
    robot.settle()
    assert robust_members(robot)["spread"] == new_spread


@for_fixed_point_firmwares
def test_no_more_than_512_votes_are_counted(firmware: FixedPointFirmware) -> None:
    robot = restore_robust_robot(firmware, estimates=[0x8000], votes=511)
    robot.settle()
    robot.settle()
    assert robust_members(robot)["votes"] == 512


@for_fixed_point_firmwares
def test_a_robot_that_is_received_more_often_has_no_more_votes(firmware: FixedPointFirmware) -> None:
    """Robot 6 is received in every round, and robots 7 and 8 once."""
    robot = firmware(WITHOUT_TEST, OWN_ID, 0.95)
    robot.receive(7, 0.25, 1.0)
    robot.receive(8, 0.25, 1.0)
    for _ in range(3000):
        robot.receive(6, 0.75, 1.0)
        robot.settle()
    assert robot.x == pytest.approx(0.25, abs=0.01)


# --- The filter ------------------------------------------------------------------------------------------


@for_fixed_point_firmwares
@pytest.mark.parametrize(("estimate_count", "tests"), [(4, 0), (5, 1)])
def test_a_robot_tests_itself_against_five_estimates_or_more(
    firmware: FixedPointFirmware, estimate_count: int, tests: int
) -> None:
    robot = firmware(ROBUST, OWN_ID, 0.95)
    observe_tiles(robot, black=9, white=1)
    receive_estimates(robot, *[0.25] * estimate_count)
    robot.settle()
    assert robot.counters.tests == tests


@for_fixed_point_firmwares
def test_before_the_first_observation_a_robust_robot_does_not_test(firmware: FixedPointFirmware) -> None:
    robot = firmware(ROBUST, OWN_ID, 0.95)
    receive_estimates(robot, *[0.25] * 5)
    assert robot.settle() == Status.OK
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
    assert robot.settle() == Status.UPDATED
    assert robot.b_hat == pytest.approx(0.55, abs=1e-4)
    assert robot.counters.tests == 1
    assert robot.counters.updates == 1


@for_fixed_point_firmwares
def test_a_robot_that_agrees_with_the_others_keeps_b_hat(firmware: FixedPointFirmware) -> None:
    robot = firmware(ROBUST, OWN_ID, 0.95)
    observe_tiles(robot, black=905, white=95)
    receive_estimates(robot, *[0.95] * 5)
    assert robot.settle() == Status.OK
    assert (robot.b_hat_raw, robot.counters.tests) == (ROBUST_B_HAT, 1)


# design: R37
@for_fixed_point_firmwares
def test_the_initial_b_hat_comes_back_when_the_others_no_longer_contradict_it(
    firmware: FixedPointFirmware,
) -> None:
    robot = firmware(ROBUST, OWN_ID, 0.95)
    observe_tiles(robot, black=905, white=95)
    receive_estimates(robot, *[0.25] * 5)
    assert robot.settle() == Status.UPDATED
    receive_estimates(robot, *[0.95] * 5)
    assert robot.settle() == Status.UPDATED
    assert (robot.b_hat_raw, robot.counters.updates) == (ROBUST_B_HAT, 2)


@for_fixed_point_firmwares
def test_the_test_is_about_the_initial_b_hat_and_not_the_present_one(firmware: FixedPointFirmware) -> None:
    """With the re-estimated b_hat the robot agrees with the others; it is rejected again nevertheless."""
    robot = firmware(ROBUST, OWN_ID, 0.95)
    observe_tiles(robot, black=545, white=455)
    receive_estimates(robot, *[0.95] * 5)
    robot.settle()
    re_estimated = robot.b_hat
    assert robot.settle() == Status.UPDATED
    assert robot.b_hat == re_estimated != 0.95


# design: R25
@for_fixed_point_firmwares
def test_a_centre_of_a_half_leaves_b_hat_as_it_is(firmware: FixedPointFirmware) -> None:
    robot = firmware(ROBUST, OWN_ID, 0.95)
    observe_tiles(robot, black=100, white=0)
    receive_estimates(robot, *[0.5] * 5)
    assert robot.settle() == Status.OK
    assert (robot.b_hat_raw, robot.counters.tests) == (ROBUST_B_HAT, 1)


@for_fixed_point_firmwares
@pytest.mark.parametrize(
    ("supporters", "opponents", "status"), [(2, 3, Status.UPDATED), (3, 4, Status.OK), (3, 5, Status.UPDATED)]
)
def test_a_robot_that_more_than_two_fifths_support_keeps_b_hat(
    firmware: FixedPointFirmware, supporters: int, opponents: int, status: Status
) -> None:
    """545 of 1000 black: 0.55 of the tiles by the own b_hat, so those who send 0.55 support the robot."""
    robot = firmware(ROBUST, OWN_ID, 0.95)
    observe_tiles(robot, black=545, white=455)
    receive_estimates(robot, *[0.55] * supporters, *[0.95] * opponents)
    assert robot.settle() == status


@for_fixed_point_firmwares
def test_a_liar_of_five_does_not_move_the_centre_by_much(firmware: FixedPointFirmware) -> None:
    robot = firmware(ROBUST, OWN_ID, 0.95)
    observe_tiles(robot, black=905, white=95)  # as 0.95 of the tiles are black
    receive_estimates(robot, 0.94, 0.95, 0.95, 0.96, 0.0)
    assert robot.settle() == Status.OK
    assert robot.counters.tests == 1


# design: R37
@for_fixed_point_firmwares
@pytest.mark.parametrize(("t", "status"), [(3_804_264, Status.OK), (3_804_263, Status.UPDATED)])
def test_a_robot_keeps_b_hat_where_both_sides_of_its_test_are_equal(
    firmware: FixedPointFirmware, t: int, status: Status
) -> None:
    """Such counts are rare, so they were searched for: both sides are 43681824."""
    largest_b_hat = 2**32 - 2**12
    counts = {"t": t, "n": 3227, "batch_t": t, "batch_n": 3227}
    robot = restore_robust_robot(
        firmware, **counts, b_hat=largest_b_hat, initial_b_hat=largest_b_hat, estimates=[0] * 5
    )
    assert robot.settle() == status


@for_fixed_point_firmwares
@pytest.mark.parametrize(("filter_period", "tests"), [(1, 3), (2, 1), (3, 1), (4, 0)])
def test_the_robust_filter_runs_every_filter_period(
    firmware: FixedPointFirmware, filter_period: int, tests: int
) -> None:
    robot = firmware(replace(ROBUST, filter_period=filter_period), OWN_ID, 0.95)
    observe_tiles(robot, black=9, white=1)
    receive_estimates(robot, *[0.9] * 5)
    for _ in range(3):
        robot.settle()
    assert robot.counters.tests == tests


# --- Centre and spread of the estimates ------------------------------------------------------------------


@pytest.mark.parametrize(
    ("values", "median"), [([1, 2, 9], 2), ([1, 2, 6, 9], 4), ([1, 2, 5, 9], 3), ([0, 1, 7, 8, 9, 9], 7)]
)
def test_the_median_of_an_even_number_is_the_mean_of_the_middle_two_rounded_down(
    values: list[int], median: int
) -> None:
    assert median_of(values) == median


@pytest.mark.parametrize(
    ("estimates", "spread"),
    [
        ([1 << 20, 2 << 20, 4 << 20, 5 << 20, 15 << 20], 2 << 20),
        ([4 << 20] * 5, 1 << 12),
        ([0, 0, 4 << 20, 15 << 20, 15 << 20], 4 << 20),
        ([0, 0, 8 << 20, 15 << 20, 15 << 20], 4 << 20),  # 7 << 20, but at most 1/4
    ],
)
def test_the_spread_is_the_median_distance_from_the_median_within_limits(
    estimates: list[int], spread: int
) -> None:
    assert spread_of(estimates, median=estimates[2]) == spread


def test_an_estimate_far_away_counts_as_one_at_the_distance_of_the_spread() -> None:
    """Two lie below by a spread or more, and two above: they balance, however far one of them is."""
    estimates = [value << 8 for value in (1000, 2000, 3000, 4000, 60000)]
    assert huber_centre(estimates, median=3000 << 8, spread=1000 << 8) == 3000 << 8


def test_the_centre_of_estimates_within_the_spread_is_their_mean() -> None:
    estimates = [value << 8 for value in (1000, 2000, 6000)]
    centre = huber_centre(estimates, median=2000 << 8, spread=5000 << 8)
    assert centre == pytest.approx(3000 << 8, abs=2)


@pytest.mark.parametrize(
    ("estimate_of_all", "centre"), [(LARGEST_ESTIMATE, LARGEST_ESTIMATE - 5000), (0, 5000)]
)
def test_a_step_of_the_centre_does_not_leave_the_range_of_an_estimate(
    estimate_of_all: int, centre: int
) -> None:
    """No estimate is within the spread, so the step is five spreads, which is too far."""
    new_centre = centre_after_huber_step([estimate_of_all] * 5, centre, spread=1 << 12)
    assert new_centre == estimate_of_all


# --- The dispersion --------------------------------------------------------------------------------------


def dispersion_after_batch(robot: FixedPoint, black: int, white: int) -> int:
    """Let a robot observe a batch and run its filter, and return the dispersion, in units of 2**-8."""
    observe_tiles(robot, black, white)
    robot.settle()
    return robust_members(robot)["dispersion"]


@for_fixed_point_firmwares
def test_batches_with_equal_shares_of_black_keep_the_dispersion_at_1(firmware: FixedPointFirmware) -> None:
    robot = firmware(ROBUST, OWN_ID, 0.95)
    assert [dispersion_after_batch(robot, black=60, white=40) for _ in range(3)] == [INDEPENDENT] * 3


@for_fixed_point_firmwares
def test_the_ratio_of_a_batch_counts_an_eighth_in_the_dispersion(firmware: FixedPointFirmware) -> None:
    """The second batch has 30 black of 100 where n / t is 0.4: 10 too few, which is 100 / 24 variances.

    (7 + 100 / 24) / 8 = 1.3958, and 256 times this is 357.3.
    """
    robot = firmware(ROBUST, OWN_ID, 0.95)
    dispersion_after_batch(robot, black=50, white=50)
    assert dispersion_after_batch(robot, black=30, white=70) == 357


@for_fixed_point_firmwares
def test_an_outlier_counts_as_12_times_the_dispersion(firmware: FixedPointFirmware) -> None:
    """A white batch after a black one: 100 variances. (7 + 12) / 8 = 2.375, less a unit by rounding."""
    robot = firmware(ROBUST, OWN_ID, 0.95)
    dispersion_after_batch(robot, black=100, white=0)
    assert dispersion_after_batch(robot, black=0, white=100) == 2.375 * 256 - 1


@for_fixed_point_firmwares
def test_the_dispersion_falls_back_where_batches_are_alike(firmware: FixedPointFirmware) -> None:
    robot = restore_robust_robot(firmware, t=100, n=50, batch_t=100, batch_n=50, dispersion=1000)
    dispersions = [dispersion_after_batch(robot, black=50, white=50) for _ in range(3)]
    assert dispersions == [1000 * 7 // 8, 875 * 7 // 8, 765 * 7 // 8]


@for_fixed_point_firmwares
def test_the_dispersion_is_limited_to_16_bits(firmware: FixedPointFirmware) -> None:
    robot = restore_robust_robot(
        firmware, t=10**6, n=999_999, batch_t=999_900, batch_n=999_900, dispersion=65535
    )
    assert dispersion_after_batch(robot, black=0, white=5000) == 65535


@for_fixed_point_firmwares
def test_a_batch_without_observations_does_not_change_the_dispersion(firmware: FixedPointFirmware) -> None:
    robot = restore_robust_robot(firmware, t=100, n=50, batch_t=100, batch_n=50, dispersion=1000)
    assert dispersion_after_batch(robot, black=0, white=0) == 1000


@for_fixed_point_firmwares
def test_white_observations_alone_do_not_change_the_dispersion(firmware: FixedPointFirmware) -> None:
    robot = restore_robust_robot(firmware, t=100, n=0, batch_t=50, batch_n=0, dispersion=1000)
    assert dispersion_after_batch(robot, black=0, white=10) == 1000


@for_fixed_point_firmwares
def test_a_run_of_the_filter_begins_a_new_batch_whatever_it_decides(firmware: FixedPointFirmware) -> None:
    robot = firmware(ROBUST, OWN_ID, 0.95)
    dispersion_after_batch(robot, black=3, white=4)
    members = robust_members(robot)
    assert (members["batch_t"], members["batch_n"]) == (7, 3)


@for_fixed_point_firmwares
def test_halving_the_counts_begins_a_new_batch(firmware: FixedPointFirmware) -> None:
    robot = firmware(replace(WITHOUT_TEST, memory=64), OWN_ID, 0.95)
    observe_tiles(robot, black=40, white=24)
    members = robust_members(robot)
    assert (robot.t, members["batch_t"], members["batch_n"]) == (32, 32, 20)


@for_fixed_point_firmwares
@pytest.mark.parametrize(("dispersion", "status"), [(256, Status.UPDATED), (2560, Status.OK)])
def test_a_robot_with_a_large_dispersion_allows_for_a_large_deviation(
    firmware: FixedPointFirmware, dispersion: int, status: Status
) -> None:
    """850 of 1000 black instead of 905 are 4.9 standard deviations of independent observations too few."""
    counts = {"t": 1000, "n": 850, "batch_t": 1000, "batch_n": 850}
    robot = restore_robust_robot(firmware, **counts, estimates=[62259] * 5, dispersion=dispersion)
    assert robot.settle() == status


# --- Images ----------------------------------------------------------------------------------------------


@pytest.mark.parametrize(("mode", "size"), [(Filter.ROBUST, 156), (Filter.OFF, 124), (Filter.ALWAYS, 124)])
@for_fixed_point_firmwares
def test_an_image_has_39_words_with_the_robust_filter_and_31_with_another(
    firmware: FixedPointFirmware, mode: Filter, size: int
) -> None:
    assert len(firmware(Config(filter=mode), OWN_ID, 0.95).save()) == size


# design: R29
def test_the_words_of_an_image_are_in_the_order_of_the_page() -> None:
    robot = MirrorRobot(ROBUST, OWN_ID, 0.95)
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
    assert words[0] == 0x4D435383
    assert words[7:15] == (7, 2**20, 11, 0b111, 5, 3, 9 | 300 << 16, 2)
    assert words[15:31] == (0x22221111, 0x00003333, *[0] * 14)


def status_of_restore(firmware: FixedPointFirmware, members: dict[str, Any]) -> Status:
    """Return the status of restoring a robot, after 4 black of 10 observations, with these members.

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
def test_an_image_at_a_limit_is_accepted(firmware: FixedPointFirmware, members: dict[str, Any]) -> None:
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
    assert status_of_restore(firmware, members) == Status.ERR_IMAGE
