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
    """``lint-imports`` checks the order of the packages, which pyproject.toml states in two contracts."""
    paths = os.pathsep.join(str(ROOT / folder) for folder in ("firmware_py", "host_tools"))
    output = run("lint-imports", "--no-cache", cwd=ROOT, PYTHONPATH=paths)
    assert "Contracts: 2 kept, 0 broken." in output


def test_help_is_shown_without_loading_the_large_libraries() -> None:
    """It takes a twentieth of a second, since numpy, python-can and cffi stay on the disk."""
    program = (
        "import sys; from mcp_asdf_tools.cli.main import main; main(['--help']); "
        "assert not {'numpy', 'can', 'cffi'} & set(sys.modules)"
    )
    run(sys.executable, "-c", program, cwd=Path.cwd())


def test_the_library_offers_what_it_says() -> None:
    assert len(mcp_asdf_tools.__all__) > 10
    for name in mcp_asdf_tools.__all__:
        assert getattr(mcp_asdf_tools, name).__name__ == name


def test_the_page_about_the_architecture_lists_every_package_with_its_first_sentence() -> None:
    """The first line of a package's docstring is its row in the page's table."""
    sentences = {}
    for package in PACKAGES:
        doc = import_module(f"mcp_asdf_tools.{package}").__doc__
        assert doc is not None
        sentences[package] = doc.splitlines()[0]

    table = PAGE.partition("| room | what is in it |")[2].partition("\n\n")[0]

    assert dict(re.findall(r"^\| `(\w+)` \| (.*) \|$", table, re.MULTILINE)) == sentences


def test_the_page_about_the_architecture_has_the_order_of_the_packages() -> None:
    """Which pyproject.toml states for ``lint-imports``; packages between bars do not import each other."""
    settings = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["tool"]["importlinter"]
    layers = settings["contracts"][0]["layers"]
    assert " > ".join(layers) in " ".join(PAGE.split())


def test_the_order_of_the_packages_has_all_of_them() -> None:
    settings = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["tool"]["importlinter"]
    layers = settings["contracts"][0]["layers"]
    names = [name.strip() for layer in layers for name in layer.split("|")]
    assert sorted(names) == sorted([*PACKAGES, "library"])
