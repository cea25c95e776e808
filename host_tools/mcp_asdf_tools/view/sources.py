"""Films of runs that are over: trials of an experiment, and logs of a bus with their input_log.

A recording need not hold positions, floor and truth: they follow from its parameters, and are computed again.
"""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mcp_asdf.robot import Robot
from mcp_asdf_tools.common import UsageError
from mcp_asdf_tools.experiments import Trials, run_trials
from mcp_asdf_tools.recording import InputLogHeader, InputLogReader, input_log_path, rerun
from mcp_asdf_tools.robots import Population, parameter_names
from mcp_asdf_tools.view.film import MAX_SAMPLES, QUANTITIES, Film, Samples, Stage
from mcp_asdf_tools.view.stage import stage_of
from mcp_asdf_tools.world import World, WorldSettings

_STEPS_AT_ONCE = 512
_MOST_LINKS = 4_000_000
"""Bits of who hears whom in all samples, which bounds the size of a page of many robots."""


def spacing_of(steps: int, robots: int) -> int:
    """Steps between the samples of a film, so that a page of it has a few megabytes at most."""
    samples = min(MAX_SAMPLES, max(1, _MOST_LINKS // robots**2))
    return -(-steps // samples)


def film_of_trial(trials: Trials, trial: int) -> Film:
    """The film of one trial of an experiment, which is run again.

    Raises UsageError if there is no such trial, or what comes out is not what the results say.
    """
    experiment = trials.experiment
    if trial not in trials.numbers:
        numbers = f"{trials.numbers[0]} to {trials.numbers[-1]}"
        raise UsageError(f"there is no trial {trial}; choose one of {numbers}")
    spacing, place = spacing_of(experiment.steps, experiment.robots), trials.numbers.index(trial)
    again = run_trials(experiment, trial, 1, spacing)
    if not np.array_equal(again.errors[0], trials.errors[place]):
        raise UsageError(
            f"trial {trial} does not come out again as in the results, which another version or extension "
            "made: run mcp-asdf simulate again"
        )
    values = np.stack([again.records[name][0] for name in QUANTITIES[:3]], axis=1)
    ticks = np.arange(len(values)) * spacing
    return Film(stage_of(experiment, trial), _in_the_world(experiment, trial, ticks, values))


def film_of_log(log: Path, events: Path | None = None) -> Film:
    """The film of a log's robots, which run again on what its input log says that they saw and heard.

    Raises UsageError if the input log cannot be read or contradicts itself.
    """
    with InputLogReader(events or input_log_path(log)) as input_log:
        header = input_log.header
        settings = _settings_of(header)
        ticks, values = _states(input_log)
    if settings is not None:
        return Film(stage_of(settings), _in_the_world(settings, 0, ticks, values))
    robots = [record.id for record in header.robots]
    stage = Stage(f"robots of {log.name}", robots, steps=int(ticks[-1]))
    unknown = np.full((len(ticks), 1, len(robots)), np.nan)
    hears = np.zeros((len(ticks), len(robots), len(robots)), np.bool_)
    return Film(stage, Samples(ticks, np.concatenate([values, unknown], axis=1), hears, None))


def _settings_of(header: InputLogHeader) -> Population | None:
    """The swarm that an input log is of; None if it is of single robots."""
    names = parameter_names(Population)
    if not set(names) <= set(header.parameters):
        return None
    return Population.from_parameters({name: header.parameters[name] for name in names})


def _states(input_log: InputLogReader) -> tuple[NDArray[np.int64], NDArray[np.float64]]:
    """Ticks and values of a film of all robots of an input log.

    An input log has no ticks, but a robot settles once in each; so one has passed when a robot settles again.
    A robot that was dead keeps the values that it had.
    """
    places = {record.id: place for place, record in enumerate(input_log.header.robots)}
    steps = input_log.header.parameters.get("steps") or 1
    spacing = spacing_of(steps, len(places))
    now = np.array([_values(record.make().robot) for record in input_log.header.robots]).T
    rows, ticks, settled = [now.copy()], 0, set[int]()
    for robot_id, robot in rerun(input_log):
        if robot_id in settled:
            settled.clear()
            ticks += 1
            if ticks % spacing == 0:
                rows.append(now.copy())
        settled.add(robot_id)
        now[:, places[robot_id]] = _values(robot)
    if (ticks + 1) % spacing == 0:
        rows.append(now.copy())
    return np.arange(len(rows)) * spacing, np.stack(rows)


def _values(robot: Robot) -> tuple[float, float, float]:
    return robot.x, robot.x_hat, robot.b_hat


def _in_the_world(
    settings: WorldSettings, trial: int, ticks: NDArray[np.int64], values: NDArray[np.float64]
) -> Samples:
    """Samples of robots whose estimates are known, shape (samples, 3, N), with all else from the world."""
    parts = list(_scenes(settings, trial, ticks))
    hears, truth = (np.concatenate([each[index] for each in parts]) for index in (0, 1))
    positions = np.concatenate([each[2] for each in parts]) if settings.is_dynamic else None
    return Samples(ticks, np.concatenate([values, truth[:, np.newaxis]], axis=1), hears, positions)


def _scenes(
    settings: WorldSettings, trial: int, ticks: NDArray[np.int64]
) -> Iterator[tuple[NDArray[Any], ...]]:
    """Links, accuracies and positions in the wanted ticks; before the first tick those of the first."""
    world, wanted = World(settings, trial), np.maximum(ticks - 1, 0)
    for first in range(0, int(wanted[-1]) + 1, _STEPS_AT_ONCE):
        scene = world.advance(_STEPS_AT_ONCE)
        chosen = wanted[(wanted >= first) & (wanted < first + _STEPS_AT_ONCE)] - first
        known = (scene.hears, scene.accuracy, scene.positions)
        yield tuple(each[chosen] for each in known if each is not None)
