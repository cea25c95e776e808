/* The state's file; state.h is the manual. */
#include "state.h"

#include <errno.h>
#include <fcntl.h>
#include <limits.h>
#include <stdio.h>
#include <string.h>
#include <unistd.h>

/* Returns the bytes of an image of a robot with this config, and of its file: only the robust filter needs
 * all of them (mcp_asdf_image.h). */
static size_t image_size(const mcp_asdf_config_t *config)
{
    return mcp_asdf_is_robust(config) ? MCP_ASDF_IMAGE_SIZE : MCP_ASDF_ASDF_IMAGE_SIZE;
}

/* Read a file to its end, but at most `maximum` bytes. Returns the number of bytes, or -1 with errno set. */
static ssize_t read_file(int fd, uint8_t *bytes, size_t maximum)
{
    size_t total = 0;
    ssize_t size = 1; /* of the last read(): 0 at the end of the file, -1 after an error */
    /* One read() may return fewer bytes than there are. */
    while (size > 0 && total < maximum) {
        size = read(fd, bytes + total, maximum - total);
        total += size > 0 ? (size_t)size : 0;
    }
    return size < 0 ? -1 : (ssize_t)total;
}

/* Restore the robot from its file. Returns NULL, also if there is no file, or why it cannot be used. */
const char *state_load(const char *path, mcp_asdf_t *robot, const mcp_asdf_config_t *config)
{
    uint8_t image[MCP_ASDF_IMAGE_SIZE + 1]; /* a file with one byte more is not an image */
    mcp_asdf_t loaded;
    const int fd = open(path, O_RDONLY | O_CLOEXEC);
    if (fd < 0) {
        return errno == ENOENT ? NULL : strerror(errno);
    }
    const size_t expected_size = image_size(config);
    const ssize_t size = read_file(fd, image, expected_size + 1);
    const int error = errno;
    (void)close(fd);
    if (size < 0) {
        return strerror(error);
    }
    if ((size_t)size != expected_size || mcp_asdf_restore(&loaded, config, image) != MCP_ASDF_OK) {
        return "it is damaged, or does not fit the periods and the memory";
    }
    if (loaded.id != robot->id) {
        return "it is that of another robot";
    }
    *robot = loaded;
    return NULL;
}

/* Write an image of so many bytes to a new file, and wait until it is on the disk. Returns 0 or an errno. */
static int write_file(const char *path, const uint8_t *image, size_t size)
{
    const int fd = open(path, O_WRONLY | O_CREAT | O_TRUNC | O_CLOEXEC, 0666);
    if (fd < 0) {
        return errno;
    }
    errno = ENOSPC; /* for a short write, which sets no errno */
    if (write(fd, image, size) != (ssize_t)size || fsync(fd) != 0) {
        const int error = errno; /* closing may change it */
        (void)close(fd);
        return error;
    }
    return close(fd) == 0 ? 0 : errno;
}

/* Wait until the names in the folder of `path` are on the disk, so that a renamed file has its new name. Cuts
 * `path` at the folder's end. Returns 0 or an errno. */
static int sync_folder(char *path)
{
    char *last_slash = strrchr(path, '/');
    const char *folder = ".";
    if (last_slash != NULL) {
        /* The name of the root folder is the slash itself; other names end before the slash. */
        char *const end = last_slash == path ? last_slash + 1 : last_slash;
        *end = '\0';
        folder = path;
    }
    const int fd = open(folder, O_RDONLY | O_DIRECTORY | O_CLOEXEC);
    if (fd < 0) {
        return errno;
    }
    /* EINVAL: this file system has nothing to sync. */
    const int error = fsync(fd) == 0 || errno == EINVAL ? 0 : errno;
    (void)close(fd);
    return error;
}

/* Save the robot in another file, which then takes the place of the old one. Returns 0 or an errno. */
int state_save(const char *path, const mcp_asdf_t *robot)
{
    char new_path[PATH_MAX];
    uint8_t image[MCP_ASDF_IMAGE_SIZE]; /* saving writes as many bytes as the filter needs */
    const int length = snprintf(new_path, sizeof new_path, "%s.new", path);
    if (length < 0 || (size_t)length >= sizeof new_path) {
        return ENAMETOOLONG;
    }
    mcp_asdf_save(robot, image);
    int error = write_file(new_path, image, image_size(robot->config));
    if (error == 0 && rename(new_path, path) != 0) {
        error = errno;
    }
    if (error != 0) {
        (void)unlink(new_path);
        return error;
    }
    return sync_folder(new_path);
}
