"""The committed golden vectors are what the mirror gives, and they meet what they are for."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import replace
from fractions import Fraction
from pathlib import Path
from typing import Any

import pytest

from firmware_py import mirror
from firmware_py.fixed_point import ALPHA_MAX, B_HAT_MAX, B_HAT_MIN, HALF, ONE
from firmware_py.robot import DEFAULT_MEMORY, Status
from host_tools import golden_vectors
from host_tools.errors import UsageError
from host_tools.golden_runs import GoldenScenario, Run, Xorshift
from host_tools.golden_scenarios import edge_scenarios, run_scenarios
from host_tools.golden_vectors import Player, digest, explain, main, outcomes
from host_tools.scenarios import Call

HERE = Path(__file__).parent
SCENARIOS = edge_scenarios() + run_scenarios()


def test_the_committed_files_are_what_the_mirror_gives() -> None:
    for name, data in golden_vectors.golden_vectors().items():
        assert (HERE / name).read_bytes() == data, f"{name}: python -m host_tools.golden_vectors tells more"


def test_fast_targets_play_100_000_ticks() -> None:
    calls = (call for scenario in SCENARIOS for call in scenario.calls())
    assert sum(call.name in ("observe", "step") for call in calls) >= 100_000


def test_names_tell_scenarios_apart() -> None:
    assert len({scenario.name for scenario in SCENARIOS}) == len(SCENARIOS)


# ---- What the edges meet ----


def facts_of(scenario: GoldenScenario) -> Iterator[str]:
    """What is met on the way, in words."""
    player = Player(scenario.setup)
    yield player.made.name
    for call in scenario.calls():
        robot = player.robot
        assert robot is not None
        before, round_before = robot.state(), robot.s.open
        status = player.apply(call)
        yield status.name
        assert player.robot is not None
        state = player.robot.state()
        if call.name == "settle" and state["tests"] > before["tests"]:
            yield f"test of {round_before.count}: {'update' if status == Status.UPDATED else 'no update'}"
        if state["t"] < before["t"] and call.name in ("step", "observe"):
            yield "halved a tie" if before["n"] + call.numbers[0] & 1 else "halved evenly"
        yield from facts_about(state, player.robot.x_bar_raw)


def facts_about(state: dict[str, int], x_bar: int) -> Iterator[str]:
    where = "inside" if 0 < state["x_hat"] < ONE else state["x_hat"]
    yield f"{'no' if state['t'] == 0 else 'some'} observations"
    yield f"x_hat {where}, {'inverted' if state['accuracy_inverted'] else 'upright'}"
    yield f"b_hat {({B_HAT_MIN: 'least', B_HAT_MAX: 'most', 1 << 31: 'half'}).get(state['b_hat'], 'other')}"
    yield f"alpha {({0: 'zero', ALPHA_MAX: 'most'}).get(state['alpha'], 'other')}"
    yield f"x_bar {({0: 'zero', HALF: 'half', ONE: 'one'}).get(x_bar, 'other')}"
    yield f"t of {state['t'].bit_length()} bits"
    yield f"round of {state['open_count']} and {min(state['silent'], 1)}"
    for name in ("accepted", "repeated", "rejected", "tests", "updates"):
        yield f"{name} {'full' if state[name] == 0xFFFF else 'not full'}"
    if state["t"] == DEFAULT_MEMORY // 2 + 1:
        yield "after the longest memory"


def test_the_edges_are_met() -> None:
    facts = {fact for scenario in edge_scenarios() for fact in facts_of(scenario)}
    wanted = {status.name for status in Status}
    wanted |= {
        "halved a tie",
        "halved evenly",
        "after the longest memory",
        "no observations",
        "some observations",
    }
    wanted |= {f"{name} full" for name in ("accepted", "repeated", "rejected", "tests", "updates")}
    wanted |= {f"x_hat {x}, {way}" for x in (0, "inside", ONE) for way in ("inverted", "upright")}
    wanted |= {f"x_bar {x_bar}" for x_bar in ("zero", "half", "one", "other")}
    wanted |= {"alpha zero", "alpha most", "b_hat least", "b_hat half", "b_hat most"}
    wanted |= {"round of 127 and 0", "round of 0 and 1"}
    wanted |= {f"test of {m}: {way}" for m in (2, 3, 30, 31, 127) for way in ("update", "no update")}
    wanted |= {f"t of {bits} bits" for bits in (1, 8, 9, 17, 24, 25, 31, 32)}
    assert wanted <= facts, sorted(wanted - facts)


def test_rounds_at_the_threshold_are_decided_by_less_than_a_bit() -> None:
    margins = []
    scenarios = [scenario for scenario in edge_scenarios() if scenario.name.startswith("the threshold")]
    for scenario in scenarios:
        player = Player(scenario.setup)
        for call in scenario.calls():
            assert player.robot is not None
            margin = margin_of(player.robot)
            if player.apply(call) == Status.UPDATED or call.name == "settle":
                margins.append(margin)
    kept, rejected = margins[::2], margins[1::2]
    assert len(kept) == len(rejected) == 6
    assert all(-17 < margin <= 0 for margin in kept)
    assert all(0 < margin <= 13 for margin in rejected)
    assert max(kept) > -1  # >= instead of > on the rounded right side would reject it
    assert min(rejected) <= 1  # a right side one unit larger would keep it


def margin_of(robot: mirror.MirrorRobot) -> Fraction:
    """The left side of eq. 12 minus the right one, multiplied as docs/design.md says, but exact."""
    sums, table = robot.s.open, robot.config.table
    if sums.count < 2 or table is None:
        return Fraction(0)
    k = Fraction(table.entry(sums.count), 1 << table.fraction_bits)
    return (sums.x - sums.count * robot.s.x_hat) ** 2 - k * (sums.count * sums.x_squared - sums.x**2)


@pytest.mark.parametrize(
    ("name", "fault"),
    [
        ("alpha_bits", lambda f: lambda mantissa, exponent: f(mantissa | 1, exponent)),
        ("alpha_units", lambda f: lambda alpha: f(alpha) & ~1 if alpha < 0x34000000 else f(alpha)),
        ("mean", lambda f: lambda alpha, low, high: f(alpha, low + alpha // 100, high)),
        ("confidence_inside", lambda f: lambda accuracy, nu, total: f(accuracy, nu + 1, total)),
        ("confidence_at_end", lambda f: lambda accuracy, part, rest: f(accuracy, part - part // 99, rest)),
        ("upper_quotient", lambda f: lambda a, d: f(a, d) + (a.bit_length() > 54)),
        ("rejects", lambda f: lambda table, s, x: f(table, s, x + (s.count == 127))),
        ("rejects", lambda f: lambda table, s, x: f(table, s, x) or s.count * x == s.x),
        ("estimate", lambda f: lambda t, n, a: (f(t, n, a)[0] ^ (t > 0xFFFFFF00), f(t, n, a)[1])),
        ("rejects", lambda f: lambda table, s, x: f(replace(table, fraction_bits=31), s, x)),
        ("sums_possible", lambda f: lambda s: f(s) or s.x_squared == s.x * ONE + 1),
        ("estimate_possible", lambda f: lambda x, alpha: f(x, alpha) or alpha == ALPHA_MAX + 1),
    ],
)
def test_small_faults_change_a_digest(
    name: str, fault: Callable[[Any], Any], monkeypatch: pytest.MonkeyPatch
) -> None:
    expected = list(map(digest, edge_scenarios()))
    monkeypatch.setattr(mirror, name, fault(getattr(mirror, name)))
    assert list(map(digest, edge_scenarios())) != expected


# ---- Runs ----


def test_xorshift_is_marsaglia_s() -> None:
    """The first numbers from the seed of his paper, "Xorshift RNGs" (2003), triple 13, 17, 5."""
    source = Xorshift(2463534242)
    assert [source.draw() for _ in range(3)] == [723471715, 2497366906, 2064144800]


def test_a_run_has_its_ticks_and_all_kinds_of_messages() -> None:
    run = Run(seed=7, ticks=5000, black=64, messages=4, spread=9, centre=HALF)
    calls = list(run.calls())
    ticks = [call.numbers[0] for call in calls if call.name in ("observe", "step")]
    messages = [call.numbers for call in calls if call.name == "receive"]
    assert len(ticks) == 5000
    assert {ticks.count(z) > 40 for z in range(4)} == {True}
    assert 0.2 < ticks.count(1) / ticks.count(0) < 0.45  # 64/192
    assert 9000 < len(messages) < 11000
    senders = {sender for sender, _, _ in messages}
    assert senders >= set(range(128))
    assert 50 < len(senders) - 128 <= 128
    assert all(0 <= x_hat < ONE for _, x_hat, _ in messages)
    assert any(alpha > ALPHA_MAX for _, _, alpha in messages)
    assert any(alpha < 0x33800000 for _, _, alpha in messages)


# ---- Telling what differed ----


def printed(number: int, change: int | None, field: str = "state") -> str:
    """What a target would print that gets the call ``change`` of a scenario wrong, and all that follow."""
    lines = [f"scenario {number} expected 1 found 2"]
    for index, (_, outcome) in enumerate(outcomes(SCENARIOS[number])):
        values = {"status": outcome.status, "x": outcome.x, "x_bar": outcome.x_bar, "state": outcome.state}
        if change is not None and index >= change:
            values[field] ^= 1
        lines.append(f"call {index} " + " ".join(f"{name} {value}" for name, value in values.items()))
    return "\n".join([*lines, "FAIL"])


@pytest.mark.parametrize("field", ["status", "x", "x_bar", "state"])
@pytest.mark.parametrize(("number", "change"), [(0, 0), (0, 3), (39, 5), (97, 30)])
def test_the_first_difference_is_named(number: int, change: int, field: str) -> None:
    told = explain(printed(number, change, field), SCENARIOS)
    what, _ = list(outcomes(SCENARIOS[number]))[change]
    assert told.startswith(f"scenario {number} ({SCENARIOS[number].name}), call {change}, {what}:")


def test_output_that_breaks_off_is_told() -> None:
    whole = printed(0, None)
    assert "every call agrees" in explain(whole, SCENARIOS)
    cut = "\n".join(whole.splitlines()[:4])
    assert "call 3" in explain(cut, SCENARIOS)
    assert "found    nothing" in explain(cut, SCENARIOS)


@pytest.mark.parametrize("text", ["PASS scenarios 1", "", "scenario 9999 expected 1 found 2"])
def test_output_without_a_difference_is_refused(text: str) -> None:
    with pytest.raises(UsageError):
        explain(text, SCENARIOS)


# ---- The command ----


@pytest.fixture
def fewer_vectors(monkeypatch: pytest.MonkeyPatch) -> None:
    """Let the command make small files, for time's sake."""
    monkeypatch.setattr(golden_vectors, "edge_scenarios", lambda: edge_scenarios()[:9])
    monkeypatch.setattr(golden_vectors, "run_scenarios", lambda: edge_scenarios()[9:12])


@pytest.mark.usefixtures("fewer_vectors")
def test_check_finds_a_changed_byte(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["--output", str(tmp_path)]) == 0
    assert main(["--check", str(tmp_path)]) == 0
    path = tmp_path / "golden_runs.bin"
    path.write_bytes(path.read_bytes()[:-1] + b"\1")
    assert main(["--check", str(tmp_path)]) == 1
    assert "golden_runs.bin is not what the mirror gives" in capsys.readouterr().out


@pytest.mark.usefixtures("fewer_vectors")
def test_bad_usage_ends_with_2(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["--check", str(tmp_path / "none")]) == 2
    assert main(["--output", str(tmp_path / "none" / "deeper")]) == 2
    assert main(["--explain", str(tmp_path)]) == 2
    assert "error: cannot read" in capsys.readouterr().err


def test_explain_reads_a_log(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    log = tmp_path / "log"
    log.write_bytes(b"\xff\x1b[32m" + printed(0, 2).encode())
    assert main(["--explain", str(log)]) == 0
    assert "scenario 0 (nothing observed), call 2, step:2" in capsys.readouterr().out


def test_calls_are_written_as_the_cross_check_s() -> None:
    assert str(Call("receive", (1, 2, 3))) == "receive:1:2:3"
