/* One build of the firmware; VARIANT and the macros of its choices come from the command line. */
#define NAME(variant, name) PASTE(variant, name)
#define PASTE(variant, name) firmware_##variant##name

#define mcp_asdf_init NAME(VARIANT, _init)
#define mcp_asdf_observe NAME(VARIANT, _observe)
#define mcp_asdf_receive NAME(VARIANT, _receive)
#define mcp_asdf_settle NAME(VARIANT, _settle)
#define mcp_asdf_step NAME(VARIANT, _step)
#define mcp_asdf_x NAME(VARIANT, _x)
#define mcp_asdf_x_bar NAME(VARIANT, _x_bar)
#define mcp_asdf_invariants_hold NAME(VARIANT, _invariants_hold)
#define mcp_asdf_save NAME(VARIANT, _save)
#define mcp_asdf_restore NAME(VARIANT, _restore)
#include "mcp_asdf.c"

#include "mcp_asdf_image.c"

#include "variant.h"

#ifdef MISTAKE /* for the test of the fuzzer: rare, and in one variant */
static uint32_t wrong_x_bar(const mcp_asdf_t *robot)
{
    return mcp_asdf_x_bar(robot) + (MCP_ASDF_SHIFT_BYTES && robot->open.count == 3 && robot->n == 2);
}
#undef mcp_asdf_x_bar
#define mcp_asdf_x_bar wrong_x_bar
#endif

const firmware_t NAME(VARIANT, ) = {
    mcp_asdf_init, mcp_asdf_observe, mcp_asdf_receive,         mcp_asdf_settle, mcp_asdf_step,
    mcp_asdf_x,    mcp_asdf_x_bar,   mcp_asdf_invariants_hold, mcp_asdf_save,   mcp_asdf_restore};
