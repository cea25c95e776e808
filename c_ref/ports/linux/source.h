/* Where observations come from: a stream that is read on, or a file that is read anew in every tick. */
#ifndef MCP_ASDF_LINUX_SOURCE_H
#define MCP_ASDF_LINUX_SOURCE_H

#include "mcp_asdf_frame.h"

#include <stdbool.h>
#include <stddef.h>

/*   path        of the file; "-": the standard input
 *   is_sensor   read anew in every tick, as a GPIO's value file: "0" is white and "1" black, and what follows
 *               is ignored. Otherwise a stream of 0 (white), 1 (black) and - (nothing seen); white space is
 *               ignored
 *   has_ended   a stream has come to its end
 *   odd         a character of a stream that is none of these, or 0; the stream stops before it
 *   error       what a read of the stream failed with, as an errno, or 0; the stream stops there
 *   taken       characters of the stream used so far
 *   missing     ticks without an observation: the stream had none ready, the sensor could not be read */
typedef struct {
    const char *path;
    bool is_sensor;
    bool has_ended;
    char odd;
    uint32_t taken, missing;
    int error, fd;
    size_t at, filled;
    char buffer[256];
} source_t;

/* Returns 0, or what went wrong as an errno. */
int source_open(source_t *source);

/* Take the observation of the tick that begins, MCP_ASDF_OBSERVE_WHITE, BLACK or NONE; returns whether one
 * has come, else it is NONE. Does not wait. */
bool source_next(source_t *source, mcp_asdf_action_t *seen);

#endif
