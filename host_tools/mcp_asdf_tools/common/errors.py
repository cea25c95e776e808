"""The exception for requests that cannot be done, which the command line turns into exit code 2."""

from collections.abc import Iterable, Iterator
from contextlib import contextmanager

_MAX_LENGTH = 800
"""Maximum length of a message in characters."""


class UsageError(ValueError):
    """A request that cannot be done as asked; the message names the value and the fix.

    A message may quote anything, such as a hostile file, and is one line that can be printed all the same:
    white space becomes single spaces, other characters that do not print are escaped, and the middle of a
    message that is too long is replaced by dots.
    """

    def __init__(self, message: str) -> None:
        """Create the error, with ``message`` made one line that can be printed.

        The middle of a line of more than _MAX_LENGTH characters is left out.
        """
        line = " ".join(message.split())
        printable_characters = [char if char.isprintable() else _escape(char) for char in line]
        printable_line = "".join(printable_characters)
        if len(printable_line) > _MAX_LENGTH:
            half = _MAX_LENGTH // 2
            printable_line = f"{printable_line[:half]} ... {printable_line[-half:]}"
        super().__init__(printable_line)


@contextmanager
def refusing_wrong_values() -> Iterator[None]:
    """Context manager, or decorator, for code that reads JSON values: it fails with UsageError alone.

    The values may be of any JSON type and size, and an entry may be missing. A KeyError becomes a UsageError
    that says what is missing; an ArithmeticError, AttributeError, TypeError or ValueError becomes one with
    its text.
    """
    try:
        yield
    except KeyError as error:
        raise UsageError(f"{error} is missing; add it") from error
    except (ArithmeticError, AttributeError, TypeError, ValueError) as error:
        raise UsageError(str(error)) from error


def did_you_mean(word: str, known: Iterable[str]) -> str:
    """Return the end of a message about an unknown word: it asks whether a similar known one was meant.

    It is ``; did you mean robots?`` for ``robot``, and empty if no known word is similar.
    """
    from difflib import get_close_matches  # noqa: PLC0415 (only a mistake needs it)

    nearest_words = get_close_matches(word, list(known), n=1)
    return f"; did you mean {nearest_words[0]}?" if nearest_words else ""


def _escape(character: str) -> str:
    """Return a character as an escape sequence of Python, such as ``\\x1b``."""
    return character.encode("unicode_escape").decode("ascii")
