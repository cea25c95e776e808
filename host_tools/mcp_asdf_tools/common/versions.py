"""Versions of this project and of the software that it uses, for results and reports."""

from __future__ import annotations

import platform
from functools import cache
from importlib import metadata


def own_version() -> str:
    """Return the version of this project that is installed."""
    return _version("mcp-asdf")


def software_versions() -> dict[str, str]:
    """Return the versions of what results may depend on, by name: this project, NumPy, python-can, Python."""
    versions = {name: _version(name) for name in ("mcp-asdf", "numpy", "python-can")}
    versions["python"] = platform.python_version()
    return versions


@cache
def _version(name: str) -> str:
    """Return the installed version of a distribution. To look it up takes some milliseconds."""
    return metadata.version(name)
