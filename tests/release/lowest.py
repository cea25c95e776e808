"""Install the lowest versions that ``pyproject.toml`` allows in build/lowest, and run the Python tests.

Run as ``python -m release.lowest [PYTEST ARGUMENT...]`` with ``tests`` on PYTHONPATH. uv chooses the versions
(``lowest-direct``) and the oldest Python that the project allows.
"""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
import tomllib
from pathlib import Path

from support import PATH, ROOT

FOLDER = ROOT / "build/lowest"
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))
TESTED = ("tests/firmware_py", "tests/host_tools")
TOOLS = ("hypothesis", "pytest", "pytest-timeout", "pytest-xdist", "pycparser", "cantools")
"""Packages that these tests need beside the project, in any version."""


def requirements() -> list[str]:
    """Requirements of the project to be built and run, all its extras included, as it states them."""
    project = PROJECT["project"]
    extras = project.get("optional-dependencies", {}).values()
    every = {
        *PROJECT["build-system"]["requires"],
        *project["dependencies"],
        *(one for e in extras for one in e),
    }
    return sorted(each for each in every if not each.startswith("mcp-asdf"))


def call(*command: str | Path, **environment: str) -> None:
    """Run a command, whose output goes to the screen; ends the program with its code if it fails."""
    given = {**os.environ, "PATH": PATH, **environment}
    code = subprocess.run(command, cwd=ROOT, env=given, check=False, timeout=3600).returncode
    if code:
        sys.exit(code)


def main(arguments: list[str]) -> None:
    """Install and test. Old libraries may warn of what newer Pythons will drop: that is no failure here."""
    shutil.rmtree(FOLDER, ignore_errors=True)
    FOLDER.mkdir(parents=True)
    stated, chosen, python = FOLDER / "stated.txt", FOLDER / "versions.txt", FOLDER / "venv/bin/python"
    stated.write_text("".join(f"{each}\n" for each in requirements()), encoding="utf-8")
    oldest = PROJECT["project"]["requires-python"].removeprefix(">=")
    found = shutil.which(f"python{oldest}") or sys.executable
    call("uv", "venv", "--quiet", "--python", found, FOLDER / "venv")
    lowest = ("--quiet", "--resolution", "lowest-direct", "--no-annotate", "--no-header")
    call("uv", "pip", "compile", *lowest, "--python", python, "--output-file", chosen, stated)
    into = ("uv", "pip", "install", "--quiet", "--python", python)
    call(*into, "--requirement", chosen, "--constraint", chosen, *TOOLS, "pip", "cmake", "ninja")
    path = os.pathsep.join([str(python.parent), PATH])
    call(*into, "--no-deps", "--no-build-isolation", "--editable", ROOT, PATH=path)
    print(chosen.read_text(encoding="utf-8"), end="", flush=True)
    options = ("-q", "-m", "not slow", "-W", "default", "--numprocesses=auto", "--dist=worksteal")
    call(python, "-m", "pytest", *options, *(arguments or TESTED), PATH=path)


if __name__ == "__main__":
    main(sys.argv[1:])
