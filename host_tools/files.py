"""Writing output files so that a reader never meets half of one."""

from __future__ import annotations

import os
import secrets
from contextlib import suppress
from pathlib import Path

from host_tools.errors import UsageError


def write_atomically(path: Path | str, data: bytes | str) -> None:
    """Write ``data`` (text as UTF-8) to ``path``, whole or not at all.

    The data goes to a temporary name in the same folder, which then takes the place of ``path``; a
    symbolic link is followed. Raises UsageError if ``path`` is a folder or a device, or cannot be
    written; whatever stood there before is then unchanged.
    """
    target = Path(path).resolve()
    if target.exists() and not target.is_file():
        raise UsageError(f"cannot write {path}: it is not a regular file; choose another name")
    temporary = target.with_name(f".{target.name}.{secrets.token_hex(4)}.tmp")
    try:
        temporary.write_bytes(data.encode() if isinstance(data, str) else data)
        os.replace(temporary, target)
    except OSError as error:
        raise UsageError(
            f"cannot write {path}: {error.strerror}; choose a folder you may write to"
        ) from error
    finally:
        with suppress(OSError):
            temporary.unlink()
