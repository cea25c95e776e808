"""Files of events without a run."""

from __future__ import annotations

import gzip
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from mcp_asdf_tools.recording.events import (
    EventsHeader,
    EventsReader,
    EventsWriter,
    InjectedFrame,
    RobotEvents,
)


@contextmanager
def events_file(path: Path, header: EventsHeader) -> Iterator[EventsWriter]:
    """Yield a writer of the file of events ``path``, which is complete at the end."""
    with gzip.open(path, "wt", encoding="ascii") as file:
        file.write(header.to_line())
        writer = EventsWriter(header, file.write)
        yield writer
        writer.finish()


def lines_of(events: Path) -> list[str]:
    """Return the lines of a compressed file of events, with their ends."""
    with gzip.open(events, "rt", encoding="ascii") as file:
        return file.readlines()


def read_entries(path: Path) -> list[RobotEvents | InjectedFrame]:
    """Return all entries of a file of events."""
    with EventsReader(path) as reader:
        return list(reader.entries())
