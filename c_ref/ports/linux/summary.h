/* Summary of a run. */
#ifndef MCP_ASDF_LINUX_SUMMARY_H
#define MCP_ASDF_LINUX_SUMMARY_H

#include "../node/node.h"
#include "bus.h"
#include "conflicts.h"
#include "source.h"
#include "ticker.h"

/* Print it as one line of JSON; returns whether the standard output took it. `ended` is why the run did.
 * Estimates and accuracies are the firmware's integers. */
bool summary_print(const char *ended, const node_t *node, const bus_t *bus, const source_t *source,
                   const ticker_t *ticker, const conflicts_t *conflicts);

#endif
