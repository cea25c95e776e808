"""The page about data frames: its commands and programs print what it shows, in each program for analysis."""

from __future__ import annotations

import re
import sys
from importlib.util import find_spec
from pathlib import Path
from typing import NamedTuple

import pytest

import mcp_asdf_tools as m
from support import ROOT, blocks, made_once, require, run

PAGE = ROOT / "docs/platforms/data_frames.md"
TEXT = PAGE.read_text(encoding="utf-8")
PROGRAM_AND_OUTPUT = re.compile(
    r"^```(python|r|octave)\n(.*?)^```\n\n```text\n(.*?)^```$", re.DOTALL | re.MULTILINE
)
"""A block with a program, and below it the block of text that the program prints."""


class Example(NamedTuple):
    """A program of the page, in the language of its block, and what the page says that it prints."""

    language: str
    code: str
    output: str


EXAMPLES = [Example(*groups) for groups in PROGRAM_AND_OUTPUT.findall(TEXT)]


@pytest.fixture(scope="module")
def folder_of_sweep(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with what the page's commands for a sweep have written; its programs leave that alone."""
    return made_once(tmp_path_factory, "tables", run_commands_for_a_sweep)


def run_commands_for_a_sweep(folder: Path) -> None:
    """Run the page's first commands in a folder, and write what they print to ``printed.txt`` there."""
    [grid] = blocks(PAGE, "toml")
    (folder / "grid.toml").write_text(grid)
    commands_for_a_sweep, _ = blocks(PAGE, "sh")
    (folder / "printed.txt").write_text(run("sh", "-ec", commands_for_a_sweep, cwd=folder))


def skip_without_modules_of(code: str) -> None:
    """Skip the test, visibly, if Python code imports a module that is not installed."""
    modules = re.findall(r"^import (\w+)", code, re.MULTILINE)
    if ".to_pandas()" in code:
        modules.append("pandas")
    if ".to_xarray()" in code:
        modules += ["xarray", "tables"]
    for module in modules:
        if find_spec(module) is None:
            pytest.skip(f"{module} is not installed: make setup")


def run_example(example: Example, folder: Path) -> str:
    """Run a program of the page in a folder, and return what it prints; skip if it has no interpreter."""
    if example.language == "r":
        return run(require("Rscript", "r-base-core"), "-e", example.code, cwd=folder)
    if example.language == "octave":
        return run(require("octave-cli", "octave"), "--norc", "--eval", example.code, cwd=folder)
    skip_without_modules_of(example.code)
    return run(sys.executable, "-c", example.code, cwd=folder)


def test_each_of_the_seven_programs_on_the_page_about_data_frames_has_its_output_below_it() -> None:
    """EXAMPLES are found by a block of text below the program, so one without it would not be tested."""
    programs = blocks(PAGE, "python", "r", "octave")
    assert len(programs) == 7
    assert [example.code for example in EXAMPLES] == programs


@pytest.mark.slow
@pytest.mark.parametrize("example", EXAMPLES, ids=lambda example: example.language)
def test_a_program_in_python_r_or_octave_prints_what_the_page_about_data_frames_shows(
    example: Example, folder_of_sweep: Path
) -> None:
    """It reads tables that the commands of the page have written. ``example`` has its code and the output."""
    printed = run_example(example, folder_of_sweep)
    assert printed == example.output


@pytest.mark.slow
def test_the_commands_of_a_sweep_print_at_the_end_what_the_page_about_data_frames_shows(
    folder_of_sweep: Path,
) -> None:
    """The page shows dots for what they print before. The fixture has written it to printed.txt."""
    shown_for_sweep, *_others = blocks(PAGE, "text")
    shown_end = shown_for_sweep.removeprefix("...\n")
    printed = (folder_of_sweep / "printed.txt").read_text()
    assert printed.endswith(shown_end)


@pytest.mark.slow
def test_the_commands_that_export_a_log_print_at_the_end_what_the_page_about_data_frames_shows(
    tmp_path: Path,
) -> None:
    """They are the second block of commands on the page, and their output is the second block of text."""
    _commands_for_sweep, commands_for_log = blocks(PAGE, "sh")
    _shown_for_sweep, shown_for_log, *_others = blocks(PAGE, "text")

    printed = run("sh", "-ec", commands_for_log, cwd=tmp_path)

    assert printed.endswith(shown_for_log)


@pytest.mark.slow
def test_the_page_about_data_frames_lists_each_column_of_a_sweep_with_the_unit_and_meaning_in_its_file(
    folder_of_sweep: Path,
) -> None:
    """The column "filter" is not listed: the example varies the filter, and only that makes it a column."""
    schema = m.to_frame(folder_of_sweep / "grid.parquet").schema
    expected_rows = []
    for field in schema:
        if field.name != "filter":
            unit, meaning = field.metadata[b"unit"].decode(), field.metadata[b"meaning"].decode()
            expected_rows.append(f"| `{field.name}` | {unit} | {meaning} |")

    rows_on_page = re.findall(r"^\| `.*$", TEXT, re.MULTILINE)
    assert rows_on_page == expected_rows
