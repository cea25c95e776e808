"""The one exception that the command line turns into a message and exit code 2."""


class UsageError(ValueError):
    """A request that cannot be done as asked; the message names the value and the fix."""
