"""Which version of this project runs."""

from __future__ import annotations

from importlib import metadata


def own_version() -> str:
    """The installed version of this project, or that it is not installed."""
    try:
        return metadata.version("mcp-asdf")
    except metadata.PackageNotFoundError:
        return "not installed"
