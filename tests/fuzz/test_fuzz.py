"""The inputs that fuzzing kept find nothing, nor does a little more fuzzing; a planted fault is found."""

from __future__ import annotations

import re
import subprocess
from dataclasses import replace
from pathlib import Path

import pytest

from fuzz.harnesses import CHECKED, FAST, HARNESSES, PORTS
from support import ROOT, slow

MORE = 300_000
"""Inputs that the slow test tries with each harness."""
QUICK_HARNESSES = ("multicast", "radio")
"""Harnesses of ``make test``, in which tests/targets sends noise to a checked robot on a serial line."""
SLOW_HARNESSES = [name for name in HARNESSES if name not in QUICK_HARNESSES]


@pytest.mark.parametrize(
    ("compiler_flags", "input_count"), [(CHECKED, 0), *slow([(FAST, MORE)])], ids=["kept", "more"]
)
@pytest.mark.parametrize("name", [*QUICK_HARNESSES, *slow(SLOW_HARNESSES)])
def test_no_input_makes_a_port_crash_or_break_a_promise(
    name: str,
    compiler_flags: tuple[str, ...],
    input_count: int,
    tmp_path: Path,
    capfd: pytest.CaptureFixture[str],
) -> None:
    """A port is C code between the firmware and a bus. A harness gives it inputs, and asserts its promises.

    libFuzzer runs the harness called ``name`` on an empty input and on those that earlier fuzzing has kept.
    Then it makes others from them, until there were ``input_count``. An input that the harness does not
    survive ends the run with CalledProcessError. ``compiler_flags`` choose the checks that are compiled in.
    """
    harness = HARNESSES[name]
    inputs = harness.unpack(tmp_path / "inputs")
    kept_and_empty_count = len(list(inputs.iterdir())) + 1

    harness.run(inputs, compiler_flags, f"-runs={input_count}")

    last_line = re.search(r"^Done (\d+) runs", capfd.readouterr().err, re.MULTILINE)
    assert last_line is not None
    assert int(last_line[1]) >= max(input_count, kept_and_empty_count)


def test_the_page_lists_the_harnesses() -> None:
    page = (ROOT / "docs/internals/trust.md").read_text(encoding="utf-8").partition("## Fuzzing")[2]
    assert re.findall(r"^\| `(\w+)` \|", page, re.MULTILINE) == list(HARNESSES)
    assert f"tries {MORE:,} more of each" in page


def test_fuzzing_finds_a_radio_that_sends_a_wrong_identifier(tmp_path: Path) -> None:
    """The inputs that earlier fuzzing has kept find it. The mistake is planted into a copy of the source."""
    right, wrong = "frame->id >> (8 * i)", "frame->id >> (7 * i)"
    text = (PORTS / "packet_radio.c").read_text(encoding="utf-8")
    assert text.count(right) == 1
    (tmp_path / "packet_radio.c").write_text(text.replace(right, wrong))
    harness = replace(HARNESSES["radio"], sources=(tmp_path / "packet_radio.c",))
    inputs = harness.unpack(tmp_path / "inputs")

    with pytest.raises(subprocess.CalledProcessError):
        harness.run(inputs, CHECKED, "-runs=0")
