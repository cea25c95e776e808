/* The serial line of a board with a start-up file of ours. */
#ifndef MCP_ASDF_PORT_UART_H
#define MCP_ASDF_PORT_UART_H

/* Switch the serial line on; called once, before main(). */
void uart_start(void);

/* Handle interrupt 0 of a Cortex-M chip. Without a function of this name it ends the program. */
void handle_first_interrupt(void);

#endif
