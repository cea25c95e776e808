/* Assertions for the C tests. A failed check prints what it compared and the values last GIVEN, and the test
 * goes on, or with CHECK_ONCE ends; check_report() is what main returns. */
#ifndef CHECK_H
#define CHECK_H

#include <inttypes.h>
#include <stdbool.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>

#define CHECK_PRINTED 8 /* failures that are printed; all are counted */

#define CHECK(condition) check_that((condition), #condition, __FILE__, __LINE__)
#define CHECK_EQUAL(actual, expected)                                                                        \
    check_equal((uint64_t)(actual), (uint64_t)(expected), #actual " == " #expected, __FILE__, __LINE__)
#define GIVEN(a, b, c) check_given((uint64_t)(a), (uint64_t)(b), (uint64_t)(c))
#define COUNT(array) (sizeof(array) / sizeof((array)[0]))

static struct {
    unsigned long checks, failures;
    uint64_t given[3];
} check_state;

static inline void check_given(uint64_t a, uint64_t b, uint64_t c)
{
    check_state.given[0] = a;
    check_state.given[1] = b;
    check_state.given[2] = c;
}

static inline bool check_that(bool holds, const char *what, const char *file, int line)
{
    ++check_state.checks;
    if (!holds && ++check_state.failures <= CHECK_PRINTED) {
        printf("%s:%d: not so: %s, given %#" PRIx64 ", %#" PRIx64 ", %#" PRIx64 "\n", file, line, what,
               check_state.given[0], check_state.given[1], check_state.given[2]);
#ifdef CHECK_ONCE
        exit(EXIT_FAILURE);
#endif
    }
    return holds;
}

static inline void check_equal(uint64_t actual, uint64_t expected, const char *what, const char *file,
                               int line)
{
    if (!check_that(actual == expected, what, file, line) && check_state.failures <= CHECK_PRINTED) {
        printf("    %#" PRIx64 " is not %#" PRIx64 "\n", actual, expected);
    }
}

/* A number of a fixed sequence (xorshift), with a random number of bits, so that small ones come up, too. */
static inline uint32_t check_random_word(void)
{
    static uint64_t state = UINT64_C(0x9E3779B97F4A7C15);
    state ^= state << 13;
    state ^= state >> 7;
    state ^= state << 17;
    return (uint32_t)(state >> 32) >> (state & 31);
}

static inline int check_report(void)
{
    printf("%lu checks, %lu failed\n", check_state.checks, check_state.failures);
    return check_state.failures != 0 || check_state.checks == 0;
}

#endif
