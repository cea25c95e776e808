/* A clock that ticks at a steady rate, and how late its owner was. Times are nanoseconds. */
#ifndef MCP_ASDF_LINUX_TICKER_H
#define MCP_ASDF_LINUX_TICKER_H

#include <stdbool.h>
#include <stdint.h>

#define TICKER_SECOND INT64_C(1000000000)

/*   period    between ticks
 *   next      when the next tick is due; the first is due at once
 *   worst     how late a tick was at most
 *   skipped   ticks left out, since a node that is a period late or more must not catch up in a burst */
typedef struct {
    int64_t period, next, worst;
    uint32_t skipped;
} ticker_t;

/* Time since some moment in the past that no one sets back. */
int64_t ticker_now(void);

ticker_t ticker_start(int64_t period, int64_t now);

/* Whether a tick is due; says so once for each. */
bool ticker_is_due(ticker_t *ticker, int64_t now);

#endif
