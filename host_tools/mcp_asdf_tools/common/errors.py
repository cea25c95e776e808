"""The one exception that the command line turns into a message and exit code 2."""

from collections.abc import Iterable
from difflib import get_close_matches

_LONGEST = 800


class UsageError(ValueError):
    """A request that cannot be done as asked; the message names the value and the fix.

    It is one line, whatever others have written into it: white space becomes single spaces, other characters
    that do not print are escaped, and of a long one the middle is left out.
    """

    def __init__(self, message: str) -> None:
        shown = "".join(each if each.isprintable() else _escaped(each) for each in " ".join(message.split()))
        if len(shown) > _LONGEST:
            shown = f"{shown[: _LONGEST // 2]} ... {shown[-_LONGEST // 2 :]}"
        super().__init__(shown)


def offer(word: str, known: Iterable[str]) -> str:
    """A question that offers the nearest of the ``known`` words; nothing if none is near."""
    near = get_close_matches(word, list(known), n=1)
    return f"; did you mean {near[0]}?" if near else ""


def _escaped(character: str) -> str:
    return character.encode("unicode_escape").decode("ascii")
