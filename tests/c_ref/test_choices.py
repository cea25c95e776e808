"""The core's choices for a target compile in every combination, and wrong ones do not compile at all."""

from __future__ import annotations

import json
import subprocess
from itertools import product
from pathlib import Path

import pytest

from support import CORE, ROOT, require, run

PRESETS = json.loads((ROOT / "CMakePresets.json").read_text(encoding="utf-8"))
WARNINGS = PRESETS["configurePresets"][0]["environment"]["WARNINGS"].split()
CHOICES = {"DIVIDE": range(1, 4), "SPLIT_MULTIPLY": range(2), "SHIFT_BYTES": range(2), "HAS_CLZ": range(2)}


@pytest.mark.slow
@pytest.mark.parametrize("way", ["gcc -O2 -c", "clang -O2 -fsyntax-only"])
def test_every_combination_compiles_without_a_warning(way: str, tmp_path: Path) -> None:
    compiler, *flags = way.split()
    require(compiler, compiler)
    for values in product(*CHOICES.values()):
        chosen = [f"-DMCP_ASDF_{name}={value}" for name, value in zip(CHOICES, values, strict=True)]
        run(compiler, "-std=c99", *flags, *WARNINGS, *chosen, CORE, cwd=tmp_path)


@pytest.mark.parametrize(
    ("flag", "complaint"),
    [
        *((f"-DMCP_ASDF_DIVIDE={wrong}", "MCP_ASDF_DIVIDE is out of range: choose ") for wrong in (0, 5)),
        *(
            (f"-DMCP_ASDF_{part}", "define all of MCP_ASDF_ROM")
            for part in ("ROM=", "READ_WORD(address)=(*(address))", "READ_BYTE(address)=(*(address))")
        ),
    ],
)
def test_a_choice_that_is_none_is_refused(flag: str, complaint: str) -> None:
    command = ["gcc", "-std=c99", "-fsyntax-only", flag, str(CORE)]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode != 0 and complaint in done.stderr
