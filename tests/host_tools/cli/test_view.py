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
from mcp_asdf_tools.common.signals import INTERRUPTED
from mcp_asdf_tools.experiments.experiment import Experiment
from mcp_asdf_tools.experiments.result_files import write_tables
from mcp_asdf_tools.experiments.result_tables import trials_to_table
from mcp_asdf_tools.experiments.trials import run_trials

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
    tables = [
        trials_to_table(run_trials(experiment, first=0, trials=2, sampling_interval=20))
        for experiment in experiments
    ]
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


def test_plot_draws_only_the_experiments_that_meet_all_conditions_of_where(
    tmp_path: Path, capsys: Capture
) -> None:
    """grid.parquet has four experiments, with two filters and two fill ratios; two conditions leave one."""
    picture = tmp_path / "x.svg"
    conditions = "--where filter=none --where fill_ratio=.950"
    line = f"plot grid.parquet {picture} --kind series {conditions} --json"
    assert main(line.split()) == 0

    report = json.loads(capsys.readouterr().out)
    assert report["experiments"] == 1, "number of experiments that were drawn"


def test_view_exports_a_log_of_60_steps_as_a_web_page_with_61_states(tmp_path: Path, capsys: Capture) -> None:
    """The page shows the state at the beginning and after each step, and names the swarm.

    With ``--json`` the command reports the page's file, size and number of states.
    """
    page = tmp_path / "run.html"
    assert main(["view", "run.log", "--export", str(page), "--json"]) == 0
    report = json.loads(capsys.readouterr().out)

    assert report == {"export": str(page), "bytes": page.stat().st_size, "states": 61}
    assert "5 robots, 2 flawed, ASDF+" in page.read_text()


def test_view_exports_a_trial_of_the_experiment_that_is_chosen_by_where(tmp_path: Path) -> None:
    """grid.parquet has experiments with two filters and two fill ratios.

    The title of the web page has the parameters of the experiment, and the number of the trial.
    """
    page = tmp_path / "run.html"
    line = f"view grid.parquet --where filter=none --where fill_ratio=.950 --trial 1 --export {page}"
    assert main(line.split()) == 0
    assert "5 robots, 2 flawed, no filter, fully connected, seed 1, trial 1" in page.read_text()


def test_view_shows_60_states_of_a_log_without_events_and_warns_of_what_is_missing(
    tmp_path: Path, capsys: Capture
) -> None:
    """The last of 60 steps begins after 5.9 s. The page shows a state every 0.1 s, from 0 on.

    Frames show x and b_hat of a robot only if it sends telemetry.
    """
    log = tmp_path / "real.log"
    shutil.copy("run.log", log)  # and not run.log.events
    assert main(["view", str(log), "--export", str(tmp_path / "run.html"), "--json"]) == 0
    output, warnings = capsys.readouterr()

    assert json.loads(output)["states"] == 60
    assert f"mcp-asdf view: there is no {log}.events, which swarm, radio and node write" in warnings
    assert "no robot sent telemetry" in warnings


@pytest.mark.parametrize(("options", "expects_warning"), [([], True), (["--channel", "can3"], False)])
def test_view_warns_that_a_log_has_frames_of_two_buses_unless_one_is_chosen(
    options: list[str], expects_warning: bool, tmp_path: Path, capsys: Capture
) -> None:
    """The log has the frames of run.log twice: of vcan0, and of can3. The page is always exported.

    Each bus may have other robots of the same ids, so a page of both would mix them up.
    """
    log = tmp_path / "any.log"
    frames_of_vcan0 = Path("run.log").read_text()
    frames_of_can3 = frames_of_vcan0.replace(" vcan0 ", " can3 ")
    log.write_text(frames_of_vcan0 + frames_of_can3)

    assert main(["view", str(log), *options, "--export", str(tmp_path / "all.html")]) == 0
    warning = f"{log} has frames of vcan0 and can3; choose one by --channel"
    has_warned = warning in capsys.readouterr().err
    assert has_warned == expects_warning


def test_view_of_a_log_without_events_warns_of_lines_that_are_no_frames(
    tmp_path: Path, capsys: Capture
) -> None:
    """Without the warning a user would not know that a page of a damaged log lacks frames.

    The log has a comment in front of the frames of run.log.
    """
    frames = Path("run.log").read_text()
    log = tmp_path / "real.log"
    log.write_text(f"# by hand\n{frames}")
    assert main(["view", str(log), "--export", str(tmp_path / "run.html")]) == 0

    warning = "line 1, '# by hand', is no frame and was left out"
    assert f"mcp-asdf view: of {log} {warning}\n" in capsys.readouterr().err


# --- Pages that are served -------------------------------------------------------------------------------


def read_events_at_printed_address(capsys: Capture) -> str:
    """Return all events of the web page whose address has been printed on standard error."""
    url = re.search(r"http://127\.0\.0\.1:\d+/", capsys.readouterr().err)
    assert url is not None
    with urlopen(f"{url[0]}events") as answer:
        events: bytes = answer.read()
    return events.decode()


@pytest.mark.parametrize(
    ("command", "options"), [("view", "run.log"), ("swarm", "--robots 4 --steps 20 --quiet --view")]
)
def test_a_command_serves_the_states_of_a_swarm_while_it_waits_for_ctrl_c(
    command: str, options: str, monkeypatch: pytest.MonkeyPatch, capsys: Capture
) -> None:
    """The commands are ``view run.log`` and ``swarm --view``. Here the page is read in place of the wait.

    A page reads its data as a stream of events.
    """
    event_streams: list[str] = []

    def read_page(_should_stop: Callable[[], bool]) -> None:
        event_streams.append(read_events_at_printed_address(capsys))

    monkeypatch.setattr(f"mcp_asdf_tools.cli.{command}.sleep_until", read_page)
    assert main([command, *options.split()]) == 0
    [served_events] = event_streams

    assert served_events.startswith("event: description\n")
    assert "\nevent: block\n" in served_events, "a block of states"
    assert served_events.endswith("event: end\ndata: null\n\n")


@pytest.fixture
def bus_without_network(monkeypatch: pytest.MonkeyPatch) -> None:
    """Let a bus inside this process stand in for any other, so that the test needs no network."""
    monkeypatch.setattr(BusChoice, "open", lambda *_, **__: can.Bus("watched", "virtual"))


@pytest.mark.usefixtures("bus_without_network")
def test_view_of_a_silent_bus_prints_the_page_s_address_and_that_no_robot_sent_telemetry(
    monkeypatch: pytest.MonkeyPatch, capsys: Capture
) -> None:
    """Ctrl-C ends it when it looks for the second time whether it should stop.

    No robot sends on the bus, which is one inside this process. The command looks by calling what
    ``with stopping() as should_stop`` gives it.
    """
    is_ctrl_c_pressed = Mock(side_effect=[False, True])
    monkeypatch.setattr(view, "stopping", Mock(return_value=nullcontext(is_ctrl_c_pressed)))
    assert main(["view", "--interface", "udp_multicast", "--channel", "239.74.163.77", "--json"]) == 0
    output, errors = capsys.readouterr()

    assert json.loads(output)["url"].startswith("http://127.0.0.1:")
    assert "no robot sent telemetry" in errors


@pytest.mark.usefixtures("bus_without_network")
def test_view_ends_with_exit_code_1_and_the_reason_when_the_bus_fails(
    monkeypatch: pytest.MonkeyPatch, capsys: Capture
) -> None:
    """A bus fails, for example, when its adapter is unplugged. Here the first attempt to read it fails."""
    raise_bus_error = Mock(side_effect=can.CanOperationError("it is off"))
    monkeypatch.setattr("mcp_asdf_tools.view.frame_history.record_bus", raise_bus_error)

    assert main(["view", "--interface", "udp_multicast", "--channel", "239.74.163.77"]) == 1
    assert "mcp-asdf view: the bus failed: it is off" in capsys.readouterr().err


def test_swarm_with_a_web_page_ends_with_an_error_and_does_not_wait_when_the_bus_fails(
    monkeypatch: pytest.MonkeyPatch, capsys: Capture
) -> None:
    """Only after a swarm that succeeds does the command serve the page until Ctrl-C."""
    raise_bus_error = Mock(side_effect=can.CanOperationError("it is off"))
    monkeypatch.setattr("mcp_asdf_tools.swarm.run.run_swarm", raise_bus_error)
    fail_instead_of_waiting = Mock(side_effect=AssertionError("it waits for Ctrl-C"))
    monkeypatch.setattr("mcp_asdf_tools.cli.swarm.sleep_until", fail_instead_of_waiting)

    assert main(["swarm", "--robots", "4", "--steps", "20", "--view"]) == 1
    assert "mcp-asdf swarm: it is off" in capsys.readouterr().err


def test_ctrl_c_that_ends_a_swarm_ends_its_page_too(monkeypatch: pytest.MonkeyPatch, capsys: Capture) -> None:
    """The command does not wait for a second Ctrl-C, as the printed line with the address says.

    It looks for Ctrl-C by calling what ``with stopping() as should_stop`` gives it.
    """
    is_ctrl_c_pressed = Mock(return_value=True)
    stopping = Mock(return_value=nullcontext(is_ctrl_c_pressed))
    monkeypatch.setattr("mcp_asdf_tools.cli.swarm.stopping", stopping)
    fail_instead_of_waiting = Mock(side_effect=AssertionError("it waits for Ctrl-C"))
    monkeypatch.setattr("mcp_asdf_tools.cli.swarm.sleep_until", fail_instead_of_waiting)

    assert main(["swarm", "--robots", "4", "--steps", "20", "--view"]) == INTERRUPTED
    assert "(Ctrl-C ends it)" in capsys.readouterr().err


# --- Wrong usage -----------------------------------------------------------------------------------------

VIEW = "view grid.parquet --export out.html"
PLOT = "plot grid.parquet out.svg"
DIFFERENCES = "fill_ratio=0.55|0.95, filter=asdf-plus|none"


@pytest.mark.parametrize(
    ("refused_line", "expected_reason"),
    [
        ("view", "there is no recording and no bus; give a file"),
        ("view --export out.html --interface socketcan --channel nowhere0", "--export is for recordings"),
        ("view --where filter=none --interface socketcan --channel nowhere0", "--where is for recordings"),
        ("view --trial 0 --interface socketcan --channel nowhere0", "--trial is for recordings"),
        ("view none.log", "there is no log"),
        ("view none.log --export no/such/out.html", "its folder does not exist"),
        ("view none.parquet", "cannot read"),
        (VIEW, f"4 experiments match; choose one with where {DIFFERENCES}"),
        (f"{VIEW} --where filter=none --where fill_ratio=.950 --trial 9", "no trial 9; choose one of 0 to 1"),
        ("view run.log --export out.html --trial 0", "--trial and --where choose from results"),
        ("view run.log --export out.html --where filter=none", "--trial and --where choose from results"),
        ("view run.log --export out.pdf", "choose a name that ends in .html"),
        ("view run.log --port 99999", "--port is 99999"),
        ("view run.log --export out.html --port 0", "--port is for a page that is served"),
        ("view run.log --fill-ratio 0.5", "--fill-ratio is for a bus, but run.log is a recording"),
        ("view run.log --true-accuracy 0.5", "--true-accuracy is for a bus"),
        ("view run.log --subject 9", "--subject is for a bus"),
        ("view run.log -ivirtual", "--interface is for a bus"),
        ("view run.log -b 500000", "--bitrate is for a bus"),
        ("view run.log --bus-kwargs a=b", "--bus-kwargs is for a bus"),
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
def test_view_plot_and_swarm_refuse_what_they_cannot_show_in_two_lines_and_write_no_file(
    refused_line: str, expected_reason: str, capsys: Capture
) -> None:
    """The reason for ``view run.log --export out.pdf`` is "choose a name that ends in .html", for example.

    The pages and pictures that these commands would write are called out.html or out.svg.
    """
    assert main(refused_line.split()) == 2
    output, errors = capsys.readouterr()

    assert output == ""
    assert expected_reason in errors
    assert errors.count("\n") == 2, "two lines"
    assert list(Path().glob("out.*")) == []
