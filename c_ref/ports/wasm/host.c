/* WebAssembly without a system: bytes and the exit go to whoever runs the module, in run.mjs to Node.js. */
#include "port.h"

#define IMPORT(name) __attribute__((import_module("port"), import_name(#name)))

int main(void);
IMPORT(put) void host_put(int byte);
IMPORT(exit) void host_exit(int status);

/* Pass a byte to the host, as a number from 0 to 255. */
void port_put(char byte) { host_put((unsigned char)byte); }

/* Let the host end the module with a status. */
void port_exit(int status) { host_exit(status); }

__attribute__((export_name("run"))) int run(void);

/* What the host calls to run the program. Returns its status. */
int run(void) { return main(); }
