/* mcp_asdf_node: one robot on a CAN bus under Linux. docs/socketcan.md is the manual. */
#include "bus.h"
#include "conflicts.h"
#include "image.h"
#include "options.h"
#include "source.h"
#include "summary.h"
#include "ticker.h"

#include <errno.h>
#include <poll.h>
#include <signal.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#define MOST_PACKETS 256 /* taken in a row, so that a babbling node cannot keep us from ticking */

typedef struct {
    options_t options;
    node_t node;
    bus_t bus;
    source_t source;
    conflicts_t conflicts;
    ticker_t clock, reopening;
    sigset_t when_waiting; /* signals blocked then */
    uint32_t seen;         /* ticks whose end note_progress() has seen */
    const char *ended;     /* why, or NULL */
    int save_error;        /* the last one, as an errno */
    int status;
} run_t;

static volatile sig_atomic_t is_interrupted;

static void interrupt(int signal)
{
    (void)signal;
    is_interrupted = 1;
}

/* ---- Setting up ------------------------------------------------------------------------------------- */

static void fail(const char *what, const char *which, const char *why, const char *fix)
{
    (void)fprintf(stderr, "mcp_asdf_node: %s %s: %s; %s\n", what, which, why, fix);
    exit(EXIT_USAGE);
}

/* One that this program was started to ignore (nohup, a shell's background) stays ignored. */
static void heed(run_t *run, int signal, const struct sigaction *action)
{
    struct sigaction before;
    (void)sigdelset(&run->when_waiting, signal);
    if (sigaction(signal, NULL, &before) == 0 && before.sa_handler != SIG_IGN) {
        (void)sigaction(signal, action, NULL);
    }
}

/* Signals come through only while we wait, so none can slip in between a check and the wait. */
static void catch_signals(run_t *run)
{
    const struct sigaction action = {.sa_handler = interrupt};
    sigset_t caught;
    (void)sigemptyset(&caught);
    (void)sigaddset(&caught, SIGINT);
    (void)sigaddset(&caught, SIGTERM);
    (void)sigaddset(&caught, SIGHUP);
    (void)sigprocmask(SIG_BLOCK, &caught, &run->when_waiting);
    heed(run, SIGINT, &action);
    heed(run, SIGTERM, &action);
    heed(run, SIGHUP, &action);
}

static void join(bus_t *bus)
{
    const int error = bus_open(bus);
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

static void restore(run_t *run)
{
    const char *path = run->options.state;
    switch (image_load(path, &run->node.robot, &run->node.config, run->options.node.id)) {
    case IMAGE_OK:
    case IMAGE_ABSENT:
        break;
    case IMAGE_UNREADABLE:
        fail("cannot read the state", path, strerror(errno), "choose another file for --state");
        break;
    case IMAGE_REFUSED:
        fail("cannot use the state", path, "damaged, or it does not fit the periods and the memory",
             "remove it to begin anew");
        break;
    case IMAGE_OF_ANOTHER:
        fail("cannot use the state", path, "it is that of another robot", "give each --id its own file");
        break;
    }
}

static void set_up(run_t *run)
{
    const options_t *options = &run->options;
    const node_output_t output = {bus_send, &run->bus};
    run->bus.name = options->interface;
    run->bus.receive_buffer = (int)options->receive_buffer;
    run->bus.subjects[0] = options->node.estimate.subject;
    run->bus.subjects[1] = (options->node.lockstep ? options->node.command : options->node.estimate).subject;
    run->source.is_sensor = options->sensor != NULL;
    run->source.path = options->sensor != NULL ? options->sensor : options->observations;
    if (node_init(&run->node, &options->node, output) != MCP_ASDF_OK) {
        fail("cannot make the robot", "of these options", "refused by the firmware", "see --help");
    }
    if (options->state != NULL) {
        restore(run);
    }
    if (run->source.path != NULL) {
        const int error = source_open(&run->source);
        if (error != 0) {
            fail("cannot open", run->source.path, strerror(error), "choose a file that can be read");
        }
    }
    join(&run->bus);
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
    const int error = image_save(run->options.state, &run->node.robot);
    if (error != 0 && error != run->save_error) {
        (void)fprintf(stderr, "mcp_asdf_node: cannot save the state %s: %s; going on\n", run->options.state,
                      strerror(error));
    }
    if (error != 0) {
        run->save_error = error;
        run->status = EXIT_FAILURE;
    }
}

static void note_sender(run_t *run, const mcp_asdf_frame_t *frame)
{
    const uint8_t own = run->options.node.id;
    mcp_asdf_estimate_t heard;
    if (mcp_asdf_decode_estimate(&heard, run->options.node.estimate.subject, frame) == MCP_ASDF_FRAME_OK &&
        conflicts_hear(&run->conflicts, own, &heard)) {
        (void)fprintf(stderr, "mcp_asdf_node: %s: %u; give one of them another\n",
                      heard.node == own ? "another node sends under this node's own id"
                                        : "two nodes send under one id",
                      heard.node);
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
    if (ticks == run->options.ticks) {
        end(run, "ticks", run->status);
    }
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
            note_sender(run, &frame);
            node_hear(&run->node, &frame);
            note_progress(run);
        }
    }
    if (event == BUS_CLOSED) {
        end(run, "bus closed", EXIT_FAILURE);
    }
    run->node.health = run->bus.health;
}

static void settle(run_t *run)
{
    if (!run->node.is_settled) {
        node_settle(&run->node);
        note_progress(run);
    }
}

/* A tick lasts until the next begins: what is heard meanwhile belongs to its round. */
static void tick(run_t *run)
{
    settle(run);
    if (run->ended != NULL) {
        return;
    }
    const mcp_asdf_action_t seen = source_next(&run->source);
    if (run->source.odd != 0) {
        (void)fprintf(stderr, "mcp_asdf_node: character %lu of %s is no observation; write 0, 1 or -\n",
                      (unsigned long)run->source.taken + 1, run->source.path);
        end(run, "observations not valid", EXIT_FAILURE);
    } else if (run->source.has_ended && seen == MCP_ASDF_OBSERVE_NONE) {
        end(run, "observations", run->status);
    } else {
        node_observe(&run->node, seen);
    }
}

/* Sleep until there is a frame, a tick is due, or a signal comes. */
static void wait_for_work(run_t *run)
{
    const bool is_joined = run->bus.fd >= 0, in_lockstep = run->options.node.lockstep;
    struct pollfd bus = {.fd = run->bus.fd, .events = POLLIN}; /* one below 0 is not waited for */
    int64_t until = in_lockstep ? INT64_MAX : run->clock.next;
    if (!is_joined && run->reopening.next < until) {
        until = run->reopening.next;
    }
    const int64_t now = ticker_now(), left = until > now ? until - now : 0;
    const struct timespec timeout = {.tv_sec = (time_t)(left / TICKER_SECOND),
                                     .tv_nsec = (long)(left % TICKER_SECOND)};
    (void)ppoll(&bus, 1, in_lockstep && is_joined ? NULL : &timeout, &run->when_waiting);
}

static void run_until_ended(run_t *run)
{
    const bool in_lockstep = run->options.node.lockstep;
    run->reopening = ticker_start(TICKER_SECOND, ticker_now());
    run->clock = ticker_start(TICKER_SECOND / run->options.node.ticks_per_second, ticker_now());
    node_start(&run->node);
    while (run->ended == NULL) {
        wait_for_work(run);
        if (run->bus.fd < 0 && ticker_is_due(&run->reopening, ticker_now())) {
            (void)bus_open(&run->bus);
        }
        hear(run);
        if (run->ended == NULL && !in_lockstep && ticker_is_due(&run->clock, ticker_now())) {
            tick(run);
        }
        if (run->ended == NULL && is_interrupted) {
            end(run, "signal", run->status);
        }
    }
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
    bus_close(&run.bus);
    const bool is_told =
        summary_print(run.ended, &run.node, &run.bus, &run.source, &run.clock, &run.conflicts);
    return is_told ? run.status : EXIT_FAILURE;
}
