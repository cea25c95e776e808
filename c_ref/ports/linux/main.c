/* mcp_asdf_node: a robot on a CAN bus under Linux. docs/socketcan.md is the manual. */
#include "bus.h"
#include "options.h"
#include "source.h"
#include "state.h"

#include <errno.h>
#include <inttypes.h>
#include <poll.h>
#include <signal.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <time.h>

#define MOST_PACKETS 256 /* taken in a row, so that a babbling node cannot keep us from ticking */
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

typedef struct {
    options_t options;
    node_t node;
    node_sender_t senders[MCP_ASDF_MAX_ID + 1];
    uint32_t seen; /* ticks whose end note_progress() has seen */
    bus_t bus;
    source_t source;
    ticker_t clock, reopening, greeting;
    sigset_t when_waiting; /* signals blocked then */
    const char *ended;     /* why, or NULL */
    int save_error;        /* the last one, as an errno */
    int status;
} run_t;

/* ---- Signals ---------------------------------------------------------------------------------------- */

static volatile sig_atomic_t is_interrupted;

static void interrupt(int signal)
{
    (void)signal;
    is_interrupted = 1;
}

/* Signals come through only while we wait, so none can slip in between a check and the wait. */
static void catch_signals(run_t *run)
{
    static const int signals[] = {SIGINT, SIGTERM, SIGHUP};
    const struct sigaction action = {.sa_handler = interrupt};
    struct sigaction before;
    sigset_t caught;
    (void)sigemptyset(&caught);
    (void)sigprocmask(SIG_BLOCK, NULL, &run->when_waiting);
    for (size_t i = 0; i < sizeof signals / sizeof signals[0]; ++i) {
        (void)sigaddset(&caught, signals[i]);
        (void)sigdelset(&run->when_waiting, signals[i]);
        /* One that this program was started to ignore (nohup, a shell's background) stays ignored. */
        if (sigaction(signals[i], NULL, &before) == 0 && before.sa_handler != SIG_IGN) {
            (void)sigaction(signals[i], &action, NULL);
        }
    }
    (void)sigprocmask(SIG_BLOCK, &caught, NULL);
}

/* ---- Setting up: what is wrong ends the program with a message that names the value and the fix ------ */

static void fail(const char *what, const char *which, const char *why, const char *fix)
{
    (void)fprintf(stderr, "mcp_asdf_node: %s %s: %s; %s\n", what, which, why, fix);
    exit(EXIT_USAGE);
}

static void join(bus_t *bus)
{
    const int error = bus_open(bus);
    if (error != 0 && bus->is_multicast) {
        fail("cannot join", bus->name, strerror(error),
             error == EINVAL ? "name a multicast group and a port, as udp:239.74.163.2:43113"
                             : "name an interface that `ip link` shows by --network");
    }
    if (error == ENODEV || error == EAFNOSUPPORT) {
        (void)fprintf(
            stderr,
            "mcp_asdf_node: there is no CAN interface %s; name one that `ip link` shows, or make it:\n"
            "  modprobe vcan\n  ip link add dev %s type vcan\n  ip link set %s up\n",
            bus->name, bus->name, bus->name);
        exit(EXIT_USAGE);
    }
    if (error != 0) {
        fail("cannot join", bus->name, strerror(error), "is --interface right?");
    }
}

static void set_up(run_t *run)
{
    const options_t *options = &run->options;
    const node_output_t output = {bus_send, &run->bus};
    const bool in_lockstep = options->node.lockstep;
    run->bus.name = options->interface;
    run->bus.group.network = options->network;
    run->bus.group.hops = (int)options->hops;
    run->bus.receive_buffer = (int)options->receive_buffer;
    run->bus.subjects[0] = options->node.estimate.subject;
    run->bus.subjects[1] = (in_lockstep ? options->node.command : options->node.estimate).subject;
    run->source.is_sensor = options->sensor != NULL;
    run->source.path = options->sensor != NULL ? options->sensor : options->observations;
    if (node_init(&run->node, &options->node, output) != MCP_ASDF_OK) {
        fail("cannot make the robot", "of these options", "refused by the firmware", "see --help");
    }
    run->node.senders = run->senders;
    if (options->state != NULL) {
        const char *why = state_load(options->state, &run->node.robot, &run->node.config);
        if (why != NULL) {
            fail("cannot use the state", options->state, why,
                 "choose another --state, or move this one away");
        }
    }
    if (!in_lockstep) {
        const int error = source_open(&run->source);
        if (error != 0) {
            fail("cannot open", run->source.path, strerror(error), "choose a file that can be read");
        }
    }
    join(&run->bus);
}

/* ---- The clock -------------------------------------------------------------------------------------- */

/* Time since some moment in the past that no one sets back. */
static int64_t now_ns(void)
{
    struct timespec now;
    (void)clock_gettime(CLOCK_MONOTONIC, &now);
    return (int64_t)now.tv_sec * SECOND + now.tv_nsec;
}

/* Whether a tick is due; says so once for each. */
static bool is_due(ticker_t *ticker, int64_t now)
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

/* ---- Running ---------------------------------------------------------------------------------------- */

static void end(run_t *run, const char *why, int status)
{
    run->ended = why;
    run->status = status;
}

/* A full disk must not stop the robot: the state saved last stays, and the status tells in the end. */
static void save(run_t *run)
{
    const int error = state_save(run->options.state, &run->node.robot);
    if (error != 0 && error != run->save_error) {
        (void)fprintf(stderr, "mcp_asdf_node: cannot save the state %s: %s; going on\n", run->options.state,
                      strerror(error));
    }
    if (error != 0) {
        run->save_error = error;
        run->status = EXIT_FAILURE;
    }
}

/* Called after whatever may have ended a tick. */
static void note_progress(run_t *run)
{
    const uint32_t ticks = run->node.ticks, period = run->options.save_period;
    if (!run->node.is_settled || ticks == run->seen) {
        return;
    }
    run->seen = ticks;
    if (run->options.state != NULL && period != 0 && ticks % period == 0) {
        save(run);
    }
    if (run->options.ticks != 0 && ticks == run->options.ticks) {
        end(run, "ticks", run->status);
    }
}

static void take(run_t *run, const mcp_asdf_frame_t *frame)
{
    const bool is_first = run->node.counts.collisions == 0;
    node_hear(&run->node, frame);
    if (is_first && run->node.counts.collisions != 0) {
        (void)fprintf(stderr,
                      "mcp_asdf_node: another node sends under this node's own id: %u; "
                      "give one of them another\n",
                      run->options.node.id);
    }
    note_progress(run);
}

static void hear(run_t *run)
{
    mcp_asdf_frame_t frame;
    bus_event_t event = BUS_FRAME;
    for (int i = 0; i < MOST_PACKETS && run->ended == NULL && run->bus.fd >= 0; ++i) {
        event = bus_receive(&run->bus, &frame);
        if (event == BUS_NOTHING || event == BUS_CLOSED) {
            break;
        }
        run->node.health = run->bus.health;
        if (event == BUS_FRAME) {
            take(run, &frame);
        }
    }
    if (event == BUS_CLOSED) {
        end(run, "bus closed", EXIT_FAILURE);
    }
    run->node.health = run->bus.health;
}

/* Take an observation; returns whether the run goes on. */
static bool look(run_t *run, mcp_asdf_action_t *seen)
{
    source_t *source = &run->source;
    const bool has_come = source_next(source, seen);
    if (source->odd != 0) {
        (void)fprintf(stderr, "mcp_asdf_node: character %lu of %s is no observation; write 0, 1 or -\n",
                      (unsigned long)source->taken + 1, source->path);
        end(run, "observations not valid", EXIT_FAILURE);
    } else if (source->error != 0) {
        (void)fprintf(stderr, "mcp_asdf_node: cannot read %s: %s\n", source->path, strerror(source->error));
        end(run, "observations not readable", EXIT_FAILURE);
    } else if (source->has_ended && !has_come) {
        end(run, "observations", run->status);
    }
    return run->ended == NULL;
}

/* A tick lasts until the next begins: what is heard meanwhile belongs to its round. */
static void tick(run_t *run)
{
    mcp_asdf_action_t seen;
    if (!run->node.is_settled) {
        node_settle(&run->node);
        note_progress(run);
    }
    if (run->ended == NULL && look(run, &seen)) {
        node_observe(&run->node, seen);
    }
}

/* Sleep until there is a frame, a tick is due, or a signal comes. */
static void wait_for_work(run_t *run)
{
    const bool is_joined = run->bus.fd >= 0, in_lockstep = run->options.node.lockstep;
    struct pollfd bus = {.fd = run->bus.fd, .events = POLLIN}; /* one below 0 is not waited for */
    int64_t until = in_lockstep ? INT64_MAX : run->clock.next;
    if (in_lockstep && run->node.ticks == 0) {
        until = run->greeting.next;
    }
    if (!is_joined && run->reopening.next < until) {
        until = run->reopening.next;
    }
    const int64_t now = now_ns(), left = until > now ? until - now : 0;
    const struct timespec timeout = {.tv_sec = (time_t)(left / SECOND), .tv_nsec = (long)(left % SECOND)};
    (void)ppoll(&bus, 1, until == INT64_MAX ? NULL : &timeout, &run->when_waiting);
}

static void run_until_ended(run_t *run)
{
    run->reopening = (ticker_t){.period = SECOND, .next = now_ns()};
    run->clock = (ticker_t){.period = SECOND / run->options.node.ticks_per_second, .next = now_ns()};
    run->greeting = run->reopening;
    while (run->ended == NULL) {
        if (run->node.ticks == 0 && is_due(&run->greeting, now_ns())) {
            node_start(&run->node); /* again while no one commands it: who does may not have been there */
        }
        wait_for_work(run);
        if (run->bus.fd < 0 && is_due(&run->reopening, now_ns())) {
            (void)bus_open(&run->bus);
        }
        hear(run);
        if (run->ended == NULL && !run->options.node.lockstep && is_due(&run->clock, now_ns())) {
            tick(run);
        }
        if (run->ended == NULL && is_interrupted) {
            end(run, "signal", run->status);
        }
    }
}

/* ---- The summary: a line of JSON, whose members docs/socketcan.md explains ---------------------------- */

#define NUMBER(name, value) (void)printf(", \"%s\": %" PRIu64, name, (uint64_t)(value))

/* Returns whether the standard output took it. Estimates and accuracies are the firmware's integers. */
static bool print_summary(const run_t *run)
{
    const mcp_asdf_t *robot = &run->node.robot;
    const mcp_asdf_counters_t counters = mcp_asdf_counters(robot);
    const node_counts_t *counts = &run->node.counts;
    const bus_counts_t *bus = &run->bus.counts;
    (void)printf("{\"id\": %u, \"ended\": \"%s\"", run->options.node.id, run->ended);
    NUMBER("ticks", run->node.ticks);
    NUMBER("t", mcp_asdf_t_count(robot));
    NUMBER("n", mcp_asdf_n_count(robot));
    NUMBER("b_hat", mcp_asdf_b_hat(robot));
    NUMBER("x_hat", mcp_asdf_x_hat(robot));
    NUMBER("alpha", mcp_asdf_alpha(robot));
    NUMBER("x_bar", mcp_asdf_x_bar(robot));
#if MCP_ASDF_WITH_ASDF
    NUMBER("beta", mcp_asdf_beta(robot));
#endif
    NUMBER("x", mcp_asdf_x(robot));
    NUMBER("accepted", counters.accepted);
    NUMBER("repeated", counters.repeated);
    NUMBER("rejected", counters.rejected);
    NUMBER("tests", counters.tests);
    NUMBER("updates", counters.updates);
    NUMBER("estimates", counts->estimates);
    NUMBER("heartbeats", counts->heartbeats);
    NUMBER("telemetry", counts->telemetry);
    NUMBER("unsent", counts->unsent);
    NUMBER("heard", counts->heard);
    NUMBER("unknown", counts->unknown);
    NUMBER("jumps", counts->jumps);
    NUMBER("collisions", counts->collisions);
    NUMBER("refused", counts->refused);
    NUMBER("others", counts->others);
    NUMBER("obeyed", counts->obeyed);
    NUMBER("disobeyed", counts->disobeyed);
    NUMBER("unsettled", counts->unsettled);
    (void)printf(", \"filtered_by\": \"%s\"", run->bus.is_filtered ? "kernel" : "node");
    NUMBER("received", bus->received);
    NUMBER("overflowed", bus->overflowed);
    NUMBER("queue_full", bus->queue_full);
    NUMBER("error_frames", bus->error_frames);
    NUMBER("bus_off", bus->bus_off);
    NUMBER("downs", bus->downs);
    NUMBER("odd_packets", bus->odd_packets);
    NUMBER("missing", run->source.missing);
    NUMBER("skipped", run->clock.skipped);
    NUMBER("worst_lateness_us", run->clock.worst / 1000);
    (void)printf("}\n");
    return fflush(stdout) == 0 && ferror(stdout) == 0;
}

int main(int count, char *arguments[])
{
    static run_t run;
    options_read(&run.options, count, arguments);
    catch_signals(&run);
    set_up(&run);
    run_until_ended(&run);
    if (run.options.state != NULL) {
        save(&run);
    }
    const bool is_told = print_summary(&run);
    bus_close(&run.bus);
    return is_told ? run.status : EXIT_FAILURE;
}
