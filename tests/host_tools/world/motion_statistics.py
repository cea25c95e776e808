"""Statistics of a swarm's motion: who meets whom for how long, and how robots wander."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from mcp_asdf_tools.world.arena import Motion

LAGS = (1, 10, 50, 100, 500)
"""In ticks."""

_TICKS_PER_SECOND = 10
"""Of the arenas whose motion this is."""

_APART = 10
"""Avoidances at most so many ticks apart are one burst."""

MEAN_DEGREE = 0.867
"""Of all trials together. About the mean of each trial alone the degree would look less persistent: a trial
is too short to tell its mean from slow changes."""


def motion_statistics(motion: Motion) -> dict[str, float]:
    """Every statistic by name; in metres, radians, and ticks unless the name says otherwise.

    Raises ValueError if ``motion`` is not longer than the largest lag. O(ticks robots^2).
    """
    if len(motion.position) <= max(LAGS):
        raise ValueError(f"{len(motion.position)} ticks are too few; give more than {max(LAGS)}")
    return {
        **_rounds(motion.adjacency),
        **_driving(motion),
        **_avoidances(motion),
        **bursts(motion.avoids.astype(np.bool_)),
        **_contacts(motion.adjacency),
        **{name: value for lag in LAGS for name, value in _after(motion, lag).items()},
    }


def _rounds(adjacency: NDArray[np.bool_]) -> dict[str, float]:
    degree = adjacency.sum(axis=2)
    return {
        "degree": float(degree.mean()),
        "rounds with 0 neighbours": float((degree == 0).mean()),
        "rounds with 1 neighbour": float((degree == 1).mean()),
        "rounds with 2 or more neighbours": float((degree >= 2).mean()),
    }


def _driving(motion: Motion) -> dict[str, float]:
    steps = np.linalg.norm(np.diff(motion.position, axis=0), axis=2)
    return {
        "speed": float(steps.mean()) * _TICKS_PER_SECOND,
        "ticks straight": float((motion.wheels == 0).mean()),
        "ticks in a soft turn": float((motion.wheels == 1).mean()),
        "ticks in a hard turn": float((motion.wheels == 2).mean()),
        "ticks avoiding": float(motion.avoids.mean()),
        "largest coordinate": float(np.abs(motion.position).max()),
    }


def runs(state: NDArray[np.bool_]) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Runs of True that begin and end within ``state``, of shape (ticks, columns), by column, then by tick.

    Returns the column and the tick before the first of each, shape (runs, 2), and their lengths.
    """
    change = np.diff(state.astype(np.int8), axis=0).T
    starts, ends = np.argwhere(change == 1), np.argwhere(change == -1)
    first, last = np.full(len(change), len(state)), np.full(len(change), -1)
    np.minimum.at(first, starts[:, 0], starts[:, 1])
    np.maximum.at(last, ends[:, 0], ends[:, 1])
    starts = starts[starts[:, 1] < last[starts[:, 0]]]
    ends = ends[ends[:, 1] > first[ends[:, 0]]]
    return starts, ends[:, 1] - starts[:, 1]


def _avoidances(motion: Motion) -> dict[str, float]:
    """An avoidance is a run of ticks in which a robot heads away from an obstacle."""
    starts, lengths = runs(motion.avoids.astype(np.bool_))
    robots, first = starts[:, 0], starts[:, 1]
    angle = np.unwrap(np.arctan2(motion.heading[:, :, 1], motion.heading[:, :, 0]), axis=0)
    turns = np.abs(angle[first + lengths + 1, robots] - angle[first + 1, robots])
    at_robot = np.concatenate([np.zeros((1, motion.avoids.shape[1])), motion.sees_robot.cumsum(axis=0)])
    seen = at_robot[first + lengths + 1, robots] - at_robot[first + 1, robots] > 0
    return {
        "avoidances of a robot": float(seen.mean()),
        "turn of an avoidance": float(turns.mean()),
    }


def bursts(avoids: NDArray[np.bool_]) -> dict[str, float]:
    """Avoidances with those that follow at once, as a robot that turns away from two obstacles in turn."""
    joined = avoids.copy()
    starts, lengths = runs(~avoids)
    for (robot, before), length in zip(starts[lengths < _APART], lengths[lengths < _APART], strict=True):
        joined[before + 1 : before + 1 + length, robot] = True
    seconds = avoids.size / _TICKS_PER_SECOND
    return {
        "avoidance bursts in 1000 s": 1000 * len(runs(joined)[1]) / seconds,
        "ticks between bursts": float(runs(~joined)[1].mean()),
    }


def _contacts(adjacency: NDArray[np.bool_]) -> dict[str, float]:
    """Runs of ticks in which a pair is linked, and the runs between."""
    upper = np.triu_indices(adjacency.shape[1], 1)
    linked = adjacency[:, upper[0], upper[1]]
    return {
        "contact": float(runs(linked)[1].mean()),
        "time between contacts": float(runs(~linked)[1].mean()),
    }


def _after(motion: Motion, lag: int) -> dict[str, float]:
    adjacency, position, heading = motion.adjacency, motion.position, motion.heading
    degree = adjacency.sum(axis=2, dtype=np.float64)
    deviation = degree - MEAN_DEGREE
    moved = position[lag:] - position[:-lag]
    return {
        f"pairs persisting after {lag}": float(
            (adjacency[lag:] & adjacency[:-lag]).sum() / adjacency[:-lag].sum()
        ),
        f"degree autocorrelation after {lag}": float(
            (deviation[lag:] * deviation[:-lag]).mean() / (deviation**2).mean()
        ),
        f"squared displacement after {lag}": float((moved**2).sum(axis=2).mean()),
        f"cosine of turn after {lag}": float((heading[lag:] * heading[:-lag]).sum(axis=2).mean()),
    }
