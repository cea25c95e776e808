"""The page of a run inside a notebook."""

from __future__ import annotations

import html
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from mcp_asdf_tools.common.errors import UsageError
from mcp_asdf_tools.common.extras import naming_extras
from mcp_asdf_tools.common.files import write_atomically
from mcp_asdf_tools.experiments.experiment import Experiment
from mcp_asdf_tools.experiments.results import select_experiments, single_experiment
from mcp_asdf_tools.view.page import make_page
from mcp_asdf_tools.view.run_histories import recompute_trial_history, run_trial_history


@dataclass(frozen=True)
class NotebookPage:
    """The page of a run; as the last value of a notebook's cell it is shown below the cell.

    Attributes:
        page: The page as HTML that needs no other file.
    """

    page: str

    def save(self, path: Path | str) -> None:
        """Write the page to a file, which it replaces. Raises UsageError if that cannot be done."""
        write_atomically(path, self.page)

    def _repr_html_(self) -> str:
        """Return the page in a frame, as the HTML that a notebook shows."""
        style = "width: 100%; height: 720px; border: 0"
        return f'<iframe srcdoc="{html.escape(self.page)}" style="{style}"></iframe>'


@naming_extras()
def show(results: Any, *, trial: int = 0, where: Mapping[str, Any] | None = None) -> NotebookPage:
    """Return the page of one trial, the same that the command ``mcp-asdf view`` shows in a browser.

    ``results`` is an Experiment, whose trial is run for this, or a table of results. ``trial`` is the trial's
    number. ``where`` chooses one of several experiments of a table by its parameters; it does nothing for an
    Experiment. Raises UsageError if several are left, or there is no such trial.
    """
    if trial < 0:
        raise UsageError(f"trial is {trial}; give 0 or more")
    if isinstance(results, Experiment):
        return NotebookPage(make_page(run_trial_history(results, trial)))
    from mcp_asdf_tools.experiments.result_files import stream_experiments  # noqa: PLC0415 (pyarrow is slow)

    experiments = list(stream_experiments(results))
    trials = single_experiment(select_experiments(experiments, where or {}))
    return NotebookPage(make_page(recompute_trial_history(trials, trial)))
