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

/* Opened again each time: a file that was replaced is a new one. Here and below MCP_ASDF_SETTLE, which no one
 * sees, stands for no observation that has come. */
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
    return colour == '0' ? MCP_ASDF_OBSERVE_WHITE : MCP_ASDF_SETTLE;
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
    source->error = size < 0 && errno != EINTR && errno != EAGAIN ? errno : 0;
    source->has_ended = size == 0 || source->error != 0;
    source->at = 0;
    source->filled = size > 0 ? (size_t)size : 0;
    return size > 0;
}

static mcp_asdf_action_t take(source_t *source)
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
            return (mcp_asdf_action_t)(found - symbols);
        }
    }
    return MCP_ASDF_SETTLE;
}

bool source_next(source_t *source, mcp_asdf_action_t *seen)
{
    *seen = source->is_sensor ? sense(source) : take(source);
    const bool has_come = *seen != MCP_ASDF_SETTLE;
    if (!has_come) {
        *seen = MCP_ASDF_OBSERVE_NONE;
        source->missing += !source->has_ended;
    }
    return has_come;
}
