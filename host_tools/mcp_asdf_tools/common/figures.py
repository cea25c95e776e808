"""Pictures as files: formats by suffix, whole or not at all, the same figure always the same bytes."""

from __future__ import annotations

import io
from pathlib import Path

from matplotlib import rc_context
from matplotlib.figure import Figure

from mcp_asdf_tools.common.errors import UsageError
from mcp_asdf_tools.common.files import check_target, write_atomically

_STAMPS: dict[str, dict[str, None]] = {".png": {}, ".svg": {"Date": None}, ".pdf": {"CreationDate": None}}
"""Formats, and what must be left out of them to keep the date away."""


def check_plot_path(path: Path) -> Path:
    """Return ``path``. Raises UsageError if no plot can be written there."""
    if path.suffix.lower() not in _STAMPS:
        raise UsageError(f"cannot plot to {path.name}: choose a name that ends in {', '.join(_STAMPS)}")
    check_target(path)
    return path


def save_figure(figure: Figure, path: Path) -> None:
    """Write a figure. Raises UsageError if that cannot be done."""
    write_atomically(path, image_of(figure, path))


def image_of(figure: Figure, path: Path) -> bytes:
    """What the file ``path`` of a figure has to hold. Raises UsageError if no plot can be written there."""
    image, suffix = io.BytesIO(), check_plot_path(path).suffix.lower()
    with rc_context({"svg.hashsalt": "mcp-asdf"}):
        figure.savefig(image, format=suffix[1:], dpi=150, metadata=_STAMPS[suffix])
    return image.getvalue()
