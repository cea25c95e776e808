"""The robot that swarms, nodes, neighbours and replays drive: its ticks, its counts, and how it starts.

What it sends and receives is compared with trials (test_swarm.py) and with the C node (tests/targets).
"""

from __future__ import annotations

import json
from collections import Counter
from collections.abc import Sequence
from dataclasses import replace
from decimal import Decimal
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from mcp_asdf.mirror import MirrorRobot
from mcp_asdf.robot import Config, Counters, Filter, Observation
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
from wire import TABLE, setup_of_robot

ESTIMATE_FORMAT = FrameFormat()


# Ticks, numbers, crashes


def make_robot_5(*, comms_period: int, **counters: int) -> BusRobot:
    """Return robot 5 without a filter, whose firmware begins with counters that may be close to a wrap.

    It broadcasts in every tick whose number is a multiple of ``comms_period``.
    """
    firmware = MirrorRobot(Config(filter=Filter.OFF), 5, 0.75)
    for name, value in counters.items():
        setattr(firmware.s, name, value)
    return BusRobot(
        setup_of_robot(5, comms_period=comms_period), ESTIMATE_FORMAT, make_firmware=lambda: firmware
    )


def estimates_from(senders: Sequence[int]) -> NDArray[np.uint32]:
    """Return an array with a row for each sender: its id, an x_hat of 0 and an alpha of 1."""
    return np.array([[sender, 0, ALPHA_ONE] for sender in senders], np.uint32)


def test_a_broadcast_stays_due_until_its_tick_has_ended() -> None:
    """A robot broadcasts in every third tick. ``observe`` begins a tick, and returns whether this is due.

    From the third tick on it returns True, until ``settle`` ends the tick. Then it counts anew.
    """
    robot = make_robot_5(comms_period=3)
    nothing_observed = None

    is_due = [robot.observe(nothing_observed) for _ in range(5)]
    robot.settle()
    is_due_in_next_round = [robot.observe(nothing_observed) for _ in range(3)]

    assert is_due == [False, False, True, True, True]
    assert is_due_in_next_round == [False, False, True]


def test_a_count_in_reports_goes_on_after_more_than_2_16_refusals_in_a_round() -> None:
    """The reported count is the sum, although the firmware's counters have 16 bits.

    The firmware has refused 7 estimates. It refuses 70,000 more, as they are under the robot's own id, 5.
    """
    ticks_of_a_round = 10**6  # so that all 70 ticks are in one round
    robot = make_robot_5(comms_period=ticks_of_a_round, rejected=7)
    a_thousand_estimates = estimates_from([5] * 1000)
    for _ in range(70):
        robot.observe(None)
        robot.receive_all(a_thousand_estimates)
        robot.settle()

    assert robot.counters.rejected == 7 + 70 * 1000


def test_the_counts_of_received_estimates_in_reports_go_on_where_the_firmware_s_16_bits_end() -> None:
    """All counters of the firmware begin at their largest value, 65,535. Three of them count on, and wrap.

    The first estimates of robots 6 and 7 are accepted, and their second ones are repeated. The one under the
    robot's own id, 5, is rejected. The filter is off, so there are no tests and updates.
    """
    robot = make_robot_5(
        comms_period=10, accepted=65_535, repeated=65_535, rejected=65_535, tests=65_535, updates=65_535
    )
    robot.observe(None)
    robot.receive_all(estimates_from([6, 7, 6, 7, 5]))

    assert robot.counters == Counters(
        accepted=65_535 + 2, repeated=65_535 + 2, rejected=65_535 + 1, tests=65_535, updates=65_535
    )


@pytest.mark.parametrize("firmware", ["native", "mirror", "reference"])
def test_repeated_estimates_and_those_under_the_robot_s_own_id_are_counted_as_refused(firmware: str) -> None:
    """Robot 5 refuses one of the two estimates of robot 6, and one under its own id, which is a conflict."""
    robot = BusRobot(setup_of_robot(5, firmware), ESTIMATE_FORMAT)
    robot.receive_all(estimates_from([6, 6, 5, 7]))
    conflict_under_id_5 = Counter({(Suspicion.CONFLICT, 5): 1})
    assert robot.reception == Reception(delivered=4, refused=2, events=conflict_under_id_5)


def test_telemetry_has_the_number_of_updates_modulo_256() -> None:
    """The count 65,535 is sent as 255. x is 1/2, and b_hat, the accuracy that the robot assumes, is 3/4."""
    robot = make_robot_5(comms_period=1, updates=65_535)

    x = round(1 / 2 * 2**23)  # in units of 2**-23
    b_hat = round(3 / 4 * 2**24)  # in units of 2**-24
    expected_telemetry = Telemetry(sender=5, x=x, b_hat=b_hat, updates=65_535 % 256, transfer_id=0)
    assert robot.telemetry(now=0.0).data == encoded(expected_telemetry).data


def test_telemetry_is_numbered_from_0() -> None:
    """The number is the frame's transfer id."""
    robot = make_robot_5(comms_period=1)
    assert [robot.next_telemetry().transfer_id for _ in range(3)] == [0, 1, 2]


@pytest.mark.parametrize(("b_hat", "sent_b_hat"), [(1.0, 2**24 - 2**4), (0.0, 2**4)])
def test_telemetry_holds_a_b_hat_of_0_or_1_as_the_nearest_legal_one(
    b_hat: float, sent_b_hat: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A robot that computes in float64 may have such a b_hat. b_hat is sent in units of 2**-24."""
    robot = make_robot_5(comms_period=1)
    monkeypatch.setattr(MirrorRobot, "b_hat", b_hat)
    assert robot.next_telemetry().b_hat == sent_b_hat


ESTIMATE_OF_6 = Estimate(sender=6, x_hat=9, alpha=0, transfer_id=0)
ESTIMATE_OF_5 = replace(ESTIMATE_OF_6, sender=5)
HEARTBEAT_OF_8 = Heartbeat(sender=8, uptime=1, transfer_id=0)


def test_a_robot_that_has_crashed_receives_nothing() -> None:
    """It gets an estimate of robot 6, one under its own id, 5, and a heartbeat, and counts none of them.

    Each comes as a frame of the swarm and as a frame of another program.
    """
    robot = BusRobot(setup_of_robot(5), ESTIMATE_FORMAT)
    robot.crash(loses_state=False)
    for content in (ESTIMATE_OF_6, ESTIMATE_OF_5, HEARTBEAT_OF_8):
        robot.receive_frames([encoded(content)])
        robot.count_foreign_content(content)

    nothing_received = Reception()
    assert robot.reception == nothing_received


@pytest.mark.parametrize(("loses_state", "kept_ticks"), [(False, 1), (True, 0)])
def test_a_robot_that_rejoins_goes_on_where_it_was_unless_the_crash_lost_its_state(
    loses_state: bool, kept_ticks: int
) -> None:
    """Before the crash it has made one observation in one tick, which it has kept or lost."""
    robot = BusRobot(setup_of_robot(5), ESTIMATE_FORMAT)
    robot.observe(Observation.BLACK)
    robot.settle()
    robot.crash(loses_state)
    robot.rejoin()

    assert robot.is_alive
    assert robot.ticks == kept_ticks
    assert robot.robot.t == kept_ticks, "observations"


def test_a_line_of_events_has_all_that_a_robot_did_in_a_tick() -> None:
    """The line is a list in JSON: the robot's id, 1 for a black tile, each estimate, and 3 for the end.

    An estimate is [sender, x_hat, alpha]. A heartbeat is no event.
    """
    lines: list[str] = []
    robot = BusRobot(setup_of_robot(5), ESTIMATE_FORMAT, EventRecorder(5, lines.append))
    estimate = encoded(Estimate(sender=6, x_hat=9, alpha=0, transfer_id=0))
    heartbeat = encoded(Heartbeat(sender=8, uptime=1, transfer_id=0))

    robot.observe(Observation.BLACK)
    robot.receive_frames([estimate, heartbeat])
    robot.receive_frames([estimate])
    robot.settle()

    assert lines == ["[5,1,[6,9,0],[6,9,0],3]\n"]


def test_the_first_line_of_events_after_a_crash_that_lost_the_state_begins_with_a_restart() -> None:
    """The line has the robot's id, 5, "restart", 2 for a tick without an observation, and 3 for its end."""
    lines: list[str] = []
    robot = BusRobot(setup_of_robot(5), ESTIMATE_FORMAT, EventRecorder(5, lines.append))
    robot.crash(loses_state=True)
    robot.rejoin()  # records the restart
    robot.observe(None)
    robot.receive_frames([])
    robot.settle()

    assert lines == ['[5,"restart",2,3]\n']


def test_frames_without_an_estimate_are_counted_by_their_kind() -> None:
    """A robot receives a heartbeat, telemetry, and frames that it rejects. Each reason to reject occurs once.

    One of these is an error frame, which is counted apart. An estimate comes, too, and is not counted.
    """
    robot = BusRobot(setup_of_robot(5), ESTIMATE_FORMAT)
    telemetry = Telemetry(sender=8, x=9, b_hat=1 << 23, updates=1, transfer_id=0)
    for content in (HEARTBEAT_OF_8, telemetry, ESTIMATE_OF_6, *Rejection):
        robot.count_content(content)

    other_reasons = set(Rejection) - {Rejection.ERROR_FRAME}
    rejections = Counter(dict.fromkeys(other_reasons, 1))
    assert robot.reception == Reception(heartbeats=1, telemetry=1, errors=1, rejected=rejections)


# How a robot starts


@pytest.mark.parametrize(
    "setup",
    [
        setup_of_robot(5, "mirror", 0.55, comms_period=2, filter_period=10, memory=64),
        setup_of_robot(5, comms_period=1, filter_period=1),
        setup_of_robot(5, comms_period=2**32 - 1, filter_period=2**32 - 1),
        replace(setup_of_robot(5, table=None, filter=Filter.ALWAYS), allow=frozenset((0, 2, 3, 127))),
    ],
)
def test_a_robot_s_setup_written_as_json_is_read_as_the_same_setup(setup: RobotSetup) -> None:
    """A setup has the id of a robot, its firmware, its b_hat at the start and its parameters."""
    text = json.dumps(setup.plain())
    assert RobotSetup.from_plain(json.loads(text)) == setup


def test_a_setup_in_json_has_the_allowed_ids_as_ranges() -> None:
    """The ids 0, 2, 3 and 127 are written as "0+2-3+127"."""
    setup = replace(setup_of_robot(5), allow=frozenset((0, 2, 3, 127)))
    assert setup.plain()["allow"] == "0+2-3+127"


def test_a_table_that_was_not_made_here_cannot_be_put_into_json() -> None:
    """JSON has only the numbers from which a table is computed: omega and the number of neighbours.

    This table has the entries for an omega of 0.05, but another omega, and so it is computed from none.
    """
    foreign_table = Table(omega_word=3, entries=TABLE.entries)
    with pytest.raises(UsageError, match=r"omega is .*make one with mcp-asdf table"):
        setup_of_robot(5, table=foreign_table).plain()


def test_a_setup_makes_a_robot_with_its_configuration() -> None:
    """The mirror is the firmware in Python. A round has 2 ticks, and the filter runs every 5 rounds."""
    config = Config(table=TABLE, filter=Filter.ADAPTIVE, filter_period=5, memory=64)
    setup = RobotSetup(id=5, firmware="mirror", b_hat=0.55, config=config, comms_period=2)

    robot = setup.make_robot()

    assert isinstance(robot, MirrorRobot)
    assert robot.config == config
    assert robot.state() == MirrorRobot(config, robot_id=5, b_hat=0.55).state()


@pytest.mark.parametrize(
    ("changes", "expected_message"),
    [
        ({"comms_period": 0}, "comms_period is 0"),
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
        (
            {"table": {"omega": "0.05", "q": 20.5, "checksum": 1}},
            "q of the t-table is 20.5; give a whole number",
        ),
        ({"table": {"omega": "0.05", "q": 20}}, "'checksum' is missing; add it"),
        ({"table": 20}, "table is 20; give an object in braces"),
        ({"memroy": 64}, "no setting 'memroy'; did you mean memory"),
        ({"wheels": 2}, "no setting 'wheels'; its settings are id,"),
        ({"b_hat": 7.0}, "b_hat is 7.0; choose one in"),
    ],
)
def test_a_robot_s_setup_in_json_with_a_wrong_value_is_refused_by_the_name_of_the_value(
    changes: dict[str, Any], expected_message: str
) -> None:
    """Each case changes one value of a right setup. The error says what is wrong with it."""
    right_setup_as_json = setup_of_robot(5).plain()
    with pytest.raises(UsageError, match=expected_message):
        RobotSetup.from_plain(right_setup_as_json | changes)


@pytest.mark.parametrize(
    ("flawed", "expected_count"),
    [
        *((6, 6), ("6", 6), (np.int64(4), 4), (0, 0), (10, 10)),  # counts
        *((0.0, 0), (1.0, 10), ("30%", 3), ("0.5", 5)),  # shares
        *(("44.9%", 4), ("45%", 5), (0.25, 3)),  # shares that are rounded, with halves up
    ],
)
def test_the_flawed_robots_are_given_as_a_count_or_as_a_share_of_ten_robots(
    flawed: Any, expected_count: int
) -> None:
    """A whole number is a count. A number with a point or a percent sign is a share, which is rounded."""
    assert Population(robots=10, flawed=flawed).flawed == expected_count


@pytest.mark.parametrize("flawed", [11, -1, -0.01, 1.01, "150%", True, "x", "nan", None])
def test_a_number_of_flawed_robots_that_is_neither_a_count_nor_a_share_is_refused(flawed: Any) -> None:
    """Such are 11, -1, 1.01, "150%", "nan" or None. The error says what ten robots may have."""
    with pytest.raises(UsageError, match="; give a count, 0 to 10, or a share such as"):
        Population(robots=10, flawed=flawed)


OFF_CONFIG = Config(None, Filter.OFF, filter_period=2, memory=64)
ADAPTIVE_CONFIG = replace(OFF_CONFIG, filter=Filter.ADAPTIVE, table=generate(Decimal("0.1"), q=3))
ALWAYS_CONFIG = replace(OFF_CONFIG, filter=Filter.ALWAYS)
ROBUST_CONFIG = replace(OFF_CONFIG, filter=Filter.ROBUST)
"""Parameters of the firmware of four robots, whose filter period is 2 rounds of 2 ticks."""


@pytest.mark.parametrize(
    ("filters", "activation", "flawed_config", "other_config"),
    [
        ("none", "adaptive", OFF_CONFIG, OFF_CONFIG),
        ("asdf-minus", "adaptive", ADAPTIVE_CONFIG, OFF_CONFIG),
        ("asdf-minus", "always", ALWAYS_CONFIG, OFF_CONFIG),
        ("asdf-plus", "adaptive", ADAPTIVE_CONFIG, ADAPTIVE_CONFIG),
        ("asdf-plus", "always", ALWAYS_CONFIG, ALWAYS_CONFIG),
        ("robust", "adaptive", ROBUST_CONFIG, ROBUST_CONFIG),
        ("robust", "always", ROBUST_CONFIG, ROBUST_CONFIG),  # it has no other mode
    ],
)
def test_the_filter_of_a_swarm_decides_on_the_filter_of_flawed_and_of_other_robots(
    filters: str, activation: Activation, flawed_config: Config, other_config: Config
) -> None:
    """Robots 0 and 1 are flawed: they assume an accuracy of 0.3, and robots 2 and 3 one of nearly 1.

    The parameter ``activation`` is "always" for a filter that re-estimates without a test. The expected
    configurations are those of flawed and of other robots.
    """
    population = Population(
        robots=4,
        flawed=2,
        flawed_accuracy=0.3,
        true_accuracy=1.0,
        comms_period=2,
        filter_period=4,  # in ticks; that of the firmware is in rounds of 2 ticks
        memory=64,
        omega="0.1",
        filter=filters,
        activation=activation,
    )

    largest_b_hat = 1 - 2**-20  # the firmware refuses 1.0
    robot_0 = RobotSetup(id=0, firmware="native", b_hat=0.3, config=flawed_config, comms_period=2)
    robot_2 = RobotSetup(id=2, firmware="native", b_hat=largest_b_hat, config=other_config, comms_period=2)
    assert population.setup_of(0) == robot_0
    assert population.setup_of(1) == replace(robot_0, id=1)
    assert population.setup_of(2) == robot_2
    assert population.setup_of(3) == replace(robot_2, id=3)


@pytest.mark.parametrize(
    ("filters", "activation", "unused_parameters"),
    [
        ("none", "adaptive", {"omega", "activation"}),
        ("robust", "adaptive", {"omega", "activation"}),
        ("asdf-minus", "adaptive", set()),
        ("asdf-plus", "always", {"omega"}),
    ],
)
def test_a_population_lists_the_parameters_that_its_filter_does_not_use(
    filters: str, activation: Activation, unused_parameters: set[str]
) -> None:
    """The commands refuse such options. ``activation`` "always" leaves out the test that omega is for.

    The sensors drift, so that the parameters of a drift are used.
    """
    population = Population(
        robots=4, flawed=2, filter=filters, activation=activation, omega="0.1", drift="linear"
    )
    assert set(population.unused_parameters()) == unused_parameters


def test_a_population_can_be_made_again_from_its_parameters() -> None:
    """``parameters`` returns what a report says of the robots, from which an equal population is made."""
    population = Population(
        robots=4, flawed=2, flawed_accuracy=0.3, memory=64, omega="0.1", drift="linear", drift_of="flawed"
    )
    assert Population(**population.parameters()) == population


def test_the_sensors_of_all_robots_drift_unless_only_flawed_robots_are_to_drift() -> None:
    """Two of four robots are flawed. ``drifting`` is the number of robots whose sensors drift."""
    assert Population(robots=4, flawed=2, drift="linear", drift_of="flawed").drifting == 2
    assert Population(robots=4, flawed=2, drift="linear").drifting == 4


@pytest.mark.parametrize(
    ("parameters", "expected_message"),
    [
        ({"drift_of": "flawed"}, "drift_of is flawed but drift is none"),  # so that no sensor would drift
        ({"memory": 66}, "memory is 66; it must be a multiple of 4"),
    ],
)
def test_a_population_with_a_wrong_parameter_is_refused(
    parameters: dict[str, Any], expected_message: str
) -> None:
    """The error names the parameter: flawed robots are to drift without a drift, or a wrong memory."""
    with pytest.raises(ParameterError, match=expected_message):
        Population(**parameters)


@pytest.mark.parametrize(("robots", "expected_neighbours"), [(1, 2), (4, 3), (128, 127), (129, 127)])
def test_the_table_of_thresholds_is_for_as_many_neighbours_as_a_robot_can_hear(
    robots: int, expected_neighbours: int
) -> None:
    """A robot can hear all others. The table is for at least 2, and at most 127, as there are 128 ids."""
    # Fully connected swarms of 129 robots are refused, and those with a dynamic topology are not.
    population = Population(robots=robots, topology="dynamic", filter="asdf-plus")
    table = population.config(0).table
    assert table is not None
    assert table.q == expected_neighbours, "neighbours up to which the table is exact"
