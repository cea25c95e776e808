/* Save a robot across a reset, restore it, and check its memory. Optional: the method of mcp_asdf.h does not
 * use it. */
#ifndef MCP_ASDF_IMAGE_H
#define MCP_ASDF_IMAGE_H

#include "mcp_asdf.h"

#ifdef __cplusplus
extern "C" {
#endif

#define MCP_ASDF_IMAGE_VERSION 3U
/* Room for any image, in every build. A robot with the robust filter fills all of it, one with another filter
 * the first MCP_ASDF_ASDF_IMAGE_SIZE bytes. */
#define MCP_ASDF_IMAGE_SIZE 156
#define MCP_ASDF_ASDF_IMAGE_SIZE 124

/* Write the robot's state to an image: little-endian, the same on every target, with version and checksum.
 * Bytes that are not used are not touched. O(1). Needs a copy of the robot on the stack
 * (docs/internals/cost.md has the bytes). */
void mcp_asdf_save(const mcp_asdf_t *robot, uint8_t image[MCP_ASDF_IMAGE_SIZE]);

/* Make a robot from an image; it goes on as the saved one would have, bit for bit. O(q) for the table. Needs
 * two copies of the robot on the stack. Fails as init does for config and table (ERR_CONFIG, ERR_TABLE), and
 * if the image is damaged, of another version, or does not fit the config's filter_period and memory
 * (ERR_IMAGE). An image of a robot with the robust filter fits only such a robot, and the other way round. On
 * failure *robot is unchanged. */
mcp_asdf_status_t mcp_asdf_restore(mcp_asdf_t *robot, const mcp_asdf_config_t *config,
                                   const uint8_t image[MCP_ASDF_IMAGE_SIZE]);

/* Whether the state could have come from calls of these functions (docs/internals/properties.md): false after
 * a stray write or a bit flip that breaks a relation between members. Forms x_hat and alpha again from t, n
 * and b_hat to compare them, unless b_hat was updated since the last observation. O(1), writes nothing; any
 * memory contents are safe but a damaged config pointer. Needs a copy of the robot on the stack. */
bool mcp_asdf_invariants_hold(const mcp_asdf_t *robot);

#ifdef __cplusplus
}
#endif

#endif
