"""Mutants that are no mistakes, each listed in equivalents.toml with the reason."""

from __future__ import annotations

import tomllib
from functools import cache
from pathlib import Path


@cache
def equivalents(language: str) -> dict[str, str]:
    """Return the reasons by the mutants' names, for ``c`` or ``python``."""
    lists = tomllib.loads(Path(__file__).with_name("equivalents.toml").read_text(encoding="utf-8"))
    listed = [(name, reason) for reason, names in lists[language].items() for name in names]
    assert len(dict(listed)) == len(listed), "a mutant is listed twice"
    return dict(listed)
