"""An experiment: a swarm in its world, to be run many times.

Words and letters are the paper's; ``trials`` runs experiments, ``experiment_files`` reads them.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from itertools import product
from typing import Any, Literal

from mcp_asdf_tools.common.parameters import ParameterError, naming_parameter, parameter
from mcp_asdf_tools.experiments.message_codes import EXACT, MessageCode, parse_message_bits
from mcp_asdf_tools.robots.population import Population
from mcp_asdf_tools.world.graph import MAX_ON_BUS

MAX_TRIALS = 10**6
MAX_EXPERIMENTS = 100_000
"""Number of experiments that one file or grid may make."""


Convention = Literal["paper", "authors"]
"""Reading of the equations that the reference firmware follows; see ``mcp_asdf.reference``."""


@dataclass(frozen=True, kw_only=True)
class Experiment(Population):
    """The parameters of a swarm that is run many times; equal experiments give equal results.

    Trial i of two experiments with one seed sees the same draws, and the same motion in the same arena.
    Raises ParameterError, naming the field, for values that are wrong or do not fit together.
    """

    trials: int = parameter("number of trials", 1, MAX_TRIALS, default=30)
    conventions: Convention = parameter("reading of the equations, for firmware reference", default="paper")
    message_bits: str = parameter(
        "bits of x_hat and of alpha in a message, such as 16+9; exact: unrounded", default=EXACT
    )

    def __post_init__(self) -> None:
        """Check the values, and bring ``message_bits`` to the one text that its code has.

        Raises ParameterError, naming the field, for values that are wrong or do not fit together, and for
        more than MAX_ON_BUS robots in an experiment that the C engine cannot run.
        """
        super().__post_init__()
        if self.conventions == "authors" and self.firmware != "reference":
            message = f"firmware {self.firmware} has no conventions of the authors; choose firmware reference"
            raise ParameterError("conventions", message)
        with naming_parameter("message_bits"):  # turns a UsageError into a ParameterError for this name
            message_code = parse_message_bits(self.message_bits)
        # One text for each code, so that equal experiments compare equal: not "07+4" beside "7+4".
        message_bits = EXACT if message_code is None else str(message_code)
        object.__setattr__(self, "message_bits", message_bits)  # the class is frozen
        # In a larger swarm several robots have the same id. The C engine tells them apart, but messages do
        # not.
        if self.robots > MAX_ON_BUS and self.parameter_lacking_in_c:
            slow_parameter = self.parameter_lacking_in_c
            value = getattr(self, slow_parameter)
            reason = f"{slow_parameter} is {value}, which runs message by message, with ids of 7 bits"
            message = f"robots is {self.robots}, but {reason}; take at most {MAX_ON_BUS}"
            raise ParameterError(slow_parameter, message)

    @property
    def message_code(self) -> MessageCode | None:
        """The code to which messages are rounded when they are sent; None if they are exact."""
        return parse_message_bits(self.message_bits)

    @property
    def parameter_lacking_in_c(self) -> str:
        """The parameter whose value the engine in C lacks, so that trials run in Python, message by message.

        It is the name of a parameter, or empty if the engine can run the experiment. The engine lacks any
        firmware but "native", moving robots with two accuracies, for black and for white, latency where all
        robots are connected, and topologies that are extensions.

        Raises UsageError if the sensor is an extension that cannot be loaded.
        """
        from mcp_asdf_tools.world.sensors import has_one_accuracy  # noqa: PLC0415 (numpy loads slowly)

        # The engine has the C firmware compiled in, and calls no other.
        if self.firmware != "native":
            return "firmware"
        if self.topology == "dynamic":
            # A moving robot reads black and white tiles, for which the engine has one accuracy.
            if has_one_accuracy(self):
                return ""
            return "sensor" if self.sensor else "white_offset"
        if self.topology == "fully-connected":
            return "latency" if self.latency else ""
        # What is neither is a graph, which the engine takes as a list of arcs, or an extension in Python.
        return "" if self.topology == "graph" else "topology"


def grid(**parameters: Any) -> list[Experiment]:
    """Return experiments with all combinations of parameters.

    A parameter may have a list of values in place of one. Parameters that vary together stand in a list of
    tables, such as ``sensors=[{"true_accuracy": 0.95, "flawed_accuracy": 0.55}, ...]``; its key, here
    ``sensors``, may be any name. Raises ParameterError for values that are wrong or do not fit together, for
    an empty list, and for more than MAX_EXPERIMENTS experiments.
    """
    return [Experiment.from_parameters(combination) for combination in combinations(parameters)]


def combinations(parameters: Mapping[str, Any]) -> Iterator[dict[str, Any]]:
    """Yield a dictionary for each combination of the values in lists, the last parameter varying fastest.

    A list of tables, such as ``sensors=[{"true_accuracy": 0.95}, {"true_accuracy": 0.55}]``, holds parameters
    that vary together. For each of its tables in turn all combinations of the other parameters are made, with
    the parameters of the table in place of the list; the list's key may be any name. Raises ParameterError
    for an empty list, and for lists that make more than MAX_EXPERIMENTS combinations.
    """
    table_lists = {key: value for key, value in parameters.items() if _is_list_of_tables(value)}
    plain_parameters = {key: value for key, value in parameters.items() if key not in table_lists}
    if not table_lists:
        yield from _combine_values(plain_parameters)
        return
    # Each combination has one table of each list.
    for chosen_tables in product(*table_lists.values()):
        combined = dict(plain_parameters)
        for table in chosen_tables:
            combined |= table
        # A table may have lists of values, or of tables, itself.
        yield from combinations(combined)


def without_repetitions(experiments: Iterable[Experiment]) -> list[Experiment]:
    """Return each of several experiments once, in the order in which they first come."""
    experiments_as_keys = dict.fromkeys(experiments)
    # The keys of a dictionary keep their order, unlike the elements of a set.
    return list(experiments_as_keys)


def _is_list_of_tables(value: Any) -> bool:
    """Return whether a value is a list of at least one table and of nothing else."""
    is_list = isinstance(value, list | tuple) and len(value) > 0
    return is_list and all(isinstance(element, dict) for element in value)


def _combine_values(parameters: Mapping[str, Any]) -> Iterator[dict[str, Any]]:
    """Yield all combinations of parameters of which some have lists of values.

    Raises ParameterError for an empty list, and for lists that make more than MAX_EXPERIMENTS combinations.
    """
    value_lists = []
    combination_count = 1
    for key, value in parameters.items():
        values = value if isinstance(value, list | tuple) else [value]
        value_lists.append(values)
        combination_count *= len(values)
        # Checked list by list, so that the error names the first list that makes too many or, as it is empty,
        # none.
        if not 0 < combination_count <= MAX_EXPERIMENTS:
            message = f"{key} makes {combination_count} experiments; give 1 to {MAX_EXPERIMENTS}"
            raise ParameterError(key, message)
    for chosen_values in product(*value_lists):
        yield dict(zip(parameters, chosen_values, strict=True))
