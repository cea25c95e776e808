"""Every target computes the mirror's bits, with every compiler at every level, and needs no library."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from mcp_asdf import mirror
from mcp_asdf.robot import Status
from support import slow
from targets import matrix
from targets.golden_vectors import FILES, HERE, Player, content, played, scenarios, verdict
from targets.matrix import HOST, TARGETS, WASM, Cell, quick_cell, slow_cells

QUICK_TARGETS = ("avr", "cortex-m0")
"""The targets that compute least like this computer: bit by bit, and by a table.

For the arithmetic of the others, and for the order of bytes of an s390x, make test has the C tests that
tests/c_ref/test_presets.py builds.
"""
CELLS = [
    *(quick_cell(target) for target in TARGETS if target.name in QUICK_TARGETS),
    *slow(quick_cell(target) for target in TARGETS if target.name not in QUICK_TARGETS),
    *slow(slow_cells()),
]


@pytest.mark.parametrize("name", FILES)
def test_a_file_is_what_the_mirror_gives(name: str) -> None:
    assert content(name) == (HERE / name).read_bytes(), "write it again and say why in the changelog"


@pytest.mark.parametrize("cell", CELLS, ids=str)
def test_the_target_computes_the_mirror_s_bits(cell: Cell, tmp_path: Path) -> None:
    cell.require_tools()
    for files in cell.images():
        printed = matrix.play(cell, tmp_path, *(HERE / name for name in files))
        if wrong := re.search(r"scenario (\d+) expected", printed):
            assert re.findall(r"call .*", printed) == Player(scenarios(*files)[int(wrong[1])]).lines, printed
        assert verdict(files) in printed and "failed" not in printed, printed
    if "LTO" in cell.level or cell.target == WASM:  # whose linker refuses what the image lacks
        return
    core = matrix.core_objects(tmp_path)
    odd = {name for name in matrix.needed_symbols(core) if not re.fullmatch(cell.target.helpers, name)}
    assert not odd, f"the core needs {sorted(odd)}"
    assert sum(map(matrix.variables, core)) == 0, "the core has variables"


@pytest.mark.slow
def test_a_target_that_differs_prints_every_call(tmp_path: Path) -> None:
    """The digest of one scenario is not what any robot reaches."""
    name = next(iter(FILES))
    known = played(name)
    number = max(range(len(known)), key=lambda each: len(known[each][0].calls))
    wrong, digest = bytearray((HERE / name).read_bytes()), 6 + sum(len(each) for _, each in known[:number])
    wrong[digest] ^= 1
    (tmp_path / "wrong.bin").write_bytes(wrong)
    printed = matrix.play(quick_cell(HOST), tmp_path, tmp_path / "wrong.bin").splitlines()
    assert re.match(rf"scenario {number} expected \d+ found \d+$", printed[-len(known[number][0].calls) - 5])
    assert printed[-len(known[number][0].calls) - 4 : -1] == [*Player(known[number][0]).lines, "FAIL"]


@pytest.mark.slow
def test_files_made_by_a_wrong_mirror_are_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Writing the files again hides no mistake of the mirror: the C does not play them."""
    usual = mirror.MirrorRobot.settle

    def settle(robot: mirror.MirrorRobot) -> Status:
        updated = usual(robot)
        robot.s.t += robot.s.t == 1  # it counts the first tick twice
        return updated

    name = next(iter(FILES))
    monkeypatch.setattr(mirror.MirrorRobot, "settle", settle)
    played.cache_clear()
    try:
        (tmp_path / name).write_bytes(content(name))
    finally:
        played.cache_clear()
    assert (tmp_path / name).read_bytes() != (HERE / name).read_bytes()
    assert "FAIL" in matrix.play(quick_cell(HOST), tmp_path, tmp_path / name)
