"""Which version of this project runs."""

from __future__ import annotations

import platform
from functools import cache
from importlib import metadata


def own_version() -> str:
    """Return the installed version of this project."""
    return metadata.version("mcp-asdf")


def software_versions() -> dict[str, str]:
    """Return the versions of the software that results may depend on, by name."""
    return {name: _version(name) for name in ("mcp-asdf", "numpy", "python-can")} | {
        "python": platform.python_version()
    }


@cache
def _version(name: str) -> str:
    return metadata.version(name)
