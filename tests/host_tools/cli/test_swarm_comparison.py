"""``mcp-asdf swarm --compare``: the difference that the filter makes, on the same seed."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from mcp_asdf_tools.cli.main import main

SMALL = ["swarm", "--robots", "8", "--steps", "600", "--filter-period", "100", "--flawed", "50%"]


def test_the_other_run_is_the_same_swarm_without_a_filter(capsys: pytest.CaptureFixture[str]) -> None:
    reports = []
    for options in (["--compare"], ["--filter", "none"]):
        assert main([*SMALL, *options, "--json"]) == 0
        reports.append(json.loads(capsys.readouterr().out))
    assert reports[0]["without_filter"] == reports[1]["results"]
    assert reports[0]["results"]["updates"] > 0


def test_a_sentence_says_what_it_is_good_for(capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    log = tmp_path / "run.log"
    assert main([*SMALL, "--omega", "0.1", "--compare", "--quiet", "--log", str(log)]) == 0
    results = json.loads(Path(f"{log}.json").read_text())
    with_it, without = (results[name]["mean_error"] for name in ("results", "without_filter"))
    said = capsys.readouterr().out.splitlines()[-1]
    assert (
        f"With the filter the mean error is {with_it:.3f}; without it, on the same seed, {without:.3f}."
        in said
    )
    assert main(["replay", str(log)]) == 0


@pytest.mark.parametrize(
    ("options", "reason"),
    [
        (["--filter", "none"], "but filter is none; leave it out"),
        (["--processes", "--interface", "udp_multicast"], "but robots elsewhere run once; leave it out"),
    ],
)
def test_what_cannot_be_compared_is_refused(
    options: list[str], reason: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main([*SMALL, *options, "--compare"]) == 2
    assert reason in capsys.readouterr().err
