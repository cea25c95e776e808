"""The page in a real browser: it shows a history, goes where one drags the time, and follows a run."""

from __future__ import annotations

import re
from pathlib import Path
from typing import TYPE_CHECKING

import can
import numpy as np
import pytest

from browser import browser_page, until
from mcp_asdf_tools.bus.frame_layout import Health
from mcp_asdf_tools.bus.frames import Estimate, Heartbeat
from mcp_asdf_tools.experiments.experiment import Experiment
from mcp_asdf_tools.experiments.trials import run_trials
from mcp_asdf_tools.swarm.carrier import Wiring
from mcp_asdf_tools.swarm.run import run_swarm
from mcp_asdf_tools.swarm.settings import SwarmSettings
from mcp_asdf_tools.swarm.swarm import Swarm
from mcp_asdf_tools.view.film import History, RunDescription, State
from mcp_asdf_tools.view.films import SwarmRecorder, recompute_trial_history
from mcp_asdf_tools.view.page import page
from mcp_asdf_tools.view.roster import Roster
from mcp_asdf_tools.view.server import serving
from mcp_asdf_tools.world.arena import Arena

if TYPE_CHECKING:
    from playwright.sync_api import Page

SETTINGS = SwarmSettings(
    robots=8, flawed="50%", steps=300, filter="asdf-minus", filter_period=50, topology="dynamic", density=4
)
IS_SHOWN = "window.view && view.arena.places.length > 0 && view.charts.drawn > 0"
ALL = """[...Array(view.film.length).keys()].map((sample) => {
    const { film, film: { stage } } = view, robots = stage.robots.map((_, robot) => robot);
    return [
        stage.quantities.map((name) => robots.map((robot) => film.value(name, robot, sample))),
        robots.map((i) => robots.map((j) => film.heard(sample, i).some(([each]) => each === j))),
        robots.map((robot) => film.position(robot, sample)),
    ]; })"""
INK = "view.arena.context.getImageData(0, 0, view.arena.canvas.width, view.arena.canvas.height).data"
COLOURS = f"new Set(new Uint32Array({INK}.buffer)).size"


@pytest.fixture(scope="module")
def history() -> History:
    camera = SwarmRecorder(SETTINGS)
    with Swarm(SETTINGS, Wiring()) as swarm:
        run_swarm(swarm, [camera])
    return camera.history


@pytest.mark.slow
def test_the_page_shows_a_film_and_follows_a_run(history: History, tmp_path: Path) -> None:
    """One browser for all that is tested always: starting it takes longer than the rest."""
    path, step = tmp_path / "run.html", 1 / 65534
    path.write_text(page(history))
    update = history.states_since()
    stage, states = update.description, update.states
    with browser_page() as browser:
        browser.goto(path.as_uri())
        until(browser, IS_SHOWN)
        for (values, links, places), state in zip(browser.evaluate(ALL), states, strict=True):
            assert state.positions is not None and stage.sides is not None
            assert np.abs(values - state.values).max() <= step
            assert np.array_equal(links, state.neighbours)
            assert np.abs(places - state.positions).max() <= step * max(stage.sides)

        browser.evaluate("view.player.pause()")
        browser.locator("#time").fill("200")
        # Robots are where the frame last drawn has them.
        until(browser, "document.getElementById('clock').textContent.startsWith('step 200 of')")
        x, y = until(browser, "view.arena.places[2].map((each) => each / view.arena.ratio)")
        browser.locator("#arena").click(position={"x": x, "y": y})
        assert until(browser, "view.chosen") == 2
        assert "Robot 2, flawed at the start" in browser.locator("#robot").inner_text()
        assert browser.evaluate(COLOURS) > 50
        follow_a_run(browser, history)


def follow_a_run(browser: Page, history: History) -> None:
    """States come and a robot joins while the page is open; it goes along until the run has ended."""
    update = history.states_since()
    stage, states = update.description, update.states
    live = History(stage)
    with serving(live) as url:
        for state in states[:50]:
            live.add(state)
        browser.goto(url)
        until(browser, f"{IS_SHOWN} && view.film.length === 50")
        for state in states[50:]:
            live.add(state)
        until(browser, f"view.film.length === {len(states)} && view.player.tick > 250")
    bus = History(RunDescription("a bus", [5]))
    with serving(bus) as url:
        bus.add(states[0]._replace(values=states[0].values[:, :1], neighbours=np.eye(1) > 1, positions=None))
        browser.goto(url)
        until(browser, f"{IS_SHOWN} && view.film.robots === 1")
        bus.add_robot(9)
        until(browser, "view.film.robots === 2 && view.film.length === 1")
        assert browser.evaluate("Number.isNaN(view.film.value('x', 1, 0))")
        check_the_table(browser, bus)
        bus.has_ended = True
        until(browser, "document.getElementById('state').textContent === 'the run has ended'")


def check_the_table(browser: Page, bus: History) -> None:
    """A row for each robot, a silent one greyed, and frames through the filter."""
    roster, text = Roster(), "document.getElementById('frames').textContent"
    for robot, now in ((9, 0.0), (5, 9.0)):
        for content in (Estimate(robot, 0, 0, 3), Heartbeat(robot, 60, 4, Health.WARNING)):
            roster.receive(can.Message(), content, now)
    bus.report = roster.report(10.0)
    until(browser, "document.querySelectorAll('#roster tbody tr').length === 2")
    rows = [row.split() for row in browser.locator("#roster tbody tr").all_inner_texts()]
    rest = ["%", "0", *["\N{EN DASH}"] * 3, "0"]
    assert rows[0] == ["5", "1.0", "s", "warning", "operational", "1.0/s", "0.0", *rest]
    assert rows[1] == ["9", "10.0", "s", "warning", "operational", "0.0/s", "0.0", *rest]
    assert browser.locator("#roster tr.silent").count() == 1
    browser.locator("#roster button").last.press("Enter")
    assert browser.evaluate("view.film.stage.robots[view.chosen]") == 9
    assert browser.evaluate(text).count("\n") == 3
    browser.locator("#filter").fill("9 heartbeat")
    assert browser.evaluate(text).strip() == "0.000 s  9  heartbeat 4: warning, operational, up 60 s"


def check_marks(browser: Page, path: Path) -> None:
    """Faults stand in the header; they, a death and a return are marked; the dead are in no mean."""
    states = [State(tick, np.full((4, 2), 0.5), np.eye(2) > 1, None) for tick in range(11)]
    for state in states[4:7]:
        state.values[:3, 1] = np.nan
    states[5].values[0, 0] = 0.75
    faults = [("loss=0.2", 0, None), ("liar=1.0", 2, 9)]
    stage = RunDescription("two", [3, 8], fill_ratio=0.5, steps=10, faults=faults)
    path.write_text(page(History(stage, states)))
    browser.goto(f"{path.as_uri()}#step=5")
    until(browser, IS_SHOWN)
    assert browser.locator("#faults").inner_text() == "loss=0.2; liar=1.0"
    figures = [browser.locator(f"#{name}").inner_text() for name in ("mean-x", "spread", "wrong")]
    assert figures == ["0.750", "0.000", "0 of 1"]
    events = browser.evaluate("view.film.events.map(({ tick, text }) => `${tick} ${text}`).join(', ')")
    assert events == "1 fault: loss=0.2, 2 fault: liar=1.0, 4 dead, 7 back, 9 fault over: liar=1.0"
    width, data = "document.getElementById('marks').width", "getContext('2d').getImageData"
    ink = f"document.getElementById('marks').{data}(0, 0, {width}, 1).data.filter((each, i) => i % 4 === 3)"
    places = np.flatnonzero(list(browser.evaluate(f"[...{ink}]")))[::2] / (browser.evaluate(width) - 2)
    assert places == pytest.approx([0.1, 0.2, 0.4, 0.7, 0.9], abs=0.01)


def check_keys_and_address(browser: Page, path: Path) -> None:
    """Arrows choose a robot, n and p lead to events, and the address brings back what was seen."""
    browser.mouse.move(0, 0)
    browser.locator("#arena").focus()
    for key, robot in (("ArrowRight", 0), ("ArrowLeft", 7), ("ArrowLeft", 6), ("ArrowDown", 7)):
        browser.keyboard.press(key)
        assert browser.evaluate("view.chosen") == robot
    browser.evaluate("view.player.seek(0)")
    ticks = browser.evaluate("[...new Set(view.film.events.map(({ tick }) => tick))]")
    for key, tick in (("n", ticks[0]), ("n", ticks[1]), ("p", ticks[0])):
        browser.keyboard.press(key)
        assert browser.evaluate("view.player.tick") == tick
    browser.locator("#later").click()
    assert browser.evaluate("view.player.tick") == ticks[1]
    until(browser, f"location.hash.startsWith('#step={ticks[1]}&robot=')")
    browser.goto("about:blank")
    browser.goto(f"{path.as_uri()}#step=120&robot=5")
    until(browser, f"{IS_SHOWN} && view.player.tick === 120 && view.chosen === 5 && !view.player.isPlaying")


@pytest.mark.slow
def test_all_controls_work_on_screens_of_any_size(history: History, tmp_path: Path) -> None:
    path, asked = tmp_path / "run.html", list[str]()
    path.write_text(page(history))
    with browser_page() as browser:
        browser.on("request", lambda request: asked.append(request.url.partition(":")[0]))
        for width, height, is_dark in ((1920, 1080, False), (1024, 700, True), (420, 900, False)):
            browser.emulate_media(color_scheme="dark" if is_dark else "light")
            browser.set_viewport_size({"width": width, "height": height})
            browser.goto("about:blank")  # a page that plays keeps its step in the address, which interrupts
            browser.goto(path.as_uri())
            until(browser, f"{IS_SHOWN} && view.player.tick > 0")
            assert browser.evaluate("document.documentElement.scrollWidth") <= width
            for name in ("#arena", "#charts", "#figures", "#events", "#play", "#time"):
                box = browser.locator(name).bounding_box()
                assert box is not None and min(box["width"], box["height"]) > 10, name
            assert browser.evaluate("view.charts.plots.every((each) => each.plot.over.clientHeight > 40)")
            background = browser.evaluate("getComputedStyle(document.body).backgroundColor")
            assert (int(re.findall(r"\d+", background)[0]) < 128) == is_dark
        browser.locator("#play").click()
        assert not browser.evaluate("view.player.isPlaying")
        browser.locator("#speed").select_option("1000")
        browser.keyboard.press("Escape")
        browser.locator("#play").click()
        until(browser, "view.player.tick === view.player.end && !view.player.isPlaying")
        until(browser, "document.querySelectorAll('#events button').length > 0")
        browser.locator("#events button").last.click()
        until(browser, "view.chosen !== null && view.player.tick % 50 === 0")
        browser.keyboard.press("Escape")
        assert browser.evaluate("view.chosen") is None
        check_keys_and_address(browser, path)
        check_marks(browser, tmp_path / "faults.html")
    assert set(asked) <= {"file", "data", "blob"}, "nothing comes from a network"


@pytest.mark.slow
def test_the_page_shows_who_hears_whom_among_many(tmp_path: Path) -> None:
    experiment = Experiment(topology="dynamic", robots=140, steps=40, trials=1)
    history = recompute_trial_history(run_trials(experiment, 0, 1), 0)
    hears = np.argwhere(Arena(experiment).record(40).adjacency[-1])
    (tmp_path / "many.html").write_text(page(history))
    with browser_page() as browser:
        browser.goto((tmp_path / "many.html").as_uri())
        until(browser, IS_SHOWN)
        shown = browser.evaluate("[...Array(view.film.length).keys()].map((at) => view.film.heard(at))")
        one = browser.evaluate(f"view.film.heard(view.film.length - 1, {hears[0, 0]})")
    assert [state.neighbours[:, ::-1].tolist() for state in history.states_since().states] == shown
    assert shown[-1] == hears[:, ::-1].tolist() and one == [
        each for each in shown[-1] if each[1] == hears[0, 0]
    ]
