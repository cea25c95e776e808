"""The texts that give the bits of a message, and rounding to them."""

from __future__ import annotations

import pytest

from mcp_asdf.fixed_point import HALF, ONE, alpha_word_from_float
from mcp_asdf_tools.common.parameters import ParameterError
from mcp_asdf_tools.experiments.experiment import Experiment
from mcp_asdf_tools.experiments.message_codes import MessageCode, parse_message_bits


def test_exact_messages_are_not_rounded() -> None:
    assert parse_message_bits("exact") is None


@pytest.mark.parametrize("text", ["1+1", "7+4", "16+9", "23+25"])
def test_a_code_has_the_text_that_it_was_read_from(text: str) -> None:
    assert str(parse_message_bits(text)) == text


@pytest.mark.parametrize(
    "text", ["", "16", "0+9", "24+9", "16+0", "16+26", "16+9+1", "-1+9", "1\uff16+9", "16 + 9"]
)
def test_other_texts_are_refused_with_the_limits(text: str) -> None:
    with pytest.raises(
        ParameterError, match=r"give the bits of x_hat, 1 to 23, and of alpha, 1 to 25"
    ) as error:
        Experiment(message_bits=text)
    assert error.value.key == "message_bits"


def test_experiments_with_the_same_code_are_equal() -> None:
    assert Experiment(message_bits="07+04") == Experiment(message_bits="7+4")


def test_messages_are_exact_by_default() -> None:
    assert Experiment().message_code is None


def test_numbers_between_two_codes_are_rounded() -> None:
    """x_hat of two bits is the nearest of 0, 1/3, 2/3 and 1; alpha of four bits is cut to 1/2, 2, 8 ..."""
    code = MessageCode(x_hat_bits=2, alpha_bits=4)

    x_hat, alpha = code.round_raw(int(0.4 * ONE), alpha_word_from_float(7.9))

    assert x_hat == round(ONE / 3)
    assert alpha == alpha_word_from_float(2.0)


def test_floats_are_rounded_likewise() -> None:
    assert MessageCode(x_hat_bits=2, alpha_bits=4).round_floats(0.4, 7.9) == (round(ONE / 3) / ONE, 2.0)


def test_an_estimate_of_one_half_becomes_the_larger_of_two_codes() -> None:
    assert MessageCode(x_hat_bits=1, alpha_bits=1).round_raw(HALF, 0) == (ONE, 0)
