"""A film as an animated picture, for READMEs and slides."""

from __future__ import annotations

import io
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import cast

import numpy as np
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.collections import EllipseCollection, LineCollection
from matplotlib.colors import LinearSegmentedColormap
from matplotlib.figure import Figure
from matplotlib.patches import Rectangle
from numpy.typing import NDArray
from PIL import Image

from mcp_asdf_tools.common import FLAWED, GREY, INK, OTHER, UsageError, check_target, clean, empty_figure
from mcp_asdf_tools.view.film import Film

SUFFIXES = (".webp", ".gif")
_PICTURES, _PICTURES_PER_SECOND = 150, 15
_LAST_PICTURE_SECONDS = 2.0
_DOTS_PER_INCH = 100
_GIF_COLOURS = 64
_MOST_PIXELS = 200
"""Of a floor, along a side: smaller ones are seen as grey, and cost more than all else."""
_MOST_WRONG = 0.4
"""|b_hat - b| from which on a robot has the last colour."""
_COLOURS = LinearSegmentedColormap.from_list("wrongness", [OTHER, "#a9a9a9", FLAWED])
_PANELS = (("b_hat", r"assumed accuracy $\hat{b}$"), ("x", "informed estimate $x$"))

Show = Callable[[int], None]
"""Moves everything to a sample."""


def check_animation_path(path: Path) -> Path:
    """Return ``path``. Raises UsageError if no animation can be written there."""
    if path.suffix.lower() not in SUFFIXES:
        raise UsageError(f"cannot animate to {path.name}: choose a name that ends in {', '.join(SUFFIXES)}")
    check_target(path)
    return path


def image_of_film(film: Film, path: Path) -> bytes:
    """Content of the animation ``path``; the same film gives the same bytes. O(pictures)."""
    pictures = list(_pictures(film))
    durations = [1000 // _PICTURES_PER_SECOND] * (len(pictures) - 1) + [int(1000 * _LAST_PICTURE_SECONDS)]
    sink, kind = io.BytesIO(), check_animation_path(path).suffix.lower()[1:]
    first, *others = _with_few_colours(pictures) if kind == "gif" else pictures
    first.save(sink, kind, save_all=True, append_images=others, duration=durations, loop=0, quality=70)
    return sink.getvalue()


def _with_few_colours(pictures: list[Image.Image]) -> list[Image.Image]:
    """Pictures of one palette and without dithering, so that of each only what has moved is stored."""
    palette = pictures[len(pictures) // 2].quantize(_GIF_COLOURS)
    return [each.quantize(palette=palette, dither=Image.Dither.NONE) for each in pictures]


def _pictures(film: Film) -> Iterator[Image.Image]:
    """Pictures of which the parts that stand still are drawn once."""
    figure = empty_figure(9.6, 4.8)
    figure.set_dpi(_DOTS_PER_INCH)
    moving, shows = _draw(figure, film)
    for artist in moving:
        artist.set_animated(True)
    canvas = cast(FigureCanvasAgg, figure.canvas)
    canvas.draw()  # type: ignore[no-untyped-call]
    background = canvas.copy_from_bbox(figure.bbox)  # type: ignore[no-untyped-call]
    count = len(film.samples.ticks)
    for sample in np.linspace(0, count - 1, min(_PICTURES, count)).astype(int).tolist():
        for show in shows:
            show(sample)
        canvas.restore_region(background)  # type: ignore[no-untyped-call]
        for artist in moving:
            figure.draw_artist(artist)
        yield Image.fromarray(_pixels(canvas))


def _draw(figure: Figure, film: Film) -> tuple[list[Artist], list[Show]]:
    """Draw all that stands still; returns what moves, and what moves it."""
    grid = figure.add_gridspec(len(_PANELS), 2, width_ratios=(1, 1.15))
    arena = figure.add_subplot(grid[:, 0])
    moving, show = _draw_arena(arena, film)
    shows = [show]
    for row, (name, label) in enumerate(_PANELS):
        axes = figure.add_subplot(grid[row, 1])
        artists, show = _draw_chart(axes, film, name, label)
        axes.tick_params(labelbottom=row == len(_PANELS) - 1)
        moving += artists
        shows.append(show)
    axes.set_xlabel("step")
    figure.suptitle(film.stage.title, x=0.02, ha="left", fontsize=10, color=INK)
    return moving, shows


def _pixels(canvas: FigureCanvasAgg) -> NDArray[np.uint8]:
    pixels: NDArray[np.uint8] = np.asarray(canvas.buffer_rgba())  # type: ignore[no-untyped-call]
    return pixels[..., :3].copy()


# --- The arena -------------------------------------------------------------------------------------------


def _draw_arena(axes: Axes, film: Film) -> tuple[list[Artist], Show]:
    stage = film.stage
    width, height = stage.sides or (2.6, 2.6)
    axes.set_xlim(-width / 2, width / 2)
    axes.set_ylim(-height / 2, height / 2)
    axes.set_aspect("equal")
    axes.set_xticks([])
    axes.set_yticks([])
    for side in axes.spines.values():
        side.set_visible(stage.sides is not None)
    if stage.floor is not None and max(stage.floor.shape) <= _MOST_PIXELS:
        shades = np.where(stage.floor[..., np.newaxis], np.array([232, 235, 239]), 255).astype(np.uint8)
        axes.imshow(shades, extent=(-width / 2, width / 2, -height / 2, height / 2), zorder=0)
    places, size = _places(film), 0.032 * width
    links = LineCollection([], colors=GREY, linewidths=1.0, alpha=0.25 if stage.sides is None else 0.9)
    robots = _discs(axes, film, size)
    moving: list[Artist] = [links, robots]
    rings = None if stage.radio_range is None else _discs(axes, film, 2 * stage.radio_range)
    axes.add_collection(links)

    def show(sample: int) -> None:
        links.set_segments([places[sample, list(pair)] for pair in _pairs(film, sample)])
        colours = [tuple(each) for each in _COLOURS(_wrongness(film, sample) / _MOST_WRONG).tolist()]
        robots.set_offsets(places[sample])
        robots.set_facecolor(colours)
        if rings is not None:
            rings.set_offsets(places[sample])
            rings.set_facecolor([(*colour[:3], 0.07) for colour in colours])

    return ([] if rings is None else [rings]) + moving, show


def _discs(axes: Axes, film: Film, diameter: float) -> EllipseCollection:
    """A disc for each robot, in metres; those flawed at the start have a dark edge where it can be seen."""
    stage = film.stage
    is_body = diameter != 2 * (stage.radio_range or 0)
    edges = [INK if place in stage.flawed else "white" for place in range(len(stage.robots))]
    sizes = np.full(len(stage.robots), diameter)
    discs = EllipseCollection(
        sizes,
        sizes,
        np.zeros(len(sizes)),
        units="x",
        offsets=np.zeros((len(sizes), 2)),
        offset_transform=axes.transData,
        linewidths=1.3 if is_body else 0.0,
        edgecolors=edges if is_body else "none",
    )
    axes.add_collection(discs)
    return discs


def _places(film: Film) -> NDArray[np.float64]:
    """Centres of the robots, shape (samples, N, 2); robots that do not move stand in a circle."""
    if film.samples.positions is not None:
        return film.samples.positions
    angles = np.linspace(0, 2 * np.pi, len(film.stage.robots), endpoint=False)
    circle = np.column_stack([np.sin(angles), np.cos(angles)])
    return np.broadcast_to(circle, (len(film.samples.ticks), *circle.shape))


def _pairs(film: Film, sample: int) -> NDArray[np.int64]:
    """Pairs of robots of which one hears the other."""
    hears = film.samples.hears[sample]
    return np.argwhere(np.triu(hears | hears.T))


def _wrongness(film: Film, sample: int) -> NDArray[np.float64]:
    """|b_hat - b| of each robot; half of the scale where it is unknown."""
    samples = film.samples
    values = np.abs(samples.quantity("b_hat")[sample] - samples.quantity("b")[sample])
    return np.where(np.isnan(values), _MOST_WRONG / 2, values)


# --- The charts ------------------------------------------------------------------------------------------


def _draw_chart(axes: Axes, film: Film, name: str, label: str) -> tuple[list[Artist], Show]:
    """All of the series; a veil over what is still to come moves."""
    ticks, values = film.samples.ticks, film.samples.quantity(name)
    for place in range(values.shape[1]):
        colour = FLAWED if place in film.stage.flawed else OTHER
        axes.plot(ticks, values[:, place], color=colour, linewidth=0.8, alpha=0.7)
    truth = film.samples.quantity("b")[:, 0] if name == "b_hat" else film.stage.fill_ratio
    if truth is not None:
        axes.plot(ticks, np.broadcast_to(truth, ticks.shape), "--", color=INK, linewidth=1.2)
    clean(axes)
    axes.set_title(label, fontsize=9, loc="left", pad=3)
    axes.set_xlim(ticks[0], max(ticks[-1], ticks[0] + 1))
    axes.set_ylim(*_limits(values))
    low, high = axes.get_ylim()
    veil = Rectangle((0, low), 0, high - low, facecolor="white", alpha=0.86, zorder=3)
    axes.add_patch(veil)
    now = axes.axvline(ticks[0], color="#009e73", linewidth=1.5, zorder=4)

    def show(sample: int) -> None:
        tick = float(ticks[sample])
        veil.set_bounds(tick, low, float(ticks[-1]) - tick, high - low)
        now.set_xdata([tick, tick])

    return [veil, now], show


def _limits(values: NDArray[np.float64]) -> tuple[float, float]:
    """Room for all but the first moments, when estimates still jump between 0 and 1."""
    settled = values[len(values) // 25 :]
    low, high = float(np.nanmin(settled)), float(np.nanmax(settled))
    margin = max(0.06 * (high - low), 0.01)
    return low - margin, high + margin
