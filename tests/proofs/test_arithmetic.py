"""Every function of the header keeps its contract for all arguments, in every variant that a target can
choose."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import pytest

from proofs.arithmetic import RECIPROCAL_LIMITS, contracts, is_tried
from proofs.prove import prove_lemma
from proofs.source import ARITHMETIC, HEADER, HERE, LANES, LANES_HEADER, VARIANTS, Variant, program
from support import ROOT, require, run

LEMMAS = sorted({name for variant in VARIANTS for name in contracts(variant)})
LONG_PROOFS = ("divide_by_bits", "ratio", "shift_right_64")
"""Functions whose proofs only the slow tests have."""
DEFINITION = re.compile(r"(?!#|typedef)[A-Za-z_].*?(\w+)\(.*\)( \{.*)?$")
"""The first line of one, which begins in the first column."""


def variants_to_prove(name: str) -> list[Variant]:
    """Return the variants that define a function, but those where every argument is tried instead."""
    return [
        variant for variant in VARIANTS if name in program(variant).functions and not is_tried(variant, name)
    ]


@pytest.mark.parametrize("name", [name for name in LEMMAS if name not in LONG_PROOFS])
def test_a_function_of_the_arithmetic_keeps_its_contract_in_a_variant(name: str) -> None:
    """A variant is how a target divides, multiplies and shifts. This is the first that has the function.

    ``prove_lemma`` raises UnprovenError if some arguments break the contract.
    """
    first_variant, *_other_variants = variants_to_prove(name)
    prove_lemma(program(first_variant), name, contracts(first_variant))


@pytest.mark.slow
@pytest.mark.parametrize("name", LEMMAS)
def test_a_function_of_the_arithmetic_keeps_its_contract_in_every_variant(name: str) -> None:
    """A variant is how a target divides, multiplies and shifts. The same text in two is proved once.

    ``prove_lemma`` adds to ``done_proofs`` what it has proved. It raises UnprovenError without a proof.
    """
    done_proofs = set[Any]()
    for variant in variants_to_prove(name):
        prove_lemma(program(variant), name, contracts(variant), done_proofs)
    assert len(done_proofs) > 0


def build_every_divisor(divide: int, folder: Path) -> Path:
    """Build every_divisor.c for a way to divide, and return the program.

    Its exit code is 0 if all reciprocals are within the limits that the proofs assume. A sanitizer ends it
    at a conversion that does not fit.
    """
    least_divisor, lost_share = RECIPROCAL_LIMITS[divide]
    definitions = {
        "MCP_ASDF_DIVIDE": divide,
        "LEAST": least_divisor,
        "LOST_TIMES": lost_share.numerator,
        "LOST_OVER": lost_share.denominator,
    }
    flags = ["-std=c99", "-O2", "-fsanitize=undefined,float-cast-overflow", "-fno-sanitize-recover=all"]
    flags += [f"-D{name}={value}" for name, value in definitions.items()]
    if divide == LANES:
        flags += ["-include", str(LANES_HEADER)]
    source, built = Path(__file__).with_name("every_divisor.c"), folder / "every_divisor"
    run(require("gcc", "gcc"), *flags, f"-I{HEADER.parent}", source, "-o", built)
    return built


@pytest.mark.parametrize("divide", RECIPROCAL_LIMITS)
def test_the_reciprocal_of_every_divisor_is_as_good_as_the_proofs_assume(divide: int, tmp_path: Path) -> None:
    """A program tries all divisors, and ends with an error if a reciprocal is not as near as assumed.

    Reciprocals come from a table or from floats of 32 bits, which are too hard for the solver.
    """
    run(build_every_divisor(divide, tmp_path))


Place = tuple[Path, int, str]
"""File, line and name of a function's definition."""


def written_definitions() -> set[Place]:
    """Return the definitions of functions in the texts of the arithmetic's headers, in all variants."""
    definitions = set[Place]()
    for path in ARITHMETIC:
        for number, line in enumerate(path.read_text(encoding="utf-8").splitlines(), start=1):
            definition = DEFINITION.match(line)
            if definition is not None:
                definitions.add((path, number, definition[1]))
    return definitions


def parsed_definitions() -> set[Place]:
    """Return the definitions that some variant has."""
    definitions = set[Place]()
    for variant in VARIANTS:
        code = program(variant)
        for name in code.defined_in(*ARITHMETIC):
            coordinates = code.functions[name].coord
            definitions.add((Path(coordinates.file), coordinates.line, name))
    return definitions


def test_every_function_of_the_arithmetic_is_proved_in_some_variant() -> None:
    """A function may be defined more than once; which definition a compiler sees depends on the variant.

    The definitions in the headers' texts are those that some variant has, and LEMMAS lists their names: the
    functions whose contracts are proved in every variant.
    """
    definitions = written_definitions()
    names = {name for _path, _line, name in definitions}

    assert parsed_definitions() == definitions
    assert names == set(LEMMAS)


def test_the_page_about_trust_states_how_many_functions_and_targets_are_proved() -> None:
    """A function may have several definitions, for targets that divide, multiply or shift in different ways.

    HERE lists the choices of targets that a compiler for this machine takes. Eva analyses each of them.
    """
    definitions = written_definitions()
    names = {name for _path, _line, name in definitions}
    page = (ROOT / "docs/internals/trust.md").read_text(encoding="utf-8")
    assert f"Each of the {len(names)} functions, in all its {len(definitions)} definitions" in page
    assert len(HERE) == 6
    assert "Eva reports no alarm for six targets' choices" in page


def line_count(name: str) -> int:
    """Return the number of lines of a file beside this one."""
    return len(Path(__file__).with_name(name).read_text(encoding="utf-8").splitlines())


def test_the_page_about_trust_states_how_long_the_code_is_that_gives_c_its_meaning() -> None:
    """The page rounds to 50 lines. Whoever does not trust the code knows how much to read."""
    page = (ROOT / "docs/internals/trust.md").read_text(encoding="utf-8")
    [stated_count] = re.findall(r"some (\d+) lines that give C its meaning", page)
    assert int(stated_count) == pytest.approx(line_count("machine.py") + line_count("numbers.py"), abs=50)
