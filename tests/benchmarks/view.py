"""Smoothness of the page in a browser, and its size: ``python tests/benchmarks/view.py``."""

from __future__ import annotations

import sys
import tempfile
from dataclasses import dataclass
from pathlib import Path
from statistics import median

sys.path.insert(0, str(Path(__file__).parents[1]))

from browser import browser_page, until
from mcp_asdf_tools.experiments import Experiment, experiments_in, run_trials, table_of
from mcp_asdf_tools.robots import Filtering
from mcp_asdf_tools.view import film_of_trial, page

ROBOTS, STEPS, FRAMES = 20, 40_000, 200
RECORD = f"""new Promise((resolve) => {{
    const [intervals, draws] = [[], []];
    let before = performance.now();
    const note = (now) => {{
        intervals.push(now - before);
        draws.push(1000 * view.drawSeconds);
        before = now;
        if (intervals.length < {FRAMES}) requestAnimationFrame(note);
        else resolve([intervals, draws]);
    }};
    requestAnimationFrame(note);
}})"""
CHARTS = """(() => {
    const start = performance.now();
    view.charts.repaint();
    return performance.now() - start;
})()"""


@dataclass(frozen=True)
class Smoothness:
    """Figures of a page that plays a film.

    Attributes:
        megabytes: Size of the exported page.
        opening: From opening the file to the first picture, seconds.
        scripts: Time in the page's scripts for a picture: median and 95th percentile, milliseconds.
        frames: Time from picture to picture, which the browser wants to be 16.7: the same.
        charts: Thinning out all samples and drawing the charts anew, milliseconds.
    """

    megabytes: float
    opening: float
    scripts: tuple[float, float]
    frames: tuple[float, float]
    charts: float


def measure(robots: int = ROBOTS, steps: int = STEPS) -> Smoothness:
    """Play a film of robots that move, at the speed that the page chooses."""
    experiment = Experiment(
        robots=robots, steps=steps, topology="dynamic", filter=Filtering.ASDF_MINUS, flawed="50%", trials=1
    )
    (trials,) = experiments_in(table_of(run_trials(experiment, 0, 1)))
    content = page(film_of_trial(trials, 0)).encode()
    with tempfile.TemporaryDirectory() as folder, browser_page() as browser:
        path = Path(folder, "run.html")
        path.write_bytes(content)
        browser.goto(path.as_uri())
        opening = until(browser, "window.view && view.film && view.frames > 0 && performance.now()") / 1000
        intervals, draws = browser.evaluate(RECORD)
        charts = browser.evaluate(CHARTS)
    return Smoothness(len(content) / 1e6, opening, _figures(draws), _figures(intervals), charts)


def _figures(times: list[float]) -> tuple[float, float]:
    return median(times), sorted(times)[int(0.95 * len(times))]


def main() -> None:
    """Measure and print a table."""
    print(f"{ROBOTS} robots, {STEPS} steps, {FRAMES} pictures of 1280 x 800 without a graphics processor")
    for name, value in vars(measure()).items():
        values = value if isinstance(value, tuple) else (value,)
        print(f"{name:10}", "  ".join(f"{each:8.2f}" for each in values))


if __name__ == "__main__":
    main()
