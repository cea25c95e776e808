/* Files of the Linux node with three of the kernel's calls replaced, for what no test of the whole program
 * can make happen. Prints what is wrong; its argument is a folder. */
#include <errno.h>
#include <fcntl.h>
#include <poll.h>
#include <stdio.h>
#include <string.h>
#include <unistd.h>

static char order[8]; /* f: fsync(), r: rename() */
static int sync_error, read_error;

static int noted_sync(int file)
{
    (void)file;
    (void)strcat(order, "f");
    errno = sync_error;
    return sync_error == 0 ? 0 : -1;
}

static int noted_rename(const char *from, const char *to)
{
    (void)strcat(order, "r");
    return rename(from, to);
}

static ssize_t interrupted_read(int file, void *to, size_t size)
{
    const int error = read_error;
    read_error = 0;
    errno = error;
    return error == 0 ? read(file, to, size) : -1;
}

#define fsync noted_sync
#define rename noted_rename
#define read interrupted_read
#include "linux/image.c"
#include "linux/source.c"

extern const uint32_t mcp_asdf_t_table_omega05_q30[];

static int is_wrong;

static void must(int is_right, const char *what)
{
    if (!is_right) {
        is_wrong = 1;
        (void)puts(what);
    }
}

static void saving(const char *path)
{
    const mcp_asdf_config_t config = MCP_ASDF_CONFIG(mcp_asdf_t_table_omega05_q30);
    mcp_asdf_t robot, loaded;
    must(mcp_asdf_init(&robot, &config, 5, UINT32_C(0xC0000000)) == MCP_ASDF_OK, "a robot is made");
    must(image_save(path, &robot) == 0, "an image is saved");
    must(strcmp(order, "fr") == 0, "it reaches the disk before it takes its name");
    must(mcp_asdf_observe(&robot, MCP_ASDF_BLACK) == MCP_ASDF_OK, "the robot goes on");
    order[0] = '\0';
    sync_error = EIO;
    must(image_save(path, &robot) == EIO, "a disk that fails is told");
    must(strcmp(order, "f") == 0, "the image of before stays");
    must(image_load(path, &loaded, &config, 5) == IMAGE_OK && mcp_asdf_t_count(&loaded) == 0, "as it was");
}

static void reading(const char *path)
{
    source_t source = {.path = path, .robots = 1};
    mcp_asdf_action_t seen[SOURCE_MOST_ROBOTS];
    FILE *file = fopen(path, "w");
    must(file != NULL && fputs("1", file) >= 0 && fclose(file) == 0, "observations are written");
    must(source_open(&source) == 0, "observations are opened");
    read_error = EINTR;
    must(!source_next(&source, seen) && !source.has_ended, "a signal does not end the observations");
    must(source_next(&source, seen) && seen[0] == MCP_ASDF_OBSERVE_BLACK, "they go on after it");
    read_error = EIO;
    must(!source_next(&source, seen) && source.has_ended, "a failure ends them");
}

int main(int count, char *arguments[])
{
    char state[4096], observations[4096];
    must(count == 2, "the argument is a folder");
    (void)snprintf(state, sizeof state, "%s/state", arguments[1]);
    (void)snprintf(observations, sizeof observations, "%s/observations", arguments[1]);
    saving(state);
    reading(observations);
    return is_wrong;
}
