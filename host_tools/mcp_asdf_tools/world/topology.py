"""Which robots receive from which, where robots do not move: all from all, or along the edges of a graph."""

from __future__ import annotations

from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from mcp_asdf_tools.common.errors import UsageError
from mcp_asdf_tools.world.graph import Graph


class Topology(Protocol):
    """Neighbours over time; an extension in the entry point group ``mcp_asdf.topologies`` makes one."""

    def advance(self, steps: int) -> NDArray[np.bool_]:
        """Return the neighbours in the next steps, shape (steps, N, N).

        ``[k, i, j]`` is True if robot i receives from robot j in step k.
        """


class FixedTopology:
    """A topology in which the neighbours never change."""

    def __init__(self, neighbours: NDArray[np.bool_]) -> None:
        """Take the neighbours, shape (N, N): ``[i, j]`` is True if robot i receives from robot j."""
        self._neighbours = neighbours

    def advance(self, steps: int) -> NDArray[np.bool_]:
        """Return the neighbours in the next steps, shape (steps, N, N), as a view to be read only. O(1).

        All steps of the view are the same matrix in memory.
        """
        return np.broadcast_to(self._neighbours, (steps, *self._neighbours.shape))


class CheckedTopology:
    """The topology of an extension, whose answers are checked."""

    def __init__(self, topology: Topology, name: str, robots: int) -> None:
        """Take the topology of ``robots`` robots that is installed under ``name``, for messages."""
        self._topology = topology
        self._name = name
        self._robots = robots

    def advance(self, steps: int) -> NDArray[np.bool_]:
        """Return the extension's answer for the next steps, shape (steps, N, N). O(steps N^2).

        Raises UsageError unless it has the type and shape that ``Topology`` states, and no robot is its own
        neighbour.
        """
        neighbours = np.asarray(self._topology.advance(steps))
        # An array of another type is not converted: ids or weights would turn into truth values in silence.
        shape = (steps, self._robots, self._robots)
        if neighbours.shape != shape or neighbours.dtype != np.bool_:
            raise UsageError(
                f"topology {self._name} gives {neighbours.dtype} of shape {neighbours.shape}; "
                f"return bool of {shape}"
            )
        receiver_axis, sender_axis = 1, 2
        if neighbours.diagonal(axis1=receiver_axis, axis2=sender_axis).any():
            raise UsageError(f"in topology {self._name} a robot hears itself; clear the diagonal")
        return neighbours


def graph_topology(graph: Graph, robots: int) -> FixedTopology:
    """Return the topology of ``robots`` robots with a graph's links.

    Raises UsageError if the graph names a robot with a higher id, or gives one more than 127 neighbours.
    """
    graph.check(robots)
    neighbours = np.zeros((robots, robots), np.bool_)
    for sender, receiver in graph.links:
        # Row i has what robot i receives, so the receiver comes first.
        neighbours[receiver, sender] = True
    return FixedTopology(neighbours)
