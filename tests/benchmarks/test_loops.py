"""The longest path through code with loops."""

from __future__ import annotations

from pathlib import Path

import pytest

from benchmarks.cost.loops import Bound, Graph, bounds_in, longest_path


def count_longest_path(graph: Graph, source_lines: dict[int, str], bounds: dict[str, Bound]) -> int:
    """Return the number of instructions on the longest path from instruction 0 on.

    ``graph`` lists the instructions that may follow each instruction. ``source_lines`` says which line of the
    source an instruction comes from, such as "a.c:7", if that is the line of a loop. ``bounds`` says how
    often the loop of a line turns.
    """
    cost_by_instruction = dict.fromkeys(graph, 1)
    return longest_path(graph, cost_by_instruction, source_lines, bounds, start=0)


def test_bounds_are_read_from_the_comments_beside_loops(tmp_path: Path) -> None:
    """A comment states how often a loop turns, and may state how often in all the runs of an inner loop."""
    source = tmp_path / "sort.c"
    source.write_text(
        "for (i = 0; i < n; ++i) { /* at most 32 turns */\n"
        "    for (j = i; j > 0; --j) { /* at most 31 turns, 496 in all */\n"
        "    }\n"
        "}\n"
    )

    bounds_by_line = bounds_in([source])

    assert bounds_by_line == {
        "sort.c:1": Bound(turns=32, in_all=None),
        "sort.c:2": Bound(turns=31, in_all=496),
    }


def test_without_a_loop_the_longer_branch_counts() -> None:
    """After instruction 0, the longer branch has the instructions 1 and 2. Both branches end at 3.

    A graph lists the instructions that may follow each instruction.
    """
    graph = {0: [1, 3], 1: [2], 2: [3], 3: []}
    assert count_longest_path(graph, source_lines={}, bounds={}) == 4


def test_a_loop_that_is_left_at_its_end_counts_as_often_as_it_turns() -> None:
    """Instruction 2 goes back to 1 or leaves the loop, so ten turns are 20 instructions.

    It comes from line 7 of a.c, whose comment states ten turns. Each instruction counts 1.
    """
    graph = {0: [1], 1: [2], 2: [1, 3], 3: []}
    bounds = {"a.c:7": Bound(turns=10, in_all=None)}

    count = count_longest_path(graph, source_lines={2: "a.c:7"}, bounds=bounds)

    before, after = 1, 1
    assert count == before + 10 * 2 + after


def test_a_loop_that_is_left_at_its_beginning_tests_once_more_than_it_turns() -> None:
    """Instruction 1 is the test, from line 7 of a.c: it goes on to 2 or leaves the loop after ten turns."""
    graph = {0: [1], 1: [2, 3], 2: [1], 3: []}
    bounds = {"a.c:7": Bound(turns=10, in_all=None)}

    count = count_longest_path(graph, source_lines={1: "a.c:7"}, bounds=bounds)

    before, last_test, after = 1, 1, 1
    assert count == before + 10 * 2 + last_test + after


def test_a_loop_with_instructions_of_another_may_turn_as_often_as_the_one_that_turns_more_often() -> None:
    """A compiler has moved instruction 1, of the loop in line 8, into the loop of line 7."""
    graph = {0: [1], 1: [2], 2: [1, 3], 3: []}
    source_lines = {1: "a.c:8", 2: "a.c:7"}
    bounds = {"a.c:8": Bound(turns=5, in_all=None), "a.c:7": Bound(turns=10, in_all=None)}

    count = count_longest_path(graph, source_lines, bounds)

    before, after = 1, 1
    assert count == before + 10 * 2 + after


def test_an_inner_loop_turns_in_every_turn_of_the_outer_one() -> None:
    """Instruction 2, of line 8, repeats itself within the loop of instructions 1 to 3, of line 7."""
    graph = {0: [1], 1: [2], 2: [2, 3], 3: [1, 4], 4: []}
    source_lines = {2: "a.c:8", 3: "a.c:7"}
    bounds = {"a.c:8": Bound(turns=50, in_all=None), "a.c:7": Bound(turns=10, in_all=None)}

    count = count_longest_path(graph, source_lines, bounds)

    turn_of_outer_loop = 1 + 50 + 1
    before, after = 1, 1
    assert count == before + 10 * turn_of_outer_loop + after


def test_an_inner_loop_with_a_bound_on_all_its_turns_adds_these_once() -> None:
    """They are 20, beside one instruction of the inner loop in each of the 10 turns of the outer one.

    Instruction 2, of line 8, repeats itself within the loop of instructions 1 to 3, of line 7.
    """
    graph = {0: [1], 1: [2], 2: [2, 3], 3: [1, 4], 4: []}
    source_lines = {2: "a.c:8", 3: "a.c:7"}
    bounds = {"a.c:8": Bound(turns=5, in_all=20), "a.c:7": Bound(turns=10, in_all=None)}

    count = count_longest_path(graph, source_lines, bounds)

    turn_of_outer_loop = 1 + 1 + 1
    before, after = 1, 1
    assert count == before + 10 * turn_of_outer_loop + 20 + after


def test_the_cost_of_a_loop_with_two_entries_is_at_most_twice_that_of_its_longest_walk() -> None:
    """The bound is less tight there. Instruction 0 jumps to either of the loop's instructions 1 and 2."""
    graph = {0: [1, 2], 1: [2, 3], 2: [1], 3: []}
    bounds = {"a.c:7": Bound(turns=10, in_all=None)}

    count = count_longest_path(graph, source_lines={1: "a.c:7", 2: "a.c:7"}, bounds=bounds)

    before, last_test, after = 1, 1, 1
    longest_walk = before + 10 * 2 + last_test + after
    assert longest_walk <= count <= 2 * longest_walk


def test_a_loop_without_a_bound_in_the_source_is_refused() -> None:
    """Instruction 1 may be repeated for ever, so there is no longest path."""
    graph = {0: [1], 1: [1, 2], 2: []}
    with pytest.raises(ValueError, match=r"without a bound in the source: \['a.c:7'\]"):
        count_longest_path(graph, source_lines={1: "a.c:7"}, bounds={})
