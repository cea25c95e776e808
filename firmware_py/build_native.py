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
    """Return what a C header declares, its constants, types and functions, as text that cffi can parse.

    cffi knows no preprocessor. So comments and directives are left out, constants that are numbers are
    declared in cffi's own form, and inline functions lose their bodies.
    """
    text = _CONTINUED_LINE.sub(" ", _COMMENT.sub("", header))
    text = _ONLY_CPLUSPLUS.sub("", text)
    constants = []
    for name, value in _CONSTANT.findall(text):
        is_number = re.search(r"\d", value) is not None  # other macros have no digit in their value
        if is_number:
            constants.append(_declare_constant(name, value))
    text_without_directives = _DIRECTIVE.sub("", text)
    code = _INLINE_FUNCTION.sub(r"\1;", text_without_directives)  # \1 is the head of the function
    return "\n".join([*constants, code])


def _declare_constant(name: str, value: str) -> str:
    """Return cffi's declaration of a macro whose value is a number.

    It states a decimal value, which cffi needs where it is the length of an array, without C's suffix for an
    unsigned number. For any other value it has dots, so that cffi asks the compiler.
    """
    number = value.removesuffix("U")
    declared_value = number if number.isdecimal() else "..."
    return f"#define {name} {declared_value}"


def main() -> None:
    """Write the C source of an extension module from the headers that the command line names.

    The arguments are the module's name, the file to write and the paths of the headers. The module offers all
    that the headers declare. A compiler that builds it finds the headers by their names without a folder.
    """
    module, output, *header_arguments = sys.argv[1:]
    headers = [Path(argument) for argument in header_arguments]
    includes = [f'#include "{header.name}"' for header in headers]
    builder = FFI()
    # cffi parses the declarations to write the wrappers; the compiler reads the headers themselves.
    for header in headers:
        builder.cdef(declarations(header.read_text(encoding="utf-8")))
    builder.set_source(module, "\n".join(includes))
    builder.emit_c_code(output)


if __name__ == "__main__":
    main()
