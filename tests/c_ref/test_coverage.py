"""Every condition of the firmware that can be, is decided both ways by the C tests, and each by itself."""

from __future__ import annotations

from pathlib import Path

import pytest

from c_ref.coverage import SOURCES, measured
from support import CORE

UNREACHED = {
    ("divide_24", "MCP_ASDF_DIVIDE == MCP_ASDF_DIVIDE_BY_TABLE && d >> 30 == 0U", "effect of condition 1"): (
        "a constant of each variant, so no run can change it; both its values are compiled and tested"
    ),
}
"""Conditions that cannot be reached: function, text and value; and the reason."""


@pytest.mark.slow
def test_every_condition_is_tested(tmp_path: Path) -> None:
    """Missing means missing from all C tests together."""
    found = measured(tmp_path)
    assert {Path(path) for _, path, _ in found.outcomes} == {
        *SOURCES,
        CORE.with_name("mcp_asdf_arithmetic.h"),
        *CORE.parent.glob("mcp_asdf_target*.h"),
    }
    assert len(found.outcomes) > 150 and sum(map(len, found.effects.values())) > 70
    missing = found.missing()
    assert missing == sorted(UNREACHED), "\n".join(map(str, missing))
