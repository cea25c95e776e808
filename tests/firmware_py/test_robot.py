"""A robot's step, the same in every firmware: rounds, observations, memory, filter (docs/design.md)."""

from __future__ import annotations

import random
from dataclasses import replace

import pytest

from mcp_asdf.reference import ReferenceRobot
from mcp_asdf.robot import Config, Counters, Filter, FixedPointRobot, Observation, Robot, Status
from robots import (
    OWN_ID,
    TABLE,
    Firmware,
    for_every_firmware,
    make_robot,
    observe_tiles,
    receive_estimates,
    status_of_receive,
)

WHITE, BLACK = Observation.WHITE, Observation.BLACK
ADAPTIVE = Config(TABLE, Filter.ADAPTIVE, filter_period=1)
ALWAYS = Config(None, Filter.ALWAYS, filter_period=1)


@for_every_firmware
def test_a_robot_implements_the_interfaces(firmware: Firmware) -> None:
    robot = make_robot(firmware)
    assert isinstance(robot, Robot)
    assert isinstance(robot, FixedPointRobot) == (firmware is not ReferenceRobot)


# design: R2, R18
@for_every_firmware
def test_a_robot_knows_nothing_before_it_observes_and_receives(firmware: Firmware) -> None:
    robot = make_robot(firmware, b_hat=0.75)
    for _ in range(2):
        assert (robot.id, robot.t, robot.n, robot.b_hat, robot.counters) == (OWN_ID, 0, 0, 0.75, Counters())
        assert (robot.x_hat, robot.alpha, robot.x_bar, robot.beta, robot.x) == (0.5, 0.0, 0.5, 0.0, 0.5)
        assert robot.settle() == Status.OK


@for_every_firmware
def test_repr_shows_the_state(firmware: Firmware) -> None:
    robot = make_robot(firmware, b_hat=0.75)
    observe_tiles(robot, black=3, white=1)
    expected = f"<{firmware.__name__} {OWN_ID}: t=4 n=3 b_hat=0.75 x_hat=1 alpha=5.33333 x=1>"
    assert repr(robot) == expected


# design: R6
@for_every_firmware
def test_messages_count_once_the_round_is_closed(firmware: Firmware) -> None:
    robot = make_robot(firmware)
    robot.receive(1, 0.25, 2.0)
    robot.receive(2, 0.75, 2.0)
    assert (robot.x_bar, robot.beta) == (0.5, 0.0)
    robot.step(BLACK)
    assert (robot.x_bar, robot.beta) == (0.5, 4.0)


# design: R8
@for_every_firmware
def test_the_first_message_of_a_sender_counts_in_each_round(firmware: Firmware) -> None:
    robot = make_robot(firmware)
    assert robot.receive(1, 0.25, 2.0) == Status.OK
    assert robot.receive(1, 0.75, 9.0) == Status.REPEATED
    robot.step(BLACK)
    assert (robot.x_bar, robot.beta) == (0.25, 2.0)
    assert robot.receive(1, 0.75, 9.0) == Status.OK, "a new round"
    robot.step(BLACK)
    assert (robot.x_bar, robot.beta) == (0.75, 9.0)
    assert robot.counters == Counters(accepted=2, repeated=1)


# design: R15
@for_every_firmware
def test_after_a_round_without_messages_the_social_estimate_is_gone(firmware: Firmware) -> None:
    robot = make_robot(firmware)
    robot.receive(1, 0.75, 9.0)
    robot.step(BLACK)
    robot.step(BLACK)
    assert (robot.x_bar, robot.beta, robot.x) == (0.5, 0.0, robot.x_hat)


# design: R13
@for_every_firmware
def test_counters_wrap(firmware: Firmware) -> None:
    robot = make_robot(firmware)
    for _ in range(65536 + 3):
        assert status_of_receive(robot, OWN_ID, 0.5, 1.0) == Status.ERR_SENDER
    assert robot.counters == Counters(rejected=3)


# design: R10, R23, R26
@for_every_firmware
@pytest.mark.parametrize(
    ("mode", "neighbours", "tests", "updates"),
    [
        (Filter.ADAPTIVE, (), 0, 0),
        (Filter.ADAPTIVE, (0.9,), 0, 0),
        (Filter.ADAPTIVE, (0.9, 0.9), 1, 1),
        (Filter.ADAPTIVE, (1.0, 1.0, 1.0), 1, 0),  # S = 0, equal to the own estimate
        (Filter.ADAPTIVE, (0.5, 0.5), 1, 0),  # rejected, but x_bar = 1/2
        (Filter.ALWAYS, (), 0, 0),
        (Filter.ALWAYS, (0.9,), 0, 1),
        (Filter.ALWAYS, (0.25, 0.7502), 0, 0),  # x_bar is too near to 1/2 to be informative
        (Filter.ALWAYS, (0.25, 0.7503), 0, 1),
        (Filter.ALWAYS, (1.0, 1.0, 1.0), 0, 1),
        (Filter.OFF, (0.1, 0.1, 0.1), 0, 0),
    ],
)
def test_the_filter_updates_after_enough_informative_messages(
    firmware: Firmware, mode: Filter, neighbours: tuple[float, ...], tests: int, updates: int
) -> None:
    robot = make_robot(firmware, replace(ADAPTIVE, filter=mode))
    observe_tiles(robot, black=4, white=0)  # x_hat = 1
    receive_estimates(robot, *neighbours)
    assert robot.settle() == (Status.UPDATED if updates else Status.OK)
    assert (robot.b_hat != 0.75) == bool(updates)
    assert robot.counters == Counters(accepted=len(neighbours), tests=tests, updates=updates)


@for_every_firmware
@pytest.mark.parametrize("config", [ADAPTIVE, ALWAYS])
def test_before_the_first_observation_there_is_neither_test_nor_update(
    firmware: Firmware, config: Config
) -> None:
    robot = make_robot(firmware, config)
    receive_estimates(robot, 0.9, 0.9)
    assert robot.settle() == Status.OK
    assert robot.counters == Counters(accepted=2)


# design: R22
@for_every_firmware
def test_a_fully_connected_swarm_agrees_to_the_bit(firmware: Firmware) -> None:
    """I14, whatever the order of messages; sums of float64 are correctly rounded."""
    rng = random.Random(0)
    config = replace(ALWAYS, filter_period=3)
    swarm = [make_robot(firmware, config, rng.uniform(0.6, 0.99), robot_id) for robot_id in range(10)]
    for _ in range(100):
        for robot in swarm:
            robot.observe(Observation(rng.randrange(2)))
        messages = [(robot.id, robot.x_hat, robot.alpha) for robot in swarm]
        for robot in swarm:
            messages_of_others = [message for message in messages if message[0] != robot.id]
            for message in rng.sample(messages_of_others, len(messages_of_others)):
                assert robot.receive(*message) == Status.OK
        for robot in swarm:
            robot.settle()
        assert len({robot.x for robot in swarm}) == 1
