/* A robot's state in a file, with which it goes on where it was after a restart. */
#ifndef MCP_ASDF_LINUX_STATE_H
#define MCP_ASDF_LINUX_STATE_H

#include "mcp_asdf_image.h"

/* Restore the robot from a file; if the file does not exist, the robot is unchanged. Returns NULL, or why the
 * file cannot be used: it cannot be read, is damaged, does not fit the config, or belongs to a robot with
 * another id. Then *robot is unchanged, too. */
const char *state_load(const char *path, mcp_asdf_t *robot, const mcp_asdf_config_t *config);

/* Save the robot in a file. Whoever reads the file finds the old state or the new one, even after a loss of
 * power; once this has returned 0, the new one. Returns 0 or an errno. */
int state_save(const char *path, const mcp_asdf_t *robot);

#endif
