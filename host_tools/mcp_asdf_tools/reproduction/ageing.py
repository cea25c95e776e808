"""The study of sensors that age, which the paper leaves open: the error at the end, and over time."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from mcp_asdf_tools.experiments.experiment import Experiment
from mcp_asdf_tools.experiments.results import Trials
from mcp_asdf_tools.reproduction.robust import LATE, in_markdown, late, table_of, write_page

if TYPE_CHECKING:
    from matplotlib.figure import Figure

FILES = ("ageing",)
LONGEST = 2**31
"""Memory of a robot that forgets nothing."""


def kind_of(experiment: Experiment) -> str:
    """How the sensors of an experiment age."""
    if experiment.drift_of == "flawed":
        return f"{experiment.flawed} of {experiment.robots} age alike"
    if experiment.drift_spread:
        return "all age, some faster"
    kinds = {"none": "none ages", "linear": "all age alike", "stepped": "all age at once"}
    return kinds.get(experiment.drift, "each ages in its own way")


def row_of(experiment: Experiment) -> str:
    """How sensors age, and what robots remember."""
    memory = "longest" if experiment.memory == LONGEST else "short"
    return f"{kind_of(experiment)}, {memory} memory"


def picture_of(results: Mapping[str, Sequence[Trials]]) -> Figure:
    """The error over time of robots with the longest memory: a panel for each way to age."""
    from mcp_asdf_tools.experiments.plots import errors_over_time  # noqa: PLC0415 (matplotlib loads slowly)

    panels: dict[str, list[Trials]] = {}
    for each in results["ageing"]:
        if each.experiment.memory == LONGEST:
            panels.setdefault(kind_of(each.experiment), []).append(each)
    return errors_over_time(panels)


def write_report(folder: Path, results: Mapping[str, Sequence[Trials]]) -> None:
    """Write ``ageing.md`` and ``ageing.csv``, the late error, and ``ageing.svg``, the picture."""
    table = table_of("Sensors that age", results["ageing"], row_of)
    lines = in_markdown(table.entries, late, f"{LATE} (95 % interval)")
    write_page(folder, "ageing", table, lines, picture_of(results))
