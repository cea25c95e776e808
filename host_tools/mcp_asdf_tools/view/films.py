"""Films of runs: trials of an experiment, logs of a bus, a running swarm, robots elsewhere on a bus.

A recording need not hold positions, floor and truth: they follow from its parameters, and are computed again.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import can
import numpy as np
from numpy.typing import NDArray

from mcp_asdf.robot import Robot
from mcp_asdf_tools.bus.frames import ONE, FrameFormat, Message, Telemetry, decode_any
from mcp_asdf_tools.common.errors import UsageError
from mcp_asdf_tools.experiments.results import Trials
from mcp_asdf_tools.experiments.trials import run_trials
from mcp_asdf_tools.recording.input_log import InputLogHeader, InputLogReader, input_log_path
from mcp_asdf_tools.recording.replay import rerun
from mcp_asdf_tools.robots.population import TYPESET_FILTER_NAMES, Population, parameter_names
from mcp_asdf_tools.swarm.settings import SwarmSettings
from mcp_asdf_tools.swarm.swarm import Swarm
from mcp_asdf_tools.view.film import MAX_SAMPLES, QUANTITIES, Film, LiveFilm, Sample, Samples, Stage
from mcp_asdf_tools.world.arena import Arena
from mcp_asdf_tools.world.floor_code import code
from mcp_asdf_tools.world.settings import WorldSettings
from mcp_asdf_tools.world.topology import Graph
from mcp_asdf_tools.world.world import World

_MOST_PIXELS = 800
"""Along a side of the floor: more than a page shows."""


def stage_of(population: Population, trial: int = 0) -> Stage:
    """The stage of a trial. Raises UsageError if its arena cannot be made."""
    settings = population
    moves = settings.is_dynamic
    return Stage(
        _title(settings, trial),
        range(settings.robots),
        range(settings.flawed),
        settings.fill_ratio,
        settings.steps,
        settings.steps_per_second,
        settings.comms_period,
        settings.sides if moves else None,
        settings.radio_range if moves else None,
        floor_of(Arena(settings, trial)) if moves else None,
    )


def floor_of(arena: Arena) -> NDArray[np.bool_]:
    """The floor, a pixel for each tile, or as many as a page shows. O(pixels)."""
    settings = arena.settings
    if settings.floor == "code":
        return code(settings.fill_ratio)
    return arena.pixels(*(min(math.ceil(side / settings.tile), _MOST_PIXELS) for side in settings.sides))


def _title(settings: Population, trial: int) -> str:
    words = [
        f"{settings.robots} robots",
        f"{settings.flawed} flawed",
        TYPESET_FILTER_NAMES[settings.filter],
        f"\N{GREEK SMALL LETTER TAU} = {settings.filter_period}",
        _topology(settings),
        f"seed {settings.seed}" + (f", trial {trial}" if trial else ""),
    ]
    if settings.filter == "none":
        del words[3]
    return ", ".join(words)


def _topology(settings: Population) -> str:
    if isinstance(settings.graph, Graph):
        return Path(settings.graph.source).name
    if settings.is_dynamic:
        return "moving"
    return str(settings.topology).replace("-", " ")


# --- Runs that are over -------------------------------------------------------------------------------

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


# --- Runs that go on ----------------------------------------------------------------------------------


class SwarmCamera:
    """Hook that adds a swarm's state to a film, as often as its length asks for.

    Attributes:
        film: What was taken so far.
    """

    def __init__(self, settings: SwarmSettings) -> None:
        """Prepare for a run. Raises UsageError if its arena cannot be made."""
        self.film = LiveFilm(stage_of(settings))
        self._spacing = spacing_of(settings.steps, settings.robots)

    def __call__(self, swarm: Swarm) -> None:
        """Take the present state if it is due. O(robots^2)."""
        if swarm.ticks % self._spacing == 0:
            world = swarm.world
            self.film.add(Sample(swarm.ticks, _values_of(swarm), world.hears.copy(), world.positions))


def _values_of(swarm: Swarm) -> NDArray[np.float64]:
    states = [[getattr(node.robot, name) for node in swarm.nodes] for name in QUANTITIES[:3]]
    return np.array([*states, swarm.world.accuracy])


SAMPLES_PER_SECOND = 10
_X, _X_HAT, _B_HAT, _ = range(len(QUANTITIES))


class BusFilm:
    """Film of all robots that a bus has.

    A bus says nothing of places and of who hears whom, so the film has none.

    Attributes:
        film: What was heard so far; robots are in the order in which they were first heard.
        has_telemetry: Whether a robot sends it: x and b_hat are in no other frame.
    """

    def __init__(
        self, bus: can.BusABC, frames: FrameFormat, title: str, f: float | None = None, b: float | None = None
    ) -> None:
        """Listen on ``bus`` for these estimates; the true ``f`` and ``b`` are drawn if they are known."""
        self.film = LiveFilm(Stage(title, [], fill_ratio=f, steps_per_second=SAMPLES_PER_SECOND))
        self.has_telemetry = False
        self._bus = bus
        self._frames = frames
        self._unknown = [np.nan, np.nan, np.nan, np.nan if b is None else b]
        self._states: dict[int, list[float]] = {}

    def record(self, should_stop: Callable[[], bool]) -> None:
        """Film until asked to stop. Raises can.CanError if the bus fails."""
        began, tick = time.monotonic(), 0
        while not should_stop():
            left = began + tick / SAMPLES_PER_SECOND - time.monotonic()
            frame = self._bus.recv(max(left, 0.0))
            if frame is not None:
                self.hear(frame)
            if left <= 0:
                self._take(tick)
                tick = int((time.monotonic() - began) * SAMPLES_PER_SECOND) + 1

    def hear(self, frame: can.Message) -> None:
        """Take a frame of any node. O(1)."""
        content = decode_any(frame, self._frames)
        if isinstance(content, Message):
            self._state(content.sender)[_X_HAT] = content.x_hat / ONE
        elif isinstance(content, Telemetry):
            self.has_telemetry = True
            state = self._state(content.sender)
            state[_X], state[_B_HAT] = content.x / ONE, content.b_hat / 2**24

    def _state(self, robot: int) -> list[float]:
        if robot not in self._states:
            self._states[robot] = self._unknown.copy()
            self.film.join(robot)
        return self._states[robot]

    def _take(self, tick: int) -> None:
        if self._states:
            count = len(self._states)
            values = np.array(list(self._states.values())).T
            self.film.add(Sample(tick, values, np.zeros((count, count), np.bool_), None))
