"""Write the C source of a Python extension module that offers what C headers declare, by cffi.

CMake runs it as ``python build_native.py MODULE OUTPUT HEADER...``. The declarations for cffi are derived
from the headers, so that the two cannot differ. A construct in a header that this script does not know ends
the build with cffi's parse error.
"""

from __future__ import annotations

import re
import sys
from pathlib import Path

from cffi import FFI

_COMMENT = re.compile(r"/\*.*?\*/", re.DOTALL)
_CONTINUED_LINE = re.compile(r"\\\n")
_ONLY_CPLUSPLUS = re.compile(r"^#ifdef __cplusplus\n.*?^#endif\n", re.DOTALL | re.MULTILINE)
_CONSTANT = re.compile(r"^#define (MCP_ASDF_\w+) +([^\s{].*?)\s*$", re.MULTILINE)  # no initialisers
_DIRECTIVE = re.compile(r"^#.*$", re.MULTILINE)
_INLINE_FUNCTION = re.compile(r"(?:static inline|MCP_ASDF_INLINE) ([^{;]*?)\s*\{[^}]*\}")


def declarations(header: str) -> str:
    """Return the declarations for cffi of the constants, types and functions in the text of a header."""
    text = _CONTINUED_LINE.sub(" ", _COMMENT.sub("", header))
    text = _ONLY_CPLUSPLUS.sub("", text)
    constants = [
        _declare_constant(name, value) for name, value in _CONSTANT.findall(text) if re.search(r"\d", value)
    ]
    code = _INLINE_FUNCTION.sub(r"\1;", _DIRECTIVE.sub("", text))
    return "\n".join([*constants, code])


def _declare_constant(name: str, value: str) -> str:
    """Return the declaration of a macro whose value is a number.

    A decimal number is given to cffi, which needs the lengths of arrays; it asks the compiler for others.
    """
    return f"#define {name} {value if value.isdecimal() else '...'}"


def main() -> None:
    """Write the module's source, as the command line says."""
    module, output, *headers = sys.argv[1:]
    builder = FFI()
    for header in map(Path, headers):
        builder.cdef(declarations(header.read_text(encoding="utf-8")))
    builder.set_source(module, "\n".join(f'#include "{Path(header).name}"' for header in headers))
    builder.emit_c_code(output)


if __name__ == "__main__":
    main()
