"""Descriptions of emulated runs: what the page shows that stays the same during a run."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from mcp_asdf_tools.common.parameters import parameters_of
from mcp_asdf_tools.experiments.experiment import Experiment
from mcp_asdf_tools.experiments.trials import run_trials
from mcp_asdf_tools.robots.population import Population
from mcp_asdf_tools.swarm.settings import SwarmSettings
from mcp_asdf_tools.view.history import RunDescription, steps_between_states
from mcp_asdf_tools.world.arena import Arena
from mcp_asdf_tools.world.floor_code import make_floor_code

_MAX_FLOOR_PIXELS = 800
"""Pixels along a side of the floor: more than a page shows."""
_MAX_ERROR_POINTS = 480
"""Points of the chart's line of the errors without a filter."""
_MAX_UNFILTERED_ROBOT_STEPS = 20_000_000
"""Robots times steps of a run that is computed only for that line: it takes a second or two."""


def describe_swarm(settings: SwarmSettings) -> RunDescription:
    """Return the description of a swarm's run on an emulated bus, which is trial 0 of its world.

    If the swarm has neither faults nor refused ids, the description has the errors without a filter. They
    come from another run, which is computed here. That run has no faults and refuses no ids, so it would be
    no fair comparison for other swarms. Raises UsageError if the arena cannot be made.
    """
    faults = tuple((str(fault), fault.start, fault.stop) for fault in settings.faults)
    description = replace(_describe_emulated_run(settings, trial=0), faults=faults)
    if settings.faults or settings.allow:
        return description
    return replace(description, unfiltered_errors=_compute_unfiltered_errors(settings, trial=0))


def describe_trial(experiment: Experiment, trial: int) -> RunDescription:
    """Return the description of an experiment's trial, with the errors without a filter.

    These errors come from another run, which is computed here. Raises UsageError if the arena cannot be made.
    """
    description = _describe_emulated_run(experiment, trial)
    return replace(description, unfiltered_errors=_compute_unfiltered_errors(experiment, trial))


def _describe_emulated_run(settings: Population, trial: int) -> RunDescription:
    """Return the description of a run; its faults and the errors without a filter are still missing.

    With robots that move, the floor is computed, too. Raises UsageError if the arena cannot be made.
    """
    description = describe_population(settings, _format_title(settings, trial))
    if not settings.is_dynamic:
        return description
    floor = draw_floor(Arena(settings, trial))
    return replace(description, sides=settings.sides, radio_range=settings.radio_range, floor=floor)


def describe_population(settings: Population, title: str) -> RunDescription:
    """Return a description with what the parameters alone say: robots, filter, fill ratio and steps."""
    return RunDescription(
        title=title,
        robots=list(range(settings.robots)),
        flawed=range(settings.flawed),
        fill_ratio=settings.fill_ratio,
        steps=settings.steps,
        steps_per_second=settings.steps_per_second,
        filter=settings.filter,
        filter_term=settings.swarm_filter.typeset_term,
    )


def _compute_unfiltered_errors(settings: Population, trial: int) -> list[float]:
    """Run a trial without a filter, and return the mean error of its robots as the run goes on.

    The error of a robot is the distance of its informed estimate x from the fill ratio f. The list is empty
    if the robots have no filter anyway, or if the trial would take more than about two seconds, or cannot be
    run by the fast engine in C.
    """
    robot_steps = settings.robots * settings.steps
    if not settings.swarm_filter.is_on or robot_steps > _MAX_UNFILTERED_ROBOT_STEPS:
        return []
    experiment = _remove_filter(settings)
    if experiment.parameter_lacking_in_c:
        return []
    sampling_interval = steps_between_states(settings.steps, settings.robots)
    trials = run_trials(experiment, first=trial, trials=1, sampling_interval=sampling_interval)
    (estimates,) = trials.records["x"]  # those of the only trial, shape (samples, N)
    errors = abs(estimates - settings.fill_ratio)
    robot_axis = 1
    return _average_parts(errors.mean(axis=robot_axis))


def _remove_filter(settings: Population) -> Experiment:
    """Return an experiment with the parameters of ``settings``, but without a filter."""
    # ``settings`` may have more parameters than an experiment takes.
    parameters = {name: getattr(settings, name) for name in parameters_of(Population)}
    parameters["filter"] = "none"
    return Experiment(**parameters)


def _average_parts(values: NDArray[np.float64]) -> list[float]:
    """Cut a series into up to _MAX_ERROR_POINTS parts of nearly equal length, and return their means."""
    part_count = min(_MAX_ERROR_POINTS, len(values))
    parts = np.array_split(values, part_count)
    return [round(float(part.mean()), 5) for part in parts]


def draw_floor(arena: Arena) -> NDArray[np.bool_]:
    """Return the floor as pixels, True where it is black, the first row in the north. O(pixels).

    Every tile is one pixel. A side with more than _MAX_FLOOR_PIXELS tiles is drawn with that many pixels. A
    floor of the kind "code" has a pixel for each module of its pattern.
    """
    settings = arena.settings
    if settings.floor == "code":
        return make_floor_code(settings.fill_ratio)
    width, height = settings.sides
    columns = min(math.ceil(width / settings.tile), _MAX_FLOOR_PIXELS)
    rows = min(math.ceil(height / settings.tile), _MAX_FLOOR_PIXELS)
    return arena.pixels(columns, rows)


def _format_title(settings: Population, trial: int) -> str:
    """Return the run's main parameters as a title: "7 robots, 4 flawed, no filter, dynamic, seed 3".

    It has the filter's period if there is a filter, and the number of a trial other than 0.
    """
    title_parts = [
        f"{settings.robots} robots",
        f"{settings.flawed} flawed",
        settings.swarm_filter.typeset_term,
    ]
    if settings.swarm_filter.is_on:
        title_parts.append(f"\N{GREEK SMALL LETTER TAU} = {settings.filter_period}")
    title_parts.append(str(settings.topology).replace("-", " "))
    title_parts.append(f"seed {settings.seed}")
    if trial != 0:
        title_parts.append(f"trial {trial}")
    return ", ".join(title_parts)
