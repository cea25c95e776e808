"""The codec of small messages: in Python the same as in C, which tests/c_ref compares with its rules."""

from __future__ import annotations

import ctypes
import random
from collections.abc import Sequence
from typing import Any

import pytest

from mcp_asdf import small_messages
from mcp_asdf.fixed_point import HALF, ONE, alpha_from_word, alpha_word_from_float
from mcp_asdf.small_messages import (
    MAX_ALPHA_BITS,
    MAX_X_HAT_BITS,
    decode_alpha,
    decode_message,
    encode_alpha,
    encode_message,
    encode_x_hat,
)
from support import CORE, require, run

C_SOURCE = CORE.with_name("mcp_asdf_small.c")


# --- Messages --------------------------------------------------------------------------------------------


def test_a_message_has_the_bytes_that_the_specification_shows() -> None:
    """Here x_hat and alpha are 1.0, which ONE is in the units of x_hat."""
    message = encode_message(sender=42, x_hat=ONE, alpha=alpha_word_from_float(1.0))
    assert message == bytes.fromhex("50FEFF55")


def test_a_message_is_decoded_to_sender_x_hat_and_alpha() -> None:
    """The specification shows this message: robot 42 sends an x_hat of 1.0 and an alpha of 1.0.

    ONE is 1.0 in the units of x_hat, and alpha is a word as the firmware has it.
    """
    sender, x_hat, alpha = decode_message(bytes.fromhex("50FEFF55"))
    assert sender == 42
    assert x_hat == ONE
    assert alpha == alpha_word_from_float(1.0)


def test_encoding_what_was_decoded_gives_the_same_bytes() -> None:
    """So a message loses nothing where a gateway decodes it and encodes it again.

    A message is a word of three fields, which do not affect each other. Each takes all of its values.
    """
    all_ids = [robot_id << 25 for robot_id in range(2**7)]
    all_codes_of_x_hat = [code << 9 for code in range(2**16)]
    all_codes_of_alpha = list(range(2**9))
    for word in (*all_ids, *all_codes_of_x_hat, *all_codes_of_alpha):
        message = word.to_bytes(4, "little")

        sender, x_hat, alpha = decode_message(message)

        assert encode_message(sender, x_hat, alpha) == message, message.hex()


@pytest.mark.parametrize(
    ("sender", "x_hat", "expected_message"),
    [
        (-1, 0, "sender is -1; give an id from 0 to 127"),
        (128, 0, "sender is 128; give an id from 0 to 127"),
        (0, -1, "x_hat is -1; give 0 to 8388608"),
        (0, 8388609, "x_hat is 8388609; give 0 to 8388608"),
    ],
)
def test_a_message_with_a_sender_or_an_estimate_out_of_range_is_refused(
    sender: int, x_hat: int, expected_message: str
) -> None:
    """An id has 7 bits. x_hat is a share of black tiles, in units of 1 / 8388608. The error names them."""
    with pytest.raises(ValueError, match=expected_message):
        encode_message(sender, x_hat, alpha=0)


@pytest.mark.parametrize("length", [0, 3, 5])
def test_a_message_of_another_length_is_refused(length: int) -> None:
    """A message has 4 bytes. Here it has none, one less or one more."""
    with pytest.raises(ValueError, match=f"the message has {length} bytes; a small message has 4"):
        decode_message(bytes(length))


# --- Codes of alpha --------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("code", "alpha"),
    [(0, 0.0), (1, 2**-8), (15, 15 * 2**-8), (16, 2**-4), (17, 17 * 2**-8), (80, 1.0), (511, 31 * 2.0**22)],
)
def test_a_code_of_9_bits_stands_for_the_confidence_that_the_specification_states(
    code: int, alpha: float
) -> None:
    """Up to code 16 it grows by 2**-8 with each code, and from then on 16 codes double it.

    An alpha word is a confidence in 32 bits, as the firmware has it.
    """
    alpha_word = decode_alpha(code, bits=9)
    assert alpha_from_word(alpha_word) == alpha


# --- The codec in C --------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def c_library(tmp_path_factory: pytest.TempPathFactory) -> Any:
    """The codec in C as a shared library."""
    library = tmp_path_factory.mktemp("small") / "small.so"
    run(require("gcc", "gcc"), "-std=c99", "-O1", "-shared", "-fPIC", C_SOURCE, "-o", library)
    return ctypes.CDLL(str(library))


def c_code_function(c_library: Any, name: str) -> Any:
    """Return one of the four functions of C that convert a number, given the bits of its code."""
    function = getattr(c_library, f"mcp_asdf_{name}")
    function.argtypes, function.restype = [ctypes.c_uint32, ctypes.c_uint32], ctypes.c_uint32
    return function


@pytest.mark.parametrize(
    ("c_name", "python_name", "max_bits"),
    [
        ("x_hat_from_code", "decode_x_hat", MAX_X_HAT_BITS),
        ("alpha_from_code", "decode_alpha", MAX_ALPHA_BITS),
    ],
)
def test_c_and_python_decode_codes_alike(
    c_library: Any, c_name: str, python_name: str, max_bits: int
) -> None:
    """The functions are for x_hat or alpha. They get every code of up to 9 bits, and of 16, as messages have.

    Of other lengths they get 1000 random codes.
    """
    c_function = c_code_function(c_library, c_name)
    python_function = getattr(small_messages, python_name)
    for bits in range(1, max_bits + 1):
        for code in all_or_1000_codes(bits):
            assert c_function(code, bits) == python_function(code, bits), (code, bits)


def all_or_1000_codes(bits: int) -> Sequence[int]:
    """Return all codes of so many bits if they are at most 9 or are 16, else 1000 random ones."""
    if bits <= 9 or bits == 16:
        return range(1 << bits)
    rng = random.Random(bits)
    return [rng.getrandbits(bits) for _ in range(1000)]


def test_c_and_python_encode_x_hat_alike(c_library: Any) -> None:
    """For every length of codes, x_hat is near 0, 1/2 or 1, or one of 1000 random numbers."""
    c_function = c_code_function(c_library, "x_hat_to_code")
    source = random.Random(5)
    for bits in range(1, MAX_X_HAT_BITS + 1):
        random_x_hats = [source.randint(0, ONE) for _ in range(1000)]
        for x_hat in [0, 1, HALF - 1, HALF, HALF + 1, ONE, *random_x_hats]:
            assert c_function(x_hat, bits) == encode_x_hat(x_hat, bits), (x_hat, bits)


def test_c_and_python_encode_alpha_alike(c_library: Any) -> None:
    """Codes of every length are tried, each with 2000 random confidences.

    A confidence is a word: a mantissa, here of a random length up to 24 bits, above 8 bits of shift.
    """
    c_function = c_code_function(c_library, "alpha_to_code")
    source = random.Random(6)
    for bits in range(1, MAX_ALPHA_BITS + 1):
        for _ in range(2000):
            bits_of_mantissa = source.randint(0, 24)
            mantissa = source.getrandbits(bits_of_mantissa)
            shift = source.getrandbits(8)
            alpha = (mantissa << 8) | shift

            assert c_function(alpha, bits) == encode_alpha(alpha, bits), (alpha, bits)
