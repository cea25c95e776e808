"""The outer form of a robot's image: its length, its first word and its version (``docs/design.md``).

An image is a sequence of little-endian words of 32 bits, of which the last is a checksum. Its first word is
"MCS", a bit that marks the robust filter, and the version of the layout.
"""

from __future__ import annotations

import struct

from mcp_asdf.robot import Filter
from mcp_asdf.table import checksum

IMAGE_VERSION = 3
IMAGE_MAGIC = 0x4D435300
""""MCS" in the upper three bytes of the first word of an image."""
ROBUST_IMAGE = 1 << 7
"""Bit of the first word that marks an image of the robust filter."""
ASDF_IMAGE_WORDS = 31
"""Length of an image in words, with any filter but the robust one."""
ROBUST_IMAGE_WORDS = 39
"""Length of an image with the robust filter in words."""

IMPOSSIBLE_STATE = "the image does not fit the configuration, or holds a state that no robot can have"
"""Text of an error: the outer form of an image is right, but not what it holds."""


def image_word_count(filter_number: int) -> int:
    """Return the number of words in an image of a robot with this filter, a number of `Filter`."""
    return ROBUST_IMAGE_WORDS if filter_number == Filter.ROBUST else ASDF_IMAGE_WORDS


def image_size(filter_number: int) -> int:
    """Return the number of bytes in an image of a robot with this filter, a number of `Filter`."""
    return 4 * image_word_count(filter_number)


def unpack_image(image: bytes) -> list[int]:
    """Return the words of an image, or of the beginning of one. Its length must be a multiple of 4 bytes."""
    return [word for (word,) in struct.iter_unpack("<I", image)]


def first_image_word(filter_number: int) -> int:
    """Return the first word of an image of a robot with this filter, a number of `Filter`."""
    robust_bit = ROBUST_IMAGE if filter_number == Filter.ROBUST else 0
    return IMAGE_MAGIC | robust_bit | IMAGE_VERSION


def find_image_error(image: bytes, filter_number: int) -> str | None:
    """Return what is wrong with the outer form of a robot's image, or None if it is right.

    The image must come from a robot with this filter, a number of `Filter`. Its first word, version, length
    and checksum are checked, but not the state that it holds. The result is a text for an error message.
    Where the user can do something, the text says what.
    """
    first_word = int.from_bytes(image[:4], "little")
    magic = first_word & 0xFFFFFF00  # the upper three bytes
    if magic != IMAGE_MAGIC or len(image) % 4 != 0:
        return "these bytes are no image of a robot, or a damaged one"
    # The number of words comes later: it differs between versions and filters.
    version = first_word & (ROBUST_IMAGE - 1)  # the bits below that of the robust filter
    if version != IMAGE_VERSION:
        return f"the image is of version {version}, and this firmware reads version {IMAGE_VERSION}"
    if first_word != first_image_word(filter_number):
        is_robust = bool(first_word & ROBUST_IMAGE)
        other_filter = "the robust filter" if is_robust else "a filter other than the robust one"
        return f"the image is that of a robot with {other_filter}; restore it with that"
    words = unpack_image(image)
    *checked_words, stated_checksum = words
    has_right_length = len(words) == image_word_count(filter_number)
    if not has_right_length or checksum(checked_words) != stated_checksum:
        return "the image is damaged"
    return None
