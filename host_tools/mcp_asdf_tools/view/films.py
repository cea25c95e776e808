"""Films of runs: trials of an experiment, logs of a bus, a running swarm, robots elsewhere on a bus.

A recording need not hold positions, floor and truth: they follow from its parameters, and are computed again.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import replace
from itertools import count
from pathlib import Path

import can
import numpy as np
from numpy.typing import NDArray

from mcp_asdf.robot import Robot
from mcp_asdf_tools.bus.frames import FrameFormat
from mcp_asdf_tools.common.errors import UsageError
from mcp_asdf_tools.common.parameters import parameters_of
from mcp_asdf_tools.experiments.experiment import Experiment
from mcp_asdf_tools.experiments.results import Trials
from mcp_asdf_tools.experiments.trials import run_trials
from mcp_asdf_tools.recording.events import EventsHeader, EventsReader, events_path
from mcp_asdf_tools.recording.replay import rerun
from mcp_asdf_tools.robots.population import Population
from mcp_asdf_tools.robots.robot_setup import format_ids
from mcp_asdf_tools.swarm.fault_injection.fault import Fault
from mcp_asdf_tools.swarm.settings import SwarmSettings
from mcp_asdf_tools.swarm.swarm import Swarm
from mcp_asdf_tools.view.film import MAX_STATES, QUANTITIES, Film, Stage, State
from mcp_asdf_tools.view.heard_robots import HeardRobots
from mcp_asdf_tools.world.arena import Arena
from mcp_asdf_tools.world.floor_code import make_floor_code
from mcp_asdf_tools.world.settings import WorldSettings
from mcp_asdf_tools.world.topology import MAX_ON_BUS
from mcp_asdf_tools.world.world import World

_MOST_PIXELS = 800
"""Along a side of the floor: more than a page shows."""
_TWIN_PARTS = 480
_MOST_TWIN_WORK = 20_000_000
"""Most robot-steps of a run that is made again only for a line of a chart: a second or two."""
_MOST_WORK = 200_000_000
"""Most robot-steps of a trial that is made again: 800 MB of estimates."""


def stage_of(settings: Population, trial: int = 0, faults: Sequence[Fault] = (), allow: str = "") -> Stage:
    """The stage of a trial, or of a swarm with faults and allowed ids.

    Raises UsageError if its arena cannot be made.
    """
    stage = Stage(
        _title(settings, trial),
        list(range(settings.robots)),
        range(settings.flawed),
        settings.fill_ratio,
        settings.steps,
        settings.steps_per_second,
        filter=settings.filter,
        twin=[] if faults or allow else _twin(settings, trial),
        faults=[(str(each), each.start, each.stop) for each in faults],
    )
    if not settings.is_dynamic:
        return stage
    floor = floor_of(Arena(settings, trial))
    return replace(stage, sides=settings.sides, radio_range=settings.radio_range, floor=floor)


def _twin(settings: Population, trial: int) -> list[float]:
    """Mean error of the same robots without a filter, over equal parts of the run.

    Empty where they have none, and where it would take long.
    """
    if not settings.swarm_filter.is_on or settings.robots * settings.steps > _MOST_TWIN_WORK:
        return []
    parameters = {name: getattr(settings, name) for name in parameters_of(Population)} | {"filter": "none"}
    experiment = Experiment(**parameters, trials=trial + 1)
    if experiment.lacking_in_c:
        return []
    x = run_trials(experiment, trial, 1, spacing_of(settings.steps, settings.robots)).records["x"][0]
    errors = abs(x - settings.fill_ratio).mean(axis=1)
    return [round(float(part.mean()), 5) for part in np.array_split(errors, min(_TWIN_PARTS, len(errors)))]


def floor_of(arena: Arena) -> NDArray[np.bool_]:
    """The floor, a pixel for each tile, or as many as a page shows. O(pixels)."""
    settings = arena.settings
    if settings.floor == "code":
        return make_floor_code(settings.fill_ratio)
    return arena.pixels(*(min(math.ceil(side / settings.tile), _MOST_PIXELS) for side in settings.sides))


def _title(settings: Population, trial: int) -> str:
    words = [f"{settings.robots} robots", f"{settings.flawed} flawed", settings.swarm_filter.typeset_term]
    if settings.swarm_filter.is_on:
        words.append(f"\N{GREEK SMALL LETTER TAU} = {settings.filter_period}")
    words += [str(settings.topology).replace("-", " "), f"seed {settings.seed}"]
    return ", ".join([*words, f"trial {trial}"] if trial else words)


# --- Runs that are over -------------------------------------------------------------------------------

_MOST_LINKS = 4_000_000
"""Bits of who hears whom in all states, which bounds the size of a page."""
_BITS_OF_MANY = 16
"""Of a robot among more than MAX_ON_BUS: its numbers and its links together."""


def spacing_of(steps: int, robots: int) -> int:
    """Steps between the states of a film, so that a page of it has a few megabytes at most."""
    bits = robots * (_BITS_OF_MANY if robots > MAX_ON_BUS else robots)
    return -(-steps // min(MAX_STATES, _MOST_LINKS // bits))


def film_of_trial(trials: Trials, trial: int) -> Film:
    """The film of one trial of an experiment, which is run again.

    Raises UsageError if there is no such trial, or what comes out is not what the results say.
    """
    experiment = trials.experiment
    if trial not in trials.numbers:
        numbers = f"{trials.numbers[0]} to {trials.numbers[-1]}"
        raise UsageError(f"there is no trial {trial}; choose one of {numbers}")
    if experiment.robots * experiment.steps > _MOST_WORK:
        raise UsageError(
            f"a trial of {experiment.robots} robots and {experiment.steps} steps is too long to be run "
            f"again, which view has to do; take one of at most {_MOST_WORK // experiment.robots} steps"
        )
    spacing, place = spacing_of(experiment.steps, experiment.robots), trials.numbers.index(trial)
    again = run_trials(experiment, trial, 1, spacing)
    if not np.array_equal(again.errors[0], trials.errors[place]):
        raise UsageError(
            f"trial {trial} does not come out again as in the results, which another version or extension "
            "made: run mcp-asdf simulate again"
        )
    values = np.stack([again.records[name][0] for name in QUANTITIES[:3]], axis=1)
    return Film(stage_of(experiment, trial), _in_the_world(experiment, trial, values, spacing))


def film_of_log(log: Path) -> Film:
    """The film of a swarm's log, whose robots run again on what its input log says that they saw and heard.

    Raises UsageError if the input log cannot be read, contradicts itself, or is of robots without a world.
    """
    with EventsReader(events_path(log)) as events:
        settings = _swarm_of(log, events.header)
        spacing = spacing_of(settings.steps, settings.robots)
        values = np.stack([*_values_of_log(events, settings.steps, spacing)])
    stage = stage_of(settings, 0, settings.faults, settings.allow)
    return Film(stage, _in_the_world(settings, 0, values, spacing))


def _swarm_of(log: Path, header: EventsHeader) -> SwarmSettings:
    """Return the settings of the swarm whose log this is; a parameter that the header lacks has its default.

    Raises UsageError for the log of a node or a controller, and for settings that do not fit its robots.
    """
    if "flawed" not in header.parameters:  # which every swarm has had, and nothing else has
        raise UsageError(f"{log} is not of a swarm, so there is nothing to see; mcp-asdf replay checks it")
    try:
        settings = SwarmSettings.from_recording(header.parameters)
    except UsageError as error:
        raise UsageError(f"the first line of {events_path(log)} is damaged: {error}") from error
    ids = [record.id for record in header.robots]
    if ids != list(range(settings.robots)):
        raise UsageError(
            f"the first line of {events_path(log)} is damaged: it is of {settings.robots} robots, but "
            f"lists {len(ids)}, {format_ids(frozenset(ids)) or 'none'}; the ids must be 0, 1, 2 and so on"
        )
    return settings


def _values_of_log(events: EventsReader, steps: int, spacing: int) -> Iterator[NDArray[np.float64]]:
    """Estimates of all robots of an input log after every ``spacing`` steps of at most ``steps``.

    An input log has no ticks, but a robot settles once in each; so one has passed when a robot settles again.
    Of a robot that did not settle, since it was dead, nothing is known. Raises UsageError for more steps.
    """
    places = {record.id: place for place, record in enumerate(events.header.robots)}
    now = _estimates(record.make_robot() for record in events.header.robots)

    def of_the_living() -> NDArray[np.float64]:
        return np.where([robot in settled for robot in places], now, np.nan)

    ticks, settled = 0, {*places}  # as if all had settled before the first
    for robot_id, robot in rerun(events):
        if robot_id in settled:
            if ticks % spacing == 0:
                yield of_the_living()
            settled.clear()
            ticks += 1
            if ticks > steps:
                raise events.error(f"the run goes on after the {steps} steps of the first line")
        settled.add(robot_id)
        now[:, places[robot_id]] = _estimates([robot])[:, 0]
    if ticks % spacing == 0:
        yield of_the_living()


def _estimates(robots: Iterable[Robot]) -> NDArray[np.float64]:
    """x, x_hat and b_hat of robots, shape (3, N)."""
    return np.array([[robot.x, robot.x_hat, robot.b_hat] for robot in robots]).T


def _in_the_world(
    settings: WorldSettings, trial: int, estimates: NDArray[np.float64], spacing: int
) -> Iterator[State]:
    """States of robots whose estimates are known, shape (states, 3, N), with all else from the world.

    Before the first step the world is as in it.
    """
    world, step = World(settings, trial), 1
    scene = world.advance(1)
    for tick, values in zip(count(0, spacing), estimates):
        if tick > step + 1:
            world.skip(tick - step - 1)
        if tick > step:
            scene, step = world.advance(1), tick
        hears = (
            scene.neighbours[0].copy() if settings.robots <= MAX_ON_BUS else np.argwhere(scene.neighbours[0])
        )
        positions = None if scene.positions is None else scene.positions[0]
        yield State(tick, np.vstack([values, scene.accuracy[0]]), hears, positions)


# --- Runs that go on ----------------------------------------------------------------------------------


class SwarmCamera:
    """Hook that adds a swarm's state to a film, as often as its length asks for.

    Attributes:
        film: What was taken so far.
    """

    def __init__(self, settings: SwarmSettings, pace: float = 0.0) -> None:
        """Prepare for a run of at most ``pace`` steps a second, or of any number if it is 0.

        Raises UsageError if ``pace`` is below 0, or the arena cannot be made.
        """
        if not pace >= 0:
            raise UsageError(f"--pace is {pace:g}; give steps a second, or 0 for as many as it can")
        self.film = Film(stage_of(settings, 0, settings.faults, settings.allow))
        self._spacing = spacing_of(settings.steps, settings.robots)
        self._step = 1 / pace if pace else 0.0
        self._due = 0.0

    def __call__(self, swarm: Swarm) -> None:
        """Wait for the next step, and take the present state if it is due. O(robots^2)."""
        now = time.monotonic()
        self._due = max(self._due + self._step, now)  # a slow step is not made up for
        time.sleep(self._due - now)
        if swarm.ticks % self._spacing == 0:
            world = swarm.world
            estimates = _estimates(node.robot for node in swarm.nodes)
            estimates[:, [not node.is_alive for node in swarm.nodes]] = np.nan
            values = np.vstack([estimates, world.accuracy])
            self.film.add(State(swarm.ticks, values, world.current_neighbours.copy(), world.positions))


STATES_PER_SECOND = 10
STATES_PER_REPORT = 5


class BusFilm:
    """Film of all robots that a bus has.

    A bus says nothing of places and of who hears whom, so the film has none.

    Attributes:
        film: What was heard so far; robots are in the order in which they were first heard.
    """

    def __init__(
        self, bus: can.BusABC, frames: FrameFormat, title: str, f: float | None = None, b: float | None = None
    ) -> None:
        """Listen on ``bus`` for these estimates; the true ``f`` and ``b`` are drawn if they are known."""
        self.film = Film(Stage(title, [], fill_ratio=f, steps_per_second=STATES_PER_SECOND))
        self._bus = bus
        self._heard_robots = HeardRobots(frames, b)
        self._report_due = 0

    @property
    def has_telemetry(self) -> bool:
        """Whether a robot sends it: x and b_hat are in no other frame."""
        return self._heard_robots.has_telemetry

    def record(self, should_stop: Callable[[], bool]) -> None:
        """Film until asked to stop. Raises can.CanError if the bus fails."""
        tick, self._began = 0, time.monotonic()
        while not should_stop():
            left = tick / STATES_PER_SECOND - self._seconds()
            frame = self._bus.recv(max(left, 0.0))
            if frame is not None:
                self._hear(frame)
            if left <= 0:
                self._take(tick)
                tick = int(self._seconds() * STATES_PER_SECOND) + 1

    def _hear(self, frame: can.Message) -> None:
        """Take a frame of any node. O(1)."""
        new_robot = self._heard_robots.receive(frame, self._seconds())
        if new_robot is not None:
            self.film.join(new_robot)

    def _seconds(self) -> float:
        """Seconds since the film began."""
        return time.monotonic() - self._began

    def _take(self, tick: int) -> None:
        """Add a state, in which nothing is known of robots that are silent, and a report."""
        now, robots = self._seconds(), self._heard_robots.ids
        if robots:
            no_links = np.zeros((len(robots), len(robots)), np.bool_)
            self.film.add(self._heard_robots.state(tick, now, robots, no_links))
        if tick >= self._report_due:
            self.film.report = self._heard_robots.roster.report(now)
            self._report_due = tick + STATES_PER_REPORT
