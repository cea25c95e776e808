"""Every function of the header keeps its contract for all arguments, in every variant that a target can
choose."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import pytest

from proofs.arithmetic import PREPARED, contracts, is_tried
from proofs.prove import prove_lemma
from proofs.source import ARITHMETIC, HEADER, HERE, LANES, LANES_HEADER, VARIANTS, Variant, program
from support import ROOT, require, run

LEMMAS = sorted({name for variant in VARIANTS for name in contracts(variant)})
LONG = ("divide_by_bits", "ratio", "shift_right_64")
DEFINITION = re.compile(r"(?!#|typedef)[A-Za-z_].*?(\w+)\(.*\)( \{.*)?$")
"""The first line of one, which begins in the first column."""


def proves_lemma(name: str, variant: Variant, proved: set[Any]) -> bool:
    """Prove the lemma of a function in a variant, unless ``proved`` already has the same text.

    Returns False if the variant does not define the function, or if every argument is tried instead.
    """
    code = program(variant)
    if name not in code.functions or is_tried(variant, name):
        return False
    prove_lemma(code, name, contracts(variant), proved)
    return True


@pytest.mark.parametrize("name", [name for name in LEMMAS if name not in LONG])
def test_a_function_keeps_its_contract_in_a_variant(name: str) -> None:
    """The proof is for the first variant that defines the function."""
    assert any(proves_lemma(name, variant, set()) for variant in VARIANTS)


@pytest.mark.slow
@pytest.mark.parametrize("name", LEMMAS)
def test_a_function_keeps_its_contract_in_every_variant(name: str) -> None:
    proved = set[Any]()
    for variant in VARIANTS:
        proves_lemma(name, variant, proved)
    assert proved


@pytest.mark.parametrize("divide", PREPARED)
def test_every_divisor_is_prepared(divide: int, tmp_path: Path) -> None:
    """Where reciprocals come from a table or from binary32, too many operators for the solver; not too many
    divisors for a computer. The sanitizer sees a conversion that does not fit."""
    least, lost = PREPARED[divide]
    bounds = {
        "MCP_ASDF_DIVIDE": divide,
        "LEAST": least,
        "LOST_TIMES": lost.numerator,
        "LOST_OVER": lost.denominator,
    }
    flags = ("-std=c99", "-O2", "-fsanitize=undefined,float-cast-overflow", "-fno-sanitize-recover=all")
    chosen = [f"-D{name}={value}" for name, value in bounds.items()]
    chosen += ["-include", str(LANES_HEADER)] if divide == LANES else []
    source = Path(__file__).with_name("every_divisor.c")
    run(
        require("gcc", "gcc"), *flags, *chosen, f"-I{HEADER.parent}", source, "-o", tmp_path / "every_divisor"
    )
    run(tmp_path / "every_divisor")


def test_each_definition_has_a_lemma_in_some_variant() -> None:
    """As many as the text has, and as docs/internals/trust.md says."""
    texts = {path: path.read_text(encoding="utf-8").splitlines() for path in ARITHMETIC}
    lines = {(path, at): line for path, text in texts.items() for at, line in enumerate(text, 1)}
    found = {place: DEFINITION.match(line) for place, line in lines.items()}
    written = {(*place, match[1]) for place, match in found.items() if match}
    parsed = {
        (Path(code.functions[name].coord.file), code.functions[name].coord.line, name)
        for code in map(program, VARIANTS)
        for name in code.defined_in(*ARITHMETIC)
    }
    assert parsed == written
    names = {name for *_, name in written}
    assert names == set(LEMMAS)
    said = (ROOT / "docs/internals/trust.md").read_text(encoding="utf-8")
    assert f"Each of the {len(names)} functions, in all its {len(written)} definitions" in said
    assert len(HERE) == 6 and "Eva reports no alarm for six targets' choices" in said
    lines_of_c = sum(
        len(Path(__file__).with_name(name).read_text().splitlines()) for name in ("machine.py", "numbers.py")
    )
    (about,) = re.findall(r"some (\d+) lines that give C its meaning", said)
    assert abs(int(about) - lines_of_c) < 50
