"""Which version of this project runs."""

from __future__ import annotations

import platform
from importlib import metadata

PROGRAM = "mcp-asdf"
"""The distribution's name."""


def own_version() -> str:
    """The installed version of this project, or that it is not installed."""
    try:
        return metadata.version(PROGRAM)
    except metadata.PackageNotFoundError:
        return "not installed"


def software_versions() -> dict[str, str]:
    """Versions of the software that results may depend on, by name."""
    return {
        "mcp-asdf": own_version(),
        "numpy": metadata.version("numpy"),
        "python": platform.python_version(),
        "python-can": metadata.version("python-can"),
    }
