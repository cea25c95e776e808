"""Extensions: classes and functions of users that take the place of firmware, topologies or sensors.

An extension is installed, and found by its name through an entry point, or it is an object of this process.
Worker processes find the same installed extensions. docs/platforms/extending.md has an example of each group.
"""

from __future__ import annotations

import sys
from collections.abc import Iterable, Iterator
from functools import cache
from typing import TYPE_CHECKING, Any

from mcp_asdf_tools.common.errors import UsageError

if TYPE_CHECKING:
    from importlib.metadata import EntryPoint

FIRMWARES = "mcp_asdf.firmwares"
"""Classes of robots: ``(config, id, b_hat) -> mcp_asdf.Robot``."""
TOPOLOGIES = "mcp_asdf.topologies"
"""Callables ``(WorldSettings, trial) -> mcp_asdf_tools.world.topology.Topology``."""
SENSORS = "mcp_asdf.sensors"
"""Callables ``(WorldSettings, trial) -> mcp_asdf_tools.world.sensors.SensorModel``."""


class ObjectName(str):
    """Name of an object of this process that is used as an extension, together with the object.

    It is a text, as the names of installed extensions are, so reports and results show it. Two of them are
    equal if their objects are the same. It can be pickled if another process can import the object.

    Attributes:
        extension: The object, such as a class.
    """

    extension: Any

    def __new__(cls, extension: Any) -> ObjectName:
        """Name an object by its module and qualified name; if it has no such name, by its class's."""
        qualified_name = getattr(extension, "__qualname__", type(extension).__qualname__)
        name = super().__new__(cls, f"{extension.__module__}.{qualified_name}")
        name.extension = extension
        return name

    def __eq__(self, other: object) -> bool:
        """Return whether both name the same object; to another text compare as a text."""
        if isinstance(other, ObjectName):
            return self.extension is other.extension
        return super().__eq__(other)

    def __ne__(self, other: object) -> bool:
        """Return the opposite of ``==``; the ``!=`` of texts would compare the texts alone."""
        return not self == other

    __hash__ = str.__hash__

    def __reduce__(self) -> tuple[Any, ...]:
        """Let pickle name the object again, instead of copying the text."""
        return ObjectName, (self.extension,)


class RecordedName(str):
    """Name of an extension in a recording or in results. These can be read where it is not installed."""


class Names:
    """The names that a parameter may have: built-in ones, then those of a group's installed extensions.

    Extensions are looked up when a name is not built in, or when all names are asked for: that is slow.

    Attributes:
        built_in: The names that come with the project.
    """

    def __init__(self, built_in_names: Iterable[str], group: str) -> None:
        """Take the built-in names, and the entry point group of the extensions, which is not searched yet."""
        self.built_in = list(built_in_names)
        self._group = group

    def __contains__(self, name: object) -> bool:
        """Return whether a name is built in or installed; one of an object or a recording is, in any case."""
        if isinstance(name, ObjectName | RecordedName):
            return True  # neither has to be installed here
        return name in self.built_in or name in installed_names(self._group)

    def __iter__(self) -> Iterator[str]:
        """Yield the built-in names, then those of the installed extensions."""
        return iter(self.built_in + installed_names(self._group))


def name_object(value: Any) -> Any:
    """Return the ObjectName of an object that can be called; return a text, or anything else, unchanged."""
    if isinstance(value, str) or not callable(value):
        return value
    return ObjectName(value)


def check_for_workers(name: str) -> None:
    """Raise UsageError if a name stands for an object that worker processes cannot import.

    Names of built-in or installed things are fine.
    """
    if not isinstance(name, ObjectName):
        return
    import pickle  # noqa: PLC0415 (only several workers need it)

    fix = "put it at the top level of a module that can be imported, install it, or take one worker"
    try:
        pickle.dumps(name.extension)
    except Exception as error:  # pickle raises errors of many kinds
        raise UsageError(f"{name} cannot be sent to worker processes: {error}; {fix}") from error
    # What is typed in a Python session or a notebook can be pickled, but no other process has it.
    is_session = not hasattr(sys.modules["__main__"], "__file__")  # only a script has a file
    if is_session and name.extension.__module__ == "__main__":
        raise UsageError(f"{name} exists in this session only, and not in worker processes; {fix}")


@cache
def _entry_points(group: str) -> list[EntryPoint]:
    """Return the installed entry points of a group. The first call takes up to a tenth of a second."""
    from importlib.metadata import entry_points  # noqa: PLC0415 (it loads slowly)

    return list(entry_points(group=group))


def installed_names(group: str) -> list[str]:
    """Return the names of the installed extensions of a group, sorted."""
    return sorted({entry_point.name for entry_point in _entry_points(group)})


def load(group: str, name: str) -> Any:
    """Return the extension of a group that has a name: an object of this process, or an installed one.

    Raises UsageError if no extension of that name is installed, if several are, or if its import fails.
    """
    if isinstance(name, ObjectName):
        return name.extension
    entry_point = _find_entry_point(group, name)
    try:
        return entry_point.load()
    except Exception as error:  # an import may raise anything
        raise UsageError(f"the extension {name!r} ({entry_point.value}) cannot be loaded: {error}") from error


def _find_entry_point(group: str, name: str) -> EntryPoint:
    """Return the installed entry point of a group that has a name.

    Raises UsageError if there is none, or if several packages offer one; the message then names them.
    """
    candidates = [entry_point for entry_point in _entry_points(group) if entry_point.name == name]
    if not candidates:
        raise UsageError(f"no extension {name!r} is installed in the entry point group {group}")
    if len(candidates) > 1:
        offers = []
        for candidate in candidates:
            package_name = candidate.dist.name if candidate.dist else "?"
            offers.append(f"{package_name} ({candidate.value})")
        raise UsageError(
            f"the extension {name!r} is offered by {' and '.join(offers)}; uninstall all but one"
        )
    return candidates[0]
