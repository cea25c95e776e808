"""Messages of errors are one printable line, even if they quote unprintable text."""

from __future__ import annotations

import pytest

from mcp_asdf_tools.common.errors import UsageError, did_you_mean


@pytest.mark.parametrize(
    ("text", "expected_message"),
    [
        ("cannot read a\n\t file; fix it", "cannot read a file; fix it"),
        ("cannot read \x1b[2J\ud800", "cannot read \\x1b[2J\\ud800"),
    ],
)
def test_a_message_has_single_spaces_and_characters_that_do_not_print_are_escaped(
    text: str, expected_message: str
) -> None:
    """A message may quote any file. It stays one line, so that the file cannot control the terminal."""
    assert str(UsageError(text)) == expected_message


def test_the_middle_of_a_message_of_more_than_800_characters_is_left_out() -> None:
    """The first 400 and the last 400 characters are shown, so that the fix at its end stays in sight.

    A message of exactly 800 characters is shown as it is.
    """
    first_400_characters = "cannot read a".ljust(400, "9")
    last_400_characters = "; fix it".rjust(400, "9")
    too_long_message = first_400_characters + "9" * 4000 + last_400_characters
    assert str(UsageError(too_long_message)) == f"{first_400_characters} ... {last_400_characters}"

    message_of_800_characters = first_400_characters + last_400_characters
    assert str(UsageError(message_of_800_characters)) == message_of_800_characters


@pytest.mark.parametrize(
    ("mistyped_word", "expected_hint"),
    [("robot", "; did you mean robots?"), ("speeed", "; did you mean speed?"), ("xyz", "")],
)
def test_the_nearest_known_word_is_offered(mistyped_word: str, expected_hint: str) -> None:
    """For "robot" the hint is "; did you mean robots?". No known word is near "xyz", so its hint is empty."""
    known_words = ["robots", "speed"]
    assert did_you_mean(mistyped_word, known_words) == expected_hint
