/* Source of a robot's observations: a stream that is read on, or a sensor's file that is read anew in every
 * tick. */
#ifndef MCP_ASDF_LINUX_SOURCE_H
#define MCP_ASDF_LINUX_SOURCE_H

#include "mcp_asdf_frame.h"

#include <stdbool.h>
#include <stddef.h>

/* A source. The caller sets the first two members, and 0 for all else; then it calls source_open().
 *   path                of the file; "-": the standard input
 *   is_sensor           read anew in every tick, as a GPIO's value file: "0" is white and "1" black, and what
 *                       follows is ignored. Otherwise a stream of 0 (white), 1 (black) and - (no
 *                       observation); white space is ignored
 *   has_ended           whether the stream has come to its end, or stopped as below
 *   is_invalid          whether the next character of the stream is none of these; the stream stops before it
 *   characters_read     characters of the stream used so far, white space included
 *   missing             ticks without an observation: the stream had none ready, the sensor could not be read
 *   error               errno of a failed read of the stream, or 0; the stream stops there
 *   fd                  of the stream
 *   next_index          position of the next character in the buffer
 *   buffer_length       characters in the buffer */
typedef struct {
    const char *path;
    bool is_sensor;
    bool has_ended, is_invalid;
    uint32_t characters_read, missing;
    int error, fd;
    size_t next_index, buffer_length;
    char buffer[256];
} source_t;

/* Open the source. Returns 0 or an errno. */
int source_open(source_t *source);

/* Read the observation of the tick that begins, without waiting: MCP_ASDF_OBSERVE_WHITE, BLACK or NONE.
 * Returns whether there was one; if not, *observation is NONE, and counts as missing unless the stream has
 * ended. */
bool source_next(source_t *source, mcp_asdf_action_t *observation);

#endif
