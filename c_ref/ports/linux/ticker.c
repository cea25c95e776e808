/* The clock; ticker.h is its manual. */
#include "ticker.h"

#include <time.h>

int64_t ticker_now(void)
{
    struct timespec now;
    (void)clock_gettime(CLOCK_MONOTONIC, &now);
    return (int64_t)now.tv_sec * TICKER_SECOND + now.tv_nsec;
}

ticker_t ticker_start(int64_t period, int64_t now)
{
    const ticker_t ticker = {.period = period, .next = now};
    return ticker;
}

bool ticker_is_due(ticker_t *ticker, int64_t now)
{
    const int64_t late = now - ticker->next;
    if (late < 0) {
        return false;
    }
    if (late > ticker->worst) {
        ticker->worst = late;
    }
    ticker->skipped += (uint32_t)(late / ticker->period);
    ticker->next += (late / ticker->period + 1) * ticker->period;
    return true;
}
