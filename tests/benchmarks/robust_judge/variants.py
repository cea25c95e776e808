"""Variants of the robust filter that were considered: a line or a few of the firmware are changed in each."""

from __future__ import annotations

import shutil
from dataclasses import dataclass
from pathlib import Path


@dataclass(frozen=True)
class Change:
    """A text that must stand once in a source of the firmware, and the text that replaces it."""

    file: str
    before: str
    after: str


_HEARD_LATELY = (
    Change("mcp_asdf.h", "    uint8_t turn;\n", "    uint8_t turn;\n    uint32_t heard, heard_before;\n"),
    Change("mcp_asdf.h", "#define MCP_ASDF_SIZE_MAX 184", "#define MCP_ASDF_SIZE_MAX 192"),
    Change(
        "mcp_asdf_robust.h",
        "    robot->robust.filled_slots |= shift_left(1, slot);\n",
        "    robot->robust.filled_slots |= shift_left(1, slot);\n"
        "    robot->robust.heard |= shift_left(1, slot);\n",
    ),
    Change(
        "mcp_asdf_robust.h",
        "    end_batch(robot, share);\n",
        "    end_batch(robot, share);\n"
        "    robot->robust.filled_slots = robot->robust.heard | robot->robust.heard_before;\n"
        "    robot->robust.heard_before = robot->robust.heard;\n"
        "    robot->robust.heard = 0;\n",
    ),
)

VARIANTS: dict[str, tuple[Change, ...]] = {
    "16 slots": (Change("mcp_asdf.h", "MCP_ASDF_SLOTS 32U", "MCP_ASDF_SLOTS 16U"),),
    "tests from three estimates": (
        Change("mcp_asdf.h", "MCP_ASDF_TESTED_ESTIMATES_MIN 5U", "MCP_ASDF_TESTED_ESTIMATES_MIN 3U"),
    ),
    "without supporters": (
        Change(
            "mcp_asdf_robust.h",
            " &&\n        !is_supported(robot, sorted, count, share, q32_from_q24(centre))",
            " && (true || is_supported(robot, sorted, count, share, centre))",
        ),
    ),
    "median alone": (Change("mcp_asdf_robust.h", "HUBER_STEPS 3U", "HUBER_STEPS 0U"),),
    "forgets in two filter periods": _HEARD_LATELY,
}
"""The changes by the variants' names. "Forgets": a slot that was not written in the last two filter periods
is empty."""


def write_variant(core: Path, folder: Path, name: str) -> None:
    """Copy the firmware's sources from ``core`` to a folder, with the changes of a variant.

    Raises ValueError if a source has not exactly one place for a change.
    """
    for source in core.glob("*.[ch]"):
        shutil.copy(source, folder)
    for change in VARIANTS[name]:
        path = folder / change.file
        text = path.read_text(encoding="utf-8")
        if text.count(change.before) != 1:
            raise ValueError(f"{change.file} has {text.count(change.before)} places with {change.before!r}")
        path.write_text(text.replace(change.before, change.after), encoding="utf-8")
