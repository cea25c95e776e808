"""Colours that all pictures share."""

from __future__ import annotations

from mcp_asdf_tools.common.figures import ordered_colours

DARKEST, LIGHTEST = "#440154", "#d8c51c"


def test_colours_of_ordered_values_go_from_the_darkest_to_the_lightest() -> None:
    """So lines of small and large values differ most. A single value has the darkest colour."""
    first, *others, last = ordered_colours(4)
    assert (first, last) == (DARKEST, LIGHTEST)
    assert len({first, *others, last}) == 4
    assert ordered_colours(1) == [DARKEST]
