"""C programs of the pages print numbers of the right size, whether an unsigned long has 32 bits or 64."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from support import CORE, PAGES, blocks, require, run
from targets.test_khepera import STAND_IN_FOR_LIBRARY

PRINTING_CALL = re.compile(r"printf\(|\bputchar\(|\bputs\(")


def printing_programs() -> dict[str, str]:
    """Return the C programs of the pages that print, each by its page and its number there."""
    programs = {}
    for page in PAGES:
        for number, code in enumerate(blocks(page, "c", "cpp"), start=1):
            if PRINTING_CALL.search(code):
                programs[f"{page.name} {number}"] = code
    return programs


PROGRAMS = printing_programs()


@pytest.mark.parametrize("length_of_long", ["-m32", "-m64"])
@pytest.mark.parametrize("program", PROGRAMS.values(), ids=PROGRAMS)
def test_a_program_of_the_docs_prints_each_number_by_the_format_of_its_type(
    program: str, length_of_long: str, tmp_path: Path
) -> None:
    """The compiler compares formats with types. An error, for which run() raises, is a wrong one.

    Where a long has 32 bits and where it has 64, other formats are wrong. The library of the Khepera's maker,
    which a program includes, is not here.
    """
    (tmp_path / "khepera").mkdir()
    (tmp_path / "khepera/khepera.h").write_text(STAND_IN_FOR_LIBRARY, encoding="ascii")
    (tmp_path / "program.c").write_text(program, encoding="utf-8")
    include = (f"-I{CORE.parent}", f"-I{tmp_path}")
    strict = ("-std=gnu99", "-Wformat", "-Werror", "-fsyntax-only")

    run(require("gcc"), length_of_long, *strict, *include, tmp_path / "program.c")


def test_the_pages_have_programs_that_print() -> None:
    """Otherwise the test before would compare nothing."""
    assert len(PROGRAMS) >= 4
