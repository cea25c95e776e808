/* Reading observations; source.h is the manual. */
#include "source.h"

#include <ctype.h>
#include <errno.h>
#include <fcntl.h>
#include <poll.h>
#include <string.h>
#include <unistd.h>

/* What read_sensor() and read_stream() return if there is no observation: an action that none is. */
#define NOTHING_READ MCP_ASDF_SETTLE

/* Open the stream, or see whether the sensor's file can be opened. Returns 0 or an errno. */
int source_open(source_t *source)
{
    const bool is_standard_input = strcmp(source->path, "-") == 0 && !source->is_sensor;
    source->fd = is_standard_input ? STDIN_FILENO : open(source->path, O_RDONLY | O_CLOEXEC);
    return source->fd < 0 ? errno : 0;
}

/* Read the sensor's file: white or black, or NOTHING_READ if it cannot be read or contains neither. */
static mcp_asdf_action_t read_sensor(const source_t *source)
{
    char colour = 0;
    /* Opened again in every tick, so that a file which has been replaced is read. */
    const int fd = open(source->path, O_RDONLY | O_CLOEXEC | O_NONBLOCK);
    if (fd >= 0) {
        if (read(fd, &colour, 1) != 1) {
            colour = 0;
        }
        (void)close(fd);
    }
    if (colour == '1') {
        return MCP_ASDF_OBSERVE_BLACK;
    }
    return colour == '0' ? MCP_ASDF_OBSERVE_WHITE : NOTHING_READ;
}

/* Make sure that the buffer has a character to read, but do not wait for one. Returns whether it has. Notes
 * the end of the stream, and errors. */
static bool fill_buffer(source_t *source)
{
    struct pollfd input = {.fd = source->fd, .events = POLLIN};
    if (source->next_index < source->buffer_length) {
        return true;
    }
    if (source->has_ended || poll(&input, 1, 0) <= 0) {
        return false;
    }
    const ssize_t size = read(source->fd, source->buffer, sizeof source->buffer);
    source->error = size < 0 && errno != EINTR && errno != EAGAIN ? errno : 0;
    source->has_ended = size == 0 || source->error != 0;
    source->next_index = 0;
    source->buffer_length = size > 0 ? (size_t)size : 0;
    return size > 0;
}

/* Read the next observation of the stream: white, black or none, or NOTHING_READ if no character is ready. An
 * invalid character is noted, and ends the stream. */
static mcp_asdf_action_t read_stream(source_t *source)
{
    static const char symbols[] = "01-"; /* the index of a symbol is its mcp_asdf_action_t */
    while (source->invalid_character == 0 && fill_buffer(source)) {
        const char character = source->buffer[source->next_index];
        /* strchr() would find a character 0 at the end of the symbols. */
        const char *symbol = character == 0 ? NULL : strchr(symbols, character);
        if (symbol == NULL && isspace((unsigned char)character) == 0) {
            source->invalid_character = character;
            source->has_ended = true;
            break;
        }
        ++source->next_index;
        ++source->characters_read;
        if (symbol != NULL) {
            return (mcp_asdf_action_t)(symbol - symbols);
        }
    }
    return NOTHING_READ;
}

/* Read an observation from the sensor or the stream. Returns false if there is none. */
bool source_next(source_t *source, mcp_asdf_action_t *observation)
{
    *observation = source->is_sensor ? read_sensor(source) : read_stream(source);
    const bool is_read = *observation != NOTHING_READ;
    if (!is_read) {
        *observation = MCP_ASDF_OBSERVE_NONE;
        source->missing += !source->has_ended;
    }
    return is_read;
}
