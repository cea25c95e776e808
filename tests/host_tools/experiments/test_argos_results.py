"""Swarms in ARGoS3 have the errors of ``mcp-asdf simulate``, as docs/platforms/argos.md says."""

from __future__ import annotations

from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import pytest

from benchmarks import argos
from support import ROOT

PAGE = ROOT / "docs/platforms/argos.md"
EXAMPLE = ROOT / "c_ref/examples/argos3"
LEVEL = 0.01
"""p-value below which two samples are not taken for one distribution."""
FILTERS_WITH_TABLE = ("none", "asdf-minus", "asdf-plus")


def shown_table() -> str:
    """Return the table of the page."""
    text = PAGE.read_text(encoding="utf-8")
    return text.split("<!-- argos -->\n")[1].split("\n<!-- end -->")[0]


def test_results_of_argos_are_of_40_seeds_for_each_filter() -> None:
    """Three figures of each seed are kept, for the comparison with ``simulate``."""
    results = argos.read_results()
    assert set(results) >= set(FILTERS_WITH_TABLE)
    for errors in results.values():
        assert [len(values) for values in errors.values()] == [40, 40, 40]


@pytest.mark.slow
@pytest.mark.parametrize("filter_name", FILTERS_WITH_TABLE)
def test_errors_in_argos_and_here_have_one_distribution(filter_name: str) -> None:
    simulated = argos.simulate(filter_name, trials=50)
    p_by_quantity = argos.p_values(simulated, argos.read_results()[filter_name])
    assert min(p_by_quantity.values()) >= LEVEL, p_by_quantity


@pytest.mark.slow
def test_the_comparison_notices_swarms_with_another_filter_period() -> None:
    simulated = argos.simulate("asdf-minus", trials=50, filter_period=3000)
    p_by_quantity = argos.p_values(simulated, argos.read_results()["asdf-minus"])
    assert p_by_quantity["error_in_second_half"] < 1e-4


def test_the_page_has_the_medians_of_the_results() -> None:
    rows = [[cell.strip() for cell in line.split("|")[1:-1]] for line in shown_table().splitlines()[2:]]
    expected_rows = [
        [filter_name, meaning, f"{np.median(errors[quantity]):.4f}"]
        for filter_name, errors in argos.read_results().items()
        for quantity, meaning in argos.QUANTITIES.items()
    ]

    assert [row[:3] for row in rows] == expected_rows


@pytest.mark.slow
def test_the_page_has_the_table_of_the_comparison() -> None:
    assert shown_table() == argos.format_table()


# --- The program that runs ARGoS -------------------------------------------------------------------------


def test_a_table_of_estimates_is_summed_up_as_means_over_robots(tmp_path: Path) -> None:
    """The fill ratio is 0.55, and b_hat should be 0.95.

    The rows of ticks 150 and 200 are of the second half of 200 ticks.
    """
    table = tmp_path / "results.csv"
    table.write_text(
        "tick,robot,x,b_hat\n"
        "100,kiv0,0.0,0.5\n100,kiv1,0.0,0.5\n"
        "150,kiv0,0.65,0.5\n150,kiv1,0.45,0.5\n"
        "200,kiv0,0.55,0.95\n200,kiv1,0.75,0.75\n"
    )
    summary = argos.summarise(table)

    assert summary["error_in_second_half"] == pytest.approx((0.1 + 0.1 + 0.0 + 0.2) / 4)
    assert summary["error_at_end"] == pytest.approx(0.1)
    assert summary["b_hat_error_at_end"] == pytest.approx(0.1)


def test_a_trial_has_the_filters_and_the_seed_that_it_is_about(tmp_path: Path) -> None:
    configuration = tmp_path / "trial.argos"
    argos.write_configuration(configuration, EXAMPLE, "asdf-plus", 7, tmp_path / "trial.csv")
    root = ElementTree.parse(configuration).getroot()
    parameters = [node.attrib for node in root.iterfind("controllers/*/params")]
    assert [(node["filter"], node["b_hat"], node["log_folder"]) for node in parameters] == [
        ("asdf", "0.95", ""),
        ("asdf", "0.55", ""),
    ]
    [experiment] = root.iterfind("framework/experiment")
    assert experiment.attrib["random_seed"] == "7"
    [loop_functions] = root.iterfind("loop_functions")

    assert loop_functions.attrib["results"] == str(tmp_path / "trial.csv")


def test_the_world_of_the_example_is_that_of_the_comparison() -> None:
    """Walls 0.1 m thick around a square whose density is 1, as ``simulate`` has it."""
    root = ElementTree.parse(EXAMPLE / "swarm.argos").getroot()
    [wall] = [node for node in root.iterfind("arena/box") if node.attrib["id"] == "wall_east"]
    body = wall.find("body")
    assert body is not None
    side = 2 * float(body.attrib["position"].split(",")[0]) - 0.1
    robot_count = sum(int(node.attrib["quantity"]) for node in root.iterfind("arena/distribute/entity"))

    assert robot_count * np.pi * 0.7**2 / side**2 == pytest.approx(1, abs=1e-4)
