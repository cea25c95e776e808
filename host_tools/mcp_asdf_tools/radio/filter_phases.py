"""Phases that put the filter to the test: its period, its thresholds, its re-estimates, and the memory."""

from __future__ import annotations

from collections.abc import Callable

from mcp_asdf.robot import Filter, Observation
from mcp_asdf_tools.radio.bench import Bench
from mcp_asdf_tools.radio.rounds import (
    CRAFTED_SIZES,
    Update,
    at_threshold,
    far_away,
    for_update,
    ordinary_alpha,
)

LONG_RUN = 10_000
"""Observations after which a controller must not have forgotten any, unless its memory is shorter."""

_WANTED = (Update.ABOVE, Update.BELOW, Update.MAXIMUM, Update.MINIMUM, Update.ABOVE, Update.BELOW)
"""Updates of the rounds just outside their thresholds."""
_ATTEMPTS = 4
_MANY = "many observations in a row"


def no_information(bench: Bench) -> None:
    """A re-estimate that gives b_hat = 1/2, after which the robot knows nothing until the next."""
    bench.doing = "many observations, half of them black"
    s = bench.firmware.s
    while 2 * s.n != s.t:
        bench.tick(Observation(2 * s.n < s.t))
    _update(bench, Update.HALF)
    bench.doing = "observations of a robot that knows nothing"
    for _ in range(3):
        bench.tick(bench.any_observation())


def thresholds(m: int, wanted: Update) -> Callable[[Bench], None]:
    """Rounds of ``m`` messages just inside and just outside k_m; the second one's update is ``wanted``."""

    def play(bench: Bench) -> None:
        for place, where in enumerate(("inside", "outside")):
            _to_test(bench)
            rounds = at_threshold(bench.situation, m, wanted, bench.draw)
            bench.doing = f"{m} messages just {where} the threshold"
            bench.round(*rounds[place])

    return play


THRESHOLDS = {m: thresholds(m, wanted) for m, wanted in zip(CRAFTED_SIZES, _WANTED, strict=True)}


def own_estimate(bench: Bench) -> None:
    """Messages that all equal the own estimate: the test must not reject at equality."""
    _to_test(bench)
    bench.doing = "messages equal to its own estimate"
    bench.round(*((bench.situation.x_hat, ordinary_alpha(bench.draw)) for _ in range(5)))


def no_test(bench: Bench) -> None:
    """Rounds before and after a test that it would reject, and one at the test with a single message."""
    _to_test(bench, before=1)
    bench.doing = "a round before that of the test"
    bench.round(*far_away(bench.situation, bench.draw))
    bench.doing = "too few messages with a confidence above 0 for a test"
    silent = [(x_hat, 0) for x_hat, _ in far_away(bench.situation, bench.draw)]
    loud = far_away(bench.situation, bench.draw, m=1) if bench.config.filter is Filter.ADAPTIVE else []
    bench.round(*loud, *silent)
    for _ in range(2):
        bench.doing = "a round after that of the test"
        bench.avoid_test()
        bench.round(*far_away(bench.situation, bench.draw))


def updates(bench: Bench) -> None:
    """Re-estimates of each kind but the one that a phase of its own makes."""
    for wanted in Update:
        if wanted is not Update.HALF:
            _update(bench, wanted)


def quiet(bench: Bench) -> None:
    """Messages far away from the estimate of a robot that does not filter."""
    for _ in range(5):
        bench.doing = "messages far away"
        bench.round(*far_away(bench.situation, bench.draw))


def halvings(bench: Bench) -> None:
    """Halvings of the memory with n modulo 4 as 1, 3, 0 and 2: down, up, and exact twice."""
    s, memory = bench.firmware.s, bench.config.memory
    bench.doing = "observations until the memory is halved"
    while s.t > memory - 4:
        bench.tick(bench.any_observation())
    for n in (1, 3, 0, 2):
        bench.skip(memory - 4 - s.t, bench.any_observation)
        blacks = (n - s.n) % 4
        for place in range(4):
            bench.tick(Observation(place < blacks))


def long_run(bench: Bench) -> None:
    """So many observations that a memory that is too short shows."""
    bench.doing = _MANY
    bench.skip(LONG_RUN - bench.firmware.s.t, bench.any_observation)


def _to_test(bench: Bench, before: int = 0) -> None:
    """Observe until the round of the next test begins, at least once: a new b_hat shows then."""
    bench.doing = _MANY
    bench.tick(bench.any_observation())
    bench.to_test(bench.any_observation, before)


def _update(bench: Bench, wanted: Update) -> None:
    """A round for which the test makes this update; up to three others first, where it cannot yet."""
    for _ in range(_ATTEMPTS):
        if wanted is Update.HALF:
            bench.to_test()
        else:
            _to_test(bench)
        contents = for_update(bench.situation, wanted, bench.draw)
        bench.doing = f"a round for a re-estimate: {wanted.value}"
        if contents is not None:
            bench.round(*contents)
            return
        bench.round(*far_away(bench.situation, bench.draw))
    bench.missed.append(f"a re-estimate: {wanted.value}")
