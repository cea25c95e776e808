"""The robot that swarms, nodes, neighbours and replays drive: its ticks, its counts, and how it starts.

What it sends and receives is compared with trials (test_swarm.py) and with the C node (tests/targets).
"""

from __future__ import annotations

import json
from collections import Counter
from dataclasses import replace
from decimal import Decimal
from typing import Any

import numpy as np
import pytest

from mcp_asdf.mirror import MirrorRobot
from mcp_asdf.robot import Config, Counters, Filter, FirmwareError, Observation
from mcp_asdf.table import Table
from mcp_asdf_tools.bus.frame_layout import Rejection
from mcp_asdf_tools.bus.frames import Estimate, FrameFormat, Heartbeat, Telemetry
from mcp_asdf_tools.common.errors import UsageError
from mcp_asdf_tools.common.parameters import ParameterError
from mcp_asdf_tools.recording.events import EventRecorder
from mcp_asdf_tools.robots.bus_robot import BusRobot, Reception
from mcp_asdf_tools.robots.filters import Activation
from mcp_asdf_tools.robots.population import Population
from mcp_asdf_tools.robots.robot_setup import RobotSetup
from mcp_asdf_tools.robots.suspicion import Suspicion
from mcp_asdf_tools.tables.thresholds import generate
from messages import encoded
from robots import ALPHA_ONE
from wire import TABLE, record

ESTIMATES = FrameFormat()


# Ticks, numbers, crashes


def robot_with_counters(comms_period: int, **counters: int) -> BusRobot:
    """Return robot 5 with counters that may be close to where they wrap."""
    firmware = MirrorRobot(Config(filter=Filter.OFF), 5, 0.75)
    for name, value in counters.items():
        setattr(firmware.s, name, value)
    return BusRobot(record(5, comms_period=comms_period), ESTIMATES, make_firmware=lambda: firmware)


def test_a_broadcast_stays_due_until_its_tick_has_ended() -> None:
    """A robot that broadcasts in every third tick; ``observe`` returns whether a broadcast is due."""
    robot = robot_with_counters(comms_period=3)

    is_due = [robot.observe(None) for _ in range(5)]
    robot.settle()  # ends the tick
    is_due_later = [robot.observe(None) for _ in range(3)]

    assert is_due == [False, False, True, True, True]
    assert is_due_later == [False, False, True]


def test_counts_in_reports_go_on_where_the_firmware_s_16_bits_end() -> None:
    """In each of 300 ticks come 998 estimates under the robot's own id and one each of robots 6 and 7.

    The firmware rejects the first, and takes the others: 2 in the first tick, and then as repeated ones.
    """
    counters = Counters(accepted=65_000, repeated=65_533, rejected=1, tests=65_534, updates=65_535)
    robot = robot_with_counters(10**6, **vars(counters))
    # In a round of so many messages a counter of the firmware wraps several times.
    senders = [5] * 998 + [6, 7]
    estimates = np.array([[sender, 0, ALPHA_ONE] for sender in senders], np.uint32)
    for _ in range(300):
        robot.observe(None)
        robot.receive_all(estimates)
        robot.settle()

    assert robot.counters == Counters(
        accepted=65_002, repeated=65_533 + 2 * 299, rejected=1 + 998 * 300, tests=65_534, updates=65_535
    )


def test_estimates_under_the_robot_s_own_id_are_refused_and_counted_as_conflicts() -> None:
    robot = robot_with_counters(comms_period=1)
    robot.receive_all(np.array([[5, 0, ALPHA_ONE], [5, 0, ALPHA_ONE], [6, 0, ALPHA_ONE]], np.uint32))
    conflicts = Counter({(Suspicion.CONFLICT, 5): 2})
    assert robot.reception == Reception(delivered=3, refused=2, events=conflicts)


def test_telemetry_has_the_number_of_updates_modulo_256() -> None:
    robot = robot_with_counters(comms_period=1, updates=65_535)

    # x is 1/2 in units of 2**-23, and b_hat 3/4 in units of 2**-24.
    expected = Telemetry(sender=5, x=1 << 22, b_hat=3 << 22, updates=65_535 % 256, transfer_id=0)
    assert robot.telemetry(0.0).data == encoded(expected).data


@pytest.mark.parametrize("firmware", ["native", "mirror", "reference"])
@pytest.mark.parametrize("allow", [None, frozenset({6})])
def test_an_estimate_has_the_same_effect_alone_as_in_an_array(
    firmware: str, allow: frozenset[int] | None
) -> None:
    """The senders are 6, again 6, 5 (the robot's own id) and 7. ``allow`` may admit only one of them."""
    setup = replace(record(5, firmware), allow=allow)
    lines_of_one, lines_of_array = list[str](), list[str]()
    one = BusRobot(setup, ESTIMATES, EventRecorder(5, lines_of_one.append))
    array = BusRobot(setup, ESTIMATES, EventRecorder(5, lines_of_array.append))
    for sender in (6, 6, 5, 7):
        one.receive(Estimate(sender, 1 << 22, ALPHA_ONE, 0))
        array.receive_all(np.array([[sender, 1 << 22, ALPHA_ONE]], np.uint32))
    for robot in (one, array):
        robot.observe(Observation.BLACK)
        robot.settle()

    assert one.reception == array.reception
    assert one.counters == array.counters
    assert one.robot.x == array.robot.x
    assert lines_of_one == lines_of_array


def test_a_robot_that_has_crashed_receives_nothing() -> None:
    robot = BusRobot(record(5), ESTIMATES)
    robot.crash(loses_state=False)
    for content in (Estimate(6, 9, 0, 0), Estimate(5, 9, 0, 0), Heartbeat(8, 1, 0)):
        robot.receive_frames([encoded(content)])
        robot.count_foreign_frame(encoded(content))
    robot.receive(Estimate(6, 9, 0, 0))

    assert robot.reception == Reception()


def robot_that_rejoins(*, loses_state: bool) -> BusRobot:
    """Return a robot that has made one observation in one tick, has crashed and has rejoined."""
    robot = BusRobot(record(5), ESTIMATES)
    robot.observe(Observation.BLACK)
    robot.settle()
    robot.crash(loses_state)
    robot.rejoin()
    return robot


def test_a_robot_that_rejoins_goes_on_where_it_was_if_the_crash_kept_its_state() -> None:
    robot = robot_that_rejoins(loses_state=False)
    assert robot.is_alive
    assert robot.ticks == 1
    assert robot.robot.t == 1


def test_a_robot_that_rejoins_begins_anew_if_the_crash_lost_its_state() -> None:
    robot = robot_that_rejoins(loses_state=True)
    assert robot.is_alive
    assert robot.ticks == 0
    assert robot.robot.t == 0


def test_a_line_of_events_has_all_that_a_robot_did_in_a_tick() -> None:
    """1 is a black tile, 2 no observation, 3 the end of the tick; a triple is sender, x_hat and alpha."""
    lines: list[str] = []
    robot = BusRobot(record(5), ESTIMATES, EventRecorder(5, lines.append))
    estimates = [encoded(Estimate(sender, 9, 0, 0)) for sender in (6, 7, 8)]
    robot.observe(Observation.BLACK)
    robot.receive_frames([estimates[0], encoded(Heartbeat(8, 1, 0)), estimates[1]])
    robot.receive_frames([estimates[2]] * 2)
    robot.settle()
    robot.crash(loses_state=True)
    robot.rejoin()
    robot.observe(None)
    robot.receive_frames([])
    robot.settle()

    assert lines == ["[5,1,[6,9,0],[7,9,0],[8,9,0],[8,9,0],3]\n", '[5,"restart",2,3]\n']


def test_frames_without_an_estimate_are_counted_by_their_kind() -> None:
    """Each content comes three times; Rejection lists the reasons why a frame can be refused."""
    robot = BusRobot(record(5), ESTIMATES)
    for content in (Heartbeat(8, 1, 0), Telemetry(8, 9, 1 << 23, 1, 0), Estimate(6, 9, 0, 0), *Rejection):
        robot.count_content(content, 3)
    rejections = [reason for reason in Rejection if reason is not Rejection.ERROR_FRAME]

    assert robot.reception == Reception(
        heartbeats=3, telemetry=3, errors=3, rejected=Counter(dict.fromkeys(rejections, 3))
    )


def test_estimates_from_outside_the_swarm_are_counted_as_strays() -> None:
    """Such frames come from other nodes on the bus; one of them has the id of the robot itself."""
    robot = BusRobot(record(5), ESTIMATES)
    for content in (Estimate(5, 9, 0, 0), Estimate(6, 9, 0, 0), Heartbeat(8, 1, 0)):
        robot.count_foreign_frame(encoded(content))
    conflicts = Counter({(Suspicion.CONFLICT, 5): 1})

    assert robot.reception == Reception(strays=2, heartbeats=1, events=conflicts)


# How a robot starts


@pytest.mark.parametrize(
    "setup",
    [
        record(5, "mirror", 0.55, comms_period=2, filter_period=10, memory=64),
        record(5, comms_period=1, filter_period=1),
        record(5, comms_period=2**32 - 1, filter_period=2**32 - 1),
        replace(record(5, table=None, filter=Filter.ALWAYS), allow=frozenset((0, 2, 3, 127))),
    ],
)
def test_a_robot_s_setup_written_as_json_is_read_as_the_same_setup(setup: RobotSetup) -> None:
    assert RobotSetup.from_plain(json.loads(json.dumps(setup.plain()))) == setup


def test_a_setup_in_json_has_the_allowed_ids_as_ranges() -> None:
    """Robots whose estimates the robot takes: 0, 2 to 3, and 127."""
    setup = replace(record(5), allow=frozenset((0, 2, 3, 127)))
    assert setup.plain()["allow"] == "0+2-3+127"


def test_a_table_that_was_not_made_here_cannot_be_put_into_json() -> None:
    """JSON has only the numbers from which a table is computed, and this table follows from none."""
    table = Table(3, TABLE.entries)
    with pytest.raises(UsageError, match=r"omega is .*make one with mcp-asdf table"):
        record(5, table=table).plain()


def test_a_setup_makes_a_robot_with_its_configuration() -> None:
    setup = record(5, "mirror", 0.55, comms_period=2, filter_period=10, memory=64)
    robot = setup.make_robot()
    assert isinstance(robot, MirrorRobot)
    assert robot.state() == MirrorRobot(Config(TABLE, Filter.ADAPTIVE, 5, 64), 5, 0.55).state()


@pytest.mark.parametrize(
    ("changes", "complaint"),
    [
        ({"comms_period": 0}, "comms_period is 0"),
        ({"comms_period": 20}, "filter_period is 10; choose a multiple of comms_period 20"),
        ({"filter_period": 0}, "filter_period is 0; choose a multiple of comms_period 1"),
        ({"filter_period": 2**32}, "filter_period is 4294967296"),
        ({"comms_period": 3}, "filter_period is 10; choose a multiple of comms_period 3"),
        ({"filter_period": 10.5}, "filter_period is 10.5; give a whole number"),
        ({"filter": "some"}, "filter is 'some'; it must be one of adaptive, always, off"),
        ({"memory": 66}, "memory is 66"),
        ({"allow": "x"}, "allow is 'x'; it must be ids 0 to 127 such as 0"),
        ({"allow": "3+0-128"}, "allow is '3.0-128'"),
        ({"allow": "0+5-3"}, "allow is '0.5-3'"),
        ({"id": 128}, "robot id is 128"),
        ({"b_hat": "high"}, "b_hat is 'high'"),
        ({"firmware": "own"}, "firmware is 'own'"),
        ({"table": {"omega": "0.05", "q": 20, "checksum": 1}}, "has checksum 1"),
    ],
)
def test_a_setup_with_a_wrong_value_is_refused_by_name(changes: dict[str, Any], complaint: str) -> None:
    with pytest.raises((UsageError, FirmwareError), match=complaint):
        RobotSetup.from_plain(record(5).plain() | changes)


@pytest.mark.parametrize(
    ("flawed", "count"),
    [(6, 6), ("6", 6), (np.int64(4), 4), (0, 0), (10, 10), (0.0, 0), (1.0, 10), ("30%", 3), ("0.5", 5)],
)
def test_flawed_robots_are_a_count_or_a_share(flawed: Any, count: int) -> None:
    assert Population(robots=10, flawed=flawed).flawed == count


@pytest.mark.parametrize(("share", "count"), [("44.9%", 4), ("45%", 5), (0.25, 3)])
def test_a_share_of_flawed_robots_is_rounded_to_the_nearest_count_halves_up(share: Any, count: int) -> None:
    assert Population(robots=10, flawed=share).flawed == count


@pytest.mark.parametrize("flawed", [11, -1, -0.01, 1.01, "150%", True, "x", "nan", None])
def test_what_is_neither_a_count_nor_a_share_of_robots_is_refused(flawed: Any) -> None:
    with pytest.raises(UsageError, match="; give a count, 0 to 10, or a share such as"):
        Population(robots=10, flawed=flawed)


FOUR_ROBOTS: dict[str, Any] = {
    "robots": 4,
    "flawed": 2,
    "flawed_accuracy": 0.3,
    "true_accuracy": 1.0,
    "comms_period": 2,
    "filter_period": 4,
    "memory": 64,
    "omega": "0.1",
}
OFF = Config(None, Filter.OFF, 2, 64)
ADAPTIVE = Config(generate(Decimal("0.1"), 3), Filter.ADAPTIVE, 2, 64)
ALWAYS = Config(None, Filter.ALWAYS, 2, 64)
ROBUST = Config(None, Filter.ROBUST, 2, 64)


@pytest.mark.parametrize(
    ("filters", "activation", "flawed_config", "other_config"),
    [
        ("none", "adaptive", OFF, OFF),
        ("none", "always", OFF, OFF),
        ("asdf-minus", "adaptive", ADAPTIVE, OFF),
        ("asdf-minus", "always", ALWAYS, OFF),
        ("asdf-plus", "adaptive", ADAPTIVE, ADAPTIVE),
        ("asdf-plus", "always", ALWAYS, ALWAYS),
        ("robust", "adaptive", ROBUST, ROBUST),
        ("robust", "always", ROBUST, ROBUST),
    ],
)
def test_a_swarm_s_filter_decides_on_the_filter_of_flawed_and_of_other_robots(
    filters: str, activation: Activation, flawed_config: Config, other_config: Config
) -> None:
    """Robots 0 and 1 are flawed: they assume an accuracy of 0.3, the others nearly 1."""
    population = Population(**FOUR_ROBOTS, filter=filters, activation=activation)
    largest_b_hat = 1 - 2**-20

    assert [population.setup_of(robot) for robot in range(4)] == [
        RobotSetup(0, "native", 0.3, flawed_config, 2),
        RobotSetup(1, "native", 0.3, flawed_config, 2),
        RobotSetup(2, "native", largest_b_hat, other_config, 2),
        RobotSetup(3, "native", largest_b_hat, other_config, 2),
    ]


@pytest.mark.parametrize(
    ("filters", "activation", "unused"),
    [
        ("none", "adaptive", {"omega", "activation"}),
        ("robust", "adaptive", {"omega", "activation"}),
        ("asdf-minus", "adaptive", set()),
        ("asdf-plus", "always", {"omega"}),
    ],
)
def test_a_population_knows_which_parameters_its_filter_does_not_use(
    filters: str, activation: Activation, unused: set[str]
) -> None:
    """So the commands can refuse an option that would do nothing."""
    population = Population(**FOUR_ROBOTS, filter=filters, activation=activation, drift="linear")
    assert set(population.unused_parameters()) == unused


def test_a_population_is_made_again_from_its_parameters() -> None:
    population = Population(**FOUR_ROBOTS, drift="linear", drift_of="flawed")
    assert Population(**population.parameters()) == population


def test_only_the_sensors_of_flawed_robots_drift_if_they_alone_are_to() -> None:
    assert Population(**FOUR_ROBOTS, drift="linear", drift_of="flawed").drifting == 2
    assert Population(**FOUR_ROBOTS, drift="linear").drifting == 4


def test_a_drift_of_some_robots_without_a_drift_is_refused() -> None:
    with pytest.raises(ParameterError, match="drift_of is flawed but drift is none"):
        Population(drift_of="flawed")


def test_a_memory_that_is_no_multiple_of_4_is_refused() -> None:
    with pytest.raises(ParameterError, match="memory is 66; it must be a multiple of 4"):
        Population(memory=66)


@pytest.mark.parametrize(("robots", "neighbours"), [(1, 2), (3, 2), (4, 3), (128, 127), (129, 127)])
def test_the_table_of_thresholds_is_for_as_many_neighbours_as_a_robot_can_hear(
    robots: int, neighbours: int
) -> None:
    """At least 2, and at most 127: that many estimates the firmware takes between two broadcasts."""
    table = Population(robots=robots, topology="dynamic", filter="asdf-plus").config(0).table
    assert table is not None
    assert table.q == neighbours
