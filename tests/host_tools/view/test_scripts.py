"""The scripts of the web pages without a browser: the tests in the folder ``scripts``, which Node.js runs."""

from __future__ import annotations

import re
import shutil
from pathlib import Path

import pytest

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
