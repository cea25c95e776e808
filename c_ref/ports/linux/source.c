/* Reading observations; source.h is the manual. */
#include "source.h"

#include <ctype.h>
#include <errno.h>
#include <fcntl.h>
#include <poll.h>
#include <string.h>
#include <unistd.h>

/* What read_sensor() and read_stream() return if they cannot read an observation. It is the one action that
 * is no observation. MCP_ASDF_OBSERVE_NONE is another case: the stream says that the robot has seen nothing.
 */
#define NOTHING_READ MCP_ASDF_SETTLE

/* Open the stream, or see whether the sensor's file can be opened. Returns 0 or an errno. */
int source_open(source_t *source)
{
    const bool is_standard_input = strcmp(source->path, "-") == 0 && !source->is_sensor;
    source->fd = is_standard_input ? STDIN_FILENO : open(source->path, O_RDONLY | O_CLOEXEC);
    return source->fd < 0 ? errno : 0;
}

/* Returns the observation that '0', '1' or '-' stands for. */
static mcp_asdf_action_t action_of_character(char character)
{
    if (character == '-') {
        return MCP_ASDF_OBSERVE_NONE;
    }
    return character == '1' ? MCP_ASDF_OBSERVE_BLACK : MCP_ASDF_OBSERVE_WHITE;
}

/* Read the sensor's file: white or black, or NOTHING_READ if it cannot be read or contains neither. */
static mcp_asdf_action_t read_sensor(const source_t *source)
{
    char colour = 0; /* neither of the two, until one is read */
    /* Opened again in every tick, so that a file which has been replaced is read. */
    const int fd = open(source->path, O_RDONLY | O_CLOEXEC | O_NONBLOCK);
    if (fd >= 0) {
        if (read(fd, &colour, 1) != 1) {
            colour = 0;
        }
        (void)close(fd);
    }
    return colour == '0' || colour == '1' ? action_of_character(colour) : NOTHING_READ;
}

/* Read more of the stream if the buffer has no character left, but do not wait for it. Returns whether the
 * buffer has a character now. Sets has_ended at the end of the stream and after an error, and then error. */
static bool fill_buffer(source_t *source)
{
    struct pollfd input = {.fd = source->fd, .events = POLLIN};
    if (source->next_index < source->buffer_length) {
        return true;
    }
    const int no_wait = 0; /* milliseconds */
    if (source->has_ended || poll(&input, 1, no_wait) <= 0) {
        return false;
    }
    const ssize_t size = read(source->fd, source->buffer, sizeof source->buffer);
    const bool has_failed = size < 0 && errno != EINTR && errno != EAGAIN; /* these two: try again later */
    source->error = has_failed ? errno : 0;
    source->has_ended = size == 0 || has_failed;
    source->next_index = 0;
    source->buffer_length = size > 0 ? (size_t)size : 0;
    return size > 0;
}

/* Read the next observation of the stream, after any white space: white (0), black (1) or that there is none
 * (-). Returns NOTHING_READ if no character is ready, at the end of the stream, and before any other
 * character, for which is_invalid and has_ended are set. */
static mcp_asdf_action_t read_stream(source_t *source)
{
    while (!source->is_invalid && fill_buffer(source)) {
        const char character = source->buffer[source->next_index];
        const bool is_white_space = isspace((unsigned char)character) != 0;
        if (character != '0' && character != '1' && character != '-' && !is_white_space) {
            source->is_invalid = true;
            source->has_ended = true;
            return NOTHING_READ;
        }
        ++source->next_index;
        ++source->characters_read;
        if (!is_white_space) {
            return action_of_character(character);
        }
    }
    return NOTHING_READ;
}

/* Read an observation from the sensor or the stream. Returns false if none can be read; *observation is then
 * MCP_ASDF_OBSERVE_NONE, and counts as missing unless the stream has ended. */
bool source_next(source_t *source, mcp_asdf_action_t *observation)
{
    *observation = source->is_sensor ? read_sensor(source) : read_stream(source);
    const bool is_read = *observation != NOTHING_READ;
    if (!is_read) {
        *observation = MCP_ASDF_OBSERVE_NONE;
        if (!source->has_ended) {
            ++source->missing;
        }
    }
    return is_read;
}
