/* Printing the summary; docs/socketcan.md explains its members. */
#include "run.h"

#include <inttypes.h>
#include <stdio.h>

#define U32 "%" PRIu32

static void print_robot(const mcp_asdf_t *robot)
{
    const mcp_asdf_counters_t counters = mcp_asdf_counters(robot);
    (void)printf("\"t\": " U32 ", \"n\": " U32 ", \"b_hat\": " U32 ", \"x_hat\": " U32 ", \"alpha\": " U32,
                 mcp_asdf_t_count(robot), mcp_asdf_n_count(robot), mcp_asdf_b_hat(robot),
                 mcp_asdf_x_hat(robot), mcp_asdf_alpha(robot));
    (void)printf(", \"x_bar\": " U32 ", \"beta\": %" PRIu64 ", \"x\": " U32, mcp_asdf_x_bar(robot),
                 mcp_asdf_beta(robot), mcp_asdf_x(robot));
    (void)printf(", \"accepted\": %u, \"repeated\": %u, \"rejected\": %u, \"tests\": %u, \"updates\": %u",
                 counters.accepted, counters.repeated, counters.rejected, counters.tests, counters.updates);
}

static void print_node(const node_counts_t *counts)
{
    (void)printf(", \"estimates\": " U32 ", \"heartbeats\": " U32 ", \"telemetry\": " U32
                 ", \"unsent\": " U32,
                 counts->estimates, counts->heartbeats, counts->telemetry, counts->unsent);
    (void)printf(", \"heard\": " U32 ", \"collisions\": " U32 ", \"refused\": " U32 ", \"others\": " U32,
                 counts->heard, counts->collisions, counts->refused, counts->others);
    (void)printf(", \"obeyed\": " U32 ", \"disobeyed\": " U32 ", \"unsettled\": " U32, counts->obeyed,
                 counts->disobeyed, counts->unsettled);
}

static void print_bus(const bus_t *bus)
{
    const bus_counts_t *counts = &bus->counts;
    (void)printf(
        ", \"filtered_by\": \"%s\", \"received\": " U32 ", \"overflowed\": " U32 ", \"queue_full\": " U32,
        bus->is_filtered ? "kernel" : "node", counts->received, counts->overflowed, counts->queue_full);
    (void)printf(", \"error_frames\": " U32 ", \"bus_off\": " U32 ", \"downs\": " U32
                 ", \"odd_packets\": " U32,
                 counts->error_frames, counts->bus_off, counts->downs, counts->odd_packets);
}

static void print_conflicts(const conflicts_t *conflicts)
{
    const char *between = "";
    (void)printf(", \"id_conflicts\": [");
    for (unsigned node = 0; node < CONFLICTS_NODES; ++node) {
        if (conflicts->nodes[node].is_found) {
            (void)printf("%s%u", between, node);
            between = ", ";
        }
    }
    (void)printf("]");
}

bool summary_print(const run_t *run, const node_t *node)
{
    (void)printf("{\"id\": %u, \"ended\": \"%s\", \"ticks\": " U32 ", ", node->settings->id, run->ended,
                 node->ticks);
    print_robot(&node->robot);
    print_node(&node->counts);
    print_bus(&run->bus);
    print_conflicts(&run->conflicts);
    (void)printf(", \"missing\": " U32 ", \"skipped\": " U32 ", \"worst_lateness_us\": %" PRId64 "}\n",
                 run->source.missing, run->clock.skipped, run->clock.worst / 1000);
    return fflush(stdout) == 0 && ferror(stdout) == 0;
}
