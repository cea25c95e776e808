"""Which version of this project runs."""

from __future__ import annotations

from importlib import metadata

PROGRAM = "mcp-asdf"
"""The distribution's name."""


def own_version() -> str:
    """The installed version of this project, or that it is not installed."""
    try:
        return metadata.version(PROGRAM)
    except metadata.PackageNotFoundError:
        return "not installed"
