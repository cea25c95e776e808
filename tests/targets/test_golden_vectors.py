"""The committed golden vectors are what the mirror gives."""

from __future__ import annotations

from pathlib import Path

import pytest

from targets.golden_scenarios import edge_scenarios, run_scenarios
from targets.golden_vectors import golden_vectors, main, outcomes

HERE = Path(__file__).parent


@pytest.mark.slow
def test_the_committed_files_are_what_the_mirror_gives() -> None:
    for name, data in golden_vectors().items():
        assert (HERE / name).read_bytes() == data, "make it again with --output and say why in the changelog"


@pytest.mark.parametrize("field", [0, 1])
@pytest.mark.parametrize(("number", "change"), [(0, 0), (42, 5), (108, 30)])
def test_the_first_difference_is_named(
    number: int, change: int, field: int, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Of a target that gets a call's status or state wrong, and all that follow."""
    played = edge_scenarios() + run_scenarios()
    expected = list(outcomes(played[number]))
    lines = [f"scenario {number} expected 1 found 2"]
    for index, (_, outcome) in enumerate(expected):
        found = list(outcome)
        found[field] ^= index >= change
        lines.append(f"call {index} status {found[0]} state {found[1]}")
    (tmp_path / "log").write_text("\n".join([*lines, "FAIL"]), encoding="utf-8")
    assert main(["--explain", str(tmp_path / "log")]) == 0
    title = f"scenario {number} ({played[number].name}), call {change}, {expected[change][0]}:"
    assert capsys.readouterr().out.startswith(title)
