"""How few bits suffice in a message: errors of swarms with rounded messages, beside those with exact ones.

``python -m mcp_asdf_tools.studies.small_messages FOLDER`` writes ``small_messages.md`` and
``small_messages.png`` for docs/internals/small_messages.md.

Robots send x_hat, their estimate of f, the share of black floor, and its confidence alpha. Each is rounded to
a code of some bits (``mcp_asdf.small_messages``). The late error is the mean of |x - f| over the last quarter
of a trial, where x is a robot's estimate from its own observations and from messages.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from matplotlib.axes import Axes
from matplotlib.figure import Figure

import mcp_asdf_tools as m
from mcp_asdf_tools.common.figures import WIDTH, empty_figure, save_figure
from mcp_asdf_tools.experiments.experiment import Experiment
from mcp_asdf_tools.experiments.message_codes import EXACT, MessageCode
from mcp_asdf_tools.experiments.results import Trials
from mcp_asdf_tools.robots.filters import FILTERS
from mcp_asdf_tools.studies.bootstrap import (
    Interval,
    Resampled,
    largest_of_resampled,
    mean_of_resampled,
    resample_median,
)
from mcp_asdf_tools.studies.study_program import (
    MOVING_SWARM,
    PARAMETERS_BY_FLAW,
    Rows,
    late_error_text,
    late_errors,
    markdown_table,
    parse_arguments,
    run_rows,
    write_tables,
)
from mcp_asdf_tools.studies.text_tables import format_cells, format_table

X_HAT_BITS = (4, 5, 6, 7, 8, 16)
ALPHA_BITS = {"asdf-minus": (1, 2, 3, 4, 9), "robust": (1,)}
"""Bits of alpha by the filter. The robust filter only asks whether alpha is above 0, which one bit says."""

CLOSE_CODES = (MessageCode(7, 4), MessageCode(8, 4))
CLOSE_FILTER = "asdf-minus"
CLOSE_TRIALS = 600
"""Codes about which 30 trials leave open whether they suffice: the filter and the trials that decide it."""

_WORLDS: dict[str, dict[str, Any]] = {
    "moving": {**MOVING_SWARM, "robots": 20},
    "fully connected": {"robots": 10},
}
FILL_RATIOS = [0.55, 0.65, 0.75, 0.85, 0.95]
"""Shares of black floor: several, since some are nearer to a code of x_hat than others."""

SWARMS: dict[str, dict[str, Any]] = {
    f"{world}, {flaw}": {**_WORLDS[world], **PARAMETERS_BY_FLAW[flaw], "fill_ratio": FILL_RATIOS}
    for world in _WORLDS
    for flaw in PARAMETERS_BY_FLAW
}
"""Parameters of the four kinds of swarms."""

CONFIDENCE = 0.95
TOLERANCE = 1.1
"""A code suffices if errors are at most so many times the errors with exact messages, with its interval."""

RatiosByCode = Mapping[MessageCode, Interval]
"""How many times as large errors are with each code as with exact messages, where that is worst."""


def codes_of(filter_name: str) -> list[MessageCode]:
    """Return the codes with which a filter is run: all combinations of its bits of x_hat and of alpha."""
    return [
        MessageCode(x_hat_bits, alpha_bits)
        for x_hat_bits in X_HAT_BITS
        for alpha_bits in ALPHA_BITS[filter_name]
    ]


# --- Experiments -----------------------------------------------------------------------------------------


def row_label(message_bits: str, swarm: str) -> str:
    """Return the label of the experiments of a kind of swarm with messages of these bits, such as "7+4"."""
    return f"{message_bits}, {swarm}"


def experiments_of(
    filter_name: str, codes: Sequence[MessageCode] | None = None, trials: int = 30
) -> dict[str, list[Experiment]]:
    """Return the experiments of a filter by ``row_label``, with each code and with exact messages.

    Without ``codes`` they are those of ``codes_of``.
    """
    rows: dict[str, list[Experiment]] = {}
    tested_codes = codes or codes_of(filter_name)
    for message_bits in [EXACT, *(str(code) for code in tested_codes)]:
        for swarm, parameters in SWARMS.items():
            rows[row_label(message_bits, swarm)] = m.grid(
                **parameters,
                filter=filter_name,
                message_bits=message_bits,
                flawed="30%",
                steps=10_000,
                trials=trials,
                seed=4716,  # which no tuning has seen
            )
    return rows


# --- Measures --------------------------------------------------------------------------------------------


def late_error(rows: Rows, message_bits: str, swarm: str) -> Resampled:
    """Return the late error of a kind of swarm: the mean over f of its medians over the trials."""
    experiments = rows[row_label(message_bits, swarm)]
    return mean_of_resampled([resample_median(late_errors(trials)) for trials in experiments])


def worst_ratios(rows: Rows, codes: Sequence[MessageCode]) -> RatiosByCode:
    """Return the ratio of the late error with a code to that with exact messages, by code.

    The largest of the ratios of SWARMS is taken, with its interval of CONFIDENCE. Trials of one number had
    the same floor and random numbers, so what two errors have in common cancels in their ratio.
    """
    exact_errors = {swarm: late_error(rows, EXACT, swarm) for swarm in SWARMS}
    worst: dict[MessageCode, Interval] = {}
    for code in codes:
        ratios = [late_error(rows, str(code), swarm) / exact_errors[swarm] for swarm in SWARMS]
        worst[code] = largest_of_resampled(ratios).interval(CONFIDENCE)
    return worst


# --- Text and picture ------------------------------------------------------------------------------------


def ratio_text(ratio: Interval) -> str:
    """Format a ratio such as "1.02", in bold type if its interval ends at TOLERANCE or below."""
    text = f"{ratio.value:.2f}"
    return f"**{text}**" if ratio.high <= TOLERANCE else text


def ratio_table(ratios: RatiosByCode) -> str:
    """Return a table of ratios in Markdown.

    It has a row for each number of bits of x_hat, and a column for each number of bits of alpha.
    """
    text_by_cell: dict[tuple[str, str], str] = {}
    for code, ratio in ratios.items():
        row, column = f"x_hat {code.x_hat_bits}", f"alpha {code.alpha_bits}"
        text_by_cell[row, column] = ratio_text(ratio)
    return format_cells("bits", text_by_cell)


def exact_table(rows_by_filter: Mapping[str, Rows]) -> str:
    """Return a table in Markdown of late errors with exact messages.

    It has a row for each kind of swarm, and a column for each filter.
    """
    exact_rows: dict[str, list[Trials]] = {}
    for swarm in SWARMS:
        # The filters are the columns of this table: all their experiments with this swarm make one row.
        exact_rows[swarm] = []
        for rows in rows_by_filter.values():
            exact_rows[swarm] += rows[row_label(EXACT, swarm)]
    return markdown_table("error with exact messages", exact_rows, late_error_text)


def interval_table(ratios: RatiosByCode) -> str:
    """Return a table in Markdown of ratios and the ends of their intervals; each code has a row."""
    heads = ["bits of x_hat", "bits of alpha", "ratio", "at least", "at most"]
    rows: list[list[str]] = []
    for code, (ratio, at_least, at_most) in ratios.items():
        bits = [f"{code.x_hat_bits}", f"{code.alpha_bits}"]
        rows.append([*bits, f"{ratio:.2f}", f"{at_least:.2f}", f"{at_most:.2f}"])
    return format_table(heads, rows)


def draw_ratios(ratios_by_filter: Mapping[str, RatiosByCode]) -> Figure:
    """Draw the ratios of errors over the bits of x_hat.

    There is a panel for each filter, and in it a line for each number of bits of alpha. A dotted line is at
    TOLERANCE, the largest ratio that is good enough.
    """
    figure = empty_figure(WIDTH, 3.2)
    rows_of_panels = figure.subplots(nrows=1, ncols=len(ratios_by_filter), sharey=True, squeeze=False)
    [panels] = rows_of_panels  # there is a single row
    for axes, (filter_name, ratios) in zip(panels, ratios_by_filter.items(), strict=True):
        _draw_ratios_of_filter(axes, filter_name, ratios)
    panels[0].set_ylabel("error by that of exact messages")
    panels[0].legend(title="bits of")
    return figure


def _draw_ratios_of_filter(axes: Axes, filter_name: str, ratios: RatiosByCode) -> None:
    """Draw a filter's ratios over the bits of x_hat; each number of bits of alpha has a line."""
    for alpha_bits in ALPHA_BITS[filter_name]:
        ratio_values = [ratios[MessageCode(x_hat_bits, alpha_bits)].value for x_hat_bits in X_HAT_BITS]
        axes.plot(X_HAT_BITS, ratio_values, marker=".", label=f"alpha {alpha_bits}")
    axes.axhline(TOLERANCE, color="grey", linestyle=":")
    axes.set(title=FILTERS[filter_name].term, xlabel="bits of x_hat", yscale="log")


def main() -> None:
    """Run the experiments, or resume them, and write small_messages.md and small_messages.png."""
    arguments = parse_arguments(__doc__)
    rows_by_filter: dict[str, Rows] = {}
    ratios_by_filter: dict[str, RatiosByCode] = {}
    for filter_name in ALPHA_BITS:
        file_name = f"small_messages_{filter_name}"
        rows = run_rows(file_name, experiments_of(filter_name), arguments, record=250)
        rows_by_filter[filter_name] = rows
        ratios_by_filter[filter_name] = worst_ratios(rows, codes_of(filter_name))
    # Of these codes 30 trials leave open whether they suffice, so they run again in more trials.
    close_experiments = experiments_of(CLOSE_FILTER, CLOSE_CODES, CLOSE_TRIALS)
    close_rows = run_rows("small_messages_close", close_experiments, arguments, record=250)
    tables = {
        "exact": exact_table(rows_by_filter),
        "asdf_minus": ratio_table(ratios_by_filter["asdf-minus"]),
        "robust": ratio_table(ratios_by_filter["robust"]),
        "close": interval_table(worst_ratios(close_rows, CLOSE_CODES)),
    }
    write_tables(arguments.folder / "small_messages.md", "How few bits suffice", tables)
    save_figure(draw_ratios(ratios_by_filter), arguments.folder / "small_messages.png")


if __name__ == "__main__":
    main()
