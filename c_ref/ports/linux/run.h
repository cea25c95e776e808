/* A run of the program: its robots, their bus, their observations. */
#ifndef MCP_ASDF_LINUX_RUN_H
#define MCP_ASDF_LINUX_RUN_H

#include "bus.h"
#include "conflicts.h"
#include "options.h"
#include "source.h"

#include <signal.h>

#define SECOND INT64_C(1000000000)

/* A clock that ticks at a steady rate, and how late its owner was. Times are nanoseconds.
 *   period    between ticks
 *   next      when the next tick is due; the first is due at once
 *   worst     how late a tick was at most
 *   skipped   ticks left out, since a node that is a period late or more must not catch up in a burst */
typedef struct {
    int64_t period, next, worst;
    uint32_t skipped;
} ticker_t;

typedef struct run run_t;

/*   seen   ticks whose end note_progress() has seen */
typedef struct {
    run_t *run;
    node_settings_t settings;
    node_t node;
    uint32_t seen;
} member_t;

struct run {
    options_t options;
    member_t members[SOURCE_MOST_ROBOTS]; /* those of options.robots, by rising id */
    bus_t bus;
    source_t source;
    conflicts_t conflicts;
    ticker_t clock, reopening;
    sigset_t when_waiting; /* signals blocked then */
    const char *ended;     /* why, or NULL */
    int save_error;        /* the last one, as an errno */
    int status;
};

/* Make the robots and join the bus, as run->options have it. Ends the program with EXIT_USAGE and a message
 * that names the value and the fix if something is wrong. */
void run_set_up(run_t *run);

/* Print the summary of one robot of a run that has ended as a line of JSON; returns whether the standard
 * output took it. Estimates and accuracies are the firmware's integers. */
bool summary_print(const run_t *run, const node_t *node);

#endif
