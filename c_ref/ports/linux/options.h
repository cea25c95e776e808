/* The command line. */
#ifndef MCP_ASDF_LINUX_OPTIONS_H
#define MCP_ASDF_LINUX_OPTIONS_H

#include "../node/node.h"

/* Options of the program; texts point into the command line. */
typedef struct {
    node_settings_t node;
    const char *interface;    /* name of the bus, as in bus.h */
    const char *network;      /* interface that leads to the multicast group, or NULL */
    const char *observations; /* path of a stream of observations, or NULL */
    const char *sensor;       /* path of a file that is read in every tick, or NULL */
    const char *state;        /* path of the state's file, or NULL */
    uint32_t save_period;     /* ticks from one saving of the state to the next; 0: at the end only */
    uint32_t ticks;           /* ticks after which the program ends; 0: no limit */
    uint32_t receive_buffer;  /* bytes; 0: the kernel's default */
    uint32_t hop_limit;       /* networks that a datagram may cross */
} options_t;

#define EXIT_USAGE 2

/* Read the command line into *options, which need not be initialised. Ends the program after --help and
 * --version, and with EXIT_USAGE and a message that names the value and the fix if an option is wrong. */
void options_read(options_t *options, int argument_count, char *const arguments[]);

#endif
