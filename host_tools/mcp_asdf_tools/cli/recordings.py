"""Recordings of commands on a bus: how their failures are reported, and which exit code they lead to."""

from __future__ import annotations

import logging
import sys
from pathlib import Path

from mcp_asdf_tools.bus.interfaces import BusChoice
from mcp_asdf_tools.recording.events import EventsHeader
from mcp_asdf_tools.recording.recording import NoRecording, Recording

_logger = logging.getLogger(__name__)


def recording_for(
    command: str, path: Path | None, header: EventsHeader | None, choice: BusChoice
) -> Recording | NoRecording:
    """Return the recording of frames in the log ``path``, or one that keeps nothing if there is no ``path``.

    With ``header`` it has a file of events beside the log. A failure while it records is printed to standard
    error at once, with the name of the ``command``.
    """

    def warn(text: str) -> None:
        print(f"mcp-asdf {command}: {text}", file=sys.stderr)

    if path is None:
        return NoRecording()
    _logger.info("recording the frames in %s", path)
    return Recording(path, header, warn, choice.channel or choice.interface)


def exit_code(recording: Recording | NoRecording, code: int) -> int:
    """Return the exit code of a command that would end with ``code`` if its recording were complete.

    An incomplete recording gives 2, but a failure of the run itself, 1, is what matters more.
    """
    return code if recording.failure is None or code == 1 else 2
