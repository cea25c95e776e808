"""Studies that are not the paper's: measures by hand, tables, commands and pages; and peers as extensions."""

from __future__ import annotations

import csv
import json
import re
import shutil
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from matplotlib.figure import Figure

from benchmarks import pages
from host_tools.reproduction.test_report import run_of
from mcp_asdf_tools.cli.main import main
from mcp_asdf_tools.cli.reproduce import OWN
from mcp_asdf_tools.common import extensions
from mcp_asdf_tools.experiments.experiment import Experiment, grid
from mcp_asdf_tools.experiments.experiment_files import STUDIES, read_experiments
from mcp_asdf_tools.experiments.results import Trials, experiments_in, read_table
from mcp_asdf_tools.experiments.scores import PAPERS, score
from mcp_asdf_tools.experiments.trials import run_trials
from mcp_asdf_tools.reproduction import ageing, report, resampling, robust, scaling
from mcp_asdf_tools.reproduction.resampling import Estimate
from mcp_asdf_tools.reproduction.study import PAPER, QUICK, Part, Scale
from support import ROOT, run, slow

PEERS = ROOT / "tests/peers"
UNDER = {"fill_ratio": 0.55, "true_accuracy": 0.95, "flawed_accuracy": 0.55}
MOVING: dict[str, Any] = UNDER | {"topology": "dynamic", "latency": 1, "steps": 4000, "trials": 1, "seed": 77}


def test_measures_by_hand() -> None:
    """Four robots, one flawed and the last a liar; of two trials the second harms one healthy robot."""
    experiment = Experiment(robots=4, flawed=1, steps=4000, fill_ratio=0.5, true_accuracy=0.9, trials=2)
    k, e = np.array([[0, 1000, 2000, 9]] * 2), np.array([[0.1, 0.2, 0.3, 9.0]] * 2)
    b_hat = np.array([[[0.5] * 4, [0.5, 0.9, 0.9, 0.1]], [[0.5] * 4, [0.5, 0.84, 0.94, 0.1]]])
    x = np.full((2, 9, 4), 0.7)
    x[:, -2:] = [[0.4, 0.6, 0.8, 0.0], [0.5, 0.7, 0.6, 0.0]]  # the last quarter of nine values are two
    counts = np.zeros((2, 4), np.int64)
    trials = Trials(experiment, [0, 1], k, e, b_hat, counts, counts, {"x": x})
    special = robust.Special(liars=lambda each: 1, late_f=lambda each: 0.6)
    measures = robust.measures_of(trials, special)
    assert measures["H"] == pytest.approx(score(k[:, :3], e[:, :3], *PAPERS.of(experiment))["H"])
    assert measures["e"] == pytest.approx([0.2, 0.2])
    assert measures["late"] == pytest.approx([0.1] * 2)
    assert measures["harmed"] == pytest.approx([0, 0.5])
    assert robust.measures_of(trials)["late"] == pytest.approx([(0.1 + 0.1 + 0.3 + 0.5 + 0.8) / 8] * 2)
    early = robust.measures_of(replace(trials, records={"x": x[:, 5:8]}))["late"]
    assert early == pytest.approx([(0.1 + 0.1 + 0.3 + 0.5) / 4] * 2), "one value of three"
    (entry,) = robust.table_of("", [trials], robust.grid_row, special).entries.values()
    assert (entry.trials, entry.measures["harmed"].value) == (2, 0.25)


def test_a_mean_of_medians_lies_in_its_interval_and_needs_all_its_cells() -> None:
    estimate = robust.mean_of_medians([np.arange(9.0), np.arange(100.0, 109.0)])
    assert estimate.value == 54 and 50 < estimate.low < 54 < estimate.high < 58
    assert np.isnan(robust.mean_of_medians([np.arange(9.0), np.full(9, np.nan)]).value)
    rare = robust.mean_of_medians([np.eye(20)[0], np.zeros(20)], is_rare=True)
    assert rare == pytest.approx((1 / 40, 0, 3 / 40))  # resamples have the one up to 3 times


def test_intervals_are_shown_where_they_are_wide() -> None:
    error = Estimate(0.02, 0.018, 0.0235)
    for shown, (h, late, harmed) in {
        "50.0, 0.090, 0.020, 25.0 %": ((50, 49.5, 50), (0.09, 0.0815, 0.09), (0.25, 0.24, 0.255)),
        "50.0 (49.0..50.0), 0.090 (0.090..0.100), 0.020": ((50, 49, 50), (0.09, 0.09, 0.0995), [np.nan] * 3),
        "50.0, 0.020 (0.018..0.024), 0.020, 25.0 (23.5..25.0) %": ((50, 50, 50), error, (0.25, 0.235, 0.25)),
    }.items():
        measures = {"H": Estimate(*h), "late": Estimate(*late), "e": error, "harmed": Estimate(*harmed)}
        assert robust.whole(robust.Entry(2, measures)) == shown
    assert [robust.error(value) for value in (0.00994, 0.01, 0.1)] == ["0.0099", "0.010", "0.100"]


def test_each_way_to_age_has_a_row_of_its_own() -> None:
    experiments = read_experiments(STUDIES / "ageing.toml")
    rows = {ageing.row_of(each) for each in experiments}
    assert len(rows) == 12 and len({(ageing.row_of(each), each.filter) for each in experiments}) == 38
    assert len(experiments) == 3 * 38  # fill ratios
    short = [run_trials(replace(each, steps=4000), 0, 1, 1000) for each in experiments[:38:5]]
    shown = [axes.get_title("left") for axes in ageing.picture_of({"ageing": short}).axes if axes.axison]
    lasting = [each.experiment for each in short if each.experiment.memory == ageing.LONGEST]
    assert shown == [*dict.fromkeys(map(ageing.kind_of, lasting))]


def test_density_and_world_are_the_same_for_every_number_of_robots() -> None:
    experiments = read_experiments(STUDIES / "scale.toml")
    varied = {"robots": 0, "flawed": 0, "trials": 0}
    worlds = {tuple({**each.parameters(), **varied}.items()) for each in experiments}
    assert len(worlds) == 4 and len(experiments) == 24
    assert all(10 * each.flawed == 3 * each.robots for each in experiments)


# --- Commands and pages ----------------------------------------------------------------------------------


@pytest.fixture
def root(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A folder for pages, with the present ones in it."""
    for folder in ("tests/data", "docs/images"):
        (tmp_path / "root" / folder).mkdir(parents=True)
    for page in ("ageing", "reproduce", "robust"):
        shutil.copy(ROOT / f"docs/{page}.md", tmp_path / "root/docs")
    monkeypatch.setattr(pages, "ROOT", tmp_path / "root")
    monkeypatch.setattr(resampling, "RESAMPLES", 50)
    return tmp_path / "root"


def put(part: str, folder: Path, monkeypatch: pytest.MonkeyPatch) -> int:
    monkeypatch.setattr("sys.argv", ["pages.py", part, str(folder)])
    return pages.main()


AGEING = """robots = 4
memory = [2147483648, 4096]
sensors = [{ drift = "none" }, { drift = "linear", drift_rate = -1e-5 }]
"""
SCALE = """robots = [3, 9]
topology = "dynamic"
sensors = [{}, { fill_ratio = 0.95, true_accuracy = 0.55, flawed_accuracy = 0.95 }]
"""
WAYS, KEPT = ("none ages", "all age alike"), ("longest", "short")
ROWS = {
    "robust": ["fully connected, 25 % flawed", "fully connected, 4 robots, underconfident"],
    "ageing": [f"{way}, {kept} memory" for way in WAYS for kept in KEPT],
    "scale": [f"{robots} robots, {way}confident" for way in ("under", "over") for robots in (3, 9)],
}


@pytest.mark.parametrize(
    ("part", "text"), [("robust", "robots = 4\n"), *slow([("ageing", AGEING), ("scale", SCALE)])]
)
def test_a_study_writes_tables_and_a_picture_and_they_go_into_a_page(
    part: str, text: str, root: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Of few and short trials; between the marks of the page alone."""
    folder, rows = root.parent, ROWS[part]
    for name in OWN[part].FILES:
        (folder / f"{name}.toml").write_text(f'steps = 9000\nfilter = ["none", "robust"]\n{text}')
    monkeypatch.setattr(robust, "STUDIES", folder)
    monkeypatch.setattr(scaling, "_ROBOT_STEPS", 1000)
    options = ["--part", part, "--trials", "2", "--steps", "4000", "--workers", "1", "--seed", "9"]
    assert main(["reproduce", *options, "--output", str(folder)]) == 0
    found = list(csv.DictReader((folder / f"{part}.csv").read_text().splitlines()))
    places = {(row["row"], row["filter"], row["trials"]) for row in found}
    assert places == {(row, name, "2") for row in rows for name in ("no filter", "robust")}
    assert len(found) == (5 if part == "scale" else 4) * len(places)
    late = [row for row in found if row["measure"] == "late"]
    assert all(0 < float(row["low"]) <= float(row["value"]) <= float(row["high"]) < 1 for row in late)
    page = (folder / f"{part}.md").read_text()
    assert all(f"| {row} | " in page for row in rows) and robust.LATE in page
    if part == "robust":
        return
    assert f"]({part}.svg)" in page and (folder / f"{part}.svg").read_bytes().startswith(b"<?xml")
    shutil.copy(folder / f"{part}.parquet", folder / "peers.parquet")
    assert put(part, folder, monkeypatch) == 0
    before, after = ((each / "docs" / pages.PAGES[part][0]).read_text().splitlines() for each in (ROOT, root))
    assert after != before
    assert [each for each in after if each[:1] != "|"] == [each for each in before if each[:1] != "|"]
    assert (root / f"docs/images/{part}.webp").read_bytes()[8:12] == b"WEBP"


def test_options_are_those_of_the_study(capsys: pytest.CaptureFixture[str]) -> None:
    first = robust.experiments_of(robust.GRID, Scale(2, 5000), 9)[0]
    assert (first.trials, first.steps, first.seed) == (2, 5000, 9)
    first = robust.experiments_of(robust.GRID, Scale(), None)[0]
    assert (first.trials, first.steps, first.seed) == (30, 40_000, 4711)
    assert main(["reproduce", "--part", "robust", "--part", "dynamic"]) == 2
    assert "--part robust is a study of its own" in capsys.readouterr().err


@pytest.mark.slow
def test_the_page_of_the_study_is_written(
    root: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(report, "pictures", lambda study, scale: [])
    run = run_of(1, "90 - P / 2", Part.DYNAMIC)
    report.write_report(tmp_path, [run], QUICK)
    assert put("study", tmp_path, monkeypatch) == 1
    report.write_report(tmp_path, [run], PAPER)
    assert put("study", tmp_path, monkeypatch) == 0
    assert len((root / "tests/data/study_verdicts.csv").read_text().splitlines()) == 1 + len(run.decided)
    before, after = (
        (each / "docs/reproduce.md").read_text(encoding="utf-8").partition("<!-- end -->")
        for each in (ROOT, root)
    )
    assert f"of {len(run.decided)} claims hold" in after[0]
    assert after[2] == before[2] != ""


@pytest.mark.slow
@pytest.mark.parametrize("share", ["10 %", "30 %"])
def test_the_page_has_what_the_grid_gives(share: str) -> None:
    """Few trials of another seed, so within what seeds differ."""
    page = (ROOT / "docs/robust.md").read_text(encoding="utf-8")
    row = re.search(rf"^\| moving, {share} flawed \|(.*)\|$", page, re.M)
    assert row is not None
    names = {"none": 0, "asdf-minus": 1, "robust": 3}
    cells = [cell for cell in read_experiments(STUDIES / "robust_grid.toml") if cell.is_dynamic]
    for name, column in names.items():
        own = [c for c in cells if c.filter == name and 100 * c.flawed == int(share[:2]) * c.robots]
        results = [run_trials(Experiment(**each.parameters() | {"seed": 5}), 0, 3, 1000) for each in own]
        (entry,) = robust.table_of("", results, robust.grid_row).entries.values()
        h, late = (float(value.split()[0]) for value in row[1].split("|")[column].split(", ")[:2])
        assert entry.measures["H"].value == pytest.approx(h, abs=5)
        assert entry.measures["late"].value == pytest.approx(late, rel=0.5)


# --- Peers ------------------------------------------------------------------------------------------------


@pytest.fixture
def peers(monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    """The extensions of tests/peers, found by this process."""
    monkeypatch.syspath_prepend(str(PEERS))
    extensions._points.cache_clear()
    yield
    extensions._points.cache_clear()


def late_error(f: float = 0.55, **changes: Any) -> float:
    """The error in the last quarter of a short trial, without the last five robots."""
    (experiment,) = grid(**MOVING | changes)
    x = run_trials(experiment, 0, 1, 50).records["x"][0, -20:, :15]
    return float(abs(x - f).mean())


@pytest.mark.slow
@pytest.mark.usefixtures("peers")
def test_peers_and_worlds_do_what_they_are_for() -> None:
    none, robust_error = late_error(filter="none"), late_error(filter="robust")
    assert late_error(firmware="all-counts", filter="none") < robust_error < none / 3
    assert late_error(firmware="remembering", filter="none") < none / 2  # it hears many in the end
    assert late_error(firmware="bayescpf", filter="asdf-plus") != late_error(filter="asdf-plus")
    assert late_error(firmware="lossy", filter="robust") != robust_error
    one, five = (late_error(firmware=f"liars-{count}", filter="none", flawed=0) for count in (1, 5))
    assert late_error(filter="none", flawed=0) < one < five
    assert late_error(firmware="liars-2", filter="robust", flawed=0) < five / 2
    changed = {"sensor": "changing-floor", "filter": "none", "flawed": 0, "memory": 1024}
    assert late_error(0.95, **changed) < 0.1 < late_error(0.55, **changed)


@pytest.mark.slow
@pytest.mark.usefixtures("peers")
def test_the_commands_of_the_page_find_the_peers(tmp_path: Path) -> None:
    small = re.sub(r"steps = \d+_000", "steps = 1000", (PEERS / "peers.toml").read_text())
    (tmp_path / "peers.toml").write_text(re.sub(r"trials = \d+", "trials = 1", small))
    output = run(
        "mcp-asdf", "sweep", "peers.toml", "--record", "500", "--json", cwd=tmp_path, PYTHONPATH=str(PEERS)
    )
    chosen = {each["parameters"]["firmware"] for each in json.loads(output)["experiments"]}
    assert len(chosen) == 9
    peers = experiments_in(read_table(tmp_path / "peers.parquet"))
    cells = [each for each in read_experiments(STUDIES / "robust_grid.toml") if each.is_dynamic]
    shorter = [Experiment(**each.parameters() | {"steps": 1000}) for each in cells]
    found = {
        robust.GRID: [run_trials(each, 0, 2, 100) for each in shorter],
        robust.BEYOND: [],
        "peers": peers,
    }
    for panel in pages.picture_of_robust(found).axes:
        finals = [np.asarray(line.get_ydata(), float)[-1] for line in panel.lines]
        assert len(finals) == 4 and all(0 < each < 0.8 for each in finals)
    rows = {name: table.count("\n") for name, table in pages.tables_of_robust(found).items()}
    assert rows == {"grid": 6, "beyond": 1, "peers": 4, "worlds": 10}


def ageing_error(**changes: Any) -> float:
    """The error at the end of a short trial in which all sensors lose 0.4 alike."""
    world: dict[str, Any] = {"steps": 4000, "drift": "linear", "drift_rate": -1e-4, "fill_ratio": 0.75}
    robots: dict[str, Any] = {"robots": 10, "flawed": 0, "sensor": "known", "filter": "none"}
    (experiment,) = grid(seed=7, trials=1, **world | robots | changes)
    return float(abs(run_trials(experiment, 0, 1, 100).records["x"][0, -5:] - 0.75).mean())


@pytest.mark.slow
@pytest.mark.usefixtures("peers")
def test_only_who_knows_how_accurate_the_counted_observations_were_is_right() -> None:
    plain, oracle, mean = (ageing_error(firmware=each) for each in ("reference", "oracle", "mean-accuracy"))
    assert mean < 0.03 and min(plain, oracle) > 0.06
    assert ageing_error(firmware="mean-accuracy", memory=1024) < 0.03
    ageing_peer = ageing_error(firmware="ageing-bayescpf", filter="asdf-plus")
    assert ageing_peer != ageing_error(firmware="bayescpf", filter="asdf-plus")


def test_a_row_says_what_sets_an_experiment_apart() -> None:
    healthy = Experiment(topology="dynamic", flawed=0, density=3)
    assert robust.row_of(healthy) == "moving, 0 % flawed, density 3, latency 0"
    assert robust.grid_row(healthy) == "moving, 0 % flawed"
    assert robust.grid_row(Experiment(robots=20, flawed=14)) == "fully connected, 70 % flawed"
    usual: dict[str, Any] = {"robots": 20, "flawed": 6}
    moving = usual | {"topology": "dynamic", "latency": 1}
    for own, row in (
        (usual, "fully connected, underconfident"),
        (usual | {"flawed": 14}, "fully connected, 70 % flawed, underconfident"),
        (usual | {"robots": 21}, "fully connected, 21 robots, underconfident"),
        (usual | {"robots": 19}, "fully connected, 19 robots, underconfident"),
        (usual | {"flawed_accuracy": 0.95, "true_accuracy": 0.95}, "fully connected, overconfident"),
        (moving | {"white_offset": -0.1}, "moving, b -0.1 on white, underconfident"),
        (moving | {"drift": "wiener"}, "moving, sensors age each in its own way, underconfident"),
        (moving | {"drift": "linear"}, "moving, sensors age alike, underconfident"),
    ):
        assert robust.row_of(Experiment(**own)) == row


def test_many_robots_have_costs_beside_scores_and_errors(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Of two ns for a robot and step, and a start."""
    with monkeypatch.context() as patch:
        patch.setattr(scaling, "time", SimpleNamespace(process_time=iter([0, 5, 12, 14]).__next__))
        assert scaling._seconds(Experiment(robots=2, steps=10, filter_period=10)) == 2, "the best of three"
    monkeypatch.setattr(scaling, "_seconds", lambda each: 3 + 2e-9 * each.robots * each.steps)
    over = {"true_accuracy": 0.55, "flawed_accuracy": 0.95}
    many = grid(robots=[3, 9], who=[{}, over], filter=["none", "robust"], steps=60, filter_period=20)
    results = [run_trials(each, 0, 2, 10) for each in many]
    table = robust.table_of("", results, scaling.row_of, scaling.COSTS)
    assert [entry.measures["cost"].value for entry in table.entries.values()] == pytest.approx([2] * 8)
    assert [line.rpartition(",")[2] for line in scaling.lines_of(table).splitlines()[2:]] == [" 2 |"] * 4
    figure = scaling.picture_of({"scale": results})
    for number, axes in enumerate(figure.axes):
        assert (axes.get_title(), axes.get_xscale()) == (("under", "over")[number // 3] + "confident", "log")
        assert (axes.get_ylim()[0] == 0) == (number % 3 != 1) and figure.axes[0].get_ylim() == (0, 100)
        own = [each for each in results if scaling.row_of(each.experiment).endswith(f" {axes.get_title()}")]
        found = [robust.measures_of(each, scaling.COSTS) for each in own]
        expected = [np.median(each[("H", "late", "cost")[number % 3]]) for each in found]
        drawn = np.concatenate([np.asarray(line.get_ydata()) for line in axes.lines])
        assert drawn == pytest.approx(np.array([*expected[::2], *expected[1::2]]))
    monkeypatch.setattr(scaling, "picture_of", lambda found: Figure())
    scaling.write_report(tmp_path, {"scale": results})
    assert f"{scaling.lines_of(table)}\n\n![Many robots](scale.svg)\n" in (tmp_path / "scale.md").read_text()
    assert {path.name for path in tmp_path.iterdir()} == {"scale.md", "scale.csv", "scale.svg"}
