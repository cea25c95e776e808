"""Other systems and compilers: nothing that only one of them has is used without asking."""

from __future__ import annotations

import re
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

from support import ROOT, require, run

SOURCES = [
    path
    for folder in ("c_ref/src", "host_tools/mcp_asdf_tools")
    for path in sorted((ROOT / folder).rglob("*.[ch]"))
]
OF_GNU = re.compile(r"__attribute__|__builtin_|__int128|\basm\b")
ASKED = re.compile(r"__GNUC__|MCP_ASDF_HAS_CLZ")
"""Conditions under which a compiler has GNU's extensions; the second is 1 by default for those alone."""

WITHOUT = """\
import os, signal, sys
for name in ("SIGHUP", "pthread_sigmask"):
    delattr(signal, name)
for name in ("sched_getaffinity", "sched_setaffinity"):
    delattr(os, name)
sys.modules["fcntl"] = None
from mcp_asdf_tools.cli.main import main
"""
"""A Python that lacks what Windows lacks."""


def unguarded(text: str) -> Iterator[str]:
    """The lines with extensions of GNU's compilers that no condition asks for."""
    conditions: list[str] = []
    for line in re.sub(r"/\*.*?\*/", "", text, flags=re.DOTALL).splitlines():
        directive = re.match(r"\s*#\s*(if\w*|elif|else|endif)\b(.*)", line)
        if directive is None:
            if OF_GNU.search(line) and not any(map(ASKED.search, conditions)):
                yield line.strip()
        elif directive[1].startswith("if"):
            conditions.append(directive[2])
        else:
            last = conditions.pop()
            if directive[1] != "endif":
                conditions.append(f"{directive[2]} {last}" if "!" in last else directive[2])


@pytest.mark.parametrize("path", SOURCES, ids=lambda path: path.name)
def test_extensions_of_a_compiler_are_asked_for(path: Path) -> None:
    assert list(unguarded(path.read_text(encoding="utf-8"))) == []


def test_an_extension_that_is_not_asked_for_is_found() -> None:
    text = (
        "#ifdef __GNUC__\n__builtin_clz(1)\n#else\n__builtin_ctz(1)\n#endif\nint x __attribute__((unused));\n"
    )
    assert list(unguarded(text)) == ["__builtin_ctz(1)", "int x __attribute__((unused));"]


def test_the_lowest_bit_without_the_builtin(tmp_path: Path) -> None:
    text = (ROOT / "host_tools/mcp_asdf_tools/world/arena/arena_private.h").read_text(encoding="utf-8")
    (plain,) = re.findall(r"#else\n(static inline int lowest_bit.*?)#endif", text, re.DOTALL)
    (tmp_path / "bits.c").write_text(
        "#include <stdint.h>\n"
        + plain
        + "int main(void) { int wrong = 0; for (int bit = 0; bit < 64; ++bit) {\n"
        "wrong += lowest_bit((uint64_t)1 << bit) != bit; wrong += lowest_bit(UINT64_MAX << bit) != bit; }\n"
        "return wrong; }\n"
    )
    run(require("cc", "gcc libc6-dev"), tmp_path / "bits.c", "-o", tmp_path / "bits")
    run(tmp_path / "bits")


@pytest.mark.parametrize(
    "line",
    [
        "swarm --robots 4 --steps 30 --filter-period 10 --quiet --log run.log",
        "radio --id 3 --robots 3 --steps 1 --steps-per-second 500",
        "simulate --robots 4 --steps 2000 --filter-period 10 --trials 2 --firmware mirror --workers 2",
        "--help",
    ],
)
def test_a_system_without_signals_and_locks_of_posix(line: str, tmp_path: Path) -> None:
    code = WITHOUT + f"if __name__ == '__main__': sys.exit(main({line.split()}))"
    (tmp_path / "program.py").write_text(code)
    done = subprocess.run(
        [sys.executable, "program.py"], cwd=tmp_path, capture_output=True, text=True, check=False, timeout=120
    )
    assert done.returncode == 0, done.stderr
