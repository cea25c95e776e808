"""Colours that all pictures share."""

from __future__ import annotations

from mcp_asdf_tools.common.figures import ordered_colours


def test_colours_of_ordered_values_go_from_the_darkest_to_the_lightest() -> None:
    """Four colours differ, and the first and the last are a dark purple and a light yellow.

    So lines of small and large values differ most. A single value has the darkest colour.
    """
    dark_purple, light_yellow = "#440154", "#d8c51c"
    first_colour, second_colour, third_colour, last_colour = ordered_colours(4)

    assert first_colour == dark_purple
    assert last_colour == light_yellow
    assert len({first_colour, second_colour, third_colour, last_colour}) == 4
    assert ordered_colours(1) == [dark_purple]
