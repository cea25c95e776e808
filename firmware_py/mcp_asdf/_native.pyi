"""The compiled C firmware, with its functions and types as cffi offers them.

``build_native.py`` generates its source from ``mcp_asdf.h``.
"""

from typing import Any

ffi: Any
lib: Any
