/* Philox4x32-10, a counter-based generator: the words are a function of counter and key, so any draw of any
 * trial is had without those before it. J. K. Salmon et al., "Parallel random numbers: as easy as 1, 2, 3",
 * SC'11. */
#ifndef MCP_ASDF_PHILOX_H
#define MCP_ASDF_PHILOX_H

#include "targets.h"

#include <stdint.h>

#define PHILOX_ROUNDS 10

/* Four words: a counter, or what is drawn for it. */
typedef struct {
    uint32_t word[4];
} philox_t;

/* Returns a counter after one round of mixing, with the round's key of two words. Words 0 and 2 are
 * multiplied by constants of the generator; the upper halves of the products are mixed with the other words
 * and the key, and the words change places. */
IN_LOOPS philox_t philox_round(philox_t counter, uint32_t key0, uint32_t key1)
{
    const uint64_t product0 = (uint64_t)counter.word[0] * UINT32_C(0xD2511F53);
    const uint64_t product2 = (uint64_t)counter.word[2] * UINT32_C(0xCD9E8D57);
    const uint32_t upper0 = (uint32_t)(product0 >> 32), lower0 = (uint32_t)product0;
    const uint32_t upper2 = (uint32_t)(product2 >> 32), lower2 = (uint32_t)product2;
    const uint32_t mixed1 = upper2 ^ counter.word[1] ^ key0;
    const uint32_t mixed3 = upper0 ^ counter.word[3] ^ key1;
    return (philox_t){{mixed1, lower2, mixed3, lower0}};
}

/* Returns four random words, a function of the counter and the key of two words alone. The key grows by
 * constants of the generator from round to round. */
IN_LOOPS philox_t philox(philox_t counter, uint32_t key0, uint32_t key1)
{
#if defined(__GNUC__) && !defined(__clang__)
#pragma GCC unroll 10 /* so that a loop over many generators has no inner loop */
#endif
    for (uint32_t round = 0; round < PHILOX_ROUNDS; ++round) {
        const uint32_t round_key0 = key0 + round * UINT32_C(0x9E3779B9); /* modulo 2^32 */
        const uint32_t round_key1 = key1 + round * UINT32_C(0xBB67AE85);
        counter = philox_round(counter, round_key0, round_key1);
    }
    return counter;
}

/* Returns the four draws, of 32 bits each, that decide the observations of a robot in the steps 4 block to
 * 4 block + 3 of a trial, all counted from 0. The words of the seed are the generator's key; block, robot and
 * trial are its counter, whose last word is always 0. */
IN_LOOPS philox_t draw_block(uint64_t seed, uint32_t trial, uint32_t robot, uint32_t block)
{
    const philox_t counter = {{block, robot, trial, 0}};
    const uint32_t lower_seed = (uint32_t)seed, upper_seed = (uint32_t)(seed >> 32);
    return philox(counter, lower_seed, upper_seed);
}

#endif
