/* The state's file; state.h is the manual. */
#include "state.h"

#include <errno.h>
#include <fcntl.h>
#include <limits.h>
#include <stdio.h>
#include <string.h>
#include <unistd.h>

/* Read to the end, at most so many bytes: a read may bring fewer than there are. Returns how many, or -1. */
static ssize_t read_file(int fd, uint8_t *bytes, size_t most)
{
    size_t filled = 0;
    ssize_t size = 1;
    while (size > 0 && filled < most) {
        size = read(fd, bytes + filled, most - filled);
        filled += size > 0 ? (size_t)size : 0;
    }
    return size < 0 ? -1 : (ssize_t)filled;
}

const char *state_load(const char *path, mcp_asdf_t *robot, const mcp_asdf_config_t *config)
{
    uint8_t image[MCP_ASDF_IMAGE_SIZE + 1];
    mcp_asdf_t loaded;
    const int fd = open(path, O_RDONLY | O_CLOEXEC);
    if (fd < 0) {
        return errno == ENOENT ? NULL : strerror(errno);
    }
    const ssize_t size = read_file(fd, image, sizeof image);
    const int error = errno;
    (void)close(fd);
    if (size < 0) {
        return strerror(error);
    }
    if (size != MCP_ASDF_IMAGE_SIZE || mcp_asdf_restore(&loaded, config, image) != MCP_ASDF_OK) {
        return "it is damaged, or does not fit the periods and the memory";
    }
    if (loaded.id != robot->id) {
        return "it is that of another robot";
    }
    *robot = loaded;
    return NULL;
}

static int write_file(const char *path, const uint8_t image[MCP_ASDF_IMAGE_SIZE])
{
    int error = 0;
    const int fd = open(path, O_WRONLY | O_CREAT | O_TRUNC | O_CLOEXEC, 0666);
    if (fd < 0) {
        return errno;
    }
    errno = ENOSPC; /* what a short write means */
    if (write(fd, image, MCP_ASDF_IMAGE_SIZE) != MCP_ASDF_IMAGE_SIZE || fsync(fd) != 0) {
        error = errno;
    }
    return close(fd) == 0 || error != 0 ? error : errno;
}

/* Put the names in the folder of `path`, which is cut, on the disk. What cannot be synced has nothing to
 * sync. */
static int sync_folder(char *path)
{
    char *slash = strrchr(path, '/');
    const char *folder = ".";
    if (slash != NULL) {
        slash[slash == path ? 1 : 0] = 0; /* "/" stays */
        folder = path;
    }
    const int fd = open(folder, O_RDONLY | O_DIRECTORY | O_CLOEXEC);
    if (fd < 0) {
        return errno;
    }
    const int error = fsync(fd) == 0 || errno == EINVAL ? 0 : errno;
    (void)close(fd);
    return error;
}

int state_save(const char *path, const mcp_asdf_t *robot)
{
    char temporary[PATH_MAX];
    uint8_t image[MCP_ASDF_IMAGE_SIZE];
    const int length = snprintf(temporary, sizeof temporary, "%s.new", path);
    if (length < 0 || (size_t)length >= sizeof temporary) {
        return ENAMETOOLONG;
    }
    mcp_asdf_save(robot, image);
    int error = write_file(temporary, image);
    if (error == 0 && rename(temporary, path) != 0) {
        error = errno;
    }
    if (error != 0) {
        (void)unlink(temporary);
        return error;
    }
    return sync_folder(temporary);
}
