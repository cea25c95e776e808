"""The scripts of the web pages without a browser: the tests in the folder ``scripts``, which Node.js runs."""

from __future__ import annotations

import json
import re
import shutil
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from mcp_asdf_tools.view.history import NO_LINKS, RunDescription, State
from mcp_asdf_tools.view.page import encode_description, encode_states
from support import ROOT, matching_files, require, run

FOLDER = Path(__file__).with_name("scripts")
PACKAGES = {"view": ROOT / "host_tools/mcp_asdf_tools/view/page", "playground": ROOT / "docs/playground"}
"""Folders of scripts, by the names under which the page imports them: "view/charts" is page/charts.js."""


@pytest.fixture
def folder_with_scripts(tmp_path: Path) -> Path:
    """A folder with the tests and the scripts, where node finds them under their names of the page."""
    for path in matching_files(FOLDER, "*.js"):
        shutil.copy(path, tmp_path)
    (tmp_path / "package.json").write_text('{"type": "module"}')
    for name, scripts in PACKAGES.items():
        package = tmp_path / "node_modules" / name
        package.mkdir(parents=True)
        (package / "package.json").write_text('{"type": "module", "exports": {"./*": "./*.js"}}')
        for path in matching_files(scripts, "*.js"):
            shutil.copy(path, package)
    return tmp_path


def test_all_tests_of_the_scripts_pass_in_node_js(folder_with_scripts: Path) -> None:
    """Each test begins with ``test(``, and its result is a line such as "ok 3 - a value has three digits".

    The script all.js imports all files of tests, which runs them.
    """
    test_files = sorted(folder_with_scripts.glob("*.test.js"))
    import_lines = "".join(f'import "./{file.name}";\n' for file in test_files)
    (folder_with_scripts / "all.js").write_text(import_lines)
    output = run(require("node", "nodejs"), "--test-reporter=tap", "all.js", cwd=folder_with_scripts)

    text_of_all_files = "".join(file.read_text(encoding="utf-8") for file in test_files)
    tests = re.findall(r"^test\(", text_of_all_files, re.MULTILINE)
    passed_tests = re.findall(r"^ok \d+ - ", output, re.MULTILINE)
    assert len(tests) > 0
    assert len(passed_tests) == len(tests)


DECODE_TWO_STATES = """\
import { readFileSync } from "node:fs";
import { History } from "view/history";

const { description, block } = JSON.parse(readFileSync("page.json"));
const history = await History.decode(description);
await history.appendBlock(block);
const states = [0, 1].map((state) => ({
  tick: history.ticks[state],
  x: [0, 1, 2].map((robot) => history.value("x", robot, state)),
  b: [0, 1, 2].map((robot) => history.value("b", robot, state)),
  position: history.position(2, state),
  links: history.links(state),
}));
console.log(JSON.stringify({ states, linksToRobot0: history.links(1, 0) }));
"""
"""A script that reads page.json and prints its states; JSON has null for NaN."""


def decode_by_scripts(description: RunDescription, states: list[State], folder: Path) -> Any:
    """Encode two states in Python, and return the states that the scripts in a folder decode from this."""
    page = {
        "description": encode_description(description),
        "block": encode_states(states, description),
    }
    (folder / "page.json").write_text(json.dumps(page))
    (folder / "decode.js").write_text(DECODE_TWO_STATES)
    return json.loads(run(require("node", "nodejs"), "decode.js", cwd=folder))


def test_the_scripts_of_the_page_decode_the_states_that_python_encodes(folder_with_scripts: Path) -> None:
    """Values below 0 and above 1 become these limits, and unknown ones stay unknown.

    The arena is 4 m wide and 2 m high. In the second state robot 0 receives from the robots 1 and 2. A link
    of Python is receiver and sender, and one of the scripts is sender and receiver.
    """
    description = RunDescription("three", [3, 5, 8], sides=(4.0, 2.0))
    first_values = np.array([[0.0, 0.25, np.nan], [0.0] * 3, [0.0] * 3, [-0.1, 1.1, 0.5]])
    second_values = np.array([[1.0, np.nan, 0.25], [0.0] * 3, [0.0] * 3, [0.5] * 3])
    links = np.array([(0, 1), (0, 2), (1, 0)], np.uint16)
    states = [
        State(5, first_values, NO_LINKS, np.array([(0.0, 0.0), (0.0, 0.0), (2.0, -0.5)])),
        State(300, second_values, links, np.array([(0.0, 0.0), (0.0, 0.0), (-2.0, 1.0)])),
    ]
    decoded = decode_by_scripts(description, states, folder_with_scripts)

    first_state, second_state = decoded["states"]
    one_unit = 1 / 65534  # of the 16-bit numbers in which values are stored
    assert (first_state["tick"], second_state["tick"]) == (5, 300)
    assert first_state["x"] == [0, pytest.approx(0.25, abs=one_unit), None]
    assert second_state["x"] == [1, None, pytest.approx(0.25, abs=one_unit)]
    assert first_state["b"] == [0, 1, pytest.approx(0.5, abs=one_unit)]
    assert first_state["position"] == pytest.approx([2.0, -0.5], abs=4 * one_unit)
    assert second_state["position"] == pytest.approx([-2.0, 1.0], abs=4 * one_unit)
    assert first_state["links"] == []
    assert second_state["links"] == [[1, 0], [2, 0], [0, 1]]
    assert decoded["linksToRobot0"] == [[1, 0], [2, 0]]
