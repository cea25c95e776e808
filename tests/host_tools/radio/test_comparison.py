"""A difference says how the two values belong together, where that is no accident."""

from __future__ import annotations

import pytest

from mcp_asdf_tools.bus.frames import (
    Estimate,
    FrameFormat,
    Heartbeat,
    Telemetry,
    encode_estimate,
    encode_heartbeat,
)
from mcp_asdf_tools.bus.frames import encode_telemetry as encode_t
from mcp_asdf_tools.radio.comparison import Comparison
from mcp_asdf_tools.robots.node import Subjects

X, ALPHA = 0x123456, 0x9ABCDE05  # a word: 24 bits and a shift


def told(got: tuple[int, int], expected: tuple[int, int]) -> str:
    """What is said of two estimates' x_hat and alpha."""
    judge = Comparison(Subjects(), encode_heartbeat(Heartbeat(5, 0, 0)))
    own, model = (encode_estimate(Estimate(5, *each, 0), FrameFormat()) for each in (got, expected))
    found = judge.check([model, own, own], [model] * 2)
    assert found is not None and str(found).endswith(f"; {found.relation}" if found.relation else found.got)
    return found.relation


@pytest.mark.parametrize(
    ("got", "words"),
    [
        ((0x563412, ALPHA), "its 3 bytes are in reverse order"),
        ((X << 1, ALPHA), "it is 2 times what it should be"),
        ((X >> 1, ALPHA), "it is 0.5 times what it should be"),
        ((X + 1, ALPHA), ""),
        ((3 * X, ALPHA), ""),
        ((0, ALPHA), ""),
        ((X, ALPHA + 3), "it is 8 times what it should be"),
        ((X, ALPHA + 256), ""),
        ((X, 0), ""),
    ],
)
def test_relations_of_estimates(got: tuple[int, int], words: str) -> None:
    assert told(got, (X, ALPHA)) == words


def test_powers_of_two_in_binary32() -> None:
    """From the least exponent of a normal number to the largest; others have none."""
    tells = {(1, 2): "it is 0.5 times what", (254, 253): "it is 2 times what", (0, 1): "", (255, 254): ""}
    for exponents, words in tells.items():
        own, model = (encode_estimate(Estimate(5, X, ALPHA, 0), FrameFormat()) for _ in exponents)
        for frame, exponent in zip((own, model), exponents, strict=True):
            frame.data[3:7] = (exponent << 23 | 0x345678).to_bytes(4, "little")
        found = Comparison(Subjects(), encode_heartbeat(Heartbeat(5, 0, 0))).check([own], [model])
        assert found is not None and found.relation.partition(" it should")[0] == words


def test_short_values_are_left_alone() -> None:
    """Ten digits that agree are no proof."""
    assert told((0x400 + 2, ALPHA), (0x201 << 2, ALPHA)) == ""
    judge = Comparison(Subjects(), encode_heartbeat(Heartbeat(5, 0, 0)))
    own, model = (encode_t(Telemetry(5, X, 0xABCDEF, updates, 0), Subjects().telemetry) for updates in (2, 4))
    found = judge.check([own], [model])
    assert found is not None and (found.field, found.relation) == ("updates", "")
