/* A robot with an operating system: the serial line is standard input and output. Its end ends the program.
 */
#include "port.h"

#include <stdio.h>
#include <stdlib.h>

void port_put(char byte) { (void)putchar(byte); }

bool port_has_room(void) { return true; }

/* Wait for a byte of the standard input, and return it. The end of the input ends the program. All output is
 * flushed before, as the other side may wait for it. */
int port_get(void)
{
    (void)fflush(stdout);
    const int byte = getchar();
    if (byte == EOF) {
        exit(0);
    }
    return byte;
}

void port_sleep(void) {}

void port_exit(int status) { exit(status); }
