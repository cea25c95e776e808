"""The texts that give the bits of a message, and rounding to them."""

from __future__ import annotations

import pytest

from mcp_asdf.fixed_point import ONE, alpha_word_from_float
from mcp_asdf_tools.common.parameters import ParameterError
from mcp_asdf_tools.experiments.experiment import Experiment
from mcp_asdf_tools.experiments.message_codes import MessageCode, parse_message_bits


def test_the_text_exact_means_that_messages_are_not_rounded_and_is_the_default() -> None:
    """Messages that are not rounded have no code."""
    assert parse_message_bits("exact") is None
    assert Experiment().message_bits == "exact"
    assert Experiment().message_code is None


@pytest.mark.parametrize("text", ["1+1", "7+4", "16+9", "23+25"])
def test_a_code_of_messages_has_the_text_that_it_was_parsed_from(text: str) -> None:
    """In 7+4, x_hat has 7 bits of a message and its confidence alpha has 4."""
    assert str(parse_message_bits(text)) == text


@pytest.mark.parametrize(
    "text", ["", "16", "0+9", "24+9", "16+0", "16+26", "16+9+1", "-1+9", "1\uff16+9", "16 + 9"]
)
def test_a_text_that_is_no_code_of_messages_is_refused_with_the_limits_of_bits(text: str) -> None:
    """The error has the key of the parameter, by which a file or a command names it."""
    limits = "give the bits of x_hat, 1 to 23, and of alpha, 1 to 25"
    with pytest.raises(ParameterError, match=limits) as error:
        Experiment(message_bits=text)
    assert error.value.key == "message_bits"


def test_experiments_whose_message_codes_are_spelt_differently_are_equal() -> None:
    """A number of bits may have zeros in front."""
    assert Experiment(message_bits="07+04") == Experiment(message_bits="7+4")


def test_an_estimate_between_two_codes_is_rounded_to_the_nearest_and_alpha_is_rounded_down() -> None:
    """With two bits x_hat can be 0, 1/3, 2/3 or 1, so 0.4 becomes 1/3.

    With four bits alpha can be 1/2, 2, 8 and so on, so 7.9 becomes 2.
    """
    code = MessageCode(x_hat_bits=2, alpha_bits=4)

    # In the firmware, x_hat is a whole number of units, of which ONE are 1.0, and alpha a word of 32 bits.
    x_hat_units, alpha_word = code.round_raw(int(0.4 * ONE), alpha_word_from_float(7.9))
    x_hat, alpha = code.round_floats(0.4, 7.9)

    units_nearest_to_a_third = round(ONE / 3)
    assert x_hat_units == units_nearest_to_a_third
    assert alpha_word == alpha_word_from_float(2.0)
    assert x_hat == units_nearest_to_a_third / ONE
    assert alpha == 2.0
