"""Which version of this project runs."""

from __future__ import annotations

import platform
from importlib import metadata


def own_version() -> str:
    """The installed version of this project."""
    return metadata.version("mcp-asdf")


def software_versions() -> dict[str, str]:
    """Versions of the software that results may depend on, by name."""
    versions = {name: metadata.version(name) for name in ("mcp-asdf", "numpy", "python-can")}
    return versions | {"python": platform.python_version()}
