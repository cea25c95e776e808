"""The committed golden vectors are what the mirror gives, and they meet what they are for."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from fractions import Fraction
from functools import cache
from pathlib import Path
from typing import Any

import pytest

from mcp_asdf import mirror
from mcp_asdf.fixed_point import ALPHA_MAX, B_HAT_MAX, B_HAT_MIN, HALF, ONE, alpha_units, alpha_word
from mcp_asdf.robot import DEFAULT_MEMORY, MAX_FILTER_PERIOD, Status
from mcp_asdf.table import FRACTION_BITS
from mcp_asdf_tools.common.errors import UsageError
from mcp_asdf_tools.crosscheck.scenario import Call, TableChoice, build_table
from targets import golden_vectors
from targets.golden_runs import Crowd, GoldenScenario, Run, Xorshift
from targets.golden_scenarios import edge_scenarios, run_scenarios
from targets.golden_vectors import Player, digest, explain, main, outcomes

HERE = Path(__file__).parent
SCENARIOS = edge_scenarios() + run_scenarios()


@pytest.mark.slow
def test_the_committed_files_are_what_the_mirror_gives() -> None:
    for name, data in golden_vectors.golden_vectors().items():
        assert (HERE / name).read_bytes() == data, f"{name}: see tests/targets/golden_vectors.py"


def test_fast_targets_play_100_000_ticks() -> None:
    calls = (call for scenario in SCENARIOS for call in scenario.calls())
    assert sum(call.name in ("observe", "step") for call in calls) >= 100_000


def test_names_tell_scenarios_apart() -> None:
    assert len({scenario.name for scenario in SCENARIOS}) == len(SCENARIOS)


LONGER = build_table(TableChoice("0.05", 31))
"""A table with an entry of its own for 31 messages."""


# ---- What the edges meet ----

COUNTERS = ("accepted", "repeated", "rejected", "tests", "updates")
BAND = 1 << 19
"""How far from 1/2, in units of 2**-32, a probability begins to say something."""


def facts_of(scenario: GoldenScenario) -> Iterator[str]:
    """Situations that a scenario passes through, in words."""
    player = Player(scenario.setup)
    yield player.made.name
    if player.robot is not None:
        yield f"filter period {scenario.setup.filter_period}"
    for call in scenario.calls():
        robot = player.robot
        assert robot is not None
        before, round_before = robot.state(), vars(robot.s.open).copy()
        status = player.apply(call)
        yield status.name
        assert player.robot is not None
        after = player.robot.state()
        yield from facts_about_call(call, status, before, after)
        if after["tests"] != before["tests"] and call.name == "settle":
            yield f"test of {round_before['count']}: {'update' if status == Status.UPDATED else 'no update'}"
        if call.name == "settle":
            yield from facts_about_band(player.robot.s.closed, status)
        yield from facts_about(after, player.robot.x_bar_raw)


def facts_about_call(
    call: Call, status: Status, before: dict[str, int], after: dict[str, int]
) -> Iterator[str]:
    if call.name in ("step", "observe") and after["t"] < before["t"]:
        yield f"memory {before['t'] + 1} halved a {'tie' if before['n'] + call.numbers[0] & 1 else 'whole'}"
    if call.name == "restore":
        kind = "another" if call.numbers else "the same"
        yield f"restored {kind}, updated {before['updated']}: {status.name}"
    else:
        yield from (f"{name} wrapped" for name in COUNTERS if after[name] < before[name])
    if call.name == "receive":
        yield from facts_about_word(call.numbers[2])


def facts_about_word(alpha: int) -> Iterator[str]:
    """How a confidence is written."""
    yield f"alpha {'with' if alpha >> 5 & 7 else 'without'} junk"
    units, canonical = alpha_units(alpha), alpha_word(alpha_units(alpha))
    yield f"alpha of 2**{units.bit_length()}{'' if alpha & ~0xE0 == canonical else ', not canonical'}"


def facts_about_band(closed: mirror.Closed, status: Status) -> Iterator[str]:
    """How far x_bar is from where it begins to say something, if that is close."""
    if closed.alpha:
        apart = Fraction(closed.alpha_x(), closed.alpha << 23) * 2**32 - 2**31
        if abs(abs(apart) - BAND) <= 8:
            yield f"x_bar {'above' if apart > 0 else 'below'} 1/2, at the band's edge: {status.name}"


def facts_about(state: dict[str, int], x_bar: int) -> Iterator[str]:
    b_hat, t = state["accuracy_b_hat"], state["t"]
    where = "inside" if 0 < state["x_hat"] < ONE else state["x_hat"]
    yield f"{'no' if t == 0 else 'some'} observations"
    yield f"x_hat {where}, {'inverted' if b_hat < 1 << 31 else 'upright'}"
    yield f"b_hat {({B_HAT_MIN: 'least', B_HAT_MAX: 'most', 1 << 31: 'half'}).get(b_hat, 'other')}"
    yield f"b_hat at {b_hat - (1 << 31)} from 1/2, alpha {'0' if state['alpha'] == 0 else 'above 0'}"
    yield f"alpha {({0: 'zero', ALPHA_MAX: 'most'}).get(state['alpha'], 'other')}"
    yield f"x_bar {({0: 'zero', HALF: 'half', ONE: 'one'}).get(x_bar, 'other')}"
    yield f"t of {t.bit_length()} bits"
    if 2 * state["n"] == t and not state["updated"]:
        yield f"half of {t} black: x_hat {'1/2' if state['x_hat'] == HALF else 'other'}"
    heard = sum(state[f"heard_{i}"].bit_count() for i in range(4))
    yield f"round of {state['open_count']} and {min(heard - state['open_count'], 1)}"
    if t == DEFAULT_MEMORY // 2 + 1:
        yield "after the longest memory"


def test_the_edges_are_met() -> None:
    facts = {fact for scenario in edge_scenarios() for fact in facts_of(scenario)}
    wanted = {status.name for status in Status}
    wanted |= {f"memory {m} halved a {n}" for m in (64, 2**31 - 4, 2**31) for n in ("tie", "whole")}
    wanted |= {"after the longest memory", "no observations", "some observations"}
    wanted |= {f"{name} wrapped" for name in COUNTERS}
    wanted |= {f"x_hat {x}, {way}" for x in (0, "inside", ONE) for way in ("inverted", "upright")}
    wanted |= {f"x_bar {x_bar}" for x_bar in ("zero", "half", "one", "other")}
    wanted |= {"alpha zero", "alpha most", "b_hat least", "b_hat half", "b_hat most"}
    wanted |= {f"b_hat at {side * b} from 1/2, alpha 0" for side in (1, -1) for b in (1, BAND - 1)}
    wanted |= {f"b_hat at {side * b} from 1/2, alpha above 0" for side in (1, -1) for b in (BAND, BAND + 1)}
    wanted |= {f"half of {t} black: x_hat 1/2" for t in (2, 64, 2**24, 2**31 - 2)}
    wanted |= {"alpha with junk", "alpha of 2**0, not canonical", "alpha of 2**32, not canonical"}
    wanted |= {f"alpha of 2**{bits}" for bits in (0, 1, 25, 32, 33, 55)}
    wanted |= {f"filter period {period}" for period in (1, 3, MAX_FILTER_PERIOD)}
    wanted |= {"round of 127 and 0", "round of 0 and 1"}
    wanted |= {f"test of {m}: {way}" for m in (2, 3, 29, 30, 31, 127) for way in ("update", "no update")}
    wanted |= {
        f"x_bar {side} 1/2, at the band's edge: {status}"
        for side in ("above", "below")
        for status in ("OK", "UPDATED")
    }
    wanted |= {"restored the same, updated 0: OK", "restored the same, updated 1: OK"}
    wanted |= {
        f"restored another, updated {flag}: {status}" for flag in (0, 1) for status in ("OK", "ERR_IMAGE")
    }
    wanted |= {f"t of {bits} bits" for bits in (1, 8, 9, 17, 24, 25, 31)}
    assert wanted <= facts, sorted(wanted - facts)
    assert not any(fact.endswith("black: x_hat other") for fact in facts)


def verdicts_on_images(name: str) -> list[str]:
    """The outcome of each restore of a scenario, and where rounds end."""
    (scenario,) = (each for each in edge_scenarios() if each.name == name)
    player, said = Player(scenario.setup), []
    for call in scenario.calls():
        status = player.apply(call)
        if call.name in ("restore", "settle"):
            said.append("settle" if call.name == "settle" else status.name)
    return said


def test_words_that_do_not_fit_are_refused_each_by_itself() -> None:
    """Until the round has ended: some of them fit an empty one."""
    said = verdicts_on_images("images that do not fit")
    assert set(said[: said.index("settle")]) == {"ERR_IMAGE"}
    assert {"OK", "ERR_IMAGE"} == set(said[said.index("settle") + 1 :])


def test_sums_are_restored_up_to_their_limits() -> None:
    """Images that are one unit beyond a limit, and those at it."""
    pair = ["ERR_IMAGE", "OK"]
    said = verdicts_on_images("sums of a round")
    assert said == ["ERR_IMAGE", *pair, "OK", *4 * pair, "settle", *4 * pair]


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
    assert len(kept) == len(rejected) == 7
    assert all(-11 < margin <= 0 for margin in kept)
    assert all(0 < margin < 17 for margin in rejected)
    assert max(kept) > -1  # >= instead of > on the rounded right side would reject it
    assert min(rejected) <= 1  # a right side one unit larger would keep it


def margin_of(robot: mirror.MirrorRobot) -> Fraction:
    """The left side of eq. 12 minus the right one, multiplied as docs/design.md says, but exact."""
    sums, table = robot.s.open, robot.config.table
    if sums.count < 2 or table is None:
        return Fraction(0)
    k = Fraction(table.entry(sums.count), 1 << FRACTION_BITS)
    return (sums.x - sums.count * robot.s.x_hat) ** 2 - k * (sums.count * sums.x_squared - sums.x**2)


@cache
def digests_of_edges() -> list[int]:
    """Those of the right mirror, as the tests that change it begin with it."""
    return [digest(scenario) for scenario in edge_scenarios()]


@pytest.mark.parametrize(
    ("name", "fault"),
    [
        ("alpha_word", lambda f: lambda mantissa, exponent: f(mantissa | 1, exponent)),
        ("sums_add", lambda f: lambda s, x, word: f(s, x, word + 0x100 if word & 0xE0 else word)),
        ("sums_add", lambda f: lambda s, x, word: f(s, x, word if word >> 8 else 0x100 | word)),
        ("sums_add", lambda f: lambda s, x, word: f(s, x, word ^ 1 if word >> 8 == 3 else word)),
        ("informed_estimate", lambda f: lambda s, x, own: f(s, x, own) - (s.alpha + own >= 1 << 61)),
        ("confidence_inside", lambda f: lambda a, t, r, scale, s: f(a, t, r, scale - 512, s)),
        ("confidence_at_end", lambda f: lambda a, t, part: f(a, t, part - part // 99)),
        ("square_of_ratio", lambda f: lambda g, p: f(g, p) + (p == 1 << 31)),
        ("upper_quotient", lambda f: lambda a, d: f(a, d) + (a.bit_length() > 54)),
        ("reestimate", lambda f: lambda t, n, s: f(t, n, s) or 1 << 31),
        ("rejects", lambda f: lambda table, s, x: f(table, s, x + (s.count == 127))),
        ("rejects", lambda f: lambda table, s, x: f(table, s, x) or s.count * x == s.x),
        ("rejects", lambda f: lambda table, s, x: f(LONGER if s.count == 31 else table, s, x)),
        ("estimate", lambda f: lambda t, n, a: (f(t, n, a)[0] ^ (t > 0x7FFFFF00), f(t, n, a)[1])),
        ("sums_possible", lambda f: lambda s: f(s) or s.x_squared == s.x * ONE + 1),
        ("sums_possible", lambda f: lambda s: f(s) and s.count * s.x_squared != s.x * s.x),
        ("estimate_possible", lambda f: lambda s: f(s) or s.updated == 2),
        ("estimate_possible", lambda f: lambda s: f(s) and not s.updated),
    ],
)
def test_small_faults_change_a_digest(
    name: str, fault: Callable[[Any], Any], monkeypatch: pytest.MonkeyPatch
) -> None:
    expected = digests_of_edges()
    monkeypatch.setattr(mirror, name, fault(getattr(mirror, name)))
    assert any(digest(each) != right for each, right in zip(edge_scenarios(), expected, strict=True))


# ---- Runs ----


def test_xorshift_is_marsaglia_s() -> None:
    """The first numbers from the seed of his paper, "Xorshift RNGs" (2003), triple 13, 17, 5."""
    source = Xorshift(2463534242)
    assert [source.draw() for _ in range(3)] == [723471715, 2497366906, 2064144800]


def test_a_run_has_its_ticks_and_all_kinds_of_messages() -> None:
    run = Run(seed=7, ticks=5000, black=64, settled=192, messages=4, spread=9, centre=HALF)
    calls = list(run.calls())
    ticks = [call.numbers[0] for call in calls if call.name in ("observe", "step")]
    messages = [call.numbers for call in calls if call.name == "receive"]
    assert 40 < 5000 - len(ticks) < 120  # without an observation
    assert {ticks.count(z) > 40 for z in range(3)} == {True}
    assert 0.2 < ticks.count(1) / ticks.count(0) < 0.45  # 64/192
    names = [call.name for call in calls]
    assert 3600 < names.count("settle") + names.count("step") < 3900  # 192/256
    assert 1600 < names.count("step") < 2000
    assert 9000 < len(messages) < 11000
    senders = {sender for sender, _, _ in messages}
    assert senders >= set(range(128))
    assert 50 < len(senders) - 128 <= 128
    assert all(0 <= x_hat < ONE for _, x_hat, _ in messages)
    canonical = [alpha for *_, alpha in messages if alpha_word(alpha_units(alpha)) == alpha]
    assert 0.6 < len(canonical) / len(messages) < 0.85
    assert {alpha & 31 for alpha in canonical} == set(range(32))
    assert {alpha >> 5 & 7 for *_, alpha in messages} == set(range(8))
    assert sum(alpha >> 8 == 0 for *_, alpha in messages) > 100


def test_a_crowd_goes_around_at_the_end_of_ids_and_numbers() -> None:
    calls = [call.numbers for call in Crowd(sender=254, count=4, x_hat=3, step=2**32 - 2, alpha=9).calls()]
    assert calls == [(254, 3, 9), (255, 1, 9), (0, 2**32 - 1, 9), (1, 2**32 - 3, 9)]


# ---- Telling what differed ----


def printed(number: int, change: int | None, field: str = "state") -> str:
    """Output of a target that gets the call ``change`` of a scenario wrong, and all that follow."""
    lines = [f"scenario {number} expected 1 found 2"]
    for index, (_, outcome) in enumerate(outcomes(SCENARIOS[number])):
        values = {"status": outcome.status, "x": outcome.x, "x_bar": outcome.x_bar, "state": outcome.state}
        if change is not None and index >= change:
            values[field] ^= 1
        lines.append(f"call {index} " + " ".join(f"{name} {value}" for name, value in values.items()))
    return "\n".join([*lines, "FAIL"])


@pytest.mark.parametrize("field", ["status", "x", "x_bar", "state"])
@pytest.mark.parametrize(("number", "change"), [(0, 0), (0, 3), (42, 5), (108, 30)])
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
