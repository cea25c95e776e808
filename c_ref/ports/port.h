/* What an image asks of the board it runs on. A port is a file or two that keep this promise; docs/targets.md
 * lists the ones there are. Without a C library, memory.c gives the two functions that compilers call. */
#ifndef MCP_ASDF_PORT_H
#define MCP_ASDF_PORT_H

/* Send a byte over the serial line; waits until there is room for it. */
void port_put(char byte);

/* End the program once everything sent has left: 0 is success. An emulator ends with that status where it can
 * be told one; hardware stops. */
void port_exit(int status);

#endif
