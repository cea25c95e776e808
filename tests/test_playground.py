"""The playground of the documentation in a real browser: it computes the bits of the native engine."""

from __future__ import annotations

import argparse
import re
import runpy
import shlex
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING

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
    from playwright.sync_api import Browser, Page

FILTERS = ("none", "asdf-minus", "asdf-plus", "robust")
HAS_TWO_TRIALS = """window.view?.playground?.comparison.filters.every(
    ({ trials }) => trials.length >= 2 && trials[0])"""
COMMAND = "document.querySelector('#command code').textContent"
RECORDS = "Array.from(view.playground.records)"
WORDS_PER_RECORD = 10
"""Of mcp_asdf_record_t: x_hat is word 4, x word 7, and word 9 is padding."""


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
    records[:, 9] = 0
    return records


# --- The page without a browser -----------------------------------------------------------------------


def test_the_page_of_a_run_has_nothing_of_the_playground() -> None:
    text = make_page()
    assert "playground" not in text
    assert "wasm" not in text.partition("<style>")[0]


def test_only_the_playground_may_compile_and_start_a_worker() -> None:
    build_page = runpy.run_path(str(ROOT / ".ci/playground.py"))["build_page"]
    text = build_page(b"\0asm")
    assert "script-src 'unsafe-inline' data: 'wasm-unsafe-eval'; worker-src data:;" in text
    assert "worker-src" not in make_page().partition("<style>")[0]


def test_the_page_of_the_playground_holds_its_module() -> None:
    build_page = runpy.run_path(str(ROOT / ".ci/playground.py"))["build_page"]
    assert '<script id="history" type="application/json">{"module": "AGFzbQ=="}</script>' in build_page(
        b"\0asm"
    )


# --- Bits ---------------------------------------------------------------------------------------------


@pytest.mark.slow
@pytest.mark.parametrize(
    "address",
    [
        "seed=7&steps=1000",
        "filter=asdf-plus&robots=9&flawed=35&density=4&fill=0.3&steps=1000",
        "filter=robust&robots=127&density=9.8&wrong=0.05&accuracy=0.9&steps=60",
        "everybody=1&filter=robust&robots=9&steps=1000&accuracy=1&fill=1&wrong=0.99",
        "everybody=1&filter=asdf-minus&robots=20&steps=1000",
        "everybody=1&filter=none&robots=2&steps=50",
    ],
)
def test_a_browser_computes_the_bits_of_the_command(browser: Page, playground: Path, address: str) -> None:
    open_playground(browser, playground, address)
    (experiment,) = experiments_of(parse_command(browser))
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
    records[:, 9] = 0
    return records


def check_last_values(browser: Page, experiment: Experiment, last_records: NDArray[np.uint32]) -> None:
    """Check what a page draws of x_hat, x and b_hat at the end, to the precision of its 16 bits."""
    shown = browser.evaluate(
        "['x_hat', 'x', 'b_hat'].map((name) => view.history.description.robots.map((_, robot) => "
        f"view.history.value(name, robot, view.history.stateAt({experiment.steps}))))"
    )
    expected = last_records[:, [4, 7, 8]] / [2.0**23, 2.0**23, 2.0**32]
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
def test_liars_lie_as_on_an_emulated_bus(
    browser: Page, playground: Path, topology: str, filter_name: str
) -> None:
    address = f"{topology}&robots=9&liars=2&flawed=35&steps=60&filter={filter_name}"
    open_playground(browser, playground, address)
    last_records = read_records(browser)[-9:]
    settings = swarm_command.settings_of(parse_command(browser))
    with Swarm(settings, Wiring()) as swarm:
        run_swarm(swarm, [])
        robots = [node.robot for node in swarm.nodes]
    assert [robot.x_hat for robot in robots] == (last_records[:, 4] / 2**23).tolist()
    assert [robot.x for robot in robots] == (last_records[:, 7] / 2**23).tolist()


# --- Controls -----------------------------------------------------------------------------------------


@pytest.fixture
def small_browser(chromium: Browser, playground: Path) -> Iterator[Page]:
    """The playground with few steps, in a browser as narrow as a telephone."""
    with new_page(chromium, 390, 844) as browser:
        open_playground(browser, playground, "flawed=20&filter=robust&steps=100")
        yield browser


@pytest.mark.slow
def test_the_address_has_the_settings(small_browser: Page) -> None:
    settings = small_browser.evaluate("view.playground.settings")
    assert (settings["flawed"], settings["filter"], settings["steps"]) == (20, "robust", 100)
    small_browser.evaluate("location.hash = '#steps=40&robots=4'")
    until(small_browser, f"view.history.robotCount === 4 && {HAS_TWO_TRIALS}")


@pytest.mark.slow
def test_settings_of_an_address_that_are_no_settings_have_their_defaults(small_browser: Page) -> None:
    small_browser.evaluate("location.hash = '#density=nonsense&robots=500&filter=best'")
    until(small_browser, "view.playground.settings.filter === 'asdf-minus'")
    settings = small_browser.evaluate("view.playground.settings")
    assert (settings["density"], settings["robots"]) == (1, 20)


@pytest.mark.slow
def test_a_slider_changes_address_and_command(small_browser: Page) -> None:
    small_browser.locator("#more").click()
    small_browser.locator("[name=liars]").focus()
    small_browser.keyboard.press("ArrowRight")
    until(small_browser, "location.hash.includes('liars=1')")
    assert "--fault liar,robots=19-19,x=0,alpha=1e6" in small_browser.evaluate(COMMAND)
    assert small_browser.locator("#liars").is_visible()


@pytest.mark.slow
def test_the_space_bar_on_a_slider_does_not_pause(small_browser: Page) -> None:
    until(small_browser, "view.history !== null")
    small_browser.locator("#more").click()
    was_playing = small_browser.evaluate("view.player.isPlaying = true")
    small_browser.locator("[name=liars]").press("Space")
    assert small_browser.evaluate("view.player.isPlaying") == was_playing


@pytest.mark.slow
def test_each_example_is_marked_and_has_a_story(small_browser: Page) -> None:
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
    with new_page(chromium, width, height) as browser:
        open_playground(browser, playground, "liars=1&steps=100")
        if is_open:
            browser.locator("#more").click()
        assert browser.evaluate("document.documentElement.scrollWidth") <= width
        controls = ["#play", "#miscalibrate", "#add-liar", "#more", "#time"]
        for name in ("#about", "#beliefs", "#arena", *controls, *(["#settings"] if is_open else [])):
            box = browser.locator(name).bounding_box()
            assert box is not None and min(box["width"], box["height"]) > 10, name
            assert box["y"] + box["height"] <= height, name


@pytest.mark.slow
def test_the_first_line_says_what_one_sees(small_browser: Page) -> None:
    text = "document.getElementById('about').textContent"
    assert small_browser.evaluate(text).startswith("Each robot guesses the share of black tiles. 4 of them")
    small_browser.locator("#miscalibrate").click()
    until(small_browser, f"{text}.includes('6 of them misjudge their sensor (orange).')")
    small_browser.locator("#add-liar").click()
    until(small_browser, f"{text}.includes('One claims that no tile is black.')")
    small_browser.locator("#start-over").click()
    until(small_browser, f"{text}.includes('Half of them')")


@pytest.mark.slow
def test_other_settings_start_the_run_again_at_its_end(small_browser: Page) -> None:
    small_browser.evaluate("view.player.seek(view.player.end)")
    small_browser.evaluate("location.hash = '#steps=100&robots=4'")
    until(small_browser, "view.history.robotCount === 4 && view.player.isPlaying")


@pytest.mark.slow
def test_the_large_figures_are_grey_until_all_runs_are_in(browser: Page, playground: Path) -> None:
    open_playground(browser, playground, "steps=3000")
    figure = "document.querySelectorAll('#beliefs .result')[{}].children"
    first = f"(([, error, note]) => [error.className, note.textContent])([...{figure.format(0)}])"
    class_name, runs = browser.evaluate(first)
    if runs != "points, 30 runs":
        assert class_name == "unfinished" and re.fullmatch(r"points, \d+ of 30 runs", runs)
    until(browser, f"{first}.join() === ',points, 30 runs'")
    errors = browser.evaluate("view.playground.comparison.filters[0].trials.map((errors) => errors.at(-1))")
    assert len(errors) == 30
    text = browser.evaluate(f"{figure.format(0)}[1].textContent")
    assert text == f"off by {100 * sorted(errors)[15]:.1f}"


@pytest.mark.slow
def test_the_swarm_believes_the_mean_of_its_robots(small_browser: Page) -> None:
    small_browser.evaluate("view.player.seek(100)")
    x = "view.history.description.robots.map((_, robot) => view.history.value('x', robot, 100))"
    text = "document.getElementById('belief').textContent"
    until(small_browser, f"{text} === `${{Math.round(5 * {x}.reduce((sum, value) => sum + value))}} %`")


@pytest.mark.slow
def test_a_page_that_frames_the_playground_has_its_address_height_and_colours(
    browser: Page, playground: Path
) -> None:
    script = (ROOT / "docs/javascripts/playground.js").read_text(encoding="utf-8")
    index = playground.with_name("index.html")
    frame = f'<iframe id="playground"></iframe><script>{script}</script>'
    index.write_text(f'<body data-md-color-scheme="slate">{frame}</body>', encoding="utf-8")
    background = "getComputedStyle(document.body).backgroundColor"
    browser.goto(f"{index.as_uri()}#robots=5&steps=40")
    inner_page = browser.frames[-1]
    until(inner_page, HAS_TWO_TRIALS)
    assert inner_page.evaluate("view.history.robotCount") == 5
    screen = "document.documentElement.style.getPropertyValue('--screen')"
    until(inner_page, f"{screen} === '792px'")  # below the margin of 8 pixels
    browser.set_viewport_size({"width": 800, "height": 590})
    until(inner_page, f"{screen} === '590px'")
    until(inner_page, f"{background} === 'rgb(16, 20, 26)'")
    browser.evaluate("document.body.dataset.mdColorScheme = 'default'")
    until(inner_page, f"{background} === 'rgb(246, 247, 249)'")
    inner_page.locator("#more").click()
    inner_page.locator("[name=everybody]").check()
    until(browser, "location.hash === '#robots=5&everybody=1&steps=40'")
    assert browser.evaluate("document.getElementById('playground').offsetHeight") > 300
