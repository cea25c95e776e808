"""The inputs that fuzzing kept find nothing, nor does a little more fuzzing; a planted fault is found."""

from __future__ import annotations

import random
import sys
from dataclasses import replace
from pathlib import Path

import pytest

from fuzz.harnesses import CHECKED, FAST, HARNESSES, PORTS, run
from support import run as run_command


@pytest.mark.parametrize("name", HARNESSES)
def test_kept_inputs_find_nothing(name: str, tmp_path: Path) -> None:
    harness = HARNESSES[name]
    folder = harness.unpack(tmp_path / "inputs")
    outcome = run(harness.build(CHECKED), folder, "-runs=0")
    assert not outcome.finding, f"{outcome.finding.hex()}\n{outcome.said}"
    assert outcome.executions > len(list(folder.iterdir()))  # and one empty one


@pytest.mark.slow
@pytest.mark.parametrize("name", HARNESSES)
def test_more_inputs_find_nothing(name: str, tmp_path: Path) -> None:
    harness, seed = HARNESSES[name], random.randrange(1, 1 << 31)
    print(f"seed {seed}")
    folder = harness.unpack(tmp_path / "inputs")
    options = (f"-seed={seed}", f"-max_len={harness.longest}", "-timeout=60", "-runs=300000")
    outcome = run(harness.build(FAST), folder, *options)
    assert not outcome.finding, f"{outcome.finding.hex()}\n{outcome.said}"
    assert outcome.executions >= 300000


@pytest.mark.slow
def test_the_command_reports_what_it_did() -> None:
    said = run_command(
        sys.executable, "-m", "fuzz", "codec", "--runs", "100000", "--seed", "7", PYTHONPATH="tests"
    )
    assert "codec: 100000 executions" in said and "seed 7" in said


def test_a_mistake_is_found(tmp_path: Path) -> None:
    """A radio that sends a wrong identifier."""
    right, wrong = "frame->id >> 8 * i", "frame->id >> 7 * i"
    text = (PORTS / "packet_radio.c").read_text(encoding="utf-8")
    assert text.count(right) == 1
    (tmp_path / "packet_radio.c").write_text(text.replace(right, wrong))
    harness = replace(HARNESSES["radio"], sources=(tmp_path / "packet_radio.c",))
    inputs = harness.unpack(tmp_path / "inputs")
    assert run(harness.build(CHECKED), inputs, "-runs=0").finding
