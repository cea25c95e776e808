"""Extensions: objects that other distributions offer through entry points.

Entry points are read from what is installed, so worker processes find the same ones. docs/extending.md has an
example of each group.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from functools import cache
from importlib import metadata
from itertools import count
from typing import Any

from mcp_asdf_tools.common.errors import UsageError

FIRMWARES = "mcp_asdf.firmwares"
"""Classes of robots: ``(config, id, b_hat) -> mcp_asdf.Robot``."""
TOPOLOGIES = "mcp_asdf.topologies"
"""Callables ``(WorldSettings, trial) -> mcp_asdf_tools.world.topology.Topology``."""
SENSORS = "mcp_asdf.sensors"
"""Callables ``(WorldSettings, trial) -> mcp_asdf_tools.world.sensors.SensorModel``."""


class Names:
    """Names that come with the project, then those of a group's extensions, which are sought when needed."""

    def __init__(self, own: Iterable[str], group: str) -> None:
        self._own, self._group = list(own), group

    def __contains__(self, name: object) -> bool:
        return name in self._own or name in names(self._group)

    def __iter__(self) -> Iterator[str]:
        return iter(self._own + names(self._group))


_HERE: dict[tuple[str, str], Any] = {}
"""Objects that this process uses under names, by group and name."""


def name_of(group: str, given: Any) -> Any:
    """The name under which an object serves as an extension of this process; what cannot be one stays.

    Another process does not know it: where there are workers an extension has to be installed.
    """
    if isinstance(given, str) or not callable(given):
        return given
    plain = f"{given.__module__}.{getattr(given, '__qualname__', type(given).__qualname__)}"
    tries = (plain if number == 1 else f"{plain}#{number}" for number in count(1))
    name = next(each for each in tries if _HERE.get((group, each), given) is given)
    _HERE[group, name] = given
    return name


@cache
def _points(group: str) -> dict[str, metadata.EntryPoint]:
    """Entry points of a group by name. Reading all that is installed takes a tenth of a second."""
    return {point.name: point for point in metadata.entry_points(group=group)}


def names(group: str) -> list[str]:
    """Names of the extensions of a group, sorted: installed ones and those of this process."""
    return sorted({*_points(group), *(name for own, name in _HERE if own == group)})


def load(group: str, name: str) -> Any:
    """The object of that name. Raises UsageError unless one is installed and can be imported."""
    if (group, name) in _HERE:
        return _HERE[group, name]
    point = _points(group).get(name)
    if point is None:
        raise UsageError(f"no extension {name!r} is installed in the entry point group {group}")
    offers = [
        f"{each.dist.name if each.dist else '?'} ({each.value})"
        for each in metadata.entry_points(group=group, name=name)
    ]
    if len(offers) > 1:
        raise UsageError(
            f"the extension {name!r} is offered by {' and '.join(offers)}; uninstall all but one"
        )
    try:
        return point.load()
    except Exception as error:  # an import may raise anything
        raise UsageError(f"the extension {name!r} ({point.value}) cannot be loaded: {error}") from error
