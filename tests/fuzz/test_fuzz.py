"""The inputs that fuzzing kept find nothing, nor does a little more fuzzing; planted faults are found."""

from __future__ import annotations

import os
import random
import sys
from pathlib import Path

import pytest

from fuzz.harnesses import BUILD, CHECKED, CORPORA, FAST, HARNESSES, run
from support import require
from support import run as run_command


def test_every_harness_has_kept_inputs() -> None:
    assert {each.stem for each in CORPORA.iterdir()} == set(HARNESSES)


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


@pytest.mark.slow
def test_a_mistake_in_one_variant_is_found(tmp_path: Path) -> None:
    harness = HARNESSES["api"]
    folder = harness.unpack(tmp_path / "inputs")
    outcome = run(harness.build((*FAST, "-DMISTAKE")), folder, "-seed=1", "-max_len=64", "-runs=5000000")
    assert outcome.finding and "not so: targets[i]->x_bar(&robot) == w.model.x_bar()" in outcome.said


@pytest.mark.slow
def test_harnesses_are_afls_too(tmp_path: Path) -> None:
    """It takes the same file, and tries some inputs of its own."""
    require("afl-fuzz", "afl++")
    flags = ("-O2", "-fsanitize=undefined", "-fsanitize-trap=undefined", "-fsanitize=fuzzer")
    program = HARNESSES["codec"].build(flags, compiler="afl-clang-fast")
    folder = HARNESSES["codec"].unpack(tmp_path / "inputs")
    run_command(
        *(
            "env",
            "AFL_NO_UI=1",
            "AFL_SKIP_CPUFREQ=1",
            "AFL_I_DONT_CARE_ABOUT_MISSING_CRASHES=1",
            "AFL_NO_AFFINITY=1",
        ),
        *("afl-fuzz", "-V", "5", "-i", folder, "-o", tmp_path / "out", "--", program),
    )
    stats = (tmp_path / "out/default/fuzzer_stats").read_text(encoding="ascii")
    assert int(stats.split("execs_done")[1].split()[1]) > 1000
    assert os.listdir(tmp_path / "out/default/crashes") == []


def test_builds_are_kept(tmp_path: Path) -> None:
    """By a name that changes with the flags and every source."""
    harness = HARNESSES["codec"]
    program = harness.build(CHECKED)
    assert program.parent == BUILD and harness.build(CHECKED) == program
    before = program.stat().st_mtime_ns
    assert harness.build(CHECKED).stat().st_mtime_ns == before
