"""Figures: their common style, and files of them, in which equal figures give equal bytes."""

from __future__ import annotations

import io
import textwrap
from collections.abc import Sequence
from pathlib import Path

from matplotlib import rc_context
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.colors import LinearSegmentedColormap, to_hex
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
    """Return the suffix of a picture's file, in lower case. Raises UsageError for any other suffix."""
    suffix = path.suffix.lower()
    if suffix not in _STAMPS:
        raise UsageError(f"cannot plot to {path.name}: choose a name that ends in {', '.join(_STAMPS)}")
    return suffix


def save_figure(figure: Figure, path: Path) -> None:
    """Write a figure. Raises UsageError if that cannot be done."""
    write_atomically(check_plot_path(path), image_of(figure, path))


def image_of(figure: Figure, path: Path) -> bytes:
    """Return the content of the file ``path`` for a figure.

    Raises UsageError if its name is not that of a picture.
    """
    image, suffix = io.BytesIO(), _format_of(path)
    with rc_context({"svg.hashsalt": "mcp-asdf", "svg.fonttype": "path"}):
        figure.savefig(image, format=suffix[1:], dpi=150, metadata=_STAMPS[suffix])
    return image.getvalue()


# --- One style for all -----------------------------------------------------------------------------------

WIDTH = 9.0
"""Inches of a figure with several panels, so that letters are of one size on a page."""
SMALL, MEDIUM = 8, 10
"""Sizes of letters: of ticks, legends and captions; of titles and labels."""

COLOURS = (
    *("#0072b2", "#d55e00", "#009e73", "#cc79a7", "#e69f00", "#56b4e9", "#8a4f7d", "#222222"),
    *("#999999", "#f0e442", "#6a3d9a", "#7a5230"),
)
"""For what has no colour of its own; the first eight stay apart for the colour-blind."""

FLAWED, OTHER, INK = COLOURS[1], COLOURS[0], COLOURS[7]
"""Flawed robots, healthy ones, the truth."""

_LOW_TO_HIGH = LinearSegmentedColormap.from_list("low to high", ["#440154", "#31688e", "#35b779", "#d8c51c"])


def ordered_colours(count: int) -> list[str]:
    """Return colours from dark to light for values in order."""
    return [to_hex(_LOW_TO_HIGH(index / max(1, count - 1))) for index in range(count)]


class Drawing(Figure):
    """A figure that the last line of a notebook's cell shows."""

    def _repr_png_(self) -> bytes:
        """What a notebook asks for."""
        return image_of(self, Path("cell.png"))


def empty_figure(width: float, height: float) -> Figure:
    """Return a figure of this size in inches, which needs no display."""
    figure = Drawing(figsize=(width, height), layout="constrained")
    FigureCanvasAgg(figure)
    return figure


def clean(axes: Axes) -> None:
    """Give a panel light lines to read values by, small letters, and no frame."""
    axes.grid(axis="y", color="#dddddd", linewidth=0.6)
    axes.set_axisbelow(True)
    axes.tick_params(labelsize=SMALL)
    for side in ("top", "right"):
        axes.spines[side].set_visible(False)


_MOST_COLUMNS = 6


def add_legend(figure: Figure, handles: Sequence[Artist]) -> None:
    """Add a legend above the panels, in as many columns as the figure's width has room for."""
    for columns in range(min(len(handles), _MOST_COLUMNS), 0, -1):
        legend = figure.legend(
            handles=handles, loc="outside upper center", ncols=columns, frameon=False, fontsize=SMALL
        )
        if columns == 1 or legend.get_window_extent().width < figure.bbox.width:
            return
        legend.remove()


def add_caption(figure: Figure, axis: str, words: str) -> None:
    """Add the name of the common x axis, if any, and below it what a reader of the figure has to know."""
    # A symbol and its value stay on one line.
    text = words.replace(" = ", "\N{NO-BREAK SPACE}=\N{NO-BREAK SPACE}")
    lines = textwrap.wrap(text, round(_LETTERS_PER_INCH * figure.get_figwidth()))
    if axis:
        lines.insert(0, axis)
    figure.supxlabel("\n".join(lines), fontsize=SMALL)


_LETTERS_PER_INCH = 15.5


def number_in_words(value: float | str) -> str:
    """Return a value for a legend or title: whole numbers in full, large powers of two as such."""
    if isinstance(value, str):
        return value.replace("_", " ")
    if value != int(value):
        return f"{value:g}"
    integer = int(value)
    is_power_of_two = integer & (integer - 1) == 0
    if integer >= _LARGE and is_power_of_two:
        return f"2^{integer.bit_length() - 1}"
    return f"{integer}"


_LARGE = 1 << 16
