/* Reading the command line; options.h is the manual. */
#include "options.h"

#include <errno.h>
#include <getopt.h>
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#define LARGEST UINT32_MAX

extern const uint32_t MCP_ASDF_NODE_TABLE[];

/* Every option: its index, name, what stands for it if it is not given, and its range. Numbers come first,
 * then texts, then what takes no argument. */
#define OPTIONS(X)                                                                                           \
    X(COMMS_PERIOD, "comms-period", "1", 1, LARGEST)                                                         \
    X(FILTER_PERIOD, "filter-period", "1000", 1, LARGEST)                                                    \
    X(MEMORY, "memory", "2147483648", MCP_ASDF_MEMORY_MIN, MCP_ASDF_MEMORY_MAX)                              \
    X(RATE, "steps-per-second", "10", 1, 1000)                                                               \
    X(TICKS, "steps", "0", 0, LARGEST)                                                                       \
    X(TELEMETRY_PERIOD, "telemetry-period", "0", 0, LARGEST)                                                 \
    X(SUBJECT, "subject", "3000", 0, MCP_ASDF_SUBJECT_MAX)                                                   \
    X(TELEMETRY_SUBJECT, "telemetry-subject", "3001", 0, MCP_ASDF_SUBJECT_MAX)                               \
    X(COMMAND_SUBJECT, "command-subject", "3002", 0, MCP_ASDF_SUBJECT_MAX)                                   \
    X(RECEIVE_BUFFER, "receive-buffer", "0", 0, INT32_MAX)                                                   \
    X(SAVE_PERIOD, "save-period", "0", 0, LARGEST)                                                           \
    X(HOP_LIMIT, "hop-limit", "1", 0, 255)                                                                   \
    X(ID, "id", NULL, 0, MCP_ASDF_MAX_ID)                                                                    \
    X(ALLOW, "allow", NULL, 0, 0)                                                                            \
    X(INTERFACE, "interface", NULL, 0, 0)                                                                    \
    X(NETWORK, "network", NULL, 0, 0)                                                                        \
    X(B_HAT, "b-hat", "0.95", 0, 0)                                                                          \
    X(FILTER, "filter", "asdf-plus", 0, 0)                                                                   \
    X(ACTIVATION, "activation", "adaptive", 0, 0)                                                            \
    X(OBSERVATIONS, "observations", NULL, 0, 0)                                                              \
    X(SENSOR, "sensor", NULL, 0, 0)                                                                          \
    X(STATE, "state", NULL, 0, 0)                                                                            \
    X(LOCKSTEP, "lockstep", NULL, 0, 0)                                                                      \
    X(HELP, "help", NULL, 0, 0)                                                                              \
    X(VERSION, "version", NULL, 0, 0)

#define INDEX(index, ...) index,
#define ROW(index, ...) {__VA_ARGS__},

enum option_index { OPTIONS(INDEX) ALL };

static const struct {
    const char *name, *usual;
    uint32_t least, most;
} table[ALL] = {OPTIONS(ROW)};

#define WITH_ARGUMENT LOCKSTEP

/* ---- Help ------------------------------------------------------------------------------------------- */

static const char usage[] =
    "A robot on a CAN bus: mcp_asdf_node --interface can0 --id 7 --sensor /sys/class/gpio/gpio48/value\n"
    "\n"
    "  --interface NAME       can0, vcan0, ...; udp:GROUP:PORT, multicast for robots without CAN, such as\n"
    "                         udp:239.74.163.2:43113 or "
    "udp:[ff15:7079:7468:6f6e:6465:6d6f:6d63:6173]:43113;\n"
    "                         or unix:PATH, a socket that passes frames on\n"
    "  --network NAME         what leads to the group, such as wlan0 (the kernel's route)\n"
    "  --hop-limit N          networks that a datagram may cross, 0 (none: this computer) to 255 (1)\n"
    "  --id N                 of robot and node, 0 to 127\n"
    "  --allow IDS            take estimates of these ids only, such as 0-19+30 (all)\n"
    "  --b-hat P              how often the sensor is taken to be right, 2^-20 to 1 - 2^-20 (0.95)\n"
    "  --filter FILTER        how it recalibrates: none, asdf-plus, robust (asdf-plus)\n"
    "  --activation WHEN      if the test rejects or in every period: adaptive, always (adaptive)\n"
    "  --comms-period STEPS   between broadcasts (1)\n"
    "  --filter-period STEPS  between tests, a multiple of the former (1000)\n"
    "  --memory N             observations at which counts are halved, a multiple of 4, 64 to 2^31 (2^31)\n"
    "\n"
    "Clock and observations, one of:\n"
    "  --lockstep             do what command frames say\n"
    "  --observations FILE    in real time: 0 white, 1 black, - nothing seen, one of these in each step;\n"
    "                         - is the standard input\n"
    "  --sensor FILE          in real time, read anew in every step: 0 white, 1 black\n"
    "\n"
    "  --steps-per-second N   1 to 1000 (10); in lockstep of simulated time\n"
    "  --steps N              end after so many (0: no limit)\n"
    "  --telemetry-period STEPS  between telemetry frames (0: none; in lockstep every step)\n"
    "  --subject N, --telemetry-subject N, --command-subject N  0 to 6143 (3000, 3001, 3002)\n"
    "  --receive-buffer BYTES of the kernel (0: its default)\n"
    "  --state FILE           go on from there, and save there at the end\n"
    "  --save-period STEPS    save there in between, too (0: no)\n"
    "\n"
    "Ends with a line of JSON. Status 0: by --steps, the end of observations, SIGINT or "
    "SIGTERM;\n"
    "1: the bus or the observations failed; 2: it could not start.\n";

/* ---- Values ----------------------------------------------------------------------------------------- */

static void fail(enum option_index which, const char *value, const char *fix)
{
    (void)fprintf(stderr, "mcp_asdf_node: --%s is %s; %s\n", table[which].name, value, fix);
    exit(EXIT_USAGE);
}

static uint32_t number(const char *const given[ALL], enum option_index which)
{
    const char *const text = given[which];
    char *end = NULL;
    errno = 0;
    const unsigned long long value = strtoull(text, &end, 10);
    if (errno != 0 || end == text || *end != '\0' || strchr(text, '-') != NULL ||
        value < table[which].least || value > table[which].most) {
        char fix[64];
        (void)snprintf(fix, sizeof fix, "choose a whole number, %lu to %lu",
                       (unsigned long)table[which].least, (unsigned long)table[which].most);
        fail(which, text, fix);
    }
    return (uint32_t)value;
}

/* Read an id; returns what follows it, or NULL if there is none. */
static const char *read_id(const char *text, unsigned long *id)
{
    char *end = NULL;
    *id = strtoul(text, &end, 10);
    return *text >= '0' && *text <= '9' && *id <= MCP_ASDF_MAX_ID ? end : NULL;
}

/* Mark all ids but those of `text`, such as 0-19+30. */
static void ignore_others(uint8_t ignore[], const char *text)
{
    const char *at = text;
    memset(ignore, 0xFF, (MCP_ASDF_MAX_ID + 1) / 8);
    do {
        unsigned long first = 0, last = 0;
        at = read_id(at, &first);
        last = first;
        if (at != NULL && *at == '-') {
            at = read_id(at + 1, &last);
        }
        if (at == NULL || last < first || (*at != '+' && *at != '\0')) {
            fail(ALLOW, text, "give ids, 0 to 127, such as 0-19+30");
        }
        for (; first <= last; ++first) {
            ignore[first / 8] &= (uint8_t)~(1U << first % 8);
        }
    } while (*at++ == '+');
}

static uint32_t b_hat(const char *text)
{
    const double unit = 4294967296.0;
    char *end = NULL;
    const double value = strtod(text, &end) * unit;
    if (end == text || *end != '\0' || !(value >= MCP_ASDF_B_HAT_MIN && value <= MCP_ASDF_B_HAT_MAX)) {
        fail(B_HAT, text, "choose 2^-20 to 1 - 2^-20, for example 0.95");
    }
    return (uint32_t)llrint(value);
}

static bool is_given(const char *const given[ALL], enum option_index which, const char *word)
{
    return strcmp(given[which], word) == 0;
}

static uint8_t filter(const char *const given[ALL])
{
    const bool always = is_given(given, ACTIVATION, "always");
    if (!always && !is_given(given, ACTIVATION, "adaptive")) {
        fail(ACTIVATION, given[ACTIVATION], "choose adaptive or always");
    }
    if (is_given(given, FILTER, "none")) {
        return MCP_ASDF_OFF;
    }
    if (is_given(given, FILTER, "robust")) {
        return MCP_ASDF_ROBUST;
    }
    if (!is_given(given, FILTER, "asdf-plus")) {
        fail(FILTER, given[FILTER], "choose none, asdf-plus or robust");
    }
    return always ? MCP_ASDF_ALWAYS : MCP_ASDF_ADAPTIVE;
}

/* ---- What is given ---------------------------------------------------------------------------------- */

/* Remember what is given for each option; of one given twice the last counts. */
static void collect(const char *given[ALL], int count, char *const arguments[])
{
    enum { FIRST = 256 }; /* beyond what getopt_long() returns by itself */
    struct option known[ALL + 1] = {0};
    for (int i = 0; i < ALL; ++i) {
        given[i] = table[i].usual;
        known[i].name = table[i].name;
        known[i].has_arg = i < WITH_ARGUMENT ? required_argument : no_argument;
        known[i].val = FIRST + i;
    }
    for (int found = 0; (found = getopt_long(count, arguments, "", known, NULL)) != -1;) {
        if (found < FIRST) {
            exit(EXIT_USAGE); /* getopt_long() has said why */
        }
        given[found - FIRST] = optarg != NULL ? optarg : "";
    }
    if (optind < count) {
        (void)fprintf(stderr, "mcp_asdf_node: %s belongs to no option; see --help\n", arguments[optind]);
        exit(EXIT_USAGE);
    }
}

static void answer_questions(const char *const given[ALL])
{
    if (given[HELP] != NULL) {
        (void)fputs(usage, stdout);
        exit(EXIT_SUCCESS);
    }
    if (given[VERSION] != NULL) {
        (void)printf("mcp_asdf_node %d.%d.%d\n", MCP_ASDF_VERSION_MAJOR, MCP_ASDF_VERSION_MINOR,
                     MCP_ASDF_VERSION_PATCH);
        exit(EXIT_SUCCESS);
    }
}

/* ---- Checks that need more than one option ---------------------------------------------------------- */

static void check_needed(const char *const given[ALL])
{
    if (given[INTERFACE] == NULL) {
        fail(INTERFACE, "missing", "see --help");
    }
    if (given[ID] == NULL) {
        fail(ID, "missing", "see --help");
    }
    if ((given[LOCKSTEP] != NULL) + (given[OBSERVATIONS] != NULL) + (given[SENSOR] != NULL) != 1) {
        fail(LOCKSTEP, given[LOCKSTEP] == NULL ? "not given" : "given",
             "choose one of --lockstep, --observations, --sensor");
    }
}

static void check_values(const node_settings_t *node, const char *const given[ALL])
{
    const uint16_t estimate = node->estimate.subject, telemetry = node->telemetry.subject;
    const uint16_t command = node->command.subject;
    if (node->filter_period % node->comms_period != 0) {
        fail(FILTER_PERIOD, given[FILTER_PERIOD], "choose a multiple of --comms-period");
    }
    if (node->memory % 4 != 0) {
        fail(MEMORY, given[MEMORY], "choose a multiple of 4");
    }
    if (estimate == telemetry || estimate == command || telemetry == command) {
        fail(SUBJECT, given[SUBJECT],
             "choose three different subjects for estimates, telemetry and commands");
    }
}

static void check_multicast(const char *const given[ALL])
{
    static const enum option_index only[] = {NETWORK, HOP_LIMIT};
    for (size_t i = 0; i < sizeof only / sizeof only[0]; ++i) {
        if (given[only[i]] != table[only[i]].usual && strncmp(given[INTERFACE], "udp:", 4) != 0) {
            fail(only[i], given[only[i]], "leave it out, or choose an --interface udp:GROUP:PORT");
        }
    }
}

/* ---- All of it -------------------------------------------------------------------------------------- */

static node_settings_t node_settings(const char *const given[ALL])
{
    node_settings_t settings = {.table = MCP_ASDF_NODE_TABLE,
                                .comms_period = number(given, COMMS_PERIOD),
                                .filter_period = number(given, FILTER_PERIOD),
                                .memory = number(given, MEMORY),
                                .filter = filter(given),
                                .estimate = {(uint16_t)number(given, SUBJECT), 4},
                                .telemetry = {(uint16_t)number(given, TELEMETRY_SUBJECT), 6},
                                .command = {(uint16_t)number(given, COMMAND_SUBJECT), 3},
                                .b_hat = b_hat(given[B_HAT]),
                                .ticks_per_second = number(given, RATE),
                                .telemetry_period = number(given, TELEMETRY_PERIOD),
                                .id = (uint8_t)number(given, ID),
                                .lockstep = given[LOCKSTEP] != NULL};
    if (given[ALLOW] != NULL) {
        ignore_others(settings.ignore, given[ALLOW]);
    }
    return settings;
}

void options_read(options_t *options, int count, char *const arguments[])
{
    const char *given[ALL];
    collect(given, count, arguments);
    answer_questions(given);
    check_needed(given);
    const options_t read = {.node = node_settings(given),
                            .interface = given[INTERFACE],
                            .network = given[NETWORK],
                            .observations = given[OBSERVATIONS],
                            .sensor = given[SENSOR],
                            .state = given[STATE],
                            .save_period = number(given, SAVE_PERIOD),
                            .ticks = number(given, TICKS),
                            .receive_buffer = number(given, RECEIVE_BUFFER),
                            .hops = number(given, HOP_LIMIT)};
    check_multicast(given);
    check_values(&read.node, given);
    *options = read;
}
