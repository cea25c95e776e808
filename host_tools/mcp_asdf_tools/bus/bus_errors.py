"""What an exception out of a python-can interface means: damaged input, or a bus that has failed or is gone.

Interfaces raise what they like: slcan raises ValueError, IndexError or CanOperationError for a damaged line,
and CanOperationError for an adapter that was unplugged. The exception that caused it makes the difference.
"""

from __future__ import annotations

import errno
import struct
from collections.abc import Iterable, Iterator

import can
import serial  # type: ignore[import-untyped]

_DECODING_ERRORS = (ValueError, LookupError, TypeError, ArithmeticError, AttributeError, struct.error)
"""What decoders raise for input that they do not expect."""

_TEMPORARY_FAILURES = frozenset(
    {
        *(errno.EAGAIN, errno.EINTR, errno.ENOBUFS, errno.ENOMEM, errno.EPERM, errno.ETIMEDOUT),
        *(errno.ENETDOWN, errno.ENETUNREACH, errno.EHOSTUNREACH, errno.EADDRNOTAVAIL, errno.ECONNREFUSED),
    }
)
"""Error numbers of a full queue, an interface that is down, or a group that is out of reach: the connection
is there, and works again when the cause is over."""


class BusGoneError(can.CanOperationError):
    """The bus is gone for good: its adapter was unplugged, or its connection is closed."""


def failure_of_bus(error: Exception, bus: can.BusABC) -> can.CanError | None:
    """Return the failure that ``error``, which ``bus`` has raised, stands for; None if input was undecodable.

    The failure is a BusGoneError unless the bus may work again. If it is not ``error`` itself, the caller has
    to raise it with ``error`` as its cause.
    """
    causes = list(_causes(error))
    # An error of the operating system decides, also where a driver has wrapped it in one of its own.
    system_error = _system_error_among(causes)
    if system_error is not None:
        return _failure_by_system_error(error, system_error)
    decoding_errors = [cause for cause in causes if isinstance(cause, _DECODING_ERRORS)]
    if decoding_errors:
        # Operations on a closed port or socket raise these errors, too.
        if _is_closed(bus):
            return _create_bus_gone_error(error, decoding_errors[0])
        return None
    if isinstance(error, can.CanError):
        return error  # A driver's own error may be a state that passes, such as bus-off or a full queue.
    return _create_bus_gone_error(error, error)


def _failure_by_system_error(error: Exception, system_error: OSError) -> can.CanError:
    """Return the failure that ``error`` stands for; the operating system's ``system_error`` has caused it.

    The failure is a BusGoneError if the bus will not work again. Otherwise it is ``error`` itself if that is
    a can.CanError, and a can.CanOperationError with the same text if not.
    """
    if not _is_temporary(system_error):
        return _create_bus_gone_error(error, system_error)
    if isinstance(error, can.CanError):
        return error
    return can.CanOperationError(str(error))


def _causes(error: BaseException | None) -> Iterator[BaseException]:
    """Yield an exception and the chain of its causes."""
    while error is not None:
        yield error
        error = error.__cause__


def _system_error_among(causes: Iterable[BaseException]) -> OSError | None:
    """Return the first cause that the operating system or pyserial has raised; None if there is none."""
    for cause in causes:
        # python-can's own time-out is an OSError, too.
        if isinstance(cause, OSError) and not isinstance(cause, can.CanError):
            return cause
    return None


def _is_temporary(error: OSError) -> bool:
    """Return whether the bus may work again after ``error``.

    Among pyserial's errors, which have no number, only a full output buffer is temporary.
    """
    is_timeout = isinstance(error, TimeoutError | serial.SerialTimeoutException)
    return is_timeout or error.errno in _TEMPORARY_FAILURES


def _create_bus_gone_error(error: Exception, cause: BaseException) -> BusGoneError:
    """Return a BusGoneError with the messages of ``error`` and of the exception that caused it."""
    message = str(error) if cause is error else f"{error}: {cause}"
    return BusGoneError(message)


def _is_closed(bus: can.BusABC) -> bool:
    """Return whether the connection's file descriptor is closed, or can no longer be asked for.

    Returns False where the interface has none.
    """
    try:
        descriptor = bus.fileno()
    except NotImplementedError:
        return False
    except (can.CanError, OSError, ValueError):  # ports and sockets that are closed raise any of these
        return True
    # A closed socket has the descriptor -1.
    return isinstance(descriptor, int) and descriptor < 0
