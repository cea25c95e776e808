"""The playground of the documentation in a real browser: it computes what the commands of this project do."""

from __future__ import annotations

import argparse
import re
import runpy
import shlex
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple
from uuid import uuid4

import numpy as np
import pytest
from numpy.typing import NDArray

from browser import new_page, until
from mcp_asdf_tools.cli import main as cli
from mcp_asdf_tools.cli import swarm as swarm_command
from mcp_asdf_tools.cli.options import experiments_of
from mcp_asdf_tools.experiments.engine import native
from mcp_asdf_tools.experiments.experiment import Experiment
from mcp_asdf_tools.swarm.carrier import Wiring
from mcp_asdf_tools.swarm.run import run_swarm
from mcp_asdf_tools.swarm.swarm import Swarm
from mcp_asdf_tools.view.page import make_page
from mcp_asdf_tools.world.arena import Arena
from support import ROOT, require, run

if TYPE_CHECKING:
    from playwright.sync_api import Browser, Frame, Page

FILTERS = ("none", "asdf-minus", "asdf-plus", "robust")
HAS_TWO_TRIALS = """window.view?.playground?.comparison.filters.every(
    ({ trials }) => trials.length >= 2 && trials[0])"""
COMMAND = "document.querySelector('#command code').textContent"
RECORDS = "Array.from(view.playground.records)"
"""These three are expressions of JavaScript, which the web page evaluates."""
WORDS_PER_RECORD = 10
X_HAT_WORD, X_WORD, B_HAT_WORD, PADDING_WORD = 4, 7, 8, 9
"""Words of ``mcp_asdf_record_t``, what the engine records of a robot in a step."""


@pytest.fixture(scope="module")
def playground(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The page of the playground, as a file."""
    for tool in ("clang", "wasm-ld"):
        require(tool, "clang lld")
    file = tmp_path_factory.mktemp("playground") / "play.html"
    run("python", ".ci/playground.py", file)
    return file


def open_playground(browser: Page, playground: Path, address: str) -> None:
    """Open the page with the settings of an address, and wait until two trials of all filters have run."""
    browser.goto(f"{playground.as_uri()}#{address}")
    until(browser, HAS_TWO_TRIALS)


def parse_command(browser: Page) -> argparse.Namespace:
    """Return the options of the command that the page shows, as that command's parser reads them."""
    _, command, *options = shlex.split(str(browser.evaluate(COMMAND)))
    return cli._parser_for(command, cli._load(command)).parse_args(options)


def read_records(browser: Page) -> NDArray[np.uint32]:
    """Return the words of the page's records, shape (records, words), with 0 for padding."""
    records = np.array(browser.evaluate(RECORDS), np.uint32).reshape(-1, WORDS_PER_RECORD)
    records[:, PADDING_WORD] = 0
    return records


# --- The page without a browser -----------------------------------------------------------------------


def build_playground(program: bytes) -> str:
    """Return the page of the playground with a program in WebAssembly."""
    script = runpy.run_path(str(ROOT / ".ci/playground.py"))
    page: str = script["build_page"](program)
    return page


def head_of(page: str) -> str:
    """Return the beginning of a page, which states what its scripts may do, up to its styles."""
    head, _, _ = page.partition("<style>")
    return head


def test_the_page_of_mcp_asdf_view_contains_nothing_of_the_playground() -> None:
    """The two pages have scripts in common, but those of the playground are left out.

    Nor does the policy in the head of the page allow scripts to compile WebAssembly or to start workers.
    """
    page = make_page()
    assert "playground" not in page
    assert "wasm" not in head_of(page)
    assert "worker-src" not in head_of(page)


def test_the_playground_may_compile_webassembly_and_start_a_worker() -> None:
    """The policy in the head of a page states what its scripts may do."""
    policy = "script-src 'unsafe-inline' data: 'wasm-unsafe-eval'; worker-src data:;"
    assert policy in head_of(build_playground(b"\0asm"))


def test_the_playground_is_a_single_file_with_its_compiled_program_in_it() -> None:
    """A program in WebAssembly begins with the bytes 0asm, which are AGFzbQ== in base 64."""
    page = build_playground(b"\0asm")
    assert '<script id="history" type="application/json">{"module": "AGFzbQ=="}</script>' in page


# --- Bits ---------------------------------------------------------------------------------------------


ADDRESSES = (
    "seed=7&steps=1000",
    "filter=asdf-plus&robots=9&flawed=35&density=4&fill=0.3&steps=1000",
    "filter=robust&robots=127&density=9.8&wrong=0.05&accuracy=0.9&steps=60",
    "everybody=1&filter=robust&robots=9&steps=1000&accuracy=1&fill=1&wrong=0.99",
    "everybody=1&filter=asdf-minus&robots=20&steps=1000",
    "everybody=1&filter=none&robots=2&steps=50",
)
"""Settings of the playground, as they stand in its address."""


class Computed(NamedTuple):
    """A page of the playground, the experiment of the command that it shows, and what the command computes.

    Attributes:
        page: The page, when it has computed two trials of all filters.
        experiment: The experiment of the command, which has the page's settings.
        records: All that the native engine records of its first trial.
    """

    page: Page
    experiment: Experiment
    records: NDArray[np.uint32]

    @property
    def last_records(self) -> NDArray[np.uint32]:
        """The records of all robots after the last step."""
        return self.records[-self.experiment.robots :]


@pytest.fixture(scope="module", params=ADDRESSES)
def computed(request: pytest.FixtureRequest, chromium: Browser, playground: Path) -> Iterator[Computed]:
    with new_page(chromium) as page:
        open_playground(page, playground, request.param)
        [experiment] = experiments_of(parse_command(page))
        yield Computed(page, experiment, native_records(experiment))


def native_records(experiment: Experiment) -> NDArray[np.uint32]:
    """Return the records of the first trial by the native engine, as ``read_records`` does."""
    native_trial = native.run(experiment, first=0, trials=1, sampling_interval=1)
    records = native_trial.records.view(np.uint32).reshape(-1, WORDS_PER_RECORD).copy()
    records[:, PADDING_WORD] = 0
    return records


@pytest.mark.slow
def test_the_playground_computes_the_command_that_it_shows_to_the_last_bit(computed: Computed) -> None:
    """The page shows a command ``mcp-asdf simulate`` with its settings. Its engine computes the same here.

    Records are integers of each robot in each step of the first trial.
    """
    records_of_page = read_records(computed.page)
    assert np.array_equal(records_of_page, computed.records)


def read_drawn_values(page: Page, name: str, step: int) -> Any:
    """Return the values of all robots that the page draws at a step."""
    return page.evaluate(
        "view.history.description.robots.map((_, robot) => "
        f"view.history.value('{name}', robot, view.history.stateAt({step})))"
    )


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "word", "one"),
    [("x_hat", X_HAT_WORD, 2**23), ("x", X_WORD, 2**23), ("b_hat", B_HAT_WORD, 2**32)],
)
def test_the_playground_draws_the_computed_values_of_the_last_step(
    computed: Computed, name: str, word: int, one: int
) -> None:
    """The values are compared with the last records of the native engine, a row of words for each robot.

    ``word`` is the column of the value there, where ``one`` stands for 1. The page keeps a value from 0 to 1
    as a whole number from 0 to 65534.
    """
    drawn_values = read_drawn_values(computed.page, name, step=computed.experiment.steps)
    computed_values = computed.last_records[:, word] / one
    errors = np.abs(drawn_values - computed_values)
    assert errors.max() <= 1 / 65534


@pytest.mark.slow
@pytest.mark.parametrize(
    "computed", [address for address in ADDRESSES if "everybody=1" not in address], indirect=True
)
def test_the_playground_draws_robots_where_they_are_in_the_arena_after_the_last_step(
    computed: Computed,
) -> None:
    """The page rounds a position to a 65534th of the arena's side.

    In its other swarms everybody receives from everybody: there are no positions, as nobody moves.
    """
    experiment = computed.experiment
    first_trial = 0
    *_, last_positions = Arena(experiment, first_trial).record(experiment.steps).position
    drawn_positions = computed.page.evaluate(
        f"view.history.description.robots.map((_, robot) => view.history.position(robot, {experiment.steps}))"
    )
    errors = np.abs(drawn_positions - last_positions)
    longer_side = max(experiment.sides)
    assert errors.max() <= longer_side / 65534


@pytest.mark.slow
def test_the_playground_writes_the_median_of_each_filter_s_final_errors_in_percent(
    computed: Computed,
) -> None:
    """It has computed some of 30 trials of each of four filters.

    Of an even number of errors, the larger of the two in the middle is taken for the median.
    """
    # Both are read at once, as the page goes on computing.
    errors_by_filter, texts = computed.page.evaluate(
        "["
        "  view.playground.comparison.filters.map(({ trials }) => trials.map((errors) => errors.at(-1))),"
        "  [...document.querySelectorAll('#filters output')].map(({ textContent }) => textContent),"
        "]"
    )
    assert len(texts) == 4
    for errors, text in zip(errors_by_filter, texts, strict=True):
        upper_median = sorted(errors)[len(errors) // 2]
        assert text == f"{100 * upper_median:.1f}"


def native_errors(experiment: Experiment, filter_name: str) -> Any:
    """Return the mean error of all robots in each step of two trials, computed by the native engine."""
    with_filter = Experiment(**experiment.parameters() | {"filter": filter_name})
    x = native.run(with_filter, first=0, trials=2).x / 2.0**23  # by trial, robot and step
    errors = abs(x - experiment.fill_ratio).mean(axis=1)
    return np.broadcast_to(errors, (2, experiment.steps + 1))  # alike if all robots have one x


@pytest.mark.slow
@pytest.mark.parametrize(("index", "filter_name"), [*enumerate(FILTERS)])
def test_a_point_of_the_chart_of_errors_is_the_mean_error_of_eight_steps(
    computed: Computed, index: int, filter_name: str
) -> None:
    """The first two trials of each filter are compared with the same trials of the native engine.

    ``index`` is the filter's place on the page. Steps that fill no point of eight at the end are left out.
    """
    trials = f"view.playground.comparison.filters[{index}].trials.slice(0, 2)"
    points = np.array(computed.page.evaluate(f"{trials}.map((errors) => [...errors])"))  # by trial and point
    trial_count, point_count = points.shape
    errors_by_step = native_errors(computed.experiment, filter_name)  # by trial and step
    errors_in_points = errors_by_step[:, : 8 * point_count].reshape(trial_count, point_count, 8)
    expected_points = errors_in_points.mean(axis=2)

    assert trial_count == 2
    assert np.abs(points - expected_points).max() < 1e-12


def final_estimates_on_page(browser: Page, robots: int) -> list[tuple[float, float]]:
    """Return x_hat and x of each robot of the page after the last step."""
    last_records = read_records(browser)[-robots:]
    return [(record[X_HAT_WORD] / 2**23, record[X_WORD] / 2**23) for record in last_records]


@pytest.mark.slow
@pytest.mark.parametrize("topology", ["everybody=1", "density=4"])
@pytest.mark.parametrize("filter_name", ["asdf-plus", "robust"])
def test_nine_robots_with_two_liars_end_in_the_playground_as_in_a_swarm_on_an_emulated_bus(
    browser: Page, playground: Path, topology: str, filter_name: str
) -> None:
    """The swarm has the settings of the command that the page shows.

    Robots are compared by their own estimate, x_hat, and by the one with those of others, x.
    """
    address = f"{topology}&robots=9&liars=2&flawed=35&steps=60&filter={filter_name}"
    open_playground(browser, playground, address)

    settings = swarm_command.settings_of(parse_command(browser))
    with Swarm(settings, Wiring()) as swarm:
        run_swarm(swarm)
        robots = [node.robot for node in swarm.nodes]

    estimates_in_swarm = [(robot.x_hat, robot.x) for robot in robots]
    assert estimates_in_swarm == final_estimates_on_page(browser, robots=9)


# --- Controls -----------------------------------------------------------------------------------------


@pytest.fixture
def small_browser(chromium: Browser, playground: Path) -> Iterator[Page]:
    """The playground with few steps, in a browser as narrow as a telephone."""
    with new_page(chromium, 390, 844) as browser:
        open_playground(browser, playground, "flawed=20&filter=robust&steps=100")
        yield browser


@pytest.mark.slow
def test_the_playground_opens_with_the_settings_in_its_address(small_browser: Page) -> None:
    """The address ends with #flawed=20&filter=robust&steps=100."""
    settings = small_browser.evaluate("view.playground.settings")
    assert settings["flawed"] == 20
    assert settings["filter"] == "robust"
    assert settings["steps"] == 100


@pytest.mark.slow
def test_a_change_of_the_address_runs_a_swarm_with_the_new_settings(small_browser: Page) -> None:
    """The new swarm has four robots, and is run for 40 steps with each filter. ``until`` waits for it."""
    small_browser.evaluate("location.hash = '#steps=40&robots=4'")

    until(small_browser, f"view.history.robotCount === 4 && {HAS_TWO_TRIALS}")


@pytest.mark.slow
def test_a_slider_changes_the_address_and_the_command_that_is_shown(small_browser: Page) -> None:
    """The slider of the liars moves from none to one. The page then also says that one robot lies."""
    small_browser.locator("#more").click()
    small_browser.locator("[name=liars]").focus()

    small_browser.keyboard.press("ArrowRight")

    until(small_browser, "location.hash.includes('liars=1')")
    last_of_20_robots_lies = "--fault liar,robots=19-19,x=0,alpha=1e6"
    assert last_of_20_robots_lies in small_browser.evaluate(COMMAND)
    assert small_browser.locator("#liars").is_visible(), "the sentence about the liar"


@pytest.mark.slow
def test_the_space_bar_does_not_pause_the_swarm_while_a_slider_has_the_focus(small_browser: Page) -> None:
    """The space bar is pressed at the slider of the liars, and the swarm goes on playing."""
    until(small_browser, "view.history !== null")
    small_browser.locator("#more").click()
    small_browser.evaluate("view.player.isPlaying = true")

    small_browser.locator("[name=liars]").press("Space")

    assert small_browser.evaluate("view.player.isPlaying")


@pytest.mark.slow
def test_each_button_of_an_example_is_marked_when_it_is_pressed_and_shows_sentences_about_it(
    small_browser: Page,
) -> None:
    """A button sets up a swarm, such as one with liars. The sentences below it end with a full stop."""
    for index, button in enumerate(small_browser.locator("#presets button").all()):
        button.press("Enter")

        until(small_browser, f"document.querySelectorAll('#presets button')[{index}].ariaPressed === 'true'")
        assert small_browser.locator("#story").inner_text().endswith(".")


@pytest.mark.slow
def test_a_filter_that_is_chosen_on_the_page_stands_in_the_title_and_in_the_address(
    small_browser: Page,
) -> None:
    """The page was opened with the robust filter. The setting "no filter" is chosen on it.

    ``until`` waits, and fails if it takes too long.
    """
    small_browser.locator("[name=filter][value=none]").check()

    until(small_browser, "view.history.description.title.endsWith('no filter')")
    until(small_browser, "location.hash.includes('filter=none')")


@pytest.mark.slow
@pytest.mark.parametrize(("width", "height"), [(1400, 900), (800, 600), (390, 844)])
@pytest.mark.parametrize("is_open", [False, True], ids=["closed", "open"])
def test_floor_figures_and_buttons_fit_on_the_screen_of_a_computer_a_tablet_and_a_phone(
    chromium: Browser, playground: Path, width: int, height: int, is_open: bool
) -> None:
    """Nobody has to scroll, whether further settings are closed or open.

    Each element has a box of more than 10 pixels, so it is there, that ends above the lower edge.
    """
    names = ["#about", "#beliefs", "#arena", "#play", "#miscalibrate", "#add-liar", "#more", "#time"]
    with new_page(chromium, width, height) as browser:
        open_playground(browser, playground, "liars=1&steps=100")
        if is_open:
            browser.locator("#more").click()
            names.append("#settings")

        assert browser.evaluate("document.documentElement.scrollWidth") <= width
        for name in names:
            box = browser.locator(name).bounding_box()
            assert box is not None, name
            assert min(box["width"], box["height"]) > 10, name
            assert box["y"] + box["height"] <= height, name


INTRODUCTION = "document.getElementById('about').textContent"


@pytest.mark.slow
def test_the_introduction_has_how_many_of_20_robots_misjudge_their_sensors(small_browser: Page) -> None:
    """Four do on this page, which is 20 % of 20 robots; a button lets a tenth more of the robots do so.

    Another button starts over with the settings that a reader first sees, in which half of the robots do.
    """
    text = small_browser.evaluate(INTRODUCTION)
    assert text.startswith("Each robot guesses the share of black tiles. 4 of them")

    small_browser.locator("#miscalibrate").click()
    until(small_browser, f"{INTRODUCTION}.includes('6 of them misjudge their sensor (orange).')")

    small_browser.locator("#start-over").click()
    until(small_browser, f"{INTRODUCTION}.includes('Half of them')")


@pytest.mark.slow
def test_the_introduction_says_that_a_robot_lies_when_the_button_has_added_a_liar(
    small_browser: Page,
) -> None:
    """A liar is a robot that always claims that no tile is black."""
    small_browser.locator("#add-liar").click()
    until(small_browser, f"{INTRODUCTION}.includes('One claims that no tile is black.')")


@pytest.mark.slow
def test_a_swarm_that_was_played_to_its_end_plays_from_the_start_when_settings_change(
    small_browser: Page,
) -> None:
    """The address is changed while the last step is shown. The swarm with four robots then plays."""
    small_browser.evaluate("view.player.seek(view.player.end)")

    small_browser.evaluate("location.hash = '#steps=100&robots=4'")

    until(small_browser, "view.history.robotCount === 4 && view.player.isPlaying")


ERROR_OF_FIRST_RESULT = "document.querySelector('#beliefs .result').children[1]"
NOTE_OF_FIRST_RESULT = "document.querySelector('#beliefs .result').children[2]"
"""Parts of the first filter's result in large figures: the error, and a note of how many trials it is."""


@pytest.mark.slow
def test_the_error_in_large_figures_is_grey_until_all_30_trials_have_been_computed(
    browser: Page, playground: Path
) -> None:
    """Beside the error stands a note of how many trials have been computed. Grey is the style "unfinished".

    If the browser is quick, all have been computed when the test looks for the first time.
    """
    open_playground(browser, playground, "steps=3000")
    style, note = browser.evaluate(f"[{ERROR_OF_FIRST_RESULT}.className, {NOTE_OF_FIRST_RESULT}.textContent]")
    if note != "points, 30 runs":
        assert style == "unfinished"
        assert re.fullmatch(r"points, \d+ of 30 runs", note)

    until(browser, f"{NOTE_OF_FIRST_RESULT}.textContent === 'points, 30 runs'")
    until(browser, f"{ERROR_OF_FIRST_RESULT}.className === ''")


@pytest.mark.slow
def test_the_large_figure_above_the_floor_is_the_mean_estimate_of_all_robots_in_percent(
    small_browser: Page,
) -> None:
    """The page is asked to show the estimates of the last step, 100. A robot's estimate is x."""
    estimates = read_drawn_values(small_browser, "x", step=100)
    percent = 100 * np.mean(estimates)

    small_browser.evaluate("view.player.seek(100)")

    until(small_browser, f"document.getElementById('belief').textContent === '{percent:.0f}\u00a0%'")


@dataclass(frozen=True)
class Framed:
    """A page of the docs that frames the playground, and the playground in it."""

    outer: Page
    inner: Frame


@pytest.fixture
def framed(browser: Page, playground: Path) -> Framed:
    """The framed playground with five robots and 40 steps, on a page with the docs' dark colours."""
    script = (ROOT / "docs/javascripts/playground.js").read_text(encoding="utf-8")
    index = playground.with_name(f"index_{uuid4()}.html")
    frame = f'<iframe id="playground"></iframe><script>{script}</script>'
    index.write_text(f'<body data-md-color-scheme="slate">{frame}</body>', encoding="utf-8")
    browser.goto(f"{index.as_uri()}#robots=5&steps=40")
    inner = browser.frames[-1]
    until(inner, HAS_TWO_TRIALS)
    return Framed(browser, inner)


@pytest.mark.slow
def test_a_framed_playground_has_the_settings_of_the_outer_address(framed: Framed) -> None:
    """A page of the documentation frames the playground, and its own address ends with #robots=5&steps=40."""
    assert framed.inner.evaluate("view.history.robotCount") == 5


@pytest.mark.slow
def test_settings_that_are_chosen_in_a_framed_playground_stand_in_the_outer_address(framed: Framed) -> None:
    """A page of the documentation frames the playground; here all robots are set to receive each other."""
    framed.inner.locator("#more").click()
    framed.inner.locator("[name=everybody]").check()
    until(framed.outer, "location.hash === '#robots=5&everybody=1&steps=40'")


@pytest.mark.slow
def test_the_frame_of_the_playground_is_higher_than_300_pixels_when_further_settings_are_open(
    framed: Framed,
) -> None:
    """A page of the documentation frames the playground, whose button "more" opens further settings."""
    framed.inner.locator("#more").click()
    until(framed.outer, "document.getElementById('playground').offsetHeight > 300")


HEIGHT_OF_SCREEN = "document.documentElement.style.getPropertyValue('--screen')"


@pytest.mark.slow
def test_a_framed_playground_fills_the_window_of_the_outer_page_below_the_text_above_it(
    framed: Framed,
) -> None:
    """The window is 800 pixels high, and above the frame is nothing but a margin of 8 pixels.

    The outer page tells the playground the height that is left, which it keeps in a variable of its style.
    """
    until(framed.inner, f"{HEIGHT_OF_SCREEN} === '792px'")


@pytest.mark.slow
def test_a_framed_playground_is_as_high_as_a_window_of_less_than_600_pixels(framed: Framed) -> None:
    """The window is 590 pixels high. A visitor has to scroll to the frame, and then sees nothing else."""
    framed.outer.set_viewport_size({"width": 800, "height": 590})
    until(framed.inner, f"{HEIGHT_OF_SCREEN} === '590px'")


@pytest.mark.slow
def test_a_framed_playground_becomes_light_when_the_outer_page_changes_from_dark_to_light(
    framed: Framed,
) -> None:
    """A page of the documentation frames it. Material for MkDocs calls its dark colours "slate"."""
    background = "getComputedStyle(document.body).backgroundColor"
    dark, light = "rgb(16, 20, 26)", "rgb(246, 247, 249)"
    until(framed.inner, f"{background} === '{dark}'")

    framed.outer.evaluate("document.body.dataset.mdColorScheme = 'default'")

    until(framed.inner, f"{background} === '{light}'")
