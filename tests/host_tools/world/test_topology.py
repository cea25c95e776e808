"""Who hears whom: files of edges, and the moving world behind a swarm."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from mcp_asdf_tools.common.errors import UsageError
from mcp_asdf_tools.world.arena import Arena, ArenaSettings, Tiles, square_side
from mcp_asdf_tools.world.swarm_world import World, arena_seed
from mcp_asdf_tools.world.topology import Graph, read_graph


def graph_of(text: str, folder: Path) -> Graph:
    path = folder / "edges.txt"
    path.write_text(text)
    return read_graph(path)


def test_a_file_of_edges(tmp_path: Path) -> None:
    graph = graph_of("# a line and a way back\n\n0 1\n 1  2 # both\n3>2\n2 > 4\n", tmp_path)
    assert [sorted(graph.neighbours(robot)) for robot in range(5)] == [[1], [0, 2], [1, 3], [], [2]]
    assert graph.source == str(tmp_path / "edges.txt")


def test_an_empty_file_is_a_graph_of_hermits(tmp_path: Path) -> None:
    assert graph_of("", tmp_path).neighbours(0) == frozenset()


@settings(max_examples=100, derandomize=True, database=None)
@given(st.frozensets(st.tuples(st.integers(0, 127), st.integers(0, 127)).filter(lambda e: e[0] != e[1])))
def test_any_graph_reads_back(
    tmp_path_factory: pytest.TempPathFactory, links: frozenset[tuple[int, int]]
) -> None:
    path = tmp_path_factory.mktemp("graph") / "g"
    path.write_text("".join(f"{a} > {b}\n" for a, b in links))
    graph = read_graph(path)
    assert graph.links == links
    for robot in {end for link in links for end in link}:
        assert set(graph.neighbours(robot)) == {a for a, b in links if b == robot}


@pytest.mark.parametrize(
    ("text", "complaint"),
    [
        ("0 1\n2\n", "line 2: '2' is no edge; write two ids, such as '3 5' or '3 > 5'"),
        ("0 1 2", "line 1: '0 1 2' is no edge"),
        ("\n0 > 1 > 2", "line 2: '0 > 1 > 2' is no edge"),
        ("0 >", "line 1: '0 >' is no edge"),
        ("> 0 1", "line 1: '> 0 1' is no edge"),
        ("0 one", "line 1: 'one' is no robot; ids are 0 to 127"),
        ("0 128", "line 1: '128' is no robot"),
        ("0 -1", "line 1: '-1' is no robot"),
        ("0 1.5", "line 1: '1.5' is no robot"),
        ("4 4", "line 1: robot 4 cannot be its own neighbour; cut the edge"),
        ("0 1\n# again\n1 0", "line 3: that robot 0 hears 1 stands in line 1 already; cut one of them"),
        ("0 > 1\n0 1", "line 2: that robot 1 hears 0 stands in line 1 already"),
    ],
)
def test_errors_name_the_line(text: str, complaint: str, tmp_path: Path) -> None:
    with pytest.raises(UsageError) as caught:
        graph_of(text, tmp_path)
    assert complaint in str(caught.value)


def test_a_file_that_is_no_text_is_refused(tmp_path: Path) -> None:
    (tmp_path / "g").write_bytes(b"\xff\xfe\0")
    with pytest.raises(UsageError, match="cannot read the graph"):
        read_graph(tmp_path / "g")


def test_ids_must_be_robots(tmp_path: Path) -> None:
    graph = graph_of("0 1\n1 7\n", tmp_path)
    graph.check(8)
    with pytest.raises(UsageError, match="names robot 7, but the ids of 7 robots are 0 to 6"):
        graph.check(7)


# A world whose robots move


def arena_of(robots: int, seed: int) -> Arena:
    side = square_side(robots, 2.0)
    return Arena(ArenaSettings(robots, side, side, Tiles(0.4)), arena_seed(seed))


def test_robots_that_move_see_the_floor_through_their_sensors() -> None:
    """Recomputed from an arena of the same seed and the documented streams of the sensors."""
    seed, accuracies = 77, [0.9, 0.6, 1.0]
    seen = World(0.4, accuracies, arena_of(3, seed), seed).observe(50)
    twin = arena_of(3, seed)
    streams = [
        np.random.Generator(np.random.PCG64(np.random.SeedSequence(seed, spawn_key=(i,)))) for i in range(3)
    ]
    for tick in range(50):
        twin.step()
        for robot, stream in enumerate(streams):
            _, draw = stream.random(2)
            is_black = bool(twin.black[robot])
            assert seen[tick, robot] == (is_black if draw < accuracies[robot] else not is_black)


def test_the_world_moves_with_each_observation() -> None:
    arena = arena_of(8, 5)
    world, twin = World(0.4, [0.9] * 8, arena, 5), arena_of(8, 5)
    changes = 0
    for _ in range(100):
        before = twin.links.tolist()
        world.observe()
        twin.step()
        changes += twin.links.tolist() != before
        assert [arena.neighbours(robot) for robot in range(8)] == [
            twin.neighbours(robot) for robot in range(8)
        ]
    assert changes > 5


def test_how_many_ticks_are_drawn_at_once_changes_nothing_in_an_arena() -> None:
    world = World(0.4, [0.9] * 5, arena_of(5, 1), 1)
    pieces = [world.observe(ticks) for ticks in (7, 13, 1)]
    assert np.array_equal(np.concatenate(pieces), World(0.4, [0.9] * 5, arena_of(5, 1), 1).observe(21))
