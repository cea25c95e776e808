"""The robot that swarms, nodes, neighbours and replays drive: its numbers, and records of it.

What it says and hears is compared with trials (test_swarm.py) and with the C node (tests/targets).
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
from mcp_asdf_tools.robots.bus_robot import BusRobot, Reception, Recorder
from mcp_asdf_tools.robots.filters import Activation
from mcp_asdf_tools.robots.population import Population
from mcp_asdf_tools.robots.record import RobotRecord
from mcp_asdf_tools.robots.suspicion import Suspicion
from mcp_asdf_tools.tables.thresholds import generate
from messages import encoded
from robots import ALPHA_ONE
from wire import TABLE, record

ESTIMATES = FrameFormat()


# Ticks, numbers, crashes


def counting(comms_period: int, **counters: int) -> BusRobot:
    """A robot whose counters may be close to where they wrap."""
    firmware = MirrorRobot(Config(filter=Filter.OFF), 5, 0.75)
    for name, value in counters.items():
        setattr(firmware.s, name, value)
    return BusRobot(record(5, comms_period=comms_period), ESTIMATES, make=lambda: firmware)


def test_a_broadcast_that_did_not_end_its_tick_stays_due() -> None:
    one = counting(3)
    assert [one.begin(None) for _ in range(5)] == [False, False, True, True, True]
    one.end()
    assert [one.begin(None) for _ in range(3)] == [False, False, True]


def test_counters_go_on_where_those_of_the_firmware_wrap() -> None:
    """In a long round of many messages, too."""
    one = counting(10**6, accepted=65_000, updates=65_535, tests=65_534, rejected=1, repeated=65_533)
    before = one.counters
    assert before == Counters(65_000, 65_533, 1, 65_534, 65_535)
    messages = np.array([[sender, 0, ALPHA_ONE] for sender in [5] * 998 + [6, 7]], np.uint32)
    for _ in range(300):
        one.begin(None)
        one.receive(messages)
        one.end()
    assert one.counters == replace(before, accepted=65_002, rejected=1 + 998 * 300, repeated=65_533 + 598)
    conflicts = Counter({(Suspicion.CONFLICT, 5): 998 * 300})
    assert one.reception == Reception(1000 * 300, 998 * 300 + 598, events=conflicts)
    assert one.telemetry(0.0).data == encoded(Telemetry(5, 1 << 22, 3 << 22, 255, 0)).data


def test_a_line_has_all_that_befell_a_robot_in_a_tick() -> None:
    """And what is left when it ends. The dead hear nothing, and wake to an event if all was lost."""
    lines, beat = list[str](), encoded(Heartbeat(8, 1, 0))
    own, *heard = (encoded(Estimate(sender, 9, 0, 0)) for sender in (5, 6, 7, 8))
    recorder = Recorder(5, lines.append, json.dumps)
    one = BusRobot(record(5), ESTIMATES, recorder)
    recorder.flush()
    one.begin(Observation.BLACK)
    one.listen([heard[0], beat, heard[1]])
    one.listen([heard[2]] * 2)
    one.end()
    for loses_state in (False, True):
        one.die(loses_state)
        for frame in (own, beat, *heard):
            one.listen([frame])
            one.hear_stranger(frame)
        one.wake()
        assert (one.ticks, one.robot.t) == ((0, 0) if loses_state else (1, 1))
    one.begin(Observation.WHITE)
    one.listen([])
    recorder.silent()
    one.end()
    one.begin(None)
    one.listen(heard[:1])
    recorder.falsified(3, 4)
    recorder.foreign(heard[0])
    recorder.flush()
    assert lines == [
        "[5,1,[[6, 9, 0], [7, 9, 0], [8, 9, 0], [8, 9, 0]],3]\n",
        '[5,"restart",0,"silent",3]\n',
        '"106BB806#09000000000000E0"\n',
        "[5,2,[[6, 9, 0]],[3,4]]\n",
    ]
    assert one.reception == Reception(delivered=5, refused=1, heartbeats=1) and not one.reception.events


def test_what_is_no_estimate_is_counted_by_its_kind() -> None:
    one = BusRobot(record(5), ESTIMATES)
    for content in (Heartbeat(8, 1, 0), Telemetry(8, 9, 1 << 23, 1, 0), Estimate(6, 9, 0, 0), *Rejection):
        one.count(content, 3)
    others = [each for each in Rejection if each is not Rejection.ERROR_FRAME]
    assert one.reception == Reception(
        heartbeats=3, telemetry=3, errors=3, rejected=Counter(dict.fromkeys(others, 3))
    )
    one.reception = Reception()
    for said in (Estimate(5, 9, 0, 0), Estimate(6, 9, 0, 0), Heartbeat(8, 1, 0)):
        one.hear_stranger(encoded(said))
    own = Counter({(Suspicion.CONFLICT, 5): 1})
    assert one.reception == Reception(strays=2, heartbeats=1, events=own)


# Records


def test_a_record_is_the_same_after_json_and_makes_the_same_robot() -> None:
    own = record(5, "mirror", 0.55, comms_period=2, filter_period=10, memory=64)
    ends = [record(5, comms_period=each, filter_period=each) for each in (1, 2**32 - 1)]
    choosy = replace(record(5, table=None, filter=Filter.ALWAYS), allow=frozenset((0, 2, 3, 127)))
    assert choosy.plain()["allow"] == "0+2-3+127"
    for each in (own, choosy, *ends):
        assert RobotRecord.from_plain(each.plain()) == each
    table = Table(3, TABLE.entries)
    with pytest.raises(UsageError, match=r"omega is .*make one with mcp-asdf table"):
        record(5, table=table).plain()
    made = own.make()
    assert isinstance(made, MirrorRobot)
    assert made.state() == MirrorRobot(Config(own.config.table, Filter.ADAPTIVE, 5, 64), 5, 0.55).state()


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
def test_what_is_no_record_is_refused_by_name(changes: dict[str, Any], complaint: str) -> None:
    with pytest.raises((UsageError, FirmwareError), match=complaint):
        RobotRecord.from_plain(record(5).plain() | changes)


def test_flawed_robots_are_a_count_or_a_share() -> None:
    ways = (6, "6", np.int64(4), "44.9%", 0, 0.0, 10, 1.0, "30%", 0.25, "45%", "0.5")
    counts = [Population(robots=10, flawed=way).flawed for way in ways]
    assert counts == [6, 6, 4, 4, 0, 0, 10, 10, 3, 3, 5, 5]
    for wrong in (11, -1, -0.01, 1.01, "150%", True, "x", "nan", None):
        with pytest.raises(UsageError, match="; give a count, 0 to 10, or a share such as"):
            Population(robots=10, flawed=wrong)


@pytest.mark.parametrize("filters", ["none", "asdf-minus", "asdf-plus", "robust"])
@pytest.mark.parametrize("activation", ["adaptive", "always"])
def test_a_population_has_a_record_of_each_robot(filters: str, activation: Activation) -> None:
    periods: dict[str, Any] = {"comms_period": 2, "filter_period": 4, "memory": 64}
    accuracies: dict[str, Any] = {"robots": 4, "flawed": 2, "flawed_accuracy": 0.3, "true_accuracy": 1.0}
    drift: dict[str, Any] = {"drift": "linear", "drift_of": "flawed"}
    some = Population(**accuracies, **periods, **drift, filter=filters, activation=activation, omega="0.1")
    off, on = Config(None, Filter.OFF, 2, 64), Config(None, Filter.ALWAYS, 2, 64)
    if filters == "robust":
        on = replace(on, filter=Filter.ROBUST)
    elif activation == "adaptive":
        on = Config(generate(Decimal("0.1"), 3), Filter.ADAPTIVE, 2, 64)
    configs = [on if filters != "none" else off] * 2 + [off if filters in ("none", "asdf-minus") else on] * 2
    b_hat = [0.3, 0.3, 1 - 2**-20, 1 - 2**-20]
    expected = [RobotRecord(i, "native", b_hat[i], configs[i], 2) for i in range(4)]
    assert [some.record(robot) for robot in range(4)] == expected
    assert Population(**some.parameters()) == some
    assert (some.drifting, some.omega) == (2, Decimal("0.1"))
    with pytest.raises(ParameterError, match="drift_of is flawed but drift is none"):
        Population(drift_of="flawed")
    with pytest.raises(ParameterError, match="memory is 66; it must be a multiple of 4"):
        Population(memory=66)
    both = {"omega", "activation"}
    unused = {"none": both, "robust": both}.get(filters, {"omega"} if activation == "always" else set())
    assert set(some.unused_parameters()) == unused


def test_a_table_is_for_as_many_neighbours_as_a_round_can_have() -> None:
    for robots, neighbours in ((1, 2), (3, 2), (4, 3), (128, 127), (129, 127)):
        table = Population(robots=robots, topology="dynamic", filter="asdf-plus").config(0).table
        assert table is not None and table.q == neighbours
