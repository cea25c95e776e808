/* A robot with an operating system: the serial line is standard input and output. Its end ends the program.
 */
#include "port.h"

#include <stdio.h>
#include <stdlib.h>

/* Write a byte to the standard output, which may keep it until port_get() flushes it. */
void port_put(char byte) { (void)putchar(byte); }

/* Whether port_put() would find room at once: always, as the operating system has a buffer. */
bool port_has_room(void) { return true; }

/* Wait for a byte of the standard input, and return it. The end of the input ends the program. All output is
 * flushed before, as the other side may wait for it. */
int port_get(void)
{
    (void)fflush(stdout);
    const int byte = getchar();
    if (byte == EOF) {
        exit(EXIT_SUCCESS);
    }
    return byte;
}

/* Does nothing: port_get() waits for a byte already. */
void port_sleep(void) {}

/* End the program with a status, 0 for success. */
void port_exit(int status) { exit(status); }
