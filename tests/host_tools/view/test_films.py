"""Films show what was: the states of a swarm, of its log and of its trial are one and the same."""

from __future__ import annotations

import base64
import html
import json
import re
import time
import zlib
from dataclasses import replace
from itertools import product
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import can
import numpy as np
import pytest
from numpy.typing import NDArray

from mcp_asdf_tools.bus.frames import (
    Estimate,
    FrameFormat,
    Telemetry,
    encode_estimate,
    encode_telemetry,
    format_frame,
)
from mcp_asdf_tools.cli.main import main
from mcp_asdf_tools.common.errors import UsageError
from mcp_asdf_tools.experiments.experiment import Experiment
from mcp_asdf_tools.experiments.result_tables import experiments_in, trials_to_table
from mcp_asdf_tools.experiments.results import Trials
from mcp_asdf_tools.experiments.trials import run_trials
from mcp_asdf_tools.library import simulate
from mcp_asdf_tools.swarm.carrier import Wiring
from mcp_asdf_tools.swarm.run import run_swarm
from mcp_asdf_tools.swarm.settings import SwarmSettings
from mcp_asdf_tools.swarm.swarm import Swarm
from mcp_asdf_tools.view import film as history_module
from mcp_asdf_tools.view.film import History, RunDescription, State
from mcp_asdf_tools.view.films import (
    BusRecorder,
    SwarmRecorder,
    recompute_swarm_history,
    recompute_trial_history,
    steps_between_states,
)
from mcp_asdf_tools.view.frame_film import read_frame_history
from mcp_asdf_tools.view.inline import show
from mcp_asdf_tools.view.page import encode_description, page
from mcp_asdf_tools.world.arena import Arena

PARAMETERS: dict[str, Any] = {
    **{"robots": 7, "flawed": "50%", "steps": 250, "filter": "asdf-minus", "filter_period": 50, "seed": 3}
}
WORLDS: list[dict[str, Any]] = [
    {"topology": "dynamic", "drift": "linear", "drift_rate": -1e-3},
    {"topology": "graph", "graph": "0 1; 1 > 2; 3 6"},
    {},
    {"filter": "robust", "topology": "dynamic", "density": 8, "fill_ratio": 0.95, "flawed": 2},
]


def filmed(**more: Any) -> History:
    settings = SwarmSettings(**PARAMETERS | more)
    camera = SwarmRecorder(settings)
    with Swarm(settings, Wiring()) as swarm:
        run_swarm(swarm, [camera])
    return camera.history


def logged(log: Path, **more: Any) -> History:
    """The history of the log of the same swarm."""
    options = [f"--{name.replace('_', '-')}={value}" for name, value in (PARAMETERS | more).items()]
    assert main(["swarm", *options, "--log", str(log), "--quiet"]) == 0
    return recompute_swarm_history(log)


def states(history: History) -> dict[int, list[Any]]:
    """All but the tick of each state, by the tick."""
    return {each.tick: [*each[1:]] for each in history.states_since().states}


def trials_of(**more: Any) -> Trials:
    experiment = Experiment(**PARAMETERS | more, trials=2)
    return experiments_in(trials_to_table(run_trials(experiment, 0, 2)))[0]


def plain(stage: RunDescription) -> dict[str, Any]:
    return encode_description(stage) | {"title": stage.title.partition(", trial")[0]}


@pytest.mark.parametrize("world", WORLDS, ids=["dynamic", "graph", "fully-connected", "robust"])
def test_a_swarm_its_log_and_its_trial_make_one_film(
    world: dict[str, Any], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    log = tmp_path / "run.log"
    live, past, trial = filmed(**world), logged(log, **world), recompute_trial_history(trials_of(**world), 0)
    assert plain(live.description) == plain(past.description) == plain(trial.description)
    assert live.description.title.endswith(", seed 3")
    assert ("flawed, robust, " in live.description.title) == (world.get("filter") == "robust")
    x, _, b_hat, _ = np.stack([state[0] for state in states(live).values()], axis=1)
    assert "graph" in world or min(np.ptp(each, axis=0).max() for each in (x, b_hat)) > 0.1
    assert past.has_ended and trial.has_ended and not live.has_ended
    assert list(states(past)) == list(states(trial)) == [*range(251)]
    assert set(states(live)) <= set(states(trial)) and len(states(live)) >= 250
    monkeypatch.setattr("mcp_asdf_tools.view.films.MAX_STATES", 63)
    sparse = [recompute_swarm_history(log), recompute_trial_history(trials_of(**world), 0)]
    assert [list(states(each)) for each in sparse] == [[*range(0, 251, 4)]] * 2
    for some, whole in ((live, past), (live, trial), *product(sparse, [past])):
        for tick, state in states(some).items():
            assert all(map(np.array_equal, state, states(whole)[tick])), tick


def test_the_twin_is_the_same_run_without_a_filter(monkeypatch: pytest.MonkeyPatch) -> None:
    world = {"topology": "dynamic", "steps": 60}
    history, plain_run = filmed(**world), filmed(**world, filter="none")
    x = np.stack([state[0][0] for state in states(plain_run).values()])
    assert history.description.unfiltered_errors[1:] == np.round(abs(x - 0.55).mean(axis=1), 5).tolist()
    assert (history.description.filter, plain_run.description.filter) == ("asdf-minus", "none")
    assert plain_run.description.title == "7 robots, 4 flawed, no filter, dynamic, seed 3"
    for more in ({"filter": "none"}, {"faults": ("loss=0.1",)}, {"allow": "0-6"}, {"latency": 1}):
        assert (
            len(SwarmRecorder(SwarmSettings(**PARAMETERS | more)).history.description.unfiltered_errors) == 0
        ), more
    monkeypatch.setattr("mcp_asdf_tools.view.films._MAX_ERROR_POINTS", 4)
    assert len(filmed(**world).description.unfiltered_errors) == 4


def test_a_run_that_is_watched_is_paced(monkeypatch: pytest.MonkeyPatch) -> None:
    """A slow step is not made up for."""
    worked, slept = [50.0], list[float]()
    camera: Any = SwarmRecorder(SwarmSettings(**PARAMETERS | {"steps": 20_000}), 100)
    monkeypatch.setattr(time, "monotonic", lambda: sum(worked + slept))
    monkeypatch.setattr(time, "sleep", slept.append)
    for work in (0.002, 0.0, 0.05, 0.0):
        camera(SimpleNamespace(ticks=1))
        worked.append(work)
    assert slept == pytest.approx([0.0, 0.008, 0.01, 0.0])
    with pytest.raises(UsageError, match="--pace is -1; give steps a second"):
        SwarmRecorder(SwarmSettings(**PARAMETERS), -1)


def test_nothing_is_known_of_dead_robots_and_faults_are_named(tmp_path: Path) -> None:
    fault = "crash=1.0,from=20,to=21,robots=2,ticks=15"
    live, past = filmed(faults=(fault,)), logged(tmp_path / "run.log", fault=fault)
    assert plain(past.description) == plain(live.description)
    assert [*past.description.faults] == [(fault, 20, 21)] and not past.description.unfiltered_errors
    for tick, (values, *_) in states(past).items():
        assert np.isnan(values[:3, 2]).all() == np.isnan(values).any() == (20 < tick <= 35), tick
        assert tick == 0 or np.array_equal(values, states(live)[tick][0], equal_nan=True)


def test_results_that_do_not_come_out_again_are_refused() -> None:
    trials = trials_of()
    with pytest.raises(UsageError, match="trial 1 does not come out again"):
        recompute_trial_history(replace(trials, errors=trials.errors + 1e-9), 1)
    assert ", trial 1" in recompute_trial_history(trials, 1).description.title


@pytest.mark.parametrize("floor", ["tiles", "code"])
def test_the_floor_is_the_one_that_the_robots_see(floor: str) -> None:
    """Of each pixel the middle, and of more tiles than a page shows only as many pixels."""
    size = {"width": 1.0, "height": 0.5} if floor == "tiles" else {}
    settings = SwarmSettings(robots=3, topology="dynamic", floor=floor, **size)  # type: ignore[arg-type]
    arena, pixels = Arena(settings, 0), SwarmRecorder(settings).history.description.floor
    assert pixels is not None
    rows, columns = pixels.shape
    width, height = settings.sides
    for row, column in ((0, 0), (0, columns - 1), (rows - 1, 0), (17, 31)):
        x, y = ((column + 0.5) / columns - 0.5) * width, (0.5 - (row + 0.5) / rows) * height
        assert arena.is_black(x, y) == pixels[row, column]
    if floor == "tiles":
        assert (rows, columns) == (50, 100) and 0.5 < pixels.mean() < 0.6
        small = SwarmRecorder(replace(settings, tile=0.0005)).history.description.floor
        assert small is not None and small.shape == (800, 800)


def test_a_long_film_of_many_robots_stays_small() -> None:
    assert (steps_between_states(10_000, 20), steps_between_states(40_000, 20)) == (1, 4)
    for steps, robots in ((10**9, 1), (10**6, 128), (1, 128), (20_000, 60)):
        count = steps / steps_between_states(steps, robots)
        assert count * robots**2 <= 4_000_000 and count <= 10_000


def inflated(text: str, kind: str) -> NDArray[Any]:
    return np.frombuffer(zlib.decompress(base64.b64decode(text)), kind)


@pytest.mark.parametrize(("robots", "moves"), [(3, 0), (11, 1), (128, 0), (129, 1)])
def test_a_page_has_all_of_a_film(robots: int, moves: int) -> None:
    """In the layout that its script reads: with places and without, who hears whom as bits or as pairs.

    No text in it ends the script."""
    draw, sides, floor = np.random.default_rng(robots), (3.0, 2.0), np.arange(33).reshape(3, 11) % 5 < 2
    values, places = draw.uniform(-0.1, 1.1, (5, 4, robots)), draw.uniform(-1, 1, (5, robots, 2))
    values[values > 1.05] = np.nan
    hears = draw.random((5, robots, robots)) < 0.3
    links = [np.argwhere(each) if robots > 128 else each for each in hears]
    stage = RunDescription(
        "any </script>", [*range(robots)], range(1), sides=sides if moves else None, floor=floor
    )
    history = [State(7 * i, values[i], links[i], places[i] if moves else None) for i in range(5)]
    whole = page(History(stage, history))
    assert not re.findall("__[A-Z_]+__", whole) and "Permission is hereby granted" in whole
    (text,) = re.findall('<script id="history"[^>]*>(.*?)</script>', whole)
    told, block = (json.loads(text)[name] for name in ("description", "block"))
    bits = np.unpackbits(inflated(told["floor"].pop("bits"), "u1").reshape(3, 2), axis=1)
    assert np.array_equal(bits[:, :11], floor) and told["floor"] == {"rows": 3, "columns": 11}
    assert [told[name] for name in ("quantities", "flawed", "unfiltered_errors")] == [
        ["x", "x_hat", "b_hat", "b"],
        [0],
        [],
    ]
    parts = inflated(block["data"], "u1")
    ticks, series, rest = np.split(parts, [20, 20 + 2 * 5 * robots * (4 + 2 * moves)])
    assert block["count"] == 5 and [*ticks.view("<u4")] == [0, 7, 14, 21, 28]
    found = series.view("<u2").reshape(-1, robots, 5).cumsum(axis=2, dtype=np.uint16).transpose(2, 0, 1)
    all_values = np.concatenate([values, *[(places / sides + 0.5).transpose(0, 2, 1)] * moves], axis=1)
    assert np.array_equal(found == 65535, np.isnan(all_values))
    assert np.nanmax(abs(found - 65534 * all_values.clip(0, 1))) < 0.501
    if robots > 128:
        rest, pairs = np.split(rest, [20])
        assert [*rest.view("<u4")] == [*map(len, links)]
        assert np.array_equal(pairs.view("<u2").reshape(-1, 2), np.concatenate(links))
    else:
        heard = np.unpackbits(rest.reshape(5, -1), axis=1, count=robots**2, bitorder="little")
        assert np.array_equal(heard.reshape(hears.shape), hears)


def test_a_film_without_an_end_is_thinned_out(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(history_module, "MAX_STATES", 100)
    live, most = History(RunDescription("endless", [0, 1])), 0
    for tick in range(1000):
        live.add(State(tick, np.full((4, 2), tick / 1e5), np.ones((2, 2), np.bool_), None))
        update = live.states_since()
        generation, taken = update.generation, update.states
        most = max(most, len(taken))
    assert (generation, most) == (4, 100)
    assert [each.tick for each in taken] == list(range(0, 1000, 16))
    assert live.states_since(generation, len(taken)).states == []
    live.add_robot(7)
    assert live.states_since().states[-1].neighbours.tolist() == [[True, True, False]] * 2 + [[False] * 3]


def test_a_bus_is_filmed_as_robots_join(monkeypatch: pytest.MonkeyPatch) -> None:
    """The history takes a state every 1/8 s; frames come between."""
    frames = {
        0.0: encode_telemetry(Telemetry(7, 1 << 22, 1 << 23, 0, 0)),
        0.1875: encode_estimate(Estimate(7, 1 << 21, 1, 0), FrameFormat()),
        0.3125: encode_telemetry(Telemetry(3, 1 << 21, 1 << 22, 0, 0)),
    }
    now = [0.0]

    def recv(timeout: float) -> can.Message | None:
        due = next((at for at in frames if at <= now[0] + timeout), None)
        now[0] = round(now[0] + timeout, 9) if due is None else due
        return None if due is None else frames.pop(due)

    bus: Any = SimpleNamespace(recv=recv)
    monkeypatch.setattr(time, "monotonic", lambda: 1000 + now[0])
    monkeypatch.setattr("mcp_asdf_tools.view.films.STATES_PER_SECOND", 8)
    watch = BusRecorder(bus, FrameFormat(), "a bus", true_accuracy=0.9)
    watch.record(lambda: now[0] >= 0.5)
    report = watch.history.report
    assert report is not None and [(each["robot"], each["seen"]) for each in report["robots"]] == [(7, 0.0)]
    update = watch.history.states_since()
    taken = update.states
    assert update.generation == 2 and update.description.robots == [7, 3] and watch.has_telemetry
    nan = np.nan
    # x_hat of robot 7, x and b of robot 3, which comes last
    heard = ((nan, nan, nan), (nan, nan, nan), (0.25, nan, nan), (0.25, 0.25, 0.9))
    expected = [[[0.5, x], [x_hat, nan], [0.5, x], [0.9, b]] for x_hat, x, b in heard]
    assert [each.tick for each in taken] == [0, 1, 2, 3]
    assert np.array_equal([each.values for each in taken], expected, equal_nan=True)
    watch.record(lambda: now[0] >= 4.5)
    silent = watch.history.states_since().states[-1].values
    assert np.isnan(silent[:3]).all() and (silent[3] == 0.9).all()
    assert watch.history.report is not None and all(each["silent"] for each in watch.history.report["robots"])


def log_of(path: Path, frames: dict[float, can.Message], head: str = "") -> Path:
    """Write a log as candump does, with the frames by their times."""
    lines = [f"({seconds:.6f}) can0 {format_frame(frame)}\n" for seconds, frame in frames.items()]
    path.write_text(head + "".join(lines))
    return path


def test_a_log_is_filmed_by_its_frames(tmp_path: Path) -> None:
    """Robot 7 comes first and falls silent after 3 s; robot 3 sends telemetry."""
    frames = {
        1000.0: encode_estimate(Estimate(7, 1 << 21, 1, 0), FrameFormat()),
        1000.25: encode_telemetry(Telemetry(3, 1 << 21, 1 << 22, 0, 0)),
        1003.5: encode_telemetry(Telemetry(3, 1 << 22, 1 << 23, 0, 1)),
    }
    log = log_of(tmp_path / "real.log", frames, "# of Tuesday\n")
    shown = read_frame_history(log, FrameFormat(), fill_ratio=0.4, true_accuracy=0.9)
    assert shown.has_telemetry and shown.summary.skipped_lines == 1
    update = shown.history.states_since()
    stage, taken = update.description, update.states
    assert (stage.title, stage.robots, stage.fill_ratio) == ("real.log", [7, 3], 0.4)
    assert [state.tick for state in taken] == [*range(37)]
    nan = np.nan
    assert np.array_equal(taken[1].values, [[nan, nan], [0.25, nan], [nan, nan], [0.9, 0.9]], equal_nan=True)
    assert np.array_equal(taken[4].values[:, 1], [0.25, nan, 0.25, 0.9], equal_nan=True)
    assert np.array_equal(taken[36].values[:, 0], [nan, nan, nan, 0.9], equal_nan=True)
    assert shown.history.has_ended and shown.history.report is not None


def test_frames_of_a_long_log_make_a_film_of_bounded_length(tmp_path: Path) -> None:
    frame = encode_estimate(Estimate(7, 1 << 21, 1, 0), FrameFormat())
    log = log_of(tmp_path / "real.log", {0.0: frame, 2e7: frame})
    assert (
        len(read_frame_history(log, FrameFormat()).history.states_since().states)
        <= history_module.MAX_STATES + 1
    )


@pytest.mark.parametrize(
    ("text", "reason"),
    [
        ("(1.0) can0 123#00\n(2.0) can0 123#00\n", "has no estimate and no telemetry of a robot"),
        (" can0  106BB807   [8]  00 00 40 00 00 80 3F E0\n" * 2, "span 0 s, so they cannot be shown"),
        ("(0) can0 106BB807#000040000080 3FE0\n", "holds no frame"),
    ],
)
def test_frames_that_cannot_be_shown_are_refused(text: str, reason: str, tmp_path: Path) -> None:
    log = tmp_path / "real.log"
    log.write_text(text)
    with pytest.raises(UsageError, match=reason):
        read_frame_history(log, FrameFormat())


def test_a_run_is_shown_in_a_notebook_as_its_page(tmp_path: Path) -> None:
    moving = Experiment(topology="dynamic", robots=4, steps=50, filter_period=20, trials=2, density=0.5)
    shown = show(moving, trial=1)
    shown.save(str(tmp_path / "run.html"))
    page = (tmp_path / "run.html").read_text(encoding="utf-8")
    assert shown._repr_html_().startswith("<iframe srcdoc=") and html.escape(page) in shown._repr_html_()
    assert show(simulate(moving), trial=1, where={"robots": "4"}).page == page != show(moving).page
    with pytest.raises(UsageError, match="trial is -1; give 0 or more"):
        show(moving, trial=-1)
