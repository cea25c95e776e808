"""``mcp-asdf view`` and ``plot`` show recordings and results, or refuse what cannot be shown in a line."""

from __future__ import annotations

import json
import re
import shutil
from collections.abc import Callable
from contextlib import nullcontext
from dataclasses import replace
from pathlib import Path
from unittest.mock import Mock
from urllib.request import urlopen

import can
import pyarrow as pa  # type: ignore[import-untyped]
import pytest

from mcp_asdf_tools.cli import view
from mcp_asdf_tools.cli.main import main
from mcp_asdf_tools.cli.output import sleep_until
from mcp_asdf_tools.experiments.experiment import Experiment
from mcp_asdf_tools.experiments.result_files import write_tables
from mcp_asdf_tools.experiments.result_tables import trials_to_table
from mcp_asdf_tools.experiments.trials import run_trials
from mcp_asdf_tools.view.bus_recorder import BusRecorder

VIEW, PLOT = "view grid.parquet --export out.html", "plot grid.parquet out.svg"
ONE = "--where filter=none --where fill_ratio=.950"
ANY = "where fill_ratio=0.55|0.95, filter=asdf-plus|none"


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A swarm's log, and results of four experiments of two trials, with values every 20 steps."""
    path = tmp_path_factory.mktemp("view")
    common = Experiment(robots=5, filter="asdf-plus", steps=60, filter_period=20, trials=2)
    experiments = [
        replace(common, filter=name, fill_ratio=fill)
        for fill in (0.55, 0.95)
        for name in ("none", "asdf-plus")
    ]
    tables = [trials_to_table(run_trials(each, 0, 2, 20)) for each in experiments]
    write_tables(path / "grid.parquet", [pa.concat_tables(tables)])
    swarm = "swarm --robots 5 --filter asdf-plus --steps 60 --filter-period 20 --quiet --log"
    assert main([*swarm.split(), str(path / "run.log")]) == 0
    return path


@pytest.fixture(autouse=True)
def place(folder: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    monkeypatch.chdir(folder)
    capsys.readouterr()


@pytest.mark.parametrize(
    ("options", "count"),
    [("", 4), ("--where fill_ratio=0.95", 2), (f"--kind series {ONE} --where robots=5", 1)],
)
def test_experiments_are_chosen(
    options: str, count: int, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["plot", "grid.parquet", str(tmp_path / "x.svg"), "--json", *options.split()]) == 0
    assert json.loads(capsys.readouterr().out)["experiments"] == count


@pytest.mark.parametrize(
    ("recording", "title"),
    [("run.log", "ASDF+"), (f"grid.parquet {ONE} --trial 1", "no filter")],
)
def test_a_log_and_a_trial_are_exported(
    recording: str, title: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    target = tmp_path / "run.html"
    assert main(["view", *recording.split(), "--export", str(target), "--json"]) == 0
    report = json.loads(capsys.readouterr().out)
    assert report == {"export": str(target), "bytes": target.stat().st_size, "states": 61}
    assert f"5 robots, 2 flawed, {title}" in target.read_text()


def test_a_log_without_events_shows_what_its_frames_say(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    log, target = tmp_path / "real.log", tmp_path / "run.html"
    shutil.copy("run.log", log)
    assert main(["view", str(log), "--export", str(target), "--json"]) == 0
    said = capsys.readouterr()
    assert json.loads(said.out)["states"] == 61
    assert f"mcp-asdf view: there is no {log}.events, which swarm, radio and node write" in said.err
    assert "no robot sent telemetry" in said.err


def test_a_log_of_two_buses_is_shown_of_one(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    log, command = tmp_path / "any.log", ["view", str(tmp_path / "any.log"), "--export"]
    text = Path("run.log").read_text()
    log.write_text(text + text.replace(" vcan0 ", " can3 "))
    assert main([*command, str(tmp_path / "all.html")]) == 0
    assert f"{log} has frames of vcan0 and can3; choose one by --channel" in capsys.readouterr().err
    assert main([*command, str(tmp_path / "one.html"), "--channel", "can3"]) == 0
    assert "choose one" not in capsys.readouterr().err


@pytest.mark.parametrize("line", ["view run.log", "swarm --robots 4 --steps 20 --quiet --view"])
def test_a_page_is_served_until_it_is_asked_to_end(
    line: str, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    told: list[str] = []

    def look(should_stop: Callable[[], bool]) -> None:
        answers = [True, should_stop()]
        sleep_until(answers.pop)
        assert answers == []
        url = re.search(r"http://127\.0\.0\.1:\d+/", capsys.readouterr().err)
        assert url is not None
        told.append(urlopen(f"{url[0]}events").read().decode())

    monkeypatch.setattr(f"mcp_asdf_tools.cli.{line.split(maxsplit=1)[0]}.sleep_until", look)
    assert main(line.split()) == 0
    assert told[0].startswith("event: description\n") and told[0].endswith("event: end\ndata: null\n\n")


def test_a_bus_is_watched_until_it_is_asked_to_end(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    answers = iter([False, True])
    monkeypatch.setattr(view, "stopping", lambda: nullcontext(lambda: next(answers)))
    assert main(["view", "--interface", "udp_multicast", "--channel", "239.74.163.77", "--json"]) == 0
    out, err = capsys.readouterr()
    assert json.loads(out)["url"].startswith("http://127.0.0.1:") and "no robot sent telemetry" in err
    failing = Mock(side_effect=can.CanOperationError("it is off"))
    monkeypatch.setattr(BusRecorder, "record", failing)
    assert main(["view", "--interface", "udp_multicast", "--channel", "239.74.163.77"]) == 1
    assert "mcp-asdf view: the bus failed: it is off" in capsys.readouterr().err
    monkeypatch.setattr("mcp_asdf_tools.swarm.run.run_swarm", failing)
    monkeypatch.setattr(
        "mcp_asdf_tools.cli.swarm.sleep_until", None
    )  # nobody looks at a run that an error ended
    assert main(["swarm", "--robots", "4", "--steps", "20", "--view"]) == 1
    assert "mcp-asdf swarm: it is off" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("line", "reason"),
    [
        ("view", "give a recording, or with --interface the bus"),
        ("view --export x.html --interface udp_multicast", "--export is for recordings"),
        ("view none.log", "there is no log"),
        ("view none.log --export no/such/out.html", "its folder does not exist"),
        ("view none.parquet", "cannot read"),
        (VIEW, f"4 experiments match; choose one with {ANY}"),
        (f"{VIEW} {ONE} --trial 9", "no trial 9; choose one of 0 to 1"),
        ("view run.log --export out.html --trial 1", "--trial and --where choose from results"),
        ("view run.log --export out.pdf", "choose a name that ends in .html"),
        ("view run.log --port 99999", "--port is 99999"),
        ("view run.log --export out.html --port 0", "--port is for a page that is served"),
        ("view run.log --fill-ratio 0.5", "--fill-ratio is for a bus, but run.log is a recording"),
        ("view run.log --true-accuracy 0.5", "--true-accuracy is for a bus"),
        ("view run.log --subject 9", "--subject is for a bus"),
        ("view run.log --interface virtual", "--interface is for a bus"),
        ("view run.log --channel can0", "--channel is for a bus"),
        ("swarm --steps 1 --pace 500", "--pace is for the page of --view; add --view, or leave it out"),
        ("swarm --steps 1 --port 0", "--port is for the page of --view"),
        ("view --subject 9999 --interface udp_multicast", "subject is 9999"),
        (
            f"{PLOT} --where colour=red",
            "where colour=red: no parameter is called so; the experiments differ in fill_ratio",
        ),
        (f"{PLOT} --where filte=none", "no parameter is called so; did you mean filter?"),
        (f"{PLOT} --where filter", f"differ in {ANY.removeprefix('where ')}"),
        (f"{PLOT} --where filter=both", "has it; filter is asdf-plus or none"),
        (f"{PLOT} --where filter=none --where filter=asdf-plus", "has it; filter is none"),
        (f"{PLOT} --x omega", "--x would do nothing: it is for curve, and kind is boxes; leave it out"),
        (f"{PLOT} --kind scatter --hue filter", "--hue would do nothing: it is for curve"),
        (f"{PLOT} --y H", "--y would do nothing: it is for curve"),
        (f"{PLOT} --kind bands --facet filter", "--facet would do nothing: it is for curve"),
        (f"{PLOT} --kind curve --x omega --trial 0", "--trial would do nothing: it is for series"),
        (
            f"{PLOT} --kind series --e-max 0.45",
            "--e-max would do nothing: it is for boxes and curve and scatter,",
        ),
        (f"{PLOT} --kind curve --x omega --y K --k-max 9", "--k-max would do nothing: it is for scores"),
        (f"{PLOT} --kind series --where filter=none", "choose one with where fill_ratio=0.55|0.95"),
    ],
)
def test_what_cannot_be_shown_is_refused(line: str, reason: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(line.split()) == 2
    out, err = capsys.readouterr()
    assert reason in err and not out and err.count("\n") == 2
    assert not [*Path().glob("out.*")]
