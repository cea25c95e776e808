"""Names and limits of the paper's scores.

``metrics`` computes the scores. It needs numpy, which loads slowly, and this module does not.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from mcp_asdf_tools.common.errors import UsageError

if TYPE_CHECKING:
    from mcp_asdf_tools.experiments.experiment import Experiment

E_MAX = 0.45
"""e_max of all the paper's figures."""


@dataclass(frozen=True)
class Limits:
    """The K and e that score 0, by default those of the paper's figures.

    Raises UsageError for a limit that is 0 or less, or infinite.

    Attributes:
        k_max: K_max in steps; None for the length of a trial.
        e_max: The error.
    """

    k_max: float | None = None
    e_max: float = E_MAX

    def __post_init__(self) -> None:
        """Check the values; None is legal. Raises UsageError for a limit that is not above 0 and finite."""
        for name, value in (("K_max", self.k_max), ("e_max", self.e_max)):
            is_legal = value is None or 0 < value < float("inf")
            if not is_legal:
                raise UsageError(f"{name} is {value}; it must be above 0")

    def of(self, experiment: Experiment) -> tuple[float, float]:
        """Return K_max and e_max for the trials of an experiment; without a K_max it is their last step."""
        k_max = experiment.steps if self.k_max is None else self.k_max
        return k_max, self.e_max


PAPER_LIMITS = Limits()
"""The limits of the paper's figures."""

SCORES = ("H", "h_K", "h_e")
