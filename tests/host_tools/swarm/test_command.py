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

from host_tools.swarm.swarms import identifiers_and_data, run_and_record, small_swarm
from mcp_asdf_tools.cli.main import main
from mcp_asdf_tools.common.parameters import parameters_of
from mcp_asdf_tools.experiments.engine import native
from mcp_asdf_tools.experiments.experiment import Experiment
from mcp_asdf_tools.swarm import carrier
from mcp_asdf_tools.swarm.live_view import LiveView
from mcp_asdf_tools.swarm.settings import SwarmSettings
from mcp_asdf_tools.swarm.summary import one_line, summary, summary_table
from mcp_asdf_tools.swarm.swarm import Swarm
from support import ROOT, block_with, interruptible

pytestmark = pytest.mark.usefixtures("private_setup")

Capture = pytest.CaptureFixture[str]
SMALL = ("--robots", "4", "--steps", "30", "--filter-period", "10")
SMALL_SETTINGS = SwarmSettings(robots=4, steps=30, filter_period=10)
"""The swarm of these options."""


def run_swarm_command(*arguments: str | Path) -> int:
    """Run ``mcp-asdf swarm`` with a small swarm; return its exit code."""
    return main(["swarm", *SMALL, *map(str, arguments)])


def json_report(capsys: Capture, *arguments: str | Path) -> dict[str, Any]:
    """Run the command with --json, which has to succeed, and return what it prints."""
    assert run_swarm_command("--json", *arguments) == 0
    report: dict[str, Any] = json.loads(capsys.readouterr().out)
    return report


# --- Files and reports -----------------------------------------------------------------------------------


def test_the_report_has_parameters_bus_and_results(capsys: Capture) -> None:
    report = json_report(capsys, "--channel", "mine")
    assert report["parameters"]["seed"] == 1
    assert report["parameters"]["frames"] == {"subject": 3000, "priority": 4}
    assert report["bus"] == {"interface": "virtual", "channel": "mine", "slcan": None}
    ticks, robots, receivers = 30, 4, 3
    assert report["results"]["frames"]["delivered"] == ticks * robots * receivers


def test_the_file_beside_a_log_has_the_report(tmp_path: Path, capsys: Capture) -> None:
    report = json_report(capsys, "--log", tmp_path / "my.run.log")
    assert json.loads((tmp_path / "my.run.log.json").read_text()) == report


def test_the_log_has_every_frame_with_channel_and_time(tmp_path: Path) -> None:
    _, sent_frames = run_and_record(SMALL_SETTINGS)
    log = tmp_path / "my.run.log"
    assert run_swarm_command("--quiet", "--log", log, "--channel", "mine") == 0
    with can.LogReader(log) as reader:
        logged_frames = list(reader)
    assert identifiers_and_data(logged_frames) == identifiers_and_data(sent_frames)
    assert {frame.channel for frame in logged_frames} == {"mine"}
    start = logged_frames[0].timestamp
    logged_times = [round(frame.timestamp - start, 3) for frame in logged_frames]

    assert logged_times == [round(frame.timestamp, 3) for frame in sent_frames]


def test_the_same_command_writes_the_same_files(tmp_path: Path) -> None:
    contents = []
    for _ in range(2):
        assert run_swarm_command("--quiet", "--log", tmp_path / "run.log") == 0
        contents.append({path.name: path.read_bytes() for path in tmp_path.iterdir()})

    assert contents[0].keys() == {"run.log", "run.log.events", "run.log.json"}
    assert contents[0] == contents[1]


# --- Summaries -------------------------------------------------------------------------------------------


def test_a_piped_summary_has_a_name_and_a_tab_in_each_line(capsys: Capture) -> None:
    assert run_swarm_command("--seed", "42") == 0
    *lines, _ = capsys.readouterr().out.splitlines()
    names = [line.split("\t")[0] for line in lines]

    # Lines while the run goes on, and then those of the summary
    start_of_summary = names.index("run")
    assert set(names[:start_of_summary]) <= {"step", "robot"}
    assert names[start_of_summary:] == [
        "run",
        "estimate",
        "b_hat, flawed",
        "b_hat, other",
        "filter",
        "frames",
        "bus load",
    ]


def test_a_summary_ends_with_the_line_for_the_same_run(capsys: Capture) -> None:
    assert run_swarm_command("--seed", "42") == 0
    last_line = capsys.readouterr().out.splitlines()[-1]
    assert last_line == f"again: mcp-asdf swarm {' '.join(SMALL)} --seed 42"


def test_quiet_prints_one_line(capsys: Capture) -> None:
    assert run_swarm_command("--seed", "42", "--quiet") == 0
    output = capsys.readouterr().out
    assert output.startswith("seed 42: ")
    assert output.count("\n") == 1


RESULTS_IN_REAL_TIME: dict[str, Any] = {
    "tests": None,
    "clock": {"mean_lateness": 0.001, "max_lateness": 0.02, "drift": -0.0005, "late_ticks": 3},
}
"""Results that only a swarm of robots elsewhere, in real time, has."""
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


def test_a_summary_has_faults_conflicts_the_clock_and_robots_in_trouble() -> None:
    run, _ = run_and_record(
        small_swarm("corrupt=0.5,bits=5,receivers=0", "collide,robots=2,id=1", robots=3, flawed=0)
    )
    run.results |= RESULTS_IN_REAL_TIME
    run.interrupted = True
    assert ["\t".join(row) for row in summary(run, "vcan0", 1.26)] == SUMMARY.split("\n")


def test_the_summary_in_one_line_says_that_the_run_was_interrupted() -> None:
    run, _ = run_and_record(
        small_swarm("corrupt=0.5,bits=5,receivers=0", "collide,robots=2,id=1", robots=3, flawed=0)
    )
    run.interrupted = True

    assert (
        one_line(run) == "seed 11: 3 robots, ASDF+, 60 steps, mean error 0.04922, spread 0.05334; interrupted"
    )


def test_a_summary_says_what_failed() -> None:
    run, _ = run_and_record(small_swarm(robots=3))
    run.failure = "tick 41: bus off"
    assert dict(summary(run, "vcan0", 1.26))["run"] == "60 of 60 steps in 1.3 s; failed in tick 41: bus off"


def test_a_summary_of_a_run_without_faults_has_no_lines_about_faults() -> None:
    run, _ = run_and_record(small_swarm(robots=3))
    names = [name for name, _ in summary(run, "vcan0", 1.26)]
    assert names == ["run", "estimate", "b_hat, flawed", "b_hat, other", "filter", "frames", "bus load"]


def test_a_summary_is_a_table_with_bold_names() -> None:
    output = StringIO()
    console = Console(width=31, file=output, force_terminal=True, color_system="standard", _environ={})
    console.print(summary_table([("node-id conflict", "another node [b]")]))

    assert output.getvalue() == (
        "\x1b[1m \x1b[0m\x1b[1mnode-id conflict\x1b[0m\x1b[1m \x1b[0m another     \n"
        "\x1b[1m                  \x1b[0m node [b]    \n"
    )


# --- Options ---------------------------------------------------------------------------------------------


def test_swarm_has_an_option_for_every_parameter(capsys: Capture) -> None:
    assert run_swarm_command("--help") == 0
    options = re.findall(r"^  (--[a-z-]+)", capsys.readouterr().out, re.MULTILINE)
    assert {f"--{name.replace('_', '-')}" for name in parameters_of(SwarmSettings)} <= set(options)


def test_swarm_reports_the_parameters_that_its_options_set(capsys: Capture) -> None:
    report = json_report(capsys, "--latency", "1", "--flawed-accuracy", "0.5", "--activation=always")
    assert report["parameters"]["latency"] == 1
    assert report["parameters"]["flawed_accuracy"] == 0.5
    assert report["parameters"]["activation"] == "always"


def test_swarm_sends_estimates_in_the_format_that_its_options_set(capsys: Capture) -> None:
    report = json_report(capsys, "--subject", "17", "--priority", "6")
    assert report["parameters"]["frames"] == {"subject": 17, "priority": 6}


def test_the_port_of_the_slcan_adapter_is_printed_beside_the_json(capsys: Capture) -> None:
    assert run_swarm_command("--slcan", "0", "--json") == 0
    output, errors = capsys.readouterr()
    port = json.loads(output)["bus"]["slcan"]

    assert port > 0
    assert errors == f"the bus is an slcan adapter, too: socket://127.0.0.1:{port}\n"


def test_swarm_warns_of_a_bus_that_would_be_busy(capsys: Capture) -> None:
    assert run_swarm_command("--robots", "10", "--steps-per-second", "300") == 0
    warning = "a real bus at 500 kbit/s or less would be busy for more than 70% of the time"
    assert warning in capsys.readouterr().err


def test_swarm_does_not_warn_of_a_bus_with_room(capsys: Capture) -> None:
    assert run_swarm_command("--robots", "10", "--steps-per-second", "30") == 0
    assert "would be busy" not in capsys.readouterr().err


DEVICE = "--device 1=virtual:a --channel v{robot}"
PROCESSES = "--processes --interface udp_multicast"
WRONG_OPTIONS = {
    "--robots 127 --slcan 0": "with --slcan take at most 126",
    "--slcan 0 --channel vcan{robot}": "--slcan needs one bus for all",
    "--radio-range 1": "--radio-range is 1.0 but robots do not move; choose topology dynamic",
    "--subject 6144": "subject is 6144",
    "--latency": "argument --latency: expected one argument",
    "--omga=0.1": "no such option: --omga=0.1; did you mean --omega?",
    "--latency one": "argument --latency: invalid int value: 'one'",
    "--speed fast": "argument --speed: invalid float value: 'fast'",
    "--set omega=0.1": "no such option: --set",
    f"{PROCESSES} --compare": "but robots elsewhere run once; leave it out",
    "--log no/such/folder/run.log": "cannot write no/such/folder/run.log: its folder does not exist",
    "--interface nonsense": "argument -i/--interface: 'nonsense' is none of ",
    "--firmware natve": "argument --firmware: 'natve' is none of native, mirror, reference",
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
    f"{PROCESSES} --fault loss": "for faults, latency or a topology write {robot}",
    f"{PROCESSES} --latency 1": "for faults, latency or a topology write {robot}",
    f"{PROCESSES} --topology dynamic": "for faults, latency or a topology write {robot}",
}
"""Options that swarm refuses, and a part of the message."""


@pytest.mark.parametrize(("options", "message"), WRONG_OPTIONS.items())
def test_swarm_refuses_wrong_options_and_writes_nothing(
    options: str, message: str, capsys: Capture, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    monkeypatch.chdir(tmp_path)
    assert run_swarm_command(*shlex.split(options)) == 2
    output, errors = capsys.readouterr()

    assert message in errors
    assert output == ""
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("name", ["run.log", "run.log.events", "run.log.json"])
def test_swarm_refuses_a_file_that_it_cannot_write_before_the_first_tick(
    name: str, capsys: Capture, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    monkeypatch.setattr(Swarm, "tick", lambda self: pytest.fail("the swarm took a step"))
    obstacle = tmp_path / name
    obstacle.mkdir()

    assert run_swarm_command("--log", tmp_path / "run.log") == 2
    assert f"cannot write {obstacle}: it is not a regular file" in capsys.readouterr().err
    assert list(tmp_path.iterdir()) == [obstacle]


# --- Ends before the last step ---------------------------------------------------------------------------


def frames_of_small_swarm(ticks: int) -> int:
    """Return how many frames four robots send in so few ticks: a heartbeat, and an estimate in each tick."""
    robots, heartbeats, estimates = 4, 1, ticks
    return robots * (heartbeats + estimates)


@interruptible()
def test_a_signal_ends_the_run_after_a_whole_tick_and_saves_log_and_results(
    capsys: Capture, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    """The signal comes during the seventh tick of 30, of a swarm of four robots."""

    def send_signal_in_tick_7(view: LiveView, swarm: Swarm) -> None:
        if swarm.ticks == 7:
            os.kill(os.getpid(), signal.SIGTERM)

    # The swarm calls its live view in each tick, so that is where the signal can be sent.
    monkeypatch.setattr(LiveView, "__call__", send_signal_in_tick_7)
    log = tmp_path / "run.log"
    assert run_swarm_command("--json", "--log", log) == 128 + signal.SIGTERM
    report = json.loads(capsys.readouterr().out)
    assert report["interrupted"]
    assert report["results"]["steps"] == 7
    assert json.loads(Path(f"{log}.json").read_text()) == report
    assert len(log.read_text().splitlines()) == frames_of_small_swarm(ticks=7)


def test_a_failing_bus_gives_exit_code_1_and_saves_what_is_done(
    capsys: Capture, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    send = virtual.VirtualBus.send

    def fail_after_tick_8(bus: virtual.VirtualBus, frame: can.Message, timeout: float) -> None:
        if frame.timestamp > 0.75:  # tick 8 is at 0.7 s, and tick 9 at 0.8 s
            raise can.CanOperationError("bus off")
        send(bus, frame, timeout)

    monkeypatch.setattr(virtual.VirtualBus, "send", fail_after_tick_8)
    log = tmp_path / "run.log"
    assert run_swarm_command("--bus-kwargs", "preserve_timestamps=True", "--log", log) == 1
    assert "failed in tick 9: bus off" in capsys.readouterr().err
    assert len(log.read_text().splitlines()) == frames_of_small_swarm(ticks=8)


def test_a_bus_that_takes_no_more_frames_fails_after_a_time_limit(
    capsys: Capture, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(carrier, "FRAME_TIMEOUT", 0.05)
    assert run_swarm_command("--bus-kwargs", "rx_queue_size=2") == 1
    assert "failed in tick 1: Could not send" in capsys.readouterr().err


def test_results_that_cannot_be_written_cost_neither_the_summary_nor_the_log(
    capsys: Capture, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    obstacle = tmp_path / "run.log.json"
    monkeypatch.setattr(LiveView, "__call__", lambda self, swarm: obstacle.mkdir(exist_ok=True))
    assert run_swarm_command("--quiet", "--log", tmp_path / "run.log") == 2
    output, errors = capsys.readouterr()

    assert output.startswith("seed 1: 4 robots, ASDF-, 30 steps")
    assert f"cannot write {obstacle}" in errors
    assert {path.name for path in tmp_path.iterdir()} == {"run.log", "run.log.events", "run.log.json"}


# --- The same swarm with other filters -------------------------------------------------------------------

COMPARED = ["swarm", "--robots", "8", "--steps", "600", "--filter-period", "100", "--flawed", "50%"]


def results_of_filter(capsys: Capture, filter_name: str) -> dict[str, Any]:
    """Run the swarm of ``COMPARED`` with a filter alone, and return its results."""
    assert main([*COMPARED, "--filter", filter_name, "--json"]) == 0
    results: dict[str, Any] = json.loads(capsys.readouterr().out)["results"]
    return results


@pytest.mark.slow
@pytest.mark.parametrize("filter_name", ["asdf-plus", "none", "asdf-minus", "robust"])
def test_compared_results_are_those_of_the_same_swarm_with_each_filter_alone(
    filter_name: str, capsys: Capture
) -> None:
    assert main([*COMPARED, "--filter", filter_name, "--compare", "--json"]) == 0
    report = json.loads(capsys.readouterr().out)
    results_by_filter = report["compared"] | {filter_name: report["results"]}
    assert results_by_filter.keys() == {"none", "asdf-minus", "robust", filter_name}
    for other_name, results in results_by_filter.items():
        assert results == results_of_filter(capsys, other_name)


def test_a_comparison_ends_with_the_error_and_b_hat_of_each_filter(capsys: Capture) -> None:
    assert main([*COMPARED, "--filter", "asdf-plus", "--compare", "--quiet"]) == 0
    last_line = capsys.readouterr().out.splitlines()[-1]

    assert last_line.startswith(
        "Mean error on the same seed: no filter 0.025, ASDF- 0.030, ASDF+ 0.046, robust 0.153. "
        "The flawed robots first assumed an accuracy of 0.55 (true: 0.95), now: "
        "ASDF- 0.84, ASDF+ 0.80, robust 0.64. "
    )


def test_the_log_of_a_comparison_is_that_of_the_chosen_filter(tmp_path: Path) -> None:
    options = ["--filter", "asdf-plus", "--steps", "100", "--quiet", "--log"]
    assert main([*COMPARED, *options, str(tmp_path / "alone.log")]) == 0
    assert main([*COMPARED, "--compare", *options, str(tmp_path / "compared.log")]) == 0
    assert (tmp_path / "compared.log").read_bytes() == (tmp_path / "alone.log").read_bytes()


WITHOUT_FLAWED = [*COMPARED, "--omega", "0.1", "--flawed", "0", "--compare", "--steps", "100"]


def test_a_comparison_without_flawed_robots_says_nothing_of_them(capsys: Capture) -> None:
    assert main([*WITHOUT_FLAWED, "--quiet"]) == 0
    assert "flawed" not in capsys.readouterr().out.splitlines()[-1]


def test_a_comparison_without_flawed_robots_has_results_of_other_filters(capsys: Capture) -> None:
    assert main([*WITHOUT_FLAWED, "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["compared"].keys() == {"none", "robust"}


@pytest.mark.parametrize(
    ("options", "needs_none"),
    [
        ("", True),
        ("--topology dynamic", False),
        ("--true-accuracy 0.55 --flawed-accuracy 0.9", False),
    ],
)
def test_a_comparison_says_that_a_connected_underconfident_swarm_needs_no_filter(
    options: str, needs_none: bool, capsys: Capture
) -> None:
    """As docs/advice.md has it: neither robots that move nor overconfident ones can do without."""
    assert main([*COMPARED, "--steps", "100", *options.split(), "--compare", "--quiet"]) == 0
    assert ("This swarm needs no filter" in capsys.readouterr().out) == needs_none


def final_error(filter_name: str) -> float:
    """Return the mean error of all robots at the end of the README's first swarm with a filter."""
    experiment = Experiment(topology="dynamic", filter="asdf-minus", flawed="50%", trials=1)
    # A swarm is trial 0 of the experiment with the same parameters, which the engine runs faster.
    x = native.run(replace(experiment, filter=filter_name), 0, 1).x[0, :, -1] / 2**23
    return float(np.abs(x - experiment.fill_ratio).mean())


def test_the_figures_of_the_readme_are_those_of_its_first_command() -> None:
    readme = " ".join((ROOT / "README.md").read_text(encoding="utf-8").split())
    without_filter, with_filter, robust = map(final_error, ("none", "asdf-minus", "robust"))
    line = f"no filter {without_filter:.3f}, ASDF- {with_filter:.3f}, robust {robust:.3f}."
    assert f"Mean error on the same seed: {line}" in readme


@pytest.mark.slow
def test_the_first_command_of_the_readme_ends_as_it_shows(capsys: Capture) -> None:
    command = re.search(r"^\t@\$\(BIN\)/mcp-asdf (swarm .*)$", (ROOT / "Makefile").read_text(), re.MULTILINE)
    assert command is not None and main(command[1].split()) == 0
    *_, last_line = capsys.readouterr().out.splitlines()
    assert f"{last_line}\n" == block_with(ROOT / "README.md", "Mean error", "text")
