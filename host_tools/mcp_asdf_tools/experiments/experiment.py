"""An experiment: a swarm in its world, to be run many times.

Words and letters are the paper's; ``simulation`` runs experiments, ``experiment_files`` reads them.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum

from mcp_asdf_tools.common import ParameterError, parameter
from mcp_asdf_tools.robots import Population

MAX_TRIALS = 10**6
MAX_EXPERIMENTS = 100_000
"""Of one file."""


class Convention(Enum):
    """Reading of the equations that the reference firmware follows; see ``mcp_asdf.reference``."""

    PAPER = "paper"
    AUTHORS = "authors"


@dataclass(frozen=True, kw_only=True)
class Experiment(Population):
    """A definition; equal ones give equal results. Raises ParameterError, naming the field.

    Trial i of two experiments with one seed sees the same draws, and the same motion in the same arena.
    """

    trials: int = parameter(30, "number of trials", 1, MAX_TRIALS)
    conventions: Convention = parameter(Convention.PAPER, "reading of the equations, for firmware reference")

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.conventions is Convention.AUTHORS and self.firmware != "reference":
            message = f"firmware {self.firmware} has no conventions of the authors; choose firmware reference"
            raise ParameterError("conventions", message)
