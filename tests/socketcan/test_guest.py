"""Reports of the guest's tests arrive, and missing ones show. Needs no guest."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Literal

import pytest

from socketcan import guest, relay
from socketcan.guest import NoGuestError

Outcome = Literal["passed", "failed", "skipped"]


def report(item: pytest.Item, outcome: Outcome, longrepr: object) -> pytest.TestReport:
    return pytest.TestReport(item.nodeid, item.location, {}, outcome, longrepr, "call")  # type: ignore[arg-type]


def test_reports_arrive_as_they_were_made(request: pytest.FixtureRequest, tmp_path: Path) -> None:
    item = request.node
    made = [
        report(item, "passed", None),
        report(item, "failed", "assert 5 == 6"),
        report(item, "skipped", ("file.py", 3, "Skipped: no candump")),
    ]
    reporter = relay.Reporter(request.config, str(tmp_path / "reports"))
    for each in made:
        reporter.pytest_runtest_logreport(each)
    read = relay._read(request.config, tmp_path / "reports")[item.nodeid]
    assert [(each.outcome, each.longrepr) for each in read] == [(e.outcome, e.longrepr) for e in made]


def test_a_test_that_the_guest_did_not_finish_has_failed(
    request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch
) -> None:
    item = request.node
    begun = report(item, "passed", None)
    for reports in ({}, {item.nodeid: [begun]}):
        monkeypatch.setattr(relay, "_reports", lambda session, reports=reports: reports)
        assert relay.reports_of(item)[-1].outcome == "failed"
        assert "broke off" in str(relay.reports_of(item)[-1].longrepr)


def test_without_a_guest_a_test_is_skipped_and_says_why(
    request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch
) -> None:
    def none(session: pytest.Session) -> relay.Reports:
        raise NoGuestError("no busybox: apt-get install busybox-static")

    monkeypatch.setattr(relay, "_reports", none)
    (only,) = relay.reports_of(request.node)
    assert only.outcome == "skipped"
    assert "and no guest: no busybox: apt-get install busybox-static" in str(only.longrepr)


def test_what_a_guest_lacks_is_named(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    empty: Mapping[str, str] = {"PATH": str(tmp_path)}
    monkeypatch.setattr(guest, "_environment", lambda: empty)
    with pytest.raises(NoGuestError) as raised:
        guest.run_in_guest("", tmp_path, 1)
    packages = "qemu-system-x86 busybox-static kmod udev iproute2 apt dpkg"
    assert str(raised.value).endswith(f"apt-get install {packages}")


def test_a_cache_that_cannot_be_used_is_named(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    blocked = tmp_path / "file"
    blocked.touch()
    monkeypatch.setenv("MCP_ASDF_CACHE", str(blocked / "cache"))
    monkeypatch.setattr(guest, "TOOLS", {})
    monkeypatch.setattr("platform.machine", lambda: "x86_64")
    with pytest.raises(NoGuestError, match="set MCP_ASDF_CACHE to another folder"):
        guest.run_in_guest("", tmp_path, 1)
