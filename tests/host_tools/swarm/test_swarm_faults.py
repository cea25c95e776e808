"""Swarms in which things go wrong: what is injected arrives, is counted, and breaks nothing."""

from __future__ import annotations

import csv
import os
from collections import Counter
from pathlib import Path
from statistics import fmean
from typing import Any, NamedTuple

import can
import pytest
from can.interfaces import virtual

from host_tools.swarm.swarms import (
    ON_ONE_BUS,
    ON_OWN_BUSES,
    identifiers_and_data,
    own_bus,
    run_and_record,
    saved_robots,
    small_swarm,
)
from mcp_asdf_tools.bus.frames import Estimate, FrameFormat, Heartbeat, decode_estimate, decode_heartbeat
from mcp_asdf_tools.bus.interfaces import BusChoice
from mcp_asdf_tools.cli.main import main
from mcp_asdf_tools.recording.events import EventsReader, InjectedFrame
from mcp_asdf_tools.recording.replay import verify
from mcp_asdf_tools.swarm.carrier import Wiring
from mcp_asdf_tools.swarm.run import SwarmRun, run_swarm
from mcp_asdf_tools.swarm.settings import SwarmSettings
from mcp_asdf_tools.swarm.swarm import Swarm
from multicast import multicast
from support import ROOT, block_with, slow

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


def frame_counts(run: SwarmRun) -> Any:
    """Return the results of a run that count frames, by name."""
    return run.results["frames"]


def hit_counts(run: SwarmRun) -> list[int]:
    """Return how often each fault of a run has hit."""
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
def test_swarms_without_a_bus_or_with_several_run_as_on_one_that_all_share(
    medium: str, faults: tuple[str, ...], world: dict[str, Any]
) -> None:
    settings = small_swarm(*faults, **world)
    events_on_one_bus, events = list[str](), list[str]()
    run_on_one_bus, frames_on_one_bus = run_and_record(settings, events=events_on_one_bus)
    run, frames = run_and_record(settings, MEDIA[medium], events=events)

    assert identifiers_and_data(frames) == identifiers_and_data(frames_on_one_bus)
    assert saved_robots(run.nodes) == saved_robots(run_on_one_bus.nodes)
    assert run.results == run_on_one_bus.results
    assert events == events_on_one_bus
    assert all(hit_counts(run))


@pytest.mark.parametrize("medium", ["no bus", "a bus for each"])
def test_frames_have_the_same_times_on_several_buses_as_on_one(medium: str) -> None:
    """Multicast groups keep no time stamps of the sender."""
    _, frames_on_one_bus = run_and_record(small_swarm())
    _, frames = run_and_record(small_swarm(), MEDIA[medium])
    assert [frame.timestamp for frame in frames] == [frame.timestamp for frame in frames_on_one_bus]


def test_frames_of_a_swarm_without_a_bus_have_a_channel_for_the_log() -> None:
    _, frames = run_and_record(small_swarm(), Wiring(channel="none"))
    assert {frame.channel for frame in frames} == {"none"}


def test_the_bus_of_a_robot_has_its_frames_and_those_that_reach_it() -> None:
    """Here those of robot 1 are lost on their way."""
    with Swarm(small_swarm("loss,robots=1", steps=5), ON_OWN_BUSES) as swarm, own_bus(0) as listener:
        run_swarm(swarm)
        frames = list(iter(lambda: listener.recv(0), None))
    contents = [decode_estimate(frame, FrameFormat()) for frame in frames]
    senders = Counter(estimate.sender for estimate in contents if isinstance(estimate, Estimate))

    assert senders == {0: 5, 2: 5, 3: 5, 4: 5}


SENT = 60 + 6
"""Frames of a robot in 60 ticks: an estimate in each, a heartbeat in each of 6 seconds."""
NOTHING_WRONG: dict[str, Any] = {"refused": 0, "strays": 0, "rejected": {}, "id_conflicts": {}}


@pytest.mark.parametrize(
    ("fault", "hits", "expected_counts"),
    [
        ("loss=0", 0, {"sent": 300, "delivered": 1200, "heartbeats_heard": 120, **NOTHING_WRONG}),
        ("loss", SENT * 20, {"delivered": 0, "heartbeats_heard": 0, "arrived": 0, "in_range": SENT * 20}),
        # All messages come three ticks late, and those of the last three rounds never.
        ("delay,ticks=3", SENT * 20, {"delivered": (60 - 3) * 20, "refused": 0}),
        ("duplicate,ticks=0", SENT * 20, {"delivered": 2 * 60 * 20, "refused": 60 * 20}),
        # The copy of the last round comes first, so it is the new message that is a repetition.
        ("duplicate,ticks=1", SENT * 20, {"delivered": (60 + 59) * 20, "refused": 59 * 20}),
        ("corrupt,bits=64", SENT * 20, {"delivered": 0, "arrived": SENT * 20}),
        ("babble,frames=4,robots=3,from=10,to=20", 40, {"arrived": (SENT * 5 + 40) * 4}),
        ("crash,robots=1,from=20,to=35", 15, {"sent": 60 * 5 - 15, "delivered": 1080}),
        ("busoff,robots=1,from=20,to=35", 15, {"sent": 60 * 5, "delivered": 1080}),
        ("freeze,robots=1,from=30", 30, {"delivered": 60 * 20, "refused": 0}),
        ("liar,robots=2", 60, {"delivered": 60 * 20, "refused": 0}),
        ("liar,robots=1,from=10,to=20,alpha=1e-9", 10, {"refused": 0}),
        ("collide,robots=3,id=3", SENT, {"delivered": 60 * 20, **NOTHING_WRONG}),
        # Robot 2 refuses its own id; the other three receive from 2 twice, robot 3 once.
        ("collide,robots=3,id=2", SENT, {"id_conflicts": {"2": 60}, "refused": 240}),
    ],
)
def test_a_fault_hits_as_many_frames_as_its_options_say_with_its_effect(
    fault: str, hits: int, expected_counts: dict[str, Any]
) -> None:
    """Five robots run for 60 ticks, and each frame has four receivers, which together are 20 paths."""
    run, frames = run_and_record(small_swarm(fault))
    assert hit_counts(run) == [hits]
    assert {name: frame_counts(run)[name] for name in expected_counts} == expected_counts
    assert frame_counts(run)["on_the_bus"] == len(frames)


def test_robots_whose_frames_are_all_lost_know_their_own_estimates_alone() -> None:
    run, _ = run_and_record(small_swarm("loss"))
    assert all(node.robot.x == node.robot.x_hat for node in run.nodes)


class Broadcasts(NamedTuple):
    """Numbers of broadcasts that a replay knows; a run without faults has 5 robots * 60 ticks = 300.

    Attributes:
        reproduced: Those of robots, as they were sent.
        falsified: Those of robots that were replaced by others.
        foreign: Those that another node sent under a robot's id.
        injected: Frames that no robot sends.
    """

    reproduced: int
    falsified: int = 0
    foreign: int = 0
    injected: int = 0


@pytest.mark.parametrize(
    ("fault", "expected"),
    [
        ("loss=0", Broadcasts(300)),
        ("loss", Broadcasts(300)),
        ("delay,ticks=3", Broadcasts(300)),
        ("duplicate,ticks=0", Broadcasts(300)),
        ("duplicate,ticks=1", Broadcasts(300)),
        ("corrupt,bits=64", Broadcasts(300)),
        ("babble,frames=4,robots=3,from=10,to=20", Broadcasts(300, injected=40)),
        ("crash,robots=1,from=20,to=35", Broadcasts(285)),
        ("busoff,robots=1,from=20,to=35", Broadcasts(285)),
        ("freeze,robots=1,from=30", Broadcasts(270, falsified=30)),
        ("liar,robots=2", Broadcasts(240, falsified=60)),
        ("liar,robots=1,from=10,to=20,alpha=1e-9", Broadcasts(290, falsified=10)),
        ("collide,robots=3,id=3", Broadcasts(300)),
        ("collide,robots=3,id=2", Broadcasts(240, foreign=60, injected=SENT)),
    ],
)
def test_replay_tells_which_broadcasts_a_fault_has_changed(
    fault: str, expected: Broadcasts, tmp_path: Path
) -> None:
    """A run writes its events, by which replay computes all broadcasts again.

    Those that a fault has falsified, sent under another robot's id or injected are counted, and the others
    are reproduced.
    """
    path, events = tmp_path / "run.events", list[str]()
    _run, frames = run_and_record(small_swarm(fault), events=events)
    path.write_text("".join(events))

    with EventsReader(path) as reader:
        verdict = verify(frames, reader)
    with EventsReader(path) as reader:
        injected = sum(isinstance(entry, InjectedFrame) for entry in reader.entries())

    assert verdict.difference is None
    assert verdict.not_logged == 0
    assert Broadcasts(verdict.reproduced, verdict.falsified, verdict.foreign, injected) == expected


without_and_with_buses = pytest.mark.parametrize("medium", ["no bus", "a bus for each"])


@without_and_with_buses
def test_estimates_under_ids_that_are_not_allowed_change_nothing(medium: str) -> None:
    undisturbed_run, _ = run_and_record(small_swarm())
    run, _ = run_and_record(small_swarm("sybil,robots=1,ids=5-9+127", allow="0-4"), MEDIA[medium])
    assert saved_robots(run.nodes) == saved_robots(undisturbed_run.nodes)
    assert frame_counts(run)["delivered"] == frame_counts(undisturbed_run)["delivered"]


@without_and_with_buses
def test_estimates_under_ids_that_are_not_allowed_are_counted_as_unknown(medium: str) -> None:
    run, _ = run_and_record(small_swarm("sybil,robots=1,ids=5-9+127", allow="0-4"), MEDIA[medium])
    ticks, made_up_ids, receivers = 60, 6, 4
    assert frame_counts(run)["unknown"] == ticks * made_up_ids * receivers


@without_and_with_buses
def test_estimates_under_the_id_of_a_robot_that_is_allowed_are_conflicts(medium: str) -> None:
    run, _ = run_and_record(small_swarm("sybil,robots=1,ids=0", allow="0-4"), MEDIA[medium])
    assert frame_counts(run)["unknown"] == 0
    assert frame_counts(run)["id_conflicts"] == {"0": 60}  # one in each tick


@without_and_with_buses
def test_robots_that_allow_no_id_of_the_swarm_know_their_own_estimates_alone(medium: str) -> None:
    run, _ = run_and_record(small_swarm(allow="127"), MEDIA[medium])
    assert all(node.robot.x == node.robot.x_hat for node in run.nodes)


def crash_in_two_ticks(rejoin: str) -> SwarmSettings:
    """Settings of a run of 60 ticks in which robot 0 is dead in ticks 45 and 46."""
    return small_swarm(f"crash,robots=0,from=45,to=47,rejoin={rejoin}", seed=3, fill_ratio=0.95)


def b_hat_around_the_crash(rejoin: str) -> tuple[float, float]:
    """Return the assumed accuracy of that robot before and after its crash; it began with 0.55."""
    b_hat_by_tick: list[float] = []
    run_and_record(
        crash_in_two_ticks(rejoin), hooks=[lambda swarm: b_hat_by_tick.append(swarm.nodes[0].robot.b_hat)]
    )
    last_tick_before, first_tick_after = 44, 47
    return b_hat_by_tick[last_tick_before], b_hat_by_tick[first_tick_after]


def test_a_robot_that_rejoins_new_begins_with_the_accuracy_of_its_start() -> None:
    before, after = b_hat_around_the_crash("new")
    assert before > 0.9
    assert after == pytest.approx(0.55, abs=1e-6)


def test_a_robot_that_rejoins_restored_has_the_accuracy_that_it_had() -> None:
    before, after = b_hat_around_the_crash("restored")
    assert before > 0.9
    assert after == before


@pytest.mark.parametrize(("rejoin", "observations"), [("new", 60 - 47), ("restored", 60 - 2)])
def test_a_robot_that_rejoins_has_its_observations_only_if_it_is_restored(
    rejoin: str, observations: int
) -> None:
    """It is dead in ticks 45 and 46 of 60, and makes an observation in each of the others."""
    run, _ = run_and_record(crash_in_two_ticks(rejoin))
    assert run.nodes[0].robot.t == observations


@pytest.mark.parametrize(
    ("rejoin", "numbers"), [("new", [*range(45), *range(13)]), ("restored", [*range(58)])]
)
def test_a_robot_that_rejoins_numbers_its_estimates_anew_unless_it_is_restored(
    rejoin: str, numbers: list[int]
) -> None:
    _, frames = run_and_record(crash_in_two_ticks(rejoin))
    contents = [decode_estimate(frame, FrameFormat()) for frame in frames]
    transfer_ids = [
        estimate.transfer_id
        for estimate in contents
        if isinstance(estimate, Estimate) and estimate.sender == 0
    ]

    assert transfer_ids == [number % 32 for number in numbers]


REJOINING = {
    "new": [*((10 * uptime, uptime) for uptime in range(5)), (47, 0), (57, 1)],
    "restored": [*((10 * uptime, uptime) for uptime in range(5)), (52, 5)],
}
"""The ticks and uptimes of the heartbeats of a robot that is dead in ticks 45 and 46, by how it rejoins."""


@pytest.mark.parametrize(("rejoin", "expected"), REJOINING.items())
def test_a_robot_that_rejoins_sends_heartbeats_in_its_own_seconds(
    rejoin: str, expected: list[tuple[int, int]]
) -> None:
    _, frames = run_and_record(small_swarm(f"crash,robots=0,from=45,to=47,rejoin={rejoin}"))
    heartbeats = [(frame, decode_heartbeat(frame)) for frame in frames]
    found = [
        (round(10 * frame.timestamp), heartbeat.uptime)
        for frame, heartbeat in heartbeats
        if isinstance(heartbeat, Heartbeat) and heartbeat.sender == 0
    ]

    assert found == expected


@pytest.fixture
def run_with_a_late_tick(monkeypatch: pytest.MonkeyPatch) -> SwarmRun:
    """A run of 3 robots in real time in which the frames of tick 5 arrive in tick 6."""
    settings, receive = (
        small_swarm(robots=3, clock="real-time", steps_per_second=1000),
        virtual.VirtualBus.recv,
    )
    with Swarm(settings, ON_ONE_BUS) as swarm:
        monkeypatch.setattr(
            virtual.VirtualBus,
            "recv",
            lambda bus, timeout: receive(bus, timeout) if swarm.ticks != 5 else None,
        )
        return run_swarm(swarm)


def test_frames_that_come_too_late_in_real_time_are_counted(run_with_a_late_tick: SwarmRun) -> None:
    assert run_with_a_late_tick.results["steps"] == 60
    assert frame_counts(run_with_a_late_tick)["missed"] == 3


def test_frames_that_come_too_late_in_real_time_are_received_in_the_next_tick(
    run_with_a_late_tick: SwarmRun,
) -> None:
    ticks, robots, receivers = 60, 3, 2
    assert frame_counts(run_with_a_late_tick)["delivered"] == ticks * robots * receivers
    # Of two messages of a neighbour in one round the second is a repetition.
    assert frame_counts(run_with_a_late_tick)["refused"] == 3 * 2


def test_a_run_in_real_time_reports_how_late_ticks_have_begun(run_with_a_late_tick: SwarmRun) -> None:
    clock = run_with_a_late_tick.results["clock"]
    assert 0 <= clock["mean_lateness"] <= clock["max_lateness"]


@pytest.mark.parametrize("medium", ["one bus", "a group for each", *slow(["one group"])])
def test_no_frame_is_lost_when_a_robot_floods_the_bus(medium: str) -> None:
    """There are more frames than a socket holds, so that they have to be read while they are sent."""
    run, frames = run_and_record(
        small_swarm("babble,frames=900,robots=0,from=1,to=2", steps=3), MEDIA[medium]
    )
    estimates_and_heartbeats = (3 + 1) * 5
    assert len(frames) == estimates_and_heartbeats + 900
    assert frame_counts(run)["arrived"] == 4 * len(frames)  # receivers


# The figures of docs/internals/threats.csv, and the table of docs/threats.md

SETTINGS: dict[str, dict[str, Any]] = {
    "asdf_plus": {"filter": "asdf-plus"},
    "robust": {"filter": "robust"},
    "asdf_plus_allow_0_19": {"filter": "asdf-plus", "allow": "0-19"},
}
"""Settings of a row's runs, by how their columns begin. Only rows of made-up ids use the last ones."""

FIGURES = ("error", "flawed_b_hat", "healthy_b_hat")
"""How the columns of a run end: what `figures_of_run` returns."""

ATTACKS = list(csv.DictReader((ROOT / "docs/internals/threats.csv").read_text(encoding="utf-8").splitlines()))
RUNS = [attack for attack in ATTACKS if attack["robust_error"]]
"""The attacks and faults that can be run; the others are words."""


def figures_of_run(faults: list[str], settings: dict[str, Any]) -> list[str]:
    """Return the mean error of robots without a fault, and the mean b_hat of flawed and of other ones.

    Robots from 6 on have the faults, and the first six are flawed.
    """
    swarm_settings = SwarmSettings(steps=500, filter_period=100, faults=tuple(faults), **settings)
    last_with_fault = max({6}.union(*(fault.robots for fault in swarm_settings.faults)))
    with Swarm(swarm_settings, Wiring()) as swarm:
        robots = [node.robot for node in run_swarm(swarm).nodes]
    flawed_robots, other_robots = robots[:6], robots[last_with_fault + 1 :]
    mean_error = fmean(abs(robot.x - 0.55) for robot in flawed_robots + other_robots)
    b_hat = [fmean(robot.b_hat for robot in group) for group in (flawed_robots, other_robots)]
    return [f"{figure:.3f}" for figure in (mean_error, *b_hat)]


def test_the_table_of_threats_begins_with_a_swarm_without_faults() -> None:
    assert len(ATTACKS) == 27
    assert len(RUNS) == 20
    assert RUNS[0] == ATTACKS[0] and RUNS[0]["faults"] == ""


@pytest.mark.parametrize("row", [RUNS[1], *slow([RUNS[0], *RUNS[2:]])])
def test_the_table_of_threats_has_the_figures_of_these_runs(row: dict[str, str]) -> None:
    columns = {run: [f"{run}_{figure}" for figure in FIGURES] for run in SETTINGS}
    written = {run: [row[name] for name in names] for run, names in columns.items() if row[names[0]]}
    assert len(written) == (3 if "sybil" in row["faults"] else 2)
    faults = row["faults"].split()

    assert written == {run: figures_of_run(faults, SETTINGS[run]) for run in written}


def test_the_page_of_threats_puts_six_of_them_in_words() -> None:
    """Its words stand for the errors in the table, by the limits that it names."""

    def in_a_word(error: str) -> str:
        return "safe" if float(error) < 0.05 else "wrong" if float(error) < 0.2 else "lost"

    page = (ROOT / "docs/threats.md").read_text(encoding="utf-8")
    assert "ends below 0.05, *wrong* if below 0.2" in page
    by_name = {row["attack"]: row for row in RUNS}
    lines = page.partition("|---|---|---|---|---|\n")[2].partition("\n\n")[0].splitlines()
    assert len(lines) == 6
    for line in lines:
        name, *cells, _ = [cell.strip() for cell in line.strip("|").split("|")]
        error_asdf, error_robust = (by_name[name][f"{run}_error"] for run in ("asdf_plus", "robust"))
        assert cells == [in_a_word(error_asdf), in_a_word(error_robust), error_robust]
    assert f"the robust filter ends at {RUNS[0]['robust_error']}." in page


def test_the_page_of_threats_shows_what_its_commands_print(capsys: pytest.CaptureFixture[str]) -> None:
    page = ROOT / "docs/threats.md"
    for command in block_with(page, "--filter robust", "sh").splitlines():
        assert main(command.split()[1:]) == 0
    assert capsys.readouterr().out == block_with(page, "seed 1", "text")
