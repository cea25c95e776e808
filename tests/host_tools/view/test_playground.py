"""The playground in a real browser: it computes the native engine's bits, as its command says."""

from __future__ import annotations

import shlex
from itertools import product
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest

from browser import browser_page, until
from mcp_asdf_tools.cli import main as cli
from mcp_asdf_tools.cli import swarm as swarm_command
from mcp_asdf_tools.cli.options import experiments_of
from mcp_asdf_tools.experiments.engine import native
from mcp_asdf_tools.swarm.carrier import Wiring
from mcp_asdf_tools.swarm.run import run_swarm
from mcp_asdf_tools.swarm.swarm import Swarm
from mcp_asdf_tools.view.page import page, playground
from mcp_asdf_tools.world.arena import Arena
from support import ROOT, require, run

if TYPE_CHECKING:
    from playwright.sync_api import Page

IS_DONE = "window.view?.playground?.comparison.filters.every(({ trials }) => trials.length >= 2 && trials[0])"
COMMAND = "document.querySelector('#command code').textContent"
WORDS = "Array.from(view.playground.words)"
ADDRESSES = (
    "seed=7&steps=1000",
    "filter=asdf-plus&robots=9&flawed=35&density=4&fill=0.3&steps=1000",
    "filter=robust&robots=127&density=9.8&wrong=0.05&accuracy=0.9&steps=60",
    "everybody=1&filter=robust&robots=9&steps=1000&accuracy=1&fill=1&wrong=0.99",
    "everybody=1&filter=asdf-minus&robots=20&steps=1000",
    "everybody=1&filter=none&robots=2&steps=50",
)


@pytest.fixture(scope="module")
def path(tmp_path_factory: pytest.TempPathFactory) -> Path:
    for tool in ("clang", "wasm-ld"):
        require(tool, "clang lld")
    file = tmp_path_factory.mktemp("playground") / "play.html"
    run("python", ".ci/playground.py", file)
    return file


def open_at(browser: Page, path: Path, address: str) -> Any:
    """Open the page with these settings; returns the options of its command as their parser reads them."""
    browser.goto("about:blank")
    browser.goto(f"{path.as_uri()}#{address}")
    until(browser, IS_DONE)
    _, command, *words = shlex.split(str(browser.evaluate(COMMAND)))
    return cli._parser_for(command, cli._load(command)).parse_args(words)


def test_only_the_playground_may_compile() -> None:
    """The page of recordings keeps its stricter rules."""
    assert "wasm" not in page().partition("<style>")[0]
    text = playground(b"\0asm")
    assert "script-src 'unsafe-inline' data: 'wasm-unsafe-eval'; worker-src data:;" in text
    assert '{"module": "AGFzbQ=="}' in text and "__" not in text.partition("<style>")[0]


@pytest.mark.slow
def test_a_browser_computes_the_bits_of_the_command(path: Path) -> None:
    """Every record of the first trial, its motion, the errors of all filters in the first two, and liars."""
    with browser_page() as browser:
        for address in ADDRESSES:
            check_bits(browser, open_at(browser, path, address))
        for topology, name in product(("everybody=1", "density=4"), ("asdf-plus", "robust")):
            address = f"{topology}&robots=9&liars=2&flawed=35&steps=60&filter={name}"
            check_liars(open_at(browser, path, address), browser.evaluate(WORDS))


def check_bits(browser: Page, args: Any) -> None:
    experiment = experiments_of(args)[0]
    found = np.array(browser.evaluate(WORDS), np.uint32)
    expected = native.run(experiment, 0, 1, 1).records.view(np.uint32).ravel()
    is_padding = np.arange(len(expected)) % 10 == 9
    assert np.array_equal(np.where(is_padding, 0, found), np.where(is_padding, 0, expected))
    if experiment.is_dynamic:
        motion = Arena(experiment, 0).record(experiment.steps)
        last = f"view.film.position(robot, {experiment.steps})"
        places = browser.evaluate(f"view.film.stage.robots.map((robot) => {last})")
        assert np.abs(places - motion.position[-1]).max() <= max(experiment.sides) / 65534
    for number, name in enumerate(("none", "asdf-minus", "asdf-plus", "robust")):
        other = type(experiment)(**experiment.parameters() | {"filter": name})
        x = native.run(other, 0, 2).x / 2.0**23
        errors = np.broadcast_to(abs(x - experiment.fill_ratio).mean(axis=1), (2, experiment.steps + 1))
        trials = f"view.playground.comparison.filters[{number}].trials.slice(0, 2)"
        series = np.array(browser.evaluate(f"{trials}.map((each) => [...each])"))
        blocks = errors[:, : 8 * series.shape[1]].reshape(*series.shape, 8).mean(axis=2)
        assert np.abs(series - blocks).max() < 1e-12


def check_liars(args: Any, words: list[int]) -> None:
    """They lie as on an emulated bus."""
    found = np.array(words, np.uint32).reshape(60, 9, 10)[-1]
    with Swarm(swarm_command.settings_of(args), Wiring()) as swarm:
        run_swarm(swarm, [])
        robots = [node.robot for node in swarm.nodes]
    assert [robot.x_hat for robot in robots] == (found[:, 4] / 2**23).tolist()
    assert [robot.x for robot in robots] == (found[:, 7] / 2**23).tolist()


@pytest.mark.slow
def test_controls_presets_and_the_address_agree(path: Path) -> None:
    with browser_page(390, 844) as browser:
        open_at(browser, path, "flawed=20&filter=robust&steps=100&density=nonsense&robots=500")
        settings = browser.evaluate("view.playground.settings")
        assert (settings["flawed"], settings["filter"], settings["robots"]) == (20, "robust", 20)
        assert browser.evaluate("document.documentElement.scrollWidth") <= 390
        browser.locator("[name=liars]").focus()
        browser.keyboard.press("ArrowRight")
        until(browser, "location.hash.includes('liars=1')")
        assert "--fault liar,robots=19-19,x=0,alpha=1e6" in browser.evaluate(COMMAND)
        browser.keyboard.press("Space")  # on a slider it does not play
        for index, button in enumerate(browser.locator("#presets button").all()):
            button.press("Enter")
            until(browser, f"document.querySelectorAll('#presets button')[{index}].ariaPressed === 'true'")
            assert browser.locator("#story").inner_text().endswith(".")
        browser.evaluate("location.hash = '#steps=40&robots=4'")
        until(browser, f"view.film.robots === 4 && {IS_DONE}")
        browser.locator("[name=filter][value=none]").check()
        until(browser, "location.hash.includes('filter=none') && view.film.stage.title.endsWith('no filter')")
        check_documentation(browser, path.with_name("index.html"))


def check_documentation(browser: Page, index: Path) -> None:
    """The page that has the playground in a frame has the address and the colours."""
    script = (ROOT / "docs/javascripts/playground.js").read_text(encoding="utf-8")
    frame = f'<iframe id="playground"></iframe><script>{script}</script>'
    index.write_text(f'<body data-md-color-scheme="slate">{frame}</body>', encoding="utf-8")
    browser.goto(f"{index.as_uri()}#robots=5&steps=40")
    inner = browser.frames[-1]
    until(inner, IS_DONE)
    assert inner.evaluate("view.film.robots") == 5
    background = "getComputedStyle(document.body).backgroundColor"
    until(inner, f"{background} === 'rgb(16, 20, 26)'")
    browser.evaluate("document.body.dataset.mdColorScheme = 'default'")
    until(inner, f"{background} === 'rgb(246, 247, 249)'")
    inner.locator("[name=everybody]").check()
    until(browser, "location.hash === '#robots=5&everybody=1&steps=40'")
    assert browser.evaluate("document.getElementById('playground').offsetHeight") > 300
