/* Reading observations; source.h is the manual. */
#include "source.h"

#include <ctype.h>
#include <errno.h>
#include <fcntl.h>
#include <poll.h>
#include <string.h>
#include <unistd.h>

int source_open(source_t *source)
{
    const bool is_standard = strcmp(source->path, "-") == 0 && !source->is_sensor;
    source->fd = is_standard ? STDIN_FILENO : open(source->path, O_RDONLY | O_CLOEXEC);
    return source->fd < 0 ? errno : 0;
}

/* Opened again each time: a file that was replaced is a new one. */
static mcp_asdf_action_t sense(source_t *source)
{
    char colour = 0;
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
    return colour == '0' ? MCP_ASDF_OBSERVE_WHITE : MCP_ASDF_OBSERVE_NONE;
}

/* Make sure that the buffer has a character, if that needs no waiting. */
static bool fill(source_t *source)
{
    struct pollfd input = {.fd = source->fd, .events = POLLIN};
    if (source->at < source->filled) {
        return true;
    }
    if (source->has_ended || poll(&input, 1, 0) <= 0) {
        return false;
    }
    const ssize_t size = read(source->fd, source->buffer, sizeof source->buffer);
    source->has_ended = size == 0 || (size < 0 && errno != EINTR && errno != EAGAIN);
    source->at = 0;
    source->filled = size > 0 ? (size_t)size : 0;
    return size > 0;
}

static bool take(source_t *source, mcp_asdf_action_t *seen)
{
    static const char symbols[] = "01-"; /* at the places of mcp_asdf_action_t */
    while (source->odd == 0 && fill(source)) {
        const char symbol = source->buffer[source->at];
        const char *found = symbol == 0 ? NULL : strchr(symbols, symbol);
        if (found == NULL && isspace((unsigned char)symbol) == 0) {
            source->odd = symbol;
            source->has_ended = true;
            break;
        }
        ++source->at;
        ++source->taken;
        if (found != NULL) {
            *seen = (mcp_asdf_action_t)(found - symbols);
            return true;
        }
    }
    return false;
}

static bool take_row(source_t *source)
{
    while (source->in_row < source->robots && take(source, &source->row[source->in_row])) {
        ++source->in_row;
    }
    return source->in_row == source->robots;
}

bool source_next(source_t *source, mcp_asdf_action_t seen[SOURCE_MOST_ROBOTS])
{
    bool has_come;
    if (source->is_sensor) {
        source->row[0] = sense(source);
        has_come = source->row[0] != MCP_ASDF_OBSERVE_NONE;
    } else {
        has_come = take_row(source);
    }
    for (unsigned i = 0; i < source->robots; ++i) {
        seen[i] = has_come ? source->row[i] : MCP_ASDF_OBSERVE_NONE;
    }
    if (has_come) {
        source->in_row = 0;
    }
    source->missing += !has_come && !source->has_ended;
    return has_come;
}
