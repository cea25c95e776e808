"""Pictures of moving robots: their paths, and the network of one step."""

from __future__ import annotations

import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection
from matplotlib.colors import to_rgba
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Circle, Rectangle
from numpy.typing import NDArray

from mcp_asdf_tools.common import (
    FLAWED,
    INK,
    MEDIUM,
    OTHER,
    SMALL,
    WIDTH,
    UsageError,
    add_legend,
    empty_figure,
)
from mcp_asdf_tools.experiments.experiment import Experiment
from mcp_asdf_tools.world import Arena, ArenaSettings, Picture, make_arena

BODY_RADIUS = 0.0704
_RANGE = "#bbbbbb"
_MOST_POINTS = 2000
"""Of a path: more could not be distinguished."""


def trajectories(experiment: Experiment, trial: int, step: int) -> Figure:
    """The paths of all robots of a dynamic experiment up to a step, and where they are then.

    Raises UsageError if robots do not move or the step is none of the trial's.
    """
    arena = _arena_of(experiment, trial, step)
    start = arena.positions
    motion = arena.record(step)
    figure, axes = _empty_arena(arena.settings)
    every = np.linspace(0, step, min(step, _MOST_POINTS) + 1).astype(int)
    paths = np.concatenate([start[np.newaxis], motion.position])
    for robot in range(experiment.robots - 1, -1, -1):
        axes.add_collection(_fading(paths[every, robot], _colour(experiment, robot)))
    interval = _round_interval(step)
    moments = paths[interval:-1:interval].reshape(-1, 2)
    axes.plot(*moments.T, ".", color=INK, markersize=3)
    axes.plot(*start.T, "o", color="none", markeredgecolor=INK, markersize=4, markeredgewidth=0.8)
    _draw_robots(axes, experiment, arena)
    marks = [
        Line2D(
            [], [], linestyle="", color=INK, marker="o", markerfacecolor="none", markersize=4, label="start"
        ),
        Line2D(
            [],
            [],
            linestyle="",
            color=INK,
            marker=".",
            markersize=4,
            label=f"every {interval} steps; paths fade with age",
        ),
    ]
    _finish(figure, axes, f"{_words(experiment, trial)}, steps 0 to {step}", marks)
    return figure


def _fading(path: NDArray[np.float64], colour: str) -> LineCollection:
    """A path that is faint at its start."""
    pieces = np.stack([path[:-1], path[1:]], axis=1)
    strength = np.linspace(_FAINT, 1, len(pieces))
    return LineCollection(list(pieces), colors=[to_rgba(colour, alpha) for alpha in strength], linewidths=1.0)


_FAINT = 0.12


def _round_interval(steps: int) -> int:
    """A round number of steps, five to ten of which make a path."""
    unit = 10 ** int(np.log10(steps))
    return max(
        1, next(int(part * unit) for part in (0.1, 0.2, 0.5, 1.0) if steps / (part * unit) <= _MOST_MOMENTS)
    )


_MOST_MOMENTS = 10


def network(experiment: Experiment, trial: int, step: int) -> Figure:
    """The robots of a dynamic experiment after a step, and a line between any two that hear each other.

    Circles have half the range, so that they overlap where two are near enough to. Raises as
    ``trajectories``.
    """
    arena = _arena_of(experiment, trial, step)
    arena.step(step)
    figure, axes = _empty_arena(arena.settings)
    links = {(int(a), int(b)) for a, b in np.sort(arena.links.astype(int), axis=1)}
    blocked = sorted(_near(arena) - links)
    _draw_links(axes, arena, sorted(links), "-", 1.6)
    _draw_links(axes, arena, blocked, ":", 1.2)
    walls = axes.patches[0]
    for centre in arena.positions:
        ring = Circle(tuple(centre), arena.settings.radio_range / 2, fill=False, color=_RANGE, linewidth=0.7)
        axes.add_patch(ring).set_clip_path(walls)
    _draw_robots(axes, experiment, arena)
    marks = [
        Line2D([], [], color=INK, linewidth=1.6, label="hear each other"),
        Line2D(
            [],
            [],
            color=_RANGE,
            linewidth=0.9,
            label="half the range: overlap within reach",
        ),
    ]
    if blocked:
        marks.append(Line2D([], [], color=INK, linestyle=":", label="a third stands between"))
    _finish(figure, axes, f"{_words(experiment, trial)}, step {step}", marks)
    return figure


Pair = tuple[int, int]


def _near(arena: Arena) -> set[Pair]:
    """Pairs within range of each other."""
    apart = np.hypot(*(arena.positions[:, np.newaxis] - arena.positions).T)
    first, second = np.nonzero(np.triu(apart < arena.settings.radio_range, 1))
    return set(zip(first.tolist(), second.tolist(), strict=True))


def _draw_links(axes: Axes, arena: Arena, pairs: list[Pair], dash: str, width: float) -> None:
    ends = [arena.positions[list(pair)] for pair in pairs]
    axes.add_collection(LineCollection(ends, colors=INK, linewidths=width, linestyles=dash, zorder=2))


def _words(experiment: Experiment, trial: int) -> str:
    """What is shown."""
    return f"{experiment.robots} robots, {experiment.flawed} flawed, seed {experiment.seed}, trial {trial}"


def _arena_of(experiment: Experiment, trial: int, step: int) -> Arena:
    if not experiment.is_dynamic:
        raise UsageError("the robots of this experiment do not move; run one with topology dynamic")
    if not 0 <= trial < experiment.trials:
        raise UsageError(f"there is no trial {trial}; choose one of 0 .. {experiment.trials - 1}")
    if not 1 <= step <= experiment.steps:
        raise UsageError(f"there is no step {step}; choose one of 1 .. {experiment.steps}")
    return make_arena(experiment, trial)


def _empty_arena(settings: ArenaSettings) -> tuple[Figure, Axes]:
    """The walls, and the floor if it is a picture; tiles are too small to be seen."""
    across = 0.7 * WIDTH
    figure = empty_figure(across, across * settings.height / settings.width + 0.5)
    axes = figure.subplots()
    corner = (-settings.width / 2, -settings.height / 2)
    if isinstance(settings.floor, Picture):
        _draw_floor(axes, settings.floor.pixels, corner)
    axes.add_patch(Rectangle(corner, settings.width, settings.height, fill=False, color=INK, linewidth=1.2))
    axes.set_xlim(1.02 * corner[0], -1.02 * corner[0])
    axes.set_ylim(1.02 * corner[1], -1.02 * corner[1])
    axes.set_aspect("equal")
    for side in axes.spines.values():
        side.set_visible(False)
    return figure, axes


def _draw_floor(axes: Axes, pixels: NDArray[np.bool_], corner: tuple[float, float]) -> None:
    shades = np.where(pixels[..., np.newaxis], np.array([228, 228, 228]), 255).astype(np.uint8)
    extent = (corner[0], -corner[0], corner[1], -corner[1])
    axes.imshow(shades, extent=extent, interpolation="nearest", zorder=0)


def _draw_robots(axes: Axes, experiment: Experiment, arena: Arena) -> None:
    """Bodies at their size, and a line towards their heading."""
    for robot, (centre, heading) in enumerate(zip(arena.positions, arena.headings, strict=True)):
        colour = _colour(experiment, robot)
        axes.add_patch(
            Circle(tuple(centre), BODY_RADIUS, facecolor=colour, edgecolor=INK, linewidth=0.6, zorder=3)
        )
        axes.plot(
            *zip(centre, centre + BODY_RADIUS * heading, strict=True), color="white", linewidth=1.2, zorder=4
        )


def _colour(experiment: Experiment, robot: int) -> str:
    return FLAWED if robot < experiment.flawed else OTHER


def _finish(figure: Figure, axes: Axes, title: str, marks: list[Line2D]) -> None:
    axes.set_title(title, fontsize=MEDIUM)
    axes.set_xlabel("$x$ (m)", fontsize=MEDIUM)
    axes.set_ylabel("$y$ (m)", fontsize=MEDIUM)
    axes.tick_params(labelsize=SMALL)
    robots = [
        Line2D([], [], linestyle="", marker="o", color=colour, markeredgecolor=INK, label=name)
        for name, colour in (("flawed", FLAWED), ("healthy", OTHER))
    ]
    add_legend(figure, [*robots, *marks])
