"""The page of the Khepera IV: node and sensor are built for a Cortex-A8, calibrated, run as its service
says, and watched; in the place of the vendor's library stand readings in a file."""

from __future__ import annotations

import configparser
import json
import random
import re
import shutil
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import can
import pytest

from mcp_asdf_tools.bus.frames import Estimate, FrameFormat, decode_estimate
from multicast import multicast
from support import ROOT, blocks, made_once, replace_each, require, run
from targets.c_node import CORTEX_A8

PAGE = ROOT / "docs/platforms/khepera.md"
STAND_IN_FOR_LIBRARY = """\
#include <stdio.h>
#include <stdlib.h>
#include <time.h>
#define KNET_BUS_I2C 0
#define nanosleep(tick, left) (void)(tick)
typedef FILE knet_dev_t;
static int kh4_init(int count, char **words) { return count != 0 || words != NULL; }
static FILE *knet_open(const char *name, int bus, int address, void *more)
{
    return bus == 0 && address == 0 && more == NULL && name[0] == 'K' ? fopen("ground", "r") : NULL;
}
static int kh4_proximity_ir(char *bytes, FILE *ground)
{
    int left, right;
    if (fscanf(ground, "%d %d", &left, &right) != 2) {
        exit(0);
    }
    for (int i = 0; i < 24; ++i) {
        bytes[i] = (char)0xFF;
    }
    bytes[18] = (char)left, bytes[19] = (char)(left >> 8);
    bytes[20] = (char)right, bytes[21] = (char)(right >> 8);
    return left < 0 ? -1 : 24;
}
"""
"""Takes the place of the Khepera's library: the readings of its two ground sensors come from a file."""


def put_on_floor(folder: Path, brightness: int, reading_count: int) -> list[int]:
    """Let the next run of the sensor be over a floor of this brightness, and return its readings.

    A reading is the mean of the two sensors that look at the ground, left and right. The stand-in for the
    library reads their values from the file "ground", which is written here.
    """
    rng = random.Random(brightness)
    lines, readings = "", []
    for _ in range(reading_count):
        left = max(round(rng.gauss(brightness, 120)), 20)
        right = left + 2 * rng.randrange(-9, 10)  # an even difference, so that the mean is a whole number
        lines += f"{left} {right}\n"
        readings.append((left + right) // 2)
    (folder / "ground").write_text(lines, encoding="ascii")
    return readings


BUILD_NODE, BUILD_SENSOR, CALIBRATE, *_ = blocks(PAGE, "sh")
"""The page's commands. CALIBRATE records a black floor, then a white one, and computes from both."""
[CALIBRATION_OUTPUT] = blocks(PAGE, "text")
"""The output of the page's calibration, as the page shows it."""


def build_programs(folder: Path) -> None:
    """Build node and sensor with the page's commands, but with Debian's compiler and STAND_IN_FOR_LIBRARY.

    Their names stand for scripts that run them in an emulator.
    """
    for name in ("c_ref", "tables"):
        (folder / name).symlink_to(ROOT / name)
    run("sh", "-exc", BUILD_NODE, cwd=folder)
    (folder / "khepera").mkdir()
    (folder / "khepera/khepera.h").write_text(STAND_IN_FOR_LIBRARY, encoding="ascii")
    (folder / "tile_sensor.c").write_text(blocks(PAGE, "c")[0], encoding="utf-8")
    replacements = {
        "arm-angstrom-linux-gnueabi-gcc": "arm-linux-gnueabihf-gcc -Wall -Wextra",
        "-L $LIBPATH -lkhepera": "-static",
        "$INCPATH": ".",
    }
    run("sh", "-exc", replace_each(BUILD_SENSOR, replacements), cwd=folder)
    for program in (folder / "build/khepera/mcp_asdf_node", folder / "tile_sensor"):
        emulated = program.rename(f"{program}.arm")
        script = folder / program.name
        script.write_text(f'#!/bin/sh\nexec qemu-arm -cpu cortex-a8 {emulated} "$@"\n')
        script.chmod(0o755)


@pytest.fixture
def robot(tmp_path: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with both programs, as the page's commands leave it."""
    require(*CORTEX_A8.compiler)
    require("qemu-arm", "qemu-user")
    built = made_once(tmp_path_factory, "khepera", build_programs)
    return Path(shutil.copytree(built, tmp_path / "robot", symlinks=True))


def service_command() -> str:
    """Return the command by which the page's service, for systemd, starts the robot.

    It runs a sensor that compares readings with a threshold, and pipes 0 or 1 to the node.
    """
    service = configparser.ConfigParser(interpolation=None)
    service.read_string(blocks(PAGE, "ini")[0])
    return service["Service"]["ExecStart"]


@pytest.mark.slow
def test_the_node_for_a_khepera_runs_on_its_linux_whatever_libraries_are_there(robot: Path) -> None:
    """readelf finds no dynamic section in it, so it needs no libraries, and it uses registers for floats.

    The earliest kernel on which it runs is that which docs/platforms/khepera.md names.
    """
    notes = run("arm-linux-gnueabihf-readelf", "-ndA", robot / "build/khepera/mcp_asdf_node.arm")

    assert "There is no dynamic section" in notes
    assert "VFP registers" in notes
    [kernel] = re.findall(r"OS: Linux, ABI: (\S+)", notes)
    assert f"Linux {kernel} or later" in PAGE.read_text(encoding="utf-8")


def record_floor(robot: Path, command: str, brightness: int) -> None:
    """Run a command that writes the sensor's readings over a floor to a file, and check the file."""
    readings = put_on_floor(robot, brightness, reading_count=600)
    run("sh", "-exc", command, cwd=robot)
    *_, file_name = command.split()
    written = (robot / file_name).read_text(encoding="ascii").split()
    assert [int(line) for line in written] == readings


@pytest.mark.slow
def test_the_calibration_of_a_khepera_prints_what_docs_khepera_shows(robot: Path) -> None:
    """It computes the threshold and the accuracy from readings over a black and over a white floor.

    docs/platforms/khepera.md has the commands (CALIBRATE), of which the first two record a floor each, and
    shows what the others print (CALIBRATION_OUTPUT). ``record_floor`` draws the readings around a brightness.
    """
    command_over_black, command_over_white, *commands_that_compute = CALIBRATE.splitlines(keepends=True)
    record_floor(robot, command_over_black, brightness=300)
    record_floor(robot, command_over_white, brightness=700)

    printed = run("sh", "-exc", "".join(commands_that_compute), cwd=robot)

    assert printed == CALIBRATION_OUTPUT


def test_the_service_of_a_khepera_has_the_threshold_and_the_accuracy_of_the_calibration() -> None:
    """docs/platforms/khepera.md shows both: a service of systemd, and what the calibration prints.

    The threshold is an argument of the service's sensor, and the accuracy is its node's option --b-hat.
    """
    [threshold] = re.findall(r"tile_sensor (\d+) ", service_command())
    [accuracy] = re.findall("--b-hat ([0-9.]+)", service_command())
    [calibrated_accuracy] = re.findall("--b-hat ([0-9.]+)", CALIBRATION_OUTPUT)

    assert f"threshold {threshold}:" in CALIBRATION_OUTPUT
    assert accuracy == calibrated_accuracy


@dataclass(frozen=True)
class Khepera:
    """A Khepera that has run as its service says, until its sensor had no more readings.

    Attributes:
        summary: What its node has printed.
        estimates: What it has broadcast.
    """

    summary: dict[str, Any]
    estimates: list[Estimate]


def run_as_service_says(folder: Path) -> Khepera:
    """Run the service's command, but on a bus of this test and ten times as fast."""
    choice = multicast(group=93)
    command = replace_each(
        service_command(),
        {
            "udp:239.74.163.2:43113": f"udp:{choice.settings['channel']}:{choice.settings['port']}",
            "--network wlan0": "--hop-limit 0",
            "--observations": "--steps-per-second 100 --observations",
        },
    )
    with choice.open() as bus:
        printed = run("sh", "-c", command, cwd=folder)
        return Khepera(json.loads(printed), receive_estimates(bus))


def receive_estimates(bus: can.BusABC) -> list[Estimate]:
    """Receive all frames of a bus until none comes for a second, and return the estimates among them."""
    estimates = []
    one_second = 1
    while (frame := bus.recv(one_second)) is not None:
        content = decode_estimate(frame, FrameFormat())
        if isinstance(content, Estimate):
            estimates.append(content)
    return estimates


@pytest.mark.slow
def test_a_khepera_that_runs_as_its_service_says_observes_and_broadcasts(robot: Path) -> None:
    """It moves over 200 tiles. Tiles below the service's threshold are black. Its id is 7.

    In the end its node prints a summary: t tiles, n black ones, the number of estimates that it has sent, and
    the last estimate, x_hat. It saves its state in the file that the service names, robot.state.
    """
    readings = put_on_floor(robot, brightness=500, reading_count=200)
    [threshold] = re.findall(r"tile_sensor (\d+) ", service_command())

    khepera = run_as_service_says(robot)

    black_tiles = [reading for reading in readings if reading < int(threshold)]
    assert khepera.summary["ended"] == "observations"
    assert khepera.summary["t"] == 200
    assert khepera.summary["n"] == len(black_tiles)
    assert khepera.summary["estimates"] == len(khepera.estimates)
    *_, last_estimate = khepera.estimates
    assert last_estimate.sender == 7
    assert last_estimate.x_hat == khepera.summary["x_hat"]
    assert (robot / "robot.state").exists()
