/* The serial line of a board with a start-up file of ours. */
#ifndef MCP_ASDF_PORT_UART_H
#define MCP_ASDF_PORT_UART_H

/* Switch the serial line on; called once, before main(). */
void uart_start(void);

#endif
