"""Trial files of the paper's authors, written from a swarm here as their two simulators write them.

That of fixed networks is in Python: ten numbers a step, as ``str`` has them after rounding to six places, and
a comma behind the last. That of moving robots is in C++: thirteen numbers, the whole ones first, the others
with six decimal places.
"""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np

from mcp_asdf_tools.experiments.experiment import Experiment
from mcp_asdf_tools.experiments.trials import MessageSwarm

FIXED = Experiment(
    robots=5,
    flawed=2,
    flawed_accuracy=0.75,
    steps=60,
    filter_period=20,
    trials=3,
    omega="0.1",
    firmware="reference",
    conventions="authors",
    seed=0,
)
"""An experiment with a fixed network that their simulator could run. Its seed says that theirs is unknown."""
MOVING = Experiment(
    robots=6,
    flawed=2,
    steps=60,
    filter_period=20,
    filter="asdf-plus",
    topology="dynamic",
    latency=1,
    density=2.0,
    trials=3,
    firmware="reference",
    conventions="authors",
    seed=0,
)
"""An experiment with robots that move."""


def states_of(experiment: Experiment, number: int) -> list[list[list[float]]]:
    """Run a trial, and return QUANTITIES of each robot after each step from 0 on: [step][quantity][robot]."""
    swarm = MessageSwarm(experiment, number)
    states = [swarm.snapshot()]
    for _ in swarm.steps():
        states.append(swarm.snapshot())
    return states


def trial_content(experiment: Experiment, number: int) -> dict[str, Any]:
    """Return the content of the file of a trial."""
    is_moving = experiment.topology == "dynamic"
    data_str: list[list[str]] = [[] for _ in range(experiment.robots)]
    for quantities in states_of(experiment, number):
        for robot in range(experiment.robots):
            values = [values_of_robots[robot] for values_of_robots in quantities]
            text = _moving_text(values, experiment) if is_moving else _fixed_text(values)
            # Theirs are the last robots.
            data_str[(robot - experiment.flawed) % experiment.robots].append(text)
    content = _moving_parameters(experiment) if is_moving else _fixed_parameters(experiment)
    return content | {
        "num_robots": experiment.robots,
        "num_flawed_robots": experiment.flawed,
        "num_trials": experiment.trials,
        "num_steps": experiment.steps,
        "comms_period": experiment.comms_period,
        "sensor_filter_period": experiment.filter_period,
        "tfr": experiment.fill_ratio,
        "method": "BRAVO",
        "correct_robot_filter": experiment.filter == "asdf-plus",
        "flawed_sensor_acc_b": experiment.flawed_accuracy,
        "flawed_sensor_acc_w": experiment.flawed_accuracy,
        "correct_sensor_acc_b": experiment.true_accuracy,
        "correct_sensor_acc_w": experiment.true_accuracy,
        "trial_ind": number,
        "data_str": data_str,
    }


def write_trial(path: Path, experiment: Experiment, number: int, **changes: Any) -> Path:
    """Write the file of a trial, with some keys changed or, if their value is None, left out."""
    content = trial_content(experiment, number) | changes
    content = {key: value for key, value in content.items() if value is not None}
    path.write_text(json.dumps(content, indent=4), encoding="utf-8")
    return path


def _fixed_parameters(experiment: Experiment) -> dict[str, Any]:
    return {
        "sim_type": "static_topo_static_degrad_1d",
        "num_correct_robots": experiment.robots - experiment.flawed,
        "flawed_sensor_cov": 0.0,
        "fully_connected": True,
        "filter_specific_params": [float(experiment.omega)],
    }


def _moving_parameters(experiment: Experiment) -> dict[str, Any]:
    return {
        "sim_type": "dynamic_topo_static_deg_1d",
        "seed": 1712345678,
        "filter_specific_params": {"type_2_err_prob": str(experiment.omega)},
        "dynamic_degradation": False,
        "true_drift_coeff": 0.0,
        "true_diffusion_coeff": -1.0,
        "lowest_degraded_acc_lvl": 0.0,
        "obs_queue_size": 0,
        "dynamic_observation_queue": False,
        "dynamic_observation_queue_window_size": 0,
        "comms_range": experiment.radio_range,
        "meas_period": experiment.observation_period,
        "speed": 100 * experiment.speed,
        "density": experiment.density + 1e-5,
    }


def _fixed_text(values: list[float]) -> str:
    """Return the text of a step: -1 for the seed, n, t, six rounded numbers, and b_hat twice."""
    t, n, *others, b_hat = values
    numbers = [-1, int(n), int(t), *(np.round(value, 6) for value in (*others, b_hat, b_hat))]
    return "".join(f"{number}," for number in numbers)


def _moving_text(values: list[float], experiment: Experiment) -> str:
    """Return the text of a step: seed, n, t, then with six places the rest, b_hat and b twice, and a mean."""
    t, n, *others, b_hat = values
    true_accuracy = experiment.true_accuracy
    real_numbers = [*others, b_hat, b_hat, true_accuracy, true_accuracy, 0.0]
    texts = [f"{value:.6f}" for value in real_numbers]
    return ",".join(["1712345684", f"{n:.0f}", f"{t:.0f}", *texts])
