"""Report of a controller's verification in JSON, in Markdown or on a terminal."""

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
_MICROSECONDS = 1e6


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
    ]
    for title, entries in sections(verdict).items():
        lines += [f"{title}:", "", *(f"- {entry}" for entry in entries), ""]
    lines += [
        "| " + " | ".join(COLUMNS.values()) + " |",
        "| " + " | ".join(["---"] * len(COLUMNS)) + " |",
    ]
    for phase in verdict["phases"]:
        cells = ("" if phase[name] is None else str(phase[name]) for name in COLUMNS)
        lines.append("| " + " | ".join(cells) + " |")
    everything = {key: report[key] for key in ("parameters", "versions", "model")}
    lines += ["", "To repeat it:", "", "```json", json.dumps(everything, indent=2), "```", ""]
    return "\n".join(lines)


def sections(verdict: dict[str, Any]) -> dict[str, list[str]]:
    """The lists of a verdict by their titles; empty ones are left out."""
    lists = {
        "Put to the test": coverage_lines(verdict["coverage"]),
        "Not exercised": verdict["not_exercised"],
        "Not checked": verdict["not_checked"],
        "Others on the bus": verdict["strangers"],
    }
    return {title: entries for title, entries in lists.items() if entries}


def coverage_lines(coverage: dict[str, Any]) -> list[str]:
    """Coverage in words."""
    tests = ", ".join(f"{m}: {run}/{rejected}" for m, (run, rejected) in coverage["tests"].items())
    updates = ", ".join(f"{count} {text}" for text, count in coverage["updates"].items() if count)
    equal = ", ".join(f"{count} {kind}" for kind, count in coverage["equal_frames"].items())
    ids = coverage["ids_heard"]
    mean, maximum = (round(coverage[f"latency_{which}"] * _MICROSECONDS) for which in ("mean", "maximum"))
    return [
        f"frames equal to the model's: {equal or 'none'}",
        f"{coverage['observations']} observations, {coverage['halvings']} halvings",
        f"messages of {len(ids)} ids, up to {coverage['most_messages']} in a round",
        f"tests run/rejected by number of messages: {tests or 'none'}",
        f"tests that rejected: {updates or 'none'}",
        f"rounds without a test that it would have rejected: {coverage['rounds_without_a_test']}",
        f"{len(coverage['invalid_frames'])} kinds of invalid frames, "
        f"{len(coverage['stray_commands'])} kinds of stray commands, "
        f"{len(coverage['unusual_frames'])} kinds of unusual frames",
        f"{coverage['answers']} answers timed: {mean} us on average, {maximum} us at most",
    ]


def headline(verdict: dict[str, Any]) -> str:
    """The verdict in a sentence or two."""
    phases = verdict["phases"]
    passed = sum(phase["outcome"] == "passed" for phase in phases)
    count = f"{passed} of {len(phases)} phases passed"
    if verdict["passed"]:
        repeated = f"; {verdict['repeated']} commands were repeated" * bool(verdict["repeated"])
        return f"PASSED: {count}; every frame of the controller equals the model's{repeated}"
    if verdict["difference"] is not None:
        return f"FAILED: {count}; first in {verdict['difference']}. Likely cause: {verdict['cause']}"
    if verdict["disturbance"] is not None:
        return f"DISTURBED, no verdict: {count}; {verdict['disturbance']}"
    if verdict["is_interrupted"]:
        return f"INTERRUPTED: {count}"
    empty = [f'the fault of phase "{phase["name"]}"' for phase in phases if phase["outcome"] != "passed"]
    missing = "; ".join(empty + verdict["not_exercised"])
    return f"NOT EXERCISED: {count}, no difference, but never put to the test: {missing}"
