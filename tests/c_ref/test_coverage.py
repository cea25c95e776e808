"""Every condition of the firmware that can be, is decided both ways by the C tests, and each by itself: MC/DC
by clang."""

from __future__ import annotations

import json
from collections import defaultdict
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import pytest

from mutation.killers import third_object
from proofs.source import HERE
from support import CORE, ROOT, TABLE, require, run

PACKAGES = "clang-19 llvm-19 libclang-rt-19-dev"
PORTS = ROOT / "c_ref/ports"
SOURCES = [*sorted(CORE.parent.glob("*.c")), *sorted((PORTS / "node").glob("*.c"))]
FIRMWARE = {*SOURCES, *CORE.parent.glob("*.h")}
"""Files whose conditions count."""
BLACK_BOX = ("frame", "node")
FLAGS = ("-std=c99", "-O1", "-fprofile-instr-generate", "-fcoverage-mapping", "-fcoverage-mcdc")

Span = tuple[int, ...]
"""First line and column, last line and column."""
Place = tuple[str, str, Span]
"""Function, file and place."""


@dataclass
class Decisions:
    """Observed values of the conditions and decisions of some functions.

    Attributes:
        outcomes: How often a condition was true and false, by function, file and place.
        effects: Whether each condition of a decision changed its result by itself, in its order, likewise.
    """

    outcomes: dict[Place, list[int]] = field(default_factory=lambda: defaultdict(lambda: [0, 0]))
    effects: dict[Place, list[bool]] = field(default_factory=dict)

    def add(self, function: dict[str, Any]) -> None:
        """Adds what one program saw of a function; what any of them saw counts."""
        name = function["name"].replace(";", ":").rpartition(":")[2]
        path = function["filenames"][0]
        for *span, true, false, _, _, _ in function["branches"]:
            seen = self.outcomes[name, path, tuple(span)]
            seen[:] = seen[0] + true, seen[1] + false
        for record in function["mcdc_records"]:
            key, effects = (name, path, tuple(record[:4])), record[-1]
            before = self.effects.get(key, [False] * len(effects))
            self.effects[key] = [a or b for a, b in zip(before, effects, strict=True)]

    def missing(self) -> list[tuple[str, str, str]]:
        """Function, text, and what was not seen: ``true``, ``false``, or ``effect of condition i``."""
        found = [
            (place, outcome)
            for place, counts in self.outcomes.items()
            for outcome, count in zip(("true", "false"), counts, strict=True)
            if count == 0
        ]
        found += [
            (place, f"effect of condition {number}")
            for place, effects in self.effects.items()
            for number, seen in enumerate(effects, 1)
            if not seen
        ]
        return sorted((name, text_at(path, span), what) for (name, path, span), what in found)


def text_at(path: str, span: Span) -> str:
    """A part of a source file on one line."""
    first_line, first_column, last_line, last_column = span
    lines = Path(path).read_text(encoding="utf-8").splitlines()[first_line - 1 : last_line]
    lines[-1] = lines[-1][: last_column - 1]
    lines[0] = lines[0][first_column - 1 :]
    return " ".join(" ".join(lines).split())


def programs(folder: Path) -> Iterator[Path]:
    """The C tests, as they are built for the project, with counters in them."""
    require("clang-19", PACKAGES)
    tests = ROOT / "tests/c_ref"
    for name in BLACK_BOX:
        yield _compiled(folder / name, tests / f"test_{name}.c", *SOURCES, TABLE)
    third = third_object(folder)
    core = CORE, CORE.with_name("mcp_asdf_image.c"), TABLE
    for variant in HERE:
        yield _compiled(folder / f"core_{variant}", tests / "test_core.c", *variant.flags())
        linked = (*core, third, "-lstdc++", "-lm")
        yield _compiled(folder / f"third_{variant}", *variant.flags(), *linked)


def _compiled(program: Path, *arguments: str | Path) -> Path:
    run("clang-19", *FLAGS, f"-I{CORE.parent}", f"-I{PORTS}", *arguments, "-o", program)
    return program


def measured(folder: Path) -> Decisions:
    """Of all C tests together."""
    found = Decisions()
    for program in programs(folder):
        raw, profile = program.with_suffix(".profraw"), program.with_suffix(".profdata")
        run(program, LLVM_PROFILE_FILE=str(raw))
        run(require("llvm-profdata-19", PACKAGES), "merge", "-o", profile, raw)
        exported = run(
            *(require("llvm-cov-19", PACKAGES), "export", "-skip-expansions"),
            *(f"-instr-profile={profile}", program),
        )
        for function in json.loads(exported)["data"][0]["functions"]:
            if Path(function["filenames"][0]) in FIRMWARE:
                found.add(function)
    return found


CONSTANT = "a constant of each build, so no run can change it; both its values are compiled and tested"
OF_BUILDS = {
    ("divide_24", "MCP_ASDF_DIVIDE == MCP_ASDF_DIVIDE_BY_TABLE && d >> 30 == 0U"): (1,),
    (
        "mcp_asdf_is_robust",
        "MCP_ASDF_WITH_ROBUST && (!MCP_ASDF_WITH_ASDF || config->filter == MCP_ASDF_ROBUST)",
    ): (1, 2),
}
UNREACHED = {
    (*place, f"effect of condition {number}"): CONSTANT
    for place, numbers in OF_BUILDS.items()
    for number in numbers
}
"""Conditions that cannot be reached: function, text and value; and the reason."""


@pytest.mark.slow
def test_every_condition_is_tested(tmp_path: Path) -> None:
    """Missing means missing from all C tests together."""
    found = measured(tmp_path)
    without_code = CORE.with_name("mcp_asdf_accessors.c")  # its functions stand in mcp_asdf.h
    assert {Path(path) for _, path, _ in found.outcomes} == {
        *(source for source in SOURCES if source != without_code),
        *(CORE.with_name(f"mcp_asdf{part}.h") for part in ("", "_arithmetic", "_robust")),
        *CORE.parent.glob("mcp_asdf_target*.h"),
    }
    assert len(found.outcomes) > 150 and sum(map(len, found.effects.values())) > 70
    missing = found.missing()
    assert missing == sorted(UNREACHED), "\n".join(map(str, missing))
