"""Who hears whom: files of edges, and the moving world behind a swarm."""

from __future__ import annotations

from pathlib import Path
from unittest.mock import Mock

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from mcp_asdf_tools.common.errors import UsageError
from mcp_asdf_tools.world.topology import Graph, parse_graph


def read(text: str, folder: Path) -> Graph:
    path = folder / "edges.txt"
    path.write_text(text)
    return parse_graph(path)


def heard_in(graph: Graph, robots: int) -> list[list[int]]:
    (hears,) = graph.topology(robots).advance(1)
    return [np.flatnonzero(row).tolist() for row in hears]


def test_a_file_of_edges(tmp_path: Path) -> None:
    graph = read("# a line and a way back\n\n0 1\n 1  2 # both\n3>2\n2 > 4\n", tmp_path)
    assert heard_in(graph, 5) == [[1], [0, 2], [1, 3], [], [2]]
    assert (graph.source, str(graph)) == (str(tmp_path / "edges.txt"), "0 1; 1 2; 2 > 4; 3 > 2")


@pytest.mark.parametrize("text", ["", "\n", "# 0 1\n", "\ufeff"])
def test_a_graph_file_without_edges_is_refused(text: str, tmp_path: Path) -> None:
    with pytest.raises(
        UsageError, match=r"edges\.txt has no edge, so no robot would hear another; write edg"
    ):
        read(text, tmp_path)


@pytest.mark.parametrize("nothing", [[], "", " ; ", np.zeros((3, 3), np.bool_)])
def test_an_object_or_a_text_without_edges_is_refused(nothing: object) -> None:
    with pytest.raises(UsageError, match="graph has no edge"):
        parse_graph(nothing)


@pytest.mark.parametrize(
    "text",
    [
        "0 1 {}\n1 2 {}\n",
        "0 1 {'weight': 0.5}\n1 2 {'weight': 3}  # as networkx writes them\n",
        "0 1 0.5\n1 2 3\n",
        "\ufeff0 1\t1e-3\n1 2 -2\n",
        "0 1\n1 0\n2 1\n1 2\n",
    ],
)
def test_edge_lists_of_other_tools_are_read(text: str, tmp_path: Path) -> None:
    """They have attributes or a weight behind each edge, or list an edge in both directions."""
    assert str(read(text, tmp_path)) == "0 1; 1 2"


def test_a_weight_may_follow_an_edge_of_one_direction(tmp_path: Path) -> None:
    assert str(read("0 > 1 {}\n2>1 7\n", tmp_path)) == "0 > 1; 2 > 1"


@settings(max_examples=100, derandomize=True, database=None)
@given(
    st.frozensets(
        st.tuples(st.integers(0, 127), st.integers(0, 127)).filter(lambda e: e[0] != e[1]), min_size=1
    )
)
def test_any_graph_reads_back(links: frozenset[tuple[int, int]]) -> None:
    graph = parse_graph("; ".join(f"{a} > {b}" for a, b in links))
    assert graph.links == links
    assert heard_in(graph, 128) == [sorted(a for a, b in links if b == robot) for robot in range(128)]
    assert parse_graph(str(graph)) == graph


@pytest.mark.parametrize(
    ("text", "complaint"),
    [
        ("0 1\n2\n", "line 2: '2' is not an edge; write two ids, 0 to 65535, such as '3 5' or '3 > 5'"),
        ("0 1 2 3", "line 1: '0 1 2 3' is not an edge"),
        ("0 1 two", "line 1: '0 1 two' is not an edge"),
        ("0 1 {", "line 1: '0 1 {' is not an edge"),
        ("\n0 > 1 > 2", "line 2: '0 > 1 > 2' is not an edge"),
        ("0 >", "line 1: '0 >' is not an edge"),
        ("> 0 1", "line 1: '> 0 1' is not an edge"),
        ("0 one", "line 1: '0 one' is not an edge"),
        ("0 65536", "line 1: '0 65536' is not an edge"),
        ("65536 > 0", "line 1: '65536 > 0' is not an edge"),
        ("0 -1", "line 1: '0 -1' is not an edge"),
        ("4 4", "line 1: robot 4 cannot be its own neighbour; remove the edge"),
        ("0 1\n# again\n0 1", "line 3: that robot 1 hears 0 is in line 1 already; remove one of them"),
        ("0 1\n1 > 0", "line 2: that robot 0 hears 1 is in line 1 already"),
        ("0 > 1\n0 1", "line 2: that robot 1 hears 0 is in line 1 already"),
    ],
)
def test_errors_name_the_line(text: str, complaint: str, tmp_path: Path) -> None:
    with pytest.raises(UsageError) as caught:
        read(text, tmp_path)
    assert complaint in str(caught.value)


def test_a_graph_must_be_text_about_these_robots(tmp_path: Path) -> None:
    graph = read("0 1\n1 7\n", tmp_path)
    graph.check(8)
    with pytest.raises(UsageError, match="names robot 7, but the ids of 7 robots are 0 to 6"):
        graph.check(7)
    crowded = read("".join(f"{sender} > 5\n" for sender in range(200) if sender != 5), tmp_path)
    with pytest.raises(UsageError, match="robot 5 hears 199 others, but a round of the firmware holds 127"):
        crowded.check(200)
    Graph(frozenset((sender, 5) for sender in range(6, 133))).check(133)
    (tmp_path / "edges.txt").write_bytes(b"\xff\xfe\0")
    with pytest.raises(UsageError, match="cannot read the graph"):
        parse_graph(tmp_path / "edges.txt")


def test_a_graph_may_be_an_object() -> None:
    """Pairs, which hear each other, an array, or a graph of networkx, which knows its edges and direction."""
    heard, edges = np.zeros((4, 4), np.bool_), [(1, 3), (3, np.int64(65535))]
    heard[3, 1] = heard[0, 3] = True
    assert parse_graph(heard).links == {(1, 3), (3, 0)}
    assert parse_graph(Mock(edges=lambda: edges, is_directed=lambda: True)).links == {*edges}
    for each in (edges, Mock(edges=lambda: edges, is_directed=lambda: False)):
        assert parse_graph(each).links == {*edges, *(edge[::-1] for edge in edges)}
    for wrong in (heard[:3], heard[0], [(1, 2, 3)], [("1", 2)], Mock(spec=["edges"])):
        with pytest.raises(UsageError, match=r"graph (is|has) .*; give a"):
            parse_graph(wrong)
