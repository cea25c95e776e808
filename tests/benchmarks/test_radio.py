"""The benchmark of the radio measures what it says."""

from __future__ import annotations

import json

import pytest

from benchmarks.radio import COLUMNS, main
from multicast import multicast


def test_it_measures_every_interface(capsys: pytest.CaptureFixture[str]) -> None:
    """The figures of a run that is far too short for them to be right fit together all the same."""
    multicast(252)
    assert main(["--robots", "3", "--seconds", "0.01", "--json"]) == 0
    report = json.loads(capsys.readouterr().out)
    alone = {f"udp_multicast, {who} alone" for who in ("python-can", "sockets")}
    assert len(report["interfaces"]) == 7
    assert alone < report["interfaces"].keys()
    virtual = report["interfaces"]["virtual"]
    for name, row in report["interfaces"].items():
        assert row["x virtual"] == pytest.approx(row["ticks/s"] / virtual["ticks/s"])
        assert row["robot-ticks/s"] == pytest.approx(3 * row["ticks/s"])
        if name in alone:
            assert set(row) == {"ticks/s", "x virtual", "robot-ticks/s"}
            continue
        assert set(row) == set(COLUMNS)
        assert row["delivered/s"] == pytest.approx(6 * row["ticks/s"])
        assert row["us a delivery"] == pytest.approx(1e6 / row["delivered/s"])
        shares = {name: row[name] for name in ("send", "receive", "rest")}
        assert sum(shares.values()) == pytest.approx(1)
        assert shares[row["limited by"]] == max(shares.values())


def test_people_get_a_table(capsys: pytest.CaptureFixture[str]) -> None:
    multicast(253)
    assert main(["--robots", "2", "--seconds", "0.01"]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert len(lines) == 8
    assert all(column in lines[0] for column in COLUMNS)
