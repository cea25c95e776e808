/* The Linux node's command line and stream of observations: whatever they hold, the program goes on with
 * settings that a node can have, or ends with its status for bad usage and one line. Nothing is read or
 * written: what the node calls of the system stands here. */
#include "input.h"

#include <errno.h>
#include <fcntl.h>
#include <poll.h>
#include <setjmp.h>
#include <stdarg.h>
#include <string.h>
#include <unistd.h>

static struct {
    jmp_buf end;
    int status;
    char said[512];
    input_t *stream;
} outside;

static void outside_exit(int status)
{
    outside.status = status;
    longjmp(outside.end, 1);
}

static int outside_print(FILE *to, const char *format, ...)
{
    va_list values;
    va_start(values, format);
    const int size = vsnprintf(outside.said, sizeof outside.said, format, values);
    va_end(values);
    return to == stderr ? size : 0;
}

/* Pieces of any size, with interruptions and failures between them. */
static ssize_t outside_read(int file, void *bytes, size_t size)
{
    const uint32_t wish = input_take(outside.stream, 1);
    size_t read = 0;
    if (wish >= 0xF0) {
        errno = wish == 0xF0 ? EIO : wish == 0xF1 ? EINTR : EAGAIN;
        return -1;
    }
    for (; read < size && read < wish && outside.stream->left > 0; ++read) {
        ((char *)bytes)[read] = (char)input_take(outside.stream, 1);
    }
    return file < 0 ? -1 : (ssize_t)read;
}

static int outside_poll(struct pollfd *files, nfds_t count, int timeout)
{
    MUST(count == 1 && timeout == 0);
    files->revents = POLLIN;
    return 1;
}

static int outside_open(const char *path, int flags, ...) { return path[0] == 0 ? -1 : 3 + (flags & 0); }

#define exit outside_exit
#define fprintf outside_print
#define printf(...) outside_print(stdout, __VA_ARGS__)
#define fputs(text, to) outside_print(to, "%s", text)
#define read outside_read
#define poll(files, count, timeout) outside_poll(files, count, timeout)
#define open outside_open
#define close(file) (file)

#include "linux/options.c"
#include "linux/source.c"

#undef fprintf

const uint32_t MCP_ASDF_NODE_TABLE[] = {0};

/* Options in short: a byte for each that is known, then text up to a zero; or any text by itself. */
static void any_command_line(input_t *in)
{
    static char texts[16][48], program[] = "mcp_asdf_node";
    char *arguments[17] = {program};
    int count = 1;
    for (int left = 1 + (int)(input_take(in, 1) & 15); left > 0 && count < 16; --left, ++count) {
        const uint32_t which = input_take(in, 1);
        size_t size = which < ALL ? (size_t)snprintf(texts[count], 24, "--%s=", table[which].name) : 0;
        for (char letter; size < sizeof texts[0] - 1 && (letter = (char)input_take(in, 1)) != 0; ++size) {
            texts[count][size] = letter;
        }
        size -= which >= WITH_ARGUMENT && which < ALL;
        texts[count][size] = 0;
        arguments[count] = texts[count];
    }
    options_t options;
    opterr = 0;
    optind = 0;
    outside.said[0] = 0;
    if (setjmp(outside.end) != 0) {
        MUST(outside.status == EXIT_USAGE || outside.status == EXIT_SUCCESS);
        const char *const line = strchr(outside.said, '\n');
        MUST(outside.status == EXIT_SUCCESS || outside.said[0] == 0 || line == NULL || line[1] == 0 ||
             memchr(texts, '\n', sizeof texts) != NULL);
        return;
    }
    options_read(&options, count, arguments);
    const node_settings_t *const node = &options.node;
    MUST(options.interface != NULL && node->id <= MCP_ASDF_MAX_ID);
    MUST(node->comms_period > 0 && node->filter_period % node->comms_period == 0);
    MUST(node->ticks_per_second >= 1 && node->ticks_per_second <= 1000);
    MUST(node->memory % 4 == 0 && node->memory >= MCP_ASDF_MEMORY_MIN && node->memory <= MCP_ASDF_MEMORY_MAX);
    MUST(node->b_hat >= MCP_ASDF_B_HAT_MIN && node->b_hat <= MCP_ASDF_B_HAT_MAX);
    MUST(node->filter <= MCP_ASDF_OFF);
    MUST(node->estimate.subject <= MCP_ASDF_SUBJECT_MAX && node->command.subject <= MCP_ASDF_SUBJECT_MAX);
}

/* The stream is used up, stops for good at a character that means nothing, and says which. */
static void any_stream(input_t *in)
{
    source_t source = {.path = "-", .is_sensor = (input_take(in, 1) & 1) != 0};
    mcp_asdf_action_t seen;
    outside.stream = in;
    MUST(source_open(&source) == 0);
    for (int tick = 0; tick < 300 && !source.has_ended && in->left > 0; ++tick) {
        const uint32_t missing = source.missing, taken = source.taken;
        const bool has_come = source_next(&source, &seen);
        MUST(seen == MCP_ASDF_OBSERVE_NONE || (has_come && seen <= MCP_ASDF_OBSERVE_BLACK));
        MUST(source.at <= source.filled && source.filled <= sizeof source.buffer);
        MUST(source.missing - missing == (!has_come && !source.has_ended ? 1U : 0U));
        MUST(!has_come || source.is_sensor || source.taken > taken);
        MUST(source.odd == 0 || (source.has_ended && strchr("01- \t\n\v\f\r", source.odd) == NULL));
    }
}

int LLVMFuzzerTestOneInput(const uint8_t *data, size_t size);
int LLVMFuzzerTestOneInput(const uint8_t *data, size_t size)
{
    input_t in = {data, size};
    if (input_take(&in, 1) & 1) {
        any_stream(&in);
    } else {
        any_command_line(&in);
    }
    return 0;
}
