"""The same source gives the same bytes, in whatever folder and at whatever time it is built."""

from __future__ import annotations

from pathlib import Path

import pytest

from release.reproducible import build_twice
from support import CORE, ROOT, require

MADE = {"library": "libmcp_asdf.a", "tables": "t_table_omega05_q30.c", "wheel": ".whl"}
"""A file that must be among what is compared."""


@pytest.mark.slow
@pytest.mark.parametrize("kind", MADE)
def test_two_builds_give_the_same_bytes(kind: str, tmp_path: Path) -> None:
    require("cmake")
    first, second = build_twice(kind, tmp_path)
    assert any(name.endswith(MADE[kind]) for name in first)
    assert first == second


@pytest.mark.slow
def test_a_difference_is_found(tmp_path: Path) -> None:
    def change(source: Path) -> None:
        path = source / CORE.relative_to(ROOT)
        path.write_text(path.read_text(encoding="utf-8") + "\nextern int planted;\nint planted = 1;\n")

    first, second = build_twice("library", tmp_path, change)
    assert [Path(name).name for name in first if first[name] != second[name]] == ["libmcp_asdf.a"]
