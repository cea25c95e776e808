"""The C firmware itself, behind the same interface as its mirror.

``lib`` and ``ffi`` are the C functions and types as cffi offers them, for engines that drive many robots
from C: ``lib.mcp_asdf_receive(robot.pointer, ...)``.
"""

from __future__ import annotations

import struct
from collections.abc import Iterator
from dataclasses import fields
from operator import index
from typing import TYPE_CHECKING, Any

from mcp_asdf._native import ffi, lib
from mcp_asdf.fixed_point import FixedPointView, b_hat_to_raw
from mcp_asdf.robot import (
    B_HAT_MARGIN,
    Config,
    Counters,
    Filter,
    FirmwareError,
    Observation,
    Status,
    reading,
)
from mcp_asdf.table import EXTRA_WORDS, MAX_Q, MAX_WORD, Table

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

__all__ = ["NativeRobot", "ffi", "lib"]

_STATUS = {int(status): status for status in Status}
_MAX_BYTE = 2**8 - 1
_REASONS = {
    Status.ERR_CONFIG: "the firmware refuses the filter, the filter_period or the memory of {config}",
    Status.ERR_TABLE: "the adaptive filter needs a sound table; make one with mcp-asdf table",
    Status.ERR_ID: "robot id is {robot_id}; choose 0 .. 127",
    Status.ERR_B_HAT: "b_hat is {b_hat}; choose one in [2**-20, 1 - 2**-20]",
    Status.ERR_IMAGE: "the image is damaged, of another version or does not fit the configuration",
}


class NativeRobot(FixedPointView):
    """MCP-ASDF in C. Implements ``FixedPointRobot``.

    Args:
        config: Shared settings.
        robot_id: Own id, 0..127.
        b_hat: Initial assumed accuracy, rounded to a multiple of 2**-32.

    Attributes:
        config: As given.
        pointer: The robot's ``mcp_asdf_t *``, valid for as long as this object lives.

    Raises:
        FirmwareError: As ``mcp_asdf_init`` fails.
    """

    def __init__(self, config: Config, robot_id: int, b_hat: float) -> None:
        self._attach(config)
        raw = b_hat_to_raw(b_hat) if B_HAT_MARGIN <= b_hat <= 1 - B_HAT_MARGIN else 0
        status = lib.mcp_asdf_init(self.pointer, self._settings.pointer, _fit(robot_id, _MAX_BYTE), raw)
        _check(status, config=config, robot_id=robot_id, b_hat=b_hat)

    def _attach(self, config: Config) -> None:
        self.config = config
        self.pointer = ffi.new("mcp_asdf_t *")
        self._settings = _ConfigInC(config)

    @classmethod
    def restore(cls, config: Config, image: bytes) -> NativeRobot:
        """A robot from ``save``'s image. Raises FirmwareError as ``mcp_asdf_restore`` fails."""
        robot = cls.__new__(cls)
        robot._attach(config)
        plain = bytes(memoryview(image))
        whole = plain if len(plain) == lib.MCP_ASDF_IMAGE_SIZE else bytes(lib.MCP_ASDF_IMAGE_SIZE)
        status = lib.mcp_asdf_restore(robot.pointer, robot._settings.pointer, whole)
        _check(status, config=config)
        return robot

    def save(self) -> bytes:
        """The state as ``mcp_asdf_save`` writes it."""
        image = ffi.new("uint8_t[]", lib.MCP_ASDF_IMAGE_SIZE)
        lib.mcp_asdf_save(self.pointer, image)
        return bytes(image)

    def observe(self, z: Observation) -> Status:
        """Count an observation and form x_hat and alpha."""
        return _STATUS[lib.mcp_asdf_observe(self.pointer, _fit(z, MAX_WORD))]

    def _receive(self, sender: int, x_hat: int, alpha: int) -> Status:
        try:
            return _STATUS[lib.mcp_asdf_receive(self.pointer, sender, x_hat, alpha)]
        except OverflowError:
            fitting = _fit(sender, _MAX_BYTE), _fit(x_hat, MAX_WORD)
            return _STATUS[lib.mcp_asdf_receive(self.pointer, *fitting, alpha)]

    def _receive_all(self, messages: NDArray[np.uint32]) -> int:
        words = ffi.from_buffer("uint32_t[]", messages)
        return int(lib.mcp_asdf_receive_all(self.pointer, words, len(messages)))

    def settle(self) -> Status:
        """Close the round, and filter every ``filter_period`` rounds."""
        return _STATUS[lib.mcp_asdf_settle(self.pointer)]

    def step(self, z: Observation) -> Status:
        """``observe(z)`` then ``settle()``: what ``settle`` returns, or the error of ``observe``."""
        return _STATUS[lib.mcp_asdf_step(self.pointer, _fit(z, MAX_WORD))]

    id = reading(lambda robot: int(robot.pointer.id), "Own id.")
    t = reading(lambda robot: int(lib.mcp_asdf_t_count(robot.pointer)), "Observations counted.")
    n = reading(lambda robot: int(lib.mcp_asdf_n_count(robot.pointer)), "Black ones among them.")
    b_hat_raw = reading(lambda robot: int(lib.mcp_asdf_b_hat(robot.pointer)), "b_hat in units of 2**-32.")
    x_hat_raw = reading(lambda robot: int(lib.mcp_asdf_x_hat(robot.pointer)), "x_hat in units of 2**-23.")
    alpha_raw = reading(lambda robot: int(lib.mcp_asdf_alpha(robot.pointer)), "alpha as the firmware's word.")
    x_bar_raw = reading(lambda robot: int(lib.mcp_asdf_x_bar(robot.pointer)), "x_bar in units of 2**-23.")
    beta_raw = reading(lambda robot: int(lib.mcp_asdf_beta(robot.pointer)), "beta in units of 2**-24.")
    x_raw = reading(lambda robot: int(lib.mcp_asdf_x(robot.pointer)), "x in units of 2**-23.")

    @property
    def counters(self) -> Counters:
        """Diagnostics since the robot was made."""
        native_counters = lib.mcp_asdf_counters(self.pointer)
        return Counters(*(getattr(native_counters, member.name) for member in fields(Counters)))

    def state(self) -> dict[str, int]:
        """Every member of ``mcp_asdf_t`` but ``config``, named as ``MirrorRobot.state`` names them."""
        return dict(_flatten("", self.pointer[0], ffi.typeof("mcp_asdf_t")))

    def holds_invariants(self) -> bool:
        """True if the state could have come from calls alone (``docs/invariants.md``)."""
        return bool(lib.mcp_asdf_invariants_hold(self.pointer))


class _ConfigInC:
    """A config and its table in C memory, which lives for as long as this object."""

    def __init__(self, config: Config) -> None:
        self._table = ffi.NULL
        if config.filter == Filter.ADAPTIVE and config.table is not None:
            self._table = _table_in_c(config.table)
        self.pointer = ffi.new("mcp_asdf_config_t *")
        self.pointer.table = self._table
        self.pointer.filter_period = _fit(config.filter_period, MAX_WORD, refused=0)
        self.pointer.memory = _fit(config.memory, MAX_WORD, refused=0)
        self.pointer.filter = _fit(config.filter, _MAX_BYTE)


def _table_in_c(table: Table) -> Any:
    """A table's words and zeros up to the longest table: so that C reads valid memory for any q."""
    words = table.words()
    try:
        return ffi.new("uint32_t[]", [*words, *[0] * (EXTRA_WORDS + MAX_Q - len(words))])
    except OverflowError:  # a word of more than 32 bits: no table
        return ffi.NULL


def _fit(value: int, most: int, refused: int | None = None) -> int:
    """``value`` if the C type holds it, else a number that the C refuses: ``refused``, or the largest."""
    value = index(value)
    if 0 <= value <= most:
        return value
    return most if refused is None else refused


def _check(status: int, **settings: object) -> None:
    if status != Status.OK:
        reason = _STATUS[status]
        raise FirmwareError(reason, _REASONS[reason].format(**settings))


def _flatten(name: str, value: Any, kind: Any) -> Iterator[tuple[str, int]]:
    """Numbers inside a C value by name; members of the counters go without the counters' name.

    Who was heard is taken by words, as in an image, however C divides it.
    """
    if kind.kind == "struct":
        prefix = f"{name}_" if name and kind != ffi.typeof("mcp_asdf_counters_t") else ""
        for member, field in kind.fields:
            yield from _flatten(prefix + member, getattr(value, member), field.type)
    elif kind.kind in ("array", "union"):
        for index, (word,) in enumerate(struct.iter_unpack("<I", ffi.buffer(ffi.addressof(value)))):
            yield f"{name}_{index}", word
    elif kind.kind == "primitive":
        yield name, int(value)
