"""Input logs without a run."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from mcp_asdf_tools.recording.input_log import InputLogHeader, InputLogWriter


@contextmanager
def input_log_in(path: Path, header: InputLogHeader) -> Iterator[InputLogWriter]:
    """Writer of the input log ``path``, which is complete at the end."""
    with path.open("w") as file:
        file.write(header.line())
        writer = InputLogWriter(header, file.write)
        yield writer
        writer.finish()
