"""What robots refuse, and how: messages, images, settings and tables; an error changes nothing.

I1, I2, ... are the numbers of docs/invariants.md.
"""

from __future__ import annotations

import itertools
import math
import re
import struct
from collections.abc import Sequence
from dataclasses import dataclass, replace

import pytest

from mcp_asdf.robot import (
    Config,
    Filter,
    FirmwareError,
    Observation,
    Robot,
    Status,
)
from mcp_asdf.table import MAX_OMEGA_WORD, Table, checksum
from robots import (
    ALPHA_MOST,
    FIXED_POINT,
    HALF,
    IMAGE_SIZE,
    LAYOUT,
    ONE,
    OWN_ID,
    PLAIN,
    TABLE,
    AnyType,
    FixedPoint,
    FixedPointType,
    new,
    of_every_kind,
    of_fixed_point,
    pack,
    receive_all,
    rewritten,
    robot_at,
    status_of_receive,
    unpack,
    watch,
)

WHITE, BLACK = Observation.WHITE, Observation.BLACK
EPSILON = 2.0**-20
ADAPTIVE = Config(table=TABLE, filter_period=1)


def view(robot: Robot) -> tuple[object, ...]:
    """All that can be seen of a robot, but the counter of rejected messages."""
    values = (robot.t, robot.n, robot.b_hat, robot.x_hat, robot.alpha, robot.x_bar, robot.beta, robot.x)
    return (*values, replace(robot.counters, rejected=0))


# --- Messages --------------------------------------------------------------------------------------------

REFUSED = {
    Status.ERR_SENDER: [
        (OWN_ID, 0.5, 1.0),
        (128, 0.5, 1.0),
        (-1, 0.5, 1.0),
        (300, 0.5, 1.0),
        (128, 2.0, 0.0),
    ],
    Status.ERR_X_HAT: [
        (1, math.nextafter(1, 2), 1.0),
        (1, -1e-9, 1.0),
        (1, math.nan, 1.0),
        (1, math.inf, 1.0),
        (1, 2.0, 0.0),
    ],
}


@of_every_kind
@pytest.mark.parametrize(("status", "message"), [(s, m) for s, rows in REFUSED.items() for m in rows])
def test_invalid_messages_count_and_change_nothing(
    kind: AnyType, status: Status, message: tuple[int, float, float]
) -> None:
    robot = new(kind)
    watch(robot, 2, 1)
    robot.receive(1, 0.25, 4.0)
    before = view(robot)
    sender, x_hat, _ = message
    wrong = f"sender is {sender};" if status == Status.ERR_SENDER else f"x_hat is {x_hat};"
    with pytest.raises(FirmwareError, match=re.escape(wrong)) as refused:
        robot.receive(*message)
    assert refused.value.status == status
    assert view(robot) == before
    assert robot.counters.rejected == 1
    following = message[0] % 128 + 1
    assert status_of_receive(robot, following, 0.5, 1.0) != Status.OK or robot.counters.accepted == 2


@of_every_kind
def test_a_robot_shows_its_state(kind: AnyType) -> None:
    robot = new(kind, b_hat=0.75)
    watch(robot, 3, 1)
    name = kind.__name__
    assert repr(robot) == f"<{name} {OWN_ID}: t=4 n=3 b_hat=0.75 x_hat=1 alpha=5.33333 x=1>"
    assert robot.id == OWN_ID


@of_every_kind
@pytest.mark.parametrize("alpha", [-0.0, -1.0, -1e-40, -5e-324, -1e300, math.nan, math.inf, -math.inf])
@pytest.mark.parametrize(("sender", "x_hat"), [(1, 0.5), (OWN_ID, 0.5), (1, 2.0)])
def test_what_is_no_confidence_raises_and_changes_nothing(
    kind: AnyType, alpha: float, sender: int, x_hat: float
) -> None:
    """Frames with such an alpha do not reach a robot; a program that passes one has a fault."""
    robot = new(kind)
    watch(robot, 2, 1)
    before, counters = view(robot), robot.counters
    with pytest.raises(ValueError, match="alpha is"):
        robot.receive(sender, x_hat, alpha)
    assert (view(robot), robot.counters) == (before, counters)
    assert robot.receive(1, 0.5, 1.0) == Status.OK, "it has not been heard"


# --- Saving ----------------------------------------------------------------------------------------------


def busy_robot(kind: FixedPointType) -> FixedPoint:
    """In the middle of a round, with something in every field of the state."""
    robot = kind(replace(ADAPTIVE, filter_period=4), OWN_ID, 0.7)
    for tick in range(41):
        robot.observe(Observation(tick % 3 == 1))
        receive_all(
            robot, [(i * 13 % 128, 5 * 2**20 + 2**17 * i, 0x80000001 + 259 * i) for i in range(tick % 7)]
        )
        receive_all(robot, [(9, 5, 0), (OWN_ID, 5, 0), (9, 5, 0)])
        if tick % 2:
            robot.settle()
    robot.settle()
    receive_all(
        robot, [(3, 2**21, 0x80123417), (40, 2**21 + 9, 0xFF123417), (70, 3, 0x80000007), (127, 7, 0)]
    )
    return robot


@of_fixed_point
def test_an_image_holds_every_field(kind: FixedPointType) -> None:
    """The image is the one docs/design.md describes, field by field."""
    robot = busy_robot(kind)
    image, state = robot.save(), robot.state()
    found = unpack(image)
    assert len(image) == IMAGE_SIZE == 124
    assert found.pop("magic") == 0x4D435302, "version 2"
    assert found.pop("b_hat") == state["accuracy_b_hat"]
    assert found == {name: value for name, value in state.items() if not name.startswith("accuracy_")}
    assert pack(unpack(image)) == image
    assert [name for name, value in found.items() if not value] == ["updated"], "the others can be told apart"


@pytest.mark.parametrize(("source", "target"), list(itertools.product(FIXED_POINT, repeat=2)))
def test_images_are_the_same_everywhere(source: FixedPointType, target: FixedPointType) -> None:
    robot = busy_robot(source)
    restored = target.restore(robot.config, robot.save())
    assert restored.state() == robot.state()
    assert restored.save() == robot.save()


def check_refused(kind: FixedPointType, config: Config, image: bytes) -> None:
    with pytest.raises(FirmwareError) as caught:
        kind.restore(config, image)
    assert caught.value.status == Status.ERR_IMAGE


@of_fixed_point
def test_every_flipped_bit_of_an_image_is_refused(kind: FixedPointType) -> None:
    """I17"""
    robot = busy_robot(kind)
    image = robot.save()
    for bit in range(8 * len(image)):
        damaged = bytearray(image)
        damaged[bit // 8] ^= 1 << bit % 8
        check_refused(kind, robot.config, bytes(damaged))
    assert robot.save() == image


@of_fixed_point
def test_images_of_another_size_or_make_are_refused(kind: FixedPointType) -> None:
    robot = busy_robot(kind)
    image = robot.save()
    for size in (0, 4, 120, 123):
        check_refused(kind, robot.config, image[:size])
    check_refused(kind, robot.config, image + b"\0")
    check_refused(kind, robot.config, bytes(124))
    check_refused(kind, robot.config, b"\xff" * 124)
    check_refused(kind, robot.config, image[::-1])
    for magic in (0x4D435300, 0x4D435301, 0x4D435303, 0x4D435402, 0):
        check_refused(kind, robot.config, rewritten(image, magic=magic))
    check_refused(kind, robot.config, rewritten(image)[:-4] + struct.pack("<I", checksum([0])))


IMPOSSIBLE = {
    "I1": [{"id": 128}, {"id": 255}],
    "I2": [{"t": 100}, {"t": 0, "n": 1}, {"n": 2**32 - 1}, {"t": 2**32 - 1}],
    "I3": [{"b_hat": 2**12 - 1}, {"b_hat": 2**32 - 2**12 + 1}, {"b_hat": 0}],
    "I5": [
        {"x_hat": ONE + 1},
        {"x_hat": ONE + 1, "updated": 1},
        {"alpha": 0x20, "updated": 1},
        {"alpha": 0x80000080, "updated": 1},
        {"alpha": 0x00000101, "updated": 1},
        {"alpha": 0x7FFFFF1F, "updated": 1},
        {"alpha": 1, "updated": 1},
        {"x_hat": HALF + 1},
        {"alpha": 0},
        {"alpha": ALPHA_MOST},
        {"t": 42},
        {"n": 13},
        {"b_hat": 3 << 30},
        {"updated": 2},
        {"updated": 255},
        {"t": 0, "n": 0},
        {"t": 0, "n": 0, "x_hat": HALF, "alpha": 0, "updated": 1},
    ],
    "I6": [
        {"closed_alpha": 0, "closed_alpha_x_low": 1, "closed_alpha_x_high": 0},
        {"closed_alpha": 3, "closed_alpha_x_low": 3 * ONE + 1, "closed_alpha_x_high": 0},
        {"closed_alpha": 127 * (2**55 - 2**31) + 1},
        {"closed_alpha": 2**61, "closed_alpha_x_high": 2**53},
        {"closed_alpha": 2**61, "closed_alpha_x_low": 2**62},
    ],
    "I7": [
        {"open_alpha": 2**62},
        {"open_alpha": 2},
        {"open_x": 4 * ONE},
        {"open_x_squared": 2**53},
        {"open_x_squared": 2**40},
        {"open_alpha_x_low": 2**62},
        {"open_alpha_x_high": 2**53},
        {"open_count": 128},
        {"open_count": 0},
    ],
    "I8": [{"heard_0": 0, "heard_1": 0}, {"heard_2": 0, "heard_3": 0}, {"open_count": 5}],
    "I9": [{"heard_0": 1 << OWN_ID}, {"heard_0": 2**32 - 1}],
    "I10": [{"filter_left": 0}, {"filter_left": 5}, {"filter_left": 2**32 - 1}],
}
"""Fields of the busy robot's image that no sequence of calls can have, by the invariant they break."""


@of_fixed_point
@pytest.mark.parametrize(("invariant", "fields"), [(i, f) for i, rows in IMPOSSIBLE.items() for f in rows])
def test_impossible_states_are_refused(kind: FixedPointType, invariant: str, fields: dict[str, int]) -> None:
    """With a right checksum, so the invariants themselves must refuse."""
    robot = busy_robot(kind)
    config = replace(robot.config, memory=100)
    kind.restore(config, robot.save())
    check_refused(kind, config, rewritten(robot.save(), **fields))


@of_fixed_point
def test_an_image_must_fit_its_new_config(kind: FixedPointType) -> None:
    robot = robot_at(kind, replace(PLAIN, filter_period=8), t=80, filter_left=8)
    image = robot.save()
    kind.restore(replace(PLAIN, filter_period=9, memory=84), image)
    check_refused(kind, replace(PLAIN, filter_period=8, memory=80), image)
    check_refused(kind, replace(PLAIN, filter_period=7), image)


# --- Settings --------------------------------------------------------------------------------------------


def check_not_made(
    kind: AnyType, status: Status, config: Config, robot_id: int = OWN_ID, b_hat: float = 0.75
) -> None:
    with pytest.raises(FirmwareError) as caught:
        kind(config, robot_id, b_hat)
    assert caught.value.status == status


@of_every_kind
@pytest.mark.parametrize(
    "wrong",
    [
        {"filter_period": 0},
        {"filter_period": -1},
        {"filter_period": 2**32},
        {"filter_period": 2**32 + 1},
        {"memory": 0},
        {"memory": -64},
        {"memory": 60},
        {"memory": 62},
        {"memory": 65},
        {"memory": 66},
        {"memory": 2**31 - 2},
        {"memory": 2**31 + 4},
        {"memory": 2**32 - 4},
        {"memory": 2**32},
        {"memory": 2**32 + 64},
        {"filter": 3},
        {"filter": -1},
        {"filter": 256},
    ],
    ids=str,
)
def test_config_errors(kind: AnyType, wrong: dict[str, int]) -> None:
    values: dict[str, object] = {"filter": Filter.OFF, **wrong}
    check_not_made(kind, Status.ERR_CONFIG, Config(**values))  # type: ignore[arg-type]


@of_every_kind
def test_the_ends_of_the_settings_are_legal(kind: AnyType) -> None:
    kind(replace(PLAIN, filter_period=2**32 - 1, memory=2**31), 127, EPSILON)
    kind(replace(PLAIN, filter_period=1, memory=64), 0, 1 - EPSILON)
    kind(replace(PLAIN, memory=68), 0, 1 - EPSILON)
    kind(replace(PLAIN, memory=2**31 - 4), 0, 1 - EPSILON)
    kind(Config(table=None, filter=Filter.ALWAYS), 1, 0.5)


@of_every_kind
@pytest.mark.parametrize("robot_id", [-1, 128, 255, 256])
def test_id_errors(kind: AnyType, robot_id: int) -> None:
    check_not_made(kind, Status.ERR_ID, PLAIN, robot_id)


@of_every_kind
@pytest.mark.parametrize(
    "b_hat", [EPSILON - 2.0**-33, 1 - EPSILON + 2.0**-33, 0.0, 1.0, -0.5, 2.0, math.nan, math.inf]
)
def test_b_hat_errors(kind: AnyType, b_hat: float) -> None:
    check_not_made(kind, Status.ERR_B_HAT, PLAIN, b_hat=b_hat)


GOOD = Table(omega_word=1 << 30, entries=(2**32 - 2, 3 << 26, (1 << 26) + 1))
BAD_TABLES = {
    "none": None,
    "omega 0": replace(GOOD, omega_word=0),
    "omega above 0.9": replace(GOOD, omega_word=MAX_OMEGA_WORD + 1),
    "q = 1": replace(GOOD, entries=GOOD.entries[:1]),
    "q = 128": replace(GOOD, entries=tuple(range((9 << 26) + 128, 9 << 26, -1))),
    "no entries": replace(GOOD, entries=()),
    "rising": replace(GOOD, entries=(3 << 26, (3 << 26) + 1)),
    "equal": replace(GOOD, entries=(3 << 26, 3 << 26)),
    "rising at the end": replace(GOOD, entries=(4 << 26, 3 << 26, (3 << 26) + 1)),
    "1.0": replace(GOOD, entries=(3 << 26, 1 << 26)),
    "below 1.0": replace(GOOD, entries=(3 << 26, 1)),
    "64.0": replace(GOOD, entries=(64 << 26, 2 << 26)),
    "33 bits": replace(GOOD, entries=(2**33 - 1, 2**31 + 1)),
    "below 0, but the largest of 32 bits": replace(GOOD, entries=(-1, 3 << 26)),
    "below 0, of a fallen row": replace(GOOD, entries=(-1, -2)),
    "omega below 0": replace(GOOD, omega_word=-1),
    "omega of 33 bits": replace(GOOD, omega_word=2**32 + 5),
    "q = 2 claimed of 258": replace(GOOD, entries=tuple(range((9 << 26) + 258, 9 << 26, -1))),
}


@of_every_kind
@pytest.mark.parametrize("fault", BAD_TABLES)
def test_table_errors(kind: AnyType, fault: str) -> None:
    check_not_made(kind, Status.ERR_TABLE, Config(table=BAD_TABLES[fault]))


@of_every_kind
@pytest.mark.parametrize(
    "table",
    [
        GOOD,
        replace(GOOD, omega_word=1),
        replace(GOOD, omega_word=MAX_OMEGA_WORD),
        replace(GOOD, entries=((1 << 26) + 2, (1 << 26) + 1)),
        replace(GOOD, entries=(2**32 - 1, 2**32 - 2)),
        replace(GOOD, entries=tuple(range((9 << 26) + 127, 9 << 26, -1))),
    ],
)
def test_the_ends_of_a_table_s_fields_are_legal(kind: AnyType, table: Table) -> None:
    kind(Config(table=table), OWN_ID, 0.75)


@dataclass(frozen=True)
class Spoilt(Table):
    """A table whose words are not those of its entries."""

    given: tuple[int, ...]

    def words(self) -> tuple[int, ...]:
        return self.given


def table_of(words: Sequence[int]) -> Table:
    return Spoilt(words[1], tuple(words[2:-1]), tuple(words))


@of_every_kind
@pytest.mark.parametrize("place", range(len(GOOD.words())))
def test_every_flipped_bit_of_a_table_is_refused(kind: AnyType, place: int) -> None:
    """Its checksum sees it, whichever word; also where word 0 then claims another q or format."""
    for bit in range(32):
        words = list(GOOD.words())
        words[place] ^= 1 << bit
        check_not_made(kind, Status.ERR_TABLE, Config(table=table_of(words)))


@of_every_kind
@pytest.mark.parametrize(
    "first", [0x4D435303, 0x4D435503, 0x00000003, 0x4D435404, 0x4D435402, 0x4D4354FF, 0x4D435400]
)
def test_a_table_of_another_make_is_refused(kind: AnyType, first: int) -> None:
    """With a right checksum, so word 0 itself must be looked at: other formats, other q."""
    body = (first, *GOOD.words()[1:-1])
    check_not_made(kind, Status.ERR_TABLE, Config(table=table_of((*body, checksum(body)))))


@of_every_kind
def test_a_table_is_not_needed_without_a_test(kind: AnyType) -> None:
    for mode in (Filter.ALWAYS, Filter.OFF):
        kind(Config(table=BAD_TABLES["rising"], filter=mode), OWN_ID, 0.75)


@of_every_kind
def test_the_first_error_is_told(kind: AnyType) -> None:
    """Config, table, id, b_hat, in this order."""
    bad_table = Config(table=None)
    check_not_made(kind, Status.ERR_CONFIG, replace(bad_table, memory=1), 200, 0.0)
    check_not_made(kind, Status.ERR_TABLE, bad_table, 200, 0.0)
    check_not_made(kind, Status.ERR_ID, PLAIN, 200, 0.0)


@of_fixed_point
def test_a_bad_config_restores_nothing(kind: FixedPointType) -> None:
    image = kind(PLAIN, OWN_ID, 0.75).save()
    for config, status in (
        (replace(PLAIN, memory=1), Status.ERR_CONFIG),
        (Config(table=None), Status.ERR_TABLE),
    ):
        with pytest.raises(FirmwareError) as caught:
            kind.restore(config, image)
        assert caught.value.status == status


def test_the_table_s_checksum_is_fnv_1a_over_words() -> None:
    words = GOOD.words()
    value = 0x811C9DC5
    for word in words[:-1]:
        value = (value ^ word) * 0x01000193 % 2**32
    assert words[-1] == value and words[0] == 0x4D435403
    assert set(LAYOUT.values()) == {8, 16, 32, 64}
