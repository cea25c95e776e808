/* A robot's state in a file, so that it goes on after a reset where it was. */
#ifndef MCP_ASDF_LINUX_STATE_H
#define MCP_ASDF_LINUX_STATE_H

#include "mcp_asdf_image.h"

/* Make a robot from the file; one that does not exist leaves it new. Returns NULL, or why it cannot be used:
 * it cannot be read, is damaged, does not fit the config, or is that of another robot than `robot`. Then
 * *robot is unchanged. */
const char *state_load(const char *path, mcp_asdf_t *robot, const mcp_asdf_config_t *config);

/* Write the file anew: a reader finds the old image or the new, even after a loss of power, and once this has
 * returned 0 the new. Returns 0, or what went wrong as an errno. */
int state_save(const char *path, const mcp_asdf_t *robot);

#endif
