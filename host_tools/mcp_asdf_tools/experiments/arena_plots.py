"""Pictures of moving robots: their paths, and the network of one step."""

from __future__ import annotations

import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Circle, Rectangle
from numpy.typing import NDArray

from mcp_asdf_tools.common import FLAWED, INK, OTHER, UsageError, empty_figure
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
    paths = np.concatenate([start[np.newaxis], motion.position])[every]
    for robot in range(experiment.robots - 1, -1, -1):
        axes.plot(*paths[:, robot].T, color=_colour(experiment, robot), linewidth=0.8, alpha=0.6)
    axes.plot(*start.T, "o", color="none", markeredgecolor=INK, markersize=3, markeredgewidth=0.7)
    _draw_robots(axes, experiment, arena)
    mark = Line2D(
        [], [], linestyle="", marker="o", color="none", markeredgecolor=INK, markersize=4, label="start"
    )
    _finish(figure, axes, f"trial {trial}, steps 0 to {step}", [mark])
    return figure


def network(experiment: Experiment, trial: int, step: int) -> Figure:
    """The robots of a dynamic experiment after a step, and a line between any two that hear each other.

    Raises as ``trajectories``.
    """
    arena = _arena_of(experiment, trial, step)
    arena.step(step)
    figure, axes = _empty_arena(arena.settings)
    ends = arena.positions[arena.links.astype(int)]
    axes.add_collection(LineCollection(list(ends), colors=INK, linewidths=1.4, zorder=2))
    walls = axes.patches[0]
    for centre in arena.positions:
        ring = Circle(tuple(centre), arena.settings.radio_range, fill=False, color=_RANGE, linewidth=0.5)
        axes.add_patch(ring).set_clip_path(walls)
    _draw_robots(axes, experiment, arena)
    marks = [
        Line2D([], [], color=INK, linewidth=1.4, label="hear each other"),
        Line2D([], [], color=_RANGE, linewidth=0.8, label="range"),
    ]
    _finish(figure, axes, f"trial {trial}, step {step}", marks)
    return figure


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
    figure = empty_figure(6.2, 6.2 * settings.height / settings.width + 0.5)
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
    axes.set_title(title, fontsize=10)
    axes.set_xlabel("$x$ (m)")
    axes.set_ylabel("$y$ (m)")
    robots = [
        Line2D([], [], linestyle="", marker="o", color=colour, markeredgecolor=INK, label=name)
        for name, colour in (("flawed", FLAWED), ("not flawed", OTHER))
    ]
    figure.legend(handles=[*robots, *marks], loc="outside lower center", ncols=4, frameon=False, fontsize=9)
