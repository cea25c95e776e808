"""The C firmware computes the same bits on every target, with every compiler at every level.

Files in this folder hold calls of robots, and a digest of what MirrorRobot, the robot in Python, answers to
them. On each target an image plays them: it makes the calls, and compares digests. Each must also do without
a library.
"""

from __future__ import annotations

import re
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import pytest

from mcp_asdf import mirror
from mcp_asdf.robot import Status
from support import made_once, slow
from targets import matrix
from targets.golden_vectors import FILES, HERE, Player, content, played, scenarios, verdict
from targets.matrix import HOST, TARGETS, WASM, ImageBuild, quick_build, slow_builds

QUICK_TARGETS = ("cortex-m0",)
"""The target that computes least like this computer, but for the AVR, whose images take ten times as long.

For the arithmetic of the AVR and the others, and for the order of bytes of an s390x, make test has the C
tests that tests/c_ref/test_presets.py builds.
"""
QUICK_BUILDS = [quick_build(target) for target in TARGETS if target.name in QUICK_TARGETS]
SLOW_BUILDS = [
    *(quick_build(target) for target in TARGETS if target.name not in QUICK_TARGETS),
    *slow_builds(),
]
FIRST_FILE = next(iter(FILES))
QUICK_FILES = ("golden_few.bin", "golden_robust.bin")
SLOW_FILES = [name for name in FILES if name not in QUICK_FILES]


def has_objects(build: ImageBuild) -> bool:
    """Return whether the compiled core can be looked into; with an optimising linker it is no machine code.

    Of WebAssembly the linker refuses an image that lacks something.
    """
    return "LTO" not in build.level and build.target != WASM


@dataclass(frozen=True)
class PlayedImages:
    """What the images of a build printed, each with the files that it plays, and where they were built."""

    outputs: list[tuple[list[str], str]]
    folder: Path


def play_images(build: ImageBuild, folder: Path) -> None:
    """Build the images in a folder and play them, and write what each prints to a file there."""
    for number, files in enumerate(build.images()):
        printed = matrix.play(build, folder, *(HERE / name for name in files))
        (folder / f"printed_{number}.txt").write_text(printed, encoding="utf-8")


@pytest.fixture(scope="module")
def played_images(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> PlayedImages:
    build: ImageBuild = request.param
    build.require_tools()
    folder = made_once(tmp_path_factory, f"image {build}", partial(play_images, build))
    outputs = [
        (files, (folder / f"printed_{number}.txt").read_text(encoding="utf-8"))
        for number, files in enumerate(build.images())
    ]
    return PlayedImages(outputs, folder)


@pytest.mark.parametrize("name", [*QUICK_FILES, *slow(SLOW_FILES)])
def test_the_files_of_calls_are_what_the_robot_in_python_gives(name: str) -> None:
    assert content(name) == (HERE / name).read_bytes(), "write it again and say why in the changelog"


@pytest.mark.parametrize("played_images", [*QUICK_BUILDS, *slow(SLOW_BUILDS)], ids=str, indirect=True)
def test_a_target_computes_the_same_bits_as_the_robot_in_python(played_images: PlayedImages) -> None:
    """An image prints "PASS" and the numbers of calls. Where one goes wrong it prints every call."""
    for files, printed in played_images.outputs:
        wrong_scenario = re.search(r"scenario (\d+) expected", printed)
        if wrong_scenario is not None:
            scenario = scenarios(*files)[int(wrong_scenario[1])]
            assert re.findall(r"call .*", printed) == Player(scenario).lines, printed
        assert verdict(files) in printed, printed
        assert "failed" not in printed, printed


@pytest.mark.parametrize(
    "played_images",
    [*filter(has_objects, QUICK_BUILDS), *slow(filter(has_objects, SLOW_BUILDS))],
    ids=str,
    indirect=True,
)
def test_the_firmware_needs_no_library_and_no_variables_on_a_target(
    played_images: PlayedImages, request: pytest.FixtureRequest
) -> None:
    """It may call what the target's compiler needs for integers."""
    build: ImageBuild = request.node.callspec.params["played_images"]
    objects = matrix.core_objects(played_images.folder)

    foreign_symbols = {
        name for name in matrix.needed_symbols(objects) if not re.fullmatch(build.target.helpers, name)
    }

    assert foreign_symbols == set()
    assert [matrix.variables(each) for each in objects] == [0] * len(objects), "bytes of variables"


@pytest.mark.slow
def test_an_image_that_computes_other_bits_prints_every_call(tmp_path: Path) -> None:
    """One digest in its file is wrong, that of the scenario with the most calls."""
    scenarios_and_bytes = played(FIRST_FILE)
    call_counts = [len(scenario.calls) for scenario, _ in scenarios_and_bytes]
    number = call_counts.index(max(call_counts))
    scenario, _ = scenarios_and_bytes[number]
    bytes_of_head = 6
    place_of_digest = bytes_of_head + sum(len(encoded) for _, encoded in scenarios_and_bytes[:number])
    content_with_wrong_digest = bytearray((HERE / FIRST_FILE).read_bytes())
    content_with_wrong_digest[place_of_digest] ^= 1
    (tmp_path / "wrong.bin").write_bytes(content_with_wrong_digest)

    printed = matrix.play(quick_build(HOST), tmp_path, tmp_path / "wrong.bin")

    last_lines = [*Player(scenario).lines, "FAIL", "a test of the image failed"]
    *_, complaint = printed.splitlines()[: -len(last_lines)]
    assert re.fullmatch(rf"scenario {number} expected \d+ found \d+", complaint)
    assert printed.splitlines()[-len(last_lines) :] == last_lines


@pytest.mark.slow
def test_a_file_written_by_a_wrong_robot_in_python_fails_on_the_c(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """So writing the files again hides no mistake of the robot in Python."""
    right_settle = mirror.MirrorRobot.settle

    def settle_and_count_first_tick_twice(robot: mirror.MirrorRobot) -> Status:
        status = right_settle(robot)
        if robot.s.t == 1:
            robot.s.t = 2
        return status

    monkeypatch.setattr(mirror.MirrorRobot, "settle", settle_and_count_first_tick_twice)
    played.cache_clear()
    try:
        (tmp_path / FIRST_FILE).write_bytes(content(FIRST_FILE))
    finally:
        played.cache_clear()
    assert (tmp_path / FIRST_FILE).read_bytes() != (HERE / FIRST_FILE).read_bytes()

    assert "FAIL" in matrix.play(quick_build(HOST), tmp_path, tmp_path / FIRST_FILE)
