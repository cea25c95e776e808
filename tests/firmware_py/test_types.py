"""Arguments of other types than the interface names: treated alike, whichever arithmetic runs inside."""

from __future__ import annotations

import array
from dataclasses import fields, replace
from decimal import Decimal
from fractions import Fraction
from typing import Any

import numpy as np
import pytest

from mcp_asdf.fixed_point import sums_add
from mcp_asdf.robot import Config, Filter, FirmwareError, FixedPointRobot, Observation, Robot, Status, Sums
from robots import (
    ALPHA_LEAST,
    ALPHA_ONE,
    ONE,
    OWN_ID,
    PLAIN,
    AnyType,
    FixedPointType,
    new,
    of_every_kind,
    of_fixed_point,
    status_of_receive,
    watch,
)

NO_INTEGERS: list[Any] = [
    1.0,
    1.5,
    "1",
    b"1",
    None,
    1j,
    Fraction(1),
    Decimal(1),
    np.float32(1),
    np.float64(1),
]
NO_REALS: list[Any] = ["0.5", b"0.5", None, 0.5j, [0.5]]
INTEGERS: list[Any] = [np.int64, np.int32, np.uint32, np.uint64]
REALS: list[Any] = [Fraction, Decimal, np.float64, np.float32]

of_no_integer = pytest.mark.parametrize("wrong", NO_INTEGERS, ids=repr)
of_no_real = pytest.mark.parametrize("wrong", NO_REALS, ids=repr)


def view(robot: Robot) -> tuple[object, ...]:
    shown = (robot.t, robot.n, robot.b_hat, robot.x_hat, robot.alpha, robot.x_bar, robot.beta, robot.x)
    return (*shown, robot.counters)


def busy(kind: AnyType) -> Robot:
    """After a round, in the middle of the next."""
    robot = new(kind)
    robot.receive(9, 0.25, 3.0)
    watch(robot, 2, 1)
    robot.settle()
    robot.receive(9, 0.75, 3.0)
    return robot


# --- Refused ---------------------------------------------------------------------------------------------


@of_every_kind
@of_no_integer
def test_an_observation_is_an_integer(kind: AnyType, wrong: Any) -> None:
    robot = busy(kind)
    before = view(robot)
    with pytest.raises(TypeError):
        robot.observe(wrong)
    with pytest.raises(TypeError):
        robot.step(wrong)
    assert view(robot) == before
    robot.settle()
    assert robot.x_bar == 0.75, "the round was still open"


@of_every_kind
@of_no_integer
def test_a_sender_is_an_integer(kind: AnyType, wrong: Any) -> None:
    robot = busy(kind)
    before = view(robot)
    with pytest.raises(TypeError):
        robot.receive(wrong, 0.5, 1.0)
    assert view(robot) == before
    assert robot.receive(1, 0.5, 1.0) == Status.OK, "it has not been heard"


@of_every_kind
@of_no_real
def test_what_a_message_says_are_real_numbers(kind: AnyType, wrong: Any) -> None:
    robot = busy(kind)
    before = view(robot)
    with pytest.raises(TypeError):
        robot.receive(1, wrong, 1.0)
    with pytest.raises(TypeError):
        robot.receive(1, 0.5, wrong)
    assert view(robot) == before
    assert robot.receive(1, 0.5, 1.0) == Status.OK, "it has not been heard"


@of_fixed_point
@of_no_integer
@pytest.mark.parametrize("place", range(3))
def test_raw_messages_are_integers(kind: FixedPointType, wrong: Any, place: int) -> None:
    robot = kind(PLAIN, OWN_ID, 0.75)
    before = robot.state()
    message: list[Any] = [1, ONE, ALPHA_ONE]
    message[place] = wrong
    with pytest.raises(TypeError):
        robot.receive_raw(*message)
    assert robot.state() == before


@of_fixed_point
@of_no_integer
@pytest.mark.parametrize("name", ["messages", *(member.name for member in fields(Sums))])
def test_sums_are_integers(kind: FixedPointType, wrong: Any, name: str) -> None:
    robot, sums = kind(PLAIN, OWN_ID, 0.75), Sums()
    before = robot.state()
    sums_add(sums, 1, ALPHA_LEAST)
    messages = wrong if name == "messages" else 1
    with pytest.raises(TypeError):
        robot.add_round(sums if name == "messages" else replace(sums, **{name: wrong}), messages)
    assert robot.state() == before


@of_every_kind
@of_no_integer
@pytest.mark.parametrize("name", ["filter", "filter_period", "memory"])
def test_settings_are_integers(kind: AnyType, wrong: Any, name: str) -> None:
    settings: dict[str, Any] = {"filter": Filter.OFF, "filter_period": 1}
    equal = kind(Config(**settings | {name: 64 if name == "memory" else 1}), OWN_ID, 0.75)
    for value in (wrong, 64.0 if name == "memory" else 1.0):
        with pytest.raises(TypeError):
            kind(Config(**settings | {name: value}), OWN_ID, 0.75)
    assert equal.t == 0, "it lives until here, and so does its config, which is equal to one of the others"


@of_every_kind
@of_no_integer
def test_an_id_is_an_integer(kind: AnyType, wrong: Any) -> None:
    with pytest.raises(TypeError):
        kind(PLAIN, wrong, 0.75)


@of_every_kind
@of_no_real
def test_an_accuracy_is_a_real_number(kind: AnyType, wrong: Any) -> None:
    with pytest.raises(TypeError):
        kind(PLAIN, OWN_ID, wrong)


@of_fixed_point
@pytest.mark.parametrize(
    "image", ["x" * 124, 124, None, [0] * 124, 1.0], ids=lambda image: type(image).__name__
)
def test_an_image_is_bytes(kind: FixedPointType, image: Any) -> None:
    with pytest.raises(TypeError):
        kind.restore(PLAIN, image)


# --- Taken -----------------------------------------------------------------------------------------------


@of_every_kind
@pytest.mark.parametrize("integer", INTEGERS)
def test_integers_of_numpy_are_integers(kind: AnyType, integer: Any) -> None:
    """To the bit, with values whose products fill far more than 64 bits."""
    config = Config(filter=Filter.ALWAYS, filter_period=integer(2), memory=integer(64))
    robot = new(kind, replace(PLAIN, filter=Filter.ALWAYS, filter_period=2, memory=64), 0.7)
    other = kind(config, integer(OWN_ID), 0.7)
    for tick in range(70):
        for each, number in ((robot, int), (other, integer)):
            for sender in (1, 31, 100, 127):
                each.receive(number(sender), 0.9, 2.0**30 + tick)
            each.step(number(tick % 3 == 1))  # type: ignore[arg-type]
        assert view(other) == view(robot)
    assert robot.counters.updates > 0
    if isinstance(other, FixedPointRobot):
        assert {type(value) for value in other.state().values()} == {int}


@of_fixed_point
@pytest.mark.parametrize("integer", INTEGERS)
def test_raw_integers_of_numpy_are_integers(kind: FixedPointType, integer: Any) -> None:
    robot, other = kind(PLAIN, OWN_ID, 0.75), kind(PLAIN, OWN_ID, 0.75)
    sums = Sums()
    for x_hat in (ONE, ONE - 1, 5):
        sums_add(sums, x_hat, ALPHA_ONE + 0x101)
    for each, number in ((robot, int), (other, integer)):
        for sender in range(100):
            each.receive_raw(number(sender), number(ONE - sender), number(0x7FFFFF1F))
        wide: Any = int if number is int else np.uint64
        given = Sums(**{name: wide(value) for name, value in vars(sums).items()})
        each.add_round(given, number(4))
    assert other.state() == robot.state()
    assert other.save() == robot.save()
    robot.step(Observation.BLACK)
    other.step(Observation.BLACK)
    assert (other.x_raw, other.x_bar_raw, other.beta_raw) == (robot.x_raw, robot.x_bar_raw, robot.beta_raw)


@of_every_kind
@pytest.mark.parametrize("real", REALS)
def test_real_numbers_of_any_kind_are_taken_by_their_value(kind: AnyType, real: Any) -> None:
    robot, other = new(kind, b_hat=float(real(0.7))), kind(PLAIN, OWN_ID, real(0.7))
    for each, number in ((robot, lambda value: float(real(value))), (other, real)):
        each.receive(1, number(0.3), number(0.1))
        each.receive(2, number(0.9), number(1000.7))
        each.receive(3, number(1), number(0))
        assert status_of_receive(each, 4, number(1.5), number(1)) == Status.ERR_X_HAT
        with pytest.raises(ValueError, match="alpha is"):
            each.receive(4, number(0.5), number(-1))
        watch(each, 3, 1)
    assert view(other) == view(robot)
    assert all(type(value) is float for value in (other.b_hat, other.x_hat, other.x_bar, other.beta, other.x))


@of_fixed_point
@pytest.mark.parametrize(
    "wrapped",
    [
        bytes,
        bytearray,
        memoryview,
        lambda image: memoryview(image).cast("I"),
        lambda image: memoryview(b"".join(bytes([byte, 0]) for byte in image))[::2],
        lambda image: array.array("I", image),
        lambda image: np.frombuffer(image, np.uint8),
    ],
    ids=["bytes", "bytearray", "memoryview", "words", "strided", "array", "numpy"],
)
def test_an_image_may_come_in_any_buffer(kind: FixedPointType, wrapped: Any) -> None:
    robot = kind(PLAIN, OWN_ID, 0.75)
    watch(robot, 5, 2)
    image = robot.save()
    assert kind.restore(PLAIN, wrapped(image)).state() == robot.state()
    for damaged in (image[:-4], image + bytes(4), bytes(len(image))):
        with pytest.raises(FirmwareError, match="ERR_IMAGE"):
            kind.restore(PLAIN, wrapped(damaged))
