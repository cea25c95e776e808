"""Parts of the installation that only some commands need."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager

from mcp_asdf_tools.common.errors import UsageError

EXTRAS = {
    "jinja2": "study",
    "markdown_it": "study",
    "matplotlib": "study",
    "pyarrow": "study",
    "scipy": "study",
    "distributed": "cluster",
    "starlette": "view",
    "uvicorn": "view",
}
"""The extra of ``pyproject.toml`` that brings each module outside the base installation."""


@contextmanager
def naming_extras() -> Iterator[None]:
    """Raises UsageError, which names the extra, where one is missing; around code, or as a decorator."""
    try:
        yield
    except ImportError as error:
        module = (error.name or "").partition(".")[0]
        if module not in EXTRAS:
            raise
        extra = EXTRAS[module]
        raise UsageError(
            f"this needs {module}, which is not installed; run: pip install 'mcp-asdf[{extra}]'"
        ) from error
