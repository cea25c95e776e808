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
def test_a_function_of_the_arithmetic_keeps_its_contract_in_every_variant(name: str) -> None:
    """Where two variants have the same text one proof is enough."""
    proved = set[Any]()
    for variant in VARIANTS:
        proves_lemma(name, variant, proved)
    assert len(proved) > 0


@pytest.mark.parametrize("divide", PREPARED)
def test_the_reciprocal_of_every_divisor_is_as_good_as_the_proofs_assume(divide: int, tmp_path: Path) -> None:
    """A program tries all divisors, where reciprocals come from a table or from floats of 32 bits.

    They are too many operators for the solver, and not too many divisors for a computer. The program's
    sanitizer sees a conversion that does not fit.
    """
    least, lost = PREPARED[divide]
    bounds = {
        "MCP_ASDF_DIVIDE": divide,
        "LEAST": least,
        "LOST_TIMES": lost.numerator,
        "LOST_OVER": lost.denominator,
    }
    flags = ["-std=c99", "-O2", "-fsanitize=undefined,float-cast-overflow", "-fno-sanitize-recover=all"]
    flags += [f"-D{name}={value}" for name, value in bounds.items()]
    if divide == LANES:
        flags += ["-include", str(LANES_HEADER)]
    source, program_path = Path(__file__).with_name("every_divisor.c"), tmp_path / "every_divisor"

    run(require("gcc", "gcc"), *flags, f"-I{HEADER.parent}", source, "-o", program_path)

    run(program_path)


Place = tuple[Path, int, str]
"""File, line and name of a function's definition."""


def written_definitions() -> set[Place]:
    """Return the definitions of functions in the texts of the arithmetic's headers, in whatever variant."""
    places = set[Place]()
    for path in ARITHMETIC:
        for number, line in enumerate(path.read_text(encoding="utf-8").splitlines(), start=1):
            definition = DEFINITION.match(line)
            if definition is not None:
                places.add((path, number, definition[1]))
    return places


def parsed_definitions() -> set[Place]:
    """Return the definitions that some variant has."""
    places = set[Place]()
    for variant in VARIANTS:
        code = program(variant)
        for name in code.defined_in(*ARITHMETIC):
            place = code.functions[name].coord
            places.add((Path(place.file), place.line, name))
    return places


def test_every_function_of_the_arithmetic_is_proved_in_some_variant() -> None:
    definitions = written_definitions()
    assert parsed_definitions() == definitions
    assert {name for *_, name in definitions} == set(LEMMAS)


def test_the_page_states_how_many_functions_and_targets_are_proved() -> None:
    definitions = written_definitions()
    names = {name for *_, name in definitions}
    page = (ROOT / "docs/internals/trust.md").read_text(encoding="utf-8")
    assert f"Each of the {len(names)} functions, in all its {len(definitions)} definitions" in page
    assert len(HERE) == 6
    assert "Eva reports no alarm for six targets' choices" in page


def test_the_page_states_how_long_the_code_is_that_gives_c_its_meaning() -> None:
    """To 50 lines: whoever does not trust it knows how much to read."""
    files = [Path(__file__).with_name(name) for name in ("machine.py", "numbers.py")]
    line_count = sum(len(path.read_text(encoding="utf-8").splitlines()) for path in files)
    page = (ROOT / "docs/internals/trust.md").read_text(encoding="utf-8")

    [stated_count] = re.findall(r"some (\d+) lines that give C its meaning", page)

    assert abs(int(stated_count) - line_count) < 50
