"""The files of .github name files and commands that are there."""

from __future__ import annotations

import os
import re
from pathlib import Path

import pytest
import yaml

from mcp_asdf_tools.cli import main as cli
from support import ROOT

GITHUB = ROOT / ".github"
FILES = sorted(path for path in GITHUB.rglob("*") if path.is_file())


@pytest.mark.parametrize("path", FILES, ids=lambda path: path.name)
def test_files_and_commands_that_are_named_are_there(path: Path) -> None:
    text = path.read_text(encoding="utf-8")
    if path.suffix == ".yml":
        assert yaml.safe_load(text)
    for link in re.findall(r"\]\((?!https?:)([^)#\s]+)", text):
        assert (path.parent / link).exists(), link
    for name in re.findall(r"(?<![\w/.-])(?:docs|tests|c_ref|\.ci)/[\w./-]*\w", text):
        assert (ROOT / name).exists(), name
    for command in re.findall(r"mcp-asdf (\w+)", text):
        assert command in cli.COMMANDS, command


def test_the_tests_workflow_runs_what_continuous_integration_runs() -> None:
    workflow = yaml.safe_load((GITHUB / "workflows/tests.yml").read_text(encoding="utf-8"))
    (job,) = workflow["jobs"].values()
    assert job["steps"][-1]["run"] == ".ci/run"
    assert os.access(ROOT / ".ci/run", os.X_OK)
