/* Where observations come from: a stream that is read on, or a file that is read anew in every tick. */
#ifndef MCP_ASDF_LINUX_SOURCE_H
#define MCP_ASDF_LINUX_SOURCE_H

#include "mcp_asdf.h"
#include "mcp_asdf_frame.h"

#include <stdbool.h>
#include <stddef.h>

#define SOURCE_MOST_ROBOTS (MCP_ASDF_MAX_ID + 1)

/*   path        of the file; "-": the standard input
 *   robots      that observe in each tick, at most SOURCE_MOST_ROBOTS; with a sensor one
 *   is_sensor   read anew in every tick, as a GPIO's value file: "0" is white and "1" black, and what follows
 *               is ignored. Otherwise a stream of 0 (white), 1 (black) and - (nothing seen); white space is
 *               ignored
 *   has_ended   a stream has come to its end
 *   odd         a character of a stream that is none of these, or 0; the stream stops before it
 *   taken       characters of the stream used so far
 *   missing     ticks without observations: the stream had less than a row ready, the sensor could not be
 * read row         of observations, one a robot, of which the first `in_row` have come */
typedef struct {
    const char *path;
    unsigned robots;
    bool is_sensor;
    bool has_ended;
    char odd;
    uint32_t taken, missing;
    mcp_asdf_action_t row[SOURCE_MOST_ROBOTS];
    unsigned in_row;
    int fd;
    size_t at, filled;
    char buffer[256];
} source_t;

/* Returns 0, or what went wrong as an errno. */
int source_open(source_t *source);

/* Take the observations of the tick that begins, MCP_ASDF_OBSERVE_WHITE, BLACK or NONE for each robot;
 * returns whether they had come, else all are NONE. A row that has come in part waits for its rest, so that
 * no robot gets another's. Does not wait. */
bool source_next(source_t *source, mcp_asdf_action_t seen[SOURCE_MOST_ROBOTS]);

#endif
