"""Pictures as files: formats by suffix, whole or not at all, the same figure always the same bytes."""

from __future__ import annotations

import io
from pathlib import Path

from matplotlib import rc_context
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.colors import LinearSegmentedColormap
from matplotlib.figure import Figure

from mcp_asdf_tools.common.errors import UsageError
from mcp_asdf_tools.common.files import check_target, write_atomically

_STAMPS: dict[str, dict[str, None]] = {".png": {}, ".svg": {"Date": None}, ".pdf": {"CreationDate": None}}
"""Formats, and what must be left out of them to keep the date away."""


def check_plot_path(path: Path) -> Path:
    """Return ``path``. Raises UsageError if no plot can be written there."""
    _format_of(path)
    check_target(path)
    return path


def _format_of(path: Path) -> str:
    suffix = path.suffix.lower()
    if suffix not in _STAMPS:
        raise UsageError(f"cannot plot to {path.name}: choose a name that ends in {', '.join(_STAMPS)}")
    return suffix


def save_figure(figure: Figure, path: Path) -> None:
    """Write a figure. Raises UsageError if that cannot be done."""
    write_atomically(check_plot_path(path), image_of(figure, path))


def image_of(figure: Figure, path: Path, has_text: bool = False) -> bytes:
    """Content of the file ``path`` for a figure, an .svg with letters as shapes unless it ``has_text``.

    Raises UsageError if its name is not that of a picture.
    """
    image, suffix = io.BytesIO(), _format_of(path)
    with rc_context({"svg.hashsalt": "mcp-asdf", "svg.fonttype": "none" if has_text else "path"}):
        figure.savefig(image, format=suffix[1:], dpi=150, metadata=_STAMPS[suffix])
    return image.getvalue()


# The first eight stay apart for the colour-blind.
GREY = "#999999"


COLOURS = (
    *("#0072b2", "#d55e00", "#009e73", "#cc79a7", "#e69f00", "#56b4e9", "#8a4f7d", "#222222"),
    *(GREY, "#f0e442", "#6a3d9a", "#7a5230"),
)


FLAWED, OTHER, INK = COLOURS[1], COLOURS[0], COLOURS[7]

DIVERGING = LinearSegmentedColormap.from_list("below to above", [COLOURS[1], "#ffffff", COLOURS[0]])
"""Of differences: orange below 0, blue above."""


def empty_figure(width: float, height: float) -> Figure:
    """A figure of this size in inches, which needs no display."""
    figure = Figure(figsize=(width, height), layout="constrained")
    FigureCanvasAgg(figure)
    return figure


def clean(axes: Axes) -> None:
    """Light lines to read values by, and no frame."""
    axes.grid(axis="y", color="#dddddd", linewidth=0.6)
    axes.set_axisbelow(True)
    for side in ("top", "right"):
        axes.spines[side].set_visible(False)
