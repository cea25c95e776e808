/* A robot's state in a file, so that it goes on after a reset where it was. */
#ifndef MCP_ASDF_LINUX_IMAGE_H
#define MCP_ASDF_LINUX_IMAGE_H

#include "mcp_asdf_image.h"

typedef enum { IMAGE_OK, IMAGE_ABSENT, IMAGE_UNREADABLE, IMAGE_REFUSED, IMAGE_OF_ANOTHER } image_status_t;

/* Make a robot from the file. Fails if there is none (ABSENT), it cannot be read (UNREADABLE, errno tells
 * why), it is damaged or does not fit the config (REFUSED), or its robot has not the id `id` (OF_ANOTHER);
 * then *robot is unchanged. */
image_status_t image_load(const char *path, mcp_asdf_t *robot, const mcp_asdf_config_t *config, uint8_t id);

/* Write the file anew: a reader finds the old image or the new, even after a loss of power. Returns
 * 0, or what went wrong as an errno. */
int image_save(const char *path, const mcp_asdf_t *robot);

#endif
