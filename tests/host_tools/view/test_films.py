"""Films show what was: the states of a swarm, of its log and of its trial are one and the same."""

from __future__ import annotations

import base64
import threading
import zlib
from dataclasses import replace
from pathlib import Path
from typing import Any

import can
import numpy as np
import pytest
from numpy.typing import NDArray

from browser import developed
from mcp_asdf.robot import Observation
from mcp_asdf_tools.bus.frames import FrameFormat, Telemetry, encode_telemetry
from mcp_asdf_tools.cli.main import main
from mcp_asdf_tools.common.errors import UsageError
from mcp_asdf_tools.experiments.experiment import Experiment
from mcp_asdf_tools.experiments.results import Trials, experiments_in, table_of
from mcp_asdf_tools.experiments.trials import run_trials
from mcp_asdf_tools.robots.lockstep import Lockstep
from mcp_asdf_tools.swarm.carrier import Wiring
from mcp_asdf_tools.swarm.settings import SwarmSettings
from mcp_asdf_tools.swarm.swarm import Swarm, run_swarm
from mcp_asdf_tools.view import film as films
from mcp_asdf_tools.view.film import Film, LiveFilm, Sample, Stage, rows_of
from mcp_asdf_tools.view.films import BusFilm, SwarmCamera, film_of_log, film_of_trial, spacing_of
from mcp_asdf_tools.view.page import samples_as_plain, stage_as_plain
from mcp_asdf_tools.world.arena import Arena
from node_thread import node_in_a_thread
from support import PATIENCE

PARAMETERS: dict[str, Any] = {
    "robots": 7,
    "steps": 250,
    "filter_period": 50,
    "flawed": "50%",
    "filter": "asdf-minus",
    "seed": 3,
}
WORLDS: list[dict[str, Any]] = [
    {"topology": "dynamic", "drift": "wiener", "drift_diffusion": 1e-3},
    {"topology": "graph", "graph": "0 1; 1 > 2; 3 6"},
    {},
]


def filmed(**more: Any) -> Film:
    settings = SwarmSettings(**PARAMETERS | more)
    camera = SwarmCamera(settings)
    with Swarm(settings, Wiring()) as swarm:
        run_swarm(swarm, [camera])
    return developed(camera.film)


def trials_of(**more: Any) -> Trials:
    experiment = Experiment(**PARAMETERS | more, trials=2)
    return experiments_in(table_of(run_trials(experiment, 0, 2)))[0]


def equal(left: Film, right: Film) -> bool:
    """True if the films agree in all ticks that both have."""
    both = np.intersect1d(left.samples.ticks, right.samples.ticks)
    assert len(both) > 200
    columns = []
    for film in (left, right):
        rows, samples = np.isin(film.samples.ticks, both), film.samples
        places = np.zeros(0) if samples.positions is None else samples.positions[rows]
        columns.append((samples.values[rows], samples.hears[rows], places))
    return all(np.array_equal(*pair) for pair in zip(*columns, strict=True))


@pytest.mark.parametrize("world", WORLDS, ids=["dynamic", "graph", "fully-connected"])
def test_a_swarm_its_log_and_its_trial_make_one_film(world: dict[str, Any], tmp_path: Path) -> None:
    live, log = filmed(**world), tmp_path / "run.log"
    given = (PARAMETERS | world).items()
    words = [f"--{name.replace('_', '-')}={getattr(value, 'value', value)}" for name, value in given]
    assert main(["swarm", *words, "--log", str(log), "--quiet"]) == 0
    logged, trial = film_of_log(log), film_of_trial(trials_of(**world), 0)
    assert equal(live, logged)
    assert equal(live, trial)
    assert live.stage == logged.stage == trial.stage
    assert len(logged.samples.ticks) == len(trial.samples.ticks) == 251


def test_dead_robots_keep_their_values(tmp_path: Path) -> None:
    log = tmp_path / "run.log"
    words = ["swarm", "--robots", "4", "--steps", "60", "--fault", "crash=1,robots=2,from=20,ticks=40"]
    assert main([*words, "--log", str(log), "--quiet"]) == 0
    values = film_of_log(log).samples.values
    assert len(values) == 61
    assert (values[21:, :3, 2] == values[21, :3, 2]).all()
    assert (values[30, 1, [0, 1, 3]] != values[60, 1, [0, 1, 3]]).all()


def test_a_node_has_a_film_without_a_world(tmp_path: Path) -> None:
    log = tmp_path / "node.log"
    with node_in_a_thread(f"--id 9 --log {log}") as bus:
        lockstep = Lockstep(bus, timeout=PATIENCE)
        for _ in range(30):
            lockstep.observe({9: Observation.BLACK})
            lockstep.settle({9})
    film = film_of_log(log)
    assert list(film.stage.robots) == [9]
    assert film.stage.floor is None and film.stage.sides is None
    assert np.isnan(film.samples.quantity("b")).all()
    assert film.samples.quantity("x_hat")[-1] != 0.5


def test_results_that_do_not_come_out_again_are_refused() -> None:
    trials = trials_of()
    wrong = replace(trials, errors=trials.errors + 1e-9)
    with pytest.raises(UsageError, match="trial 1 does not come out again"):
        film_of_trial(wrong, 1)
    with pytest.raises(UsageError, match="no trial 2; choose one of 0 to 1"):
        film_of_trial(trials, 2)


def test_the_floor_is_the_one_that_the_robots_see() -> None:
    """Of each pixel the middle, and of more tiles than a page shows only as many pixels."""
    settings = SwarmSettings(robots=3, topology="dynamic", width=1.0, height=0.5)
    camera, arena = SwarmCamera(settings), Arena(settings, 0)
    floor = camera.film.stage.floor
    assert floor is not None and floor.shape == (50, 100)
    for row, column in ((0, 0), (0, 99), (49, 0), (17, 31)):
        x, y = (column + 0.5) / 100 - 0.5, 0.25 - (row + 0.5) / 100
        assert arena.is_black(x, y) == floor[row, column]
    assert 0.5 < floor.mean() < 0.6
    small = SwarmCamera(replace(settings, tile=0.0005)).film.stage.floor
    assert small is not None and small.shape == (800, 800)


def test_a_long_film_of_many_robots_stays_small() -> None:
    assert spacing_of(10_000, 20) == 1
    assert spacing_of(40_000, 20) == 4
    for steps, robots in ((10**9, 1), (10**6, 128), (1, 128), (20_000, 60)):
        samples = steps / spacing_of(steps, robots)
        assert samples * robots**2 <= 4_000_000 and samples <= 10_000


def series(content: bytes, count: int, robots: int) -> NDArray[np.float64]:
    raw = np.cumsum(np.frombuffer(content, "<u2").reshape(robots, count), axis=1, dtype=np.uint16).T
    return np.where(raw == 65535, np.nan, raw / 65534)


def test_what_goes_to_a_page_is_the_film() -> None:
    """Decoded by a few lines that follow the description of the format."""
    film = filmed(topology="dynamic")
    count, robots = film.samples.values.shape[::2]
    plain = samples_as_plain(film.samples, film.stage)
    content = zlib.decompress(base64.b64decode(plain["data"]))
    assert plain["count"] == count
    assert np.array_equal(np.frombuffer(content[: 4 * count], "<u4"), film.samples.ticks)
    size, at = 2 * count * robots, 4 * count
    for index in range(4):
        found = series(content[at + index * size : at + (index + 1) * size], count, robots)
        assert np.abs(found - film.samples.values[:, index]).max() <= 0.5 / 65534
    links = np.unpackbits(
        np.frombuffer(content[at + 6 * size :], np.uint8).reshape(count, -1), axis=1, bitorder="little"
    )
    assert np.array_equal(links[:, : robots**2].reshape(count, robots, robots), film.samples.hears)
    assert stage_as_plain(film.stage)["flawed"] == [0, 1, 2, 3]


def sample(tick: int, robots: int = 2) -> Sample:
    return Sample(tick, np.full((4, robots), tick / 1e5), np.zeros((robots, robots), np.bool_), None)


def test_a_film_without_an_end_is_thinned_out(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(films, "MAX_SAMPLES", 100)
    live = LiveFilm(Stage("endless", [0, 1]))
    for tick in range(1000):
        live.add(sample(tick))
        generation, _, samples = live.since(0, 0)
        assert samples is not None and len(samples.ticks) <= 100
    assert generation == 4 and samples is not None
    assert samples.ticks.tolist() == list(range(0, 1000, 16))
    assert live.since(generation, len(samples.ticks))[2] is None


def test_readers_and_the_writer_do_not_disturb_each_other() -> None:
    live, read = LiveFilm(Stage("film", [0, 1])), list[int]()

    def write() -> None:
        for tick in range(3000):
            live.add(sample(tick))

    writer = threading.Thread(target=write)
    writer.start()
    while writer.is_alive() or len(read) < 3000:
        _, _, samples = live.since(0, len(read))
        read += [] if samples is None else samples.ticks.tolist()
    assert read == list(range(3000))


def test_a_bus_is_filmed_as_robots_join() -> None:
    with can.Bus("films", "virtual") as bus:
        watch = BusFilm(bus, FrameFormat(), "a bus", b=0.9)
        watch.hear(encode_telemetry(Telemetry(7, 1 << 22, 1 << 23, 0, 0)))
        watch._take(0)
        watch.hear(encode_telemetry(Telemetry(3, 1 << 21, 1 << 22, 0, 0)))
        watch._take(1)
    film = developed(watch.film)
    assert list(film.stage.robots) == [7, 3]
    expected = [[[0.5, np.nan], [np.nan] * 2, [0.5, np.nan], [0.9, np.nan]]]
    expected += [[[0.5, 0.25], [np.nan] * 2, [0.5, 0.25], [0.9, 0.9]]]
    assert np.array_equal(film.samples.values, expected, equal_nan=True)
    assert watch.has_telemetry


def test_rows_are_the_samples() -> None:
    film = filmed()
    live = LiveFilm(film.stage)
    for row in rows_of(film.samples):
        live.add(row)
    assert equal(developed(live), film)
