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

from mcp_asdf_tools.bus.interfaces import BusChoice
from mcp_asdf_tools.cli import view
from mcp_asdf_tools.cli.main import main
from mcp_asdf_tools.cli.output import sleep_until
from mcp_asdf_tools.common.signals import INTERRUPTED
from mcp_asdf_tools.experiments.experiment import Experiment
from mcp_asdf_tools.experiments.result_files import write_tables
from mcp_asdf_tools.experiments.result_tables import trials_to_table
from mcp_asdf_tools.experiments.trials import run_trials
from mcp_asdf_tools.view.bus_recorder import BusRecorder

Capture = pytest.CaptureFixture[str]


@pytest.fixture(scope="module")
def recordings(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with run.log, a swarm's log, and grid.parquet, results of four experiments of two trials.

    Filter and fill ratio of the experiments differ; values are kept every 20 steps.
    """
    folder = tmp_path_factory.mktemp("recordings")
    common = Experiment(robots=5, filter="asdf-plus", steps=60, filter_period=20, trials=2)
    experiments = [
        replace(common, filter=filter_name, fill_ratio=fill_ratio)
        for fill_ratio in (0.55, 0.95)
        for filter_name in ("none", "asdf-plus")
    ]
    tables = [trials_to_table(run_trials(experiment, 0, 2, 20)) for experiment in experiments]
    write_tables(folder / "grid.parquet", [pa.concat_tables(tables)])
    swarm = "swarm --robots 5 --filter asdf-plus --steps 60 --filter-period 20 --quiet --log"
    assert main([*swarm.split(), str(folder / "run.log")]) == 0
    return folder


@pytest.fixture(autouse=True)
def work_beside_the_recordings(recordings: Path, monkeypatch: pytest.MonkeyPatch, capsys: Capture) -> None:
    """Let commands find run.log and grid.parquet in their folder."""
    monkeypatch.chdir(recordings)
    capsys.readouterr()  # what the fixture of the recordings has printed


# --- Recordings ------------------------------------------------------------------------------------------

ONE_EXPERIMENT = "--where filter=none --where fill_ratio=.950"


@pytest.mark.parametrize(
    ("options", "count"),
    [
        ("", 4),
        ("--where fill_ratio=0.95", 2),
        (f"--kind series {ONE_EXPERIMENT} --where robots=5", 1),
    ],
)
def test_plot_draws_the_experiments_that_meet_all_conditions(
    options: str, count: int, tmp_path: Path, capsys: Capture
) -> None:
    assert main(["plot", "grid.parquet", str(tmp_path / "x.svg"), "--json", *options.split()]) == 0
    assert json.loads(capsys.readouterr().out)["experiments"] == count


@pytest.mark.parametrize(
    ("recording", "filter_term"),
    [("run.log", "ASDF+"), (f"grid.parquet {ONE_EXPERIMENT} --trial 1", "no filter")],
)
def test_view_exports_a_log_or_a_trial_as_one_page(
    recording: str, filter_term: str, tmp_path: Path, capsys: Capture
) -> None:
    page = tmp_path / "run.html"
    assert main(["view", *recording.split(), "--export", str(page), "--json"]) == 0
    report = json.loads(capsys.readouterr().out)

    assert report == {"export": str(page), "bytes": page.stat().st_size, "states": 61}
    assert f"5 robots, 2 flawed, {filter_term}" in page.read_text()


def test_view_of_a_log_without_events_shows_what_its_frames_say(tmp_path: Path, capsys: Capture) -> None:
    log = tmp_path / "real.log"
    shutil.copy("run.log", log)
    assert main(["view", str(log), "--export", str(tmp_path / "run.html"), "--json"]) == 0
    output, errors = capsys.readouterr()

    assert json.loads(output)["states"] == 61
    assert f"mcp-asdf view: there is no {log}.events, which swarm, radio and node write" in errors
    assert "no robot sent telemetry" in errors


@pytest.fixture
def log_of_two_buses(tmp_path: Path) -> Path:
    """A log without events that has the frames of run.log twice, of vcan0 and of can3."""
    log = tmp_path / "any.log"
    text = Path("run.log").read_text()
    log.write_text(text + text.replace(" vcan0 ", " can3 "))
    return log


def test_view_of_a_log_of_two_buses_asks_to_choose_one(
    log_of_two_buses: Path, tmp_path: Path, capsys: Capture
) -> None:
    assert main(["view", str(log_of_two_buses), "--export", str(tmp_path / "all.html")]) == 0
    expected = f"{log_of_two_buses} has frames of vcan0 and can3; choose one by --channel"
    assert expected in capsys.readouterr().err


def test_view_of_one_bus_of_a_log_asks_for_nothing(
    log_of_two_buses: Path, tmp_path: Path, capsys: Capture
) -> None:
    command = ["view", str(log_of_two_buses), "--channel", "can3", "--export", str(tmp_path / "one.html")]
    assert main(command) == 0
    assert "choose one" not in capsys.readouterr().err


# --- Pages that are served -------------------------------------------------------------------------------


@pytest.mark.parametrize("line", ["view run.log", "swarm --robots 4 --steps 20 --quiet --view"])
def test_a_page_is_served_until_ctrl_c(line: str, monkeypatch: pytest.MonkeyPatch, capsys: Capture) -> None:
    served: list[str] = []

    def read_page(should_stop: Callable[[], bool]) -> None:
        assert not should_stop()
        url = re.search(r"http://127\.0\.0\.1:\d+/", capsys.readouterr().err)
        assert url is not None
        served.append(urlopen(f"{url[0]}events").read().decode())

    command = line.split(maxsplit=1)[0]
    monkeypatch.setattr(f"mcp_asdf_tools.cli.{command}.sleep_until", read_page)
    assert main(line.split()) == 0
    assert served[0].startswith("event: description\n")
    assert served[0].endswith("event: end\ndata: null\n\n")


def test_a_command_sleeps_until_it_is_asked_to_stop(monkeypatch: pytest.MonkeyPatch) -> None:
    naps: list[float] = []
    monkeypatch.setattr("time.sleep", naps.append)
    answers = iter([False, False, True])
    sleep_until(lambda: next(answers))

    between_questions = 0.2  # seconds
    assert naps == [between_questions, between_questions]


WATCH_A_BUS = ["view", "--interface", "udp_multicast", "--channel", "239.74.163.77"]


@pytest.fixture
def bus_without_network(monkeypatch: pytest.MonkeyPatch) -> None:
    """Let a bus inside this process stand in for any other, so that the test needs no network."""
    monkeypatch.setattr(BusChoice, "open", lambda *_, **__: can.Bus("watched", "virtual"))


@pytest.mark.usefixtures("bus_without_network")
def test_view_of_a_bus_prints_its_address_and_that_nobody_sent_telemetry(
    monkeypatch: pytest.MonkeyPatch, capsys: Capture
) -> None:
    answers = iter([False, True])
    monkeypatch.setattr(view, "stopping", lambda: nullcontext(lambda: next(answers)))
    assert main([*WATCH_A_BUS, "--json"]) == 0
    output, errors = capsys.readouterr()

    assert json.loads(output)["url"].startswith("http://127.0.0.1:")
    assert "no robot sent telemetry" in errors


@pytest.mark.usefixtures("bus_without_network")
def test_view_reports_a_bus_that_fails(monkeypatch: pytest.MonkeyPatch, capsys: Capture) -> None:
    monkeypatch.setattr(BusRecorder, "record", Mock(side_effect=can.CanOperationError("it is off")))
    assert main(WATCH_A_BUS) == 1
    assert "mcp-asdf view: the bus failed: it is off" in capsys.readouterr().err


def test_swarm_does_not_keep_the_page_of_a_bus_that_fails(
    monkeypatch: pytest.MonkeyPatch, capsys: Capture
) -> None:
    """After a run that succeeds it serves the page until Ctrl-C; here it must end, and with an error."""
    failure = Mock(side_effect=can.CanOperationError("it is off"))
    monkeypatch.setattr("mcp_asdf_tools.swarm.run.run_swarm", failure)
    waiting = Mock(side_effect=AssertionError("it waits for Ctrl-C"))
    monkeypatch.setattr("mcp_asdf_tools.cli.swarm.sleep_until", waiting)

    assert main(["swarm", "--robots", "4", "--steps", "20", "--view"]) == 1
    assert "mcp-asdf swarm: it is off" in capsys.readouterr().err


def test_ctrl_c_that_ends_a_swarm_ends_its_page_too(monkeypatch: pytest.MonkeyPatch, capsys: Capture) -> None:
    """As the printed line with the address says: the command does not wait for a second Ctrl-C."""
    monkeypatch.setattr("mcp_asdf_tools.cli.swarm.stopping", lambda: nullcontext(lambda: True))
    waiting = Mock(side_effect=AssertionError("it waits for Ctrl-C"))
    monkeypatch.setattr("mcp_asdf_tools.cli.swarm.sleep_until", waiting)

    assert main(["swarm", "--robots", "4", "--steps", "20", "--view"]) == INTERRUPTED
    assert "(Ctrl-C ends it)" in capsys.readouterr().err


# --- Wrong usage -----------------------------------------------------------------------------------------

VIEW = "view grid.parquet --export out.html"
PLOT = "plot grid.parquet out.svg"
DIFFERENCES = "fill_ratio=0.55|0.95, filter=asdf-plus|none"


@pytest.mark.parametrize(
    ("line", "reason"),
    [
        ("view", "there is no recording and no bus; give a file"),
        ("view --export x.html --interface udp_multicast", "--export is for recordings"),
        ("view none.log", "there is no log"),
        ("view none.log --export no/such/out.html", "its folder does not exist"),
        ("view none.parquet", "cannot read"),
        (VIEW, f"4 experiments match; choose one with where {DIFFERENCES}"),
        (f"{VIEW} {ONE_EXPERIMENT} --trial 9", "no trial 9; choose one of 0 to 1"),
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
        (f"{PLOT} --where filter", f"differ in {DIFFERENCES}"),
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
def test_what_cannot_be_shown_is_refused_in_two_lines(line: str, reason: str, capsys: Capture) -> None:
    assert main(line.split()) == 2
    output, errors = capsys.readouterr()

    assert output == ""
    assert reason in errors
    assert errors.count("\n") == 2
    assert list(Path().glob("out.*")) == []
