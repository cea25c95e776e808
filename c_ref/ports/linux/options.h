/* The command line. */
#ifndef MCP_ASDF_LINUX_OPTIONS_H
#define MCP_ASDF_LINUX_OPTIONS_H

#include "../node/node.h"

typedef struct {
    node_settings_t node;
    const char *interface;
    const char *network;      /* interface to the multicast group, or NULL */
    const char *observations; /* a stream, or NULL */
    const char *sensor;       /* a file read in every tick, or NULL */
    const char *state;        /* a file, or NULL */
    uint32_t save_period;     /* ticks; 0: at the end only */
    uint32_t ticks;           /* to do; 0: no limit */
    uint32_t receive_buffer;  /* bytes; 0: the kernel's default */
    uint32_t hops;            /* networks that a datagram may cross */
} options_t;

#define EXIT_USAGE 2

/* Read the command line into *options, which need not be filled. Ends the program after --help and --version,
 * and with EXIT_USAGE and a message that names the value and the fix if something is wrong. */
void options_read(options_t *options, int count, char *const arguments[]);

#endif
