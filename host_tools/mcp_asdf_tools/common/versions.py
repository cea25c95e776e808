"""Which version of this project runs."""

from __future__ import annotations

from importlib import metadata

import can
import numpy as np

PROGRAM = "mcp-asdf"
"""The distribution's name."""


def own_version() -> str:
    """The installed version of this project, or that it is not installed."""
    try:
        return metadata.version(PROGRAM)
    except metadata.PackageNotFoundError:
        return "not installed"


def versions() -> dict[str, str]:
    """What the results of a run may depend on, by name."""
    return {"mcp-asdf": own_version(), "python-can": can.__version__, "numpy": np.__version__}
