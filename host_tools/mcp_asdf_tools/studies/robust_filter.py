"""The robust filter beside the paper's, with flawed robots and with liars: errors at the end and over time.

``python -m mcp_asdf_tools.studies.robust_filter FOLDER`` writes ``robust.md`` and ``robust.png``; the picture
is for docs/internals/robust.md. The tables of that page come from tests/benchmarks/robust_judge.

Each robot estimates f, the share of black floor, as x. b_hat is the accuracy that it assumes for its sensor,
and b the true one; a flawed robot starts with a wrong b_hat. Liars say that no tile is black, and are not
counted in any number.
"""

from __future__ import annotations

from typing import Any

from mcp_asdf_tools.common.figures import save_figure
from mcp_asdf_tools.experiments.experiment import Experiment
from mcp_asdf_tools.studies.peers import five_liars
from mcp_asdf_tools.studies.study_program import (
    ALL_FILTERS,
    LATE_ERROR_HEAD,
    MOVING_SWARM,
    late_error_text,
    markdown_table,
    parse_arguments,
    plot_errors_of_swarms,
    rows_of_swarms,
    run_rows,
    write_tables,
)

HONEST_SWARM: dict[str, Any] = {"steps": 40_000, "trials": 30, "seed": 4711}
# Liars run message by message, which takes longer.
SWARM_WITH_LIARS: dict[str, Any] = {"steps": 20_000, "trials": 8, "seed": 4713, "firmware": five_liars}

SWARMS: dict[str, dict[str, Any]] = {
    "30 % flawed": {**HONEST_SWARM, "flawed": "30%"},
    "30 % flawed and 5 liars": {**SWARM_WITH_LIARS, "flawed": "30%"},
    "50 % flawed": {**HONEST_SWARM, "flawed": "50%"},
}
"""Parameters of the swarms by the labels of rows; no tuning has seen their seeds."""


def robust_rows() -> dict[str, list[Experiment]]:
    """Return the experiments of each row by its label: moving swarms of SWARMS with one kind of flaws."""
    return rows_of_swarms(SWARMS, **MOVING_SWARM, filter=ALL_FILTERS)


def main() -> None:
    """Run the experiments, or resume them, and write robust.md and robust.png into the folder."""
    arguments = parse_arguments(__doc__)
    rows = run_rows("robust", robust_rows(), arguments)
    tables = {"errors": markdown_table(LATE_ERROR_HEAD, rows, late_error_text)}
    write_tables(arguments.folder / "robust.md", "The robust filter", tables)
    save_figure(plot_errors_of_swarms(rows, list(SWARMS)), arguments.folder / "robust.png")


if __name__ == "__main__":
    main()
