"""Swarms in which things go wrong: what is injected arrives, is counted, and breaks nothing."""

from __future__ import annotations

import csv
import os
from collections import Counter
from collections.abc import Sequence
from pathlib import Path
from statistics import fmean
from typing import Any, NamedTuple

import can
import pytest
from can.interfaces import virtual

from host_tools.swarm.swarms import (
    MIXED_FAULTS,
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
from support import ROOT, block_with, cells_of_line, slow

pytestmark = pytest.mark.usefixtures("no_bus_is_left")

UDP_PORT = 10_000 + os.getpid() % 500 * 40
"""The first of the ports of this process. Tests that run in other processes at the same time have others."""


def udp(port: int, returns_own: bool = False) -> can.BusABC:
    """Join a multicast group; skips the test where there are none."""
    multicast(250)
    return BusChoice("udp_multicast", {"port": port, "hop_limit": 0, "ignore_config": True}).open(returns_own)


WIRINGS = {
    "one bus": ON_ONE_BUS,
    "no bus": Wiring(),
    "a bus for each": ON_OWN_BUSES,
    "one group": Wiring(lambda robot: udp(UDP_PORT, returns_own=True)),
    "a group for each": Wiring(lambda robot: udp(UDP_PORT + 1 + robot), is_shared=False),
}


def on_wirings(*names: str) -> pytest.MarkDecorator:
    """Run a test on wirings with these names, as its parameter ``wiring``."""
    return pytest.mark.parametrize("wiring", [WIRINGS[name] for name in names], ids=names)


def frame_counts(run: SwarmRun) -> Any:
    """Return the results of a run that count frames, by name."""
    return run.results["frames"]


def hit_counts(run: SwarmRun) -> list[int]:
    """Return how often each fault of a run has hit."""
    return [fault["injected"] for fault in run.results["faults"]]


@on_wirings("no bus", "a bus for each", "one group", "a group for each")
@pytest.mark.parametrize(
    ("faults", "changes"),
    [
        pytest.param((), {}, marks=pytest.mark.slow),
        (MIXED_FAULTS, {"telemetry_period": 7, "comms_period": 4}),
        pytest.param(
            MIXED_FAULTS,
            {"topology": "dynamic", "density": 2.0, "latency": 1, "firmware": "mirror"},
            marks=pytest.mark.slow,
        ),
    ],
    ids=["lossless", "mix", "moving"],
)
def test_a_swarm_runs_the_same_way_on_any_buses_as_on_one_virtual_bus(
    wiring: Wiring, faults: tuple[str, ...], changes: dict[str, Any]
) -> None:
    """The run may have no bus, or a bus per robot. Frames, final states, results and events are the same.

    Events are what happened to each robot. The settings of the swarm have faults, and other ``changes``.
    """
    settings = small_swarm(*faults, **changes)
    events_on_one_bus: list[str] = []  # each run adds its lines of events to its list
    events: list[str] = []
    run_on_one_bus, frames_on_one_bus = run_and_record(settings, ON_ONE_BUS, events=events_on_one_bus)
    run, frames = run_and_record(settings, wiring, events=events)

    assert identifiers_and_data(frames) == identifiers_and_data(frames_on_one_bus)
    assert saved_robots(run.nodes) == saved_robots(run_on_one_bus.nodes)
    assert run.results == run_on_one_bus.results
    assert events == events_on_one_bus
    assert all(hit_counts(run)), "each fault has hit at least once"


@on_wirings("no bus", "a bus for each")
def test_frames_have_the_same_times_on_several_buses_as_on_one(wiring: Wiring) -> None:
    """Multicast groups are left out, as they do not keep the time stamps of the sender."""
    _run, frames_on_one_bus = run_and_record(small_swarm(), ON_ONE_BUS)
    _run, frames = run_and_record(small_swarm(), wiring)
    times_on_one_bus = [frame.timestamp for frame in frames_on_one_bus]
    assert [frame.timestamp for frame in frames] == times_on_one_bus


def waiting_frames(bus: can.BusABC) -> list[can.Message]:
    """Return the frames that have arrived on a bus."""
    frames = []
    while (frame := bus.recv(0)) is not None:
        frames.append(frame)
    return frames


def estimates_among(frames: Sequence[can.Message]) -> list[Estimate]:
    """Return the estimates that frames carry, in their order."""
    contents = [decode_estimate(frame, FrameFormat()) for frame in frames]
    return [estimate for estimate in contents if isinstance(estimate, Estimate)]


def test_the_bus_of_a_robot_has_its_frames_and_those_that_reach_it() -> None:
    """Five robots send an estimate in each of five ticks, and those of robot 1 are lost.

    The bus of robot 0 has its own estimates, and those of robots 2 to 4.
    """
    settings = small_swarm("loss,robots=1", robots=5, steps=5)
    with Swarm(settings, ON_OWN_BUSES) as swarm, own_bus(0) as bus_of_robot_0:
        run_swarm(swarm)
        frames = waiting_frames(bus_of_robot_0)
    estimates_by_sender = Counter(estimate.sender for estimate in estimates_among(frames))

    assert estimates_by_sender == {0: 5, 2: 5, 3: 5, 4: 5}


FRAMES_OF_ROBOT = 60 + 6
"""Frames of a robot in 60 ticks: an estimate in each, a heartbeat in each of 6 seconds."""
PATHS = 5 * 4
"""Pairs of a sender and a receiver among five robots."""
NOTHING_WRONG: dict[str, Any] = {"refused": 0, "strays": 0, "rejected": {}, "id_conflicts": {}}


@pytest.mark.parametrize(
    ("fault", "expected_hits", "expected_counts"),
    [
        (
            "loss=0",
            0,
            {"sent": 60 * 5, "delivered": 60 * PATHS, "heartbeats_heard": 6 * PATHS, **NOTHING_WRONG},
        ),
        (
            "loss",
            FRAMES_OF_ROBOT * PATHS,
            {"delivered": 0, "heartbeats_heard": 0, "arrived": 0, "in_range": FRAMES_OF_ROBOT * PATHS},
        ),
        # All messages come three ticks late. So messages of the last three rounds never come.
        ("delay,ticks=3", FRAMES_OF_ROBOT * PATHS, {"delivered": (60 - 3) * PATHS, "refused": 0}),
        ("duplicate,ticks=0", FRAMES_OF_ROBOT * PATHS, {"delivered": 2 * 60 * PATHS, "refused": 60 * PATHS}),
        # The copy of the last round comes first, so it is the new message that is a repetition.
        (
            "duplicate,ticks=1",
            FRAMES_OF_ROBOT * PATHS,
            {"delivered": (60 + 59) * PATHS, "refused": 59 * PATHS},
        ),
        ("corrupt,bits=64", FRAMES_OF_ROBOT * PATHS, {"delivered": 0, "arrived": FRAMES_OF_ROBOT * PATHS}),
        ("babble,frames=4,robots=3,from=10,to=20", 4 * 10, {"arrived": (FRAMES_OF_ROBOT * 5 + 4 * 10) * 4}),
        # For 15 ticks one robot neither sends to the four others nor receives from them: 8 paths.
        ("crash,robots=1,from=20,to=35", 15, {"sent": 60 * 5 - 15, "delivered": 60 * PATHS - 15 * 8}),
        ("busoff,robots=1,from=20,to=35", 15, {"sent": 60 * 5, "delivered": 60 * PATHS - 15 * 8}),
        ("freeze,robots=1,from=30", 30, {"delivered": 60 * PATHS, "refused": 0}),
        ("liar,robots=2", 60, {"delivered": 60 * PATHS, "refused": 0}),
        ("liar,robots=1,from=10,to=20,alpha=1e-9", 10, {"refused": 0}),
        ("collide,robots=3,id=3", FRAMES_OF_ROBOT, {"delivered": 60 * PATHS, **NOTHING_WRONG}),
        # Robot 2 refuses its own id; the other three receive from 2 twice, robot 3 once.
        ("collide,robots=3,id=2", FRAMES_OF_ROBOT, {"id_conflicts": {"2": 60}, "refused": 60 * (1 + 3)}),
    ],
)
def test_a_fault_hits_as_many_frames_as_its_options_say_with_its_effect(
    fault: str, expected_hits: int, expected_counts: dict[str, Any]
) -> None:
    """The results count the hits of the fault, what the robots have received, and all frames on the bus.

    Five robots run for 60 ticks. Each frame has four receivers, so there are 20 paths.
    """
    run, frames = run_and_record(small_swarm(fault, robots=5, steps=60))
    assert hit_counts(run) == [expected_hits]
    for name, expected_count in expected_counts.items():
        assert frame_counts(run)[name] == expected_count, name
    assert frame_counts(run)["on_the_bus"] == len(frames)


class Broadcasts(NamedTuple):
    """Numbers of broadcasts that a replay counts; a run without faults has 5 robots * 60 ticks = 300.

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
    ("fault", "expected_broadcasts"),
    [
        # Nothing that happens to frames on their way changes what is broadcast.
        ("loss", Broadcasts(300)),
        ("corrupt,bits=64", Broadcasts(300)),
        ("babble,frames=4,robots=3,from=10,to=20", Broadcasts(300, injected=4 * 10)),
        ("crash,robots=1,from=20,to=35", Broadcasts(300 - 15)),
        ("busoff,robots=1,from=20,to=35", Broadcasts(300 - 15)),
        ("freeze,robots=1,from=30", Broadcasts(300 - 30, falsified=30)),
        ("liar,robots=1,from=10,to=20,alpha=1e-9", Broadcasts(300 - 10, falsified=10)),
        ("collide,robots=3,id=3", Broadcasts(300)),
        ("collide,robots=3,id=2", Broadcasts(300 - 60, foreign=60, injected=FRAMES_OF_ROBOT)),
    ],
)
def test_replay_counts_the_broadcasts_that_a_fault_has_changed(
    fault: str, expected_broadcasts: Broadcasts, tmp_path: Path
) -> None:
    """Replay computes all broadcasts again from the events of a run.

    It counts frames that a fault has falsified, or sent under another robot's id (foreign), and reproduces
    the others, of 300 in five robots' 60 ticks. The frames that a fault has injected are in the events.
    """
    lines_of_events: list[str] = []  # filled by the run
    settings = small_swarm(fault, robots=5, steps=60)
    _run, frames = run_and_record(settings, events=lines_of_events)
    file_of_events = tmp_path / "run.events"
    file_of_events.write_text("".join(lines_of_events))
    with EventsReader(file_of_events) as reader:
        verdict = verify(frames, reader)

    assert verdict.difference is None
    assert verdict.not_logged == 0
    assert verdict.reproduced == expected_broadcasts.reproduced
    assert verdict.falsified == expected_broadcasts.falsified
    assert verdict.foreign == expected_broadcasts.foreign
    assert number_of_injected_frames(file_of_events) == expected_broadcasts.injected


def number_of_injected_frames(path: Path) -> int:
    """Return how many frames a file of events has that faults have injected."""
    with EventsReader(path) as reader:
        return sum(isinstance(entry, InjectedFrame) for entry in reader.entries())


@on_wirings("no bus", "a bus for each")
def test_estimates_under_ids_that_are_not_allowed_are_counted_as_unknown_and_change_nothing(
    wiring: Wiring,
) -> None:
    """In each of 60 ticks robot 1 of five sends under six such ids, too (a Sybil attack).

    The four others count these estimates. All robots end as in a run without the attack.
    """
    undisturbed_run, _frames = run_and_record(small_swarm())
    attack = "sybil,robots=1,ids=5-9+127"
    run, _frames = run_and_record(small_swarm(attack, allow="0-4"), wiring)

    ticks, made_up_ids, receivers = 60, 6, 4
    assert frame_counts(run)["unknown"] == ticks * made_up_ids * receivers
    assert frame_counts(run)["delivered"] == frame_counts(undisturbed_run)["delivered"]
    assert saved_robots(run.nodes) == saved_robots(undisturbed_run.nodes)


@on_wirings("no bus", "a bus for each")
def test_estimates_under_the_id_of_a_robot_that_is_allowed_are_counted_as_conflicts(wiring: Wiring) -> None:
    """In each of 60 ticks robot 1 sends an estimate as robot 0, too. The results count them under id 0."""
    attack = "sybil,robots=1,ids=0"
    run, _frames = run_and_record(small_swarm(attack, steps=60, allow="0-4"), wiring)
    assert frame_counts(run)["unknown"] == 0
    assert frame_counts(run)["id_conflicts"] == {"0": 60}


@on_wirings("no bus", "a bus for each")
def test_robots_that_allow_no_id_of_the_swarm_know_their_own_estimates_alone(wiring: Wiring) -> None:
    """Robots 0 to 4 allow only the id 127, and so refuse all estimates of the others.

    Their estimate x stays equal to x_hat, the one from their own observations.
    """
    run, _frames = run_and_record(small_swarm(robots=5, allow="127"), wiring)
    for node in run.nodes:
        assert node.robot.x == node.robot.x_hat


def settings_with_a_crash_in_ticks_45_and_46(rejoin: str) -> SwarmSettings:
    """Settings of a run of 60 ticks in which robot 0, with a b_hat of 0.55, is dead in two ticks.

    Afterwards it is ``new``, or ``restored`` to its state before the crash.
    """
    return small_swarm(f"crash,robots=0,from=45,to=47,rejoin={rejoin}", seed=3, fill_ratio=0.95)


@pytest.mark.parametrize("rejoin", ["new", "restored"])
def test_a_robot_that_rejoins_assumes_the_accuracy_of_its_start_unless_it_is_restored(rejoin: str) -> None:
    """Robot 0 started with 0.55, and had learnt until its crash in tick 45 that its sensor is better.

    It is dead in the ticks 45 and 46.
    """
    b_hat_by_tick: list[float] = []

    def record_b_hat_of_robot_0(swarm: Swarm) -> None:
        b_hat_by_tick.append(swarm.nodes[0].robot.b_hat)

    run_and_record(settings_with_a_crash_in_ticks_45_and_46(rejoin), hooks=[record_b_hat_of_robot_0])

    before_crash = b_hat_by_tick[44]
    after_return = b_hat_by_tick[47]
    expected_after_return = before_crash if rejoin == "restored" else 0.55
    assert before_crash > 0.9
    assert after_return == pytest.approx(expected_after_return, abs=1e-6)


@pytest.mark.parametrize(
    ("rejoin", "expected_numbers"), [("new", [*range(45), *range(60 - 47)]), ("restored", [*range(60 - 2)])]
)
def test_a_robot_that_rejoins_numbers_its_estimates_anew_unless_it_is_restored(
    rejoin: str, expected_numbers: list[int]
) -> None:
    """It is dead in ticks 45 and 46 of 60, and sends an estimate, numbered modulo 32, in the others."""
    _run, frames = run_and_record(settings_with_a_crash_in_ticks_45_and_46(rejoin))
    numbers = [estimate.transfer_id for estimate in estimates_among(frames) if estimate.sender == 0]
    assert numbers == [number % 32 for number in expected_numbers]


@pytest.mark.parametrize(
    ("rejoin", "expected_ticks_and_uptimes"),
    [
        ("new", [(0, 0), (10, 1), (20, 2), (30, 3), (40, 4), (47, 0), (57, 1)]),
        ("restored", [(0, 0), (10, 1), (20, 2), (30, 3), (40, 4), (52, 5)]),
    ],
)
def test_a_robot_that_rejoins_sends_heartbeats_in_its_own_seconds(
    rejoin: str, expected_ticks_and_uptimes: list[tuple[int, int]]
) -> None:
    """It is dead in ticks 45 and 46. A heartbeat has its uptime in seconds, of 10 ticks each.

    A new robot counts its uptime from tick 47 on. A restored robot's uptime has stood still for two ticks.
    """
    _run, frames = run_and_record(settings_with_a_crash_in_ticks_45_and_46(rejoin))
    ticks_and_uptimes = []
    for frame in frames:
        heartbeat = decode_heartbeat(frame)
        if isinstance(heartbeat, Heartbeat) and heartbeat.sender == 0:
            tick = round(10 * frame.timestamp)
            ticks_and_uptimes.append((tick, heartbeat.uptime))

    assert ticks_and_uptimes == expected_ticks_and_uptimes


@pytest.fixture
def run_with_a_late_tick(monkeypatch: pytest.MonkeyPatch) -> SwarmRun:
    """A run of 3 robots in real time in which the frames of tick 5 arrive in tick 6."""
    settings = small_swarm(robots=3, clock="real-time", steps_per_second=1000)
    receive = virtual.VirtualBus.recv
    with Swarm(settings, ON_ONE_BUS) as swarm:

        def receive_except_in_tick_5(bus: virtual.VirtualBus, timeout: float | None) -> can.Message | None:
            return receive(bus, timeout) if swarm.ticks != 5 else None

        monkeypatch.setattr(virtual.VirtualBus, "recv", receive_except_in_tick_5)
        return run_swarm(swarm)


def test_frames_that_come_too_late_in_real_time_are_counted_and_received_in_the_next_tick(
    run_with_a_late_tick: SwarmRun,
) -> None:
    """Three robots run for 60 ticks. The three estimates of one tick are missed. The run goes on to its end.

    In the next tick a robot receives two estimates of each neighbour, and refuses the second one.
    """
    ticks, robots, receivers = 60, 3, 2
    counts = frame_counts(run_with_a_late_tick)
    assert run_with_a_late_tick.results["steps"] == ticks
    assert counts["missed"] == robots
    assert counts["delivered"] == ticks * robots * receivers
    assert counts["refused"] == robots * receivers  # in one tick


def test_a_run_in_real_time_reports_how_late_ticks_have_begun(run_with_a_late_tick: SwarmRun) -> None:
    """The results have the mean over all ticks and the largest, in seconds. Real times vary."""
    clock = run_with_a_late_tick.results["clock"]
    assert 0 <= clock["mean_lateness"] <= clock["max_lateness"]


def test_a_robot_that_has_heard_nobody_for_long_receives_the_next_frame(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Robot 0 sends 103 frames in its multicast group before the first frame reaches it.

    The group returns them to its socket, which has room for some 20 frames in this test.
    """
    monkeypatch.setattr("mcp_asdf_tools.bus.interfaces._RECEIVE_BUFFER_BYTES", 8192)
    settings = small_swarm("loss,receivers=0,to=93", robots=2, flawed=0, steps=95)
    run, _frames = run_and_record(settings, WIRINGS["a group for each"])
    assert run.nodes[0].reception.delivered == 2


@pytest.mark.parametrize(
    "wiring",
    [WIRINGS["one bus"], WIRINGS["a group for each"], *slow([WIRINGS["one group"]])],
    ids=["one bus", "a group for each", "one group"],
)
def test_no_frame_is_lost_when_a_robot_floods_the_bus(wiring: Wiring) -> None:
    """Its 900 frames are more than a socket holds, and yet the four other robots receive each of them.

    Besides, each of five robots sends an estimate in each of three ticks, and a heartbeat.
    """
    settings = small_swarm("babble,frames=900,robots=0,from=1,to=2", robots=5, steps=3)
    run, frames = run_and_record(settings, wiring)

    robots, estimates, heartbeats, receivers = 5, 3, 1, 4
    assert len(frames) == robots * (estimates + heartbeats) + 900
    assert frame_counts(run)["arrived"] == receivers * len(frames)


# The figures of docs/internals/threats.csv, and the table of docs/threats.md

SETTINGS_BY_COLUMN: dict[str, dict[str, Any]] = {
    "asdf_plus": {"filter": "asdf-plus"},
    "robust": {"filter": "robust"},
    "asdf_plus_allow_0_19": {"filter": "asdf-plus", "allow": "0-19"},
}
"""Settings with which an attack is run, by how their columns begin. The last are for made-up ids only."""

FIGURES = ("error", "flawed_b_hat", "healthy_b_hat")
"""How the columns of a run end: what `figures_of_run` returns."""

ATTACKS = list(csv.DictReader((ROOT / "docs/internals/threats.csv").read_text(encoding="utf-8").splitlines()))
RUNNABLE_ATTACKS = [attack for attack in ATTACKS if attack["robust_error"]]
"""The attacks and faults that can be run; the others are only described. First comes a run without faults."""


def figures_of_run(faults: list[str], settings: dict[str, Any]) -> list[str]:
    """Return the mean error of robots without a fault, and the mean b_hat of flawed and of other ones.

    Robots from 6 on have the faults, and the first six are flawed.
    """
    swarm_settings = SwarmSettings(steps=500, filter_period=100, faults=tuple(faults), **settings)
    last_with_fault = last_robot_with_a_fault(swarm_settings)
    with Swarm(swarm_settings, Wiring()) as swarm:
        robots = [node.robot for node in run_swarm(swarm).nodes]
    flawed_robots, other_robots = robots[:6], robots[last_with_fault + 1 :]
    mean_error = fmean(abs(robot.x - 0.55) for robot in flawed_robots + other_robots)
    b_hat = [fmean(robot.b_hat for robot in group) for group in (flawed_robots, other_robots)]
    return [f"{figure:.3f}" for figure in (mean_error, *b_hat)]


def last_robot_with_a_fault(settings: SwarmSettings) -> int:
    """Return the largest id of a robot that a fault names, or 6 if no fault names a larger one.

    The robot 6 is the first robot with a fault in other runs.
    """
    robots_with_faults = {6}
    for fault in settings.faults:
        robots_with_faults |= fault.robots or set()
    return max(robots_with_faults)


def test_the_table_of_threats_has_figures_of_20_attacks_and_begins_with_a_swarm_without_faults() -> None:
    """docs/internals/threats.csv has 27 attacks. Seven of them are only described, and cannot be run.

    The others have figures with ASDF+ and with the robust filter.
    """
    first_attack, *_further_attacks = ATTACKS
    assert len(ATTACKS) == 27
    assert len(RUNNABLE_ATTACKS) == 20
    assert first_attack["faults"] == ""
    for attack in (first_attack, *RUNNABLE_ATTACKS):
        assert attack["asdf_plus_error"] != ""
        assert attack["robust_error"] != ""


def figures_in_table(attack: dict[str, str], column: str) -> list[str]:
    """Return the figures that the table has of an attack, in the columns that begin with this text."""
    return [attack[f"{column}_{figure}"] for figure in FIGURES]


def attacks_and_columns(attacks: list[dict[str, str]]) -> list[tuple[dict[str, str], str]]:
    """Return each attack with the beginning of the columns, of SETTINGS_BY_COLUMN, that have its figures."""
    return [
        (attack, column) for attack in attacks for column in SETTINGS_BY_COLUMN if attack[f"{column}_error"]
    ]


@pytest.mark.parametrize(
    ("attack", "column"),
    [
        *attacks_and_columns([RUNNABLE_ATTACKS[1]]),
        *slow(attacks_and_columns([RUNNABLE_ATTACKS[0], *RUNNABLE_ATTACKS[2:]])),
    ],
)
def test_the_table_of_threats_has_the_figures_of_these_runs(attack: dict[str, str], column: str) -> None:
    """docs/internals/threats.csv has the faults of each attack, and the figures with which a swarm ends.

    The name of a column says with which filter and which allowed ids.
    """
    faults = attack["faults"].split()
    expected_figures = figures_of_run(faults, SETTINGS_BY_COLUMN[column])
    assert figures_in_table(attack, column) == expected_figures


def test_the_table_of_threats_has_figures_with_allowed_ids_only_for_made_up_ids() -> None:
    """Attacks with the fault sybil make up ids. For figures with allowed ids, robots allow only 0 to 19."""
    for attack in RUNNABLE_ATTACKS:
        has_figures_with_allowed_ids = attack["asdf_plus_allow_0_19_error"] != ""
        assert has_figures_with_allowed_ids == ("sybil" in attack["faults"]), attack["attack"]


THREATS_PAGE = ROOT / "docs/threats.md"


def error_in_a_word(error: str) -> str:
    """Return how the page of threats calls a mean error."""
    if float(error) < 0.05:
        return "safe"
    return "wrong" if float(error) < 0.2 else "lost"


def rows_of_threats_page() -> list[list[str]]:
    """Return the cells of each row of the table in the page, without the last column, which is text."""
    page = THREATS_PAGE.read_text(encoding="utf-8")
    _, _, after_heading = page.partition("|---|---|---|---|---|\n")
    table, _, _ = after_heading.partition("\n\n")
    return [cells_of_line(line)[:-1] for line in table.splitlines()]


def test_the_page_of_threats_puts_the_errors_of_six_attacks_in_words() -> None:
    """An attack has a word for ASDF, a word for the robust filter, and the robust filter's error.

    The errors are those of docs/internals/threats.csv.
    """
    attacks_by_name = {attack["attack"]: attack for attack in RUNNABLE_ATTACKS}
    rows = rows_of_threats_page()
    assert len(rows) == 6
    for name, word_for_asdf, word_for_robust, error in rows:
        attack = attacks_by_name[name]
        assert word_for_asdf == error_in_a_word(attack["asdf_plus_error"])
        assert word_for_robust == error_in_a_word(attack["robust_error"])
        assert error == attack["robust_error"]


def test_the_page_of_threats_says_which_errors_its_words_stand_for() -> None:
    """The page has the limits of the words "safe" and "wrong", and the error of a swarm without faults."""
    page = THREATS_PAGE.read_text(encoding="utf-8")
    run_without_faults, *_attacks = RUNNABLE_ATTACKS
    assert "ends below 0.05, *wrong* if below 0.2" in page
    assert f"the robust filter ends at {run_without_faults['robust_error']}." in page


def test_the_page_of_threats_shows_what_its_commands_print(capsys: pytest.CaptureFixture[str]) -> None:
    """One block of the page has the commands, and another the output that all of them print together.

    A block is found by a text that no other block in its language contains.
    """
    commands = block_with(THREATS_PAGE, "--filter robust", "sh").splitlines()
    output = block_with(THREATS_PAGE, "seed 1", "text")

    for command in commands:
        _mcp_asdf, *arguments = command.split()
        assert main(arguments) == 0
    assert capsys.readouterr().out == output
