"""Show the results of a cross-check: tables and a verdict for people, plain data for machines."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass
from typing import Any

from rich.console import Group
from rich.table import Table

from mcp_asdf_tools.crosscheck.audit import Audit
from mcp_asdf_tools.crosscheck.checked_filters import CHECKED_FILTERS
from mcp_asdf_tools.crosscheck.compare import CrosscheckResult
from mcp_asdf_tools.crosscheck.operation_count import AXES, Counts, find_growth


@dataclass(frozen=True)
class CrosscheckReport:
    """Results of a cross-check, to be shown.

    Attributes:
        seed: Seed of the scenarios.
        result: Calls and scenarios that were run, and the failure, made as short as possible.
        audit: Errors of the results.
        counts: Instructions of the calls.
        storage: Bytes of tables and of saved robots, as from ``measure_storage``.
    """

    seed: int
    result: CrosscheckResult
    audit: Audit
    counts: Counts
    storage: dict[str, dict[int, int]]

    @property
    def problems(self) -> list[str]:
        """A line for each claim about time or memory that does not hold.

        The claims are that no call takes longer with more observations, messages or entries of the table;
        that a table takes 12 + 4 q bytes; and that all robots with one kind of filter take as many bytes.
        """
        problems = find_growth(self.counts)
        for q, size in self.storage["tables"].items():
            if size != 12 + 4 * q:
                problems.append(f"a table with q = {q} takes {size} bytes")
        for checked_filter in CHECKED_FILTERS:
            size_by_message_count = self.storage[checked_filter.images_key]
            different_sizes = sorted(set(size_by_message_count.values()))
            if len(different_sizes) != 1:
                problems.append(f"robots take {different_sizes} bytes")
        return problems

    @property
    def is_good(self) -> bool:
        """True if no scenario failed and all claims about time and memory hold."""
        return self.result.failure is None and not self.problems

    def as_dict(self) -> dict[str, Any]:
        """Return everything as plain data, for JSON.

        ``ok`` says whether all is good, and ``steps`` is the number of calls that were compared. The audit
        adds ``errors``, ``tests`` and, under ``robust``, the events of the robust filter.
        """
        failure = self.result.failure
        return {
            "ok": self.is_good,
            "seed": self.seed,
            "steps": self.result.calls,
            "scenarios": self.result.scenarios,
            "interrupted": self.result.interrupted,
            "failure": None if failure is None else failure.as_dict(),
            "problems": self.problems,
            **self.audit.as_dict(),
            "operations": self.counts,
            "storage": self.storage,
        }

    def tables(self) -> Group:
        """Return two tables for the terminal: of the largest errors, and of the instructions of calls."""
        return Group(self._error_table(), self._count_table())

    def _error_table(self) -> Table:
        """Return the largest errors by quantity and region, against exact fractions and against float64.

        Regions without a value are left out.
        """
        rows = []
        for row in self.audit.as_dict()["errors"]:
            exact_error, float64_error = f"{row['exact']:.2g}", f"{row['float64']:.2g}"
            rows.append((row["quantity"], row["region"], row["samples"], exact_error, float64_error))
        title = (
            "largest errors by region of |2 b_hat - 1|, for b_hat of |2 x_bar - 1|; "
            "those of alpha are relative"
        )
        return _format_table(title, ("", "region", "samples", "exact", "float64"), rows)

    def _count_table(self) -> Table:
        """Return the most instructions of each call along each axis. An axis without counts has "-"."""
        rows = []
        for call_name, count_by_axis in self.counts.items():
            largest_counts = [max(count_by_axis[axis].values(), default="-") for axis in AXES]
            rows.append((call_name, *largest_counts))
        columns = ("", *(f"over {axis}" for axis in AXES))
        return _format_table("instructions of Python's interpreter per call, at most", columns, rows)

    def verdict(self) -> str:
        """Return the conclusion in some lines; after a failure the last one replays it.

        The first three lines say how many bytes of memory are taken, how often the robust filter had which
        event, and how many calls were made. A line for each problem follows. Then comes the failure, or a
        line that says that both firmwares agree.
        """
        lines = [self._memory_line(), _format_events(self.audit.events), self._calls_line()]
        lines += [f"FAILED: {problem}" for problem in self.problems]
        failure = self.result.failure
        lines.append("native and mirror agree in every bit" if failure is None else str(failure))
        return "\n".join(lines)

    def _memory_line(self) -> str:
        """Return a line that says how many bytes a table takes, and a saved robot with each filter."""
        image_sizes = []
        for checked_filter in CHECKED_FILTERS:
            size = max(self.storage[checked_filter.images_key].values())
            filter_name = checked_filter.name  # empty for the paper's filters
            robot_text = f"with the {filter_name} filter" if filter_name else "for a saved robot"
            image_sizes.append(f"{size} {robot_text}")
        return f"memory: 12 + 4 q bytes for a table, {', '.join(image_sizes)}"

    def _calls_line(self) -> str:
        """Return a line that states the calls, scenarios and seed of the check, and an interruption."""
        result = self.result
        interruption = ", interrupted" if result.interrupted else ""
        return (
            f"calls made and compared: {result.calls} in {result.scenarios} scenarios, seed {self.seed}"
            f"{interruption}"
        )


def _format_events(events: Counter[str]) -> str:
    """Return a line that says how often the robust filter had each event: "the robust filter: 17 vote"."""
    counts = ", ".join(f"{number} {name}" for name, number in sorted(events.items()))
    return f"the robust filter: {counts}"


def _format_table(title: str, columns: tuple[str, ...], rows: list[tuple[Any, ...]]) -> Table:
    """Return a table without borders, whose first column is aligned left and the others right."""
    table = Table(title=f"\n{title}", title_justify="left", box=None, padding=(0, 1), pad_edge=False)
    first_column, *other_columns = columns
    table.add_column(first_column, justify="left", no_wrap=True)
    for column in other_columns:
        table.add_column(column, justify="right", no_wrap=True)
    for row in rows:
        table.add_row(*map(str, row))
    return table
