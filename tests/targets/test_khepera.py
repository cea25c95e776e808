"""The page of the Khepera IV: node and sensor are built for a Cortex-A8, calibrated, run as its service
says, and watched; in the place of the vendor's library stand readings in a file."""

from __future__ import annotations

import configparser
import json
import random
import re
import subprocess
from pathlib import Path

import pytest

from mcp_asdf_tools.bus.frames import Estimate, FrameFormat, decode_estimate
from multicast import multicast
from support import PATIENCE, ROOT, blocks, require, run
from targets.c_node import CORTEX_A8

PAGE = ROOT / "docs/platforms/khepera.md"
LIBRARY = """\
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


def put_down(folder: Path, centre: int, readings: int) -> list[int]:
    """Let the next run of the sensor be over a floor of that brightness; returns its readings."""
    draw = random.Random(centre)
    pairs = [(round(draw.gauss(centre, 120)), draw.randrange(-9, 10)) for _ in range(readings)]
    pairs = [(max(left, 20), max(left, 20) + 2 * more) for left, more in pairs]
    (folder / "ground").write_text("".join(f"{left} {right}\n" for left, right in pairs), encoding="ascii")
    return [(left + right) // 2 for left, right in pairs]


@pytest.mark.slow
def test_the_page_makes_a_robot(tmp_path: Path) -> None:
    choice, commands = multicast(93), blocks(PAGE, "sh")
    require(*CORTEX_A8.compiler)
    require("qemu-arm", "qemu-user")
    for name in ("c_ref", "tables"):
        (tmp_path / name).symlink_to(ROOT / name)
    run("sh", "-exc", commands[0], cwd=tmp_path)
    node = tmp_path / "build/khepera/mcp_asdf_node"
    notes = run("arm-linux-gnueabihf-readelf", "-ndA", node)
    assert "VFP registers" in notes
    assert "There is no dynamic section" in notes
    (kernel,) = re.findall(r"OS: Linux, ABI: (\S+)", notes)
    assert f"Linux {kernel} or later" in PAGE.read_text(encoding="utf-8")

    (tmp_path / "khepera").mkdir()
    (tmp_path / "khepera/khepera.h").write_text(LIBRARY, encoding="ascii")
    (tmp_path / "tile_sensor.c").write_text(blocks(PAGE, "c")[0], encoding="utf-8")
    build = commands[1].replace("arm-angstrom-linux-gnueabi-gcc", "arm-linux-gnueabihf-gcc -Wall -Wextra")
    run(
        "sh", "-exc", build.replace("-L $LIBPATH -lkhepera", "-static").replace("$INCPATH", "."), cwd=tmp_path
    )
    for program in (node, tmp_path / "tile_sensor"):
        emulated = program.rename(f"{program}.arm")
        (tmp_path / program.name).write_text(f'#!/bin/sh\nexec qemu-arm -cpu cortex-a8 {emulated} "$@"\n')
        (tmp_path / program.name).chmod(0o755)

    over_black, over_white, *rest = commands[2].splitlines(keepends=True)
    for command, centre in ((over_black, 300), (over_white, 700)):
        readings = put_down(tmp_path, centre, 600)
        run("sh", "-exc", command, cwd=tmp_path)
        said = tmp_path / command.split()[-1]
        assert [int(line) for line in said.read_text(encoding="ascii").split()] == readings
    (told,) = blocks(PAGE, "text")
    assert run("sh", "-exc", "".join(rest), cwd=tmp_path) == told

    service = configparser.ConfigParser(interpolation=None)
    service.read_string(blocks(PAGE, "ini")[0])
    line = service["Service"]["ExecStart"]
    threshold = int(re.findall(r"tile_sensor (\d+) ", line)[0])
    assert f"threshold {threshold}:" in told
    assert re.findall("--b-hat [0-9.]+", line) == re.findall("--b-hat [0-9.]+", told)
    group = f"udp:{choice.settings['channel']}:{choice.settings['port']}"
    line = line.replace("udp:239.74.163.2:43113", group).replace("--network wlan0", "--hop-limit 0")
    readings = put_down(tmp_path, 500, 200)
    with choice.open() as bus:
        command = line.replace("--observations", "--steps-per-second 100 --observations")
        done = subprocess.run(
            command, shell=True, cwd=tmp_path, capture_output=True, text=True, timeout=PATIENCE, check=True
        )
        heard = [decode_estimate(frame, FrameFormat()) for frame in iter(lambda: bus.recv(1), None)]
    figures = json.loads(done.stdout)
    assert (figures["ended"], figures["t"]) == ("observations", 200)
    assert figures["n"] == sum(reading < threshold for reading in readings)
    estimates = [each for each in heard if isinstance(each, Estimate)]
    assert [each.sender for each in estimates] == [7] * figures["estimates"]
    assert (estimates[-1].x_hat, (tmp_path / "robot.state").exists()) == (figures["x_hat"], True)


def test_a_dynamic_link_would_want_the_glibc_that_the_page_names(tmp_path: Path) -> None:
    require(*CORTEX_A8.compiler)
    (tmp_path / "main.c").write_text("int main(void) { return 0; }\n", encoding="ascii")
    run("arm-linux-gnueabihf-gcc", tmp_path / "main.c", "-o", tmp_path / "main")
    symbols = run("arm-linux-gnueabihf-objdump", "-T", tmp_path / "main")
    assert max(re.findall(r"GLIBC_2\.(\d+)", symbols), key=int) == "34"
    assert "GLIBC_2.34" in PAGE.read_text(encoding="utf-8")
