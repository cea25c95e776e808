"""Swarms in which things go wrong: what is injected arrives, is counted, and breaks nothing."""

from __future__ import annotations

import os
import re
from collections import Counter
from pathlib import Path
from statistics import fmean
from typing import Any

import can
import pytest
from can.interfaces import virtual

from host_tools.swarm.swarms import ON_ONE_BUS, ON_OWN_BUSES, content, own_bus, record, small, states
from mcp_asdf_tools.bus.frames import Estimate, FrameFormat, Heartbeat, decode_estimate, decode_heartbeat
from mcp_asdf_tools.bus.interfaces import BusChoice
from mcp_asdf_tools.recording.events import EventsReader, InjectedFrame
from mcp_asdf_tools.recording.replay import verify
from mcp_asdf_tools.swarm.carrier import Wiring
from mcp_asdf_tools.swarm.run import SwarmRun, run_swarm
from mcp_asdf_tools.swarm.settings import SwarmSettings
from mcp_asdf_tools.swarm.swarm import Swarm
from multicast import multicast
from support import ROOT, slow

pytestmark = pytest.mark.usefixtures("no_bus_is_left")

UDP_PORT = 10_000 + os.getpid() % 500 * 40
"""And some more: of this process, for tests in others run at the same time."""
MIX = (
    *("loss=0.1", "corrupt=0.1,bits=2", "delay=0.2,ticks=3", "duplicate=0.2,ticks=1", "babble=0.1,frames=3"),
    *("crash=0.01,ticks=6", "crash=0.01,ticks=4,rejoin=restored", "busoff=0.01,ticks=3"),
    *("freeze=0.05", "liar=0.05,x=1,alpha=1e5", "collide=0.05,id=2", "sybil=0.05,ids=1+9,alpha=0"),
)


def udp(port: int, returns_own: bool = False) -> can.BusABC:
    """Join a multicast group; skips the test where there are none."""
    multicast(250)
    return BusChoice("udp_multicast", {"port": port, "hop_limit": 0, "ignore_config": True}).open(returns_own)


MEDIA = {
    "one bus": ON_ONE_BUS,
    "no bus": Wiring(channel="none"),
    "a bus for each": ON_OWN_BUSES,
    "one group": Wiring(lambda robot: udp(UDP_PORT, returns_own=True)),
    "a group for each": Wiring(lambda robot: udp(UDP_PORT + 1 + robot), is_shared=False),
}


def figures(run: SwarmRun) -> Any:
    return run.results["frames"]


def injected(run: SwarmRun) -> list[int]:
    return [fault["injected"] for fault in run.results["faults"]]


@pytest.mark.parametrize("medium", list(MEDIA)[1:])
@pytest.mark.parametrize(
    ("faults", "world"),
    [
        pytest.param((), {}, marks=pytest.mark.slow),
        (MIX, {"telemetry_period": 7, "comms_period": 4}),
        pytest.param(
            MIX,
            {"topology": "dynamic", "density": 2.0, "latency": 1, "firmware": "mirror"},
            marks=pytest.mark.slow,
        ),
    ],
    ids=["lossless", "mix", "moving"],
)
def test_every_medium_carries_the_same(medium: str, faults: tuple[str, ...], world: dict[str, Any]) -> None:
    """Frames, what robots make of them, results and events; time stamps where a medium keeps them."""
    settings, logs = small(*faults, **world), (list[str](), list[str]())
    reference, sent = record(settings, events=logs[0])
    run, frames = record(settings, MEDIA[medium], events=logs[1])
    assert content(frames) == content(sent)
    assert states(run.nodes) == states(reference.nodes)
    assert run.results == reference.results
    assert logs[0] == logs[1]
    assert medium != "no bus" or {frame.channel for frame in frames} == {"none"}
    assert "group" in medium or [f.timestamp for f in frames] == [f.timestamp for f in sent]
    assert all(injected(run))


def test_on_its_own_bus_a_robots_traffic_is_what_it_says_and_hears() -> None:
    """A third connection there sees the robot's frames, and those that are in range and get through."""
    with Swarm(small("loss,robots=1", steps=5), ON_OWN_BUSES) as swarm, own_bus(0) as spy:
        run_swarm(swarm)
        heard = [*iter(lambda: spy.recv(0), None)]
    said = [decode_estimate(frame, FrameFormat()) for frame in heard]
    assert Counter(each.sender for each in said if isinstance(each, Estimate)) == {0: 5, 2: 5, 3: 5, 4: 5}


SENT = 66
"""Frames of a robot in 60 ticks: an estimate in each, a heartbeat in each second."""
NOTHING: dict[str, Any] = {"refused": 0, "strays": 0, "rejected": {}, "id_conflicts": {}}
"""Goes wrong."""


@pytest.mark.parametrize(
    ("fault", "injected_in_all", "expected", "replayed"),
    [
        ("loss=0", 0, {"sent": 300, "delivered": 1200, "heartbeats_heard": 120, **NOTHING}, ()),
        ("loss", SENT * 20, {"delivered": 0, "heartbeats_heard": 0, "arrived": 0, "in_range": SENT * 20}, ()),
        # All messages three ticks late: those of the last three rounds never come.
        ("delay,ticks=3", SENT * 20, {"delivered": (60 - 3) * 20, "refused": 0}, ()),
        ("duplicate,ticks=0", SENT * 20, {"delivered": 2 * 60 * 20, "refused": 60 * 20}, ()),
        # The copy of the last round comes first, so it is the new message that is a repetition.
        ("duplicate,ticks=1", SENT * 20, {"delivered": (60 + 59) * 20, "refused": 59 * 20}, ()),
        ("corrupt,bits=64", SENT * 20, {"delivered": 0, "arrived": SENT * 20}, ()),
        ("babble,frames=4,robots=3,from=10,to=20", 40, {"arrived": (SENT * 5 + 40) * 4}, (300, 0, 0, 40)),
        ("crash,robots=1,from=20,to=35", 15, {"sent": 60 * 5 - 15, "delivered": 1080}, (285, 0, 0, 0)),
        ("busoff,robots=1,from=20,to=35", 15, {"sent": 60 * 5, "delivered": 1080}, (285, 0, 0, 0)),
        ("freeze,robots=1,from=30", 30, {"delivered": 60 * 20, "refused": 0}, (270, 30, 0, 0)),
        ("liar,robots=2", 60, {"delivered": 60 * 20, "refused": 0}, (240, 60, 0, 0)),
        ("liar,robots=1,from=10,to=20,alpha=1e-9", 10, {"refused": 0}, (290, 10, 0, 0)),
        ("collide,robots=3,id=3", SENT, {"delivered": 60 * 20, **NOTHING}, ()),
        # Robot 2 refuses its own id; the other three hear 2 twice, robot 3 once.
        ("collide,robots=3,id=2", SENT, {"id_conflicts": {"2": 60}, "refused": 240}, (240, 0, 60, SENT)),
    ],
)
def test_what_a_fault_does(
    fault: str, injected_in_all: int, expected: dict[str, Any], replayed: tuple[int, ...], tmp_path: Path
) -> None:
    """To the swarm, and to a replay: broadcasts reproduced, falsified and foreign, and frames of no robot."""
    path, events = tmp_path / "run.events", list[str]()
    run, frames = record(small(fault), events=events)
    path.write_text("".join(events))
    assert injected(run) == [injected_in_all]
    assert {name: figures(run)[name] for name in expected} == expected
    assert figures(run)["on_the_bus"] == len(frames)
    if fault == "loss":
        assert all(node.robot.x == node.robot.x_hat for node in run.nodes)
    with EventsReader(path) as reader:
        verdict = verify(frames, reader)
    with EventsReader(path) as reader:
        others = sum(isinstance(entry, InjectedFrame) for entry in reader.entries())
    assert (verdict.difference, verdict.not_logged) == (None, 0)
    found = (verdict.reproduced, verdict.falsified, verdict.foreign, others)
    assert found == (replayed or (300, 0, 0, 0))


@pytest.mark.parametrize("medium", ["no bus", "a bus for each"])
def test_ids_that_are_not_allowed_do_nothing(medium: str) -> None:
    """A node under other ids changes no bit; under the others' ids it does."""
    honest, _ = record(small())
    found, _ = record(small("sybil,robots=1,ids=5-9+127", allow="0-4"), MEDIA[medium])
    assert states(found.nodes) == states(honest.nodes)
    assert figures(found)["unknown"] == 60 * 6 * 4 and figures(honest)["unknown"] == 0
    assert figures(found)["delivered"] == figures(honest)["delivered"]
    spoofed, _ = record(small("sybil,robots=1,ids=0", allow="0-4"), MEDIA[medium])
    assert (figures(spoofed)["unknown"], figures(spoofed)["id_conflicts"]) == (0, {"0": 60})
    nobody, _ = record(small(allow="127"), MEDIA[medium])
    assert all(node.robot.x == node.robot.x_hat for node in nobody.nodes)


@pytest.mark.parametrize("rejoin", ["new", "restored"])
def test_a_crashed_robot_rejoins(rejoin: str) -> None:
    """New, with the accuracy and the numbers that it started with, or as it was."""
    settings = small(f"crash,robots=0,from=45,to=47,rejoin={rejoin}", seed=3, fill_ratio=0.95)
    b_hat: list[float] = []
    run, frames = record(settings, hooks=[lambda swarm: b_hat.append(swarm.nodes[0].robot.b_hat)])
    assert b_hat[44] > 0.9
    assert b_hat[47] == pytest.approx(0.55 if rejoin == "new" else b_hat[44], abs=1e-6)
    assert run.nodes[0].robot.t == (60 - 47 if rejoin == "new" else 60 - 2)
    spoken = [decode_estimate(frame, FrameFormat()) for frame in frames]
    numbers = [m.transfer_id for m in spoken if isinstance(m, Estimate) and m.sender == 0]
    assert numbers == [k % 32 for k in (*range(45), *(range(13) if rejoin == "new" else range(45, 58)))]


REJOINING = {
    "new": [*((10 * uptime, uptime) for uptime in range(5)), (47, 0), (57, 1)],
    "restored": [*((10 * uptime, uptime) for uptime in range(5)), (52, 5)],
}
"""The ticks and uptimes of the heartbeats of a robot that is dead in ticks 45 and 46, by how it rejoins."""


@pytest.mark.parametrize(("rejoin", "expected"), REJOINING.items())
def test_a_robot_that_rejoins_sends_heartbeats_in_its_own_seconds(
    rejoin: str, expected: list[tuple[int, int]]
) -> None:
    _, frames = record(small(f"crash,robots=0,from=45,to=47,rejoin={rejoin}"))
    heartbeats = [(frame, decode_heartbeat(frame)) for frame in frames]
    found = [
        (round(10 * frame.timestamp), heartbeat.uptime)
        for frame, heartbeat in heartbeats
        if isinstance(heartbeat, Heartbeat) and heartbeat.sender == 0
    ]
    assert found == expected


def test_in_real_time_what_comes_too_late_is_heard_in_the_next_tick_and_counted(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    settings, usual = small(robots=3, clock="real-time", steps_per_second=1000), virtual.VirtualBus.recv
    with Swarm(settings, ON_ONE_BUS) as swarm:
        monkeypatch.setattr(
            virtual.VirtualBus, "recv", lambda bus, seconds: None if swarm.ticks == 5 else usual(bus, seconds)
        )
        run = run_swarm(swarm)
    assert (swarm.ticks, swarm.traffic.missed) == (60, 3)
    # Two messages of each neighbour in one round: the second is a repetition.
    assert (swarm.traffic.total("delivered"), swarm.traffic.total("refused")) == (60 * 3 * 2, 3 * 2)
    clock = run.results["clock"]
    assert 0 <= clock["mean_lateness"] <= clock["max_lateness"]


@pytest.mark.parametrize("medium", ["one bus", "a group for each", *slow(["one group"])])
def test_a_flood_is_read_while_it_comes(medium: str) -> None:
    """More frames than a socket keeps."""
    flood = "babble,frames=900,robots=0,from=1,to=2"
    run, frames = record(small(flood, steps=3), MEDIA[medium])
    assert figures(run)["arrived"] == len(frames) * 4 == (3 + 1) * 5 * 4 + 900 * 4


# The figures of docs/threats.md

FIGURES = re.compile(r"\d\.\d{3}, \d\.\d{3}, \d\.\d{3}")
ROWS = [
    (re.findall(r"`(\w+,robots=[^`]*)`", line.split("|")[1]), FIGURES.findall(line))
    for line in (ROOT / "docs/threats.md").read_text(encoding="utf-8").splitlines()
    if line.startswith("|") and FIGURES.search(line)
]


@pytest.mark.parametrize(("faults", "figures"), [*ROWS[:2], *slow(ROWS[2:])])
def test_the_table_of_threats_says_what_happens(faults: list[str], figures: list[str]) -> None:
    """The second row is the liar that takes all; robots from 6 on are those that go wrong."""
    assert len(ROWS) == 20 and ROWS[0][0] == []
    assert len(figures) == 2 + ("sybil" in str(faults))
    found = []
    runs: list[tuple[str, str]] = [("asdf-plus", ""), ("robust", ""), ("asdf-plus", "0-19")]
    for filtering, allow in runs[: len(figures)]:
        settings = SwarmSettings(
            steps=500, filter_period=100, filter=filtering, faults=tuple(faults), allow=allow
        )
        last = max({6}.union(*(fault.robots for fault in settings.faults)))
        with Swarm(settings, Wiring()) as swarm:
            robots = [node.robot for node in run_swarm(swarm).nodes]
        groups = robots[:6], robots[last + 1 :]
        error = fmean(abs(robot.x - 0.55) for group in groups for robot in group)
        flawed, sound = (fmean(robot.b_hat for robot in group) for group in groups)
        found.append(f"{error:.3f}, {flawed:.3f}, {sound:.3f}")
    assert found == figures
