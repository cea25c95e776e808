"""The findings of a cross-check, as tables for people and as plain data for machines."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from rich.console import Group
from rich.table import Table

from mcp_asdf_tools.crosscheck.compare import CrosscheckResult
from mcp_asdf_tools.crosscheck.operation_count import AXES, Counts, growing
from mcp_asdf_tools.crosscheck.oracle import Audit


@dataclass(frozen=True)
class Result:
    """A whole cross-check.

    Attributes:
        seed: Seed of the scenarios.
        outcome: What was run; its failure shortened.
        audit: Errors.
        counts: Instructions of the calls.
        storage: Bytes of tables and of saved robots, as ``measure_storage`` gives them.
    """

    seed: int
    outcome: CrosscheckResult
    audit: Audit
    counts: Counts
    storage: dict[str, dict[int, int]]

    @property
    def problems(self) -> list[str]:
        """Claims about time and memory that do not hold."""
        tables, images = self.storage["tables"], self.storage["images"]
        wrong = [
            f"a table with q = {q} takes {size} bytes" for q, size in tables.items() if size != 12 + 4 * q
        ]
        wrong += [f"robots take {sorted({*images.values()})} bytes"] if len({*images.values()}) != 1 else []
        return growing(self.counts) + wrong

    @property
    def is_good(self) -> bool:
        """True if no difference or problem was found."""
        return self.outcome.failure is None and not self.problems

    def as_dict(self) -> dict[str, Any]:
        """Everything, as plain data."""
        return {
            "ok": self.is_good,
            "seed": self.seed,
            "steps": self.outcome.calls,
            "scenarios": self.outcome.scenarios,
            "interrupted": self.outcome.interrupted,
            "failure": self.outcome.failure and self.outcome.failure.as_dict(),
            "problems": self.problems,
            **self.audit.as_dict(),
            "operations": self.counts,
            "storage": self.storage,
        }

    def tables(self) -> Group:
        """The measurements."""
        errors = [
            (row["quantity"], row["region"], row["samples"], f"{row['exact']:.2g}", f"{row['float64']:.2g}")
            for row in self.audit.as_dict()["errors"]
        ]
        counts = [
            (name, *(max(axes[axis].values(), default="-") for axis in AXES))
            for name, axes in self.counts.items()
        ]
        regions = "by region of |2 b_hat - 1|, for b_hat of |2 x_bar - 1|; those of alpha are relative"
        return Group(
            _table(f"largest errors {regions}", ("", "region", "samples", "exact", "float64"), errors),
            _table(
                "instructions of Python's interpreter per call, at most",
                ("", *map("over {}".format, AXES)),
                counts,
            ),
        )

    def verdict(self) -> str:
        """The conclusion; the last line replays a failure."""
        outcome = self.outcome
        lines = [
            f"memory: 12 + 4 q bytes for a table, {max(self.storage['images'].values())} for a saved robot",
            "the robust filter: "
            + ", ".join(f"{number} {name}" for name, number in sorted(self.audit.robust.items())),
            f"calls made and compared: {outcome.calls} in {outcome.scenarios} scenarios, seed {self.seed}"
            + (", interrupted" if outcome.interrupted else ""),
            *(f"FAILED: {problem}" for problem in self.problems),
            str(outcome.failure or "native and mirror agree in every bit"),
        ]
        return "\n".join(lines)


def _table(title: str, columns: tuple[str, ...], rows: list[tuple[Any, ...]]) -> Table:
    table = Table(title=f"\n{title}", title_justify="left", box=None, padding=(0, 1), pad_edge=False)
    for number, column in enumerate(columns):
        table.add_column(column, justify="right" if number else "left", no_wrap=True)
    for row in rows:
        table.add_row(*map(str, row))
    return table
