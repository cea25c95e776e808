"""Every target computes the mirror's bits, with every compiler at every level, and needs no library."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from support import slow
from targets import matrix
from targets.golden_vectors import explain, load
from targets.matrix import TARGETS, Cell, quick_cell, slow_cells

CELLS = [*map(quick_cell, TARGETS), *slow(slow_cells())]


@pytest.mark.parametrize("cell", CELLS, ids=str)
def test_the_target_computes_the_mirror_s_bits(cell: Cell, tmp_path: Path) -> None:
    if reason := cell.missing():
        pytest.skip(reason)
    printed = matrix.play(cell, tmp_path)
    if " found " in printed:
        pytest.fail(explain(printed, load()))
    assert matrix.verdict_of(cell.vectors()) in printed and "failed" not in printed, printed
    if "LTO" in cell.level:
        return
    core = matrix.core_objects(tmp_path)
    odd = {name for name in matrix.needed_symbols(core) if not re.fullmatch(cell.target.helpers, name)}
    assert not odd, f"the core needs {sorted(odd)}"
    assert sum(map(matrix.ram, core)) == 0, "the core has variables"
