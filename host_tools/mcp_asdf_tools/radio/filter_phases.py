"""Phases that put the filter to the test: its period, its thresholds, its re-estimates, and the memory."""

from __future__ import annotations

from collections.abc import Callable, Sequence

from mcp_asdf.fixed_point import HALF, ONE
from mcp_asdf.robot import Filter, Observation
from mcp_asdf_tools.radio.bench import BURST, Bench
from mcp_asdf_tools.radio.rounds import (
    CRAFTED_SIZES,
    SCALES,
    Content,
    Update,
    any_content,
    at_threshold,
    far_away,
    for_update,
    scaled_alphas,
    with_large_sums,
)
from mcp_asdf_tools.robots.robot_setup import RobotSetup

LONG_RUN = 20_000
"""Observations after which a controller must not have forgotten any, unless its memory is shorter: more than
2**14, so that narrower counts show."""
WHITE_TILES = 60
"""Tiles before the re-estimate without a black one, beside those of earlier phases."""
FEW_OBSERVATIONS = (250, 350, 480)
"""Observations after which b_hat is re-estimated early."""
FREQUENT_TESTS = 50
"""Rounds between tests with which there is time for 2**8 updates."""

_WANTED = (Update.ABOVE, Update.BELOW, Update.MAXIMUM, Update.MINIMUM, Update.ABOVE, Update.BELOW)
"""Updates of the rounds just outside their thresholds."""
_ATTEMPTS = 4
_MANY = "many observations in a row"


def no_information(bench: Bench) -> None:
    """A re-estimate that gives b_hat = 1/2, after which the robot knows nothing until the next."""
    s = bench.firmware.s
    for wanted in (Update.HALF, Update.FAINT):
        bench.activity = "many observations, half of them black"
        least = 0 if wanted is Update.HALF else s.t // 4096 + 1  # more black ones than white ones
        while 2 * s.n - s.t != least:
            bench.skip_ticks(max(abs(2 * s.n - s.t) // 2, 1), lambda: Observation(2 * s.n - s.t < least))  # noqa: B023
        if wanted is Update.HALF and s.t < 1 << 12:
            bench.skip_to_test_round()
            bench.activity = "a mean so close to 1/2 that the divisor of eq. 8 is below 1"
            _crafted(bench, [(HALF + (1 << 10) + each, 0x8000_0001) for each in range(1, 4)])
        _update(bench, wanted)
        bench.activity = "observations of a robot that knows hardly anything"
        for _ in range(3):
            bench.play_tick(bench.draw_observation())


def all_white(bench: Bench) -> None:
    """A re-estimate before the first black tile."""
    bench.activity = "white tiles, and then none until the test"
    # So few that t is still small in the next phases.
    bench.skip_ticks(WHITE_TILES, lambda: Observation.WHITE)
    bench.skip_to_test_round()
    bench.activity = "a re-estimate without a black tile"
    _crafted(bench, [(HALF // 2 + each, alpha) for each, alpha in enumerate(scaled_alphas(bench.draw, 5))])


def ends(bench: Bench) -> None:
    """Re-estimates whose x_bar is 0 or 1, after which one colour leaves the range that b_hat allows."""
    s = bench.firmware.s
    for end in (0, ONE) if s.x_hat > HALF else (ONE, 0):
        _to_test(bench)
        bench.activity = f"estimates of {end // ONE}"
        _crafted(bench, [(end, alpha) for alpha in scaled_alphas(bench.draw, 5)])
        bench.activity = f"tiles of one colour, then of the other, after estimates of {end // ONE}"
        for tick in range(12):
            bench.play_tick(Observation(tick // 3 % 2))


def large_sums(bench: Bench) -> None:
    """Rounds whose squares have most bits."""
    for name in with_large_sums(bench.situation, bench.draw):
        _to_test(bench)
        bench.activity = name
        _crafted(bench, with_large_sums(bench.situation, bench.draw)[name])


def thresholds(m: int, wanted: Update) -> Callable[[Bench], None]:
    """Rounds of ``m`` messages just inside and just outside k_m; the second one's update is ``wanted``."""

    def play(bench: Bench) -> None:
        for place, where in enumerate(("inside", "outside")):
            _to_test(bench)
            rounds = at_threshold(bench.situation, m, wanted, bench.draw)
            bench.activity = f"{m} messages just {where} the threshold"
            _crafted(bench, rounds[place])

    return play


THRESHOLDS = {m: thresholds(m, wanted) for m, wanted in zip(CRAFTED_SIZES, _WANTED, strict=True)}


def own_estimate(bench: Bench) -> None:
    """Messages that all equal the own estimate: the test must not reject at equality."""
    _to_test(bench)
    bench.activity = "messages equal to its own estimate"
    _crafted(bench, [(bench.situation.x_hat, alpha) for alpha in scaled_alphas(bench.draw, 5)])


def without_test(bench: Bench) -> None:
    """Play rounds from which only a robot without a test re-estimates: one message, and its own estimate."""
    _to_test(bench)
    bench.activity = "a re-estimate from a single message"
    bench.play_round(*far_away(bench.situation, bench.draw, m=1))
    _to_test(bench)
    bench.activity = "a re-estimate from messages equal to its own estimate"
    bench.play_round(*((bench.situation.x_hat, alpha) for alpha in scaled_alphas(bench.draw, 5)))


def few_observations(bench: Bench) -> None:
    """Re-estimate b_hat after few observations, whose share of black tiles leaves b_hat off its limits."""
    s = bench.firmware.s
    for t in FEW_OBSERVATIONS:
        if s.t > t:
            continue
        bench.activity = f"{t} observations"
        bench.skip_ticks(t - s.t, lambda: Observation(5 * s.n < 3 * s.t))
        for wanted in (Update.ABOVE, Update.BELOW):
            bench.skip_to_test_round()
            contents = for_update(bench.situation, wanted, bench.draw)
            if contents is not None:
                bench.activity = f"a re-estimate after {s.t} observations"
                bench.play_round(*contents)
                bench.play_tick(None)


def updates_to_see(record: RobotSetup) -> int:
    """Return how often a run re-estimates: beyond 2**8 times where tests are frequent, else beyond 2**5."""
    return 257 if record.filter_period <= FREQUENT_TESTS else 33


def many_updates(bench: Bench) -> None:
    """Re-estimate until a counter of too few bits shows, and from confidences of every scale."""
    count = max(updates_to_see(bench.setup) - bench.firmware.s.updates, len(SCALES))
    for number in range(count):
        bench.skip_to_test_round(bench.draw_observation)
        bench.activity = "one of many re-estimates"
        x_hats = [x_hat for x_hat, _ in far_away(bench.situation, bench.draw)]
        alphas = scaled_alphas(bench.draw, len(x_hats), SCALES[number % len(SCALES)])
        bench.play_round(*zip(x_hats, alphas, strict=True))
        bench.play_tick(bench.draw_observation())


def no_test(bench: Bench) -> None:
    """Rounds before and after a test that it would reject, and one at the test with a single message."""
    _to_test(bench, before=1)
    bench.activity = "a round before that of the test"
    bench.play_round(*far_away(bench.situation, bench.draw))
    bench.activity = "too few messages with a confidence above 0 for a test"
    silent = [(x_hat, 0) for x_hat, _ in far_away(bench.situation, bench.draw)]
    loud = far_away(bench.situation, bench.draw, m=1) if bench.config.filter is Filter.ADAPTIVE else []
    bench.play_round(*loud, *silent)
    for _ in range(2):
        bench.avoid_test("a round after that of the test")
        bench.play_round(*far_away(bench.situation, bench.draw))


def updates(bench: Bench) -> None:
    """Re-estimates of each kind but the one that a phase of its own makes."""
    s = bench.firmware.s
    bench.activity = "more black tiles, for a b_hat that is off 1/2"
    while 20 * s.n < 11 * s.t:
        bench.skip_ticks(BURST, lambda: Observation.BLACK)
    for wanted in Update:
        if wanted not in (Update.HALF, Update.FAINT):
            _update(bench, wanted)


def quiet(bench: Bench) -> None:
    """Messages far away from the estimate of a robot that does not filter, also where a test would be."""
    if bench.setup.filter_period <= LONG_RUN:
        bench.activity = _MANY
        bench.skip_to_test_round(bench.draw_observation)
    for _ in range(5):
        bench.activity = "messages far away"
        bench.play_round(*far_away(bench.situation, bench.draw))


def halvings(bench: Bench) -> None:
    """Halvings of the memory with n modulo 4 as 1, 3, 0 and 2: down, up, and exact twice."""
    s, memory = bench.firmware.s, bench.config.memory
    bench.activity = "observations until the memory is halved"
    while s.t > memory - 4:
        bench.play_tick(bench.draw_observation())
    for n in (1, 3, 0, 2):
        bench.skip_ticks(memory - 4 - s.t, bench.draw_observation)
        blacks = (n - s.n) % 4
        for place in range(4):
            bench.play_tick(Observation(place < blacks))


def long_run(bench: Bench) -> None:
    """So many observations that a memory that is too short shows."""
    bench.activity = _MANY
    bench.skip_ticks(max(LONG_RUN - bench.firmware.s.t, BURST), bench.draw_observation)


def _to_test(bench: Bench, before: int = 0) -> None:
    """Observe until the round of the next test begins, at least once: a new b_hat shows then."""
    bench.activity = _MANY
    bench.play_tick(bench.draw_observation())
    bench.skip_to_test_round(bench.draw_observation, before)


def _crafted(bench: Bench, contents: Sequence[Content]) -> None:
    """A round at the test, and another of the same senders, who count again."""
    senders = bench.draw.sample(bench.other_ids, len(contents))
    bench.play_round(*contents, senders=senders)
    bench.avoid_test(f"{bench.activity}; then others of the same senders")
    bench.play_round(*(any_content(bench.draw) for _ in senders), senders=senders)


def _update(bench: Bench, wanted: Update) -> None:
    """A round for which the test makes this update; up to three others first, where it cannot yet."""
    for _ in range(_ATTEMPTS):
        if wanted in (Update.HALF, Update.FAINT):
            bench.skip_to_test_round()
        else:
            _to_test(bench)
        contents = for_update(bench.situation, wanted, bench.draw)
        bench.activity = f"a round for a re-estimate: {wanted.value}"
        if contents is not None:
            _crafted(bench, contents)
            return
        bench.play_round(*far_away(bench.situation, bench.draw))
    bench.not_exercised.append(f"a re-estimate: {wanted.value}")
