"""Pictures as files: formats by suffix, whole or not at all, the same figure always the same bytes."""

from __future__ import annotations

import io
from pathlib import Path

from matplotlib import rc_context
from matplotlib.figure import Figure

from host_tools.errors import UsageError
from host_tools.files import write_atomically

_STAMPS: dict[str, dict[str, None]] = {".png": {}, ".svg": {"Date": None}, ".pdf": {"CreationDate": None}}
"""Formats, and what must be left out of them to keep the date away."""


def check_plot_path(path: Path) -> Path:
    """Return ``path``. Raises UsageError if no plot can be written there."""
    if path.suffix.lower() not in _STAMPS:
        raise UsageError(f"cannot plot to {path.name}: choose a name that ends in {', '.join(_STAMPS)}")
    if not path.resolve().parent.is_dir():
        raise UsageError(f"cannot plot to {path}: its folder does not exist; make it first")
    return path


def save_figure(figure: Figure, path: Path) -> None:
    """Write a figure. Raises UsageError if that cannot be done."""
    image, suffix = io.BytesIO(), check_plot_path(path).suffix.lower()
    with rc_context({"svg.hashsalt": "mcp-asdf"}):
        figure.savefig(image, format=suffix[1:], dpi=150, metadata=_STAMPS[suffix])
    write_atomically(path, image.getvalue())
