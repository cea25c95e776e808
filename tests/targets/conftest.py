"""C nodes on a bus of Unix sockets, built for this computer and for a Cortex-A8."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import pytest

from support import slow
from targets.c_node import (
    CORTEX_A8,
    HOST,
    CNode,
    Kind,
    Start,
    built,
)
from targets.unix_bus import UnixBus


@pytest.fixture(scope="module", params=[HOST, *slow([CORTEX_A8])], ids=lambda kind: kind.name)
def command(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> list[str]:
    kind: Kind = request.param
    return built(kind, tmp_path_factory)


@pytest.fixture
def bus(tmp_path: Path) -> Iterator[UnixBus]:
    with UnixBus(tmp_path / "bus") as opened:
        yield opened


@pytest.fixture
def start(command: list[str], bus: UnixBus) -> Iterator[Start]:
    """Starts nodes on the bus, and stops those that are left."""
    started: list[CNode] = []

    def start_node(robot_id: int | str, *options: object, **streams: object) -> CNode:
        started.append(CNode(command, bus.channel_info, robot_id, *options, **streams))
        return started[-1]

    yield start_node
    for node in started:
        node.__exit__()
