"""Parts of the installation that only some commands need."""

from __future__ import annotations

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


def missing_extra(error: ImportError) -> UsageError | None:
    """The error that names the extra to install; None if no extra has the module that is missing."""
    module = (error.name or "").partition(".")[0]
    extra = EXTRAS.get(module)
    if extra is None:
        return None
    return UsageError(f"this needs {module}, which is not installed; run: pip install 'mcp-asdf[{extra}]'")
