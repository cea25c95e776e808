"""Messages of errors are one printable line, even if they quote unprintable text."""

from __future__ import annotations

import pytest

from mcp_asdf_tools.common.errors import UsageError, did_you_mean


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("cannot read a\n\t file; fix it", "cannot read a file; fix it"),
        ("cannot read \x1b[2J\ud800", "cannot read \\x1b[2J\\ud800"),
    ],
)
def test_a_message_has_single_spaces_and_characters_that_do_not_print_are_escaped(
    text: str, message: str
) -> None:
    """A message may quote any file. It stays one line, so that the file cannot control the terminal."""
    assert str(UsageError(text)) == message


def test_the_middle_of_a_message_of_more_than_800_characters_is_left_out() -> None:
    """The first 400 and the last 400 characters are shown, so that the fix at its end stays in sight."""
    message = str(UsageError("cannot read a" + "9" * 5000 + "; fix it"))
    first_400, last_400 = "cannot read a".ljust(400, "9"), "; fix it".rjust(400, "9")
    assert message == f"{first_400} ... {last_400}"
    assert str(UsageError("9" * 800)) == "9" * 800


@pytest.mark.parametrize(
    ("word", "hint"), [("robot", "; did you mean robots?"), ("speeed", "; did you mean speed?"), ("xyz", "")]
)
def test_the_nearest_known_word_is_offered(word: str, hint: str) -> None:
    """The user has mistyped one of the words robots and speed, or none."""
    assert did_you_mean(word, ["robots", "speed"]) == hint
