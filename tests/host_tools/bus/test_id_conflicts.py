"""Two nodes with one id are noticed, and one node on a bad bus is never taken for two."""

from __future__ import annotations

import random
from collections.abc import Iterable

import pytest

from mcp_asdf_tools.bus.frames import Heartbeat, Message
from mcp_asdf_tools.bus.id_conflicts import IdConflict, IdConflictWatch
from support import draws

pytestmark = pytest.mark.random

ID = 5
SEED = 41


def broadcast(sender: int, number: int) -> Message:
    """The sender's message ``number``; every one has a content of its own."""
    return Message(ID, number, sender, number % 32)


def first_noticed(messages: Iterable[Message]) -> int | None:
    """Number of messages heard when a conflict was reported; None if none was."""
    watch = IdConflictWatch()
    for count, message in enumerate(messages, 1):
        conflict = watch.hear(message)
        assert (conflict is None) == (not watch.found)
        if conflict is not None:
            assert watch.found == {message.sender: conflict}
            return count
    return None


def one_sender(seed: str, messages: int, loss: float, repeats: float, late: int) -> list[Message]:
    """Messages that arrive; each may be lost, repeated, and delayed by up to ``late``."""
    draw = random.Random(seed)
    arrivals = []
    for number in range(messages):
        if draw.random() >= loss:
            arrivals.append((number + draw.randint(0, late), number))
            if draw.random() < repeats:
                arrivals.append((number + draw.randint(0, late), number))
    return [broadcast(0, number) for _, number in sorted(arrivals)]


@pytest.mark.parametrize("loss", [0.0, 0.1, 0.5, 0.8, 0.9, 0.95, 0.99])
@pytest.mark.parametrize(("repeats", "late"), [(0.0, 0), (0.3, 0), (0.3, 3), (0.3, 12)])
def test_one_sender_on_a_bad_bus_is_no_conflict(loss: float, repeats: float, late: int) -> None:
    seed, count = f"{SEED} {loss} {repeats} {late}", draws(20_000)
    arriving = one_sender(seed, count, loss, repeats, late)
    assert first_noticed(arriving) is None, (
        f"replay: one_sender({seed!r}, {count}, {loss}, {repeats}, {late})"
    )


@pytest.mark.parametrize("loss", [0.0, 0.3, 0.9])
def test_a_node_that_restarts_is_no_conflict(loss: float) -> None:
    draw = random.Random(SEED)
    number, arriving = 0, []
    for content in range(20_000):
        number = 0 if draw.random() < 0.02 else number + 1
        if draw.random() >= loss:
            arriving.append(Message(ID, content, 0, number % 32))
    assert first_noticed(arriving) is None


def two_senders(offset: int, shuffled: bool, loss: float) -> list[Message]:
    """Two nodes that send in each of 500 rounds; the second counts ``offset`` ahead of the first."""
    draw = random.Random(f"{SEED} {offset} {shuffled} {loss}")
    arriving = []
    for number in range(500):
        both = [broadcast(0, number), broadcast(1, number + offset)]
        if shuffled:
            draw.shuffle(both)
        arriving += [message for message in both if draw.random() >= loss]
    return arriving


@pytest.mark.parametrize("shuffled", [False, True])
def test_two_senders_are_noticed_within_35_rounds_and_in_spite_of_loss(shuffled: bool) -> None:
    for offset in range(32):
        noticed = first_noticed(two_senders(offset, shuffled, loss=0.0))
        assert noticed is not None, offset
        assert noticed <= 70, offset
        assert first_noticed(two_senders(offset, True, loss=0.25)) is not None, offset


def test_own_id_is_noticed_at_once() -> None:
    watch = IdConflictWatch(own=ID)
    assert watch.hear(Message(ID + 1, 0, 0, 0)) is None
    assert watch.hear(Heartbeat(ID, 0, 0)) is IdConflict.OWN_ID
    assert watch.found == {ID: IdConflict.OWN_ID}
    assert watch.hear(Heartbeat(ID, 1, 1)) is None, "it was reported"


def test_only_the_shared_id_is_reported() -> None:
    watch = IdConflictWatch()
    for first, second in zip(*[iter(two_senders(9, True, 0.0))] * 2, strict=True):
        for message in (first, second):
            watch.hear(message)
        watch.hear(Message(ID + 1, first.x_hat, 0, first.transfer_id))
    assert watch.found == {ID: IdConflict.TWO_SENDERS}
