"""The playground of the documentation in a real browser: it computes what the commands of this project do."""

from __future__ import annotations

import argparse
import re
import runpy
import shlex
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING
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


def test_the_page_that_shows_a_run_has_nothing_of_the_playground() -> None:
    text = make_page()
    assert "playground" not in text
    assert "wasm" not in text.partition("<style>")[0]


def test_only_the_playground_may_compile_and_start_a_worker() -> None:
    """The policy in a page's head says what its scripts may do; the page that shows a run needs neither."""
    build_page = runpy.run_path(str(ROOT / ".ci/playground.py"))["build_page"]

    playground = build_page(b"\0asm")

    assert "script-src 'unsafe-inline' data: 'wasm-unsafe-eval'; worker-src data:;" in playground
    assert "worker-src" not in make_page().partition("<style>")[0]


def test_the_page_of_the_playground_holds_its_compiled_program() -> None:
    """So it works as a single file. WebAssembly begins with the bytes 0asm, which are AGFzbQ== in base 64."""
    build_page = runpy.run_path(str(ROOT / ".ci/playground.py"))["build_page"]

    playground = build_page(b"\0asm")

    assert '<script id="history" type="application/json">{"module": "AGFzbQ=="}</script>' in playground


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


@pytest.mark.slow
@pytest.mark.parametrize("address", ADDRESSES)
def test_the_playground_computes_and_draws_what_the_command_below_it_computes(
    browser: Page, playground: Path, address: str
) -> None:
    """To the last bit in what it computes, and to 16 bits in what it draws.

    The page shows a command with the same settings; here the engine that this command uses computes its
    experiment.
    """
    open_playground(browser, playground, address)
    [experiment] = experiments_of(parse_command(browser))
    records = native_records(experiment)

    assert np.array_equal(read_records(browser), records)
    check_last_values(browser, experiment, records[-experiment.robots :])
    check_last_positions(browser, experiment)
    check_final_errors(browser)
    for index, filter_name in enumerate(FILTERS):
        check_errors(browser, index, experiment, filter_name)


def native_records(experiment: Experiment) -> NDArray[np.uint32]:
    """Return the records of the first trial by the native engine, as ``read_records`` does."""
    records = native.run(experiment, 0, 1, 1).records.view(np.uint32).reshape(-1, WORDS_PER_RECORD).copy()
    records[:, PADDING_WORD] = 0
    return records


def check_last_values(browser: Page, experiment: Experiment, last_records: NDArray[np.uint32]) -> None:
    """Check what a page draws of x_hat, x and b_hat at the end, to the precision of its 16 bits."""
    shown = browser.evaluate(
        "['x_hat', 'x', 'b_hat'].map((name) => view.history.description.robots.map((_, robot) => "
        f"view.history.value(name, robot, view.history.stateAt({experiment.steps}))))"
    )
    expected = last_records[:, [X_HAT_WORD, X_WORD, B_HAT_WORD]] / [2.0**23, 2.0**23, 2.0**32]
    assert np.abs(np.array(shown).T - expected).max() <= 1 / 65534


def check_final_errors(browser: Page) -> None:
    """Check that the page writes the middle one of the errors so far at the end of each filter's trials."""
    errors_and_texts = browser.evaluate(
        "view.playground.comparison.filters.map(({ trials }, index) => "
        "[trials.map((errors) => errors.at(-1)), "
        "document.querySelectorAll('#filters output')[index].textContent])"
    )
    for errors, text in errors_and_texts:
        assert text == f"{100 * sorted(errors)[len(errors) // 2]:.1f}"


def check_last_positions(browser: Page, experiment: Experiment) -> None:
    """Check where the robots of a page are at the end, if they move, to the precision of its 16 bits."""
    if not experiment.is_dynamic:
        return
    motion = Arena(experiment, 0).record(experiment.steps)
    position = f"view.history.position(robot, {experiment.steps})"
    positions = browser.evaluate(f"view.history.description.robots.map((_, robot) => {position})")
    assert np.abs(positions - motion.position[-1]).max() <= max(experiment.sides) / 65534


def check_errors(browser: Page, filter_index: int, experiment: Experiment, filter_name: str) -> None:
    """Check a page's errors of a filter in the first two trials, which are means of 8 steps each."""
    filtered = Experiment(**experiment.parameters() | {"filter": filter_name})
    x = native.run(filtered, 0, 2).x / 2.0**23
    errors = abs(x - experiment.fill_ratio).mean(axis=1)
    errors_by_step = np.broadcast_to(errors, (2, experiment.steps + 1))  # alike if all robots have one x
    trials = f"view.playground.comparison.filters[{filter_index}].trials.slice(0, 2)"
    shown = np.array(browser.evaluate(f"{trials}.map((errors) => [...errors])"))
    blocks = errors_by_step[:, : 8 * shown.shape[1]].reshape(*shown.shape, 8)
    assert np.abs(shown - blocks.mean(axis=2)).max() < 1e-12


@pytest.mark.slow
@pytest.mark.parametrize("topology", ["everybody=1", "density=4"])
@pytest.mark.parametrize("filter_name", ["asdf-plus", "robust"])
def test_liars_lie_in_the_playground_as_in_a_swarm_on_an_emulated_bus(
    browser: Page, playground: Path, topology: str, filter_name: str
) -> None:
    """All nine robots end with the same estimate of their own, x_hat, and believe the same, x.

    The swarm has the settings of the command that the page shows.
    """
    address = f"{topology}&robots=9&liars=2&flawed=35&steps=60&filter={filter_name}"
    open_playground(browser, playground, address)
    last_records = read_records(browser)[-9:]

    settings = swarm_command.settings_of(parse_command(browser))
    with Swarm(settings, Wiring()) as swarm:
        run_swarm(swarm, [])
        robots = [node.robot for node in swarm.nodes]

    assert [robot.x_hat for robot in robots] == (last_records[:, X_HAT_WORD] / 2**23).tolist()
    assert [robot.x for robot in robots] == (last_records[:, X_WORD] / 2**23).tolist()


# --- Controls -----------------------------------------------------------------------------------------


@pytest.fixture
def small_browser(chromium: Browser, playground: Path) -> Iterator[Page]:
    """The playground with few steps, in a browser as narrow as a telephone."""
    with new_page(chromium, 390, 844) as browser:
        open_playground(browser, playground, "flawed=20&filter=robust&steps=100")
        yield browser


@pytest.mark.slow
def test_the_playground_has_the_settings_of_its_address(small_browser: Page) -> None:
    """It was opened with #flawed=20&filter=robust&steps=100."""
    settings = small_browser.evaluate("view.playground.settings")
    assert settings["flawed"] == 20
    assert settings["filter"] == "robust"
    assert settings["steps"] == 100


@pytest.mark.slow
def test_another_address_runs_the_playground_with_other_settings(small_browser: Page) -> None:
    small_browser.evaluate("location.hash = '#steps=40&robots=4'")
    until(small_browser, f"view.history.robotCount === 4 && {HAS_TWO_TRIALS}")


@pytest.mark.slow
def test_settings_of_an_address_that_are_impossible_have_their_defaults(small_browser: Page) -> None:
    small_browser.evaluate("location.hash = '#density=nonsense&robots=500&filter=best'")
    until(small_browser, "view.playground.settings.filter === 'asdf-minus'")

    settings = small_browser.evaluate("view.playground.settings")

    assert settings["density"] == 1
    assert settings["robots"] == 20


@pytest.mark.slow
def test_a_slider_changes_the_address_and_the_command_that_is_shown(small_browser: Page) -> None:
    """The slider of the liars moves from none to one. The page then also says that one robot lies."""
    small_browser.locator("#more").click()
    small_browser.locator("[name=liars]").focus()

    small_browser.keyboard.press("ArrowRight")

    until(small_browser, "location.hash.includes('liars=1')")
    assert "--fault liar,robots=19-19,x=0,alpha=1e6" in small_browser.evaluate(COMMAND)
    assert small_browser.locator("#liars").is_visible()


@pytest.mark.slow
def test_the_space_bar_on_a_slider_does_not_pause(small_browser: Page) -> None:
    """Elsewhere it does."""
    until(small_browser, "view.history !== null")
    small_browser.locator("#more").click()
    small_browser.evaluate("view.player.isPlaying = true")

    small_browser.locator("[name=liars]").press("Space")

    assert small_browser.evaluate("view.player.isPlaying")


@pytest.mark.slow
def test_an_example_that_is_chosen_is_marked_and_has_a_story(small_browser: Page) -> None:
    """A story is a text that ends with a full stop."""
    for index, button in enumerate(small_browser.locator("#presets button").all()):
        button.press("Enter")

        until(small_browser, f"document.querySelectorAll('#presets button')[{index}].ariaPressed === 'true'")
        assert small_browser.locator("#story").inner_text().endswith(".")


@pytest.mark.slow
def test_another_filter_can_be_shown(small_browser: Page) -> None:
    small_browser.locator("[name=filter][value=none]").check()
    until(small_browser, "view.history.description.title.endsWith('no filter')")
    until(small_browser, "location.hash.includes('filter=none')")


@pytest.mark.slow
@pytest.mark.parametrize(("width", "height"), [(1400, 900), (800, 600), (390, 844)])
@pytest.mark.parametrize("is_open", [False, True], ids=["closed", "open"])
def test_floor_figures_and_controls_fit_on_a_screen(
    chromium: Browser, playground: Path, width: int, height: int, is_open: bool
) -> None:
    """The screens are those of a computer, a tablet and a phone. Further settings are closed or open."""
    parts_of_page = ["#about", "#beliefs", "#arena"]
    controls = ["#play", "#miscalibrate", "#add-liar", "#more", "#time"]
    settings = ["#settings"] if is_open else []
    with new_page(chromium, width, height) as browser:
        open_playground(browser, playground, "liars=1&steps=100")
        if is_open:
            browser.locator("#more").click()

        assert browser.evaluate("document.documentElement.scrollWidth") <= width
        for name in [*parts_of_page, *controls, *settings]:
            box = browser.locator(name).bounding_box()
            assert box is not None, name
            assert min(box["width"], box["height"]) > 10, name
            assert box["y"] + box["height"] <= height, name


@pytest.mark.slow
def test_the_first_line_says_how_many_robots_are_flawed_or_lie(small_browser: Page) -> None:
    """Four are flawed at first; the buttons make two more so, add a liar, and start over."""
    text = "document.getElementById('about').textContent"
    assert small_browser.evaluate(text).startswith("Each robot guesses the share of black tiles. 4 of them")

    small_browser.locator("#miscalibrate").click()
    until(small_browser, f"{text}.includes('6 of them misjudge their sensor (orange).')")
    small_browser.locator("#add-liar").click()
    until(small_browser, f"{text}.includes('One claims that no tile is black.')")
    small_browser.locator("#start-over").click()
    until(small_browser, f"{text}.includes('Half of them')")


@pytest.mark.slow
def test_a_run_that_has_ended_starts_again_with_other_settings(small_browser: Page) -> None:
    small_browser.evaluate("view.player.seek(view.player.end)")
    small_browser.evaluate("location.hash = '#steps=100&robots=4'")
    until(small_browser, "view.history.robotCount === 4 && view.player.isPlaying")


FIRST_RESULT = "([...document.querySelectorAll('#beliefs .result')[0].children])"
"""The first filter's large figure: its title, its error and a note that says of how many runs it is."""


@pytest.mark.slow
def test_a_large_figure_is_grey_until_all_30_runs_are_in(browser: Page, playground: Path) -> None:
    """If the browser is quick all are in when the test looks."""
    open_playground(browser, playground, "steps=3000")
    class_and_note = f"(([title, error, note]) => [error.className, note.textContent]){FIRST_RESULT}"

    class_name, note = browser.evaluate(class_and_note)

    if note != "points, 30 runs":
        assert class_name == "unfinished"
        assert re.fullmatch(r"points, \d+ of 30 runs", note)
    until(browser, f"{class_and_note}.join() === ',points, 30 runs'")


@pytest.mark.slow
def test_a_large_figure_is_the_median_error_of_30_runs_in_percent(browser: Page, playground: Path) -> None:
    open_playground(browser, playground, "steps=3000")
    until(browser, f"{FIRST_RESULT}[2].textContent === 'points, 30 runs'")

    text = browser.evaluate(f"{FIRST_RESULT}[1].textContent")

    errors = browser.evaluate("view.playground.comparison.filters[0].trials.map((errors) => errors.at(-1))")
    assert len(errors) == 30
    upper_median = sorted(errors)[30 // 2]
    assert text == f"off by {100 * upper_median:.1f}"


@pytest.mark.slow
def test_the_swarm_believes_the_mean_of_its_20_robots_in_percent(small_browser: Page) -> None:
    small_browser.evaluate("view.player.seek(100)")
    beliefs = "view.history.description.robots.map((_, robot) => view.history.value('x', robot, 100))"
    percent = f"Math.round(100 / 20 * {beliefs}.reduce((sum, value) => sum + value))"
    until(small_browser, f"document.getElementById('belief').textContent === `${{{percent}}} %`")


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
    assert framed.inner.evaluate("view.history.robotCount") == 5


@pytest.mark.slow
def test_the_address_of_the_outer_page_follows_the_settings_of_a_framed_playground(framed: Framed) -> None:
    framed.inner.locator("#more").click()
    framed.inner.locator("[name=everybody]").check()

    until(framed.outer, "location.hash === '#robots=5&everybody=1&steps=40'")
    assert framed.outer.evaluate("document.getElementById('playground').offsetHeight") > 300


@pytest.mark.slow
def test_a_framed_playground_is_as_high_as_the_outer_page_s_window(framed: Framed) -> None:
    """Below the page's margin of 8 pixels: 800 - 8 at first."""
    height = "document.documentElement.style.getPropertyValue('--screen')"
    until(framed.inner, f"{height} === '792px'")

    framed.outer.set_viewport_size({"width": 800, "height": 590})

    until(framed.inner, f"{height} === '590px'")


@pytest.mark.slow
def test_a_framed_playground_has_the_colours_of_the_outer_page(framed: Framed) -> None:
    background = "getComputedStyle(document.body).backgroundColor"
    dark, light = "rgb(16, 20, 26)", "rgb(246, 247, 249)"
    until(framed.inner, f"{background} === '{dark}'")

    framed.outer.evaluate("document.body.dataset.mdColorScheme = 'default'")

    until(framed.inner, f"{background} === '{light}'")
