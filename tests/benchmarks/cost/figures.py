"""Everything measured, gathered from all targets and levels, and kept as JSON beside this file."""

from __future__ import annotations

import json
import os
import re
import tempfile
from collections.abc import Iterator
from concurrent.futures import Future, ProcessPoolExecutor, as_completed
from pathlib import Path

from .demo import measure_demo
from .images import HERE, LEVELS, TARGETS, Target
from .measurement import SETTINGS, Figures, measure, table_bytes

KEPT = HERE / "figures.json"
"""Measurements that the tables and the picture show."""

_LIST = re.compile(r"\[[^\[\]{}]*\]")
"""A list without another in it: it goes on one line."""


def gather() -> Iterator[tuple[int, int, Figures]]:
    """Measure everything, in as many processes as there are processors.

    Yields the parts done, the parts there are, and the figures; they are complete after the last one.
    """
    figures: Figures = {
        "settings": SETTINGS,
        "compilers": {target.name: target.version() for target in TARGETS},
        "targets": {target.name: {} for target in TARGETS},
    }
    with tempfile.TemporaryDirectory() as name, ProcessPoolExecutor(os.cpu_count()) as pool:
        folder = Path(name)
        parts: dict[Future[Figures], tuple[Target, str]] = {
            pool.submit(measure, target, level, folder / target.name / level): (target, level)
            for target in TARGETS
            for level in LEVELS
        }
        for done, future in enumerate(as_completed(parts), 1):
            target, level = parts[future]
            figures["targets"][target.name][level] = future.result()
            yield done, len(parts) + 1, figures
        figures["table"] = table_bytes(folder / "tables")
        figures["demo"] = measure_demo(folder / "demo")
    yield len(parts) + 1, len(parts) + 1, figures


def text_of(figures: Figures) -> str:
    """The figures as they are kept, in the order of the targets."""
    ordered = {
        target.name: {level: figures["targets"][target.name][level] for level in LEVELS} for target in TARGETS
    }
    text = json.dumps(figures | {"targets": ordered}, indent=1)
    return _LIST.sub(lambda found: " ".join(found[0].split()), text) + "\n"


def kept() -> Figures:
    """The figures that were kept. Raises FileNotFoundError if there are none."""
    figures: Figures = json.loads(KEPT.read_text(encoding="utf-8"))
    return figures


def differences(old: object, new: object, tolerance: float, place: str = "") -> Iterator[str]:
    """Where two sets of figures differ by more than the tolerance, a share of the new figure."""
    if isinstance(old, dict) and isinstance(new, dict):
        for key in old.keys() | new.keys():
            yield from differences(old.get(key), new.get(key), tolerance, f"{place}, {key}".lstrip(", "))
    elif isinstance(old, list) and isinstance(new, list) and len(old) == len(new):
        for number, pair in enumerate(zip(old, new, strict=True)):
            yield from differences(*pair, tolerance, f"{place}, {number}")
    elif isinstance(old, int | float) and isinstance(new, int | float):
        if abs(old - new) > tolerance * abs(new):
            yield f"{place}: {old} was kept, {new} is measured"
    elif old != new:
        yield f"{place}: {old!r} was kept, {new!r} is measured"
