"""The house: imports run down through the rooms, and the page about it is right."""

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
ROOMS = [path.parent.name for path in matching_files(TOOLS, "*/__init__.py")]
PAGE = (ROOT / "docs/internals/architecture.md").read_text(encoding="utf-8")


def test_imports_run_down_through_the_rooms() -> None:
    paths = os.pathsep.join(str(ROOT / folder) for folder in ("firmware_py", "host_tools"))
    output = run("lint-imports", "--no-cache", cwd=ROOT, PYTHONPATH=paths)
    assert "Contracts: 2 kept, 0 broken." in output


def test_the_overview_loads_no_library_of_a_command() -> None:
    """It takes a twentieth of a second, since numpy, python-can and rich stay on the disk."""
    code = (
        "import sys; from mcp_asdf_tools.cli.main import main; main(['--help']); "
        "assert not {'numpy', 'can', 'cffi'} & set(sys.modules)"
    )
    run(sys.executable, "-c", code, cwd=Path.cwd())


def test_the_library_offers_what_it_says() -> None:
    assert len(mcp_asdf_tools.__all__) > 10
    for name in mcp_asdf_tools.__all__:
        assert getattr(mcp_asdf_tools, name).__name__ == name


def test_the_page_has_every_room_with_its_sentence() -> None:
    sentences = {}
    for room in ROOMS:
        doc = import_module(f"mcp_asdf_tools.{room}").__doc__
        assert doc is not None
        sentences[room] = doc.splitlines()[0]
    table = PAGE.partition("| room | what is in it |")[2].partition("\n\n")[0]
    assert dict(re.findall(r"^\| `(\w+)` \| (.*) \|$", table, re.MULTILINE)) == sentences


def test_the_page_has_the_contract() -> None:
    settings = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["tool"]["importlinter"]
    layers = settings["contracts"][0]["layers"]
    assert sorted("|".join(layers).replace(" ", "").split("|")) == sorted([*ROOMS, "library"])
    assert " > ".join(layers) in " ".join(PAGE.split())
