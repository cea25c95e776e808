"""Style of all figures, and files of them: equal figures give equal bytes."""

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

_METADATA_BY_SUFFIX: dict[str, dict[str, None]] = {
    ".png": {},
    ".svg": {"Date": None},
    ".pdf": {"CreationDate": None},
}
"""Suffixes of pictures, and the metadata with a date, which matplotlib leaves out if they are None."""

_DOTS_PER_INCH = 150
"""Resolution of a picture in PNG."""


def check_plot_path(path: Path) -> Path:
    """Return the path of a picture unchanged. Raises UsageError if no picture can be written there."""
    _suffix_of_picture(path)  # raises UsageError for any other suffix
    check_target(path)
    return path


def _suffix_of_picture(path: Path) -> str:
    """Return the suffix of a picture in lower case. Raises UsageError if it is not one of a picture."""
    suffix = path.suffix.lower()
    if suffix not in _METADATA_BY_SUFFIX:
        suffixes = ", ".join(_METADATA_BY_SUFFIX)
        raise UsageError(f"cannot plot to {path.name}: choose a name that ends in {suffixes}")
    return suffix


def save_figure(figure: Figure, path: Path) -> None:
    """Write a figure to a file whose suffix gives the format. Raises UsageError if that fails."""
    write_atomically(check_plot_path(path), image_of(figure, path))


def image_of(figure: Figure, path: Path) -> bytes:
    """Return the bytes of a figure in the format that the suffix of ``path`` gives.

    Nothing is written. Raises UsageError if the suffix is not one of a picture.
    """
    image = io.BytesIO()
    suffix = _suffix_of_picture(path)
    # The salt is for the names inside an SVG file, which would otherwise be random.
    with rc_context({"svg.hashsalt": "mcp-asdf", "svg.fonttype": "path"}):
        figure.savefig(
            image,
            format=suffix.removeprefix("."),
            dpi=_DOTS_PER_INCH,
            metadata=_METADATA_BY_SUFFIX[suffix],
        )
    return image.getvalue()


# --- One style for all -----------------------------------------------------------------------------------

WIDTH = 9.0
"""Width in inches of a figure with several panels. It is always the same, so that all letters of a page with
several figures have the same size."""
SMALL = 8
"""Size in points of the letters at ticks, in legends and in captions."""
MEDIUM = 10
"""Size in points of the letters in titles and labels."""

COLOURS = (
    *("#0072b2", "#d55e00", "#009e73", "#cc79a7", "#e69f00", "#56b4e9", "#8a4f7d", "#222222"),
    *("#999999", "#f0e442", "#6a3d9a", "#7a5230"),
)
"""Colours of lines without a fixed colour. Colour-blind people can tell the first eight apart."""

INK = COLOURS[7]
"""Colour of true values."""

_LOW_TO_HIGH = LinearSegmentedColormap.from_list("low to high", ["#440154", "#31688e", "#35b779", "#d8c51c"])


def ordered_colours(count: int) -> list[str]:
    """Return this many colours from dark to light, for lines of values that have an order."""
    last_index = max(1, count - 1)  # at least 1, as a divisor: a single colour is the darkest
    # The map gives a colour for each number from 0, dark, to 1, light.
    return [to_hex(_LOW_TO_HIGH(index / last_index)) for index in range(count)]


class Drawing(Figure):
    """A figure that a notebook shows if it is the value of a cell."""

    def _repr_png_(self) -> bytes:
        """Return the bytes of the figure as PNG; notebooks call this."""
        return image_of(self, Path("cell.png"))


def empty_figure(width: float, height: float) -> Figure:
    """Return a new figure of a size in inches, which can be drawn without a display."""
    figure = Drawing(figsize=(width, height), layout="constrained")
    FigureCanvasAgg(figure)  # becomes the figure's canvas, and needs no display
    return figure


def style_panel(axes: Axes) -> None:
    """Style a panel: light horizontal lines to read values by, small letters, no frame above and right."""
    axes.grid(axis="y", color="#dddddd", linewidth=0.6)
    axes.set_axisbelow(True)
    axes.tick_params(labelsize=SMALL)
    for side in ("top", "right"):
        axes.spines[side].set_visible(False)


_MAX_LEGEND_COLUMNS = 6


def add_legend(figure: Figure, handles: Sequence[Artist]) -> None:
    """Add a legend above the panels, in as many columns as the figure's width has room for, at most six.

    A single column is taken even if it is too wide.
    """
    # The width of a legend is only known when it has been added: those that are too wide are removed again.
    for column_count in range(min(len(handles), _MAX_LEGEND_COLUMNS), 0, -1):
        legend = figure.legend(
            handles=handles, loc="outside upper center", ncols=column_count, frameon=False, fontsize=SMALL
        )
        if column_count == 1 or legend.get_window_extent().width < figure.bbox.width:
            return
        legend.remove()


_LETTERS_PER_INCH = 15.5
"""Number of small letters that fit into an inch of a line."""


def add_caption(figure: Figure, x_label: str, caption: str) -> None:
    """Add a caption below the panels, in lines that fit, and above it the label of their common x axis.

    ``x_label`` may be empty. With no-break spaces, a symbol and its value stay on one line.
    """
    text = caption.replace(" = ", "\N{NO-BREAK SPACE}=\N{NO-BREAK SPACE}")
    lines = textwrap.wrap(text, round(_LETTERS_PER_INCH * figure.get_figwidth()))
    if x_label:
        lines.insert(0, x_label)
    figure.supxlabel("\n".join(lines), fontsize=SMALL)


_LARGE_NUMBER = 1 << 16
"""Smallest power of two that is written as one."""


def format_for_legend(value: float | str) -> str:
    """Return a parameter's value as legends and titles show it: 0.5 as "0.5", 5.0 as "5", 65536 as "2^16".

    Whole numbers have all their digits, unless they are powers of two from 65536 on; other numbers have six
    significant ones at most. A text has spaces in place of underscores.
    """
    if isinstance(value, str):
        return value.replace("_", " ")
    if value != int(value):
        return f"{value:g}"
    integer = int(value)
    is_power_of_two = integer.bit_count() == 1
    if integer >= _LARGE_NUMBER and is_power_of_two:
        return f"2^{integer.bit_length() - 1}"
    return f"{integer}"
