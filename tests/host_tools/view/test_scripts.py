"""The scripts of the page without a browser: the tests in the folder ``scripts``, which node runs."""

from __future__ import annotations

import re
import shutil
from pathlib import Path

import pytest

from support import ROOT, matching_files, require, run

FOLDER = Path(__file__).with_name("scripts")
PACKAGES = {
    "view": ROOT / "host_tools/mcp_asdf_tools/view/page",
    "playground": ROOT / "docs/playground",
}
"""Folders of scripts, by the names under which the page imports them: "view/charts" is page/charts.js."""


@pytest.fixture
def folder(tmp_path: Path) -> Path:
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


@pytest.mark.parametrize("name", [path.name for path in matching_files(FOLDER, "*.test.js")])
def test_the_scripts_of_the_page_compute_what_they_show(name: str, folder: Path) -> None:
    output = run(require("node", "nodejs"), "--test", "--test-reporter=tap", name, cwd=folder)
    stated_tests = re.findall(r"^test\(", (folder / name).read_text(encoding="utf-8"), re.MULTILINE)
    passed_tests = re.findall(r"^ *ok \d+ - (?!\S*\.test\.js$)", output, re.MULTILINE)
    assert len(passed_tests) == len(stated_tests) > 0
