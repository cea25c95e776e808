"""The page stays smooth and small with a long film."""

from __future__ import annotations

from pathlib import Path
from statistics import median

import pytest

from browser import browser_page, until
from mcp_asdf_tools.experiments.experiment import Experiment
from mcp_asdf_tools.experiments.results import experiments_in, table_of
from mcp_asdf_tools.experiments.trials import run_trials
from mcp_asdf_tools.view.films import film_of_trial
from mcp_asdf_tools.view.page import page

RECORD = """new Promise((resolve) => {
    const [intervals, draws] = [[], []];
    let before = performance.now();
    const note = (now) => {
        intervals.push(now - before);
        before = now;
        const start = performance.now();
        view.draw();
        draws.push(performance.now() - start);
        if (intervals.length < 200) requestAnimationFrame(note);
        else resolve([intervals, draws]);
    };
    requestAnimationFrame(note);
})"""
CHARTS = (
    "(() => { const start = performance.now(); view.show(view.film); return performance.now() - start; })()"
)


@pytest.mark.slow
def test_a_long_film_stays_smooth_and_small(tmp_path: Path) -> None:
    """A picture has 16.7 ms; the limits, in ms, leave room for a machine that is busy with other tests."""
    experiment = Experiment(
        robots=20, steps=40_000, topology="dynamic", filter="asdf-minus", flawed="50%", trials=1
    )
    (trials,) = experiments_in(table_of(run_trials(experiment, 0, 1)))
    content = page(film_of_trial(trials, 0)).encode()
    path = tmp_path / "run.html"
    path.write_bytes(content)
    with browser_page() as browser:
        browser.goto(path.as_uri())
        until(browser, "window.view && view.arena.places.length > 0")
        intervals, draws = map(median, browser.evaluate(RECORD))
        charts = browser.evaluate(CHARTS)
    print(f"{len(content)} bytes, {draws} and {intervals} ms a picture, {charts} ms for all charts")
    assert draws < 10 and intervals < 50 and charts < 1500 and len(content) < 3e6
