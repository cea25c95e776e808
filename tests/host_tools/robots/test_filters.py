"""The filters of a swarm: what each sets in the firmware, and how reports and pictures name it."""

from __future__ import annotations

import pytest

from mcp_asdf.robot import Filter
from mcp_asdf_tools.experiments.plot_panels import colours_of_filters
from mcp_asdf_tools.robots.filters import FILTERS, filter_of_one_robot


def test_filters_are_listed_from_fewer_recalibrating_robots_to_more() -> None:
    """With no filter no robot recalibrates, with ASDF- the flawed ones do, and with the others all."""
    assert list(FILTERS) == ["none", "asdf-minus", "asdf-plus", "robust"]


def test_only_the_robust_filter_is_marked_as_depending_on_the_order_of_messages() -> None:
    """If two senders' ids are equal modulo 32, it keeps only the estimate of the later message."""
    names_of_marked_filters = [name for name, swarm_filter in FILTERS.items() if swarm_filter.order_matters]
    assert names_of_marked_filters == ["robust"]


def test_pictures_and_pages_have_a_minus_sign_in_asdf_minus() -> None:
    """On the command line and in reports the name has a hyphen."""
    assert FILTERS["asdf-minus"].typeset_term == "ASDF\N{MINUS SIGN}"


def test_the_first_series_of_a_filter_has_its_colour_and_the_next_one_another() -> None:
    """Two of three series in a picture are of no filter. The first of them is grey, the second blue.

    The third series is the first one of the robust filter, and is green.
    """
    grey, blue, green = "#999999", "#0072b2", "#009e73"
    assert colours_of_filters(["none", "none", "robust"]) == [grey, blue, green]


@pytest.mark.parametrize(
    ("firmware_filter", "expected_name"),
    [
        (Filter.OFF, "none"),
        (Filter.ADAPTIVE, "asdf-plus"),
        (Filter.ALWAYS, "asdf-plus"),
        (Filter.ROBUST, "robust"),
    ],
)
def test_the_filter_of_one_robot_has_the_name_of_the_swarm_s_filter_that_gives_it_to_all_robots(
    firmware_filter: Filter, expected_name: str
) -> None:
    """The name is never asdf-minus, as ASDF- gives its filter to flawed robots alone."""
    assert filter_of_one_robot(firmware_filter).name == expected_name
