/* mcp_asdf_node: robots on a CAN bus under Linux, one or many. docs/socketcan.md is the manual. */
#include "image.h"
#include "run.h"

#include <errno.h>
#include <poll.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <time.h>

#define MOST_PACKETS 256 /* taken in a row, so that a babbling node cannot keep us from ticking */

static volatile sig_atomic_t is_interrupted;

static void interrupt(int signal)
{
    (void)signal;
    is_interrupted = 1;
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
static void save(run_t *run, const member_t *member)
{
    char name[PATH_MAX];
    const char *path = options_state(name, &run->options, member->settings.id);
    const int error = image_save(path, &member->node.robot);
    if (error != 0 && error != run->save_error) {
        (void)fprintf(stderr, "mcp_asdf_node: cannot save the state %s: %s; going on\n", path,
                      strerror(error));
    }
    if (error != 0) {
        run->save_error = error;
        run->status = EXIT_FAILURE;
    }
}

static bool is_own(const run_t *run, uint8_t id)
{
    const uint8_t first = run->options.node.id;
    return id >= first && id - first < (int)run->options.robots;
}

static void note_sender(run_t *run, const mcp_asdf_frame_t *frame)
{
    mcp_asdf_estimate_t heard;
    if (mcp_asdf_decode_estimate(&heard, run->options.node.estimate.subject, frame) != MCP_ASDF_FRAME_OK) {
        return;
    }
    const uint8_t own = is_own(run, heard.node) ? heard.node : run->options.node.id;
    if (conflicts_hear(&run->conflicts, own, &heard)) {
        (void)fprintf(stderr, "mcp_asdf_node: %s: %u; give one of them another\n",
                      heard.node == own ? "another node sends under this node's own id"
                                        : "two nodes send under one id",
                      heard.node);
    }
}

/* Called after whatever may have ended a tick of a robot. */
static void note_progress(run_t *run, member_t *member)
{
    const uint32_t ticks = member->node.ticks, period = run->options.save_period;
    if (!member->node.is_settled || ticks == member->seen) {
        return;
    }
    member->seen = ticks;
    if (run->options.state != NULL && period != 0 && ticks % period == 0) {
        save(run, member);
    }
}

static void end_after_last_tick(run_t *run)
{
    unsigned done = 0;
    for (unsigned i = 0; i < run->options.robots; ++i) {
        done += run->members[i].seen == run->options.ticks;
    }
    if (run->options.ticks != 0 && done == run->options.robots) {
        end(run, "ticks", run->status);
    }
}

static void take(run_t *run, const mcp_asdf_frame_t *frame)
{
    note_sender(run, frame);
    for (unsigned i = 0; i < run->options.robots; ++i) {
        node_hear(&run->members[i].node, frame);
        note_progress(run, &run->members[i]);
    }
    end_after_last_tick(run);
}

static void note_health(run_t *run)
{
    for (unsigned i = 0; i < run->options.robots; ++i) {
        run->members[i].node.health = run->bus.health;
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
        note_health(run);
        if (event == BUS_FRAME) {
            take(run, &frame);
        }
    }
    if (event == BUS_CLOSED) {
        end(run, "bus closed", EXIT_FAILURE);
    }
    note_health(run);
}

static void settle(run_t *run)
{
    for (unsigned i = 0; i < run->options.robots; ++i) {
        if (!run->members[i].node.is_settled) {
            node_settle(&run->members[i].node);
            note_progress(run, &run->members[i]);
        }
    }
    end_after_last_tick(run);
}

/* Take an observation for each robot; returns whether the run goes on. */
static bool look(run_t *run, mcp_asdf_action_t seen[SOURCE_MOST_ROBOTS])
{
    source_t *source = &run->source;
    const bool has_come = source_next(source, seen);
    if (source->odd != 0) {
        (void)fprintf(stderr, "mcp_asdf_node: character %lu of %s is no observation; write 0, 1 or -\n",
                      (unsigned long)source->taken + 1, source->path);
        end(run, "observations not valid", EXIT_FAILURE);
    } else if (source->has_ended && !has_come) {
        end(run, "observations", run->status);
    }
    return run->ended == NULL;
}

/* A tick lasts until the next begins: what is heard meanwhile belongs to its round. */
static void tick(run_t *run)
{
    mcp_asdf_action_t seen[SOURCE_MOST_ROBOTS];
    settle(run);
    if (run->ended == NULL && look(run, seen)) {
        for (unsigned i = 0; i < run->options.robots; ++i) {
            node_observe(&run->members[i].node, seen[i]);
        }
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
    const int64_t now = now_ns(), left = until > now ? until - now : 0;
    const struct timespec timeout = {.tv_sec = (time_t)(left / SECOND), .tv_nsec = (long)(left % SECOND)};
    (void)ppoll(&bus, 1, in_lockstep && is_joined ? NULL : &timeout, &run->when_waiting);
}

static void run_until_ended(run_t *run)
{
    const bool in_lockstep = run->options.node.lockstep;
    run->reopening = (ticker_t){.period = SECOND, .next = now_ns()};
    run->clock = (ticker_t){.period = SECOND / run->options.node.ticks_per_second, .next = now_ns()};
    for (unsigned i = 0; i < run->options.robots; ++i) {
        node_start(&run->members[i].node);
    }
    while (run->ended == NULL) {
        wait_for_work(run);
        if (run->bus.fd < 0 && is_due(&run->reopening, now_ns())) {
            (void)bus_open(&run->bus);
        }
        hear(run);
        if (run->ended == NULL && !in_lockstep && is_due(&run->clock, now_ns())) {
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
    run_set_up(&run);
    run_until_ended(&run);
    bool is_told = true;
    for (unsigned i = 0; i < run.options.robots; ++i) {
        if (run.options.state != NULL) {
            save(&run, &run.members[i]);
        }
        is_told = summary_print(&run, &run.members[i].node) && is_told;
    }
    bus_close(&run.bus);
    return is_told ? run.status : EXIT_FAILURE;
}
