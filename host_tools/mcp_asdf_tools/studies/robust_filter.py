"""The robust filter beside the paper's: on the paper's grid, beyond it, beside peers and in hard worlds.

``python -m mcp_asdf_tools.studies.robust_filter FOLDER`` writes ``robust.md`` and ``robust.png``, which
docs/robust.md shows. The peers run message by message in one process, which takes hours.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
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

POINTS_OF_A_CURVE = 16


# --- Experiments -----------------------------------------------------------------------------------------


def wandering_experiments() -> list[Experiment]:
    """Return the experiments beyond the grid with sensors that age each in its own way."""
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
    """Return experiments with the peers, and with the filters in the same worlds."""
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
    """Return experiments with liars, with messages that are lost, and with a floor that changes."""
    common = {"steps": 20_000, "seed": 4713, "trials": 8, "flawed": "30%"}
    # Where all hear all, one liar is enough to mislead everybody, so few cases tell enough.
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
    """Return the row of an experiment on the paper's grid."""
    return f"{topology_label(experiment)}, {flawed_label(experiment)}"


def beyond_row(experiment: Experiment) -> str:
    """Return what sets an experiment beyond the grid apart from 20 robots at density 1, 30 % flawed."""
    labels = [topology_label(experiment)]
    # The order is that of the rows in docs/robust.md, which are found by their names.
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
    """Return the row of an experiment with a peer."""
    length = ", 10,000 steps" if experiment.steps == 10_000 else ""
    return grid_row(experiment) + length


def world_row(experiment: Experiment) -> str:
    """Return what is hard in the world of an experiment."""
    labels = [topology_label(experiment)]
    if has_changing_floor(experiment):
        labels.append("the floor changes")
    liars = count_liars(experiment)
    if liars:
        labels.append("1 liar" if liars == 1 else f"{liars} liars")
    if firmware_name(experiment) == LossyRobot.__name__:
        labels.append("3 messages of 10 lost")
    return ", ".join(labels)


def count_liars(experiment: Experiment) -> int:
    """Return how many of the last robots lie."""
    return LIARS.get(firmware_name(experiment), 0)


def has_changing_floor(experiment: Experiment) -> bool:
    """Return whether the floor changes in the middle of the trials."""
    return bool(experiment.sensor)


def late_errors_of_honest_robots(trials: Trials) -> Sample:
    """Return the late error of the robots that do not lie, relative to the floor as it is then."""
    experiment = trials.experiment
    honest = experiment.robots - count_liars(experiment)
    fill_ratio = FLOOR_AFTER_CHANGE if has_changing_floor(experiment) else experiment.fill_ratio
    return late_errors(trials, honest, fill_ratio)


def grid_text(experiments: Sequence[Trials]) -> str:
    """Format score, late error, e and the share of harmed robots of experiments in one cell of the table."""
    # e counts from the convergence step on, so it includes the beginnings of a rule that settles early.
    e = mean_of_medians(lambda trials: trials.errors.mean(axis=1), experiments).value
    texts = [score_text(experiments), late_error_text(experiments), format_error(e)]
    harmed = mean_of_means(harmed_shares, experiments)
    if not np.isnan(harmed.value):  # there are healthy robots
        harmed_percent = Interval(*(100 * share for share in harmed))
        texts.append(f"{format_interval(harmed_percent, format_tenths, 1)} %")
    return ", ".join(texts)


def make_tables(
    grid: Sequence[Trials], beyond: Sequence[Trials], peers: Sequence[Trials], worlds: Sequence[Trials]
) -> dict[str, str]:
    """Return the tables of docs/robust.md by their marks."""

    def honest_text(experiments: Sequence[Trials]) -> str:
        return under_and_over_text(experiments, late_errors_of_honest_robots)

    return {
        "grid": markdown_table(GRID_HEAD, grid, grid_row, column_label, grid_text),
        "beyond": markdown_table(PAIR_HEAD, beyond, beyond_row, column_label, under_and_over_text),
        "peers": markdown_table(PAIR_HEAD, peers, peer_row, column_label, under_and_over_text),
        "worlds": markdown_table(PAIR_HEAD, worlds, world_row, column_label, honest_text),
    }


# --- Picture ---------------------------------------------------------------------------------------------


def draw_errors(grid: Sequence[Trials], worlds: Sequence[Trials]) -> Figure:
    """Draw errors of moving swarms over time: a column for each of three worlds, a row for each flaw."""
    # Each column has its experiments, and a condition by which they are chosen.
    columns: dict[str, tuple[Sequence[Trials], Callable[[Experiment], bool]]] = {
        "30 % flawed": (grid, lambda experiment: 10 * experiment.flawed == 3 * experiment.robots),
        "30 % flawed and 5 liars": (worlds, lambda experiment: count_liars(experiment) == 5),
        "50 % flawed": (grid, lambda experiment: 2 * experiment.flawed == experiment.robots),
    }
    panels = {}
    for row, sensors in (("underconfident", UNDERCONFIDENT), ("overconfident", OVERCONFIDENT)):
        for column, (experiments, belongs_to_column) in columns.items():
            panels[f"{column}, {row}"] = [
                thin_out(trials)
                for trials in experiments
                if trials.experiment.is_dynamic
                and has_parameters(trials.experiment, sensors)
                and belongs_to_column(trials.experiment)
                and not has_changing_floor(trials.experiment)
            ]
    figure = plot_errors_over_time(panels)
    figure.supxlabel("step")  # instead of the caption, which the page has
    for axes in figure.axes:
        axes.minorticks_off()
    return figure


def has_parameters(experiment: Experiment, parameters: Mapping[str, float]) -> bool:
    """Return whether an experiment has these values of parameters."""
    return all(getattr(experiment, name) == value for name, value in parameters.items())


def thin_out(trials: Trials) -> Trials:
    """Return trials without the liars, and with only as many values over time as a curve shows."""
    honest = trials.experiment.robots - count_liars(trials.experiment)
    x = trials.records["x"][:, :, :honest]
    indices = np.linspace(0, x.shape[1] - 1, POINTS_OF_A_CURVE + 1).astype(int)
    interval = trials.experiment.steps // POINTS_OF_A_CURVE
    return replace(trials, records={"x": x[:, indices]}, sampling_interval=interval)


def main() -> None:
    """Run the experiments and write tables and picture."""
    arguments = parse_arguments(__doc__)
    grid = run_experiments("robust_grid", m.read_experiments("robust_grid"), arguments)
    beyond = run_experiments("robust_beyond", m.read_experiments("robust_beyond"), arguments)
    # Apart, since sensors of this package run in one process.
    beyond += run_experiments("robust_wandering", wandering_experiments(), arguments)
    peers = run_experiments("robust_peers", peer_experiments(), arguments, record=500)
    worlds = run_experiments("robust_worlds", world_experiments(), arguments, record=500)
    write_tables(
        arguments.folder / "robust.md", "The robust filter", make_tables(grid, beyond, peers, worlds)
    )
    save_figure(draw_errors(grid, worlds), arguments.folder / "robust.png")


if __name__ == "__main__":
    main()
