"""The web page of a swarm in a real browser: it shows a history and follows a running swarm."""

from __future__ import annotations

import re
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any

import can
import numpy as np
import pytest

from browser import new_page, until
from mcp_asdf_tools.bus.frame_layout import Health
from mcp_asdf_tools.bus.frames import Estimate, Heartbeat
from mcp_asdf_tools.swarm.carrier import Wiring
from mcp_asdf_tools.swarm.run import run_swarm
from mcp_asdf_tools.swarm.settings import SwarmSettings
from mcp_asdf_tools.swarm.swarm import Swarm
from mcp_asdf_tools.view.history import NO_LINKS, History, RunDescription, State
from mcp_asdf_tools.view.page import make_page
from mcp_asdf_tools.view.roster import Roster
from mcp_asdf_tools.view.run_histories import SwarmRecorder
from mcp_asdf_tools.view.server import serve_page
from support import ROOT

if TYPE_CHECKING:
    from playwright.sync_api import Browser, Page

pytestmark = pytest.mark.slow

SETTINGS = SwarmSettings(
    robots=8,
    flawed="50%",
    steps=300,
    filter="asdf-minus",
    filter_period=50,
    topology="dynamic",
    density=4,
)
IS_DRAWN = "window.view && view.arena.centres.length > 0 && view.charts.drawnStateCount > 0"
PIXELS_OF_ARENA = (
    "view.arena.context.getImageData(0, 0, view.arena.canvas.width, view.arena.canvas.height).data"
)
"""These two are expressions of JavaScript, which the web page evaluates."""


@pytest.fixture(scope="module")
def history() -> History:
    """The history of a swarm whose robots move and recalibrate."""
    recorder = SwarmRecorder(SETTINGS)
    with Swarm(SETTINGS, Wiring()) as swarm:
        run_swarm(swarm, [recorder])
    return recorder.history


@pytest.fixture(scope="module")
def page_file(history: History, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The web page of the history, as a file."""
    file = tmp_path_factory.mktemp("browser") / "run.html"
    file.write_text(make_page(history))
    return file


def open_file(browser: Page, file: Path, address: str = "") -> None:
    """Open a web page from a file, and wait until it is drawn."""
    browser.goto(f"{file.as_uri()}{address}")
    until(browser, IS_DRAWN)


def open_paused_at_start(browser: Page, file: Path) -> None:
    """Open a web page from a file, and pause it at step 0."""
    open_file(browser, file)
    browser.evaluate("view.player.pause()")
    browser.evaluate("view.player.seek(0)")


def text_of(browser: Page, element_id: str) -> str:
    """Return the text that a user sees in an element of the web page."""
    return browser.locator(f"#{element_id}").inner_text()


def wait_for_text(browser: Page, element_id: str, beginning: str) -> None:
    """Wait until the text of an element begins with these words."""
    until(browser, f"document.getElementById('{element_id}').textContent.startsWith('{beginning}')")


# --- A recording --------------------------------------------------------------------------------------


def test_the_arena_is_drawn_in_many_colours(browser: Page, page_file: Path) -> None:
    """The colours of floor, links and eight robots blend at their edges into more than 50.

    A script puts the pixels, 32 bits each, into a set, so that each colour is counted once.
    """
    open_file(browser, page_file)
    number_of_colours = browser.evaluate(f"new Set(new Uint32Array({PIXELS_OF_ARENA}.buffer)).size")
    assert number_of_colours > 50


def test_the_header_explains_the_swarm_and_links_to_the_paper_that_is_to_be_cited(
    browser: Page, page_file: Path
) -> None:
    """The explanation of the swarm ends with a link, whose address is that of the paper in CITATION.cff."""
    open_file(browser, page_file)
    assert text_of(browser, "about") == (
        "Each robot guesses the share of black tiles. Half of them misjudge their sensor (orange). "
        "Watch them find out. The truth is 55\N{NO-BREAK SPACE}%. How it works: the paper"
    )
    address_of_paper = browser.locator("#about a").get_attribute("href")
    citation = (ROOT / "CITATION.cff").read_text(encoding="utf-8")
    assert f"url: {address_of_paper}\n" in citation


def test_an_exported_page_loads_nothing_from_a_network(browser: Page, page_file: Path) -> None:
    """All that the browser requests is the file itself or data inside it.

    The scheme of an address stands before its first colon. An address in a network has another scheme: https.
    """
    requested_addresses = []
    browser.on("request", lambda request: requested_addresses.append(request.url))
    open_file(browser, page_file)

    requested_schemes = {address.partition(":")[0] for address in requested_addresses}
    assert "file" in requested_schemes
    assert requested_schemes <= {"file", "data", "blob"}


@pytest.mark.parametrize(("width", "height"), [(1920, 1080), (1024, 700), (420, 900)])
def test_arena_charts_and_controls_all_fit_into_the_width_of_a_large_a_small_and_a_phone_s_screen(
    chromium: Browser, page_file: Path, width: int, height: int
) -> None:
    """There is no need to scroll sideways. Nothing is squeezed below 10 pixels, and no chart below 40."""
    with new_page(chromium, width, height) as browser:
        open_file(browser, page_file)
        assert browser.evaluate("document.documentElement.scrollWidth") <= width
        for part in ("arena", "charts", "figures", "events", "play", "time"):
            box = browser.locator(f"#{part}").bounding_box()
            assert box is not None, part
            assert min(box["width"], box["height"]) > 10, part
        chart_heights = browser.evaluate("view.charts.views.map(({ plot }) => plot.over.clientHeight)")
        assert min(chart_heights) > 40


@pytest.mark.parametrize(("scheme", "is_dark"), [("light", False), ("dark", True)])
def test_the_background_is_dark_where_the_user_prefers_dark_colours(
    browser: Page, page_file: Path, scheme: str, is_dark: bool
) -> None:
    """The browser reports the background as "rgb(16, 20, 26)": red, green and blue, from 0 (black) to 255.

    The background is nearly grey, so its red tells if it is dark.
    """
    open_file(browser, page_file)
    browser.emulate_media(color_scheme=scheme)  # type: ignore[arg-type]
    background = browser.evaluate("getComputedStyle(document.body).backgroundColor")
    red, _green, _blue = re.findall(r"\d+", background)

    assert (int(red) < 128) == is_dark


# --- Controls -----------------------------------------------------------------------------------------


def test_a_recording_plays_until_its_last_step_and_stops(browser: Page, page_file: Path) -> None:
    """It has 300 steps and is played at the speed of 1000 steps a second."""
    open_file(browser, page_file)
    browser.locator("#speed").select_option("1000")
    until(browser, "view.player.tick === 300 && !view.player.isPlaying")


def test_the_play_button_pauses_a_recording_and_continues_it(browser: Page, page_file: Path) -> None:
    """A web page plays its recording as soon as it is opened; the button is clicked twice."""
    open_file(browser, page_file)
    browser.locator("#play").click()
    assert not browser.evaluate("view.player.isPlaying")
    browser.locator("#play").click()

    assert browser.evaluate("view.player.isPlaying")


def test_moving_the_time_slider_to_200_shows_step_200(browser: Page, page_file: Path) -> None:
    """The clock shows the time as well: robots take ten steps a second."""
    open_paused_at_start(browser, page_file)
    browser.locator("#time").fill("200")
    wait_for_text(browser, "clock", "step 200 of 300, 20.0 s")


def test_a_click_on_robot_2_in_the_arena_shows_the_values_of_robot_2(browser: Page, page_file: Path) -> None:
    """The values stand in a part of the page with the title "Robot 2, flawed at the start".

    The first four of the eight robots are flawed.
    """
    open_paused_at_start(browser, page_file)
    # The canvas may have several pixels for each pixel of the page, in which a click is given.
    x, y = until(browser, "view.arena.centres[2].map((pixel) => pixel / view.arena.pixelRatio)")
    browser.locator("#arena").click(position={"x": x, "y": y})
    until(browser, "view.followedRobot === 2")
    until(browser, "document.querySelector('#robot h2').textContent === 'Robot 2, flawed at the start'")


def test_arrow_keys_select_the_next_or_the_previous_of_eight_robots(browser: Page, page_file: Path) -> None:
    """Right and down select the next robot, left the previous one; before robot 0 comes robot 7.

    No robot is selected at first, and the first key selects robot 0.
    """
    open_paused_at_start(browser, page_file)
    browser.locator("#arena").focus()

    def selected_robot_after(key: str) -> Any:
        browser.keyboard.press(key)
        return browser.evaluate("view.followedRobot")

    assert selected_robot_after("ArrowRight") == 0
    assert selected_robot_after("ArrowLeft") == 7
    assert selected_robot_after("ArrowLeft") == 6
    assert selected_robot_after("ArrowDown") == 7


def test_escape_ends_the_selection_of_a_robot(browser: Page, page_file: Path) -> None:
    """Robot 2 is selected, and then the user presses the key."""
    open_paused_at_start(browser, page_file)
    browser.evaluate("view.followRobot(2)")
    browser.keyboard.press("Escape")
    assert browser.evaluate("view.followedRobot") is None


def test_the_keys_n_and_p_go_to_the_next_and_the_previous_event(browser: Page, page_file: Path) -> None:
    """An event is, for example, that a robot corrects its estimated accuracy in a step.

    Several robots may have events in the same step, where the keys stop once.
    """
    open_paused_at_start(browser, page_file)
    steps_of_events = browser.evaluate("view.history.events.map(({ tick }) => tick)")
    first_step, second_step, *_ = sorted(set(steps_of_events))

    def shown_step_after(key: str) -> Any:
        browser.keyboard.press(key)
        return browser.evaluate("view.player.tick")

    assert shown_step_after("n") == first_step
    assert shown_step_after("n") == second_step
    assert shown_step_after("p") == first_step


def test_the_button_for_later_events_goes_to_the_next_event(browser: Page, page_file: Path) -> None:
    """At step 0 this is the first event of the swarm."""
    open_paused_at_start(browser, page_file)
    step_of_first_event = browser.evaluate("view.history.events[0].tick")
    browser.locator("#later").click()
    assert browser.evaluate("view.player.tick") == step_of_first_event


def test_a_click_in_the_list_of_events_goes_to_the_event_s_step_and_selects_its_robot(
    browser: Page, page_file: Path
) -> None:
    """Robots correct their accuracies every 50 steps, so the events of a swarm are in such steps.

    At step 300, the end, the list has all events, and its last line is clicked.
    """
    open_paused_at_start(browser, page_file)
    browser.evaluate("view.player.seek(300)")
    until(browser, "document.querySelectorAll('#events button').length > 0")
    browser.locator("#events button").last.click()

    assert browser.evaluate("view.followedRobot !== null")
    assert browser.evaluate("view.player.tick") % 50 == 0


def test_the_address_in_the_browser_holds_the_shown_step_and_the_selected_robot(
    browser: Page, page_file: Path
) -> None:
    """At step 120 with robot 5 it ends with "#step=120&robot=5"."""
    open_paused_at_start(browser, page_file)
    browser.evaluate("view.player.seek(120)")
    browser.evaluate("view.followRobot(5)")
    until(browser, "location.hash === '#step=120&robot=5'")


def test_a_page_opened_at_step_120_and_robot_5_shows_them_and_is_paused(
    browser: Page, page_file: Path
) -> None:
    """The address ends with "#step=120&robot=5". Without it a page plays its recording at once."""
    open_file(browser, page_file, "#step=120&robot=5")
    until(browser, "view.player.tick === 120 && view.followedRobot === 5")
    until(browser, "document.getElementById('time').value === '120'")
    assert not browser.evaluate("view.player.isPlaying")


def test_each_chart_has_a_vertical_line_at_the_shown_step(browser: Page, page_file: Path) -> None:
    """The line is within a pixel of where the chart draws values of step 120."""
    open_file(browser, page_file, "#step=120")
    until(browser, "view.charts.drawnStateCount === view.history.stateCount")
    is_each_line_at_step_120 = """view.charts.views.every(({ plot }) => {
        const line = plot.over.querySelector(".now");
        const pixelsFromLeft = new DOMMatrix(getComputedStyle(line).transform).m41;
        return Math.abs(pixelsFromLeft - plot.valToPos(120, "x")) < 1;
    })"""
    until(browser, is_each_line_at_step_120)


# --- Faults and deaths --------------------------------------------------------------------------------


def states_with_a_death() -> list[State]:
    """Return the states of two robots in the steps 0 to 10. The second robot is dead in the steps 4 to 6.

    All values are 0.5, but x of the first robot is 0.75 in step 5.
    """
    states = [State(tick, np.full((4, 2), 0.5), NO_LINKS, positions=None) for tick in range(11)]
    x, x_hat, b_hat, first_robot, second_robot = 0, 1, 2, 0, 1  # indices in the values of a state
    for state in states[4:7]:
        state.values[[x, x_hat, b_hat], second_robot] = np.nan
    states[5].values[x, first_robot] = 0.75
    return states


@pytest.fixture(scope="module")
def page_with_faults(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The web page of robots 3 and 8, which run ten steps with two faults.

    The fill ratio is 0.5. Frames are lost all the time, and a robot lies from step 2 to 8.
    """
    states = states_with_a_death()
    faults = [("loss=0.2", 0, None), ("liar=1.0", 2, 9)]
    description = RunDescription("two", [3, 8], fill_ratio=0.5, steps=10, faults=faults)
    file = tmp_path_factory.mktemp("faults") / "faults.html"
    file.write_text(make_page(History(description, states)))
    return file


def test_the_header_lists_the_faults_of_a_swarm(browser: Page, page_with_faults: Path) -> None:
    """Frames are lost (loss=0.2) and a robot lies (liar=1.0)."""
    open_file(browser, page_with_faults)
    assert text_of(browser, "faults") == "loss=0.2; liar=1.0"


def test_the_figures_at_a_step_leave_out_a_robot_that_is_dead(browser: Page, page_with_faults: Path) -> None:
    """In step 5 one of two robots is dead, and the other estimates 0.75 of a floor that is half black.

    So its error is 0.25. The only living robot has no spread, and its estimated accuracy is not wrong.
    """
    open_file(browser, page_with_faults, "#step=5")
    assert text_of(browser, "mean-x") == "0.750"
    assert text_of(browser, "mean-error") == "0.250"
    assert text_of(browser, "spread") == "0.000"
    assert text_of(browser, "wrong") == "0 of 1"


def test_the_first_chart_draws_the_mean_error_in_each_step(browser: Page, page_with_faults: Path) -> None:
    """In step 5 the only living robot estimates 0.75 of a floor that is half black; all else is right."""
    open_file(browser, page_with_faults)
    first_chart = "view.charts.views[0].plot"
    steps = browser.evaluate(f"[...{first_chart}.data[0]]")
    mean_errors = browser.evaluate(f"[...{first_chart}.data[1]]")

    error_in_step_5 = 0.75 - 0.5
    assert steps == [0, 1, 2, 3, 4, 5, 6, 7, 8, 9, 10]
    assert mean_errors == pytest.approx([0, 0, 0, 0, 0, error_in_step_5, 0, 0, 0, 0, 0], abs=1e-4)


# --- A swarm as it runs -------------------------------------------------------------------------------


def test_an_open_page_shows_steps_that_a_running_swarm_takes_meanwhile(
    browser: Page, history: History
) -> None:
    """The page is opened after 50 of 300 steps. It shows a step near the end soon after all are taken."""
    states = history.states_since().states
    running_history = History(history.description)
    with serve_page(running_history) as url:
        for state in states[:50]:
            running_history.add(state)
        browser.goto(url)
        until(browser, f"{IS_DRAWN} && view.history.stateCount === 50")
        for state in states[50:]:
            running_history.add(state)
        until(browser, "view.history.stateCount === 300 && view.player.tick > 250")


def test_an_open_page_reports_that_a_swarm_has_ended_without_any_data(browser: Page) -> None:
    """The swarm ends after the page has been opened, and no state has been added."""
    history_without_states = History(RunDescription("one robot", [0]))
    with serve_page(history_without_states) as url:
        browser.goto(url)
        history_without_states.has_ended = True
        wait_for_text(browser, "state", "the run has ended")
        assert text_of(browser, "waiting") == "the run has ended without any data"


def test_a_swarm_that_has_just_ended_is_shown_at_its_last_step(browser: Page, history: History) -> None:
    """So the user does not have to watch it from the start; the button offers to play it."""
    all_states = history.states_since().states
    ended_history = History(history.description, all_states)
    assert ended_history.has_ended
    with serve_page(ended_history) as url:
        browser.goto(url)
        wait_for_text(browser, "clock", "step 300 of 300")
        assert text_of(browser, "play") == "▶ play"


def make_state_of_one_robot(tick: int) -> State:
    """Return a state of a single robot, all of whose values are 0.5."""
    return State(tick, np.full((4, 1), 0.5), NO_LINKS, positions=None)


def test_the_page_of_a_silent_bus_waits_until_a_robot_sends(browser: Page) -> None:
    """It shows "waiting for the bus", which disappears when robot 5 has joined with a state."""
    history_of_bus = History(RunDescription("a bus", robots=[]))
    with serve_page(history_of_bus) as url:
        browser.goto(url)
        wait_for_text(browser, "waiting", "waiting for the bus")
        history_of_bus.add_robot(5)
        history_of_bus.add(make_state_of_one_robot(tick=1))
        until(browser, "view.history.stateCount === 1 && document.getElementById('waiting').hidden")


def roster_of_two_robots() -> Roster:
    """Return a roster of two robots. An estimate and a heartbeat came from robot 9 at 0 s, from 5 at 9 s."""
    roster = Roster()
    for robot, now in ((9, 0.0), (5, 9.0)):
        roster.receive(can.Message(), Estimate(robot, x_hat=0, alpha=0, transfer_id=3), now)
        heartbeat = Heartbeat(robot, uptime=60, transfer_id=4, health=Health.WARNING)
        roster.receive(can.Message(), heartbeat, now)
    return roster


@pytest.fixture
def bus_browser(browser: Page) -> Iterator[Page]:
    """The web page of a bus at 10 s with two robots, 9 and 5, which each sent two frames.

    The page was opened when only robot 5 had sent values.
    """
    history_of_bus = History(RunDescription("a bus", [5]))
    history_of_bus.add(make_state_of_one_robot(tick=1))
    with serve_page(history_of_bus) as url:
        browser.goto(url)
        until(browser, f"{IS_DRAWN} && view.history.robotCount === 1")
        history_of_bus.add_robot(9)
        history_of_bus.report = roster_of_two_robots().report(now=10.0)
        until(browser, "document.querySelectorAll('#roster tbody tr').length === 2")
        yield browser


def test_a_robot_that_joins_a_bus_has_no_values_before(bus_browser: Page) -> None:
    """Robot 9 joins robot 5, of which there is one state so far.

    The values of robot 9 in that state are unknown, which is NaN in the scripts of the web page.
    """
    until(bus_browser, "view.history.robotCount === 2 && view.history.stateCount === 1")
    index_of_robot_9, first_state = 1, 0
    assert bus_browser.evaluate(f"Number.isNaN(view.history.value('x', {index_of_robot_9}, {first_state}))")


def test_the_table_of_robots_has_a_row_for_each_robot_of_a_bus(bus_browser: Page) -> None:
    """A row has id, time since the last frame, health, mode, frames a second and loss.

    Then come conflicts, x, b_hat, its updates, and jumps; x, b_hat and its updates are unknown (a dash).
    Robot 5 sent its last frame one second ago, and robot 9 ten seconds ago.
    """
    texts_of_rows = bus_browser.locator("#roster tbody tr").all_inner_texts()
    rows_with_single_spaces = [" ".join(text.split()) for text in texts_of_rows]
    assert rows_with_single_spaces == [
        "5 1.0 s warning operational 1.0/s 0.0 % 0 – – – 0",  # noqa: RUF001
        "9 10.0 s warning operational 0.0/s 0.0 % 0 – – – 0",  # noqa: RUF001
    ]


def test_the_button_in_a_row_of_the_table_selects_its_robot(bus_browser: Page) -> None:
    """The second of two rows shows robot 9. The page follows the robot that is selected, by its index."""
    until(bus_browser, "view.history.robotCount === 2")
    bus_browser.locator("#roster button").last.press("Enter")
    assert bus_browser.evaluate("view.history.description.robots[view.followedRobot]") == 9


def frames_listed_in(browser: Page) -> list[str]:
    """Return the lines of the list of frames, without the spaces around them."""
    text = browser.evaluate("document.getElementById('frames').textContent")
    return [line.strip() for line in text.splitlines()]


def test_the_list_of_frames_begins_with_the_latest(bus_browser: Page) -> None:
    """Robot 5 sent an estimate and then a heartbeat at 9 s, and robot 9 did so at 0 s."""
    assert frames_listed_in(bus_browser) == [
        "9.000 s  5  heartbeat 4: warning, operational, up 60 s",
        "9.000 s  5  estimate 3: x_hat 0.0000, alpha 0",
        "0.000 s  9  heartbeat 4: warning, operational, up 60 s",
        "0.000 s  9  estimate 3: x_hat 0.0000, alpha 0",
    ]


def test_words_typed_as_a_filter_leave_the_frames_that_have_all_of_them(bus_browser: Page) -> None:
    """Robots 9 and 5 have two frames each on the page. "9 heartbeat" leaves the heartbeat of robot 9."""
    bus_browser.locator("#filter").fill("9 heartbeat")
    assert frames_listed_in(bus_browser) == ["0.000 s  9  heartbeat 4: warning, operational, up 60 s"]
