"""Messages of errors are one printable line, whatever they quote."""

from __future__ import annotations

import pytest

from mcp_asdf_tools.common.errors import UsageError, did_you_mean


def test_white_space_in_a_message_becomes_single_spaces() -> None:
    assert str(UsageError("cannot read a\n\t file; fix it")) == "cannot read a file; fix it"


def test_characters_that_do_not_print_are_escaped() -> None:
    assert str(UsageError("cannot read \x1b[2J\ud800")) == "cannot read \\x1b[2J\\ud800"


def test_a_message_of_800_characters_is_kept() -> None:
    assert str(UsageError("9" * 800)) == "9" * 800


def test_the_middle_of_a_longer_message_is_left_out() -> None:
    message = str(UsageError("cannot read a" + "9" * 5000 + "; fix it"))
    assert message == "cannot read a" + "9" * 387 + " ... " + "9" * 392 + "; fix it"


@pytest.mark.parametrize(
    ("word", "hint"), [("robot", "; did you mean robots?"), ("speeed", "; did you mean speed?"), ("xyz", "")]
)
def test_the_nearest_known_word_is_offered(word: str, hint: str) -> None:
    assert did_you_mean(word, ["robots", "speed"]) == hint
