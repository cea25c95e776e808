/* The board's clock, 8 to 20 MHz, and the speed of its serial line, by the names that AVR programmers know:
 * nothing to say for an Arduino Uno, -DF_CPU=8000000UL -DBAUD=38400 for a Kilobot. */
#ifndef MCP_ASDF_CLOCK_H
#define MCP_ASDF_CLOCK_H

#ifndef F_CPU
#define F_CPU 16000000UL /* hertz */
#endif
#ifndef BAUD
#define BAUD 115200UL
#endif

/* The UART divides the clock by 8 and by this, which one of its registers can hold up to 256. */
#define BAUD_DIVISOR ((F_CPU + 4UL * BAUD) / (8UL * BAUD))
#if F_CPU < 8000000 || F_CPU > 20000000
#error "F_CPU has to be 8 to 20 MHz, in hertz"
#elif BAUD_DIVISOR < 1 || BAUD_DIVISOR > 256
#error "the UART cannot make BAUD from F_CPU"
#elif F_CPU * 40 > 41 * 8 * BAUD * BAUD_DIVISOR || F_CPU * 40 < 39 * 8 * BAUD * BAUD_DIVISOR
#error "the nearest to BAUD that the UART can make from F_CPU is more than 2.5 % off"
#endif

#endif
