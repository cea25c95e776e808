"""Histories of runs for the page: trials of an experiment, logs of a swarm, a running swarm, robots on a bus.

A recording holds no positions, floor or true accuracies. They follow from its parameters, and are computed
again.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

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
from mcp_asdf_tools.view.film import MAX_STATES, History, RunDescription, State
from mcp_asdf_tools.view.heard_robots import LatestRobotValues
from mcp_asdf_tools.world.arena import Arena
from mcp_asdf_tools.world.floor_code import make_floor_code
from mcp_asdf_tools.world.graph import MAX_ON_BUS
from mcp_asdf_tools.world.settings import WorldSettings
from mcp_asdf_tools.world.world import World

_MAX_FLOOR_PIXELS = 800
"""Pixels along a side of the floor: more than a page shows."""
_MAX_ERROR_POINTS = 480
"""Points of the chart's line of the errors without a filter."""
_MAX_UNFILTERED_ROBOT_STEPS = 20_000_000
"""Robots times steps of a run that is computed only for that line: it takes a second or two."""
_MAX_TRIAL_ROBOT_STEPS = 200_000_000
"""Robots times steps of a trial that is run again: its estimates take 800 MB."""


def describe_run(
    settings: Population, trial: int = 0, faults: Sequence[Fault] = (), allow: str = ""
) -> RunDescription:
    """Return what stays the same during a trial, or during a swarm's run with ``faults`` and ``allow``.

    ``allow`` is the text of --allow: the ids whose estimates robots accept; "" accepts all. With robots that
    move this computes the floor. Without faults and ``allow`` it runs the trial without a filter, for up to
    two seconds, to give its errors. Raises UsageError if the arena cannot be made.
    """
    # The run without a filter has neither faults nor refused ids: with them it would be no fair comparison.
    is_plain_run = not faults and not allow
    description = RunDescription(
        title=_format_title(settings, trial),
        robots=list(range(settings.robots)),
        flawed=range(settings.flawed),
        fill_ratio=settings.fill_ratio,
        steps=settings.steps,
        steps_per_second=settings.steps_per_second,
        filter=settings.filter,
        unfiltered_errors=_compute_unfiltered_errors(settings, trial) if is_plain_run else [],
        faults=[(str(fault), fault.start, fault.stop) for fault in faults],
    )
    if not settings.is_dynamic:
        return description
    floor = draw_floor(Arena(settings, trial))
    return replace(description, sides=settings.sides, radio_range=settings.radio_range, floor=floor)


def _compute_unfiltered_errors(settings: Population, trial: int) -> list[float]:
    """Run a trial without a filter; return the robots' mean error at up to _MAX_ERROR_POINTS points.

    The error is the distance of the informed estimate x from the fill ratio f. Each point is the mean over
    one of consecutive parts of nearly equal length. The list is empty if the robots have no filter anyway, or
    the trial is too long or cannot be run by the fast engine in C.
    """
    robot_steps = settings.robots * settings.steps
    if not settings.swarm_filter.is_on or robot_steps > _MAX_UNFILTERED_ROBOT_STEPS:
        return []
    parameters = {name: getattr(settings, name) for name in parameters_of(Population)}
    parameters["filter"] = "none"
    experiment = Experiment(**parameters, trials=trial + 1)
    if experiment.lacking_in_c:
        return []
    sampling_interval = steps_between_states(settings.steps, settings.robots)
    trials = run_trials(experiment, first=trial, trials=1, sampling_interval=sampling_interval)
    estimates = trials.records["x"][0]
    mean_errors = abs(estimates - settings.fill_ratio).mean(axis=1)
    point_count = min(_MAX_ERROR_POINTS, len(mean_errors))
    return [round(float(errors.mean()), 5) for errors in np.array_split(mean_errors, point_count)]


def draw_floor(arena: Arena) -> NDArray[np.bool_]:
    """Return the floor as pixels, True where it is black, the first row in the north. O(pixels).

    There is a pixel for each tile, or _MAX_FLOOR_PIXELS along a side that has more tiles.
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


# --- Runs that are over -------------------------------------------------------------------------------

_MAX_HISTORY_BITS = 4_000_000
"""Bits of links between robots in all states, which bound the size of a page."""
_BITS_PER_ROBOT_OF_MANY = 16
"""Of the values and links of a robot among more than MAX_ON_BUS, whose links are stored as pairs."""


def steps_between_states(steps: int, robots: int) -> int:
    """Return the steps from one state to the next with which a history of ``steps`` steps is short enough.

    It is the smallest number, at least 1, that keeps the page of these ``robots`` to a few megabytes.
    """
    bits_per_robot = robots if robots <= MAX_ON_BUS else _BITS_PER_ROBOT_OF_MANY
    affordable_states = _MAX_HISTORY_BITS // (robots * bits_per_robot)
    states = min(MAX_STATES, affordable_states)
    return (steps + states - 1) // states  # rounded up


def recompute_trial_history(trials: Trials, trial: int) -> History:
    """Run one trial of an experiment again, and return its history, which has ended.

    ``trial`` is the trial's number, one of ``trials.numbers``. Raises UsageError if there is no such trial,
    if it is too long, or if its errors differ from those in ``trials``.
    """
    experiment = trials.experiment
    if trial not in trials.numbers:
        numbers = f"{trials.numbers[0]} to {trials.numbers[-1]}"
        raise UsageError(f"there is no trial {trial}; choose one of {numbers}")
    if experiment.robots * experiment.steps > _MAX_TRIAL_ROBOT_STEPS:
        raise UsageError(
            f"a trial of {experiment.robots} robots and {experiment.steps} steps is too long to be run "
            f"again, which view has to do; take one of at most {_MAX_TRIAL_ROBOT_STEPS // experiment.robots} "
            "steps"
        )
    spacing = steps_between_states(experiment.steps, experiment.robots)
    rerun_trials = run_trials(experiment, first=trial, trials=1, sampling_interval=spacing)
    # The results hold no states. Equal errors are the evidence that this run has the states of the first.
    recorded_errors = trials.errors[trials.numbers.index(trial)]
    if not np.array_equal(rerun_trials.errors[0], recorded_errors):
        raise UsageError(
            f"trial {trial} does not come out again as in the results, which another version or extension "
            "made: run mcp-asdf simulate again"
        )
    series = [rerun_trials.records[name][0] for name in ("x", "x_hat", "b_hat")]
    estimates = np.stack(series, axis=1)
    return History(describe_run(experiment, trial), _add_world(experiment, trial, estimates, spacing))


def recompute_swarm_history(log: Path) -> History:
    """Replay the log of a swarm from the events beside it, and return its history, which has ended.

    Raises UsageError if the events cannot be read, contradict themselves, or are not of a swarm.
    """
    with EventsReader(events_path(log)) as events:
        settings = _read_swarm_settings(log, events.header)
        spacing = steps_between_states(settings.steps, settings.robots)
        estimates = np.stack(list(_replay_estimates(events, settings.steps, spacing)))
    description = describe_run(settings, trial=0, faults=settings.faults, allow=settings.allow)
    return History(description, _add_world(settings, 0, estimates, spacing))


def _read_swarm_settings(log: Path, header: EventsHeader) -> SwarmSettings:
    """Return the settings of the swarm that wrote a log; a parameter that the header lacks has its default.

    Raises UsageError for the log of a node or a controller, and for settings that contradict its robots.
    """
    # Every version of swarm has written this parameter, and no other command does.
    if "flawed" not in header.parameters:
        raise UsageError(f"{log} is not of a swarm, so there is nothing to see; mcp-asdf replay checks it")
    try:
        settings = SwarmSettings.from_recording(header.parameters)
    except UsageError as error:
        raise UsageError(f"the first line of {events_path(log)} is damaged: {error}") from error
    ids = [setup.id for setup in header.robots]
    if ids != list(range(settings.robots)):
        raise UsageError(
            f"the first line of {events_path(log)} is damaged: it is of {settings.robots} robots, but "
            f"lists {len(ids)}, {format_ids(frozenset(ids)) or 'none'}; the ids must be 0, 1, 2 and so on"
        )
    return settings


def _replay_estimates(events: EventsReader, max_ticks: int, spacing: int) -> Iterator[NDArray[np.float64]]:
    """Replay a swarm's events; yield x, x_hat and b_hat of all robots, shape (3, N), every ``spacing`` ticks.

    The first is their start. A robot that did not settle in a tick, since it was dead, has NaN there. Raises
    UsageError if the events go on after ``max_ticks``, and as ``rerun``.
    """
    columns = {setup.id: column for column, setup in enumerate(events.header.robots)}
    estimates = _collect_estimates(setup.make_robot() for setup in events.header.robots)

    def estimates_of_living_robots() -> NDArray[np.float64]:
        has_settled = [robot_id in settled_ids for robot_id in columns]
        return np.where(has_settled, estimates, np.nan)

    # Events have no ticks, but a living robot settles once in each: when one settles again, a tick is
    # complete.
    tick = 0
    settled_ids = set(columns)  # so that the first settle completes tick 0, the start
    for robot_id, robot in rerun(events):
        if robot_id in settled_ids:
            if tick % spacing == 0:
                yield estimates_of_living_robots()
            settled_ids.clear()
            tick += 1
            if tick > max_ticks:
                raise events.error(f"the run goes on after the {max_ticks} steps of the first line")
        settled_ids.add(robot_id)
        estimates[:, columns[robot_id]] = _collect_estimates([robot])[:, 0]
    if tick % spacing == 0:
        yield estimates_of_living_robots()


def _collect_estimates(robots: Iterable[Robot]) -> NDArray[np.float64]:
    """Return x, x_hat and b_hat of robots, shape (3, N)."""
    return np.array([[robot.x, robot.x_hat, robot.b_hat] for robot in robots]).T


def _add_world(
    settings: WorldSettings, trial: int, estimates: NDArray[np.float64], spacing: int
) -> Iterator[State]:
    """Yield a state for each of the robots' ``estimates``, with the rest computed from the world again.

    ``estimates`` has x, x_hat and b_hat at ticks 0, ``spacing`` and so on, shape (states, 3, N). The rest is
    true accuracies, neighbours and positions.
    """
    world = World(settings, trial)
    # The world has no state before the first step, so the state at tick 0 shows that of tick 1.
    scene = world.advance(1)
    world_tick = 1
    for index, estimates_at_tick in enumerate(estimates):
        tick = index * spacing
        if tick > world_tick:
            steps_to_skip = tick - world_tick - 1
            if steps_to_skip > 0:
                world.skip(steps_to_skip)
            scene = world.advance(1)
            world_tick = tick
        if settings.robots <= MAX_ON_BUS:
            neighbours: NDArray[Any] = scene.neighbours[0].copy()
        else:
            neighbours = np.argwhere(scene.neighbours[0])
        positions = None if scene.positions is None else scene.positions[0]
        yield State(tick, np.vstack([estimates_at_tick, scene.accuracy[0]]), neighbours, positions)


# --- Runs that go on ----------------------------------------------------------------------------------


class SwarmRecorder:
    """Hook of ``run_swarm`` that adds the swarm's states to a history, and slows the run to a given pace.

    Attributes:
        history: The description of the swarm, and its states so far. Its owner sets ``has_ended``.
    """

    def __init__(self, settings: SwarmSettings, pace: float = 0.0) -> None:
        """Prepare for a run of at most ``pace`` steps a second; 0 sets no limit.

        Raises UsageError if ``pace`` is below 0 or no number, or if the arena cannot be made.
        """
        # Written as "not >=", since NaN is refused, too.
        if not pace >= 0:
            raise UsageError(f"--pace is {pace:g}; give steps a second, or 0 for as many as it can")
        self.history = History(describe_run(settings, faults=settings.faults, allow=settings.allow))
        self._spacing = steps_between_states(settings.steps, settings.robots)
        self._seconds_per_step = 1 / pace if pace else 0.0
        self._next_step_time = 0.0

    def __call__(self, swarm: Swarm) -> None:
        """Sleep until the next step may begin, and add the present state if it is due. O(robots^2).

        States are due every ``steps_between_states`` ticks.
        """
        now = time.monotonic()
        # After a slow step the schedule starts anew from now: the steps that follow do not hurry to make up
        # for it.
        self._next_step_time = max(self._next_step_time + self._seconds_per_step, now)
        time.sleep(self._next_step_time - now)
        if swarm.ticks % self._spacing == 0:
            self.history.add(_read_swarm_state(swarm))


def _read_swarm_state(swarm: Swarm) -> State:
    """Return the present state of a running swarm; robots that are not alive have no estimates."""
    world = swarm.world
    estimates = _collect_estimates(node.robot for node in swarm.nodes)
    is_dead = [not node.is_alive for node in swarm.nodes]
    estimates[:, is_dead] = np.nan
    values = np.vstack([estimates, world.accuracy])
    return State(swarm.ticks, values, world.current_neighbours.copy(), world.positions)


STATES_PER_SECOND = 10
"""States that a history has for each second on a bus; they are its ticks."""
TICKS_PER_REPORT = 5
"""Ticks from one report on the robots of a bus to the next."""


class BusRecorder:
    """Records the history of the robots on a bus from their frames.

    A bus shows neither positions nor which robot receives from which, so the history has none of these.

    Attributes:
        history: What was recorded so far; robots are in the order of their first estimate or telemetry.
    """

    def __init__(
        self,
        bus: can.BusABC,
        frame_format: FrameFormat,
        title: str,
        fill_ratio: float | None = None,
        true_accuracy: float | None = None,
    ) -> None:
        """Prepare to record from ``bus`` the estimates of ``frame_format``, heartbeats and telemetry.

        ``fill_ratio`` and ``true_accuracy``, which frames do not show, are for the page; None if unknown.
        """
        description = RunDescription(
            title, robots=[], fill_ratio=fill_ratio, steps_per_second=STATES_PER_SECOND
        )
        self.history = History(description)
        self._bus = bus
        self._robot_values = LatestRobotValues(frame_format, true_accuracy)
        self._next_report_tick = 0
        self._start_time = 0.0

    @property
    def has_telemetry(self) -> bool:
        """Whether a robot has sent telemetry; without it x and b_hat stay unknown."""
        return self._robot_values.has_telemetry

    def record(self, should_stop: Callable[[], bool]) -> None:
        """Receive frames and add states to the history until ``should_stop``, which is asked after each.

        Time starts anew with each call. Raises can.CanError if the bus fails.
        """
        self._start_time = time.monotonic()
        tick = 0
        while not should_stop():
            seconds_to_tick = tick / STATES_PER_SECOND - self._seconds()
            frame = self._bus.recv(max(seconds_to_tick, 0.0))
            if frame is not None:
                self._receive(frame)
            if seconds_to_tick <= 0:
                self._add_state(tick)
                # On a busy computer this leaves ticks out, rather than fall further and further behind.
                tick = int(self._seconds() * STATES_PER_SECOND) + 1

    def _receive(self, frame: can.Message) -> None:
        """Take the values of a frame of any node, and add its robot to the history if it is new.

        O(1), or O(states) for a new robot.
        """
        new_robot_id = self._robot_values.receive(frame, self._seconds())
        if new_robot_id is not None:
            self.history.add_robot(new_robot_id)

    def _seconds(self) -> float:
        """Return the seconds since recording began."""
        return time.monotonic() - self._start_time

    def _add_state(self, tick: int) -> None:
        """Add a state if there are robots, and every TICKS_PER_REPORT ticks replace the history's report."""
        now = self._seconds()
        robot_ids = self._robot_values.ids
        if robot_ids:
            no_links = np.zeros((len(robot_ids), len(robot_ids)), np.bool_)
            self.history.add(self._robot_values.state(tick, now, robot_ids, no_links))
        if tick >= self._next_report_tick:
            self.history.report = self._robot_values.roster.report(now)
            self._next_report_tick = tick + TICKS_PER_REPORT
