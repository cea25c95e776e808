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
    ("value", "text"),
    [
        ("asdf_plus", "asdf plus"),
        (0.25, "0.25"),
        (1e3, "1000"),
        (65535, "65535"),
        (65536, "2^16"),
        (65537, "65537"),
    ],
)
def test_labels_have_numbers_in_words(value: float | str, text: str) -> None:
    assert format_for_legend(value) == text


@pytest.fixture(scope="module")
def unfiltered() -> Trials:
    return results_of(SHORT_EXPERIMENT)


@pytest.fixture(scope="module")
def filtered() -> Trials:
    return results_of(replace(SHORT_EXPERIMENT, filter="asdf-plus"))


@pytest.fixture(scope="module")
def flawed() -> Trials:
    return results_of(replace(SHORT_EXPERIMENT, flawed=2, flawed_accuracy=0.75))


def test_series_of_two_experiments_are_refused(unfiltered: Trials, filtered: Trials) -> None:
    with pytest.raises(UsageError, match="2 experiments match; choose one with where filter="):
        library.plot_series([unfiltered, filtered])


def test_series_without_records_are_refused(unfiltered: Trials) -> None:
    with pytest.raises(UsageError, match="nothing was recorded over time"):
        library.plot_series([unfiltered])


def test_curves_that_differ_in_what_is_not_shown_are_refused(unfiltered: Trials, filtered: Trials) -> None:
    with pytest.raises(UsageError, match="the results differ in filter too"):
        library.plot_curve([unfiltered, filtered], "omega")


def test_curves_that_differ_in_the_share_of_flawed_robots_are_refused(
    unfiltered: Trials, flawed: Trials
) -> None:
    with pytest.raises(UsageError, match="the results differ in flawed_accuracy, flawed too"):
        library.plot_curve([unfiltered, flawed], "omega")


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({}, "x is ''; choose a parameter: robots, topology"),
        ({"x": "omega", "hue": "tao"}, "hue is 'tao'; choose"),
        ({"x": "omega", "y": "h"}, "y is 'h'; choose one of H,"),
        ({"x": "omega", "y": lambda trials: trials.errors}, r"y gives shape \(5, 4\)"),
        ({"x": "omega", "y": "e", "limits": Limits()}, "limits would do nothing"),
        ({"x": "omega", "facet": "flawed", "ax": object()}, "facet makes panels and ax is one"),
    ],
)
def test_a_curve_of_bad_options_is_refused(options: dict[str, Any], message: str, unfiltered: Trials) -> None:
    with pytest.raises(UsageError, match=message):
        library.plot_curve([unfiltered], **options)


def test_a_picture_of_nothing_is_refused() -> None:
    with pytest.raises(UsageError, match="there is no experiment to draw"):
        library.plot_boxes([])


@pytest.mark.parametrize(
    ("suffix", "start"), [("svg", b"<?xml"), *slow([("pdf", b"%PDF"), ("png", b"\x89PNG")])]
)
def test_equal_results_give_equal_files(
    suffix: str, start: bytes, tmp_path: Path, unfiltered: Trials
) -> None:
    results, picture = tmp_path / "run.parquet", tmp_path / f"picture.{suffix}"
    write_tables(results, [trials_to_table(unfiltered)])
    assert cli.main(["plot", str(results), str(picture)]) == 0
    first_bytes = picture.read_bytes()

    assert cli.main(["plot", str(results), str(picture)]) == 0
    assert picture.read_bytes() == first_bytes
    assert first_bytes.startswith(start)
