"""The one exception that the command line turns into a message and exit code 2."""

from collections.abc import Iterable

_LONGEST = 800
"""Characters of a message; of a longer one the middle is left out."""


class UsageError(ValueError):
    """A request that cannot be done as asked; the message names the value and the fix.

    It is one line, whatever others have written into it: white space becomes single spaces, other characters
    that do not print are escaped, and of a long one the middle is left out.
    """

    def __init__(self, message: str) -> None:
        line = " ".join(message.split())
        shown = "".join(char if char.isprintable() else _escape(char) for char in line)
        if len(shown) > _LONGEST:
            shown = f"{shown[: _LONGEST // 2]} ... {shown[-_LONGEST // 2 :]}"
        super().__init__(shown)


def offer(word: str, known: Iterable[str]) -> str:
    """Return a question that offers the nearest of the ``known`` words; an empty text if none is near."""
    from difflib import get_close_matches  # noqa: PLC0415 (only a mistake needs it)

    nearest_words = get_close_matches(word, list(known), n=1)
    return f"; did you mean {nearest_words[0]}?" if nearest_words else ""


def _escape(character: str) -> str:
    """Return a character that does not print as Python writes it in a text."""
    return character.encode("unicode_escape").decode("ascii")
