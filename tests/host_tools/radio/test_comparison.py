"""Comparison of a controller's frames with its model's: what differs first, and the hint at its cause.

The model is the same robot in Python, and what it sends is expected of the controller.
"""

from __future__ import annotations

import can
import pytest

from mcp_asdf_tools.bus.frame_layout import Health
from mcp_asdf_tools.bus.frames import (
    Estimate,
    FrameFormat,
    Heartbeat,
    Telemetry,
    encode_estimate,
    encode_heartbeat,
    encode_telemetry,
)
from mcp_asdf_tools.radio.comparison import Comparison, Difference, is_from
from mcp_asdf_tools.robots.node import Subjects

X_HAT = 0x123456
ALPHA_WORD = 0x9ABCDE05
"""An alpha as the firmware's word: a mantissa of 24 bits, and 5 as its shift."""


def estimate(x_hat: int = X_HAT, alpha_word: int = ALPHA_WORD) -> can.Message:
    """Return the frame of an estimate of robot 5."""
    return encode_estimate(Estimate(sender=5, x_hat=x_hat, alpha=alpha_word, transfer_id=0), FrameFormat())


def telemetry(updates: int = 0, b_hat: int = 0xABCDEF) -> can.Message:
    return encode_telemetry(Telemetry(5, X_HAT, b_hat, updates, transfer_id=0), Subjects().telemetry)


def heartbeat(uptime: int = 0, health: Health = Health.NOMINAL) -> can.Message:
    frame = encode_heartbeat(Heartbeat(5, uptime, transfer_id=0))
    frame.data[4] = health.value  # byte 4 is the health
    return frame


def new_comparison() -> Comparison:
    return Comparison(Subjects(), first_heartbeat=heartbeat())


def comparison_after_telemetry() -> Comparison:
    """Return a comparison that has received telemetry, as the controller sends it at the end of a tick."""
    comparison = new_comparison()
    assert comparison.check([telemetry()], [telemetry()]) is None
    return comparison


def difference_between(*, received: list[can.Message], expected: list[can.Message]) -> Difference:
    """Return the difference that a new comparison finds, without telemetry before. Fails if there is none."""
    difference = new_comparison().check(received, expected)
    assert difference is not None
    return difference


# --- Hints ---


@pytest.mark.parametrize(
    ("received_x_hat", "expected_hint"),
    [(0x563412, "its 3 bytes are in reverse order"), (0x123457, ""), (0, "")],
)
def test_an_x_hat_in_reverse_order_gets_a_hint_at_that(received_x_hat: int, expected_hint: str) -> None:
    """x_hat is a robot's own estimate, of three bytes. Other differences in it get no hint: it is empty."""
    received, expected = estimate(received_x_hat), estimate(0x123456)
    assert difference_between(received=[received], expected=[expected]).hint == expected_hint


def test_a_number_of_updates_gets_no_hint() -> None:
    """It has a single byte, which has no order."""
    difference = difference_between(received=[telemetry(updates=2)], expected=[telemetry(updates=4)])
    assert difference.field == "updates"
    assert difference.hint == ""


def test_the_hint_is_about_the_first_frame_that_differs() -> None:
    """The first frame is right. The x_hat of the second has its bytes in reverse order, as the text says."""
    right_frame = estimate(0x123456)
    received = [right_frame, estimate(0x563412), estimate(0)]
    difference = difference_between(received=received, expected=[right_frame, right_frame])
    assert str(difference).endswith("; its 3 bytes are in reverse order")


def test_the_text_of_a_difference_has_both_values() -> None:
    """An x_hat is shown as it is sent, and as a number: 0x123456 is 0.1422222 * 2**23."""
    difference = difference_between(received=[estimate(0x123457)], expected=[estimate(0x123456)])
    text = str(difference)
    assert text.startswith("estimate, x_hat: expected 106BB805 transfer_id 0, x_hat 0x123456 (0.1422222), ")
    assert text.endswith(f", got {difference.received}")


# --- What differs ---


def test_a_b_hat_is_described_as_a_fraction() -> None:
    """The received b_hat 0xC00000, in units of 2**-24, is described as 0.75."""
    difference = difference_between(
        received=[telemetry(b_hat=0xC00000)], expected=[telemetry(b_hat=0xABCDEF)]
    )
    assert difference.field == "b_hat"
    assert "b_hat 0xc00000 (0.7500000)" in difference.received


def test_equal_frames_are_counted_by_kind() -> None:
    """Two estimates and one telemetry frame are received as expected. ``equal_frames`` has these numbers."""
    comparison = new_comparison()
    frames = [estimate(), estimate(), telemetry()]
    assert comparison.check(frames, frames) is None
    assert comparison.equal_frames == {"estimate": 2, "telemetry": 1, "heartbeat": 0}


def test_a_difference_names_three_frames_too_many_and_the_number_of_the_others() -> None:
    """Five telemetry frames are received where none is expected, so the text names three "and 2 more"."""
    five_frames = [telemetry(updates) for updates in range(5)]
    difference = difference_between(received=five_frames, expected=[])
    assert difference.field == "extra"
    assert difference.expected == "nothing"
    assert difference.received.endswith(" and 2 more")


def test_a_remote_frame_is_described_by_its_raw_data() -> None:
    """A remote frame asks for data but carries no data. So it is described by its identifier and an R."""
    remote_frame = can.Message(arbitration_id=estimate().arbitration_id, is_remote_frame=True)
    difference = difference_between(received=[remote_frame], expected=[estimate()])
    assert difference.field == "frame"
    assert difference.received == "106BB805#R"


def test_an_estimate_before_the_heartbeat_is_a_difference_once_telemetry_was_received() -> None:
    """The difference says that the heartbeat was expected first."""
    comparison = comparison_after_telemetry()
    difference = comparison.check(
        received=[estimate(), heartbeat(uptime=1)], expected=[heartbeat(uptime=1), estimate()]
    )
    assert str(difference) == "estimate, order: expected the heartbeat first, got it before the heartbeat"


def test_an_estimate_before_the_heartbeat_is_no_difference_before_telemetry_was_received() -> None:
    """The heartbeat was expected first, but a controller that is starting may send it at any time."""
    difference = new_comparison().check(
        received=[estimate(), heartbeat(uptime=1)], expected=[heartbeat(uptime=1), estimate()]
    )
    assert difference is None


def test_the_heartbeat_with_which_a_controller_starts_may_come_several_times_before_telemetry() -> None:
    """The heartbeat comes twice where none is expected, but each reset sends it: there is no difference."""
    received = [heartbeat(uptime=0), heartbeat(uptime=0), telemetry()]
    difference = new_comparison().check(received, expected=[telemetry()])
    assert difference is None


def test_the_heartbeat_with_which_a_controller_starts_is_a_difference_after_telemetry() -> None:
    """The heartbeat is reported as "extra": the controller has started anew meanwhile."""
    difference = comparison_after_telemetry().check(received=[heartbeat(uptime=0)], expected=[])
    assert difference is not None
    assert difference.field == "extra"


@pytest.mark.parametrize(
    ("received_health", "is_advisory_allowed", "expected_field"),
    [(Health.ADVISORY, True, None), (Health.ADVISORY, False, "health"), (Health.CAUTION, True, "health")],
)
def test_a_heartbeat_with_a_worse_health_is_a_difference_unless_it_is_advisory_and_that_is_allowed(
    received_health: Health, is_advisory_allowed: bool, expected_field: str | None
) -> None:
    """Nominal is expected. Advisory is the next worse health, and caution is worse than both.

    ``expected_field`` is the field that differs, or None if there is no difference.
    """
    comparison = comparison_after_telemetry()
    comparison.is_advisory_allowed = is_advisory_allowed

    difference = comparison.check(
        received=[heartbeat(uptime=1, health=received_health)],
        expected=[heartbeat(uptime=1, health=Health.NOMINAL)],
    )

    field = None if difference is None else difference.field
    assert field == expected_field


# --- Senders ---


def test_a_frame_is_from_the_robot_in_its_identifier() -> None:
    """``is_from`` is true for robot 5, which has sent the estimate, and false for robot 6."""
    estimate_of_robot_5 = estimate()
    assert is_from(estimate_of_robot_5, robot=5)
    assert not is_from(estimate_of_robot_5, robot=6)


def test_a_frame_with_an_11_bit_identifier_is_from_no_robot() -> None:
    """The lowest 7 bits of the identifier are 5, but robots send frames with identifiers of 29 bits."""
    frame_with_11_bit_identifier = can.Message(arbitration_id=5, is_extended_id=False)
    assert not is_from(frame_with_11_bit_identifier, robot=5)
