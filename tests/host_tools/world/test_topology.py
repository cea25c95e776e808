"""Graphs: which descriptions are read, and which are refused."""

from __future__ import annotations

from pathlib import Path
from unittest.mock import Mock

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from mcp_asdf_tools.common.errors import UsageError
from mcp_asdf_tools.world.graph import Graph, parse_graph
from mcp_asdf_tools.world.topology import graph_topology


def parse_file(content: str, folder: Path) -> Graph:
    """Return the graph of a file with this content."""
    path = folder / "edges.txt"
    path.write_text(content)
    return parse_graph(path)


def senders_by_receiver(graph: Graph, robots: int) -> list[list[int]]:
    """Return for each robot, by id, the ids from which it receives."""
    (neighbours,) = graph_topology(graph, robots).advance(1)
    return [np.flatnonzero(row).tolist() for row in neighbours]


def test_a_file_of_edges_says_which_robots_receive_from_which(tmp_path: Path) -> None:
    """ "0 1" is an edge in both directions, and by "3 > 2" robot 2 receives from robot 3 alone."""
    graph = parse_file("# a comment\n\n0 1\n 1  2 # another comment\n3>2\n2 > 4\n", tmp_path)
    assert senders_by_receiver(graph, robots=5) == [[1], [0, 2], [1, 3], [], [2]]
    assert str(graph) == "0 1; 1 2; 2 > 4; 3 > 2"


def test_a_graph_knows_its_file(tmp_path: Path) -> None:
    """``parse_graph`` gets the path of the file, and keeps it as the source of the graph."""
    path = tmp_path / "edges.txt"
    path.write_text("0 1")
    assert parse_graph(path).source == str(path)


@pytest.mark.parametrize(
    "text",
    ["", "\n", "# 0 1\n", "\ufeff"],
    ids=["an empty file", "an empty line", "a comment", "a byte order mark"],
)
def test_a_graph_file_without_edges_is_refused(text: str, tmp_path: Path) -> None:
    """The error names the file, which is called edges.txt."""
    message = r"edges\.txt has no edge, so no robot would hear another; write edges"
    with pytest.raises(UsageError, match=message):
        parse_file(text, tmp_path)


@pytest.mark.parametrize("graph_without_edges", [[], "", " ; ", np.zeros((3, 3), np.bool_)])
def test_an_object_or_a_text_without_edges_is_refused(graph_without_edges: object) -> None:
    """An empty list has none, for example, nor has an array in which no robot receives from another."""
    with pytest.raises(UsageError, match="graph has no edge"):
        parse_graph(graph_without_edges)


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
    """The graph is 0 1; 1 2. Text after an edge has no effect. An edge may be repeated in reverse."""
    graph = parse_file(text, tmp_path)
    assert str(graph) == "0 1; 1 2"


def test_a_weight_may_follow_an_edge_of_one_direction(tmp_path: Path) -> None:
    """Networkx writes {} behind an edge without a weight. The second edge has the weight 7."""
    graph = parse_file("0 > 1 {}\n2>1 7\n", tmp_path)
    assert str(graph) == "0 > 1; 2 > 1"


@settings(max_examples=50, derandomize=True, database=None)
@given(
    st.frozensets(
        st.tuples(st.integers(0, 127), st.integers(0, 127)).filter(lambda e: e[0] != e[1]), min_size=1
    )
)
def test_any_graph_is_the_same_when_it_is_written_and_parsed_again(links: frozenset[tuple[int, int]]) -> None:
    """The links, pairs of a sender and a receiver, are the same after each step."""
    edges = [f"{sender} > {receiver}" for sender, receiver in links]
    graph = parse_graph("; ".join(edges))
    assert graph.links == links
    assert parse_graph(str(graph)) == graph


@pytest.mark.parametrize(
    ("text", "expected_message"),
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
        ("# twice\n0 1\n0 1", "line 3: that robot 1 hears 0 is in line 2 already; remove one of them"),
        ("0 1\n1 > 0", "line 2: that robot 0 hears 1 is in line 1 already"),
        ("0 > 1\n0 1", "line 2: that robot 1 hears 0 is in line 1 already"),
    ],
)
def test_an_error_in_a_file_of_edges_names_its_line(text: str, expected_message: str, tmp_path: Path) -> None:
    """For example, the file with the text "0 1 two" is refused: "line 1: '0 1 two' is not an edge"."""
    with pytest.raises(UsageError) as raised:
        parse_file(text, tmp_path)
    assert expected_message in str(raised.value)


def test_a_file_that_is_no_text_is_refused(tmp_path: Path) -> None:
    """The bytes of the file are not valid in UTF-8."""
    path = tmp_path / "edges.txt"
    path.write_bytes(b"\xff\xfe\0")
    with pytest.raises(UsageError, match="cannot read the graph"):
        parse_graph(path)


def test_a_graph_that_names_robots_outside_the_swarm_is_refused() -> None:
    """The graph names robot 7. A swarm of eight has it. For a swarm of seven the error lists the ids."""
    graph = parse_graph("0 1; 1 7")
    graph.check(robots=8)  # raises no error
    with pytest.raises(UsageError, match="names robot 7, but the ids of 7 robots are 0 to 6"):
        graph.check(robots=7)


def test_a_robot_with_more_neighbours_than_a_round_holds_is_refused() -> None:
    """The firmware takes at most 127 estimates between two broadcasts, so 127 neighbours raise no error.

    Here robot 0 receives from robots 1 to 127, or 1 to 128.
    """
    links_from_127 = frozenset((sender, 0) for sender in range(1, 128))
    Graph(links_from_127).check(robots=128)  # raises no error

    links_from_128 = links_from_127 | {(128, 0)}
    with pytest.raises(UsageError, match="robot 0 hears 128 others, but a round of the firmware holds 127"):
        Graph(links_from_128).check(robots=129)


# --- Objects in Python -----------------------------------------------------------------------------------


def test_robots_of_a_pair_in_a_list_receive_from_each_other() -> None:
    """Each of the pairs (1, 3) and (3, 65535) becomes two links, one in each direction.

    An id may be an integer of numpy.
    """
    graph = parse_graph([(1, 3), (3, np.int64(65535))])
    assert graph.links == {(1, 3), (3, 1), (3, 65535), (65535, 3)}


def test_an_array_of_neighbours_has_a_row_for_each_receiver() -> None:
    """In row 3 robot 1 is marked as a sender, so the link is (1, 3). Row 0 has the sender 3."""
    neighbours = np.zeros((4, 4), np.bool_)  # by receiver and sender
    neighbours[3, 1] = True
    neighbours[0, 3] = True
    assert parse_graph(neighbours).links == {(1, 3), (3, 0)}  # (sender, receiver)


@pytest.mark.parametrize(
    ("is_directed", "expected_links"),
    [(True, {(1, 3), (3, 65535)}), (False, {(1, 3), (3, 1), (3, 65535), (65535, 3)})],
)
def test_an_undirected_graph_of_networkx_has_both_directions(
    is_directed: bool, expected_links: set[tuple[int, int]]
) -> None:
    """The graph has the two methods of networkx that ``parse_graph`` calls."""
    graph_of_networkx = Mock()
    graph_of_networkx.edges.return_value = [(1, 3), (3, np.int64(65535))]
    graph_of_networkx.is_directed.return_value = is_directed
    assert parse_graph(graph_of_networkx).links == expected_links


@pytest.mark.parametrize(
    "wrong_object",
    [np.zeros((3, 4), np.bool_), np.zeros(4, np.bool_), [(1, 2, 3)], [("1", 2)], Mock(spec=["edges"])],
)
def test_an_object_that_is_no_graph_is_refused(wrong_object: object) -> None:
    """One object is an array that is not square, for example. The error says what to give instead."""
    with pytest.raises(UsageError, match=r"graph (is|has) .*; give a"):
        parse_graph(wrong_object)
