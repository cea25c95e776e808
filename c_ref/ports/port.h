/* Functions that an image needs from its board. A port is a file or two that keep this promise;
 * docs/internals/targets.md lists the ones there are. Without a C library, memory.c gives the two functions
 * that compilers call. */
#ifndef MCP_ASDF_PORT_H
#define MCP_ASDF_PORT_H

#include <stdbool.h>

/* Send a byte over the serial line; waits until there is room for it. */
void port_put(char byte);

/* End the program once everything sent has left: 0 is success. An emulator ends with that status where it can
 * be told one; hardware stops. */
void port_exit(int status);

/* ---- For programs that listen, too; nrf51.c and atmega.c leave these out ---- */

#define PORT_NOTHING (-1) /* no byte has come since the last */
#define PORT_LOST (-2)    /* bytes that came before the next one are lost: they were not fetched in time */

/* The next byte that the serial line has received, 0 .. 255, or one of the two above. Does not wait, except
 * where there is an operating system, and so nothing else to do. */
int port_get(void);

/* Whether port_put() would find room at once. */
bool port_has_room(void);

/* Wait, at little cost, until there may be a byte. May return at any time. */
void port_sleep(void);

#endif
