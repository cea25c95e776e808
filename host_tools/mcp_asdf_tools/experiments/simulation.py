"""Run trials of an experiment on any firmware and measure them.

Native trials run in the C engine and those of the reference in arrays, where these can; all others run in
Python, message by message. All see the same draws. The series of informed estimates of a trial is dropped
once K and e are known.
"""

from __future__ import annotations

from dataclasses import dataclass
from types import ModuleType
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from mcp_asdf.fixed_point import ONE, SHIFT_MAX, UNITS_PER_ALPHA, b_hat_to_raw
from mcp_asdf_tools.common import UsageError
from mcp_asdf_tools.experiments.experiment import Experiment
from mcp_asdf_tools.experiments.measurement import QUANTITIES, Measured, measure, measured_trial

if TYPE_CHECKING:
    from mcp_asdf_tools.experiments.engine.native import EngineResults


def run_trials(experiment: Experiment, first: int, trials: int, sampling_interval: int = 0) -> Measured:
    """Run ``trials`` trials from ``first`` on, recorded every ``sampling_interval`` steps unless that is 0.

    Raises UsageError if the firmware cannot be had. O(trials steps robots), robots squared where not native.
    """
    if not experiment.is_dynamic and _is_for_engine(experiment):
        return _run_native(experiment, first, trials, sampling_interval)
    each = [_run_one(experiment, first + index, sampling_interval) for index in range(trials)]
    return Measured(
        first, *(np.concatenate([getattr(one, name) for one in each], axis=axis) for name, axis in _AXES)
    )


def _run_one(experiment: Experiment, trial: int, sampling_interval: int) -> Measured:
    if _is_for_engine(experiment):
        return _run_native(experiment, trial, 1, sampling_interval)
    if experiment.firmware == "reference" and sampling_interval == 0 and _arrays().can_run(experiment):
        return _run_float64(experiment, trial)
    from mcp_asdf_tools.experiments.by_message import run_by_message  # noqa: PLC0415 (as ``_arrays``)

    return run_by_message(experiment, trial, sampling_interval)


_AXES = (("convergence_steps", 0), ("errors", 0), ("b_hat", 0), ("tests", 0), ("updates", 0), ("records", 1))


def _is_for_engine(experiment: Experiment) -> bool:
    return experiment.firmware == "native" and _engine().can_run(experiment)


def _engine() -> ModuleType:
    """The engine, loaded when first needed: other firmwares run where nothing has been built."""
    try:
        from mcp_asdf_tools.experiments.engine import native  # noqa: PLC0415
    except ImportError as error:
        raise UsageError(
            f"the engine cannot be loaded ({error}); build it with 'pip install .' or choose firmware mirror"
        ) from error
    return native


def _arrays() -> ModuleType:
    """The reference in arrays, loaded when first needed: it brings SciPy, which no native worker needs."""
    from mcp_asdf_tools.experiments import reference_arrays  # noqa: PLC0415

    return reference_arrays


def _run_native(experiment: Experiment, first: int, trials: int, sampling_interval: int) -> Measured:
    raw = _engine().run(experiment, first, trials, sampling_interval)
    pairs = np.array(
        [[measure(series, 1 / ONE, experiment.fill_ratio) for series in trial] for trial in raw.x]
    )
    every = np.broadcast_to(pairs, (trials, experiment.robots, 2))
    return Measured(
        first,
        every[..., 0].astype(np.int64),
        every[..., 1].copy(),
        raw.b_hat / 2.0**32,
        raw.counters["tests"].astype(np.int64),
        raw.counters["updates"].astype(np.int64),
        _records_of(experiment, raw, bool(sampling_interval)),
    )


def _records_of(experiment: Experiment, raw: EngineResults, recorded: bool) -> NDArray[np.float64]:
    """The engine's records as floats, with step 0 before them."""
    shape = (len(QUANTITIES), len(raw.x), raw.records.shape[1] + recorded, experiment.robots)
    records = np.empty(shape)
    if recorded:
        start = {"x_hat": 0.5, "x_bar": 0.5, "x": 0.5}
        units = {"x_hat": ONE, "x_bar": ONE, "x": ONE, "beta": UNITS_PER_ALPHA, "b_hat": 2**32}
        for values, name in zip(records, QUANTITIES, strict=True):
            values[:, 0] = start.get(name, 0.0)
            whole = raw.records[name]
            values[:, 1:] = _confidences(whole) if name == "alpha" else whole / units.get(name, 1)
        records[-1, :, 0] = [b_hat_to_raw(experiment.b_hat(j)) / 2**32 for j in range(experiment.robots)]
    return records


def _confidences(words: NDArray[np.uint32]) -> NDArray[np.float64]:
    """The values of alpha words, exactly."""
    return np.ldexp((words >> 8) / UNITS_PER_ALPHA, (words & SHIFT_MAX).astype(np.int32))


def _run_float64(experiment: Experiment, trial: int) -> Measured:
    outcome = _arrays().run(experiment, trial)
    counts = (outcome.tests, outcome.updates)
    return measured_trial(experiment, trial, outcome.x, outcome.b_hat, counts)


@dataclass(frozen=True)
class Job:
    """Arguments of ``run_trials``, for a worker process."""

    experiment: Experiment
    first: int
    count: int
    sampling_interval: int = 0

    def run(self) -> Measured:
        """The job's results."""
        return run_trials(self.experiment, self.first, self.count, self.sampling_interval)
