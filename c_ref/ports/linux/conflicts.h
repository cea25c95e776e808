/* Two nodes with one id, noticed from the estimates that one node hears. mcp_asdf_tools/bus/id_conflicts.py
 * has the same rules, and what was measured with them.
 *
 * An estimate under the own id proves a conflict. Those of others show in their transfer ids, which count a
 * sender's messages modulo 32: when two nodes count under one id, numbers come twice with different content
 * while the count goes on. Two that say the same at the same time cannot be told apart. */
#ifndef MCP_ASDF_LINUX_CONFLICTS_H
#define MCP_ASDF_LINUX_CONFLICTS_H

#include "mcp_asdf_frame.h"

#include <stdbool.h>

#define CONFLICTS_NODES 128
#define CONFLICTS_TRANSFER_IDS 32

/* An estimate heard under a transfer id.
 *   number   of the message, counted on beyond 31 */
typedef struct {
    uint32_t number, x_hat, alpha;
    bool is_there;
} conflicts_said_t;

/* The estimates under one id.
 *   newest     highest number so far
 *   signs      of two senders, one bit for each message, the last one in bit 0
 *   advanced   whether the message counted on, for the last two, likewise
 *   is_found   whether there is a conflict */
typedef struct {
    conflicts_said_t said[CONFLICTS_TRANSFER_IDS];
    uint32_t newest, signs;
    uint8_t advanced;
    bool is_begun, is_found;
} conflicts_sequence_t;

/* All 0 before the first call. */
typedef struct {
    conflicts_sequence_t nodes[CONFLICTS_NODES];
} conflicts_t;

/* Take a legal estimate that the node `own` has not sent itself; returns whether it proves a conflict that is
 * new. Constant time. */
bool conflicts_hear(conflicts_t *conflicts, uint8_t own, const mcp_asdf_estimate_t *estimate);

#endif
