"""The files of .github are valid and name files and commands that are there."""

from __future__ import annotations

import os
import re
from typing import Any

import pytest
import yaml

from mcp_asdf_tools.cli import main as cli
from support import ROOT, blocks, require, run

GITHUB = ROOT / ".github"
FORMS = [GITHUB / "ISSUE_TEMPLATE" / name for name in ("bug.yml", "feature.yml")]
WORKFLOWS = sorted((GITHUB / "workflows").glob("*.yml"))
PARTS = {"textarea", "input", "dropdown", "checkboxes", "markdown"}
LINK = re.compile(r"\]\((?!https?:)([^)#\s]+)")
FILE = re.compile(r"(?<![\w/.-])(?:docs|tests|c_ref|\.ci)/[\w./-]*\w")


def read(path: os.PathLike[str]) -> dict[str, Any]:
    with open(path, encoding="utf-8") as file:
        content = yaml.load(file, yaml.BaseLoader)  # of strings only, so "on" stays "on"
    assert isinstance(content, dict)
    return content


@pytest.mark.parametrize("form", FORMS, ids=lambda path: path.name)
def test_a_form_has_what_the_site_asks_for(form: os.PathLike[str]) -> None:
    content = read(form)
    assert {"name", "description", "body"} <= set(content)
    ids = [part["id"] for part in content["body"]]
    assert len(set(ids)) == len(ids)
    for part in content["body"]:
        assert part["type"] in PARTS
        assert part["attributes"]["label"]
        assert part["type"] != "dropdown" or len(set(part["attributes"]["options"])) > 1


def test_every_file_of_yaml_is_tested() -> None:
    assert {*FORMS, *WORKFLOWS, GITHUB / "ISSUE_TEMPLATE/config.yml"} == set(GITHUB.rglob("*.yml"))
    assert read(GITHUB / "ISSUE_TEMPLATE/config.yml")["blank_issues_enabled"] == "true"


@pytest.mark.parametrize("workflow", WORKFLOWS, ids=lambda path: path.name)
def test_a_workflow_runs_programs_that_are_there(workflow: os.PathLike[str]) -> None:
    content = read(workflow)
    assert content["on"]
    assert content["permissions"] == {"contents": "read"}
    for job in content["jobs"].values():
        assert int(job["timeout-minutes"]) <= 120
        for step in job["steps"]:
            assert ("run" in step) != ("uses" in step)
            for path in re.findall(r"(?<!\S)\.ci/\S+", step.get("run", "")):
                assert os.access(ROOT / path, os.X_OK), path


def test_the_tests_workflow_runs_what_continuous_integration_runs() -> None:
    (job,) = read(GITHUB / "workflows/tests.yml")["jobs"].values()
    assert job["steps"][-1]["run"] == ".ci/run"


@pytest.mark.parametrize("path", sorted(p for p in GITHUB.rglob("*") if p.is_file()), ids=lambda p: p.name)
def test_files_and_commands_that_are_named_are_there(path: os.PathLike[str]) -> None:
    with open(path, encoding="utf-8") as file:
        text = file.read()
    folder = os.path.dirname(path)
    for link in LINK.findall(text):
        assert os.path.exists(os.path.join(folder, link)), link
    for name in FILE.findall(text):
        assert (ROOT / name).exists(), name
    for command in re.findall(r"mcp-asdf (\w+)", text):
        assert command in cli.COMMANDS, command


def test_the_make_targets_are_there() -> None:
    (block,) = blocks(GITHUB / "CONTRIBUTING.md", "sh")
    for target in re.findall(r"^make (\w+)", block, re.MULTILINE):
        run(require("make", "make"), "-n", target)
