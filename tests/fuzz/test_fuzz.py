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
QUICK_HARNESSES = ("multicast", "radio")
"""Harnesses of ``make test``, in which tests/targets sends noise to a checked robot on a serial line."""
SLOW_HARNESSES = [name for name in HARNESSES if name not in QUICK_HARNESSES]


@pytest.mark.parametrize(("flags", "more"), [(CHECKED, 0), *slow([(FAST, MORE)])], ids=["kept", "more"])
@pytest.mark.parametrize("name", [*QUICK_HARNESSES, *slow(SLOW_HARNESSES)])
def test_no_input_makes_a_port_crash_or_break_a_promise(
    name: str, flags: tuple[str, ...], more: int, tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    """The inputs that fuzzing kept and an empty one, and ``more`` that libFuzzer derives from them.

    It prints its seed, and "Done 123 runs" in the end; now and then it runs one again.
    """
    inputs = HARNESSES[name].unpack(tmp_path / "inputs")
    kept_count = len(list(inputs.iterdir()))

    HARNESSES[name].run(inputs, flags, f"-runs={more}")

    last_line = re.search(r"^Done (\d+) runs", capfd.readouterr().err, re.MULTILINE)
    assert last_line is not None
    assert int(last_line[1]) > max(more - 1, kept_count)


def test_the_page_lists_the_harnesses() -> None:
    page = (ROOT / "docs/internals/trust.md").read_text(encoding="utf-8").partition("## Fuzzing")[2]
    assert re.findall(r"^\| `(\w+)` \|", page, re.MULTILINE) == list(HARNESSES)
    assert f"tries {MORE:,} more of each" in page


def test_fuzzing_finds_a_radio_that_sends_a_wrong_identifier(tmp_path: Path) -> None:
    """With the kept inputs alone. The mistake is planted into a copy."""
    right, wrong = "frame->id >> (8 * i)", "frame->id >> (7 * i)"
    text = (PORTS / "packet_radio.c").read_text(encoding="utf-8")
    assert text.count(right) == 1
    (tmp_path / "packet_radio.c").write_text(text.replace(right, wrong))
    harness = replace(HARNESSES["radio"], sources=(tmp_path / "packet_radio.c",))
    inputs = harness.unpack(tmp_path / "inputs")

    with pytest.raises(subprocess.CalledProcessError):
        harness.run(inputs, CHECKED, "-runs=0")
