"""Swarms in ARGoS3 have the errors of ``mcp-asdf simulate``, as docs/platforms/argos.md says."""

from __future__ import annotations

from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import pytest

from benchmarks import argos
from support import ROOT

PAGE = ROOT / "docs/platforms/argos.md"
ARGOS_EXAMPLE = ROOT / "c_ref/examples/argos3"


def shown_table() -> str:
    """Return the table in docs/platforms/argos.md that compares ARGoS3 with ``mcp-asdf simulate``."""
    text = PAGE.read_text(encoding="utf-8")
    _before, _mark, after = text.partition("<!-- argos -->\n")
    table, _end, _after = after.partition("\n<!-- end -->")
    return table


@pytest.mark.slow
@pytest.mark.parametrize("filter_name", ["none", "asdf-minus", "asdf-plus"])
def test_errors_in_argos_and_in_mcp_asdf_simulate_have_one_distribution(filter_name: str) -> None:
    """If there is one distribution, a difference this large has a probability of at least 1 %.

    This probability, p, is computed for each of three kinds of errors. The errors in ARGoS are stored ones.
    """
    errors_in_argos = argos.read_results()[filter_name]
    simulated_errors = argos.simulate(filter_name, trials=50)
    p_by_quantity = argos.p_values(simulated_errors, errors_in_argos)
    assert min(p_by_quantity.values()) >= 0.01, p_by_quantity


@pytest.mark.slow
def test_the_comparison_with_argos_notices_swarms_with_another_filter_period() -> None:
    """In ARGoS the filter ran every 1000 ticks. With a period of 3000 the probability falls below 0.0001."""
    errors_in_argos = argos.read_results()["asdf-minus"]
    errors_of_another_swarm = argos.simulate("asdf-minus", trials=50, filter_period=3000)
    p_by_quantity = argos.p_values(errors_of_another_swarm, errors_in_argos)
    assert p_by_quantity["error_in_second_half"] < 0.0001


@pytest.mark.slow
def test_the_documentation_of_argos_shows_the_table_that_the_comparison_prints() -> None:
    """The table has ARGoS's medians, and medians of ``mcp-asdf simulate``, which the test computes again."""
    assert shown_table() == argos.format_table()


# --- The program that runs ARGoS -------------------------------------------------------------------------


def test_the_table_of_a_trial_in_argos_is_summed_up_as_mean_errors_of_its_robots(tmp_path: Path) -> None:
    """Errors are distances of x from the true fill ratio, 0.55, and of b_hat from the true accuracy, 0.95.

    The table has a line for each of two robots at the ticks 100, 150 and 200. The second half of all ticks
    begins behind tick 100.
    """
    table = tmp_path / "results.csv"
    table.write_text(
        "tick,robot,x,b_hat\n"
        "100,kiv0,0.0,0.5\n100,kiv1,0.0,0.5\n"
        "150,kiv0,0.65,0.5\n150,kiv1,0.45,0.5\n"
        "200,kiv0,0.55,0.95\n200,kiv1,0.75,0.75\n"
    )
    mean_errors = argos.summarise(table)

    # Errors of x are 0.1 and 0.1 at tick 150, and 0 and 0.2 at tick 200, the end.
    assert mean_errors["error_in_second_half"] == pytest.approx((0.1 + 0.1 + 0 + 0.2) / 4)
    assert mean_errors["error_at_end"] == pytest.approx((0 + 0.2) / 2)
    assert mean_errors["b_hat_error_at_end"] == pytest.approx((0 + 0.2) / 2)


def test_a_trial_in_argos_gets_its_filter_its_seed_and_the_file_of_its_results(tmp_path: Path) -> None:
    """ARGoS runs it from a file in XML. Healthy robots assume the true accuracy, 0.95, and flawed ones 0.55.

    With ASDF+ all robots run the paper's filter, which is called asdf in this file.
    """
    path = tmp_path / "trial.argos"
    argos.write_configuration(path, ARGOS_EXAMPLE, "asdf-plus", seed=7, results=tmp_path / "trial.csv")
    root = ElementTree.parse(path).getroot()
    healthy, flawed = root.iterfind("controllers/*/params")
    [experiment] = root.iterfind("framework/experiment")
    [loop_functions] = root.iterfind("loop_functions")

    assert (healthy.attrib["filter"], healthy.attrib["b_hat"]) == ("asdf", "0.95")
    assert (flawed.attrib["filter"], flawed.attrib["b_hat"]) == ("asdf", "0.55")
    assert experiment.attrib["random_seed"] == "7"
    assert loop_functions.attrib["results"] == str(tmp_path / "trial.csv")


def test_the_arena_of_the_example_for_argos_has_the_robot_density_of_simulate() -> None:
    """The density is the number of robots in a circle with the radius of their radio; ``simulate`` has 1.

    The file has the position of the middle of the eastern wall. The square arena ends at its inner face.
    """
    radio_range, wall_thickness = 0.7, 0.1  # metres
    root = ElementTree.parse(ARGOS_EXAMPLE / "swarm.argos").getroot()
    [east_wall] = root.iterfind("arena/box[@id='wall_east']/body")
    x_of_middle_of_wall, _y, _z = east_wall.attrib["position"].split(",")
    x_of_inner_face = float(x_of_middle_of_wall) - wall_thickness / 2
    side = 2 * x_of_inner_face  # the middle of the arena is at x = 0
    robot_count = sum(int(group.attrib["quantity"]) for group in root.iterfind("arena/distribute/entity"))

    area_in_range = np.pi * radio_range**2
    density = robot_count * area_in_range / side**2
    assert density == pytest.approx(1, abs=1e-4)
