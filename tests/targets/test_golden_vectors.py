"""The committed golden vectors are what the mirror gives."""

from __future__ import annotations

from pathlib import Path

import pytest

from targets.golden_vectors import FILES, HERE, Player, digest_of, load, main, make


def test_the_committed_digests_are_the_mirror_s() -> None:
    for golden in load():
        assert golden.digest == digest_of(golden.scenario), golden.scenario


@pytest.mark.slow
@pytest.mark.parametrize("name", FILES)
def test_a_file_is_written_again_as_it_is(name: str) -> None:
    assert make(*FILES[name]) == (HERE / name).read_bytes(), "write it again and say why in the changelog"


@pytest.mark.parametrize("field", [0, 1])
@pytest.mark.parametrize("change", [0, 5])
def test_the_first_difference_is_named(
    change: int, field: int, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Of a target that gets a call's status or state wrong, and all that follow."""
    played = load()
    number = max(range(100), key=lambda each: len(played[each].scenario.calls))
    expected = list(Player().play(played[number].scenario))
    lines = [f"scenario {number} expected 1 found 2"]
    for index, (_, outcome) in enumerate(expected):
        found = list(outcome)
        found[field] ^= index >= change
        lines.append(f"call {index} status {found[0]} state {found[1]}")
    (tmp_path / "log").write_text("\n".join([*lines, "FAIL"]), encoding="utf-8")
    assert main(["--explain", str(tmp_path / "log")]) == 0
    told = capsys.readouterr().out.splitlines()
    assert told[0] == f"scenario {number}, call {change}, {expected[change][0]}:"
    assert told[-1] == f"mcp-asdf crosscheck --replay {played[number].scenario}"
