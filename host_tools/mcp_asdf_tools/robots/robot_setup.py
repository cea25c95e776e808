"""How a robot starts: enough to make the same robot again, here, in another process or in a replay."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from mcp_asdf.robot import (
    DEFAULT_FILTER_PERIOD,
    DEFAULT_MEMORY,
    MAX_FILTER_PERIOD,
    Config,
    Filter,
    Robot,
    check_settings,
)
from mcp_asdf.table import Table
from mcp_asdf_tools.bus.frame_layout import MAX_NODE_ID
from mcp_asdf_tools.common.errors import UsageError, did_you_mean, refusing_wrong_values
from mcp_asdf_tools.robots.firmwares import load_firmware

_FILTERS_BY_NAME = {firmware_filter.name.lower(): firmware_filter for firmware_filter in Filter}
_TYPES: dict[str, type[Any]] = {
    "id": int,
    "comms_period": int,
    "filter_period": int,
    "memory": int,
    "firmware": str,
    "filter": str,
    "b_hat": float,
    "allow": str,
    "table": dict,
}
_TYPE_NAMES = {
    int: "a whole number",
    str: "a text",
    float: "a number with a point",
    dict: "an object in braces",
}
_DEFAULTS: dict[str, Any] = {
    "comms_period": 1,
    "filter": Config.filter.name.lower(),
    "filter_period": DEFAULT_FILTER_PERIOD,
    "memory": DEFAULT_MEMORY,
    "firmware": "native",
}
"""Values of settings that a plain setup need not have."""


def parse_ids(ids_text: str, name: str) -> frozenset[int]:
    """Return the ids of a text such as ``0+3-5``, here 0, 3, 4 and 5.

    Raises UsageError, which calls the text ``name``, if it holds no ids, or one that no node can have.
    """
    ids: set[int] = set()
    for item in ids_text.split("+"):
        first, dash, last = item.partition("-")
        if not dash:  # a single id is a range of one
            last = first
        try:
            item_ids = range(int(first), int(last) + 1)
        except ValueError:
            item_ids = range(0)  # which is refused like a range that ends before it starts
        # The last id is checked before the range is filled in, which a hostile text could make endless.
        if not item_ids or item_ids[-1] > MAX_NODE_ID:
            raise UsageError(f"{name} is {ids_text!r}; it must be ids 0 to {MAX_NODE_ID} such as 0+3-5")
        ids.update(item_ids)
    return frozenset(ids)


def format_ids(ids: frozenset[int]) -> str:
    """Return the text that ``parse_ids`` reads back, such as ``0+3-5`` for 0, 3, 4 and 5."""
    # A range of adjacent ids starts where the id before is missing, and ends where the next one is.
    range_starts = sorted(node_id for node_id in ids if node_id - 1 not in ids)
    range_ends = sorted(node_id for node_id in ids if node_id + 1 not in ids)
    items = []
    for start, end in zip(range_starts, range_ends, strict=True):
        items.append(str(start) if start == end else f"{start}-{end}")
    return "+".join(items)


@dataclass(frozen=True)
class RobotSetup:
    """How one robot starts.

    Attributes:
        id: Robot id, 0 .. 127.
        firmware: Name of its firmware, see ``mcp_asdf_tools.robots.firmwares``.
        b_hat: Initial assumed accuracy.
        config: Its settings; the table is one that ``mcp_asdf_tools.tables.thresholds.generate`` makes.
        comms_period: Ticks between broadcasts, the length of a round, 1 .. 2**32 - 1.
        allow: Ids besides its own whose estimates it accepts; None for all.
    """

    id: int
    firmware: str
    b_hat: float
    config: Config
    comms_period: int = 1
    allow: frozenset[int] | None = None

    @property
    def filter_period(self) -> int:
        """Nominal filtering period tau in ticks."""
        return self.config.filter_period * self.comms_period

    def make_robot(self) -> Robot:
        """Return the firmware of a robot that starts like this.

        Raises UsageError if there is no such firmware here, FirmwareError if it refuses the settings.
        """
        make_firmware = load_firmware(self.firmware)
        return make_firmware(self.config, self.id, self.b_hat)

    def plain(self) -> dict[str, Any]:
        """Return the setup as plain values, for JSON, from which ``from_plain`` makes it again.

        Keys: ``id``, ``firmware``, ``b_hat``, ``filter``, ``filter_period`` (in ticks), ``memory`` and
        ``comms_period``; ``allow``, a text of ids, if not all are allowed; and ``table`` if there is a
        t-table, with the keys ``omega``, ``q`` and ``checksum``. Raises UsageError if the table's omega, its
        type II error probability, has more than 9 decimal places: no table generated here has.
        """
        values: dict[str, Any] = {
            "id": self.id,
            "firmware": self.firmware,
            "b_hat": self.b_hat,
            "filter": self.config.filter.name.lower(),
            "filter_period": self.filter_period,
            "memory": self.config.memory,
            "comms_period": self.comms_period,
        }
        # An entry that is missing stands for None, as ``from_plain`` reads it.
        if self.allow is not None:
            values["allow"] = format_ids(self.allow)
        if self.config.table is not None:
            values["table"] = _plain_table(self.config.table)
        return values

    @classmethod
    @refusing_wrong_values()
    def from_plain(cls, plain: Any) -> RobotSetup:
        """Return the setup of plain values, which may come from any file.

        ``id`` and ``b_hat`` must be there, all else has its default. Raises UsageError for an entry that is
        missing or unknown, and for an impossible value.
        """
        if not isinstance(plain, dict):
            raise UsageError(f"a robot is {plain!r}; give its settings as an object in braces")
        values = _DEFAULTS | plain
        _check_types(values)
        config = _config_from_plain(values)
        allow = parse_ids(values["allow"], "allow") if "allow" in values else None
        # The decorator makes a UsageError of a KeyError, as for a missing id, and of the firmware's errors.
        setup = cls(
            id=values["id"],
            firmware=values["firmware"],
            b_hat=values["b_hat"],
            config=config,
            comms_period=values["comms_period"],
            allow=allow,
        )
        if config.filter is Filter.ADAPTIVE and config.table is None:
            raise UsageError("filter is 'adaptive', which needs table: give its omega, q and checksum")
        # This robot is not used, but the firmware refuses here what is wrong with its id or b_hat.
        setup.make_robot()
        return setup


def _check_types(values: dict[str, Any]) -> None:
    """Raise UsageError for a value whose name is no setting of a robot, or that has another type than it."""
    for name, value in values.items():
        if name not in _TYPES:
            advice = did_you_mean(name, _TYPES) or f"; its settings are {', '.join(_TYPES)}"
            raise UsageError(f"a robot has no setting {name!r}{advice}")
        # Not isinstance(), which would take True for a whole number.
        if type(value) is not _TYPES[name]:
            raise UsageError(f"{name} is {value!r}; give {_TYPE_NAMES[_TYPES[name]]}")


def _config_from_plain(values: dict[str, Any]) -> Config:
    """Return the configuration of a robot's firmware from its settings, of which only ``table`` is optional.

    Raises UsageError for an impossible value, and FirmwareError for a memory that the firmware would refuse.
    That an adaptive filter needs a table is not checked here.
    """
    table = _table_from_plain(values["table"], values["id"]) if "table" in values else None
    if values["filter"] not in _FILTERS_BY_NAME:
        raise UsageError(f"filter is {values['filter']!r}; it must be one of {', '.join(_FILTERS_BY_NAME)}")
    _check_periods(values["comms_period"], values["filter_period"])
    # The firmware counts rounds, of comms_period ticks each.
    rounds_between_tests = values["filter_period"] // values["comms_period"]
    config = Config(
        table=table,
        filter=_FILTERS_BY_NAME[values["filter"]],
        filter_period=rounds_between_tests,
        memory=values["memory"],
    )
    check_settings(config)  # names the wrong setting, which the C cannot
    return config


def _check_periods(comms_period: int, filter_period: int) -> None:
    """Raise UsageError unless both are in range, in ticks, and filter_period a multiple of comms_period."""
    if not 1 <= comms_period <= MAX_FILTER_PERIOD:
        raise UsageError(f"comms_period is {comms_period}; choose 1 .. {MAX_FILTER_PERIOD}")
    # The firmware counts rounds, of comms_period ticks each, and tests at the end of one.
    if not 1 <= filter_period <= MAX_FILTER_PERIOD or filter_period % comms_period != 0:
        raise UsageError(
            f"filter_period is {filter_period}; choose a multiple of comms_period {comms_period}"
        )


def _plain_table(table: Table) -> dict[str, Any]:
    """Return the values that a t-table is generated from, with the checksum of the table, for JSON.

    Keys: ``omega``, the type II error probability of the test, as a decimal text; ``q``, the number of
    neighbours with an exact threshold; ``checksum``. Raises UsageError if omega has more than 9 decimal
    places, which no table generated here has.
    """
    from mcp_asdf_tools.tables.thresholds import omega_from_word  # noqa: PLC0415 (mpmath loads slowly)

    # Without such an omega the table could not be generated again.
    omega = omega_from_word(table.omega_word)
    if omega is None:
        raise UsageError(f"the t-table's omega is {table.omega}; make one with mcp-asdf table")
    *_, checksum = table.words()  # the last word
    return {"omega": str(omega), "q": table.q, "checksum": checksum}


def _table_from_plain(plain_table: Any, robot_id: Any) -> Table:
    """Generate the t-table for the omega and q of ``plain_table``, and check its checksum.

    Raises UsageError for an omega or q that no table has and, naming the robot, if the generated table has
    another checksum than ``plain_table``: the robot would not be the same. Raises KeyError for a missing one.
    """
    from mcp_asdf_tools.tables.thresholds import generate, parse_omega  # noqa: PLC0415 (mpmath loads slowly)

    q = plain_table["q"]
    if type(q) is not int:
        raise UsageError(f"q of the t-table is {q!r}; give {_TYPE_NAMES[int]}")
    table = generate(parse_omega(str(plain_table["omega"])), q)
    *_, checksum = table.words()  # the last word
    if checksum != plain_table["checksum"]:
        raise UsageError(
            f"the t-table of robot {robot_id} has checksum {plain_table['checksum']}, "
            f"the one made here {checksum}"
        )
    return table
