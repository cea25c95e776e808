"""Recordings that commands make: one line if something goes wrong with them, and the exit code for that."""

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
    """The recording of a command on a bus; what goes wrong is on standard error at once."""

    def warn(text: str) -> None:
        print(f"mcp-asdf {command}: {text}", file=sys.stderr)

    if path is None:
        return NoRecording()
    _logger.info("recording the frames in %s", path)
    return Recording(path, header, warn, choice.channel or choice.interface)


def exit_code(recording: Recording | NoRecording, code: int) -> int:
    """The exit code of a command that would end with ``code`` if its recording were complete."""
    return code if recording.failure is None or code == 1 else 2
