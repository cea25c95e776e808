"""Phases that put the filter to the test: its period, its thresholds, its re-estimates, and the memory."""

from __future__ import annotations

from collections.abc import Callable

from mcp_asdf.robot import Observation
from mcp_asdf_tools.radio.coverage import CRAFTED_SIZES, LONG_RUN, Update, is_adaptive
from mcp_asdf_tools.radio.crafted_rounds import any_content, at_threshold, far_away, for_update
from mcp_asdf_tools.radio.protocol_phases import any_observation
from mcp_asdf_tools.radio.stage import Stage

_WANTED = (Update.ABOVE, Update.BELOW, Update.MAXIMUM, Update.MINIMUM, Update.ABOVE, Update.BELOW)
"""Updates of the rounds just outside their thresholds."""
_ATTEMPTS = 4
_MANY = "many observations in a row"


def no_information(stage: Stage) -> None:
    """A re-estimate that gives b_hat = 1/2, after which the robot knows nothing until the next."""
    stage.doing = "many observations, half of them black"
    while 2 * stage.model.firmware.s.n != stage.model.firmware.s.t:
        s = stage.model.firmware.s
        stage.tick(Observation(2 * s.n < s.t))
    _update(stage, Update.HALF)
    stage.doing = "observations of a robot that knows nothing"
    for _ in range(3):
        stage.tick(any_observation(stage))


def thresholds(m: int, wanted: Update) -> Callable[[Stage], None]:
    """Rounds of ``m`` messages just inside and just outside k_m; the second one's update is ``wanted``."""

    def play(stage: Stage) -> None:
        for place, where in enumerate(("inside", "outside")):
            _to_test(stage)
            rounds = at_threshold(stage.situation, m, wanted, stage.draw)
            stage.doing = f"{m} messages just {where} the threshold"
            stage.round(*rounds[place])

    return play


THRESHOLDS = {m: thresholds(m, wanted) for m, wanted in zip(CRAFTED_SIZES, _WANTED, strict=True)}


def own_estimate(stage: Stage) -> None:
    """Messages that all equal the own estimate: the test must not reject at equality."""
    _to_test(stage)
    stage.doing = "messages equal to its own estimate"
    x_hat = stage.situation.x_hat
    stage.round(*((x_hat, any_content(stage.draw)[1]) for _ in range(5)))


def no_test(stage: Stage) -> None:
    """Rounds before and after a test that it would reject, and one at the test with a single message."""
    _to_test(stage, before=1)
    stage.doing = "a round before that of the test"
    stage.round(*far_away(stage.situation, stage.draw))
    stage.doing = "too few messages with a confidence above 0 for a test"
    silent = [(x_hat, 0) for x_hat, _ in far_away(stage.situation, stage.draw)]
    loud = far_away(stage.situation, stage.draw, m=1) if is_adaptive(stage.settings.controller.config) else []
    stage.round(*loud, *silent)
    for _ in range(2):
        stage.doing = "a round after that of the test"
        stage.avoid_test()
        stage.round(*far_away(stage.situation, stage.draw))


def updates(stage: Stage) -> None:
    """Re-estimates of each kind that there has not been yet."""
    for wanted in Update:
        if not stage.model.coverage.updates[wanted]:
            _update(stage, wanted)


def quiet(stage: Stage) -> None:
    """Messages far away from the estimate of a robot that does not filter."""
    for _ in range(5):
        stage.doing = "messages far away"
        stage.round(*far_away(stage.situation, stage.draw))


def halvings(stage: Stage) -> None:
    """Halvings of the memory with n modulo 4 as 1, 3, 0 and 2: down, up, and exact twice."""
    s, memory = stage.model.firmware.s, stage.settings.controller.config.memory
    stage.doing = "observations until the memory is halved"
    while s.t > memory - 4:
        stage.tick(any_observation(stage))
    for n in (1, 3, 0, 2):
        stage.skip(memory - 4 - s.t, lambda: any_observation(stage))
        blacks = (n - s.n) % 4
        for place in range(4):
            stage.tick(Observation(place < blacks))


def long_run(stage: Stage) -> None:
    """So many observations that a memory that is too short shows."""
    stage.doing = _MANY
    stage.skip(LONG_RUN - stage.model.coverage.observations, lambda: any_observation(stage))


def _to_test(stage: Stage, before: int = 0) -> None:
    """Observe until the round of the next test begins, at least once: a new b_hat shows then."""
    stage.doing = _MANY
    stage.tick(any_observation(stage))
    stage.to_test(lambda: any_observation(stage), before)


def _update(stage: Stage, wanted: Update) -> None:
    """A round for which the test makes this update; up to three others first, where it cannot yet."""
    for _ in range(_ATTEMPTS):
        if wanted is Update.HALF:
            stage.to_test()
        else:
            _to_test(stage)
        contents = for_update(stage.situation, wanted, stage.draw)
        stage.doing = f"a round for a re-estimate: {wanted.value}"
        if contents is not None:
            stage.round(*contents)
            return
        stage.round(*far_away(stage.situation, stage.draw))
