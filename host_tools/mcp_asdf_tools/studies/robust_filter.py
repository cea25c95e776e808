"""The robust filter beside the paper's: on the paper's grid, beyond it, beside peers and in hard worlds.

``python -m mcp_asdf_tools.studies.robust_filter FOLDER`` writes tables into ``robust.md``, and the picture of
docs/internals/robust.md into ``robust.png``. The picture comes first, after the grid and the hard worlds.
The peers run message by message, which takes hours.

Each robot estimates f, the share of black floor, as x. b_hat is the accuracy that it assumes for its sensor,
and b the true one; a flawed robot starts with a wrong b_hat. The late error is the mean of |x - f| over the
last quarter of a trial. e is |x - f| at the step at which a robot has converged.
"""

from __future__ import annotations

import random
from collections.abc import Sequence
from dataclasses import replace
from typing import Any

from matplotlib.figure import Figure

import mcp_asdf_tools as m
from mcp_asdf_tools.common.figures import save_figure
from mcp_asdf_tools.experiments.error_plot import plot_errors_over_time
from mcp_asdf_tools.experiments.experiment import Experiment
from mcp_asdf_tools.experiments.results import Trials, select_experiments
from mcp_asdf_tools.studies.ageing_sensors import DRIFT_RATE, WanderingSensors
from mcp_asdf_tools.studies.bootstrap import Sample
from mcp_asdf_tools.studies.peers import (
    FLOOR_AFTER_CHANGE,
    LIAR_COUNT_BY_FIRMWARE,
    BayesCpfRobot,
    ChangingFloor,
    LossyRobot,
    RememberingRobot,
    firmware_name,
    five_liars,
    one_liar,
    two_liars,
)
from mcp_asdf_tools.studies.study_program import (
    ALL_FILTERS,
    BOTH_FLAWS,
    FILTERS_OF_HEALTHY_SWARMS,
    MOVING_SWARM,
    PARAMETERS_BY_FLAW,
    Rows,
    format_error,
    format_interval,
    format_tenths,
    late_error_text,
    markdown_table,
    mean_harmed_percent,
    mean_over_experiments,
    parse_arguments,
    run_rows,
    score_text,
    under_and_over_text,
    write_tables,
)

GRID_HEAD = "H, error of the last quarter, e, healthy robots harmed"
ERRORS_HEAD = "errors of the last quarter, underconfident and overconfident, then healthy robots harmed"

SLOW_SPEED = 0.007
"""Speed in m/s with which a robot takes many readings of one tile, and meets few others."""

ROBOTS_OF_STATIC_GRAPHS = 20

# --- Experiments -----------------------------------------------------------------------------------------
# m.grid makes experiments of all combinations of the values in lists. The dictionaries in a list, as in
# "sensors", hold parameters that vary together.


def grid_rows() -> dict[str, list[Experiment]]:
    """Return the experiments of the paper's grid by the label of their row, such as "moving, 10 % flawed".

    There are two topologies, each with five shares of flawed robots.
    """
    healthy: dict[str, Any] = {
        "flawed": "0%",
        "true_accuracy": [0.55, 0.95],
        "filter": FILTERS_OF_HEALTHY_SWARMS,
    }
    # Which of the paper's b_hat are wrong depends on b. Each experiment has the parameters of one table.
    flaws = [
        {"true_accuracy": 0.95, "flawed_accuracy": [0.55, 0.75]},
        {"true_accuracy": 0.55, "flawed_accuracy": [0.75, 0.95]},
    ]
    swarms: dict[str, dict[str, Any]] = {
        f"{percent} % flawed": {"flawed": f"{percent}%", "sensors": flaws, "filter": ALL_FILTERS}
        for percent in (10, 30, 50, 100)
    }
    swarms["0 % flawed"] = healthy
    topologies: dict[str, dict[str, Any]] = {"moving": MOVING_SWARM, "fully connected": {"robots": 10}}
    rows: dict[str, list[Experiment]] = {}
    for topology, topology_parameters in topologies.items():
        for label, swarm in swarms.items():
            rows[f"{topology}, {label}"] = m.grid(
                **topology_parameters,
                **swarm,
                fill_ratio=[0.55, 0.95],
                steps=40_000,
                trials=30,
                seed=4711,
            )
    return rows


def beyond_rows() -> dict[str, list[Experiment]]:
    """Return experiments, by the label of their row, of swarms, worlds and sensors beyond the paper's grid.

    Each label names what is not as in the paper's moving swarms.
    """
    flawed: dict[str, Any] = {"flawed": "30%", "sensors": BOTH_FLAWS, "filter": ALL_FILTERS}
    healthy: dict[str, Any] = {"flawed": "0%", "fill_ratio": 0.75, "filter": FILTERS_OF_HEALTHY_SWARMS}
    worse_on_white: dict[str, Any] = {"sensors": [PARAMETERS_BY_FLAW["underconfident"]], "white_offset": -0.1}
    # Robots that never move, each with four neighbours.
    ring: dict[str, Any] = {"topology": "graph", "graph": static_graph((1, 2)), "latency": 1}
    # Four rows of five robots: the end of a row is joined to the start of the next one.
    grid: dict[str, Any] = {"topology": "graph", "graph": static_graph((1, 5)), "latency": 1}
    swarms: dict[str, dict[str, Any]] = {
        "moving, latency 0": {"topology": "dynamic", **flawed},
        "moving": {**MOVING_SWARM, **flawed},
        "moving, density 0.25": {**MOVING_SWARM, **flawed, "density": 0.25},
        "moving, density 4": {**MOVING_SWARM, **flawed, "density": 4.0},
        "moving slowly": {**MOVING_SWARM, **flawed, "speed": SLOW_SPEED},
        "moving slowly, 0 % flawed": {
            **MOVING_SWARM,
            "flawed": "0%",
            "sensors": BOTH_FLAWS,
            "filter": FILTERS_OF_HEALTHY_SWARMS,
            "speed": SLOW_SPEED,
        },
        "static ring": {**flawed, **ring},
        "static grid": {**flawed, **grid},
        "moving, 3 robots": {**MOVING_SWARM, **flawed, "robots": 3},
        "moving, 5 robots": {**MOVING_SWARM, **flawed, "robots": 5},
        "moving, 10 robots": {**MOVING_SWARM, **flawed, "robots": 10},
        "moving, 127 robots": {**MOVING_SWARM, **flawed, "robots": 127},
        "fully connected, 3 robots": {**flawed, "robots": 3},
        "fully connected, 5 robots": {**flawed, "robots": 5},
        "fully connected": flawed,
        "fully connected, 127 robots": {**flawed, "robots": 127, "trials": 12},
        "moving, b -0.1 on white": {**MOVING_SWARM, **flawed, **worse_on_white},
        "moving, sensors age alike": {**MOVING_SWARM, **healthy, "drift": "linear", "drift_rate": DRIFT_RATE},
        "moving, sensors age each in its own way": {**MOVING_SWARM, **healthy, "sensor": WanderingSensors},
    }
    common = {"steps": 20_000, "trials": 30, "seed": 4712}
    # A row's own value for a parameter replaces the common one.
    return {label: m.grid(**{**common, **swarm}) for label, swarm in swarms.items()}


def static_graph(steps_to_neighbours: Sequence[int]) -> str:
    """Return a graph of 20 robots on a circle, who hear those at some distances before and after them.

    ``steps_to_neighbours`` are the distances, in places on the circle. The result has an edge such as "3 5"
    for each pair that hear each other, with "; " between edges. The flawed robots of an experiment are its
    first ones, so robots stand in a random order, always the same one.
    """
    robots = range(ROBOTS_OF_STATIC_GRAPHS)
    circle = random.Random(1).sample(robots, len(robots))  # all of them, in a random order
    edges = []
    for position, robot in enumerate(circle):
        for step in steps_to_neighbours:
            position_of_neighbour = (position + step) % ROBOTS_OF_STATIC_GRAPHS
            edges.append(f"{robot} {circle[position_of_neighbour]}")
    return "; ".join(edges)


def peer_rows() -> dict[str, list[Experiment]]:
    """Return experiments, by the label of their row, with peers and with the usual filters.

    A peer is a robot class with another filter than the project's; it stands in place of the firmware.
    BayesCPF runs with any filter but none; with asdf-plus it runs in all robots.
    """
    # Each experiment has the parameters of one of these tables.
    filters = [
        {"firmware": RememberingRobot, "filter": ["none", "asdf-minus"]},
        {"firmware": BayesCpfRobot, "filter": "asdf-plus"},
        {"filter": ALL_FILTERS},
    ]
    swarms: dict[str, dict[str, Any]] = {
        "moving, 0 % flawed": {**MOVING_SWARM, "flawed": "0%", "steps": 20_000},
        "moving, 30 % flawed": {**MOVING_SWARM, "flawed": "30%", "steps": 20_000},
        "fully connected, 30 % flawed, 10,000 steps": {"robots": 10, "flawed": "30%", "steps": 10_000},
    }
    return {
        label: m.grid(**swarm, sensors=BOTH_FLAWS, filters=filters, trials=8, seed=4713)
        for label, swarm in swarms.items()
    }


def world_rows() -> dict[str, list[Experiment]]:
    """Return experiments, by the label of their row, with liars, lost messages, and a floor that changes.

    In a fully connected swarm one liar misleads everybody, so a few experiments show enough. Firmware such as
    ``one_liar`` makes the last robots of a swarm lie.
    """
    connected_swarm: dict[str, Any] = {
        "sensors": [PARAMETERS_BY_FLAW["underconfident"]],
        "filter": FILTERS_OF_HEALTHY_SWARMS,
        "trials": 12,
    }
    # With the longest memory the old floor would be forgotten too slowly to see anything.
    changing_floor: dict[str, Any] = {
        **MOVING_SWARM,
        "sensors": [PARAMETERS_BY_FLAW["underconfident"]],
        "sensor": ChangingFloor,
        "memory": 4096,
        "steps": 40_000,
        "filter": ["none", "robust"],
    }
    moving_swarm: dict[str, Any] = {**MOVING_SWARM, "sensors": BOTH_FLAWS, "filter": ALL_FILTERS}
    worlds: dict[str, dict[str, Any]] = {
        "fully connected, 1 liar": {**connected_swarm, "firmware": one_liar},
        "fully connected, 5 liars": {**connected_swarm, "firmware": five_liars},
        "moving, the floor changes": {**changing_floor, "filter": FILTERS_OF_HEALTHY_SWARMS},
        "moving, the floor changes, 2 liars": {**changing_floor, "firmware": two_liars},
        "moving, the floor changes, 5 liars": {**changing_floor, "firmware": five_liars},
        "moving, 3 messages of 10 lost": {**moving_swarm, "firmware": LossyRobot},
        "moving, 1 liar": {**moving_swarm, "firmware": one_liar},
        "moving, 2 liars": {**moving_swarm, "firmware": two_liars},
        "moving, 5 liars": {**moving_swarm, "firmware": five_liars},
        "moving, 5 liars, 0 % flawed": {
            **moving_swarm,
            "firmware": five_liars,
            "flawed": "0%",
            "filter": FILTERS_OF_HEALTHY_SWARMS,
        },
    }
    common = {"flawed": "30%", "steps": 20_000, "trials": 8, "seed": 4713}
    # A row's own value for a parameter replaces the common one.
    return {label: m.grid(**{**common, **world}) for label, world in worlds.items()}


# --- Tables ----------------------------------------------------------------------------------------------


def as_honest_robots_see_it(trials: Trials) -> Trials:
    """Return trials without the values of the robots that lie, and with the share of black floor at the end.

    This is done for x and b_hat; other records are dropped, and all other results still cover all robots.
    Where the floor changes in the middle of a trial, the share at the end is FLOOR_AFTER_CHANGE.
    """
    experiment = trials.experiment
    liar_count = LIAR_COUNT_BY_FIRMWARE.get(firmware_name(experiment), 0)
    honest_robots = experiment.robots - liar_count  # which have the lowest ids
    # Axes are trials, recorded steps or filter steps, and robots.
    x = trials.records["x"][:, :, :honest_robots]
    b_hat = trials.b_hat[:, :, :honest_robots]
    if experiment.sensor:  # in ``world_rows`` a sensor of its own is always ChangingFloor
        experiment = replace(experiment, fill_ratio=FLOOR_AFTER_CHANGE)
    return replace(trials, experiment=experiment, b_hat=b_hat, records={"x": x})


def without_liars(rows: Rows) -> dict[str, list[Trials]]:
    """Return the results of rows without the robots that lie: x and b_hat of the honest robots alone.

    Where the floor changes in a trial, the experiments have the share of black floor at its end.
    """
    return {
        label: [as_honest_robots_see_it(trials) for trials in experiments]
        for label, experiments in rows.items()
    }


def grid_text(experiments: Sequence[Trials]) -> str:
    """Format the numbers of experiments that share one cell of the grid's table: "95.1, 0.012, 0.034, 0.5 %".

    These are H, the score from 0 to 100, the mean of |x - f| in the last quarter of a trial, e, which is
    |x - f| when a robot has converged, and the share of healthy robots that a filter harmed. The share is
    left out where all robots are flawed. An interval in brackets follows a number where it is wide.
    """
    e = mean_over_experiments(mean_e_of_robots, experiments).value
    # Convergence may come early, so that e shows the beginnings, and the late error the end.
    texts = [score_text(experiments), late_error_text(experiments), format_error(e)]
    return ", ".join([*texts, *harm_texts(experiments)])


def errors_text(experiments: Sequence[Trials]) -> str:
    """Format the numbers of experiments that share one cell of the other tables: "0.012, 0.034, 0.5 %".

    These are the late errors of the underconfident and of the overconfident swarms, and the share of healthy
    robots that a filter harmed, in both. One that the experiments do not have is left out.
    """
    return ", ".join([under_and_over_text(experiments), *harm_texts(experiments)])


def harm_texts(experiments: Sequence[Trials]) -> list[str]:
    """Format the percentage of healthy robots that a filter harmed, such as ["4.2 (2.9..5.6) %"].

    The list is empty if all robots of these experiments are flawed, so that there are no healthy ones.
    """
    harmed_percent = mean_harmed_percent(experiments)
    if harmed_percent is None:
        return []
    # An end of the interval within one percentage point is too near to be worth its room in a table.
    return [f"{format_interval(harmed_percent, format_tenths, tolerance=1)} %"]


def mean_e_of_robots(trials: Trials) -> Sample:
    """Return e of each trial, averaged over its robots: |x - f| at a robot's convergence step."""
    mean_e: Sample = trials.errors.mean(axis=1)
    return mean_e


def make_tables(grid: Rows, beyond: Rows, peers: Rows, worlds: Rows) -> dict[str, str]:
    """Return the four tables of the study in Markdown by name: "grid", "beyond", "peers" and "worlds"."""
    return {
        "grid": markdown_table(GRID_HEAD, grid, grid_text),
        "beyond": markdown_table(ERRORS_HEAD, beyond, errors_text),
        "peers": markdown_table(ERRORS_HEAD, peers, errors_text),
        "worlds": markdown_table(ERRORS_HEAD, worlds, errors_text),
    }


# --- Picture ---------------------------------------------------------------------------------------------


def draw_errors(grid: Rows, worlds: Rows) -> Figure:
    """Draw |x - f|, the error of estimates, over time in moving swarms whose floor does not change.

    ``grid`` and ``worlds`` are the results of ``grid_rows`` and ``world_rows``. The upper panels have
    underconfident flawed robots, the lower ones overconfident ones. The columns have 30 % flawed robots, 30 %
    flawed robots with 5 liars, and 50 % flawed robots.
    """
    columns = {
        "30 % flawed": grid["moving, 30 % flawed"],
        "30 % flawed and 5 liars": worlds["moving, 5 liars"],
        "50 % flawed": grid["moving, 50 % flawed"],
    }
    panels: dict[str, list[Trials]] = {}
    for flaw, flaw_parameters in PARAMETERS_BY_FLAW.items():  # a row of panels for each kind of flaws
        for column, experiments in columns.items():
            panels[f"{column}, {flaw}"] = select_experiments(experiments, where=flaw_parameters)
    figure = plot_errors_over_time(panels)
    figure.supxlabel("step")  # instead of the caption, which the page has
    return figure


def main() -> None:
    """Run the study's experiments, or resume them, and write robust.md and robust.png into the folder."""
    arguments = parse_arguments(__doc__)
    grid = run_rows("robust_grid", grid_rows(), arguments)
    all_worlds = run_rows("robust_worlds", world_rows(), arguments, record=500)
    worlds = without_liars(all_worlds)
    # The picture does not have to wait for the peers, which take hours.
    save_figure(draw_errors(grid, worlds), arguments.folder / "robust.png")
    beyond = run_rows("robust_beyond", beyond_rows(), arguments)
    peers = run_rows("robust_peers", peer_rows(), arguments, record=500)
    tables = make_tables(grid, beyond, peers, worlds)
    write_tables(arguments.folder / "robust.md", "The robust filter", tables)


if __name__ == "__main__":
    main()
