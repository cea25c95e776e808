"""The one exception that the command line turns into a message and exit code 2."""

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


def _escaped(character: str) -> str:
    return character.encode("unicode_escape").decode("ascii")
