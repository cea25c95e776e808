"""Sidecars without a run."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from mcp_asdf_tools.recording.sidecar import SidecarHeader, SidecarWriter


@contextmanager
def sidecar_in(path: Path, header: SidecarHeader) -> Iterator[SidecarWriter]:
    """Writer of the sidecar ``path``, which is complete at the end."""
    with path.open("w") as file:
        file.write(header.line())
        writer = SidecarWriter(header, file.write)
        yield writer
        writer.finish()
