"""Commands that install the project, and its extras: dependencies that only some commands need."""

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
}
"""The extra of ``pyproject.toml`` that installs a module, by the name of the module."""

# Nothing is published yet, so only a clone can be installed. A release changes these two, to "mcp-asdf" and
# "run"; docs/installing.md and docs/radio.md then have to follow, as tests/release/test_installing.py says.
PIP_TARGET = "."
PIP_PLACE = "in a clone of mcp-asdf run"


def install_command(extra: str = "") -> str:
    """Return the shell command that installs the project, with an extra unless ``extra`` is empty."""
    target = f"'{PIP_TARGET}[{extra}]'" if extra else PIP_TARGET
    return f"pip install {target}"


def install_instruction(extra: str = "") -> str:
    """Return the part of an error message that asks the user to install the project: where, and how."""
    return f"{PIP_PLACE}: {install_command(extra)}"


@contextmanager
def naming_extras() -> Iterator[None]:
    """Context manager, or decorator, that turns the failed import of an extra's module into a UsageError.

    The message says how to install the extra. Failed imports of other modules pass unchanged.
    """
    try:
        yield
    except ImportError as error:
        module = (error.name or "").partition(".")[0]
        if module not in EXTRAS:
            raise
        extra = EXTRAS[module]
        raise UsageError(
            f"this needs {module}, which is not installed; {install_instruction(extra)}"
        ) from error
