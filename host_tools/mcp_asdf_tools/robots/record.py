"""Initial state of a robot, enough to make the same robot again."""

from __future__ import annotations

from dataclasses import dataclass
from decimal import Decimal
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
from mcp_asdf_tools.bus.frame_layout import MAX_NODE_ID
from mcp_asdf_tools.common.errors import UsageError
from mcp_asdf_tools.robots.firmwares import load_firmware
from mcp_asdf_tools.tables.thresholds import generate, omega_from_word

_FILTERS = {each.name.lower(): each for each in Filter}
_TYPES: dict[str, type[Any]] = {
    **dict.fromkeys(("id", "comms_period", "filter_period", "memory"), int),
    "firmware": str,
    "b_hat": float,
}
_DEFAULTS = {
    "comms_period": 1,
    "filter": Config.filter.name.lower(),
    "filter_period": DEFAULT_FILTER_PERIOD,
    "memory": DEFAULT_MEMORY,
    "firmware": "native",
}
"""Settings that a record need not state."""
_KINDS = {int: "a whole number", str: "a text", float: "a number with a point"}


def ids_of(text: str, what: str) -> frozenset[int]:
    """The ids of ``0+3-5``. Raises UsageError, naming ``what``, if there are none or no node can have one."""
    found: set[int] = set()
    for item in text.split("+"):
        first, dash, last = item.partition("-")
        try:
            ids = range(int(first), int(last if dash else first) + 1)
        except ValueError:
            ids = range(0)
        if not ids or ids[-1] > MAX_NODE_ID:
            raise UsageError(f"{what} is {text!r}; it must be ids 0 to {MAX_NODE_ID} such as 0+3-5")
        found.update(ids)
    return frozenset(found)


def text_of_ids(ids: frozenset[int]) -> str:
    """The text that ``ids_of`` reads back."""
    firsts = sorted(each for each in ids if each - 1 not in ids)
    lasts = sorted(each for each in ids if each + 1 not in ids)
    return "+".join(f"{a}-{b}" if a < b else str(a) for a, b in zip(firsts, lasts, strict=True))


@dataclass(frozen=True)
class RobotRecord:
    """Initial state of one robot.

    Attributes:
        id: Robot id, 0 .. 127.
        firmware: Name of its firmware, see ``mcp_asdf_tools.robots.firmwares``.
        b_hat: Initial assumed accuracy.
        config: Its settings; the table is one that ``mcp_asdf_tools.tables.thresholds.generate`` makes.
        comms_period: Ticks between broadcasts, the length of a round, 1 .. 2**32 - 1.
        allow: Ids besides its own whose estimates it takes; None for all.
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

    def make(self) -> Robot:
        """The firmware of a robot that starts like this one.

        Raises UsageError if there is no such firmware here, FirmwareError if it refuses the record.
        """
        return load_firmware(self.firmware)(self.config, self.id, self.b_hat)

    def plain(self) -> dict[str, Any]:
        """The record as plain values, for JSON: the table as its omega, q and checksum.

        Raises UsageError if the table's omega has more than 9 decimal places: no table generated here has.
        """
        plain = {"id": self.id, "firmware": self.firmware, "b_hat": self.b_hat, **vars(self.config)}
        plain |= {"comms_period": self.comms_period, "filter_period": self.filter_period}
        if self.allow is not None:
            plain["allow"] = text_of_ids(self.allow)
        plain["filter"] = self.config.filter.name.lower()
        table = plain.pop("table")
        if table is not None:
            omega = omega_from_word(table.omega_word)
            if omega is None:
                raise UsageError(f"the t-table's omega is {table.omega}; make one with mcp-asdf table")
            plain["table"] = {"omega": str(omega), "q": table.q, "checksum": table.words()[-1]}
        return plain

    @classmethod
    def from_plain(cls, plain: Any) -> RobotRecord:
        """The record of ``plain`` values, which may come from any file. What it lacks has its
        default, except for the id and b_hat, which it must have.

        Raises a built-in error or one of ours, all with a message, for what is no record of a robot.
        """
        if not isinstance(plain, dict):
            raise UsageError(f"a robot is {plain!r}; give its settings as an object in braces")
        plain = _DEFAULTS | plain
        table = None
        if "table" in plain:
            stated = plain["table"]
            table = generate(Decimal(stated["omega"]), stated["q"])
            if table.words()[-1] != stated["checksum"]:
                raise UsageError(
                    f"the t-table of robot {plain['id']} has checksum {stated['checksum']}, "
                    f"the one made here {table.words()[-1]}"
                )
        if plain["filter"] not in _FILTERS:
            raise UsageError(f"filter is {plain['filter']!r}; it must be one of {', '.join(_FILTERS)}")
        for name, kind in _TYPES.items():
            if type(plain[name]) is not kind:
                raise UsageError(f"{name} is {plain[name]!r}; give {_KINDS[kind]}")
        comms, tau = plain["comms_period"], plain["filter_period"]
        if not 1 <= comms <= MAX_FILTER_PERIOD:
            raise UsageError(f"comms_period is {comms}; choose 1 .. {MAX_FILTER_PERIOD}")
        if not 1 <= tau <= MAX_FILTER_PERIOD or tau % comms:
            raise UsageError(f"filter_period is {tau}; choose a multiple of comms_period {comms}")
        config = Config(table, _FILTERS[plain["filter"]], tau // comms, plain["memory"])
        check_settings(config)  # names the wrong setting, which the C cannot
        allow = ids_of(str(plain["allow"]), "allow") if "allow" in plain else None
        record = cls(plain["id"], plain["firmware"], plain["b_hat"], config, comms, allow)
        record.make()  # raises here if the firmware refuses it
        return record
