"""Colours that all pictures share."""

from __future__ import annotations

from mcp_asdf_tools.common.figures import ordered_colours

DARKEST, LIGHTEST = "#440154", "#d8c51c"


def test_colours_of_ordered_values_go_from_the_darkest_to_the_lightest() -> None:
    """Lines of small and large values differ most."""
    colours = ordered_colours(4)
    assert len(set(colours)) == 4
    assert (colours[0], colours[-1]) == (DARKEST, LIGHTEST)


def test_a_single_value_has_the_darkest_colour() -> None:
    assert ordered_colours(1) == [DARKEST]
