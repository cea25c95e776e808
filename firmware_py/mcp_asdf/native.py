"""The C firmware itself, behind the same interface as its mirror.

``lib`` and ``ffi`` are the C functions and types as cffi offers them, for engines that drive many robots
from C: ``lib.mcp_asdf_receive(robot.pointer, ...)``.
"""

from __future__ import annotations

import operator
import struct
from collections.abc import Iterable
from dataclasses import fields
from typing import TYPE_CHECKING, Any

from mcp_asdf._native import ffi, lib
from mcp_asdf.fixed_point import FixedPointView, b_hat_to_raw
from mcp_asdf.image_format import IMPOSSIBLE_STATE, find_image_error, image_size
from mcp_asdf.robot import B_HAT_MARGIN, Config, Counters, Filter, FirmwareError, Observation, Status
from mcp_asdf.table import EXTRA_WORDS, MAX_Q, MAX_WORD, Table

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

__all__ = ["NativeRobot", "ffi", "lib"]

_MAX_BYTE = 2**8 - 1
# A dictionary, since it is used at every call of the C, and Status(value) takes several times as long.
_STATUS_BY_VALUE = {int(status): status for status in Status}
_ZEROS_RECEIVED = ffi.new("mcp_asdf_received_t *")
"""What a robot has received before the first message, for ``state``: sums of 0, or estimates of 0."""

_ERROR_MESSAGES = {
    Status.ERR_CONFIG: "the firmware refuses the filter, the filter_period or the memory of {config}",
    Status.ERR_TABLE: "the adaptive filter needs a sound table; make one with mcp-asdf table",
    Status.ERR_ID: "robot id is {robot_id}; choose 0 .. 127",
    Status.ERR_B_HAT: "b_hat is {b_hat}; choose one in [2**-20, 1 - 2**-20]",
}


class NativeRobot(FixedPointView):
    """MCP-ASDF in C. Implements ``FixedPointRobot``.

    Args:
        config: Settings, which robots may share.
        robot_id: Id of this robot, 0 .. 127.
        b_hat: Initial accuracy that the robot assumes of its sensor, rounded to a multiple of 2**-32.

    Attributes:
        config: Settings.
        pointer: The robot's ``mcp_asdf_t *``, valid for as long as this object lives.

    Raises:
        FirmwareError: Where ``mcp_asdf_init`` returns an error.
    """

    def __init__(self, config: Config, robot_id: int, b_hat: float) -> None:
        """Make a robot without observations, which assumes that its sensor has the accuracy ``b_hat``.

        Raises FirmwareError for an argument that the firmware refuses.
        """
        self._allocate(config)
        is_b_hat_valid = B_HAT_MARGIN <= b_hat <= 1 - B_HAT_MARGIN
        raw_b_hat = b_hat_to_raw(b_hat) if is_b_hat_valid else 0  # the C refuses 0
        status = lib.mcp_asdf_init(
            self.pointer, self._c_config.pointer, _fit_to_c_type(robot_id, _MAX_BYTE), raw_b_hat
        )
        _raise_for_error(status, config=config, robot_id=robot_id, b_hat=b_hat)

    def _allocate(self, config: Config) -> None:
        """Allocate the C structs of the robot and of its settings; the robot's is not initialised yet."""
        self.config = config
        self.pointer = ffi.new("mcp_asdf_t *")
        self._c_config = _CConfig(config)

    @classmethod
    def restore(cls, config: Config, image: bytes) -> NativeRobot:
        """Make a robot from an image of ``save``.

        Raises FirmwareError for an invalid ``config`` (ERR_CONFIG or ERR_TABLE), and for an image that is
        damaged, of another version or impossible with ``config`` (ERR_IMAGE). Raises TypeError for an
        ``image`` that is not bytes-like.
        """
        # memoryview raises TypeError for a number, from which bytes alone would make zeros.
        image_bytes = bytes(memoryview(image))
        robot = cls.__new__(cls)  # without __init__, which would initialise it as a new robot
        robot._allocate(config)
        # The C reads as many bytes as an image with this filter has, whatever it is given. Zeros, which it
        # refuses, take the place of an image of another size.
        size = image_size(config.filter)
        c_image = image_bytes if len(image_bytes) == size else bytes(size)
        status = lib.mcp_asdf_restore(robot.pointer, robot._c_config.pointer, c_image)
        if status == Status.ERR_IMAGE:
            # The C does not say what is wrong: the outer form, or the state that the image holds.
            error_in_form = find_image_error(image_bytes, config.filter)
            raise FirmwareError(Status.ERR_IMAGE, error_in_form or IMPOSSIBLE_STATE)
        _raise_for_error(status, config=config)
        return robot

    def save(self) -> bytes:
        """Return the state as an image for ``restore``."""
        image = ffi.new("uint8_t[]", lib.MCP_ASDF_IMAGE_SIZE)
        lib.mcp_asdf_save(self.pointer, image)
        # The buffer is as long as the longest image; other filters fill only its beginning.
        return bytes(image)[: image_size(self.config.filter)]

    def observe(self, z: Observation) -> Status:
        """Count an observation, and compute x_hat and alpha from all observations so far.

        Returns OK; or ERR_OBSERVATION, and changes nothing, if ``z`` is neither WHITE nor BLACK.
        """
        return _STATUS_BY_VALUE[lib.mcp_asdf_observe(self.pointer, _fit_to_c_type(z, MAX_WORD))]

    def _receive(self, sender: int, x_hat: int, alpha: int) -> Status:
        """Add a neighbour's estimate to the open round or, with the robust filter, to its received estimates.

        ``x_hat`` is in units of 2**-23, and ``alpha`` a word of 32 bits: a mantissa (bits 8 to 31) and a
        shift (bits 0 to 4). Returns OK, REPEATED, ERR_SENDER or ERR_X_HAT, as ``receive_raw`` explains, and
        counts the estimate as accepted, repeated or rejected.
        """
        try:
            return _STATUS_BY_VALUE[lib.mcp_asdf_receive(self.pointer, sender, x_hat, alpha)]
        except OverflowError:
            # The sender does not fit a byte, or x_hat does not fit 32 bits, so it is out of its range. The C
            # gets the largest number of its type instead, which is out of range, too, so that it rejects and
            # counts the message. The alpha fits: ``receive_raw`` has checked it.
            c_sender = _fit_to_c_type(sender, _MAX_BYTE)
            c_x_hat = _fit_to_c_type(x_hat, MAX_WORD)
            return _STATUS_BY_VALUE[lib.mcp_asdf_receive(self.pointer, c_sender, c_x_hat, alpha)]

    def _receive_all(self, messages: NDArray[np.uint32]) -> int:
        """Receive messages whose array was checked, and return how many of them were accepted.

        A row of the array is a message, with the columns sender, x_hat and alpha.
        """
        c_messages = ffi.from_buffer("uint32_t[]", messages)
        return int(lib.mcp_asdf_receive_all(self.pointer, c_messages, len(messages)))

    def settle(self) -> Status:
        """Close the open round, and run the filter if ``filter_period`` rounds have passed.

        Returns UPDATED if the filter has re-estimated b_hat, the assumed accuracy, and OK otherwise.
        """
        return _STATUS_BY_VALUE[lib.mcp_asdf_settle(self.pointer)]

    def step(self, z: Observation) -> Status:
        """Observe ``z``, then settle.

        Returns UPDATED if the filter has run and re-estimated b_hat, and OK otherwise; or ERR_OBSERVATION,
        without settling, for an invalid ``z``.
        """
        return _STATUS_BY_VALUE[lib.mcp_asdf_step(self.pointer, _fit_to_c_type(z, MAX_WORD))]

    @property
    def id(self) -> int:
        """Id of this robot."""
        return int(self.pointer.id)

    @property
    def t(self) -> int:
        """Number of observations."""
        return int(lib.mcp_asdf_t_count(self.pointer))

    @property
    def n(self) -> int:
        """Number of black observations."""
        return int(lib.mcp_asdf_n_count(self.pointer))

    @property
    def b_hat_raw(self) -> int:
        """Accuracy that this robot assumes of its sensor, in units of 2**-32."""
        return int(lib.mcp_asdf_b_hat(self.pointer))

    @property
    def x_hat_raw(self) -> int:
        """Local estimate in units of 2**-23."""
        return int(lib.mcp_asdf_x_hat(self.pointer))

    @property
    def alpha_raw(self) -> int:
        """Local confidence as an alpha word: a mantissa (bits 8 to 31) and a shift (bits 0 to 4)."""
        return int(lib.mcp_asdf_alpha(self.pointer))

    @property
    def x_bar_raw(self) -> int:
        """Social estimate, the neighbours' weighted mean, in units of 2**-23; 1/2 if there is none."""
        return int(lib.mcp_asdf_x_bar(self.pointer))

    @property
    def beta_raw(self) -> int:
        """Social confidence in units of 2**-24."""
        return int(lib.mcp_asdf_beta(self.pointer))

    @property
    def x_raw(self) -> int:
        """Informed estimate, which combines the local and the social one, in units of 2**-23."""
        return int(lib.mcp_asdf_x(self.pointer))

    @property
    def counters(self) -> Counters:
        """Numbers of events since the robot was made."""
        c_counters = lib.mcp_asdf_counters(self.pointer)
        return Counters(*(getattr(c_counters, member.name) for member in fields(Counters)))

    def state(self) -> dict[str, int]:
        """Return all numbers of the robot's C struct, ``mcp_asdf_t``, by name, to compare two firmwares.

        The names are those of ``MirrorRobot.state``, such as ``t``, ``open_alpha`` and ``estimates_31``.
        ``config``, a pointer, is left out. The robot has either the estimates of the robust filter or the
        sums of the other filters; those that it does not have are 0.
        """
        c_robot = self.pointer[0]
        # The estimates and the sums are a union: the same memory, of which the filter tells the meaning.
        if self.config.filter == Filter.ROBUST:
            estimates = c_robot.received.estimates
            sums = _ZEROS_RECEIVED.sums
        else:
            estimates = _ZEROS_RECEIVED.estimates
            sums = c_robot.received.sums
        # The set of senders heard is a union, too: 128 bits, one an id, here in words as in an image.
        words_of_senders = struct.unpack("<4I", ffi.buffer(ffi.addressof(c_robot.heard)))
        return {
            **_numbers_in_struct(c_robot),  # without its pointer ``config`` and its two unions
            **_numbers_in_array("heard", words_of_senders),
            **_numbers_in_array("estimates", estimates),
            **_numbers_in_struct(sums),
        }

    def holds_invariants(self) -> bool:
        """Return whether calls alone could have led to this state (``docs/internals/properties.md``).

        False means that the state was damaged, for example in memory.
        """
        return bool(lib.mcp_asdf_invariants_hold(self.pointer))


class _CConfig:
    """A config and its table as C structs, in memory that lives for as long as this object.

    ``pointer`` is the ``mcp_asdf_config_t *``. Settings that do not fit their C types become numbers that the
    C refuses, so that every config can be converted.
    """

    def __init__(self, config: Config) -> None:
        """Copy the settings, and the table of the adaptive filter, to C.

        A number that does not fit its C type becomes one that the C refuses.
        """
        # An attribute keeps the array of the table alive; the pointer in the C struct does not. The other
        # filters read no table.
        self._table = ffi.NULL
        if config.filter == Filter.ADAPTIVE and config.table is not None:
            self._table = _allocate_table(config.table)
        self.pointer = ffi.new("mcp_asdf_config_t *")
        self.pointer.table = self._table
        self.pointer.filter_period = _fit_to_c_type(config.filter_period, MAX_WORD, substitute=0)
        self.pointer.memory = _fit_to_c_type(config.memory, MAX_WORD, substitute=0)
        self.pointer.filter = _fit_to_c_type(config.filter, _MAX_BYTE)


def _allocate_table(table: Table) -> Any:
    """Return the words of a table of thresholds as a C array, or NULL if one of them does not fit 32 bits.

    The array has the length of the longest table, with zeros behind the words. The C reads as many words as
    the table's q says, and in a damaged table q may be larger than the number of its words.
    """
    table_words = table.words()
    padding = [0] * (EXTRA_WORDS + MAX_Q - len(table_words))
    try:
        return ffi.new("uint32_t[]", [*table_words, *padding])
    except OverflowError:  # a word does not fit
        return ffi.NULL


def _fit_to_c_type(value: int, maximum: int, substitute: int | None = None) -> int:
    """Return ``value`` as Python's ``int`` if it fits a C type, 0 .. ``maximum``, else ``substitute``.

    The substitute must be a number that fits the type but that the C refuses. By default it is ``maximum``
    itself, which is out of range as an id, an x_hat, an observation or a filter.
    """
    number = operator.index(value)
    if 0 <= number <= maximum:
        return number
    return maximum if substitute is None else substitute


def _raise_for_error(status: int, **settings: object) -> None:
    """Raise FirmwareError unless ``status``, a result of the C, is OK.

    ``settings`` are the arguments of the call by name. The error's text has the argument that is wrong.
    """
    if status != Status.OK:
        error = _STATUS_BY_VALUE[status]
        raise FirmwareError(error, _ERROR_MESSAGES[error].format(**settings))


def _numbers_in_struct(c_struct: Any, prefix: str = "") -> dict[str, int]:
    """Return the numbers in a C struct, each by the name of its member after ``prefix``.

    The name of a nested struct becomes a prefix, as in ``open_alpha``, but the name ``counters`` does not.
    Pointers and unions are left out: a union does not say which of its members is in use.
    """
    numbers: dict[str, int] = {}
    for name, field in ffi.typeof(c_struct).fields:
        member = getattr(c_struct, name)
        if field.type.kind == "primitive":
            numbers[prefix + name] = int(member)
        elif field.type.kind == "struct":
            prefix_of_members = "" if name == "counters" else f"{name}_"
            numbers.update(_numbers_in_struct(member, prefix_of_members))
    return numbers


def _numbers_in_array(name: str, array: Iterable[int]) -> dict[str, int]:
    """Return the elements of an array, each by its name and index, as in ``estimates_31``."""
    return {f"{name}_{element_index}": int(element) for element_index, element in enumerate(array)}
