"""Reading logs of frames in python-can's formats."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import can

from mcp_asdf_tools.common.errors import UsageError

_FORMATS = ".log (candump), .asc, .blf, .csv, .mf4 or .trc, each but .blf and .mf4 also with .gz"


def read_log(path: Path | str) -> Iterator[can.Message]:
    """Yield the frames of a log, in its order. The suffix tells the format.

    Raises UsageError, naming the place, if it cannot be read, is malformed or holds no frame.
    """
    number = 0
    try:
        Path(path).open("rb").close()  # so that no reader makes the file that it does not find
        with can.LogReader(Path(path)) as reader:
            for frame in reader:
                number += 1
                yield frame
    except OSError as error:
        raise UsageError(f"cannot read the log {path}: {error.strerror or error}") from error
    except Exception as error:  # a reader raises whatever its format's code happens to
        raise UsageError(
            f"the log {path} is malformed behind frame {number} ({type(error).__name__}: {error}), "
            f"or no log that the suffix tells: {_FORMATS}"
        ) from error
    if not number:
        raise UsageError(f"the log {path} holds no frame; is it a log of the format that the suffix tells?")
