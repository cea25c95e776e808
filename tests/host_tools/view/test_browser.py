"""The page in a real browser: it shows a history, has controls, and follows a run as it goes."""

from __future__ import annotations

import re
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING

import can
import numpy as np
import pytest

from browser import new_page, until
from mcp_asdf_tools.bus.frame_layout import Health
from mcp_asdf_tools.bus.frames import Estimate, Heartbeat
from mcp_asdf_tools.experiments.experiment import Experiment
from mcp_asdf_tools.experiments.trials import run_trials
from mcp_asdf_tools.swarm.carrier import Wiring
from mcp_asdf_tools.swarm.run import run_swarm
from mcp_asdf_tools.swarm.settings import SwarmSettings
from mcp_asdf_tools.swarm.swarm import Swarm
from mcp_asdf_tools.view.history import QUANTITIES, History, RunDescription, State
from mcp_asdf_tools.view.page import make_page
from mcp_asdf_tools.view.roster import Roster
from mcp_asdf_tools.view.server import serve_page
from mcp_asdf_tools.view.swarm_recorder import SwarmRecorder
from mcp_asdf_tools.view.trial_history import recompute_trial_history
from mcp_asdf_tools.world.arena import Arena
from support import ROOT

if TYPE_CHECKING:
    from playwright.sync_api import Browser, Page

pytestmark = pytest.mark.slow

SETTINGS = SwarmSettings(
    robots=8, flawed="50%", steps=300, filter="asdf-minus", filter_period=50, topology="dynamic", density=4
)
IS_DRAWN = "window.view && view.arena.centres.length > 0 && view.charts.drawnStateCount > 0"
ALL_STATES = """[...Array(view.history.stateCount).keys()].map((state) => {
    const { history } = view, robots = history.description.robots.map((_, robot) => robot);
    return {
        values: history.description.quantities.map((name) =>
            robots.map((robot) => history.value(name, robot, state))),
        neighbours: robots.map((receiver) => robots.map((sender) =>
            history.links(state, receiver).some(([linked]) => linked === sender))),
        positions: robots.map((robot) => history.position(robot, state)),
    }; })"""
X, X_HAT, B_HAT = (QUANTITIES.index(name) for name in ("x", "x_hat", "b_hat"))
"""Rows of a state's values."""
PIXELS = "view.arena.context.getImageData(0, 0, view.arena.canvas.width, view.arena.canvas.height).data"
FRAME_LINES = "document.getElementById('frames').textContent"


@pytest.fixture(scope="module")
def history() -> History:
    """The history of a swarm whose robots move and recalibrate."""
    recorder = SwarmRecorder(SETTINGS)
    with Swarm(SETTINGS, Wiring()) as swarm:
        run_swarm(swarm, [recorder])
    return recorder.history


@pytest.fixture(scope="module")
def file(history: History, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The page of the history, as a file."""
    file = tmp_path_factory.mktemp("browser") / "run.html"
    file.write_text(make_page(history))
    return file


def open_file(browser: Page, file: Path, address: str = "") -> None:
    """Open a page from a file, and wait until it is drawn."""
    browser.goto(f"{file.as_uri()}{address}")
    until(browser, IS_DRAWN)


def open_file_paused(browser: Page, file: Path) -> None:
    """Open a page from a file, and pause it at the start."""
    open_file(browser, file)
    browser.evaluate("view.player.pause()")
    browser.evaluate("view.player.seek(0)")


# --- A recording --------------------------------------------------------------------------------------


def test_the_page_has_the_values_links_and_positions_of_all_states(
    browser: Page, file: Path, history: History
) -> None:
    open_file(browser, file)
    smallest_step = 1 / 65534
    states = history.states_since().states
    for shown, state in zip(browser.evaluate(ALL_STATES), states, strict=True):
        assert state.positions is not None
        assert np.abs(np.array(shown["values"]) - state.values).max() <= smallest_step
        assert np.array_equal(shown["neighbours"], state.neighbours)
        longest_side = max(SETTINGS.sides)
        assert np.abs(shown["positions"] - state.positions).max() <= smallest_step * longest_side


def test_the_page_has_the_links_of_a_trial_with_more_robots_than_fit_a_bus(
    browser: Page, tmp_path: Path
) -> None:
    """A history of up to 128 robots has links as a matrix of bits, and one of more robots as pairs of ids."""
    experiment = Experiment(topology="dynamic", robots=140, steps=40, trials=1)
    history = recompute_trial_history(run_trials(experiment, 0, 1), 0)
    (tmp_path / "many.html").write_text(make_page(history))
    last_adjacency = Arena(experiment).record(experiment.steps).adjacency[-1]
    expected_links = [
        [sender, receiver]
        for receiver, is_heard in enumerate(last_adjacency)
        for sender in np.flatnonzero(is_heard).tolist()
    ]
    first_receiver = expected_links[0][1]
    expected_links_to_first = [link for link in expected_links if link[1] == first_receiver]

    open_file(browser, tmp_path / "many.html")
    last_state = browser.evaluate("view.history.stateCount - 1")
    assert browser.evaluate(f"view.history.links({last_state})") == expected_links
    links_to_first = browser.evaluate(f"view.history.links({last_state}, {first_receiver})")
    assert links_to_first == expected_links_to_first


def read_figure(browser: Page, name: str) -> float:
    """Return a figure of the swarm as the page shows it."""
    return float(browser.locator(f"#{name}").inner_text())


def test_the_figures_are_those_of_the_state_that_is_shown(
    browser: Page, file: Path, history: History
) -> None:
    open_file(browser, file, "#step=120")
    until(browser, "document.getElementById('clock').textContent.startsWith('step 120 ')")
    (state,) = [state for state in history.states_since().states if state.tick == 120]
    values = dict(zip(QUANTITIES, state.values, strict=True))
    x = values["x"]
    b_hat_errors = np.abs(values["b_hat"] - values["b"])
    half_digit = 0.00055  # three digits are shown, of values that the page has rounded before
    assert read_figure(browser, "mean-x") == pytest.approx(x.mean(), abs=half_digit)
    assert read_figure(browser, "spread") == pytest.approx(np.ptp(x), abs=half_digit)
    mean_error = np.abs(x - SETTINGS.fill_ratio).mean()
    assert read_figure(browser, "mean-error") == pytest.approx(mean_error, abs=half_digit)
    wrong_count = np.count_nonzero(b_hat_errors > 0.1)

    assert browser.locator("#wrong").inner_text() == f"{wrong_count} of 8"


def test_the_charts_draw_the_values_of_the_history(browser: Page, file: Path, history: History) -> None:
    """Each of the 300 states is in the lines of robots twice, and in that of the mean error once."""
    open_file(browser, file)
    states = history.states_since().states
    # A chart has its times first, and those of robots have the line of the true value last.
    error_chart, *robot_charts = browser.evaluate(
        "view.charts.views.map(({ plot }) => plot.data.map((series) => [...series]))"
    )
    mean_errors = [np.abs(state.values[X] - SETTINGS.fill_ratio).mean() for state in states]
    assert error_chart[1] == pytest.approx(mean_errors, abs=1e-4)
    for quantity, chart in zip((B_HAT, X_HAT, X), robot_charts, strict=True):
        lines = np.array(chart[1:-1])
        first_values, second_values = lines[:, ::2], lines[:, 1::2]
        expected = np.stack([state.values[quantity] for state in states], axis=1)
        assert np.abs(first_values - expected).max() < 1e-4
        assert np.array_equal(first_values, second_values)


def test_the_arena_is_drawn_in_many_colours(browser: Page, file: Path) -> None:
    open_file(browser, file)
    assert browser.evaluate(f"new Set(new Uint32Array({PIXELS}.buffer)).size") > 50


def test_a_page_explains_itself_and_leads_to_the_method(browser: Page, file: Path) -> None:
    open_file(browser, file)
    assert browser.locator("#about").inner_text() == (
        "Each robot guesses the share of black tiles. Half of them misjudge their sensor (orange). "
        "Watch them find out. The truth is 55\N{NO-BREAK SPACE}%. How it works: the paper"
    )
    paper = browser.locator("#about a").get_attribute("href")

    assert f"url: {paper}\n" in (ROOT / "CITATION.cff").read_text(encoding="utf-8")


def test_nothing_comes_from_a_network(browser: Page, file: Path) -> None:
    schemes = set[str]()
    browser.on("request", lambda request: schemes.add(request.url.partition(":")[0]))
    open_file(browser, file)
    assert schemes <= {"file", "data", "blob"}


@pytest.mark.parametrize(("width", "height"), [(1920, 1080), (1024, 700), (420, 900)])
def test_everything_fits_on_the_screen(chromium: Browser, file: Path, width: int, height: int) -> None:
    with new_page(chromium, width, height) as browser:
        open_file(browser, file)
        assert browser.evaluate("document.documentElement.scrollWidth") <= width
        for name in ("#arena", "#charts", "#figures", "#events", "#play", "#time"):
            box = browser.locator(name).bounding_box()
            assert box is not None and min(box["width"], box["height"]) > 10, name
        assert browser.evaluate("view.charts.views.every(({ plot }) => plot.over.clientHeight > 40)")


@pytest.mark.parametrize(("scheme", "is_dark"), [("light", False), ("dark", True)])
def test_the_page_has_the_colours_of_the_system(
    browser: Page, file: Path, scheme: str, is_dark: bool
) -> None:
    open_file(browser, file)
    browser.emulate_media(color_scheme=scheme)  # type: ignore[arg-type]
    background = browser.evaluate("getComputedStyle(document.body).backgroundColor")
    red_channel = int(re.findall(r"\d+", background)[0])

    assert (red_channel < 128) == is_dark


# --- Controls -----------------------------------------------------------------------------------------


def test_a_recording_plays_to_its_end(browser: Page, file: Path) -> None:
    open_file(browser, file)
    browser.locator("#speed").select_option("1000")
    until(browser, "view.player.tick === view.player.end && !view.player.isPlaying")


def test_the_button_pauses_and_plays(browser: Page, file: Path) -> None:
    open_file(browser, file)
    browser.locator("#play").click()
    assert not browser.evaluate("view.player.isPlaying")
    browser.locator("#play").click()

    assert browser.evaluate("view.player.isPlaying")


def test_the_time_line_leads_to_a_step(browser: Page, file: Path) -> None:
    open_file_paused(browser, file)
    browser.locator("#time").fill("200")
    until(browser, "document.getElementById('clock').textContent === 'step 200 of 300, 20.0 s'")


def test_a_click_follows_a_robot(browser: Page, file: Path) -> None:
    open_file_paused(browser, file)
    x, y = until(browser, "view.arena.centres[2].map((pixel) => pixel / view.arena.pixelRatio)")
    browser.locator("#arena").click(position={"x": x, "y": y})
    assert until(browser, "view.followedRobot") == 2
    until(browser, "document.querySelector('#robot h2').textContent === 'Robot 2, flawed at the start'")


def test_the_arrow_keys_follow_one_robot_after_the_other(browser: Page, file: Path) -> None:
    open_file_paused(browser, file)
    browser.locator("#arena").focus()
    followed_robots = []
    for key in ("ArrowRight", "ArrowLeft", "ArrowLeft", "ArrowDown"):
        browser.keyboard.press(key)
        followed_robots.append(browser.evaluate("view.followedRobot"))

    assert followed_robots == [0, 7, 6, 7]


def test_escape_follows_no_robot(browser: Page, file: Path) -> None:
    open_file_paused(browser, file)
    browser.evaluate("view.followRobot(2)")
    browser.keyboard.press("Escape")
    assert browser.evaluate("view.followedRobot") is None


def test_keys_and_buttons_lead_from_event_to_event(browser: Page, file: Path) -> None:
    open_file_paused(browser, file)
    first, second, *_ = browser.evaluate("[...new Set(view.history.events.map(({ tick }) => tick))]")
    ticks = []
    for key in ("n", "n", "p"):
        browser.keyboard.press(key)
        ticks.append(browser.evaluate("view.player.tick"))
    browser.locator("#later").click()
    ticks.append(browser.evaluate("view.player.tick"))

    assert ticks == [first, second, first, second]


def test_a_click_on_an_event_leads_to_its_time_and_robot(browser: Page, file: Path) -> None:
    open_file_paused(browser, file)
    browser.evaluate("view.player.seek(300)")
    until(browser, "document.querySelectorAll('#events button').length > 0")
    browser.locator("#events button").last.click()

    assert browser.evaluate("view.followedRobot !== null")
    assert browser.evaluate("view.player.tick") % SETTINGS.filter_period == 0


def test_the_address_has_step_and_robot(browser: Page, file: Path) -> None:
    open_file_paused(browser, file)
    browser.evaluate("view.player.seek(120)")
    browser.evaluate("view.followRobot(5)")
    until(browser, "location.hash === '#step=120&robot=5'")


def test_an_address_leads_to_its_step_and_robot(browser: Page, file: Path) -> None:
    open_file(browser, file, "#step=120&robot=5")
    until(browser, "view.player.tick === 120 && view.followedRobot === 5")
    assert not browser.evaluate("view.player.isPlaying")
    until(browser, "document.getElementById('time').value === '120'")
    until(browser, "view.charts.drawnStateCount === view.history.stateCount")
    lines_are_right = """view.charts.views.every(({ plot }) => {
        const { m41 } = new DOMMatrix(getComputedStyle(plot.over.querySelector(".now")).transform);
        return Math.abs(m41 - plot.valToPos(120, "x")) < 1;
    })"""
    until(browser, lines_are_right)


# --- Faults and deaths --------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def file_with_faults(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The page of a run of robots 3 and 8 with two faults, in which robot 8 is dead from tick 4 to 6."""
    states = [State(tick, np.full((4, 2), 0.5), np.eye(2) > 1, None) for tick in range(11)]
    for state in states[4:7]:
        state.values[:3, 1] = np.nan
    states[5].values[0, 0] = 0.75
    faults = [("loss=0.2", 0, None), ("liar=1.0", 2, 9)]
    description = RunDescription("two", [3, 8], fill_ratio=0.5, steps=10, faults=faults)
    file = tmp_path_factory.mktemp("faults") / "faults.html"
    file.write_text(make_page(History(description, states)))
    return file


def test_faults_stand_in_the_header(browser: Page, file_with_faults: Path) -> None:
    open_file(browser, file_with_faults)
    assert browser.locator("#faults").inner_text() == "loss=0.2; liar=1.0"


def test_dead_robots_are_in_no_figure(browser: Page, file_with_faults: Path) -> None:
    open_file(browser, file_with_faults, "#step=5")
    figures = [browser.locator(f"#{name}").inner_text() for name in ("mean-x", "spread", "wrong")]
    assert figures == ["0.750", "0.000", "0 of 1"]


def test_faults_deaths_and_returns_are_events(browser: Page, file_with_faults: Path) -> None:
    open_file(browser, file_with_faults)
    events = browser.evaluate("view.history.events.map(({ tick, text }) => `${tick} ${text}`)")
    assert events == ["1 fault: loss=0.2", "2 fault: liar=1.0", "4 dead", "7 back", "9 fault over: liar=1.0"]


def test_events_are_marked_on_the_time_line(browser: Page, file_with_faults: Path) -> None:
    open_file(browser, file_with_faults, "#step=5")
    width = browser.evaluate("document.getElementById('marks').width")
    row = f"document.getElementById('marks').getContext('2d').getImageData(0, 0, {width}, 1).data"
    opacities = browser.evaluate(f"[...{row}].filter((_, index) => index % 4 === 3)")
    first_pixels = np.flatnonzero(opacities)[::2]  # each mark is two pixels wide

    assert first_pixels / (width - 2) == pytest.approx([0.1, 0.2, 0.4, 0.7, 0.9], abs=0.01)


# --- A run as it goes ---------------------------------------------------------------------------------


def test_the_page_follows_a_run(browser: Page, history: History) -> None:
    update = history.states_since()
    live = History(update.description)
    with serve_page(live) as url:
        for state in update.states[:50]:
            live.add(state)
        browser.goto(url)
        until(browser, f"{IS_DRAWN} && view.history.stateCount === 50")
        for state in update.states[50:]:
            live.add(state)
        until(browser, f"view.history.stateCount === {len(update.states)} && view.player.tick > 250")


def test_the_page_says_when_a_run_has_ended(browser: Page) -> None:
    live = History(RunDescription("one robot", [0]))
    with serve_page(live) as url:
        browser.goto(url)
        live.has_ended = True
        until(browser, "document.getElementById('state').textContent === 'the run has ended'")
        assert browser.locator("#waiting").inner_text() == "the run has ended without any data"


def test_a_run_that_has_just_ended_is_shown_at_its_end(browser: Page, history: History) -> None:
    update = history.states_since()
    live = History(update.description)
    for state in update.states:
        live.add(state)
    live.has_ended = True
    with serve_page(live) as url:
        browser.goto(url)
        until(browser, "document.getElementById('clock').textContent.startsWith('step 300 of 300')")
        assert browser.locator("#play").inner_text() == "▶ play"


def test_the_page_of_a_bus_waits_for_it(browser: Page) -> None:
    live = History(RunDescription("a bus", []))
    with serve_page(live) as url:
        browser.goto(url)
        until(browser, "document.getElementById('waiting').textContent.startsWith('waiting for the bus')")
        live.add_robot(5)
        live.add(State(1, np.full((4, 1), 0.5), np.eye(1) > 1, None))
        until(browser, "view.history.stateCount === 1 && document.getElementById('waiting').hidden")


@pytest.fixture
def bus_browser(browser: Page) -> Iterator[Page]:
    """The page of a bus: robot 5 has sent values, robot 9 comes later, and both are in the table."""
    live = History(RunDescription("a bus", [5]))
    live.add(State(1, np.full((4, 1), 0.5), np.eye(1) > 1, None))
    roster = Roster()
    for robot, now in ((9, 0.0), (5, 9.0)):
        roster.receive(can.Message(), Estimate(robot, 0, 0, 3), now)
        roster.receive(can.Message(), Heartbeat(robot, 60, 4, Health.WARNING), now)
    with serve_page(live) as url:
        browser.goto(url)
        until(browser, f"{IS_DRAWN} && view.history.robotCount === 1")
        live.add_robot(9)
        live.report = roster.report(10.0)
        until(browser, "document.querySelectorAll('#roster tbody tr').length === 2")
        yield browser


def test_a_robot_that_joins_has_no_values_before(bus_browser: Page) -> None:
    until(bus_browser, "view.history.robotCount === 2 && view.history.stateCount === 1")
    assert bus_browser.evaluate("Number.isNaN(view.history.value('x', 1, 0))")


def test_the_table_has_a_row_for_each_robot(bus_browser: Page) -> None:
    rows = [" ".join(row.split()) for row in bus_browser.locator("#roster tbody tr").all_inner_texts()]
    assert rows == [
        "5 1.0 s warning operational 1.0/s 0.0 % 0 – – – 0",  # noqa: RUF001
        "9 10.0 s warning operational 0.0/s 0.0 % 0 – – – 0",  # noqa: RUF001
    ]


def test_the_row_of_a_silent_robot_is_grey(bus_browser: Page) -> None:
    assert bus_browser.locator("#roster tr.silent button").all_inner_texts() == ["9"]


def test_the_button_of_a_row_follows_its_robot(bus_browser: Page) -> None:
    until(bus_browser, "view.history.robotCount === 2")
    bus_browser.locator("#roster button").last.press("Enter")
    assert bus_browser.evaluate("view.history.description.robots[view.followedRobot]") == 9


def test_frames_are_listed_with_the_latest_first(bus_browser: Page) -> None:
    lines = bus_browser.evaluate(FRAME_LINES).splitlines()
    assert lines[0].strip() == "9.000 s  5  heartbeat 4: warning, operational, up 60 s"
    assert [line.split()[:3] for line in lines] == [["9.000", "s", "5"]] * 2 + [["0.000", "s", "9"]] * 2


def test_the_filter_shows_frames_that_have_all_its_words(bus_browser: Page) -> None:
    bus_browser.locator("#filter").fill("9 heartbeat")
    line = bus_browser.evaluate(FRAME_LINES)
    assert line.strip() == "0.000 s  9  heartbeat 4: warning, operational, up 60 s"
