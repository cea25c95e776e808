"""Initial state of a robot, enough to make the same robot again."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from mcp_asdf.robot import check_settings
from mcp_asdf_tools.common import UsageError, check_types
from mcp_asdf_tools.robots.firmwares import load_firmware
from mcp_asdf_tools.robots.rounds import TickConfig, TickedRobot
from mcp_asdf_tools.tables import omega_from_word


@dataclass(frozen=True)
class RobotRecord:
    """Initial state of one robot.

    Attributes:
        id: Robot id, 0 .. 127.
        firmware: Name of its firmware, see ``mcp_asdf_tools.robots.firmwares``.
        b_hat: Initial assumed accuracy.
        config: Its settings; the table is one that ``mcp_asdf_tools.tables.thresholds.generate`` makes.
    """

    id: int
    firmware: str
    b_hat: float
    config: TickConfig

    def __post_init__(self) -> None:
        """Raises UsageError for a field of another type; ranges are checked where the robot is made."""
        check_types(self)

    def make(self) -> TickedRobot:
        """A robot that starts like this one.

        Raises UsageError if there is no such firmware here, FirmwareError if it refuses the config.
        """
        config = self.config.in_rounds()
        check_settings(config)  # names the wrong setting, which the C cannot
        robot = load_firmware(self.firmware)(config, self.id, self.b_hat)
        return TickedRobot(robot, self.config.comms_period)

    def plain(self) -> dict[str, Any]:
        """The record as plain values, for JSON."""
        return {"id": self.id, "firmware": self.firmware, "b_hat": self.b_hat} | config_as_plain(self.config)


def config_as_plain(config: TickConfig) -> dict[str, Any]:
    """A config as plain values: the table as its omega, q and checksum.

    Raises UsageError if the table's omega has more than 9 decimal places: no table generated here has.
    """
    plain: dict[str, Any] = {
        "filter": config.filter.name.lower(),
        "comms_period": config.comms_period,
        "filter_period": config.filter_period,
        "memory": config.memory,
    }
    if config.table is not None:
        omega = omega_from_word(config.table.omega_word)
        if omega is None:
            raise UsageError(f"the t-table's omega is {config.table.omega}; make one with mcp-asdf table")
        plain["table"] = {"omega": str(omega), "q": config.table.q, "checksum": config.table.words()[-1]}
    return plain
