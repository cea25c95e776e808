"""An experiment: a swarm in its world, to be run many times.

Words and letters are the paper's; ``trials`` runs experiments, ``experiment_files`` reads them.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from itertools import product
from typing import Any, Literal

from mcp_asdf_tools.common.parameters import ParameterError, parameter
from mcp_asdf_tools.robots.population import Population
from mcp_asdf_tools.world.sensors import has_one_accuracy
from mcp_asdf_tools.world.topology import MAX_ON_BUS

MAX_TRIALS = 10**6
MAX_EXPERIMENTS = 100_000
"""Most experiments of one file."""


Convention = Literal["paper", "authors"]
"""Reading of the equations that the reference firmware follows; see ``mcp_asdf.reference``."""


@dataclass(frozen=True, kw_only=True)
class Experiment(Population):
    """A definition; equal ones give equal results. Raises ParameterError, naming the field.

    Trial i of two experiments with one seed sees the same draws, and the same motion in the same arena.
    """

    trials: int = parameter("number of trials", 1, MAX_TRIALS, default=30)
    conventions: Convention = parameter("reading of the equations, for firmware reference", default="paper")

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.conventions == "authors" and self.firmware != "reference":
            message = f"firmware {self.firmware} has no conventions of the authors; choose firmware reference"
            raise ParameterError("conventions", message)
        if self.robots > MAX_ON_BUS and (key := self.lacking_in_c):
            why = f"{key} is {getattr(self, key)}, which runs message by message, with ids of 7 bits"
            raise ParameterError(key, f"robots is {self.robots}, but {why}; take at most {MAX_ON_BUS}")

    @property
    def lacking_in_c(self) -> str:
        """The parameter whose value the engine in C lacks, so that trials run message by message, or none."""
        if self.firmware != "native":
            return "firmware"
        if self.topology == "dynamic":
            if has_one_accuracy(self):
                return ""
            return "sensor" if self.sensor else "white_offset"
        if self.topology == "fully-connected":
            return "latency" if self.latency else ""
        return "" if self.topology == "graph" else "topology"


def grid(**parameters: Any) -> list[Experiment]:
    """Experiments with all combinations of parameters, of which lists have several values, or several tables
    of parameters that vary together.

    Raises ParameterError as Experiment, and for lists that are empty or make too many experiments.
    """
    return [Experiment.from_parameters(choice) for choice in combinations(parameters)]


def combinations(parameters: Mapping[str, Any]) -> Iterator[dict[str, Any]]:
    """One dictionary for each combination of the values in lists. A list of tables, under a name of its own,
    is a choice among them: each in turn stands in its place. Raises ParameterError as ``grid``."""
    tables = {
        key: value
        for key, value in parameters.items()
        if isinstance(value, list | tuple) and value and all(isinstance(each, dict) for each in value)
    }
    if tables:
        others = {key: value for key, value in parameters.items() if key not in tables}
        for chosen in product(*tables.values()):
            together = {key: value for table in chosen for key, value in table.items()}
            yield from combinations({**others, **together})
        return
    axes = [value if isinstance(value, list | tuple) else [value] for value in parameters.values()]
    size = 1
    for key, axis in zip(parameters, axes, strict=True):
        size *= len(axis)
        if not 0 < size <= MAX_EXPERIMENTS:
            raise ParameterError(key, f"{key} makes {size} experiments; give 1 to {MAX_EXPERIMENTS}")
    yield from (dict(zip(parameters, values, strict=True)) for values in product(*axes))
