"""Mutants that are no mistakes, each listed with the reason."""

from __future__ import annotations

import tomllib
from functools import cache
from pathlib import Path


@cache
def equivalents(language: str) -> dict[str, str]:
    """Reasons by the mutants' names; of ``c`` or ``python``."""
    file = Path(__file__).with_name(f"equivalent_{language}.toml")
    groups = tomllib.loads(file.read_text(encoding="utf-8"))["group"]
    listed = [(name, group["reason"]) for group in groups for name in group["mutants"]]
    assert len(dict(listed)) == len(listed), f"{file.name} lists a mutant twice"
    return dict(listed)
