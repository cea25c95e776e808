"""The layout of every kind of frame: which bits of the data hold which field, and which values it may have.

This is the one table of the frames in Python. The codec (``frames``), the DBC file and the comparison of a
controller with its model all read it. ``docs/design.md`` shows the same layout to people, and
``c_ref/src/mcp_asdf_frame.h`` is the same codec in C.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from enum import Enum

from mcp_asdf.robot import Observation
from mcp_asdf_tools.common.errors import UsageError

FRAME_BYTES = 8
MAX_NODE_ID = 127
TRANSFER_ID_MODULUS = 32
"""Different values of a transfer_id, which counts a node's frames of one kind modulo this."""

Q23_ONE = 1 << 23
"""The number 1 in units of 2**-23, as x_hat and x have it."""
B_HAT_UNITS = 1 << 24
"""Units of b_hat in telemetry that make 1."""
MIN_B_HAT = 1 << 4
"""Smallest b_hat in telemetry, 2**-20 in units of 2**-24."""
MAX_B_HAT = B_HAT_UNITS - MIN_B_HAT
UPDATE_COUNT_MODULUS = 1 << 8
"""Number of values of the count of updates in telemetry, which wraps."""
MAX_FLOAT32_BITS = 0x7F7F_FFFF
"""Bits of the largest finite binary32 number. Infinity, NaN and all negative numbers have larger ones."""
EVERY_ROBOT = 255
"""Target of a command to all robots."""


class Rejection(Enum):
    """Reason why a frame is not the expected message.

    The value is the code of the same name in C, ``MCP_ASDF_FRAME_ERR_...``; ``mcp_asdf_frame.h`` explains it.
    """

    ERROR_FRAME = -21
    REMOTE_FRAME = -22
    FD_FRAME = -23
    STANDARD_ID = -24
    SERVICE = -25
    ANONYMOUS = -26
    RESERVED_BITS = -27
    SUBJECT = -28
    LENGTH = -29
    MULTI_FRAME = -30
    X_HAT = -31
    ALPHA = -32
    MODE = -33
    X = -34
    B_HAT = -35
    TARGET = -36
    ACTION = -37


class Health(Enum):
    """Health of a node (Cyphal's ``uavcan.node.Health``)."""

    NOMINAL = 0
    ADVISORY = 1
    CAUTION = 2
    WARNING = 3


class Mode(Enum):
    """Operating mode of a node (Cyphal's ``uavcan.node.Mode``)."""

    OPERATIONAL = 0
    INITIALIZATION = 1
    MAINTENANCE = 2
    SOFTWARE_UPDATE = 3


class Action(Enum):
    """Half of a control tick that a command asks for: to observe, which begins it, or to settle, its end."""

    OBSERVE_WHITE = 0
    OBSERVE_BLACK = 1
    OBSERVE_NONE = 2
    SETTLE = 3

    @classmethod
    def to_observe(cls, observation: Observation | None) -> Action:
        """Return the action that begins a tick with an observation, or without one if that is None.

        The actions to observe white and black have the values of Observation.
        """
        if observation is None:
            return cls.OBSERVE_NONE
        return cls(int(observation))

    @property
    def observation(self) -> Observation | None:
        """The observation that the action carries; None if it carries none.

        Raises ValueError for SETTLE, which is no observation.
        """
        if self is Action.OBSERVE_NONE:
            return None
        return Observation(self.value)


def check_range(name: str, value: int, minimum: int, maximum: int) -> None:
    """Raise UsageError, naming the value and its range, unless ``minimum <= value <= maximum``."""
    if not minimum <= value <= maximum:
        raise UsageError(f"{name} is {value}; it must be {minimum} to {maximum}")


@dataclass(frozen=True)
class Field:
    """Adjacent bits of a frame's 64 bits of data that hold one unsigned integer, or one binary32 number.

    Attributes:
        name: Name of the field, the same in Python, C, DBC and DSDL.
        first_bit: Position of its lowest bit; bit 0 is the lowest of the first byte.
        bit_count: Its length.
        meaning: What it holds, in a few words.
        minimum: Smallest integer that it may hold.
        maximum: Largest integer that it may hold, besides ``special_value``; by default what fits.
        special_value: One more integer that it may hold; None for none.
        value_names: Names of its integers, by value; empty if they are plain numbers.
        rejection: Why a frame is refused in which the field holds another integer; None where no decoder
            looks at it, because all its bits are legal.
        unit: What one unit of the integer is worth.
        is_float: Whether the bits are those of an IEEE binary32 number.
    """

    name: str
    first_bit: int
    bit_count: int
    meaning: str
    minimum: int = 0
    maximum: int = -1
    special_value: int | None = None
    value_names: Mapping[int, str] | None = None
    rejection: Rejection | None = None
    unit: float = 1.0
    is_float: bool = False

    def __post_init__(self) -> None:
        """Set the maximum to what fits into the bits if it is -1, the default."""
        if self.maximum == -1:
            # The dataclass is frozen, so that an assignment would be refused.
            object.__setattr__(self, "maximum", self.mask)

    @property
    def mask(self) -> int:
        """The largest integer that fits into the bits."""
        return (1 << self.bit_count) - 1

    def extract(self, payload: int) -> int:
        """Return the field's integer from a frame's 64 bits of data."""
        return (payload >> self.first_bit) & self.mask

    def is_legal(self, value: int) -> bool:
        """Return whether a frame may hold ``value`` in this field: one of its range, or the special one."""
        is_in_range = self.minimum <= value <= self.maximum
        return is_in_range or value == self.special_value

    def insert(self, value: int) -> int:
        """Return ``value`` shifted to the field's bits in the data. Raises UsageError if it is not legal."""
        if value != self.special_value:
            check_range(self.name, value, self.minimum, self.maximum)
        return value << self.first_bit


TRANSFER_ID = Field(
    "transfer_id",
    56,
    5,
    "number of the sender's messages of this kind modulo 32",
    maximum=TRANSFER_ID_MODULUS - 1,
)
START_END_TOGGLE = Field("start_end_toggle", 61, 3, "7: the transfer is this one frame", minimum=7, maximum=7)
_TAIL_BYTE = (TRANSFER_ID, START_END_TOGGLE)
"""The last byte of every Cyphal frame on classic CAN."""


@dataclass(frozen=True)
class FrameKind:
    """Kind of frames: a classic CAN frame of 8 bytes that is also a Cyphal v1 single-frame message.

    Attributes:
        name: Its name in the DBC file.
        meaning: What it is, in a few words.
        fields: Its fields from the first bit on; decoders check them in this order.
    """

    name: str
    meaning: str
    fields: tuple[Field, ...]

    @property
    def fields_and_tail(self) -> tuple[Field, ...]:
        """The fields, followed by those of the tail byte."""
        return self.fields + _TAIL_BYTE

    def field(self, name: str) -> Field:
        """Return the field of that name, which must be one of the kind or of the tail byte."""
        [named_field] = [field for field in self.fields_and_tail if field.name == name]
        return named_field

    def pack(self, transfer_id: int, values: Mapping[str, int]) -> int:
        """Return the 64 bits of data that hold these integers by field name.

        Raises UsageError for a value that a decoder would refuse, so that no such frame is ever sent.
        """
        single_frame = START_END_TOGGLE.maximum  # start, end and toggle are all 1: it is the only frame
        payload = TRANSFER_ID.insert(transfer_id) | START_END_TOGGLE.insert(single_frame)
        # Every field has bits of its own, so that none overwrites another.
        for field in self.fields:
            payload |= field.insert(values[field.name])
        return payload

    def unpack(self, payload: int) -> dict[str, int] | Rejection:
        """Return the integers in 64 bits of data by field name, or the first reason to refuse them.

        The tail byte, which all kinds of frames have, is left out.
        """
        values = {}
        # The first wrong field decides, as in C. Spare bits between fields may have any value.
        for field in self.fields:
            value = field.extract(payload)
            if field.rejection is not None and not field.is_legal(value):
                return field.rejection
            values[field.name] = value
        return values


def _names(enum: type[Enum]) -> dict[int, str]:
    """Return the names of an enumeration's members by their values."""
    return {member.value: member.name for member in enum}


ESTIMATE = FrameKind(
    "Estimate",
    "A robot's broadcast",
    (
        Field(
            "x_hat",
            0,
            24,
            "local estimate (eq. 3)",
            maximum=Q23_ONE,
            rejection=Rejection.X_HAT,
            unit=2.0**-23,
        ),
        Field(
            "alpha",
            24,
            32,
            "local confidence (eq. 4)",
            maximum=MAX_FLOAT32_BITS,
            rejection=Rejection.ALPHA,
            is_float=True,
        ),
    ),
)

HEARTBEAT = FrameKind(
    "Heartbeat",
    "A node's heartbeat, once per second",
    (
        Field("uptime", 0, 32, "seconds since start"),
        # Health and mode take 2 and 3 bits of a byte; receivers ignore the spare ones, as Cyphal asks.
        Field("health", 32, 2, "health of the node", value_names=_names(Health)),
        Field(
            "mode",
            40,
            3,
            "operating mode of the node",
            maximum=Mode.SOFTWARE_UPDATE.value,
            value_names=_names(Mode),
            rejection=Rejection.MODE,
        ),
        Field("vendor_status", 48, 8, "the application's own code"),
    ),
)

TELEMETRY = FrameKind(
    "Telemetry",
    "A robot's state for observers of the bus",
    (
        Field(
            "x",
            0,
            24,
            "informed estimate (eq. 7)",
            maximum=Q23_ONE,
            rejection=Rejection.X,
            unit=2.0**-23,
        ),
        Field(
            "b_hat",
            24,
            24,
            "assumed accuracy",
            minimum=MIN_B_HAT,
            maximum=MAX_B_HAT,
            rejection=Rejection.B_HAT,
            unit=2.0**-24,
        ),
        Field("updates", 48, 8, "number of re-estimates of b_hat (eq. 8) modulo 256"),
    ),
)

COMMAND = FrameKind(
    "Command",
    "A simulator's order",
    (
        Field("tick", 0, 32, "number of the control tick"),
        Field(
            "target",
            32,
            8,
            "id of the robot addressed",
            maximum=MAX_NODE_ID,
            special_value=EVERY_ROBOT,
            value_names={EVERY_ROBOT: "EVERY_ROBOT"},
            rejection=Rejection.TARGET,
        ),
        # The byte behind the action is spare; receivers ignore it, as Cyphal asks.
        Field(
            "action",
            40,
            8,
            "half of a tick to do",
            maximum=Action.SETTLE.value,
            value_names=_names(Action),
            rejection=Rejection.ACTION,
        ),
    ),
)
