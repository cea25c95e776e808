/* Noticing two nodes with one id; conflicts.h is the manual. */
#include "conflicts.h"

#define ENOUGH 12 /* signs among 32 messages; one sender gives at most 10, at any loss */

static uint32_t ones(uint32_t word)
{
    uint32_t count = 0;
    for (; word != 0; word &= word - 1) {
        ++count;
    }
    return count;
}

/* Places from the newest message to this one, -16 .. 15: one that is farther ahead is taken for a late one.
 */
static int32_t ahead_of(uint32_t newest, uint8_t place)
{
    const uint32_t half = CONFLICTS_TRANSFER_IDS / 2;
    return (int32_t)((place - newest + half) % CONFLICTS_TRANSFER_IDS) - (int32_t)half;
}

/* A sign is a number heard with two contents while the count goes on: after a restart of a single sender the
 * numbers come again, too, but no new ones between them. */
static bool is_shared(conflicts_sequence_t *sequence, const mcp_asdf_estimate_t *estimate)
{
    conflicts_said_t *before = &sequence->said[estimate->transfer_id % CONFLICTS_TRANSFER_IDS];
    if (!sequence->is_begun) {
        sequence->is_begun = true;
        sequence->newest = estimate->transfer_id;
    }
    const int32_t ahead = ahead_of(sequence->newest, estimate->transfer_id);
    const uint32_t number = sequence->newest + (uint32_t)ahead; /* modulo 2^32, as the count itself */
    const bool is_taken = before->is_there && before->number == number;
    if (is_taken && before->x_hat == estimate->x_hat && before->alpha == estimate->alpha) {
        return false;
    }
    if (!is_taken) {
        *before = (conflicts_said_t){number, estimate->x_hat, estimate->alpha, true};
        sequence->newest += ahead > 0 ? (uint32_t)ahead : 0;
    }
    sequence->signs = sequence->signs << 1 | (uint32_t)(is_taken && (sequence->advanced & 3) != 0);
    sequence->advanced = (uint8_t)(sequence->advanced << 1 | (!is_taken && ahead > 0));
    return ones(sequence->signs) >= ENOUGH;
}

bool conflicts_hear(conflicts_t *conflicts, uint8_t own, const mcp_asdf_estimate_t *estimate)
{
    conflicts_sequence_t *sequence = &conflicts->nodes[estimate->node % CONFLICTS_NODES];
    if (sequence->is_found) {
        return false;
    }
    sequence->is_found = estimate->node == own || is_shared(sequence, estimate);
    return sequence->is_found;
}
