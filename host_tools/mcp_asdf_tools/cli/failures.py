"""How a command reports on standard error that it failed: one line of text or, with --json, of JSON."""

from __future__ import annotations

import json
import sys


def report_failure(title: str, message: str, as_json: bool, exit_code: int = 1) -> int:
    """Print ``message`` for the command ``title``, such as "mcp-asdf node", and return ``exit_code``."""
    if as_json:
        line = json.dumps({"command": title, "error": message, "exit_code": exit_code})
    else:
        line = f"{title}: {message}"
    print(line, file=sys.stderr, flush=True)
    return exit_code
