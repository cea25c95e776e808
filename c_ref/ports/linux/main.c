/* mcp_asdf_node: a robot on a CAN bus under Linux. docs/platforms/linux.md is the manual. */
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

/* Packets that are received in a row, so that a flood of frames cannot keep the node from its ticks. */
#define PACKETS_IN_A_ROW 256
#define NS_PER_SECOND INT64_C(1000000000)

/* A timer that expires periodically. Times are nanoseconds of the monotonic clock.
 *   period           from one expiry to the next
 *   next_expiry      the next one
 *   worst_lateness   longest time from an expiry until has_expired() noticed it
 *   skipped          expiries that were left out: one that is noticed a period late or more is not made up
 *                    for in a burst */
typedef struct {
    int64_t period, next_expiry, worst_lateness;
    uint32_t skipped;
} periodic_timer_t;

/* Everything about the run of this program.
 *   senders             the node's memory of its neighbours
 *   handled_ticks       ticks whose end handle_end_of_tick() has handled
 *   tick_timer          control ticks; not used in lockstep
 *   reopen_timer        attempts to open a closed bus again
 *   start_timer         repetitions of the first heartbeat
 *   signals_when_idle   signal mask while waiting, see catch_signals()
 *   end_reason          why the run has ended; NULL while it goes on
 *   save_error          errno of the last failure to save the state, or 0
 *   exit_status         status with which the program will end */
typedef struct {
    options_t options;
    node_t node;
    node_sender_t senders[MCP_ASDF_MAX_ID + 1];
    uint32_t handled_ticks;
    bus_t bus;
    source_t source;
    periodic_timer_t tick_timer, reopen_timer, start_timer;
    sigset_t signals_when_idle;
    const char *end_reason;
    int save_error;
    int exit_status;
} run_t;

/* ---- Signals ---------------------------------------------------------------------------------------- */

static volatile sig_atomic_t is_interrupted;

/* Signal handler: only note the signal, as little else is allowed in one. */
static void handle_signal(int signal)
{
    (void)signal;
    is_interrupted = 1;
}

/* Handle the signals that end a program, and block them except while the program waits, so that none is
 * missed between a check of is_interrupted and the wait. */
static void catch_signals(run_t *run)
{
    static const int ending_signals[] = {SIGINT, SIGTERM, SIGHUP};
    const struct sigaction action = {.sa_handler = handle_signal};
    struct sigaction old_action;
    sigset_t blocked_signals;
    (void)sigemptyset(&blocked_signals);
    (void)sigprocmask(SIG_BLOCK, NULL, &run->signals_when_idle);
    for (size_t i = 0; i < sizeof ending_signals / sizeof ending_signals[0]; ++i) {
        const int signal = ending_signals[i];
        (void)sigaddset(&blocked_signals, signal);
        (void)sigdelset(&run->signals_when_idle, signal);
        /* A signal that this program was started to ignore (nohup, a shell's background) stays ignored. */
        if (sigaction(signal, NULL, &old_action) == 0 && old_action.sa_handler != SIG_IGN) {
            (void)sigaction(signal, &action, NULL);
        }
    }
    (void)sigprocmask(SIG_BLOCK, &blocked_signals, NULL);
}

/* ---- Setting up ------------------------------------------------------------------------------------- */

/* End the program with a message: what it cannot do, with which value, the reason, and the fix. */
static void fail(const char *action, const char *value, const char *reason, const char *fix)
{
    (void)fprintf(stderr, "mcp_asdf_node: %s %s: %s; %s\n", action, value, reason, fix);
    exit(EXIT_USAGE);
}

/* Open the bus, or end the program with a message that names the fix. */
static void open_bus(bus_t *bus)
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

/* Initialise run->node, which counts jumps of its neighbours' alpha, and restore its robot from the state's
 * file if there is one. Ends the program with a message on failure. */
static void set_up_node(run_t *run)
{
    const options_t *options = &run->options;
    const node_output_t output = {bus_send, &run->bus};
    if (node_init(&run->node, &options->node, output) != MCP_ASDF_OK) {
        /* Prints: cannot make the robot of these options: refused by the firmware; see --help. */
        fail("cannot make the robot", "of these options", "refused by the firmware", "see --help");
    }
    run->node.senders = run->senders; /* without such memory the node would count no jumps */
    if (options->state != NULL) {
        const char *reason = state_load(options->state, &run->node.robot, &run->node.config);
        if (reason != NULL) {
            fail("cannot use the state", options->state, reason,
                 "choose another --state, or move this one away");
        }
    }
}

/* Open run->source, from which a node that is not in lockstep takes an observation in each tick: with
 * --sensor a sensor's file that is read anew each time, with --observations a stream that is read on. Ends
 * the program with a message if it cannot be opened. */
static void set_up_source(run_t *run)
{
    const options_t *options = &run->options;
    /* options_read() has seen to it that there is exactly one of the two. */
    run->source.is_sensor = options->sensor != NULL;
    run->source.path = options->sensor != NULL ? options->sensor : options->observations;
    const int error = source_open(&run->source);
    if (error != 0) {
        fail("cannot open", run->source.path, strerror(error), "choose a file that can be read");
    }
}

/* Set up run->bus as the options say, and open it: its name, network and buffer, and the subjects that it
 * receives. Ends the program with a message on failure. */
static void set_up_bus(run_t *run)
{
    const options_t *options = &run->options;
    const node_settings_t *node = &options->node;
    run->bus.name = options->interface;
    run->bus.group.network = options->network;
    run->bus.group.hop_limit = (int)options->hop_limit;
    run->bus.receive_buffer = (int)options->receive_buffer;
    run->bus.subjects[0] = node->estimate_format.subject;
    /* Commands are received in lockstep only; else both subjects are the same. */
    run->bus.subjects[1] = (node->lockstep ? node->command_format : node->estimate_format).subject;
    open_bus(&run->bus);
}

/* ---- The clock -------------------------------------------------------------------------------------- */

/* Returns the time in nanoseconds since some moment in the past; nobody sets this clock back. */
static int64_t now_ns(void)
{
    struct timespec now;
    (void)clock_gettime(CLOCK_MONOTONIC, &now);
    return (int64_t)now.tv_sec * NS_PER_SECOND + now.tv_nsec;
}

/* Whether a timer has expired since the last call. If so, sets the next expiry after `now`, and records how
 * late the call is; if several periods have passed, all expiries but one count as skipped. */
static bool has_expired(periodic_timer_t *timer, int64_t now)
{
    const int64_t lateness = now - timer->next_expiry;
    if (lateness < 0) {
        return false;
    }
    if (lateness > timer->worst_lateness) {
        timer->worst_lateness = lateness;
    }
    const int64_t more_expiries = lateness / timer->period; /* after the one that is noticed now */
    timer->skipped += (uint32_t)more_expiries;
    timer->next_expiry += (more_expiries + 1) * timer->period;
    return true;
}

/* ---- Running ---------------------------------------------------------------------------------------- */

/* Let run_until_end() return, for a reason that the summary shows; the program will end with exit_status. */
static void end_run(run_t *run, const char *reason, int exit_status)
{
    run->end_reason = reason;
    run->exit_status = exit_status;
}

/* Save the state. A failure must not stop the robot: the state saved last stays, a message is printed once
 * for each reason, and the program will end with status 1. */
static void save_state(run_t *run)
{
    const int error = state_save(run->options.state, &run->node.robot);
    if (error != 0 && error != run->save_error) {
        (void)fprintf(stderr, "mcp_asdf_node: cannot save the state %s: %s; going on\n", run->options.state,
                      strerror(error));
    }
    if (error != 0) {
        run->save_error = error;
        run->exit_status = EXIT_FAILURE;
    }
}

/* Handle the end of a tick, if one has ended since the last call: save the state if it is time, and end the
 * run after its last tick. */
static void handle_end_of_tick(run_t *run)
{
    const uint32_t ticks = run->node.ticks, save_period = run->options.save_period;
    if (!run->node.is_settled || ticks == run->handled_ticks) {
        return;
    }
    run->handled_ticks = ticks;
    if (run->options.state != NULL && save_period != 0 && ticks % save_period == 0) {
        save_state(run);
    }
    if (run->options.ticks != 0 && ticks == run->options.ticks) {
        end_run(run, "ticks", run->exit_status);
    }
}

/* Pass `frame` to the node, and print a warning at the first frame under the node's own id. In lockstep the
 * frame may be a command that ends a tick, so that handle_end_of_tick() is called after every frame: it may
 * save the state, and end the run. */
static void handle_frame(run_t *run, const mcp_asdf_frame_t *frame)
{
    const bool had_no_collision = run->node.counts.id_collisions == 0;
    node_handle_frame(&run->node, frame);
    if (had_no_collision && run->node.counts.id_collisions != 0) {
        (void)fprintf(stderr,
                      "mcp_asdf_node: another node sends under this node's own id: %u; "
                      "give one of them another\n",
                      run->options.node.id);
    }
    handle_end_of_tick(run);
}

/* Receive and handle the packets that are waiting, PACKETS_IN_A_ROW at most, and pass the health of the bus
 * to the node. Ends the run if the bus has been closed for good. */
static void receive_frames(run_t *run)
{
    mcp_asdf_frame_t frame;
    bus_event_t event = BUS_FRAME;
    for (int i = 0; i < PACKETS_IN_A_ROW && run->end_reason == NULL && run->bus.fd >= 0; ++i) {
        event = bus_receive(&run->bus, &frame);
        if (event == BUS_NOTHING || event == BUS_CLOSED) {
            break;
        }
        run->node.health = run->bus.health; /* before the frame, which may be answered with a heartbeat */
        if (event == BUS_FRAME) {
            handle_frame(run, &frame);
        }
    }
    if (event == BUS_CLOSED) {
        end_run(run, "bus closed", EXIT_FAILURE);
    }
    run->node.health = run->bus.health; /* also without a packet: a bus opened again is nominal */
}

/* Read the tick's observation, MCP_ASDF_OBSERVE_NONE if there is none. Returns false, and ends the run with a
 * message, if the source is at its end or has failed. */
static bool read_observation(run_t *run, mcp_asdf_action_t *observation)
{
    source_t *source = &run->source;
    const bool is_read = source_next(source, observation);
    if (source->is_invalid) {
        (void)fprintf(stderr, "mcp_asdf_node: character %lu of %s is no observation; write 0, 1 or -\n",
                      (unsigned long)source->characters_read + 1, source->path);
        end_run(run, "observations not valid", EXIT_FAILURE);
    } else if (source->error != 0) {
        (void)fprintf(stderr, "mcp_asdf_node: cannot read %s: %s\n", source->path, strerror(source->error));
        end_run(run, "observations not readable", EXIT_FAILURE);
    } else if (source->has_ended && !is_read) {
        end_run(run, "observations", run->exit_status);
    }
    return run->end_reason == NULL;
}

/* End the last tick and begin the next. So a tick lasts until the next one begins, and the frames that arrive
 * in between belong to its round. */
static void run_tick(run_t *run)
{
    mcp_asdf_action_t observation;
    if (!run->node.is_settled) {
        node_settle(&run->node);
        handle_end_of_tick(run);
    }
    if (run->end_reason == NULL && read_observation(run, &observation)) {
        node_observe(&run->node, observation);
    }
}

/* Returns the time of what the node has to do next without a packet: the next tick, an attempt to open a
 * closed bus again, or in lockstep before the first tick the next heartbeat. Returns INT64_MAX if there is
 * nothing: in lockstep a frame begins the next tick. */
static int64_t next_wake_time(const run_t *run)
{
    const bool is_bus_open = run->bus.fd >= 0;
    int64_t wake_time = INT64_MAX;
    if (!run->options.node.lockstep) {
        wake_time = run->tick_timer.next_expiry;
    } else if (run->node.ticks == 0) {
        wake_time = run->start_timer.next_expiry;
    }
    if (!is_bus_open && run->reopen_timer.next_expiry < wake_time) {
        wake_time = run->reopen_timer.next_expiry;
    }
    return wake_time;
}

/* Sleep until a packet arrives, a signal comes, or it is the time of next_wake_time(). */
static void wait_for_event(run_t *run)
{
    struct pollfd bus = {.fd = run->bus.fd, .events = POLLIN}; /* ppoll() ignores a negative fd */
    const int64_t wake_time = next_wake_time(run);
    const int64_t now = now_ns();
    const int64_t duration = wake_time > now ? wake_time - now : 0;
    const struct timespec timeout = {.tv_sec = (time_t)(duration / NS_PER_SECOND),
                                     .tv_nsec = (long)(duration % NS_PER_SECOND)};
    const struct timespec *const timeout_if_any = wake_time == INT64_MAX ? NULL : &timeout;
    (void)ppoll(&bus, 1, timeout_if_any, &run->signals_when_idle);
}

/* Let all timers expire now and periodically from now on. */
static void start_timers(run_t *run)
{
    const int64_t tick_duration = NS_PER_SECOND / run->options.node.ticks_per_second;
    const int64_t now = now_ns();
    run->tick_timer = (periodic_timer_t){.period = tick_duration, .next_expiry = now};
    run->reopen_timer = (periodic_timer_t){.period = NS_PER_SECOND, .next_expiry = now};
    run->start_timer = (periodic_timer_t){.period = NS_PER_SECOND, .next_expiry = now};
}

/* Run the node until its last tick, the end of its observations, a signal, or a failure. */
static void run_until_end(run_t *run)
{
    const bool in_lockstep = run->options.node.lockstep;
    start_timers(run);
    while (run->end_reason == NULL) {
        /* The first heartbeat is repeated until the first tick: whoever commands this node in lockstep may
         * have joined the bus later. */
        if (run->node.ticks == 0 && has_expired(&run->start_timer, now_ns())) {
            node_start(&run->node);
        }
        wait_for_event(run);
        if (run->bus.fd < 0 && has_expired(&run->reopen_timer, now_ns())) {
            (void)bus_open(&run->bus);
        }
        receive_frames(run);
        if (run->end_reason == NULL && !in_lockstep && has_expired(&run->tick_timer, now_ns())) {
            run_tick(run);
        }
        if (run->end_reason == NULL && is_interrupted) {
            end_run(run, "signal", run->exit_status);
        }
    }
}

/* ---- The summary: a line of JSON, whose members docs/platforms/linux.md explains ---- */

/* Print a member of the summary, a number. */
static void print_number(const char *name, uint64_t value)
{
    (void)printf(", \"%s\": %" PRIu64, name, value);
}

/* Print the summary; estimates and accuracies are the integers of mcp_asdf.h. Returns whether the standard
 * output accepted it. */
static bool print_summary(const run_t *run)
{
    const mcp_asdf_t *robot = &run->node.robot;
    const mcp_asdf_counters_t counters = mcp_asdf_counters(robot);
    const node_counts_t *counts = &run->node.counts;
    const bus_counts_t *bus = &run->bus.counts;
    (void)printf("{\"id\": %u, \"ended\": \"%s\"", run->options.node.id, run->end_reason);
    print_number("ticks", run->node.ticks);
    print_number("t", mcp_asdf_t_count(robot));
    print_number("n", mcp_asdf_n_count(robot));
    print_number("b_hat", mcp_asdf_b_hat(robot));
    print_number("x_hat", mcp_asdf_x_hat(robot));
    print_number("alpha", mcp_asdf_alpha(robot));
    print_number("x_bar", mcp_asdf_x_bar(robot));
#if MCP_ASDF_WITH_ASDF
    print_number("beta", mcp_asdf_beta(robot));
#endif
    print_number("x", mcp_asdf_x(robot));
    print_number("accepted", counters.accepted);
    print_number("repeated", counters.repeated);
    print_number("rejected", counters.rejected);
    print_number("tests", counters.tests);
    print_number("updates", counters.updates);
    print_number("estimates", counts->estimates);
    print_number("heartbeats", counts->heartbeats);
    print_number("telemetry", counts->telemetry);
    print_number("unsent", counts->unsent_frames);
    print_number("heard", counts->received_estimates);
    print_number("unknown", counts->ignored_estimates);
    print_number("jumps", counts->alpha_jumps);
    print_number("collisions", counts->id_collisions);
    print_number("refused", counts->rejected_frames);
    print_number("others", counts->other_frames);
    print_number("obeyed", counts->followed_commands);
    print_number("disobeyed", counts->refused_commands);
    print_number("unsettled", counts->unsettled_ticks);
    (void)printf(", \"filtered_by\": \"%s\"", run->bus.is_filtered ? "kernel" : "node");
    print_number("received", bus->received);
    print_number("overflowed", bus->overflowed);
    print_number("queue_full", bus->queue_full);
    print_number("error_frames", bus->error_frames);
    print_number("bus_off", bus->bus_off);
    print_number("downs", bus->downs);
    print_number("odd_packets", bus->odd_packets);
    print_number("missing", run->source.missing);
    print_number("skipped", run->tick_timer.skipped);
    print_number("worst_lateness_us", (uint64_t)run->tick_timer.worst_lateness / 1000);
    (void)printf("}\n");
    return fflush(stdout) == 0 && ferror(stdout) == 0;
}

/* Set up, run, save the state, and print the summary. Status 0: the run ended as it should; 1: the bus, the
 * observations or the saving failed; 2: the program could not start. */
int main(int argument_count, char *arguments[])
{
    static run_t run;
    options_read(&run.options, argument_count, arguments);
    catch_signals(&run);
    set_up_node(&run);
    if (!run.options.node.lockstep) {
        set_up_source(&run);
    }
    set_up_bus(&run);
    run_until_end(&run);
    if (run.options.state != NULL) {
        save_state(&run);
    }
    const bool is_printed = print_summary(&run);
    bus_close(&run.bus);
    return is_printed ? run.exit_status : EXIT_FAILURE;
}
