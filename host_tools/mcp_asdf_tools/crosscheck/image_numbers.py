"""The numbers in a saved robot's image by name, as ``restore`` calls of a scenario replace them.

The names are those of ``MirrorRobot.state``, and besides

- ``version``, the word that marks the layout and the filter, and ``checksum``; no scenario replaces these;
- ``b_hat``, from which a robot computes all of its ``accuracy`` anew.

The layout is that of ``mcp_asdf_image.c``: little-endian numbers, one after the other.
"""

from __future__ import annotations

from functools import cache

from mcp_asdf.image_format import unpack_image
from mcp_asdf.robot import Filter
from mcp_asdf.robust_filter import SLOTS
from mcp_asdf.table import checksum

MAX_16_BITS, MAX_32_BITS = 0xFFFF, 0xFFFFFFFF
"""Largest number of 16 and of 32 bits."""

COUNTER_NAMES = ("accepted", "repeated", "rejected", "tests", "updates")
"""Counters of events in an image, which wrap."""

# Sizes of numbers in bytes, by name and in the order of an image.
_BEGINNING = dict.fromkeys(("version", "b_hat", "t", "n", "x_hat", "alpha", "filter_left"), 4)
_ROUNDS = {
    "closed_alpha": 8,
    "closed_alpha_x_low": 8,
    "closed_alpha_x_high": 8,
    "open_alpha": 8,
    "open_alpha_x_low": 8,
    "open_alpha_x_high": 8,
    "open_x_squared": 8,
    "open_x": 4,
    "open_count": 4,
}
"""What every filter but the robust one keeps: sums over the last closed round, and over the open one."""
_ROBUST_FILTER = {
    "robust_centre": 4,
    "robust_spread": 4,
    "robust_initial_b_hat": 4,
    "robust_filled_slots": 4,
    "robust_batch_t": 4,
    "robust_batch_n": 4,
    "robust_votes": 2,
    "robust_dispersion": 2,
    "robust_turn": 4,
    **{f"estimates_{slot}": 2 for slot in range(SLOTS)},
}
"""What the robust filter keeps instead."""
_ENDING = {
    "heard_0": 4,
    "heard_1": 4,
    "heard_2": 4,
    "heard_3": 4,
    **dict.fromkeys(COUNTER_NAMES, 2),
    "updated": 1,
    "id": 1,
    "checksum": 4,
}


@cache
def places_of_numbers(filter_number: int) -> dict[str, slice]:
    """Return the bytes of each number that a scenario may replace in an image, by the number's name.

    The image is of a robot with this filter, a number of `Filter`.
    """
    memory_of_filter = _ROBUST_FILTER if filter_number == Filter.ROBUST else _ROUNDS
    places = {}
    start = 0
    for name, size in (_BEGINNING | memory_of_filter | _ENDING).items():
        places[name] = slice(start, start + size)
        start += size
    del places["version"], places["checksum"]
    return places


def largest_number_at(place: slice) -> int:
    """Return the largest number that has room in these bytes of an image."""
    size: int = place.stop - place.start
    return (1 << (8 * size)) - 1


def replace_numbers(image: bytes, filter_number: int, new_numbers: dict[str, int]) -> bytes:
    """Return a copy of an image in which the numbers with these names are replaced.

    The checksum is computed anew. ``filter_number`` is that of the robot, a number of `Filter`.
    """
    places = places_of_numbers(filter_number)
    new_image = bytearray(image)
    for name, value in new_numbers.items():
        place = places[name]
        new_image[place] = value.to_bytes(place.stop - place.start, "little")
    *words, _old_checksum = unpack_image(bytes(new_image))
    new_image[-4:] = checksum(words).to_bytes(4, "little")
    return bytes(new_image)
