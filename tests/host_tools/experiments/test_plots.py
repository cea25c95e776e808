"""Pictures of the library and of the command: what is refused, and equal files of equal results."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from host_tools.experiments.drawn_figures import SHORT_EXPERIMENT, results_of
from mcp_asdf_tools import library
from mcp_asdf_tools.cli import main as cli
from mcp_asdf_tools.common.errors import UsageError
from mcp_asdf_tools.common.figures import format_for_legend
from mcp_asdf_tools.experiments.result_files import write_tables
from mcp_asdf_tools.experiments.result_tables import trials_to_table
from mcp_asdf_tools.experiments.results import Trials
from mcp_asdf_tools.experiments.scores import Limits
from support import slow


@pytest.mark.parametrize(
    ("value", "text_in_legend"),
    [
        ("asdf_plus", "asdf plus"),
        (0.25, "0.25"),
        (1e3, "1000"),
        (65535, "65535"),
        (65536, "2^16"),
        (65537, "65537"),
    ],
)
def test_a_legend_has_no_underlines_and_writes_large_powers_of_two_as_powers(
    value: float | str, text_in_legend: str
) -> None:
    """Large is 65536, 2^16, and more. Values are of parameters, which may be names or numbers."""
    assert format_for_legend(value) == text_in_legend


@pytest.fixture(scope="module")
def unfiltered() -> Trials:
    """Run five trials of four robots without a filter; nothing is recorded over time."""
    return results_of(SHORT_EXPERIMENT)


@pytest.fixture(scope="module")
def filtered() -> Trials:
    """Run the same swarm with the filter ASDF+."""
    return results_of(replace(SHORT_EXPERIMENT, filter="asdf-plus"))


def test_plot_series_refuses_two_experiments_and_says_how_to_choose_one(
    unfiltered: Trials, filtered: Trials
) -> None:
    """It draws one trial over time. These two experiments differ in their filter."""
    with pytest.raises(UsageError, match="2 experiments match; choose one with where filter="):
        library.plot_series([unfiltered, filtered])


def test_plot_series_refuses_results_without_values_recorded_over_time(unfiltered: Trials) -> None:
    """Nothing is recorded in a trial unless the user asks for it. It is what this plot would draw."""
    with pytest.raises(UsageError, match="nothing was recorded over time"):
        library.plot_series([unfiltered])


@pytest.mark.parametrize(
    ("options", "expected_message"),
    [
        ({}, "x is ''; choose a parameter: robots, topology"),
        ({"x": "omega", "hue": "tao"}, "hue is 'tao'; choose"),
        ({"x": "omega", "y": "h"}, "y is 'h'; choose one of H,"),
        ({"x": "omega", "y": lambda trials: trials.errors}, r"y gives shape \(5, 4\)"),
        ({"x": "omega", "y": "e", "limits": Limits()}, "limits would do nothing"),
        ({"x": "omega", "facet": "flawed", "ax": object()}, "facet makes panels and ax is one"),
    ],
)
def test_plot_curve_refuses_options_that_it_cannot_draw(
    options: dict[str, Any], expected_message: str, unfiltered: Trials
) -> None:
    """Results are of 5 trials of 4 robots, so a function given as y returns 5 values, and not 5 times 4."""
    with pytest.raises(UsageError, match=expected_message):
        library.plot_curve([unfiltered], **options)


def test_a_picture_of_no_experiment_is_refused() -> None:
    with pytest.raises(UsageError, match="there is no experiment to draw"):
        library.plot_boxes([])


@pytest.fixture
def results_file(unfiltered: Trials, tmp_path: Path) -> Path:
    """A file of results of one experiment."""
    path = tmp_path / "run.parquet"
    write_tables(path, [trials_to_table(unfiltered)])
    return path


@pytest.mark.parametrize(
    ("suffix", "first_bytes"), [("svg", b"<?xml"), *slow([("pdf", b"%PDF"), ("png", b"\x89PNG")])]
)
def test_the_command_plot_writes_the_same_bytes_each_time_in_the_format_of_the_suffix(
    suffix: str, first_bytes: bytes, results_file: Path, tmp_path: Path
) -> None:
    """The results are drawn twice. The first bytes of a file tell its format."""
    first_path = tmp_path / f"1.{suffix}"
    second_path = tmp_path / f"2.{suffix}"
    assert cli.main(["plot", str(results_file), str(first_path)]) == 0
    assert cli.main(["plot", str(results_file), str(second_path)]) == 0

    first_picture = first_path.read_bytes()
    second_picture = second_path.read_bytes()
    assert first_picture == second_picture
    assert first_picture.startswith(first_bytes)
