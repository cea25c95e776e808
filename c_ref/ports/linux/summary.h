/* Summary of a run. */
#ifndef MCP_ASDF_LINUX_SUMMARY_H
#define MCP_ASDF_LINUX_SUMMARY_H

#include "run.h"

/* Print that of one robot of a run that has ended as a line of JSON; returns whether the standard output took
 * it. Estimates and accuracies are the firmware's integers. */
bool summary_print(const run_t *run, const node_t *node);

#endif
