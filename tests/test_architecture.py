"""The house: imports run down through the rooms, by their faces alone, and the page about it is right."""

from __future__ import annotations

import ast
import os
import tomllib
from functools import cache
from importlib import import_module
from pathlib import Path

import pytest

from support import ROOT, run

TOOLS = ROOT / "host_tools/mcp_asdf_tools"
ROOMS = sorted(path.parent.name for path in TOOLS.glob("*/__init__.py"))
PAGE = (ROOT / "docs/architecture.md").read_text(encoding="utf-8")


def room_of(path: Path) -> str:
    return path.relative_to(TOOLS).parts[0]


@cache
def imports_of(path: Path) -> list[tuple[str, str]]:
    """Module and name of every ``from module import name`` in a file."""
    found = list[tuple[str, str]]()
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.ImportFrom) and node.module:
            found += [(node.module, alias.name) for alias in node.names]
        assert not isinstance(node, ast.Import) or not any(
            alias.name.startswith("mcp_asdf_tools") for alias in node.names
        ), f"{path}: import names from a room's face"
    return found


def test_imports_run_down_through_the_rooms() -> None:
    paths = os.pathsep.join(str(ROOT / folder) for folder in ("firmware_py", "host_tools"))
    run("lint-imports", "--no-cache", cwd=ROOT, PYTHONPATH=paths)


def test_no_room_reaches_past_the_face_of_another() -> None:
    past = [
        f"{path.relative_to(ROOT)}: {module}"
        for path in TOOLS.rglob("*.py")
        for module, _ in imports_of(path)
        if module.count(".") > 1 and module.startswith("mcp_asdf_tools.") and path.parent != TOOLS
        if module.split(".")[1] != room_of(path)
    ]
    assert past == []


@pytest.mark.parametrize("room", [room for room in ROOMS if room != "cli"])
def test_a_face_names_what_others_use_and_nothing_else(room: str) -> None:
    module = import_module(f"mcp_asdf_tools.{room}")
    offered = {name for name in module.__all__ if getattr(module, name) is not None}
    used = {
        name
        for path in TOOLS.rglob("*.py")
        for source, name in imports_of(path)
        if source == f"mcp_asdf_tools.{room}" and room_of(path) != room
    }
    assert used <= offered


def test_the_page_has_every_room_with_its_sentence() -> None:
    for room in ROOMS:
        doc = import_module(f"mcp_asdf_tools.{room}").__doc__
        assert doc is not None
        assert f"| `{room}` | {doc.splitlines()[0]} |" in PAGE


def test_the_page_has_the_contract() -> None:
    settings = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["tool"]["importlinter"]
    layers = settings["contracts"][0]["layers"]
    assert " > ".join(layers) in " ".join(PAGE.split())
