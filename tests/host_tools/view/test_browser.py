"""The page in a real browser: it shows a film, goes where one drags the time, and follows a run."""

from __future__ import annotations

import re
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, cast

import can
import numpy as np
import pytest

from browser import browser_page, developed, until
from mcp_asdf_tools.bus.frames import FrameFormat
from mcp_asdf_tools.swarm.carrier import Wiring
from mcp_asdf_tools.swarm.settings import SwarmSettings
from mcp_asdf_tools.swarm.swarm import Swarm, run_swarm
from mcp_asdf_tools.view.film import Film, LiveFilm, rows_of
from mcp_asdf_tools.view.films import BusFilm, SwarmCamera
from mcp_asdf_tools.view.page import page
from mcp_asdf_tools.view.server import serving
from support import PATIENCE, interruptible

if TYPE_CHECKING:
    from playwright.sync_api import Page

SETTINGS = SwarmSettings(
    robots=8,
    topology="dynamic",
    filter="asdf-minus",
    flawed="50%",
    steps=300,
    filter_period=50,
    density=4,
)
STATE = "document.getElementById('state').textContent"
IS_SHOWN = "window.view && view.film && view.film.length > 0 && view.frames > 1"
ALL_VALUES = """[...Array(view.film.length).keys()].map((sample) => view.film.stage.quantities.map((name) =>
    view.film.stage.robots.map((_, robot) => view.film.value(name, robot, sample))))"""
ALL_LINKS = """[...Array(view.film.length).keys()].map((sample) => view.film.stage.robots.map((_, i) =>
    view.film.stage.robots.map((_, j) => view.film.hears(i, j, sample))))"""
ALL_PLACES = """[...Array(view.film.length).keys()].map((sample) => view.film.stage.robots.map((_, robot) =>
    view.film.position(robot, sample)))"""
INK = "view.arena.context.getImageData(0, 0, view.arena.canvas.width, view.arena.canvas.height).data"
COLOURS = f"new Set(new Uint32Array({INK}.buffer)).size"


def filmed(settings: SwarmSettings) -> Film:
    camera = SwarmCamera(settings)
    with Swarm(settings, Wiring()) as swarm:
        run_swarm(swarm, [camera])
    return developed(camera.film)


def test_the_page_shows_a_film_and_follows_a_run(tmp_path: Path) -> None:
    """One browser for all that is tested always: starting it takes longer than the rest."""
    film, path = filmed(SETTINGS), tmp_path / "run.html"
    path.write_text(page(film))
    with browser_page() as browser:
        browser.goto(path.as_uri())
        until(browser, IS_SHOWN)
        step = 1 / 65534
        values = np.array(browser.evaluate(ALL_VALUES), dtype=float)
        assert np.abs(values - film.samples.values).max() <= step
        assert np.array_equal(browser.evaluate(ALL_LINKS), film.samples.hears)
        assert film.samples.positions is not None
        places = np.array(browser.evaluate(ALL_PLACES))
        assert np.abs(places - film.samples.positions).max() <= step * max(film.stage.sides or ())

        browser.evaluate("view.player.pause()")
        browser.locator("#time").fill("200")
        # Robots are where the frame last drawn has them.
        until(browser, "document.getElementById('clock').textContent.startsWith('step 200 of')")
        x, y = until(browser, "view.arena.places[2].map((each) => each / view.arena.ratio)")
        browser.locator("#arena").click(position={"x": x, "y": y})
        assert until(browser, "view.chosen") == 2
        assert "Robot 2, flawed at the start" in browser.locator("#robot").inner_text()
        assert browser.evaluate(COLOURS) > 50
        follow_a_run(browser, film)


def follow_a_run(browser: Page, film: Film) -> None:
    """Samples come while the page is open, and it goes along until the run has ended."""
    live, rows = LiveFilm(film.stage), rows_of(film.samples)
    with serving(live) as url:
        for row in rows[:50]:
            live.add(row)
        browser.goto(url)
        until(browser, f"{IS_SHOWN} && view.film.length === 50")
        for row in rows[50:]:
            live.add(row)
        until(browser, f"view.film.length === {len(rows)} && view.player.tick > 250")
        live.end()
        until(browser, f"{STATE} === 'the run has ended'")


@pytest.mark.slow
@pytest.mark.parametrize("scheme", ["light", "dark"])
def test_all_controls_work(scheme: str, tmp_path: Path) -> None:
    path, asked = tmp_path / "run.html", list[str]()
    path.write_text(page(filmed(SETTINGS)))
    with browser_page() as browser:
        browser.on("request", lambda request: asked.append(request.url.partition(":")[0]))
        browser.emulate_media(color_scheme=cast(Any, scheme))
        browser.goto(path.as_uri())
        until(browser, IS_SHOWN)
        assert browser.evaluate("document.documentElement.dataset.theme") == scheme
        browser.locator("#theme").click()
        assert browser.evaluate("document.documentElement.dataset.theme") != scheme
        until(browser, "view.player.tick > 0")
        browser.locator("#play").click()
        assert not browser.evaluate("view.player.isPlaying")
        browser.locator("#speed").select_option("1000")
        browser.locator("#play").click()
        until(browser, "view.player.tick === view.player.end && !view.player.isPlaying")
        over = browser.locator(".u-over").first.bounding_box()
        assert over is not None
        browser.mouse.click(over["x"] + over["width"] / 2, over["y"] + over["height"] / 2)
        assert browser.evaluate("view.player.tick") == pytest.approx(150, abs=5)
        browser.keyboard.press("End")
        until(browser, "document.querySelectorAll('#events button').length > 0")
        browser.locator("#events button").last.click()
        until(browser, "view.chosen !== null && view.player.tick % 50 === 0")
        browser.keyboard.press("Escape")
        assert browser.evaluate("view.chosen") is None
    assert set(asked) <= {"file", "data", "blob"}, "nothing comes from a network"


@pytest.mark.slow
@pytest.mark.parametrize(("width", "height"), [(1920, 1080), (1024, 700), (420, 900)])
def test_all_is_seen_on_screens_of_any_size(width: int, height: int, tmp_path: Path) -> None:
    path = tmp_path / "run.html"
    path.write_text(page(filmed(SETTINGS)))
    with browser_page(width, height) as browser:
        browser.goto(path.as_uri())
        until(browser, IS_SHOWN)
        assert browser.evaluate("document.documentElement.scrollWidth") <= width
        for name in ("#arena", "#charts", "#figures", "#events", "#play", "#time"):
            box = browser.locator(name).bounding_box()
            assert box is not None
            assert min(box["width"], box["height"]) > 10, name
        heights = browser.evaluate("view.charts.plots.map(({ plot }) => plot.over.clientHeight)")
        assert min(heights) > 40


@pytest.mark.slow
def test_robots_of_a_bus_are_followed() -> None:
    """Also one that joins when the page is open already."""
    settings = SwarmSettings(robots=5, steps=400, telemetry_period=5)
    with can.Bus("view", "virtual") as listener, browser_page() as browser:
        watch = BusFilm(listener, FrameFormat(), "a bus", 0.55, 0.95)
        with serving(watch.film) as url, running(watch):
            play(settings, "view")
            browser.goto(url)
            until(browser, IS_SHOWN)
            assert browser.evaluate("view.film.stage.robots") == [0, 1, 2, 3, 4]
            play(replace(settings, robots=6), "view")
            until(browser, "view.film.stage.robots.length === 6 && view.film.length > 3")
            assert browser.evaluate("Number.isNaN(view.film.value('x', 5, 0))")
            x = until(browser, "view.film.value('x', 5, view.film.length - 1)")
            assert abs(x - 0.55) < 0.2


@contextmanager
def running(watch: BusFilm) -> Iterator[None]:
    """The watch in a thread."""
    is_over = threading.Event()
    thread = threading.Thread(target=watch.record, args=[is_over.is_set])
    thread.start()
    try:
        yield
    finally:
        is_over.set()
        thread.join()


def play(settings: SwarmSettings, channel: str) -> None:
    """A swarm on the virtual bus of this process, slowly enough for its listeners."""
    wiring = Wiring(lambda robot: can.Bus(channel, "virtual", preserve_timestamps=True))
    with Swarm(settings, wiring) as swarm:
        run_swarm(swarm, [lambda swarm: time.sleep(0.001)])


@pytest.mark.slow
def test_a_swarm_is_shown_as_it_runs_and_its_page_stays_until_ctrl_c() -> None:
    options = ["--topology", "dynamic", "--steps", "300", "--robots", "6", "--quiet"]
    command = [sys.executable, "-m", "mcp_asdf_tools.cli.main", "swarm", *options, "--view"]
    with (
        browser_page() as browser,
        interruptible(),
        subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True) as swarm,
    ):
        assert swarm.stderr is not None
        (url,) = re.findall(r"http://127\.0\.0\.1:\d+/", swarm.stderr.readline())
        browser.goto(url)
        until(browser, f"{IS_SHOWN} && {STATE} === 'the run has ended'")
        assert browser.evaluate("view.film.length") == 300
        assert swarm.poll() is None
        swarm.send_signal(signal.SIGINT)
        out, err = swarm.communicate(timeout=PATIENCE)
        assert swarm.returncode == 0, err
        assert out.startswith("seed 1: 6 robots, 300 steps")
