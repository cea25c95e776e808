/* Setting up a run; run.h is the manual. */
#include "image.h"
#include "run.h"

#include <errno.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

static void fail(const char *what, const char *which, const char *why, const char *fix)
{
    (void)fprintf(stderr, "mcp_asdf_node: %s %s: %s; %s\n", what, which, why, fix);
    exit(EXIT_USAGE);
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

static void restore(const run_t *run, member_t *member)
{
    char name[PATH_MAX];
    const char *path = options_state(name, &run->options, member->settings.id);
    node_t *node = &member->node;
    switch (image_load(path, &node->robot, &node->config, member->settings.id)) {
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

/* Frames of robots in this process do not come back from the bus: the others get their estimates here, as the
 * kernel's filter lets those of strangers through. */
static bool speak(void *context, const mcp_asdf_frame_t *frame)
{
    const member_t *speaker = context;
    run_t *run = speaker->run;
    if (!bus_send(&run->bus, frame)) {
        return false;
    }
    if ((frame->id & MCP_ASDF_FRAME_MASK) == MCP_ASDF_FRAME_FILTER(speaker->settings.estimate.subject)) {
        for (unsigned i = 0; i < run->options.robots; ++i) {
            if (&run->members[i] != speaker) {
                node_hear(&run->members[i].node, frame);
            }
        }
    }
    return true;
}

static void set_up_member(run_t *run, member_t *member, uint8_t id)
{
    const node_output_t output = {speak, member};
    member->run = run;
    member->settings = run->options.node;
    member->settings.id = id;
    if (node_init(&member->node, &member->settings, output) != MCP_ASDF_OK) {
        fail("cannot make the robot", "of these options", "refused by the firmware", "see --help");
    }
    if (run->options.state != NULL) {
        restore(run, member);
    }
}

void run_set_up(run_t *run)
{
    const options_t *options = &run->options;
    run->bus.name = options->interface;
    run->bus.receive_buffer = (int)options->receive_buffer;
    run->bus.subjects[0] = options->node.estimate.subject;
    run->bus.subjects[1] = (options->node.lockstep ? options->node.command : options->node.estimate).subject;
    run->source.is_sensor = options->sensor != NULL;
    run->source.robots = options->robots;
    run->source.path = options->sensor != NULL ? options->sensor : options->observations;
    for (unsigned i = 0; i < options->robots; ++i) {
        set_up_member(run, &run->members[i], (uint8_t)(options->node.id + i));
    }
    if (run->source.path != NULL) {
        const int error = source_open(&run->source);
        if (error != 0) {
            fail("cannot open", run->source.path, strerror(error), "choose a file that can be read");
        }
    }
    join(&run->bus);
}
