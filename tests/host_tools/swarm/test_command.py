"""``mcp-asdf swarm``: its files and what it prints, and every way to end."""

from __future__ import annotations

import json
import os
import re
import shlex
import signal
from dataclasses import replace
from io import StringIO
from pathlib import Path
from typing import Any

import can
import numpy as np
import pytest
from can.interfaces import virtual
from rich.console import Console

from host_tools.swarm.swarms import content, record, small
from mcp_asdf_tools.cli.main import main
from mcp_asdf_tools.common.parameters import parameters_of
from mcp_asdf_tools.experiments.engine import native
from mcp_asdf_tools.experiments.experiment import Experiment
from mcp_asdf_tools.robots.filters import FILTERS
from mcp_asdf_tools.swarm import carrier as connection
from mcp_asdf_tools.swarm.live_view import LiveView
from mcp_asdf_tools.swarm.settings import SwarmSettings
from mcp_asdf_tools.swarm.summary import one_line, summary, summary_table
from mcp_asdf_tools.swarm.swarm import Swarm
from support import ROOT, interruptible

pytestmark = pytest.mark.usefixtures("private_setup")

SMALL = ("--robots", "4", "--steps", "30", "--filter-period", "10")


def command(*arguments: str | Path) -> int:
    return main(["swarm", *SMALL, *map(str, arguments)])


def test_a_run_is_in_its_files(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """A log of every frame, and beside it what is printed as JSON; and so in every run."""
    _, frames = record(SwarmSettings(robots=4, steps=30, filter_period=10))
    log, beside = tmp_path / "my.run.log", tmp_path / "my.run.log.json"
    assert command("--json", "--log", log, "--channel", "mine") == 0
    report = json.loads(capsys.readouterr().out)
    assert report["parameters"]["seed"] == 1
    assert report["parameters"]["frames"] == {"subject": 3000, "priority": 4}
    assert report["bus"] == {"interface": "virtual", "channel": "mine", "slcan": None}
    assert report["results"]["frames"]["delivered"] == 30 * 4 * 3
    assert json.loads(beside.read_text()) == report
    with can.LogReader(log) as reader:
        read = list(reader)
    assert content(read) == content(frames)
    assert {frame.channel for frame in read} == {"mine"}
    first = read[0].timestamp
    assert [round(frame.timestamp - first, 3) for frame in read] == [round(f.timestamp, 3) for f in frames]
    made = {path: path.read_bytes() for path in tmp_path.iterdir()}
    assert made.keys() == {log, beside, Path(f"{log}.events")}
    assert command("--json", "--log", log, "--channel", "mine") == 0
    assert {path: path.read_bytes() for path in tmp_path.iterdir()} == made


def test_what_is_piped_is_fields_or_a_line(capsys: pytest.CaptureFixture[str]) -> None:
    assert command("--seed", "42") == 0
    *lines, again = capsys.readouterr().out.splitlines()
    assert again.startswith("again: mcp-asdf swarm ") and again.endswith("--seed 42")
    names = [line.split("\t")[0] for line in lines]
    assert names[-6:] == ["estimate", "b_hat, flawed", "b_hat, other", "filter", "frames", "bus load"]
    assert set(names[:-7]) <= {"step", "robot"}
    assert command("--seed", "42", "--quiet") == 0
    shown = capsys.readouterr().out
    assert shown.startswith("seed 42: ") and shown.count("\n") == 1


OTHER_RESULTS: dict[str, Any] = {
    "tests": None,
    "clock": {"mean_lateness": 0.001, "max_lateness": 0.02, "drift": -0.0005, "late_ticks": 3},
}
"""Of robots elsewhere, in real time."""
SUMMARY = """\
run\t60 of 60 steps in 1.3 s; interrupted
estimate\tmean x 0.50078, f 0.55, mean error 0.04922, spread of x 0.05334, of x_hat 0.15370
b_hat, flawed\tno such robots
b_hat, other\t0.9500 -> 0.9667 (0.9500 to 1.0000, 3 robots; b 0.95)
filter\tASDF+: all robots recalibrate; an unknown number of tests, 2 updates
frames\t180 messages and 18 heartbeats sent on vcan0, 337 messages delivered, 25 frames rejected, 98 \
messages refused, 0 strays
arrived\t396 of 396 frames, 100.0%; 198 on the bus
fault\tcorrupt=0.5,receivers=0,bits=5: 62 injected
fault\tcollide=1.0,robots=2,id=1: 66 injected
robot 0\t97 messages delivered; 16 MULTI_FRAME, 3 X_HAT, 4 ALPHA, 2 SUBJECT, 38 refused
robot 1\t120 messages delivered; 60 refused
node-id conflict\tanother node sent 60 messages as robot 1; give it a free id
clock\tticks began 1.000 ms late on average, 20.000 ms at most, 3 of them by more than half a tick; drift \
-0.500 ms; 0 frames late or lost
bus load\t125 kbit/s 4.2% (peak 8%), 250 kbit/s 2.1% (peak 4%), 500 kbit/s 1.1% (peak 2%), 1 Mbit/s 0.5% \
(peak 1%)"""


def test_a_summary_has_all_that_is_worth_telling() -> None:
    """Faults, conflicts, the clock and robots in trouble, too; nothing is said of what there is not."""
    run, _ = record(small("corrupt=0.5,bits=5,receivers=0", "collide,robots=2,id=1", robots=3, flawed=0))
    run.results |= OTHER_RESULTS
    run.interrupted = True
    assert ["\t".join(row) for row in summary(run, "vcan0", 1.26)] == SUMMARY.split("\n")
    assert (
        one_line(run) == "seed 11: 3 robots, ASDF+, 60 steps, mean error 0.04922, spread 0.05334; interrupted"
    )
    run, _ = record(small(robots=3))
    run.failure = "tick 41: bus off"
    rows = dict(summary(run, "vcan0", 1.26))
    assert rows["run"] == "60 of 60 steps in 1.3 s; failed in tick 41: bus off"
    assert [*rows][4:] == ["filter", "frames", "bus load"]


def test_a_summary_is_a_table_with_bold_names() -> None:
    shown = Console(width=31, file=StringIO(), force_terminal=True, color_system="standard", _environ={})
    shown.print(summary_table([("node-id conflict", "another node [b]")]))
    assert isinstance(shown.file, StringIO)
    assert shown.file.getvalue() == (
        "\x1b[1m \x1b[0m\x1b[1mnode-id conflict\x1b[0m\x1b[1m \x1b[0m another     \n"
        "\x1b[1m                  \x1b[0m node [b]    \n"
    )


def test_swarm_has_an_option_for_every_parameter(capsys: pytest.CaptureFixture[str]) -> None:
    assert command("--help") == 0
    options = re.findall(r"^  (--[a-z-]+)", capsys.readouterr().out, re.MULTILINE)
    assert {f"--{name.replace('_', '-')}" for name in parameters_of(SwarmSettings)} <= set(options)


def test_swarm_reports_the_parameters_that_its_options_set(capsys: pytest.CaptureFixture[str]) -> None:
    assert command("--latency", "1", "--flawed-accuracy", "0.5", "--activation=always", "--json") == 0
    parameters = json.loads(capsys.readouterr().out)["parameters"]
    assert parameters["latency"] == 1
    assert parameters["flawed_accuracy"] == 0.5
    assert parameters["activation"] == "always"


def test_swarm_sends_estimates_in_the_format_that_its_options_set(
    capsys: pytest.CaptureFixture[str],
) -> None:
    assert command("--subject", "17", "--priority", "6", "--json") == 0
    assert json.loads(capsys.readouterr().out)["parameters"]["frames"] == {"subject": 17, "priority": 6}


def test_a_free_port_is_told_beside_the_json(capsys: pytest.CaptureFixture[str]) -> None:
    assert command("--slcan", "0", "--json") == 0
    out, err = capsys.readouterr()
    port = json.loads(out)["bus"]["slcan"]
    assert err == f"the bus is an slcan adapter, too: socket://127.0.0.1:{port}\n"
    assert port > 0


@pytest.mark.parametrize(("rate", "told"), [("300", "500 kbit/s"), ("30", "")])
def test_a_busy_bus_is_warned_of(rate: str, told: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert command("--robots", "10", "--steps-per-second", rate) == 0
    warned = f"a real bus at {told} or less would be busy for more than 70% of the time"
    assert (warned in capsys.readouterr().err) == bool(told)


DEVICE, MULTICAST = "--device 1=virtual:a --channel v{robot}", "--processes --interface udp_multicast"
BAD = {
    "--robots 127 --slcan 0": "with --slcan take at most 126",
    "--slcan 0 --channel vcan{robot}": "--slcan needs one bus for all",
    "--radio-range 1": "--radio-range is 1.0 but robots do not move; choose topology dynamic",
    "--subject 6144": "subject is 6144",
    "--latency": "argument --latency: expected one argument",
    "--omga=0.1": "no such option: --omga=0.1; did you mean --omega?",
    "--latency one": "argument --latency: invalid int value: 'one'",
    "--speed fast": "argument --speed: invalid float value: 'fast'",
    "--set omega=0.1": "no such option: --set",
    f"{MULTICAST} --compare": "but robots elsewhere run once; leave it out",
    "--log no/such/folder/run.log": "cannot write no/such/folder/run.log: its folder does not exist",
    "--interface nonsense": "nonsense",
    "--interface socketcan --channel nowhere0": "socketcan nowhere0",
    "--processes": "inside this process, so no other can join it",
    "--processes --device 1=virtual:a": "not allowed with",
    "--device 1": "device is '1'; write ID=INTERFACE:CHANNEL",
    "--device 1=nonsense:x": "device is '1=nonsense:x'",
    "--device one=virtual:a": "device is 'one=virtual",
    "--device 1=virtual:a": "robots here and elsewhere need a bus each: write {robot}",
    f"{DEVICE} --device 1=virtual:b": "two devices are one robot",
    f"{DEVICE} --subject 3002": "choose three different ones",
    f"{DEVICE} --robots 127": "at most 126, since id 126 commands",
    f"{DEVICE} --device 7=virtual:a": "robot 7 is to run elsewhere, but ids are 0 to 3",
    f"{DEVICE} --fault crash,robots=1+2": "cannot affect robots that run elsewhere",
    "--device 1=slcan:socket://127.0.0.1:1 --channel v{robot}": "cannot open the bus slcan socket://127.0.0.1",
    f"{MULTICAST} --fault loss": "for faults, latency or a topology write {robot}",
    f"{MULTICAST} --latency 1": "for faults, latency or a topology write {robot}",
    f"{MULTICAST} --topology dynamic": "for faults, latency or a topology write {robot}",
}


@pytest.mark.parametrize("arguments", BAD)
def test_bad_usage(
    arguments: str, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    monkeypatch.chdir(tmp_path)
    assert command(*shlex.split(arguments)) == 2
    out, err = capsys.readouterr()
    assert BAD[arguments] in err and out == ""
    assert list(tmp_path.iterdir()) == []


OUTPUTS = {"run.log", "run.log.events", "run.log.json"}


@pytest.mark.parametrize("obstructed", sorted(OUTPUTS))
def test_what_cannot_be_written_is_told_before_the_first_tick(
    obstructed: str, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    monkeypatch.setattr(Swarm, "tick", lambda self: pytest.fail("it ran"))
    (tmp_path / obstructed).mkdir()
    assert command("--log", tmp_path / "run.log") == 2
    assert f"cannot write {tmp_path / obstructed}: it is not a regular file" in capsys.readouterr().err
    assert [*tmp_path.iterdir()] == [tmp_path / obstructed]


@interruptible()
def test_a_signal_saves_what_is_done(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    def interrupt(view: LiveView, swarm: Swarm) -> None:
        if swarm.ticks == 7:
            os.kill(os.getpid(), signal.SIGTERM)

    monkeypatch.setattr(LiveView, "__call__", interrupt)
    log = tmp_path / "run.log"
    assert command("--json", "--log", log) == 143
    report = json.loads(capsys.readouterr().out)
    assert report["interrupted"]
    assert report["results"]["steps"] == 7
    assert len(log.read_text().splitlines()) == 4 * (7 + 1)
    assert json.loads(Path(f"{log}.json").read_text()) == report


def test_a_failing_bus_gives_exit_code_1_and_saves_what_is_done(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    usual = virtual.VirtualBus.send

    def send(bus: virtual.VirtualBus, frame: can.Message, timeout: float) -> None:
        if frame.timestamp > 0.75:
            raise can.CanOperationError("bus off")
        usual(bus, frame, timeout)

    monkeypatch.setattr(virtual.VirtualBus, "send", send)
    log = tmp_path / "run.log"
    assert command("--bus-kwargs", "preserve_timestamps=True", "--log", log) == 1
    assert "failed in tick 9: bus off" in capsys.readouterr().err
    assert len(log.read_text().splitlines()) == 4 * (8 + 1)


def test_a_bus_that_takes_no_more_frames_does_not_block_for_ever(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(connection, "FRAME_TIMEOUT", 0.05)
    assert command("--bus-kwargs", "rx_queue_size=2") == 1
    assert "failed in tick 1: Could not send" in capsys.readouterr().err


def test_results_that_cannot_be_written_cost_neither_the_summary_nor_the_log(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    obstruct = (tmp_path / "run.log.json").mkdir
    monkeypatch.setattr(LiveView, "__call__", lambda self, swarm: obstruct(exist_ok=True))
    assert command("--quiet", "--log", tmp_path / "run.log") == 2
    out, err = capsys.readouterr()
    assert out.startswith("seed 1: 4 robots, ASDF-, 30 steps")
    assert f"cannot write {tmp_path}/run.log.json" in err
    assert {path.name for path in tmp_path.iterdir()} == OUTPUTS


# The same swarm with other filters

COMPARED = ["swarm", "--robots", "8", "--steps", "600", "--filter-period", "100", "--flawed", "50%"]


@pytest.mark.slow
@pytest.mark.parametrize("own", ["asdf-plus", "none", "asdf-minus", "robust"])
def test_the_other_runs_are_the_same_swarm_with_other_filters(
    own: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Two sentences say what each filter is good for, and the log is that of the run with its own."""
    log = tmp_path / "run.log"
    assert main([*COMPARED, "--filter", own, "--compare", "--quiet", "--log", str(log)]) == 0
    said = capsys.readouterr().out.splitlines()[-1]
    report = json.loads(Path(f"{log}.json").read_text())
    found = {own: report["results"]} | report["compared"]
    assert found.keys() == {"none", "asdf-minus", "robust", own} <= {*FILTERS}
    for each, results in found.items():
        assert main([*COMPARED, "--filter", each, "--json"]) == 0
        assert results == json.loads(capsys.readouterr().out)["results"]
        assert f"{FILTERS[each].term} {results['mean_error']:.3f}" in said.split(": ")[1]
        b_hat = f"{FILTERS[each].term} {results['b_hat']['flawed']['after']:.2f}"
        assert (b_hat in said.split(": ")[2]) == (each != "none")
    assert said.split(": ")[2].startswith("ASDF- ") and said.endswith(".")
    assert "took their sensors for 0.55 accurate" in said
    assert main(["replay", str(log)]) == 0


def test_a_comparison_without_flawed_robots_has_errors_alone(capsys: pytest.CaptureFixture[str]) -> None:
    options = ("--omega", "0.1", "--flawed", "0", "--compare", "--steps", "100")
    assert main([*COMPARED, *options, "--quiet"]) == 0
    assert "flawed" not in capsys.readouterr().out.splitlines()[-1]
    assert main([*COMPARED, *options, "--json"]) == 0
    assert "compared" in json.loads(capsys.readouterr().out)


def test_a_comparison_says_where_no_filter_is_needed(capsys: pytest.CaptureFixture[str]) -> None:
    """As docs/advice.md has it: fully connected and underconfident."""
    overconfident = "--true-accuracy 0.55 --flawed-accuracy 0.9"
    for options, needs_none in (("", True), ("--topology dynamic", False), (overconfident, False)):
        assert main([*COMPARED, "--steps", "100", *options.split(), "--compare", "--quiet"]) == 0
        assert ("This swarm needs no filter" in capsys.readouterr().out) == needs_none, options


def test_the_figures_of_the_readme_are_those_of_its_first_command() -> None:
    """Computed by the engine, since a swarm is trial 0 of the experiment with the same parameters."""
    common = Experiment(topology="dynamic", filter="asdf-minus", flawed="50%", trials=1)

    def error(experiment: Experiment) -> float:
        x = native.run(experiment, 0, 1).x[0, :, -1] / 2**23
        return float(np.abs(x - experiment.fill_ratio).mean())

    errors = [error(replace(common, filter=each)) for each in ("asdf-minus", "none", "robust")]
    readme = " ".join((ROOT / "README.md").read_text(encoding="utf-8").split())
    assert f"is {errors[0]:.3f} at the end; without it, on the same seed, {errors[1]:.3f};" in readme
    assert f"[robust filter](docs/robust.md) {errors[2]:.3f}." in readme
