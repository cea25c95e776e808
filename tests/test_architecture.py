"""The packages import only those below them, and the page about the architecture is right."""

from __future__ import annotations

import os
import re
import sys
import tomllib
from importlib import import_module
from pathlib import Path

import mcp_asdf_tools
from support import ROOT, matching_files, run

TOOLS = ROOT / "host_tools/mcp_asdf_tools"
PACKAGES = [path.parent.name for path in matching_files(TOOLS, "*/__init__.py")]
PAGE = (ROOT / "docs/internals/architecture.md").read_text(encoding="utf-8")


def test_no_package_imports_one_that_stands_above_it() -> None:
    """``lint-imports`` checks the order of the packages, which two contracts in pyproject.toml state."""
    paths = os.pathsep.join(str(ROOT / folder) for folder in ("firmware_py", "host_tools"))
    output = run("lint-imports", "--no-cache", cwd=ROOT, PYTHONPATH=paths)
    assert "Contracts: 2 kept, 0 broken." in output


def test_help_is_shown_without_loading_the_large_libraries() -> None:
    """They are numpy, python-can and cffi. Without them the help is there in a twentieth of a second.

    The program runs in a process of its own, as this one has loaded them, and run() raises if it fails.
    """
    program = """
import sys
from mcp_asdf_tools.cli.main import main
main(["--help"])
assert "numpy" not in sys.modules
assert "can" not in sys.modules
assert "cffi" not in sys.modules
"""
    run(sys.executable, "-c", program, cwd=Path.cwd())


def test_every_name_that_the_library_lists_can_be_imported_from_it() -> None:
    """The list is ``__all__``, and the names are loaded when they are first used."""
    assert len(mcp_asdf_tools.__all__) > 10
    for name in mcp_asdf_tools.__all__:
        assert getattr(mcp_asdf_tools, name).__name__ == name


def first_line_of_docstring(package: str) -> str:
    """Return the first line of the docstring of a package of the tools."""
    docstring = import_module(f"mcp_asdf_tools.{package}").__doc__
    assert docstring is not None
    first_line, *_ = docstring.splitlines()
    return first_line


def test_the_page_about_the_architecture_lists_every_package_with_its_first_sentence() -> None:
    """A row of its table has a package, which it calls a room, and the first line of its docstring."""
    _before, _titles, rest = PAGE.partition("| room | what is in it |")
    table, *_paragraphs_below = rest.split("\n\n")
    sentences_by_package = dict(re.findall(r"^\| `(\w+)` \| (.*) \|$", table, re.MULTILINE))

    expected_sentences = {package: first_line_of_docstring(package) for package in PACKAGES}
    assert sentences_by_package == expected_sentences


def test_the_page_about_the_architecture_has_the_order_of_the_packages() -> None:
    """pyproject.toml states the same order, by which ``lint-imports`` checks imports.

    On the page ">" stands between the layers of packages, the highest of which is the first.
    """
    order = " > ".join(layers_of_packages())
    page_in_one_line = " ".join(PAGE.split())
    assert order in page_in_one_line


def test_the_order_of_the_packages_has_all_of_them() -> None:
    """Packages in one layer stand between bars, and do not import each other.

    The module ``library``, which is no package, has a place in the order, too.
    """
    names = re.findall(r"\w+", " ".join(layers_of_packages()))
    assert sorted(names) == sorted([*PACKAGES, "library"])


def layers_of_packages() -> list[str]:
    """Return the layers of the first contract for ``lint-imports``, the highest first."""
    settings = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["tool"]["importlinter"]
    first_contract, *_ = settings["contracts"]
    return list(first_contract["layers"])
