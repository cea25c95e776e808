"""The robust filter beside the paper's: on the paper's grid, beyond it, beside peers and in hard worlds.

``python -m mcp_asdf_tools.studies.robust_filter FOLDER`` writes ``robust.md`` and ``robust.png``, which
docs/robust.md shows. The peers run message by message in one process, which takes hours.

Each robot estimates f, the share of black floor, as x. b_hat is the accuracy that it assumes for its sensor,
and b the true one; a flawed robot starts with a wrong b_hat. The late error is the mean of |x - f| over the
last quarter of a trial. e is the mean of |x - f| from the step on at which a robot has converged.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np
from matplotlib.figure import Figure

import mcp_asdf_tools as m
from mcp_asdf_tools.common.figures import save_figure
from mcp_asdf_tools.experiments.experiment import Experiment
from mcp_asdf_tools.experiments.results import Trials
from mcp_asdf_tools.experiments.time_plots import plot_errors_over_time
from mcp_asdf_tools.studies.ageing_sensors import WanderingSensors
from mcp_asdf_tools.studies.bootstrap import Interval, Sample
from mcp_asdf_tools.studies.error_tables import (
    flawed_label,
    format_error,
    format_interval,
    format_tenths,
    harmed_shares,
    late_error_text,
    late_errors,
    markdown_table,
    mean_of_means,
    mean_of_medians,
    parse_arguments,
    run_experiments,
    score_text,
    topology_label,
    under_and_over_text,
    write_tables,
)
from mcp_asdf_tools.studies.peers import (
    FLOOR_AFTER_CHANGE,
    LIARS,
    AllCountsRobot,
    BayesCpfRobot,
    ChangingFloor,
    LossyRobot,
    RememberingRobot,
    column_label,
    firmware_name,
    five_liars,
    one_liar,
    two_liars,
)

FILTER_CHOICES = ["none", "asdf-minus", "asdf-plus", "robust"]
UNDERCONFIDENT = {"fill_ratio": 0.55, "true_accuracy": 0.95, "flawed_accuracy": 0.55}
OVERCONFIDENT = {"fill_ratio": 0.95, "true_accuracy": 0.55, "flawed_accuracy": 0.95}
MOVING = {"topology": "dynamic", "latency": 1}

GRID_HEAD = "H, error of the last quarter, e, healthy robots harmed"
PAIR_HEAD = "underconfident, overconfident"

MESSAGE_LOSS_LABEL = "3 messages of 10 lost"
"""Row label of ``LossyRobot``, whose share of lost messages is fixed."""

POINTS_OF_A_CURVE = 16
"""Number of intervals between the values of x that a curve shows."""


# --- Experiments -----------------------------------------------------------------------------------------


def wandering_experiments() -> list[Experiment]:
    """Return experiments without flawed robots in which b, a sensor's accuracy, wanders in every robot."""
    return m.grid(
        **MOVING,
        steps=20_000,
        trials=30,
        seed=4712,
        fill_ratio=0.75,
        flawed="0%",
        filter=["none", "asdf-plus", "robust"],
        sensor=WanderingSensors,
    )


def peer_experiments() -> list[Experiment]:
    """Return experiments with peers, and with the usual filters in the same worlds.

    A peer is a robot class with another filter than the project's; it stands in place of the firmware.
    """
    return m.grid(
        steps=20_000,
        seed=4713,
        trials=8,
        flawed="30%",
        sensors=[UNDERCONFIDENT, OVERCONFIDENT],
        swarms=[{**MOVING, "flawed": ["0%", "30%"]}, {"robots": 10, "steps": 10_000}],
        peers=[
            {"firmware": RememberingRobot, "filter": ["none", "asdf-minus"]},
            {"firmware": BayesCpfRobot, "filter": "asdf-plus"},
            {"firmware": AllCountsRobot, "filter": "none"},
            {"filter": FILTER_CHOICES},
        ],
    )


def world_experiments() -> list[Experiment]:
    """Return experiments with robots that lie, with messages that are lost, and with a floor that changes."""
    common = {"steps": 20_000, "seed": 4713, "trials": 8, "flawed": "30%"}
    # In a fully connected swarm one liar misleads everybody, so a few experiments show enough.
    connected = m.grid(
        **{**common, "trials": 12},
        **UNDERCONFIDENT,
        firmware=[one_liar, five_liars],
        filter=["none", "asdf-plus", "robust"],
    )
    # With the longest memory the old floor would be forgotten too slowly to see anything.
    changing = m.grid(
        **{**common, "steps": 40_000},
        **MOVING,
        **UNDERCONFIDENT,
        memory=4096,
        sensor=ChangingFloor,
        robots_and_filters=[
            {"filter": ["none", "asdf-plus", "robust"]},
            {"firmware": [two_liars, five_liars], "filter": ["none", "robust"]},
        ],
    )
    moving = m.grid(
        **common,
        **MOVING,
        sensors=[UNDERCONFIDENT, OVERCONFIDENT],
        firmware=[LossyRobot, one_liar, two_liars, five_liars],
        filter=FILTER_CHOICES,
    )
    return [*connected, *changing, *moving]


# --- Tables ----------------------------------------------------------------------------------------------


def grid_row(experiment: Experiment) -> str:
    """Return the row label of an experiment on the paper's grid, such as "moving, 30 % flawed"."""
    return f"{topology_label(experiment)}, {flawed_label(experiment)}"


def beyond_row(experiment: Experiment) -> str:
    """Return the row label of an experiment beyond the paper's grid: what differs from those on the grid.

    It names what is not as in a swarm of 20 robots at density 1 with sensors that do not age: "moving, 21
    robots, density 3", for example.
    """
    labels = [topology_label(experiment)]
    # The labels have this order in docs/robust.md, whose rows a test finds by their text.
    if experiment.robots != 20:
        labels.append(f"{experiment.robots} robots")
    if experiment.density != 1:
        labels.append(f"density {experiment.density:g}")
    if experiment.is_dynamic and experiment.latency == 0:
        labels.append("latency 0")
    if experiment.white_offset:
        labels.append(f"b {experiment.white_offset:+g} on white")
    if experiment.sensor:
        labels.append("sensors age each in its own way")
    if experiment.drift == "linear":
        labels.append("sensors age alike")
    return ", ".join(labels)


def peer_row(experiment: Experiment) -> str:
    """Return the row label of an experiment with a peer, such as "moving, 30 % flawed".

    An experiment of 10,000 steps has its length in the label, as the others are longer.
    """
    label = grid_row(experiment)
    if experiment.steps == 10_000:
        label += ", 10,000 steps"
    return label


def world_row(experiment: Experiment) -> str:
    """Return the row label of an experiment in a hard world: its topology, then what is hard for the robots.

    "moving, the floor changes, 5 liars" and "moving, 3 messages of 10 lost" are such labels.
    """
    labels = [topology_label(experiment)]
    if has_changing_floor(experiment):
        labels.append("the floor changes")
    liar_count = count_liars(experiment)
    if liar_count == 1:
        labels.append("1 liar")
    elif liar_count > 1:
        labels.append(f"{liar_count} liars")
    if has_message_loss(experiment):
        labels.append(MESSAGE_LOSS_LABEL)
    return ", ".join(labels)


def count_liars(experiment: Experiment) -> int:
    """Return how many robots broadcast false estimates; these are the last robots of the swarm."""
    return LIARS.get(firmware_name(experiment), 0)


def has_changing_floor(experiment: Experiment) -> bool:
    """Return whether f, the share of black floor, becomes FLOOR_AFTER_CHANGE in the middle of each trial.

    It holds for experiments on the grid and in hard worlds only.
    """
    # These have no other sensor class than ChangingFloor.
    return bool(experiment.sensor)


def has_message_loss(experiment: Experiment) -> bool:
    """Return whether the robots lose a share of the messages that they receive."""
    return firmware_name(experiment) == LossyRobot.__name__


def late_errors_of_honest_robots(trials: Trials) -> Sample:
    """Return the mean of |x - f| over the last quarter of each trial, over the robots that do not lie.

    x is a robot's estimate, and f is the share of black floor in that quarter: FLOOR_AFTER_CHANGE where the
    floor changes in the middle of the trial.
    """
    experiment = trials.experiment
    fill_ratio = experiment.fill_ratio
    if has_changing_floor(experiment):
        fill_ratio = FLOOR_AFTER_CHANGE
    return late_errors(trials, honest_robots=count_honest_robots(experiment), late_fill_ratio=fill_ratio)


def count_honest_robots(experiment: Experiment) -> int:
    """Return how many robots do not lie; these are the first robots of the swarm."""
    return experiment.robots - count_liars(experiment)


def grid_text(experiments: Sequence[Trials]) -> str:
    """Format the numbers of experiments that share one cell of the grid's table: "95.1, 0.012, 0.034, 0.5 %".

    These are H, the score from 0 to 100, the mean of |x - f| in the last quarter of a trial, e, the mean of
    |x - f| from convergence on, and the share of healthy robots that a filter harmed. The share is left out
    where all robots are flawed. An interval in brackets follows a number where it is wide.
    """
    # Beside the late error, e shows the beginnings: it counts from convergence on, which may come early.
    e = mean_of_medians(mean_e_of_robots, experiments).value
    texts = [score_text(experiments), late_error_text(experiments), format_error(e)]
    harmed_share = mean_of_means(harmed_shares, experiments)
    has_healthy_robots = not np.isnan(harmed_share.value)
    if has_healthy_robots:
        harmed_percent = Interval(
            value=100 * harmed_share.value, low=100 * harmed_share.low, high=100 * harmed_share.high
        )
        texts.append(f"{format_interval(harmed_percent, format_tenths, tolerance=1)} %")
    return ", ".join(texts)


def mean_e_of_robots(trials: Trials) -> Sample:
    """Return e of each trial, averaged over its robots: |x - f| from a robot's convergence on."""
    mean_e: Sample = trials.errors.mean(axis=1)
    return mean_e


def honest_robots_text(experiments: Sequence[Trials]) -> str:
    """Format the late error of the robots that do not lie, in underconfident and in overconfident swarms."""
    return under_and_over_text(experiments, late_errors_of_honest_robots)


def make_tables(
    grid: Sequence[Trials], beyond: Sequence[Trials], peers: Sequence[Trials], worlds: Sequence[Trials]
) -> dict[str, str]:
    """Return the four tables of docs/robust.md in Markdown, by the marks that the page has before them."""
    return {
        "grid": markdown_table(GRID_HEAD, grid, grid_row, column_label, grid_text),
        "beyond": markdown_table(PAIR_HEAD, beyond, beyond_row, column_label, under_and_over_text),
        "peers": markdown_table(PAIR_HEAD, peers, peer_row, column_label, under_and_over_text),
        "worlds": markdown_table(PAIR_HEAD, worlds, world_row, column_label, honest_robots_text),
    }


# --- Picture ---------------------------------------------------------------------------------------------


def draw_errors(grid: Sequence[Trials], worlds: Sequence[Trials]) -> Figure:
    """Draw |x - f|, the error of estimates, over time in moving swarms whose floor does not change.

    The panels of a row have the same kind of flawed robots: underconfident, then overconfident ones. The
    columns have 30 % flawed robots, 30 % flawed robots with 5 liars, and 50 % flawed robots.
    """
    trials_by_column = {
        "30 % flawed": [trials for trials in grid if flawed_label(trials.experiment) == "30 % flawed"],
        "30 % flawed and 5 liars": [trials for trials in worlds if count_liars(trials.experiment) == 5],
        "50 % flawed": [trials for trials in grid if flawed_label(trials.experiment) == "50 % flawed"],
    }
    panels: dict[str, list[Trials]] = {}
    for row, sensors in (("underconfident", UNDERCONFIDENT), ("overconfident", OVERCONFIDENT)):
        for column, experiments in trials_by_column.items():
            panels[f"{column}, {row}"] = [
                thin_out(trials) for trials in experiments if is_in_picture(trials.experiment, sensors)
            ]
    figure = plot_errors_over_time(panels)
    figure.supxlabel("step")  # instead of the caption, which the page has
    for axes in figure.axes:
        axes.minorticks_off()
    return figure


def is_in_picture(experiment: Experiment, sensors: Mapping[str, float]) -> bool:
    """Return whether an experiment has a moving swarm, a constant floor, and these values of parameters."""
    has_constant_floor = not has_changing_floor(experiment)
    return experiment.is_dynamic and has_constant_floor and has_parameters(experiment, sensors)


def has_parameters(experiment: Experiment, parameters: Mapping[str, float]) -> bool:
    """Return whether every attribute of an experiment that ``parameters`` names has the value given there."""
    return all(getattr(experiment, name) == value for name, value in parameters.items())


def thin_out(trials: Trials) -> Trials:
    """Return trials with x of the robots that do not lie as their only record, at fewer steps.

    The steps are POINTS_OF_A_CURVE + 1 of the recorded ones, at equal distances, with the first and the last.
    """
    honest_robots = count_honest_robots(trials.experiment)
    x = trials.records["x"][:, :, :honest_robots]
    indices = np.linspace(0, x.shape[1] - 1, POINTS_OF_A_CURVE + 1).astype(int)
    interval = trials.experiment.steps // POINTS_OF_A_CURVE
    return replace(trials, records={"x": x[:, indices]}, sampling_interval=interval)


def main() -> None:
    """Run the study's experiments, or resume them, and write robust.md and robust.png into the folder."""
    arguments = parse_arguments(__doc__)
    grid = run_experiments("robust_grid", m.read_experiments("robust_grid"), arguments)
    beyond = run_experiments("robust_beyond", m.read_experiments("robust_beyond"), arguments)
    # These run on their own, since experiments with a sensor class of this package use one process only.
    beyond += run_experiments("robust_wandering", wandering_experiments(), arguments)
    peers = run_experiments("robust_peers", peer_experiments(), arguments, record=500)
    worlds = run_experiments("robust_worlds", world_experiments(), arguments, record=500)
    write_tables(
        arguments.folder / "robust.md", "The robust filter", make_tables(grid, beyond, peers, worlds)
    )
    save_figure(draw_errors(grid, worlds), arguments.folder / "robust.png")


if __name__ == "__main__":
    main()
