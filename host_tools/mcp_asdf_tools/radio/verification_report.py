"""Report of a controller's verification in JSON or Markdown."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

from mcp_asdf_tools.common import UsageError, check_target, write_atomically

COLUMNS = {
    "name": "phase",
    "fault": "fault",
    "ticks": "ticks",
    "frames": "frames sent",
    "injected": "injected",
    "broadcasts": "equal broadcasts",
    "answers": "equal answers",
    "outcome": "outcome",
}
"""Figures of each phase, and their headings."""

_SUFFIXES = (".json", ".md")


def check_report_path(path: Path | None) -> None:
    """Raises UsageError if the suffix is unknown or the file cannot be written there."""
    if path is None:
        return
    if path.suffix not in _SUFFIXES:
        raise UsageError(f"report {path} has no known format; name it {' or '.join(_SUFFIXES)}")
    check_target(path)


def write_verification_report(path: Path, report: dict[str, Any]) -> None:
    """Write a report in the format of its suffix. Raises UsageError if that is impossible."""
    text = json.dumps(report, indent=2) + "\n" if path.suffix == ".json" else markdown(report)
    write_atomically(path, text)


def markdown(report: dict[str, Any]) -> str:
    """The report in Markdown."""
    verdict = report["verdict"]
    lines = [
        "# Verification of a controller",
        "",
        f"**{headline(verdict)}**",
        "",
        f"Robot {report['parameters']['controller']['id']} on {report['bus']['interface']} "
        f"{report['bus']['channel'] or ''}, {report['time']}.",
        "",
        "| " + " | ".join(COLUMNS.values()) + " |",
        "| " + " | ".join(["---"] * len(COLUMNS)) + " |",
    ]
    for phase in verdict["phases"]:
        cells = ("" if phase[name] is None else str(phase[name]) for name in COLUMNS)
        lines.append("| " + " | ".join(cells) + " |")
    everything = {key: report[key] for key in ("parameters", "versions", "model")}
    lines += ["", "To repeat it:", "", "```json", json.dumps(everything, indent=2), "```", ""]
    return "\n".join(lines)


def headline(verdict: dict[str, Any]) -> str:
    """The verdict in a sentence."""
    phases = verdict["phases"]
    passed = sum(phase["outcome"] == "passed" for phase in phases)
    count = f"{passed} of {len(phases)} phases passed"
    if verdict["passed"]:
        repeated = f"; {verdict['repeated']} commands were repeated" * bool(verdict["repeated"])
        return f"PASSED: {count}; every broadcast and every answer equals the model's{repeated}"
    if verdict["difference"] is not None:
        return f"FAILED: {count}; first in {verdict['difference']}"
    if verdict["is_interrupted"]:
        return f"INTERRUPTED: {count}"
    empty = ", ".join(phase["name"] for phase in phases if phase["outcome"] != "passed")
    return f"FAILED: {count}; nothing went wrong in {empty}: take more ticks"
