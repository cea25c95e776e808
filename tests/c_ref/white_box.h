/* What the white-box tests share: the core itself, with its static functions in reach. Expected values come
 * from formulas of docs/design.md, computed plainly in the widest type at hand, never from the core. */
#ifndef WHITE_BOX_H
#define WHITE_BOX_H

#include "check.h"

#if MCP_ASDF_DIVIDE == 4 /* the engine's own */
#include "lanes_arithmetic.h"
#endif
#include "mcp_asdf.c"

#endif
