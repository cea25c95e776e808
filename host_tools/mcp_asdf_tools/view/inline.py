"""A run inside a notebook."""

from __future__ import annotations

import html
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from mcp_asdf_tools.common.errors import UsageError
from mcp_asdf_tools.common.extras import naming_extras
from mcp_asdf_tools.common.files import write_atomically
from mcp_asdf_tools.experiments.experiment import Experiment
from mcp_asdf_tools.experiments.results import experiments_in, matching
from mcp_asdf_tools.experiments.trials import run_trials
from mcp_asdf_tools.view.films import film_of_trial
from mcp_asdf_tools.view.page import page

if TYPE_CHECKING:
    from collections.abc import Mapping
    from typing import Any

    import pyarrow as pa  # type: ignore[import-untyped]


@dataclass(frozen=True)
class Shown:
    """The page of a run: the last line of a notebook's cell shows it.

    Attributes:
        page: HTML that needs nothing else.
        height: Pixels in a notebook.
    """

    page: str
    height: int

    def save(self, path: Path | str) -> None:
        """Write the page. Raises UsageError if that cannot be done."""
        write_atomically(path, self.page)

    def _repr_html_(self) -> str:
        """What a notebook asks for."""
        frame = f"width: 100%; height: {self.height}px; border: 0"
        return f'<iframe srcdoc="{html.escape(self.page)}" style="{frame}"></iframe>'


@naming_extras()
def show(
    results: Experiment | pa.Table,
    *,
    trial: int = 0,
    where: Mapping[str, Any] | None = None,
    height: int = 720,
) -> Shown:
    """A trial as the page that ``mcp-asdf view`` shows: of an experiment, which is run for it, or of results.

    ``where`` chooses one of several experiments by its parameters. Raises UsageError if none or several are
    left, or there is no such trial.
    """
    if trial < 0:
        raise UsageError(f"trial is {trial}; give 0 or more")
    if isinstance(results, Experiment):
        given = [run_trials(results, trial, 1)]
    else:
        given = matching(experiments_in(results), where or {})
    if len(given) != 1:
        raise UsageError(f"there are {len(given)} experiments; choose one by where=")
    return Shown(page(film_of_trial(given[0], trial)), height)
