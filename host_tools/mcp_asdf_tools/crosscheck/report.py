"""The findings of a cross-check, as tables for people and as plain data for machines."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from itertools import groupby
from typing import Any

from rich.console import Group
from rich.table import Table

from mcp_asdf_tools.crosscheck.compare import CrosscheckResult, Disagreement
from mcp_asdf_tools.crosscheck.operation_count import AXES, Counts, Storage, growing
from mcp_asdf_tools.crosscheck.oracle import PLACES, Audit
from mcp_asdf_tools.crosscheck.scenario import Scenario

_B_HAT, _X_BAR = "|2 b_hat - 1|", "|2 x_bar - 1|"
_TITLES = {
    "x_hat": ("x_hat", _B_HAT),
    "alpha": ("alpha, relative", _B_HAT),
    "small alpha": ("alpha below 1/2, in units of its grid 2^-24", _B_HAT),
    "x": ("x", _B_HAT),
    "b_hat": ("b_hat, from the exact x_bar", _X_BAR),
}
_LEGEND = (
    "Largest errors against exact arithmetic and their 99.9 percentiles, inside the scale and at its\n"
    "ends; last the largest errors against float64."
)


@dataclass(frozen=True)
class Failure:
    """A scenario and its finding, which shows at its last call."""

    scenario: Scenario
    finding: Disagreement

    def as_dict(self) -> dict[str, Any]:
        """As plain data."""
        calls = [str(call) for call in self.scenario.calls]
        return {"problems": list(self.finding.problems), "calls": calls, "replay": str(self.scenario)}

    def __str__(self) -> str:
        steps = enumerate((self.scenario.setup, *self.scenario.calls))
        lines = [f"FAILED at call {self.finding.calls}; of two values that differ the first is native's"]
        lines += [f"  {number:3d}  {step}" for number, step in steps]
        lines += [f"  wrong: {problem}" for problem in self.finding.problems]
        return "\n".join([*lines, f"replay: mcp-asdf crosscheck --replay {self.scenario}"])


@dataclass(frozen=True)
class Result:
    """A whole cross-check."""

    seed: int
    outcome: CrosscheckResult
    failure: Failure | None
    audit: Audit
    counts: Counts
    storage: Storage

    @property
    def problems(self) -> list[str]:
        """Claims about time and memory that do not hold."""
        return growing(self.counts) + self.storage.problems()

    @property
    def is_good(self) -> bool:
        """True if no difference or problem was found."""
        return self.failure is None and not self.problems

    def as_dict(self) -> dict[str, Any]:
        """Everything, as plain data."""
        return {
            "ok": self.is_good,
            "seed": self.seed,
            "steps": self.outcome.calls,
            "scenarios": self.outcome.scenarios,
            "interrupted": self.outcome.interrupted,
            "failure": None if self.failure is None else self.failure.as_dict(),
            "problems": self.problems,
            **self.audit.as_dict(),
            "operations": self.counts,
            "storage": asdict(self.storage),
        }

    def tables(self) -> Group:
        """The measurements."""
        collected = self.audit.as_dict()
        return Group(
            _errors(collected["errors"]), _decisions(collected["decisions"]), _operations(self.counts)
        )

    def verdict(self) -> str:
        """The conclusion; the last line replays a failure."""
        outcome = self.outcome
        lines = [
            f"memory: 12 + 4 q bytes for a table, {self.storage.images[0]} for a saved robot",
            f"calls made and compared: {outcome.calls} in {outcome.scenarios} scenarios, seed {self.seed}"
            + (", interrupted" if outcome.interrupted else ""),
            *(f"FAILED: {problem}" for problem in self.problems),
            "native and mirror agree in every bit" if self.failure is None else str(self.failure),
        ]
        return "\n".join(lines)


def _errors(rows: list[dict[str, Any]]) -> Group:
    columns = [name for place in PLACES for name in (place, "99.9 %")]
    tables = []
    for quantity, group in groupby(rows, key=lambda row: row["quantity"]):
        table = _table(*_TITLES[quantity])
        for name in (*columns, "float64"):
            table.add_column(name, justify="right", width=7)
        for region, same in groupby(group, key=lambda row: row["region"]):
            table.add_row(region, *_error_cells({row["place"]: row for row in same}))
        tables.append(table)
    return Group(_LEGEND, *tables)


def _error_cells(places: dict[str, dict[str, Any]]) -> list[str]:
    cells = []
    for place in PLACES:
        exact = places[place]["exact"] if place in places else None
        cells += ["", ""] if exact is None else [f"{exact['max']:.2g}", f"{exact['p99.9']:.2g}"]
    return [*cells, f"{max(row['float64']['max'] for row in places.values()):.2g}"]


def _decisions(tallies: dict[str, dict[str, Any]]) -> Table:
    table = _table("hypothesis tests, decided by the table and by the true threshold", "")
    for name in ("tests", "decided otherwise", "nearest to it", "table's limit"):
        table.add_column(name, justify="right")
    for kind, tally in tallies.items():
        distances = (f"{tally[name]:.2g}" for name in ("nearest", "limit"))
        table.add_row(kind, str(tally["tests"]), str(tally["disagreements"]), *distances)
    return table


def _operations(counts: Counts) -> Table:
    table = _table("instructions of Python's interpreter per call, at most", "")
    for axis in AXES:
        table.add_column(f"over {axis}", justify="right")
    for name, axes in counts.items():
        table.add_row(name, *(str(max(axes[axis].values())) for axis in AXES))
    return table


def _table(title: str, first: str) -> Table:
    table = Table(title=f"\n{title}", title_justify="left", box=None, padding=(0, 1), pad_edge=False)
    table.add_column(first, no_wrap=True, min_width=13)
    return table
