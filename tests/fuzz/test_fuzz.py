"""The inputs that fuzzing kept find nothing, nor does a little more fuzzing; a planted mistake is found."""

from __future__ import annotations

import re
import subprocess
from dataclasses import replace
from pathlib import Path

import pytest

from fuzz.harnesses import CHECKED, FAST, HARNESSES, PORTS
from support import ROOT, section_of, slow

QUICK_HARNESSES = ("multicast", "radio")
SLOW_HARNESSES = [name for name in HARNESSES if name not in QUICK_HARNESSES]


def tried_inputs(capfd: pytest.CaptureFixture[str]) -> int:
    """Return how many inputs libFuzzer says that it has tried."""
    [number] = re.findall(r"^Done (\d+) runs", capfd.readouterr().err, re.MULTILINE)
    return int(number)


@pytest.mark.parametrize("name", [*QUICK_HARNESSES, *slow(SLOW_HARNESSES)])
def test_no_input_that_fuzzing_kept_makes_a_port_crash_or_break_a_promise(
    name: str, tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    """A port is C code between the firmware and a bus. A harness gives it inputs, and asserts its promises.

    libFuzzer runs it, with sanitizers, on all inputs that were kept and on an empty one. An input that it
    does not survive ends the run with CalledProcessError.
    """
    harness = HARNESSES[name]
    inputs = harness.unpack(tmp_path / "inputs")
    kept_count = len(list(inputs.iterdir()))

    no_new_inputs = "-runs=0"
    harness.run(inputs, CHECKED, no_new_inputs)

    assert tried_inputs(capfd) >= kept_count + 1


@pytest.mark.slow
@pytest.mark.parametrize("name", HARNESSES)
def test_none_of_300_000_more_inputs_makes_a_port_crash_or_break_a_promise(
    name: str, tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    """libFuzzer makes them from those that were kept. One that the harness does not survive ends the run.

    The build is a FAST one, whose only sanitizer is that for undefined behaviour.
    """
    harness = HARNESSES[name]
    inputs = harness.unpack(tmp_path / "inputs")

    harness.run(inputs, FAST, "-runs=300000")

    assert tried_inputs(capfd) >= 300_000


def test_docs_trust_lists_the_harnesses_of_fuzzing() -> None:
    """The table of docs/internals/trust.md has one row per harness. A sentence has the number of inputs."""
    section = section_of(ROOT / "docs/internals/trust.md", "Fuzzing")
    names_in_table = re.findall(r"^\| `(\w+)` \|", section, re.MULTILINE)
    assert names_in_table == list(HARNESSES)
    assert "tries 300,000 more of each" in section


@pytest.mark.slow
def test_fuzzing_finds_a_radio_that_sends_a_wrong_identifier(tmp_path: Path) -> None:
    """The inputs that earlier fuzzing has kept find it. The mistake is planted into a copy of the source.

    The radio sends an identifier byte by byte, and so shifts it by 8 bits.
    """
    right, wrong = "frame->id >> (8 * i)", "frame->id >> (7 * i)"
    text = (PORTS / "packet_radio.c").read_text(encoding="utf-8")
    assert text.count(right) == 1
    (tmp_path / "packet_radio.c").write_text(text.replace(right, wrong), encoding="utf-8")
    harness = replace(HARNESSES["radio"], sources=(tmp_path / "packet_radio.c",))
    inputs = harness.unpack(tmp_path / "inputs")

    no_new_inputs = "-runs=0"
    with pytest.raises(subprocess.CalledProcessError):
        harness.run(inputs, CHECKED, no_new_inputs)
