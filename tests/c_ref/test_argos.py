"""The example for ARGoS3: it compiles, and its robots compute what those in Python do, or check_log.py tells.

ARGoS itself is not installed here. The folder argos3 beside this file has stand-ins for those of its types
that the example uses, and a small simulator around them.
"""

from __future__ import annotations

import csv
import re
import shutil
import subprocess
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from types import ModuleType
from xml.etree import ElementTree

import numpy as np
import pytest

from support import ROOT, WARNINGS, load_program, made_once, require, run

pytestmark = pytest.mark.slow

EXAMPLE = ROOT / "c_ref/examples/argos3"
STUBS = Path(__file__).parent / "argos3"
ARGOS_HEADERS = (
    "core/control_interface/ci_controller.h",
    "core/simulator/entity/controllable_entity.h",
    "core/simulator/loop_functions.h",
    "core/simulator/simulator.h",
    "core/simulator/space/space.h",
    "core/utility/configuration/argos_exception.h",
    "core/utility/logging/argos_log.h",
    "core/utility/math/angles.h",
    "core/utility/math/rng.h",
    "core/utility/math/vector2.h",
    "plugins/robots/generic/control_interface/ci_differential_steering_actuator.h",
    "plugins/robots/generic/control_interface/ci_range_and_bearing_actuator.h",
    "plugins/robots/generic/control_interface/ci_range_and_bearing_sensor.h",
    "plugins/robots/kheperaiv/control_interface/ci_kheperaiv_ground_sensor.h",
    "plugins/robots/kheperaiv/control_interface/ci_kheperaiv_proximity_sensor.h",
)
"""Headers of ARGoS3 (421bd76) and of its plugin for the Khepera IV (7bb1bb3) that the example may include."""


# --- Building --------------------------------------------------------------------------------------------


def compiler_arguments(folder: Path) -> list[str | Path]:
    """Return the arguments with which a C++ compiler finds all headers, in a folder made by ``prepare``."""
    include_folders = (folder / "include", STUBS, folder / "vendor/mcp_asdf", EXAMPLE)
    return ["-std=c++17", *WARNINGS.split(), *(f"-I{include_folder}" for include_folder in include_folders)]


def prepare(folder: Path) -> None:
    """Put the firmware and the stand-ins for ARGoS's headers into a folder."""
    for header in ARGOS_HEADERS:
        path = folder / "include/argos3" / header
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text('#include "argos_stub.h"\n')
    run("mcp-asdf", "firmware", "vendor/mcp_asdf", "--neighbours", "30", cwd=folder)


def build(folder: Path) -> None:
    """Compile the example and the simulator into ``folder/swarm``."""
    prepare(folder)
    run(require("gcc", "gcc"), "-O2", "-c", *sorted((folder / "vendor/mcp_asdf").glob("*.c")), cwd=folder)
    sources = [*sorted(EXAMPLE.glob("*.cpp")), STUBS / "run_swarm.cpp", *sorted(folder.glob("*.o"))]
    run(require("g++", "g++"), *compiler_arguments(folder), *sources, "-o", "swarm", cwd=folder)


@pytest.fixture(scope="module")
def built_folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with the compiled example."""
    return made_once(tmp_path_factory, "argos", build)


def test_the_example_compiles_without_warnings_in_clang(tmp_path: Path) -> None:
    """A warning is an error here, for which run() raises. The other tests compile the example with gcc."""
    prepare(tmp_path)
    sources = sorted(EXAMPLE.glob("*.cpp"))
    run(require("clang++", "clang"), *compiler_arguments(tmp_path), "-fsyntax-only", *sources)


def test_the_build_file_names_all_sources_of_the_example() -> None:
    """The build file is CMakeLists.txt, and the example's sources are in C++."""
    commands = (EXAMPLE / "CMakeLists.txt").read_text(encoding="utf-8")
    sources = set(re.findall(r"\w+\.cpp", commands))
    assert sources == {path.name for path in EXAMPLE.glob("*.cpp")}


def test_the_build_file_says_how_to_get_the_firmware(tmp_path: Path) -> None:
    """CMake stops with that message, whose lines it breaks anywhere, where the firmware is missing."""
    shutil.copy(EXAMPLE / "CMakeLists.txt", tmp_path)
    command = [require("cmake"), "-S", str(tmp_path), "-B", str(tmp_path / "build")]

    result = subprocess.run(command, capture_output=True, text=True, check=False)

    message = " ".join(result.stderr.split())
    assert result.returncode == 1
    assert "run mcp-asdf firmware vendor/mcp_asdf --neighbours 30 here" in message


# --- Running ---------------------------------------------------------------------------------------------


@dataclass
class Swarm:
    """What the simulator is to run: the swarm of swarm.argos, which a test may change.

    Attributes:
        floor: Attributes of the loop functions, which make the floor.
        parameters_of_groups: Parameters of each group of robots, by the beginning of the group's line.
        packet_size: Bytes of a range-and-bearing packet.
    """

    floor: dict[str, str]
    parameters_of_groups: dict[str, dict[str, str]] = field(default_factory=dict)
    packet_size: str = ""

    def description(self, ticks: int, options: str = "") -> str:
        """Return the lines that run_swarm.cpp reads."""
        lines = [f"loop asdf_loop_functions {_format_attributes(self.floor)}"]
        for group, parameters in self.parameters_of_groups.items():
            lines.append(f"{group} {_format_attributes(parameters)}")
        lines.append(f"run {ticks} {self.packet_size} 0.7 {options}")
        return "\n".join(lines) + "\n"

    def set_parameter(self, name: str, value: str) -> None:
        """Give all robots a parameter."""
        for parameters in self.parameters_of_groups.values():
            parameters[name] = value


def _format_attributes(attributes: dict[str, str]) -> str:
    return " ".join(f"{name}={value}" for name, value in attributes.items())


def read_element(parent: ElementTree.Element, path: str) -> ElementTree.Element:
    element = parent.find(path)
    assert element is not None
    return element


@pytest.fixture
def swarm() -> Swarm:
    """The swarm of swarm.argos, with a filter that runs often enough for a short test."""
    root = ElementTree.parse(EXAMPLE / "swarm.argos").getroot()
    floor = dict(read_element(root, "loop_functions").attrib)
    assert floor.pop("label") == "asdf_loop_functions"
    del floor["library"]
    swarm = Swarm(floor)
    for entity in root.iterfind("arena/distribute/entity"):
        robot = read_element(entity, "*")
        controller_id = read_element(robot, "controller").attrib["config"]
        controller = read_element(root, f"controllers/*[@id='{controller_id}']")
        group = f"robots {controller.tag} {entity.attrib['quantity']} {entity.attrib['base_num']}"
        swarm.parameters_of_groups[group] = dict(read_element(controller, "params").attrib)
        swarm.packet_size = robot.attrib["rab_data_size"]
    swarm.set_parameter("filter_period", "50")
    return swarm


RunSwarm = Callable[..., subprocess.CompletedProcess[str]]


@pytest.fixture
def run_swarm(built_folder: Path, tmp_path: Path) -> RunSwarm:
    """A function that runs a swarm in the test's folder, and returns the ended process."""

    def run_in_folder(swarm: Swarm, ticks: int = 300, options: str = "") -> subprocess.CompletedProcess[str]:
        return subprocess.run(
            [built_folder / "swarm"],
            input=swarm.description(ticks, options),
            cwd=tmp_path,
            capture_output=True,
            text=True,
            check=False,
        )

    return run_in_folder


@pytest.fixture(scope="module")
def check_log() -> ModuleType:
    """The module check_log.py."""
    return load_program(EXAMPLE / "check_log.py")


def exit_code_for_logs(check_log: ModuleType, folder: Path) -> int:
    """Run check_log.py on all logs in a folder, as a user does, and return its exit code."""
    exit_code: int = check_log.main(sorted(map(str, folder.glob("*.csv"))))
    return exit_code


def test_the_robots_of_a_swarm_compute_the_same_bits_as_robots_in_python(
    run_swarm: RunSwarm, swarm: Swarm, check_log: ModuleType, tmp_path: Path
) -> None:
    """The swarm of the example's swarm.argos has 20 robots, and each writes a log.

    check_log.py computes all logs again in Python, and finds no bit that differs. In some of them the filter
    changes the accuracy, so that its code is compared, too.
    """
    assert run_swarm(swarm, ticks=300).returncode == 0

    verdicts = [check_log.check_log(path) for path in (tmp_path / "logs").glob("*.csv")]

    assert [verdict.difference for verdict in verdicts] == [None] * 20
    assert [verdict.ticks for verdict in verdicts] == [300] * 20
    assert sum(verdict.updates for verdict in verdicts) > 10, "changes of the accuracy"


def test_robots_with_the_robust_filter_compute_the_same_bits_as_robots_in_python(
    run_swarm: RunSwarm, swarm: Swarm, check_log: ModuleType, tmp_path: Path
) -> None:
    """A run writes a log of each robot into the folder ``logs``, with all that it received and computed.

    check_log.py computes each log again in Python, and fails if a bit differs.
    """
    swarm.set_parameter("filter", "robust")
    assert run_swarm(swarm).returncode == 0

    assert exit_code_for_logs(check_log, tmp_path / "logs") == 0


def test_after_a_reset_the_log_has_the_second_run_alone(
    run_swarm: RunSwarm, swarm: Swarm, check_log: ModuleType, tmp_path: Path
) -> None:
    """The swarm runs, is reset, and runs again. Each robot, such as kiv0, writes a log of its own.

    A log begins with a line ``start``, and each tick ends with a line ``settle``. check_log.py, which
    computes all logs again, finds no difference.
    """
    assert run_swarm(swarm, ticks=300, options="reset").returncode == 0

    log = (tmp_path / "logs/kiv0.csv").read_text(encoding="utf-8")
    assert log.count("start,") == 1
    assert log.count("settle,") == 300
    assert exit_code_for_logs(check_log, tmp_path / "logs") == 0


def test_what_robots_send_before_their_first_broadcast_is_refused(
    run_swarm: RunSwarm, swarm: Swarm, tmp_path: Path
) -> None:
    """ARGoS delivers zeros then, which must not be taken for the estimate of robot 0.

    In the log of a robot, here kiv3, a tick ends with a line ``settle``, and an estimate that it takes is a
    line ``receive``.
    """
    assert run_swarm(swarm).returncode == 0

    log = (tmp_path / "logs/kiv3.csv").read_text(encoding="utf-8")
    first_tick, later_ticks = log.split("settle,", maxsplit=1)
    assert "receive," not in first_tick
    assert "receive," in later_ticks


def x_hat_after_first_tick(log: Path) -> str:
    """Return x_hat in the first line ``settle,x,x_hat,...`` of a log, with which a tick ends."""
    _, first_settle, *_ = log.read_text(encoding="utf-8").split("settle,")
    _x, x_hat, *_ = first_settle.split(",")
    return x_hat


def test_robots_receive_the_estimates_of_the_tick_before(
    run_swarm: RunSwarm, swarm: Swarm, tmp_path: Path
) -> None:
    """In the second of two ticks robot 3 receives each x_hat that was sent at the end of the first tick.

    For each message its log has a line ``receive,sender,x_hat,...``.
    """
    assert run_swarm(swarm, ticks=2).returncode == 0

    log = (tmp_path / "logs/kiv3.csv").read_text(encoding="utf-8")
    senders_and_x_hats = re.findall(r"receive,(\d+),(\d+),", log)
    assert len(senders_and_x_hats) > 0
    for sender, x_hat in senders_and_x_hats:
        assert x_hat == x_hat_after_first_tick(tmp_path / f"logs/kiv{sender}.csv")


def read_results(folder: Path) -> list[dict[str, str]]:
    """Return the rows of the table of results that a run has written, by column."""
    with (folder / "results.csv").open(encoding="utf-8", newline="") as file:
        return list(csv.DictReader(file))


def test_the_table_of_results_has_a_row_for_each_robot_after_each_100_ticks(
    run_swarm: RunSwarm, swarm: Swarm, tmp_path: Path
) -> None:
    """In 300 ticks there are three rows for each of the robots kiv0 to kiv19."""
    assert run_swarm(swarm, ticks=300).returncode == 0

    rows = read_results(tmp_path)

    expected = [(tick, f"kiv{number}") for tick in ("100", "200", "300") for number in range(20)]
    assert [(row["tick"], row["robot"]) for row in rows] == expected


def test_the_table_of_results_has_the_last_estimate_and_accuracy_of_a_robot(
    run_swarm: RunSwarm, swarm: Swarm, tmp_path: Path
) -> None:
    """The table has nine columns. Its last row is about the last of 20 robots, kiv19, at the end of the run.

    The robot's log has its numbers as integers, in lines ``settle,x,x_hat,alpha,b_hat,status``: x in units
    of 2^-23, and the accuracy b_hat in units of 2^-32.
    """
    assert run_swarm(swarm).returncode == 0

    *_, last_row = read_results(tmp_path)

    log = (tmp_path / "logs/kiv19.csv").read_text(encoding="utf-8")
    *_, last_settle = log.split("settle,")
    x, _x_hat, _alpha, b_hat, _status = last_settle.split(",")
    assert list(last_row) == [
        "tick",
        "robot",
        "x",
        "x_hat",
        "b_hat",
        "accepted",
        "refused",
        "tests",
        "updates",
    ]
    assert last_row["robot"] == "kiv19"
    assert last_row["x"] == f"{int(x) / 2**23:.9g}"
    assert last_row["b_hat"] == f"{int(b_hat) / 2**32:.9g}"


def test_the_run_ends_with_the_mean_error_of_the_robots_accuracies(run_swarm: RunSwarm, swarm: Swarm) -> None:
    """Six of the swarm's 20 robots assume an accuracy b_hat that is wrong by 0.4.

    Without a filter it stays so. The other robots are right.
    """
    swarm.set_parameter("filter", "off")

    result = run_swarm(swarm)

    mean_error = 6 * 0.4 / 20
    assert result.stdout.endswith(f"mean |b_hat - b| at the end {mean_error:.2f}\n")


@pytest.mark.parametrize(
    ("name", "wrong_value", "expected_message"),
    [
        ("filter", "asdf-minus", 'filter is "asdf-minus"; it must be off, asdf or robust'),
        ("b_hat", "1", "b_hat is 1; it must be a probability, 0.000001 to 0.999999"),
        ("b_hat", "-0.5", "b_hat is -0.5; it must be a probability, 0.000001 to 0.999999"),
        ("sensor_accuracy", "95", "sensor_accuracy is 95; it must be 0 to 1"),
        ("filter_period", "0", "filter_period is 0; it must be 1 or more"),
        ("log_folder", "/dev/null", "cannot write /dev/null/kiv0.csv; give another log_folder"),
    ],
)
def test_a_parameter_that_robots_cannot_have_is_refused_by_its_name(
    name: str, wrong_value: str, expected_message: str, run_swarm: RunSwarm, swarm: Swarm
) -> None:
    """The simulation does not start, and ends with code 1. The file of the experiment has the parameters."""
    swarm.set_parameter(name, wrong_value)

    result = run_swarm(swarm)

    assert result.returncode == 1
    assert result.stderr.startswith(f"cannot start the MCP-ASDF firmware of robot kiv0: {expected_message}")


def test_a_fill_ratio_that_no_floor_has_is_refused_by_its_name(run_swarm: RunSwarm, swarm: Swarm) -> None:
    """It is the share of black tiles, and so at most 1; 55 may be meant as percents."""
    swarm.floor["fill_ratio"] = "55"

    result = run_swarm(swarm)

    assert "fill_ratio is 55" in result.stderr


Floor = np.ndarray[tuple[int, int], np.dtype[np.bool_]]


def distinct_rows(floor: Floor) -> set[bytes]:
    """Return the rows of a floor, as bytes."""
    return {row.tobytes() for row in floor}


def draw_floor(seed: int, fill_ratio: float, built_folder: Path, tmp_path: Path) -> Floor:
    """Let the loop functions draw a floor of 100 by 100 tiles, and return which of them are black."""
    tile_size, tiles_of_a_row = 0.01, 100
    loop_line = (
        f"loop asdf_loop_functions fill_ratio={fill_ratio} tile={tile_size} "
        f"results={tmp_path}/r results_period=1\n"
    )
    robots_line = "robots asdf_controller 1 0 filter=off b_hat=0.9 sensor_accuracy=0.9\n"
    floor_line = f"floor {seed} {tiles_of_a_row} {tile_size}\n"
    result = subprocess.run(
        [built_folder / "swarm"],
        input=loop_line + robots_line + floor_line,
        capture_output=True,
        text=True,
        check=True,
    )
    return np.array([[tile == "1" for tile in row] for row in result.stdout.split()])


def test_a_floor_has_the_fill_ratio(built_folder: Path, tmp_path: Path) -> None:
    """The fill ratio is the share of black tiles. Each of 100 by 100 tiles is drawn, so it is not exact."""
    floor = draw_floor(seed=1, fill_ratio=0.55, built_folder=built_folder, tmp_path=tmp_path)
    five_standard_deviations = 5 * 0.005  # of a share of 10,000 tiles: sqrt(0.55 * 0.45 / 10,000) is 0.005
    assert floor.mean() == pytest.approx(0.55, abs=five_standard_deviations)


def test_floors_of_two_seeds_have_no_row_or_column_in_common(built_folder: Path, tmp_path: Path) -> None:
    """A floor has 100 by 100 tiles, which a seed draws at random.

    If the random numbers of two seeds overlapped, rows or columns would be the same.
    """
    first = draw_floor(seed=1, fill_ratio=0.55, built_folder=built_folder, tmp_path=tmp_path)
    second = draw_floor(seed=2, fill_ratio=0.55, built_folder=built_folder, tmp_path=tmp_path)

    common_rows = distinct_rows(first) & distinct_rows(second)
    common_columns = distinct_rows(first.transpose()) & distinct_rows(second.transpose())
    assert common_rows == set()
    assert common_columns == set()


# --- check_log.py ----------------------------------------------------------------------------------------

LOG_OF_ONE_BLACK_TILE = """\
start,7,4080218931,2,1000,2147483648
observe,1
settle,8388608,8388608,3854762496,4080218931,0
"""
"""One tick of a robot that has observed a black tile, and assumes an accuracy of 0.95.

The numbers of its start are its id, the accuracy in units of 2^-32, filter, its period, and memory.
"""


@pytest.fixture
def short_log(run_swarm: RunSwarm, swarm: Swarm, tmp_path: Path) -> str:
    """The log of ten ticks of a healthy robot."""
    assert run_swarm(swarm, ticks=10).returncode == 0
    return (tmp_path / "logs/kiv19.csv").read_text(encoding="utf-8")


def exit_code_for_log(check_log: ModuleType, text: str, folder: Path) -> int:
    """Write a log with this text, run check_log.py on it, and return its exit code."""
    path = folder / "robot.csv"
    path.write_text(text, encoding="utf-8")
    exit_code: int = check_log.main([str(path)])
    return exit_code


def test_a_log_that_python_repeats_to_the_bit_passes(
    check_log: ModuleType, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """In the log a robot observes a tile in a single tick. check_log.py prints what it compared."""
    assert exit_code_for_log(check_log, LOG_OF_ONE_BLACK_TILE, tmp_path) == 0
    assert ": 1 ticks, 0 messages, 0 updates of b_hat: all bits are equal\n" in capsys.readouterr().out


def test_a_log_with_a_changed_bit_is_reported_with_line_and_tick(
    check_log: ModuleType, short_log: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """The log is that of a healthy robot, but for the last bit of x in its first line ``settle,x,...``.

    That is line 3, after the lines of the start and of an observation. With it the first tick ends.
    """
    before, rest = short_log.split("settle,", maxsplit=1)
    x, others = rest.split(",", maxsplit=1)
    wrong_x = int(x) ^ 1

    exit_code = exit_code_for_log(check_log, f"{before}settle,{wrong_x},{others}", tmp_path)

    assert exit_code == 1
    assert f"line 3 in tick 1 differs: settle gave [{wrong_x}," in capsys.readouterr().out


@pytest.mark.parametrize(
    ("damaged_log", "expected_message"),
    [
        ("", "no robot can start so"),
        ("start,7\n", "no robot can start so"),
        ("start,128,4080218931,2,1000,2147483648\n", "no robot can start so: robot id is 128"),
        ("start,7,4080218931,9,1000,2147483648\n", "no robot can start so: 9 is not a valid Filter"),
        ("start,7,4080218931,0,1000,2147483648\ntable,1,2,3\n", "no robot can start so: a table has"),
        (f"{LOG_OF_ONE_BLACK_TILE}observe,2\n", "line 4 is no call"),
        (f"{LOG_OF_ONE_BLACK_TILE}receive,1,2\n", "line 4 is no call"),
        (f"{LOG_OF_ONE_BLACK_TILE}receive,1,2,-3,0\n", "line 4 is no call"),
        (f"{LOG_OF_ONE_BLACK_TILE}settle,8388608", "line 4 is no call"),
        (
            f"{LOG_OF_ONE_BLACK_TILE}dance,1\n",
            "line 4 is no call that a robot can log: it begins with 'dance'",
        ),
        (f"{LOG_OF_ONE_BLACK_TILE}ü", "'ascii' codec can't decode byte"),
    ],
)
def test_a_damaged_log_is_refused_with_the_line(
    damaged_log: str,
    expected_message: str,
    check_log: ModuleType,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
) -> None:
    """check_log.py prints what is wrong, and ends with the code 2."""
    assert exit_code_for_log(check_log, damaged_log, tmp_path) == 2
    assert f"cannot be checked: {expected_message}" in capsys.readouterr().err


def test_a_missing_log_is_reported(check_log: ModuleType, capsys: pytest.CaptureFixture[str]) -> None:
    """check_log.py ends with the code 2, as for a log that is damaged."""
    assert check_log.main(["no/such.csv"]) == 2
    assert "no/such.csv: cannot be checked: [Errno 2] No such file or directory" in capsys.readouterr().err


def test_without_a_log_the_usage_of_check_log_is_shown(
    check_log: ModuleType, capsys: pytest.CaptureFixture[str]
) -> None:
    """check_log.py is called without an argument, and ends with the code 2."""
    assert check_log.main([]) == 2
    assert capsys.readouterr().err == "usage: python3 check_log.py LOG.csv ...\n"
