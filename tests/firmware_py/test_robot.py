"""A robot's step, the same in every firmware: rounds, observations, memory, filter (docs/design.md)."""

from __future__ import annotations

import random

import pytest

from mcp_asdf.reference import ReferenceRobot
from mcp_asdf.robot import Config, Counters, Filter, FixedPointRobot, Observation, Robot, Status
from robots import (
    TABLE,
    Firmware,
    for_every_firmware,
    make_robot,
    observe_tiles,
    receive_estimates,
    status_of_receive,
)

WHITE, BLACK = Observation.WHITE, Observation.BLACK


@for_every_firmware
def test_a_robot_implements_the_interfaces(firmware: Firmware) -> None:
    """All are robots. The firmware and its mirror also have raw numbers, and can be saved."""
    robot = make_robot(firmware)

    assert isinstance(robot, Robot)
    has_raw_numbers = firmware is not ReferenceRobot  # that in float64
    assert isinstance(robot, FixedPointRobot) == has_raw_numbers


# design: R2, R18
@for_every_firmware
@pytest.mark.parametrize("empty_rounds", [0, 1])
def test_a_robot_that_has_observed_and_received_nothing_guesses_a_half(
    firmware: Firmware, empty_rounds: int
) -> None:
    """x_hat is its own estimate, with the confidence alpha, and x_bar its neighbours', with beta.

    The robot is new, or has ended a round without messages.
    """
    robot = make_robot(firmware)

    for _ in range(empty_rounds):
        robot.settle()

    assert (robot.x_hat, robot.alpha) == (0.5, 0.0)
    assert (robot.x_bar, robot.beta) == (0.5, 0.0)
    assert robot.x == 0.5, "what it believes, given both estimates"


# design: R2, R18
@for_every_firmware
def test_a_new_robot_has_its_id_its_accuracy_and_counts_of_zero(firmware: Firmware) -> None:
    """It has observed t tiles, n of them black. Its counters count messages and tests."""
    robot = make_robot(firmware, b_hat=0.75, robot_id=5)

    assert robot.id == 5
    assert robot.b_hat == 0.75
    assert (robot.t, robot.n) == (0, 0)
    assert robot.counters == Counters(accepted=0, repeated=0, rejected=0, tests=0, updates=0)


@for_every_firmware
def test_repr_shows_what_a_robot_has_counted_and_what_it_estimates(firmware: Firmware) -> None:
    """Its sensor is right in 3 of 4 cases, so 3 black of 4 mean that all are. alpha is 16/3 by eq. 4."""
    robot = make_robot(firmware, b_hat=0.75, robot_id=5)

    observe_tiles(robot, black=3, white=1)

    class_name = firmware.__name__
    assert repr(robot) == f"<{class_name} 5: t=4 n=3 b_hat=0.75 x_hat=1 alpha=5.33333 x=1>"


# design: R6
@for_every_firmware
def test_messages_count_only_when_the_round_ends(firmware: Firmware) -> None:
    """Otherwise what robots believe would depend on the order in which messages come.

    x_bar is the mean of the neighbours' estimates, and beta the sum of their confidences.
    """
    robot = make_robot(firmware)
    robot.receive(sender=1, x_hat=0.25, alpha=2.0)
    robot.receive(sender=2, x_hat=0.75, alpha=2.0)
    assert robot.beta == 0.0

    robot.step(BLACK)  # ends the round

    assert robot.x_bar == (0.25 + 0.75) / 2
    assert robot.beta == 2.0 + 2.0


# design: R8
@for_every_firmware
def test_a_second_message_of_a_sender_in_a_round_is_ignored(firmware: Firmware) -> None:
    """x_bar and beta, the neighbours' estimate and confidence, are those of the first message alone."""
    robot = make_robot(firmware)
    assert robot.receive(sender=1, x_hat=0.25, alpha=2.0) == Status.OK

    assert robot.receive(sender=1, x_hat=0.75, alpha=9.0) == Status.REPEATED
    robot.step(BLACK)  # ends the round

    assert (robot.x_bar, robot.beta) == (0.25, 2.0)
    assert robot.counters == Counters(accepted=1, repeated=1)


# design: R8
@for_every_firmware
def test_a_sender_is_received_again_in_the_next_round(firmware: Firmware) -> None:
    """x_bar and beta, the neighbours' estimate and confidence, are those of the message in the last round."""
    robot = make_robot(firmware)
    robot.receive(sender=1, x_hat=0.25, alpha=2.0)
    robot.step(BLACK)  # ends the first round

    assert robot.receive(sender=1, x_hat=0.75, alpha=9.0) == Status.OK
    robot.step(BLACK)  # ends the second round

    assert (robot.x_bar, robot.beta) == (0.75, 9.0)
    assert robot.counters == Counters(accepted=2)


# design: R15
@for_every_firmware
def test_a_robot_that_hears_nobody_believes_its_own_estimate_again(firmware: Firmware) -> None:
    """Estimates of the round before count no longer: those neighbours may be far away by now.

    x_bar and beta are estimate and confidence of the neighbours; without any they are 0.5 and 0.
    """
    robot = make_robot(firmware)
    robot.receive(sender=1, x_hat=0.75, alpha=9.0)
    robot.step(BLACK)  # ends the round of the message
    assert robot.x != robot.x_hat, "it believes the neighbour, too"

    robot.step(BLACK)  # ends a round without messages

    assert robot.x == robot.x_hat
    assert (robot.x_bar, robot.beta) == (0.5, 0.0)


# design: R13
@for_every_firmware
def test_a_counter_begins_at_0_again_after_65535(firmware: Firmware) -> None:
    """A counter has 16 bits. 65536 and three more messages have the robot's own id, and so are rejected."""
    robot = make_robot(firmware, robot_id=5)

    for _ in range(65536 + 3):
        status_of_receive(robot, sender=5, x_hat=0.5, alpha=1.0)

    assert robot.counters == Counters(rejected=3)


# design: R10, R23, R26
@for_every_firmware
@pytest.mark.parametrize(
    ("mode", "neighbours_estimates", "tests", "updates"),
    [
        (Filter.ADAPTIVE, (), 0, 0),
        (Filter.ADAPTIVE, (0.9,), 0, 0),
        (Filter.ADAPTIVE, (0.9, 0.9), 1, 1),
        (Filter.ADAPTIVE, (1.0, 1.0, 1.0), 1, 0),  # all agree with the robot's own estimate
        (Filter.ADAPTIVE, (0.5, 0.5), 1, 0),  # contradict it, but 1/2 says nothing about its accuracy
        (Filter.ALWAYS, (), 0, 0),
        (Filter.ALWAYS, (0.9,), 0, 1),
        (Filter.ALWAYS, (0.25, 0.7502), 0, 0),  # their mean is nearer to 1/2 than 2**-13, 0.00012
        (Filter.ALWAYS, (0.25, 0.7503), 0, 1),  # their mean, 0.50015, is not
        (Filter.ALWAYS, (1.0, 1.0, 1.0), 0, 1),
        (Filter.OFF, (0.1, 0.1, 0.1), 0, 0),
    ],
)
def test_a_robot_re_estimates_its_accuracy_after_enough_informative_messages(
    firmware: Firmware, mode: Filter, neighbours_estimates: tuple[float, ...], tests: int, updates: int
) -> None:
    """The filter ADAPTIVE tests the accuracy if there are two messages, and updates it if that rejects.

    ALWAYS updates it without a test if there is a message, and OFF does neither. No filter updates it by
    neighbours whose mean is 1/2. The robot itself estimates 1. Its filter runs once, so that ``tests`` and
    ``updates``, the numbers to be counted, are 0 or 1.
    """
    robot = make_robot(firmware, Config(TABLE, mode, filter_period=1), b_hat=0.75)
    observe_tiles(robot, black=4, white=0)
    receive_estimates(robot, *neighbours_estimates)

    status = robot.settle()  # ends the round, in which the filter runs

    if updates == 0:
        assert status == Status.OK
        assert robot.b_hat == 0.75
    else:
        assert status == Status.UPDATED
        assert robot.b_hat != 0.75
    assert robot.counters == Counters(accepted=len(neighbours_estimates), tests=tests, updates=updates)


@for_every_firmware
@pytest.mark.parametrize("mode", [Filter.ADAPTIVE, Filter.ALWAYS, Filter.ROBUST])
def test_a_robot_that_has_observed_nothing_keeps_its_accuracy(firmware: Firmware, mode: Filter) -> None:
    """It has no observations that five neighbours could contradict. So it neither tests nor updates."""
    robot = make_robot(firmware, Config(TABLE, mode, filter_period=1), b_hat=0.75)
    receive_estimates(robot, 0.9, 0.9, 0.9, 0.9, 0.9)

    status = robot.settle()  # ends the round, in which the filter runs

    assert status == Status.OK
    assert robot.b_hat == 0.75
    assert robot.counters == Counters(accepted=5, tests=0, updates=0)


def observe_and_exchange_estimates(swarm: list[Robot], rng: random.Random) -> None:
    """Let each robot observe a random tile, and receive the estimates of all others in a random order."""
    for robot in swarm:
        robot.observe(rng.choice([BLACK, WHITE]))
    for receiver in swarm:
        for sender in rng.sample(swarm, len(swarm)):
            if sender is not receiver:
                receiver.receive(sender.id, sender.x_hat, sender.alpha)
    for robot in swarm:
        robot.settle()  # ends the round


# design: R22
@for_every_firmware
def test_robots_that_all_receive_each_other_s_estimates_believe_the_same_to_the_last_bit(
    firmware: Firmware,
) -> None:
    """They have different accuracies, observe different tiles, and receive in different orders.

    After each round x, what a robot believes, is the same number in all of them.
    """
    rng = random.Random(0)
    config = Config(filter=Filter.ALWAYS, filter_period=1)
    swarm = [
        make_robot(firmware, config, b_hat=rng.uniform(0.6, 0.99), robot_id=robot_id)
        for robot_id in range(10)
    ]

    for _ in range(30):
        observe_and_exchange_estimates(swarm, rng)
        different_values = {robot.x for robot in swarm}
        assert len(different_values) == 1
