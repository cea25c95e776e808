"""The C firmware computes the same bits on every target, with every compiler at every level.

Files in this folder hold calls of robots, and a digest of what MirrorRobot, the robot in Python, answers to
them. On each target an image plays them: it makes the calls, and compares digests.
"""

from __future__ import annotations

import re
from dataclasses import replace
from pathlib import Path

import pytest

from mcp_asdf_tools.crosscheck.scenario import Scenario
from support import slow
from targets import matrix
from targets.golden_vectors import FILES, HERE, Player, content_made_anew, expected_verdict, played
from targets.matrix import HOST, TARGETS, ImageBuild, further_builds, usual_build

QUICK_FILES = ("golden_few.bin", "golden_robust.bin")
SLOW_FILES = [name for name in FILES if name not in QUICK_FILES]
QUICK_BUILDS = [
    replace(usual_build(target), files=QUICK_FILES) for target in TARGETS if target.name == "cortex-m0"
]
"""The target whose arithmetic differs most from this computer's. The AVR differs more, but takes too long.

For the arithmetic of the AVR and the others, and for the order of bytes of an s390x, make test has the C
tests that tests/c_ref/test_presets.py builds.
"""
SLOW_BUILDS = [*map(usual_build, TARGETS), *further_builds()]
FIRST_FILE = next(iter(FILES))


@pytest.mark.parametrize("name", [*QUICK_FILES, *slow(SLOW_FILES)])
def test_the_files_of_calls_are_what_the_robot_in_python_gives(name: str) -> None:
    """A file has calls of robots, and a digest of what the robot in Python answers to them.

    If the content that is made anew differs, the robot in Python computes other bits than before.
    """
    stored_content = (HERE / name).read_bytes()
    assert content_made_anew(name) == stored_content, "write it again and say why in the changelog"


@pytest.mark.parametrize("build", [*QUICK_BUILDS, *slow(SLOW_BUILDS)], ids=str)
def test_a_target_computes_the_same_bits_as_the_robot_in_python(build: ImageBuild, tmp_path: Path) -> None:
    """An image plays files of calls on the target, and compares answers with those of the robot in Python.

    It prints "PASS" and the numbers of calls in the files if all are the same.
    """
    build.require_tools()
    for file_names in build.images():
        printed = matrix.play(build, tmp_path, *(HERE / name for name in file_names))
        assert expected_verdict(file_names) in printed, printed
        assert "failed" not in printed, printed


def longest_scenario() -> tuple[int, Scenario]:
    """Return the scenario of the first file that has the most calls, and its number."""
    numbered = enumerate(scenario for scenario, _ in played(FIRST_FILE))
    return max(numbered, key=lambda number_and_scenario: len(number_and_scenario[1].calls))


def first_file_with_wrong_digest(scenario_number: int) -> bytes:
    """Return the first file with a flipped bit in a scenario's digest."""
    bytes_of_head = 6  # a word, and the number of scenarios in 2 bytes
    scenarios_before = played(FIRST_FILE)[:scenario_number]
    place_of_digest = bytes_of_head + sum(len(encoded) for _, encoded in scenarios_before)
    wrong_content = bytearray((HERE / FIRST_FILE).read_bytes())
    wrong_content[place_of_digest] ^= 1
    return bytes(wrong_content)


@pytest.mark.slow
def test_an_image_that_computes_other_bits_prints_every_call(tmp_path: Path) -> None:
    """A file has scenarios, which are calls of a robot, each with a digest. One digest is wrong here.

    Then the image's answers to this scenario have another digest, and it prints them, so that a user can see
    in which call the bits begin to differ. The robot in Python, in a ``Player``, has the same answers.
    """
    number, scenario = longest_scenario()
    (tmp_path / "wrong.bin").write_bytes(first_file_with_wrong_digest(number))

    printed = matrix.play(usual_build(HOST), tmp_path, tmp_path / "wrong.bin")

    first_line = rf"scenario {number} expected \d+ found \d+"
    lines_of_calls = Player(scenario).lines
    expected_end = "\n".join([first_line, *lines_of_calls, "FAIL", "a test of the image failed"])
    assert re.search(f"^{expected_end}$", printed, re.MULTILINE), printed
