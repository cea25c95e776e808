"""``mcp-asdf swarm``: its files and what it prints, and every way to end."""

from __future__ import annotations

import json
import os
import re
import shlex
import signal
from collections.abc import Callable
from contextlib import nullcontext
from io import StringIO
from pathlib import Path
from typing import Any
from unittest.mock import Mock

import can
import pytest
from can.interfaces import virtual
from rich.console import Console

from host_tools.swarm.swarms import identifiers_and_data, run_and_record, small_swarm
from mcp_asdf_tools.bus import slcan_server
from mcp_asdf_tools.bus.slcan_server import SlcanServer
from mcp_asdf_tools.cli.main import main
from mcp_asdf_tools.common.parameters import parameters_of
from mcp_asdf_tools.swarm import carrier, live_view
from mcp_asdf_tools.swarm.run import SwarmRun
from mcp_asdf_tools.swarm.settings import SwarmSettings
from mcp_asdf_tools.swarm.summary import comparison, one_line, summary, summary_table
from mcp_asdf_tools.swarm.swarm import Swarm
from support import ROOT, block_with, interruptible

pytestmark = pytest.mark.usefixtures("private_setup")

Capture = pytest.CaptureFixture[str]


def run_swarm_command(*arguments: str | Path) -> int:
    """Run ``mcp-asdf swarm`` with four robots in 30 steps; return its exit code."""
    options_of_small_swarm = ("--robots", "4", "--steps", "30", "--filter-period", "10")
    return main(["swarm", *options_of_small_swarm, *map(str, arguments)])


def json_report(capsys: Capture, *arguments: str | Path) -> dict[str, Any]:
    """Run the command with --json, which has to succeed, and return what it prints."""
    assert run_swarm_command("--json", *arguments) == 0
    report: dict[str, Any] = json.loads(capsys.readouterr().out)
    return report


# --- Files and reports -----------------------------------------------------------------------------------


def test_the_json_report_of_a_swarm_has_its_parameters_its_bus_and_the_number_of_delivered_estimates(
    capsys: Capture,
) -> None:
    """Each of four robots sends an estimate in each of 30 steps, and the other three receive it.

    With a latency of one step those of the last step do not arrive. The seed is the default one.
    """
    options = "--latency 1 --flawed-accuracy 0.5 --activation=always --subject 17 --priority 6"
    report = json_report(capsys, "--robots", "4", "--steps", "30", "--channel", "mine", *options.split())
    parameters = report["parameters"]
    assert parameters["seed"] == 1
    assert parameters["latency"] == 1
    assert parameters["flawed_accuracy"] == 0.5
    assert parameters["activation"] == "always"
    assert parameters["frames"] == {"subject": 17, "priority": 6}
    assert report["bus"] == {"interface": "virtual", "channel": "mine", "slcan": None}
    assert report["results"]["frames"]["delivered"] == 29 * 4 * 3


def test_the_file_beside_a_log_has_the_json_report(tmp_path: Path, capsys: Capture) -> None:
    """Its name is that of the log and ".json"."""
    report = json_report(capsys, "--log", tmp_path / "my.run.log")
    report_in_file = json.loads((tmp_path / "my.run.log.json").read_text())
    assert report_in_file == report


def test_the_log_of_a_swarm_has_every_frame_with_its_channel_and_its_time(tmp_path: Path) -> None:
    """The same swarm, run without the command, sends the same frames.

    Times begin at 0 s with the first frame, and are compared in whole milliseconds.
    """
    log = tmp_path / "my.run.log"
    options = ["--robots", "4", "--steps", "30", "--filter-period", "10", "--channel", "mine"]
    assert main(["swarm", *options, "--quiet", "--log", str(log)]) == 0
    with can.LogReader(log) as reader:
        logged_frames = list(reader)
    _run, sent_frames = run_and_record(SwarmSettings(robots=4, steps=30, filter_period=10))

    assert identifiers_and_data(logged_frames) == identifiers_and_data(sent_frames)
    assert {frame.channel for frame in logged_frames} == {"mine"}
    start = logged_frames[0].timestamp
    logged_milliseconds = [round(1000 * (frame.timestamp - start)) for frame in logged_frames]
    sent_milliseconds = [round(1000 * frame.timestamp) for frame in sent_frames]
    assert logged_milliseconds == sent_milliseconds


def files_written_by_command(folder: Path) -> dict[str, bytes]:
    """Run the command with a log in a new folder, and return the contents of all files there, by name."""
    folder.mkdir()
    assert run_swarm_command("--quiet", "--log", folder / "run.log") == 0
    return {path.name: path.read_bytes() for path in folder.iterdir()}


def test_the_same_command_writes_the_same_files_again(tmp_path: Path) -> None:
    """Log, events and results are compared byte by byte."""
    files_of_first_run = files_written_by_command(tmp_path / "first")
    files_of_second_run = files_written_by_command(tmp_path / "second")
    assert files_of_first_run.keys() == {"run.log", "run.log.events", "run.log.json"}
    assert files_of_second_run == files_of_first_run


# --- Summaries -------------------------------------------------------------------------------------------


def test_a_piped_output_has_the_results_and_the_line_that_repeats_the_run(capsys: Capture) -> None:
    """Fields are separated by tabs. The first field of a result is its name."""
    options = "--robots 4 --steps 30 --filter-period 10 --seed 42"
    assert main(["swarm", *options.split()]) == 0
    *lines, last_line = capsys.readouterr().out.splitlines()
    names_of_results = [line.partition("\t")[0] for line in lines]

    usual_results = ["run", "estimate", "b_hat, flawed", "b_hat, other", "filter", "frames", "bus load"]
    assert names_of_results == usual_results
    assert last_line == f"again: mcp-asdf swarm {options}"


def test_quiet_prints_one_line(capsys: Capture) -> None:
    """The line begins with the seed, by which the run can be repeated."""
    assert run_swarm_command("--seed", "42", "--quiet") == 0
    output = capsys.readouterr().out
    assert output.startswith("seed 42: ")
    assert output.count("\n") == 1


def interrupted_run_with_faults() -> SwarmRun:
    """Run three robots. Robot 0 receives damaged frames, and robot 2 sends as robot 1."""
    faults = ("corrupt=0.5,bits=5,receivers=0", "collide,robots=2,id=1")
    run, _frames = run_and_record(small_swarm(*faults, robots=3, flawed=0))
    run.interrupted = True
    return run


def test_a_summary_has_faults_conflicts_the_clock_and_robots_in_trouble() -> None:
    """Robot 0 of three receives damaged frames, robot 2 sends as robot 1, and the user interrupts the run.

    Results are added that only a swarm of robots elsewhere, in real time, has. A line is a name and a text.
    """
    run = interrupted_run_with_faults()
    run.results["tests"] = None  # no frame of a robot elsewhere has this number
    run.results["clock"] = {"mean_lateness": 0.001, "max_lateness": 0.02, "drift": -0.0005, "late_ticks": 3}

    run.seconds = 1.26
    assert summary(run, bus="vcan0") == [
        ("run", "60 of 60 steps in 1.3 s; interrupted"),
        ("estimate", "mean x 0.50078, f 0.55, mean error 0.04922, spread of x 0.05334, of x_hat 0.15370"),
        ("b_hat, flawed", "no such robots"),
        ("b_hat, other", "0.9500 -> 0.9667 (0.9500 to 1.0000, 3 robots; b 0.95)"),
        ("filter", "ASDF+: all robots recalibrate; an unknown number of tests, 2 updates"),
        (
            "frames",
            "180 messages and 18 heartbeats sent on vcan0, 337 messages delivered, 25 frames rejected, "
            "98 messages refused, 0 strays",
        ),
        ("arrived", "396 of 396 frames, 100.0%; 198 on the bus"),
        ("fault", "corrupt=0.5,receivers=0,bits=5: 62 injected"),
        ("fault", "collide=1.0,robots=2,id=1: 66 injected"),
        ("robot 0", "97 messages delivered; 16 MULTI_FRAME, 3 X_HAT, 4 ALPHA, 2 SUBJECT, 38 refused"),
        ("robot 1", "120 messages delivered; 60 refused"),
        ("node-id conflict", "another node sent 60 messages as robot 1; give it a free id"),
        (
            "clock",
            "ticks began 1.000 ms late on average, 20.000 ms at most, 3 of them by more than half a tick; "
            "drift -0.500 ms; 0 frames late or lost",
        ),
        (
            "bus load",
            "125 kbit/s 4.2% (peak 8%), 250 kbit/s 2.1% (peak 4%), 500 kbit/s 1.1% (peak 2%), "
            "1 Mbit/s 0.5% (peak 1%)",
        ),
    ]


def test_the_summary_in_one_line_says_that_the_run_was_interrupted() -> None:
    """The last word of the line is "interrupted". The run has three robots and seed 11."""
    line = one_line(interrupted_run_with_faults())
    assert line == "seed 11: 3 robots, ASDF+, 60 steps, mean error 0.04922, spread 0.05334; interrupted"


def test_a_summary_of_a_run_without_faults_has_no_lines_about_faults_and_says_what_failed() -> None:
    """The line "run" ends with the tick and the error. The other lines are those of every run."""
    run, _frames = run_and_record(small_swarm(robots=3))
    run.failure = "tick 41: bus off"
    run.seconds = 1.26
    text_by_name = dict(summary(run, bus="vcan0"))
    usual_results = ["run", "estimate", "b_hat, flawed", "b_hat, other", "filter", "frames", "bus load"]
    assert list(text_by_name) == usual_results
    assert text_by_name["run"] == "60 of 60 steps in 1.3 s; failed in tick 41: bus off"


def test_a_summary_is_a_table_with_bold_names() -> None:
    """On a terminal of 31 columns a long text goes on in the next line, behind an empty name.

    Escape sequences of the terminal begin and end bold text.
    """
    output = StringIO()
    console = Console(width=31, file=output, force_terminal=True, color_system="standard", _environ={})
    console.print(summary_table([("node-id conflict", "another node [b]")]))

    bold, end = "\x1b[1m", "\x1b[0m"
    assert output.getvalue() == (
        f"{bold} {end}{bold}node-id conflict{end}{bold} {end} another     \n"
        f"{bold}                  {end} node [b]    \n"
    )


# --- Options ---------------------------------------------------------------------------------------------


def test_swarm_has_an_option_for_every_parameter(capsys: Capture) -> None:
    """A parameter such as filter_period has the option --filter-period, which the help lists in a line."""
    assert run_swarm_command("--help") == 0
    listed_options = re.findall(r"^  (--[a-z-]+)", capsys.readouterr().out, re.MULTILINE)
    for name in parameters_of(SwarmSettings):
        assert "--" + name.replace("_", "-") in listed_options


def test_a_swarm_warns_of_the_frames_that_a_slow_program_at_the_slcan_adapter_has_missed(
    capsys: Capture, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The adapter of this run says that it has dropped three frames."""

    class ServerOfSlowProgram(SlcanServer):
        def __init__(self, *arguments: Any) -> None:
            super().__init__(*arguments)
            self.dropped = 3

    monkeypatch.setattr(slcan_server, "SlcanServer", ServerOfSlowProgram)
    assert run_swarm_command("--slcan", "0") == 0
    assert "slcan adapter read too slowly: 3 frames did not reach it" in capsys.readouterr().err


def test_the_address_of_the_slcan_adapter_is_printed_as_an_error_output_not_in_the_json(
    capsys: Capture,
) -> None:
    """With --slcan 0 other programs can join the bus at a free port. The report has the port's number."""
    assert run_swarm_command("--slcan", "0", "--json") == 0
    output, errors = capsys.readouterr()
    port = json.loads(output)["bus"]["slcan"]

    assert port > 0
    assert errors == f"the bus is an slcan adapter, too: socket://127.0.0.1:{port}\n"


@pytest.mark.parametrize(("steps_per_second", "is_busy"), [("300", True), ("30", False)])
def test_swarm_warns_only_of_a_bus_that_would_be_busy(
    steps_per_second: str, is_busy: bool, capsys: Capture
) -> None:
    """Ten robots send 3000 frames a second of some 150 bits, which are 450 kbit/s, or a tenth of that."""
    assert run_swarm_command("--robots", "10", "--steps-per-second", steps_per_second) == 0
    errors = capsys.readouterr().err
    if is_busy:
        assert "a real bus at 500 kbit/s or less would be busy for more than 70% of the time" in errors
    else:
        assert "would be busy" not in errors


DEVICE = "--device 1=virtual:a --channel v{robot}"
PROCESSES = "--processes --interface udp_multicast"
WRONG_OPTIONS = {
    "--robots 127 --slcan 0": "with --slcan take at most 126",
    "--slcan 0 --channel vcan{robot}": "--slcan needs one bus for all",
    "--radio-range 1": "--radio-range is 1.0 but robots do not move; choose topology dynamic",
    "--subject 6144": "subject is 6144",
    "--latency one": "argument --latency: invalid int value: 'one'",
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


@pytest.mark.parametrize(("wrong_options", "expected_error"), WRONG_OPTIONS.items())
def test_swarm_refuses_wrong_options_and_writes_nothing(
    wrong_options: str, expected_error: str, capsys: Capture, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    """The exit code of wrong usage is 2, and the reason is printed as an error."""
    monkeypatch.chdir(tmp_path)
    assert run_swarm_command(*shlex.split(wrong_options)) == 2
    output, errors = capsys.readouterr()

    assert expected_error in errors
    assert output == ""
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("name_of_folder", ["run.log", "run.log.events", "run.log.json"])
def test_swarm_refuses_a_file_that_it_cannot_write_before_the_first_tick(
    name_of_folder: str, capsys: Capture, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    """A folder has the name of the log or of a file beside it. The error names it.

    No tick is run, and nothing is written.
    """
    tick = Mock()
    monkeypatch.setattr(Swarm, "tick", tick)
    folder_in_place_of_file = tmp_path / name_of_folder
    folder_in_place_of_file.mkdir()

    assert run_swarm_command("--log", tmp_path / "run.log") == 2
    assert f"cannot write {folder_in_place_of_file}: it is not a regular file" in capsys.readouterr().err
    assert list(tmp_path.iterdir()) == [folder_in_place_of_file]
    tick.assert_not_called()


# --- Ends before the last step ---------------------------------------------------------------------------


def call_in_each_tick(function: Callable[[Swarm], None], monkeypatch: pytest.MonkeyPatch) -> None:
    """Let the command swarm call a function at the end of each tick, instead of its live view."""
    monkeypatch.setattr(live_view, "live_view", lambda *_: nullcontext(function))


@pytest.fixture
def signal_in_tick_7(monkeypatch: pytest.MonkeyPatch) -> None:
    """Send SIGTERM to this process in the seventh tick of a swarm."""

    def send_signal_in_tick_7(swarm: Swarm) -> None:
        if swarm.ticks == 7:
            os.kill(os.getpid(), signal.SIGTERM)

    call_in_each_tick(send_signal_in_tick_7, monkeypatch)


@interruptible()
@pytest.mark.usefixtures("signal_in_tick_7")
def test_a_signal_ends_the_run_after_a_whole_tick_and_saves_log_and_results(
    capsys: Capture, tmp_path: Path
) -> None:
    """SIGTERM comes in the seventh of 30 ticks. The log has the frames of all seven.

    The exit code is 128 plus the number of the signal, as in a shell.
    """
    log = tmp_path / "run.log"
    assert run_swarm_command("--robots", "4", "--json", "--log", log) == 128 + signal.SIGTERM
    report = json.loads(capsys.readouterr().out)
    report_in_file = json.loads((tmp_path / "run.log.json").read_text())

    assert report["interrupted"]
    assert report["results"]["steps"] == 7
    assert report_in_file == report
    robots, heartbeats, estimates = 4, 1, 7
    assert len(log.read_text().splitlines()) == robots * (heartbeats + estimates)


@pytest.fixture
def bus_that_fails_after_tick_8(monkeypatch: pytest.MonkeyPatch) -> None:
    """Let each virtual bus raise an error at frames of tick 9, which is at 0.8 s, and later."""
    send = virtual.VirtualBus.send

    def fail_after_tick_8(bus: virtual.VirtualBus, frame: can.Message, timeout: float) -> None:
        if frame.timestamp > 0.75:  # tick 8 is at 0.7 s
            raise can.CanOperationError("bus off")
        send(bus, frame, timeout)

    monkeypatch.setattr(virtual.VirtualBus, "send", fail_after_tick_8)


@pytest.mark.usefixtures("bus_that_fails_after_tick_8")
def test_a_failing_bus_gives_exit_code_1_and_saves_the_frames_until_then(
    capsys: Capture, tmp_path: Path
) -> None:
    """The bus fails in tick 9. The error names the tick, and the log has the frames of eight ticks."""
    log = tmp_path / "run.log"
    keep_times = ("--bus-kwargs", "preserve_timestamps=True")  # by which the bus knows that it is tick 9
    assert run_swarm_command("--robots", "4", *keep_times, "--log", log) == 1
    assert "failed in tick 9: bus off" in capsys.readouterr().err
    robots, heartbeats, estimates = 4, 1, 8
    assert len(log.read_text().splitlines()) == robots * (heartbeats + estimates)


def test_a_bus_that_takes_no_more_frames_fails_after_a_time_limit(
    capsys: Capture, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The queue of the bus holds two frames, and nobody reads them. The error names the first tick.

    The limit is shortened to 0.05 s here.
    """
    monkeypatch.setattr(carrier, "FRAME_TIMEOUT", 0.05)
    assert run_swarm_command("--bus-kwargs", "rx_queue_size=2") == 1
    assert "failed in tick 1: Could not send" in capsys.readouterr().err


@pytest.fixture
def folder_in_place_of_results(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> Path:
    """A folder that appears while a swarm runs, with the name of the file for its results, run.log.json."""
    folder = tmp_path / "run.log.json"

    def make_folder(_swarm: Swarm) -> None:
        folder.mkdir(exist_ok=True)

    call_in_each_tick(make_folder, monkeypatch)
    return folder


def test_summary_and_log_are_there_even_if_the_file_of_results_cannot_be_written(
    folder_in_place_of_results: Path, capsys: Capture, tmp_path: Path
) -> None:
    """A folder with the name of that file appears while the swarm runs. The exit code is 2.

    Four robots run for 30 ticks, which are three seconds.
    """
    assert run_swarm_command("--quiet", "--log", tmp_path / "run.log") == 2
    output, errors = capsys.readouterr()

    assert f"cannot write {folder_in_place_of_results}" in errors
    assert output.startswith("seed 1: 4 robots, ASDF-, 30 steps")
    log_lines = (tmp_path / "run.log").read_text().splitlines()
    robots, estimates, heartbeats = 4, 30, 3
    assert len(log_lines) == robots * (estimates + heartbeats)
    assert (tmp_path / "run.log.events").is_file()


# --- The same swarm with other filters -------------------------------------------------------------------

COMPARED_SWARM = ["swarm", "--robots", "8", "--steps", "300", "--filter-period", "50", "--flawed", "50%"]


def results_of_filter(capsys: Capture, filter_name: str) -> dict[str, Any]:
    """Run the swarm of ``COMPARED_SWARM`` with a filter alone, and return its results."""
    assert main([*COMPARED_SWARM, "--filter", filter_name, "--json"]) == 0
    results: dict[str, Any] = json.loads(capsys.readouterr().out)["results"]
    return results


@pytest.mark.slow
@pytest.mark.parametrize("filter_name", ["asdf-plus", "none", "asdf-minus", "robust"])
def test_compared_results_are_those_of_the_same_swarm_with_each_filter_alone(
    filter_name: str, capsys: Capture
) -> None:
    """The report has the chosen filter under "results", and the others under "compared"."""
    assert main([*COMPARED_SWARM, "--filter", filter_name, "--compare", "--json"]) == 0
    report = json.loads(capsys.readouterr().out)
    results_by_filter = report["compared"] | {filter_name: report["results"]}
    assert results_by_filter.keys() == {"none", "asdf-minus", "robust", filter_name}
    for any_filter_name, results in results_by_filter.items():
        assert results == results_of_filter(capsys, any_filter_name), any_filter_name


def results_with(mean_error: float, b_hat_of_flawed: float) -> dict[str, Any]:
    """Return what a comparison needs of a swarm's results; its flawed robots began with a b_hat of 0.55."""
    return {"mean_error": mean_error, "b_hat": {"flawed": {"before": 0.55, "after": b_hat_of_flawed}}}


def test_a_comparison_has_mean_errors_and_the_accuracies_that_flawed_robots_assume_in_the_end() -> None:
    """Flawed robots assume an accuracy of 0.55 at the start; by default the true one is 0.95."""
    results_by_filter = {
        "none": results_with(mean_error=0.0251, b_hat_of_flawed=0.55),
        "asdf-plus": results_with(mean_error=0.0459, b_hat_of_flawed=0.801),
        "robust": results_with(mean_error=0.153, b_hat_of_flawed=0.64),
    }
    assert comparison(results_by_filter, SwarmSettings()).startswith(
        "Mean error on the same seed: no filter 0.025, ASDF+ 0.046, robust 0.153. "
        "The flawed robots first assumed an accuracy of 0.55 (true: 0.95), now: ASDF+ 0.80, robust 0.64."
    )


def test_a_comparison_names_no_true_accuracy_if_sensors_age() -> None:
    """Sensors begin with an accuracy of 0.95 and lose some in each step. So 0.95 would mislead the user."""
    results_by_filter = {
        "none": results_with(mean_error=0.03, b_hat_of_flawed=0.55),
        "robust": results_with(mean_error=0.02, b_hat_of_flawed=0.64),
    }
    aging_sensors = SwarmSettings(drift="linear", drift_rate=-1e-5)
    sentences = comparison(results_by_filter, aging_sensors)
    assert "first assumed an accuracy of 0.55, now: robust 0.64." in sentences


def test_the_last_line_of_a_comparison_describes_the_results_of_all_filters(capsys: Capture) -> None:
    """The sentences are made from the report of the same command in JSON, which has four filters."""
    options = [*COMPARED_SWARM, "--steps", "100", "--filter", "asdf-plus", "--compare"]
    assert main([*options, "--json"]) == 0
    report = json.loads(capsys.readouterr().out)
    assert main(options) == 0
    *_, last_line = capsys.readouterr().out.splitlines()

    results_by_filter = report["compared"] | {"asdf-plus": report["results"]}
    assert results_by_filter.keys() == {"none", "asdf-minus", "asdf-plus", "robust"}
    assert last_line == comparison(results_by_filter, SwarmSettings())


def test_the_log_of_a_comparison_is_the_log_of_the_chosen_filter(tmp_path: Path) -> None:
    """A run with this filter and without a comparison writes the same log."""
    log_alone = tmp_path / "alone.log"
    log_of_comparison = tmp_path / "compared.log"
    options = [*COMPARED_SWARM, "--filter", "asdf-plus", "--steps", "100", "--quiet"]
    assert main([*options, "--log", str(log_alone)]) == 0
    assert main([*options, "--log", str(log_of_comparison), "--compare"]) == 0
    assert log_of_comparison.read_bytes() == log_alone.read_bytes()


def test_a_comparison_without_flawed_robots_says_nothing_of_them(capsys: Capture) -> None:
    """Without them there is no filter for flawed robots alone, ASDF-minus, to compare with, either.

    The last line of the output has the comparison.
    """
    options = "--robots 8 --flawed 0 --steps 20 --filter-period 50 --omega 0.1 --compare"
    assert main(["swarm", *options.split(), "--quiet"]) == 0
    *_, last_line = capsys.readouterr().out.splitlines()
    assert "flawed" not in last_line

    assert main(["swarm", *options.split(), "--json"]) == 0
    report = json.loads(capsys.readouterr().out)
    assert report["compared"].keys() == {"none", "robust"}


@pytest.mark.parametrize(
    ("settings", "needs_no_filter"),
    [
        (SwarmSettings(), True),
        (SwarmSettings(topology="dynamic"), False),
        (SwarmSettings(true_accuracy=0.55, flawed_accuracy=0.9), False),
    ],
    ids=["default", "robots move", "flawed robots are overconfident"],
)
def test_a_comparison_says_that_a_connected_swarm_with_underconfident_robots_needs_no_filter(
    settings: SwarmSettings, needs_no_filter: bool
) -> None:
    """By default all robots receive from all, and flawed ones assume 0.55, less than the true 0.95.

    Other swarms do need one, as docs/advice.md explains.
    """
    results_by_filter = {
        "none": results_with(mean_error=0.03, b_hat_of_flawed=0.55),
        "robust": results_with(mean_error=0.02, b_hat_of_flawed=0.64),
    }
    sentences = comparison(results_by_filter, settings)
    assert ("This swarm needs no filter" in sentences) == needs_no_filter


@pytest.mark.slow
def test_the_first_command_of_the_readme_ends_as_it_shows(capsys: Capture) -> None:
    """The command is ``make swarm``. Its options come from the Makefile. Its last line is compared."""
    makefile = (ROOT / "Makefile").read_text()
    rule = re.search(r"^\t@\$\(BIN\)/mcp-asdf (?P<arguments>swarm .*)$", makefile, re.MULTILINE)
    assert rule is not None
    assert main(rule["arguments"].split()) == 0
    *_, last_line = capsys.readouterr().out.splitlines()
    shown_output = block_with(ROOT / "README.md", "Mean error", "text")
    assert f"{last_line}\n" == shown_output
