"""Frama-C's Eva finds nothing in the whole firmware: no trap, no stray access, nothing that C leaves open,
whatever the arguments, the table, the image and the robot's memory hold."""

from __future__ import annotations

import re
import shutil
from itertools import product
from pathlib import Path

import pytest

from proofs.source import AVR, INCLUDE, LANES, SOURCES, VARIANTS, Variant
from support import CORE, require, run

CALLS = Path(__file__).with_name("any_calls.c")
DOMAINS = ("-eva-split-return", "auto", "-eva-domains", "equality,symbolic-locations")
ALARM = re.compile(r"^\[eva:alarm\] .*: Warning: *\n  (.*?)(?:assert.*)?$", re.MULTILINE)
PART = re.compile(r"^  (\w+): (\d+) stmts out of (\d+) ", re.MULTILINE)
ASSUMED = {LANES: ["overflow in conversion from floating-point to integer."]}
"""Alarms by way of division; this one is lemma prepare's: ``every_divisor.c`` converts every word."""
UNREACHED = {"divide_24", "mcp_asdf_is_robust"}
"""Constant conditions: only where a table has reciprocals is a short divisor doubled, and only where one
filter is built is there no choice."""
FRAGILE = ("accuracy->g_shift & 31U", "accuracy->g_shift")


ONE_FILTER = ("MCP_ASDF_WITH_ASDF=0", "MCP_ASDF_WITH_ROBUST=0")


# design: R34
@pytest.mark.slow
@pytest.mark.parametrize(
    ("variant", "without"),
    [*((each, "") for each in VARIANTS), *product((VARIANTS[0], AVR), ONE_FILTER)],
    ids=str,
)
def test_any_call_is_safe(variant: Variant, without: str) -> None:
    """With one filter alone, choices are constants, and less is reached."""
    said = eva(variant, SOURCES, f"-D{without}", precision=6) if without else eva(variant)
    assert alarms(said) == ([] if without else ASSUMED.get(variant.divide, []))
    assert "neither code nor specification" not in said
    parts = PART.findall(said)
    assert without or {name for name, reached, of in parts if reached != of} <= UNREACHED
    called = {name for name, _, _ in parts}
    assert called >= set(re.findall(r"\b(mcp_asdf_\w+)\(&", CALLS.read_text(encoding="utf-8")))


@pytest.mark.slow
def test_a_trap_is_found(tmp_path: Path) -> None:
    """A shift by a count that damaged memory makes too large."""
    shutil.copytree(SOURCES, tmp_path, dirs_exist_ok=True)
    text = CORE.read_text(encoding="utf-8")
    assert FRAGILE[0] in text
    (tmp_path / CORE.name).write_text(text.replace(*FRAGILE), encoding="utf-8")
    assert any("shift" in alarm for alarm in alarms(eva(VARIANTS[0], tmp_path)))


def alarms(said: str) -> list[str]:
    """The subjects of the alarms."""
    return sorted({about.strip() for about in ALARM.findall(said)})


def eva(variant: Variant, sources: Path = SOURCES, *more: str, precision: int = 3) -> str:
    """Output of the analyser; an int of 16 or 32 bits, and a long of 32, as on the targets."""
    flags = " ".join([f"-I{sources}", *variant.flags(), *more, "-idirafter", str(INCLUDE)])
    machine = ("-machdep", f"gcc_x86_{variant.int_bits}", f"-cpp-extra-args={flags}")
    plugins = ("-no-autoload-plugins", "-load-module", "eva,from,inout,scope,metrics")
    eva = ("-eva", "-eva-precision", str(precision), *DOMAINS, "-metrics-eva-cover", CALLS)
    return run(require("frama-c", "frama-c-base"), *plugins, *machine, *eva)
