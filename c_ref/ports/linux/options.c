/* Reading the command line; options.h is the manual. */
#include "options.h"

#include <errno.h>
#include <getopt.h>
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

extern const uint32_t MCP_ASDF_NODE_TABLE[];

/* Nodes are often started alike on all robots, where the paper's filter would spoil healthy ones: it is for
 * robots whose sensors one doubts, and has to be asked for (docs/advice.md). */
#if MCP_ASDF_WITH_ROBUST
#define DEFAULT_FILTER "robust"
#else
#define DEFAULT_FILTER "none"
#endif

/* All options: index, name, default value or NULL, and for numbers the range. Options with an argument come
 * first, then those without. */
#define OPTIONS(X)                                                                                           \
    X(COMMS_PERIOD, "comms-period", "1", 1, UINT32_MAX)                                                      \
    X(FILTER_PERIOD, "filter-period", "1000", 1, UINT32_MAX)                                                 \
    X(MEMORY, "memory", "2147483648", MCP_ASDF_MEMORY_MIN, MCP_ASDF_MEMORY_MAX)                              \
    X(RATE, "steps-per-second", "10", 1, 1000)                                                               \
    X(TICKS, "steps", "0", 0, UINT32_MAX)                                                                    \
    X(TELEMETRY_PERIOD, "telemetry-period", "0", 0, UINT32_MAX)                                              \
    X(SUBJECT, "subject", "3000", 0, MCP_ASDF_SUBJECT_MAX)                                                   \
    X(TELEMETRY_SUBJECT, "telemetry-subject", "3001", 0, MCP_ASDF_SUBJECT_MAX)                               \
    X(COMMAND_SUBJECT, "command-subject", "3002", 0, MCP_ASDF_SUBJECT_MAX)                                   \
    X(RECEIVE_BUFFER, "receive-buffer", "1048576", 0, INT32_MAX)                                             \
    X(SAVE_PERIOD, "save-period", "0", 0, UINT32_MAX)                                                        \
    X(HOP_LIMIT, "hop-limit", "1", 0, 255)                                                                   \
    X(ID, "id", NULL, 0, MCP_ASDF_MAX_ID)                                                                    \
    X(ALLOW, "allow", NULL, 0, 0)                                                                            \
    X(INTERFACE, "interface", NULL, 0, 0)                                                                    \
    X(NETWORK, "network", NULL, 0, 0)                                                                        \
    X(B_HAT, "b-hat", "0.95", 0, 0)                                                                          \
    X(FILTER, "filter", DEFAULT_FILTER, 0, 0)                                                                \
    X(ACTIVATION, "activation", "adaptive", 0, 0)                                                            \
    X(OBSERVATIONS, "observations", NULL, 0, 0)                                                              \
    X(SENSOR, "sensor", NULL, 0, 0)                                                                          \
    X(STATE, "state", NULL, 0, 0)                                                                            \
    X(LOCKSTEP, "lockstep", NULL, 0, 0)                                                                      \
    X(HELP, "help", NULL, 0, 0)                                                                              \
    X(VERSION, "version", NULL, 0, 0)

#define OPTION_INDEX(index, ...) index,
#define OPTION_ROW(index, ...) {__VA_ARGS__},

enum option_index { OPTIONS(OPTION_INDEX) OPTION_COUNT };

static const struct {
    const char *name, *default_text;
    uint32_t minimum, maximum;
} option_table[OPTION_COUNT] = {OPTIONS(OPTION_ROW)};

#define FIRST_WITHOUT_ARGUMENT LOCKSTEP

/* Text of each option on the command line, or its default: "" for one without an argument that is there, NULL
 * for one that is missing and has no default. */
typedef const char *option_texts_t[OPTION_COUNT];

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
    "  --filter FILTER        how it recalibrates: none, asdf-plus, robust (" DEFAULT_FILTER ")\n"
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
    "  --receive-buffer BYTES for frames that wait in the kernel (0: its default, some 280 frames)\n"
    "  --state FILE           go on from there, and save there at the end\n"
    "  --save-period STEPS    save there in between, too (0: no)\n"
    "\n"
    "Ends with a line of JSON. Status 0: by --steps, the end of observations, SIGINT or "
    "SIGTERM;\n"
    "1: the bus or the observations failed; 2: it could not start.\n";

/* ---- Conversion of single options ------------------------------------------------------------------- */

/* End the program with a message that names the option, its value and the fix. */
static void fail(enum option_index option, const char *value, const char *fix)
{
    (void)fprintf(stderr, "mcp_asdf_node: --%s is %s; %s\n", option_table[option].name, value, fix);
    exit(EXIT_USAGE);
}

/* Returns the value of a numeric option. Ends the program if it is no whole number or out of the option's
 * range.
 */
static uint32_t parse_number(const option_texts_t texts, enum option_index option)
{
    const uint32_t minimum = option_table[option].minimum, maximum = option_table[option].maximum;
    const char *const text = texts[option];
    char *end = NULL;
    errno = 0;
    const unsigned long long value = strtoull(text, &end, 10);
    /* strtoull() would read -1 as a large number. */
    const bool has_minus = strchr(text, '-') != NULL;
    const bool is_number = errno == 0 && end != text && *end == '\0' && !has_minus;
    if (!is_number || value < minimum || value > maximum) {
        char fix[64];
        (void)snprintf(fix, sizeof fix, "choose a whole number, %lu to %lu", (unsigned long)minimum,
                       (unsigned long)maximum);
        fail(option, text, fix);
    }
    return (uint32_t)value;
}

/* Read an id at the beginning of a text. Returns the text behind it, or NULL if there is no id. */
static const char *parse_id(const char *text, unsigned long *id)
{
    char *end = NULL;
    *id = strtoul(text, &end, 10);
    /* strtoul() would accept a sign or a space, too. */
    const bool begins_with_digit = *text >= '0' && *text <= '9';
    return begins_with_digit && *id <= MCP_ASDF_MAX_ID ? end : NULL;
}

/* Set in a set of ids (bit id % 8 of byte id / 8) the bits of all ids but those in `list`, which has ids and
 * ranges with a plus between them, such as 0-19+30. Ends the program if the list is malformed. */
static void parse_allowed_senders(uint8_t ignored_senders[], const char *list)
{
    const char *position = list;
    memset(ignored_senders, 0xFF, (MCP_ASDF_MAX_ID + 1) / 8); /* all, until they are allowed */
    for (;;) { /* one id or range of the list, then the plus or the end behind it */
        unsigned long first_id = 0, last_id = 0;
        position = parse_id(position, &first_id);
        last_id = first_id; /* an id alone is a range of one */
        if (position != NULL && *position == '-') {
            position = parse_id(position + 1, &last_id);
        }
        const bool is_malformed =
            position == NULL || last_id < first_id || (*position != '+' && *position != '\0');
        if (is_malformed) {
            fail(ALLOW, list, "give ids, 0 to 127, such as 0-19+30"); /* ends the program */
        }
        for (unsigned long id = first_id; id <= last_id; ++id) {
            ignored_senders[id / 8] &= (uint8_t)~(1U << (id % 8));
        }
        if (*position == '\0') {
            return;
        }
        ++position; /* behind the plus */
    }
}

/* Convert an accuracy such as 0.95 to units of 2^-32. Ends the program if it is no number or out of range. */
static uint32_t parse_b_hat(const char *text)
{
    const double units_of_one = 4294967296.0; /* 2^32 */
    char *end = NULL;
    const double value = strtod(text, &end) * units_of_one;
    /* NaN is out of range, too, as comparisons with it are false. */
    const bool is_in_range = value >= MCP_ASDF_B_HAT_MIN && value <= MCP_ASDF_B_HAT_MAX;
    if (end == text || *end != '\0' || !is_in_range) {
        fail(B_HAT, text, "choose 2^-20 to 1 - 2^-20, for example 0.95");
    }
    return (uint32_t)llrint(value);
}

/* Whether an option has a certain value. */
static bool has_value(const option_texts_t texts, enum option_index option, const char *value)
{
    return strcmp(texts[option], value) == 0;
}

/* Returns the mcp_asdf_filter_t that --filter and --activation ask for. Ends the program if either is
 * unknown, and for the robust filter with the activation "always", which only the paper's filter, asdf-plus,
 * has. Without a filter the activation makes no difference. */
static uint8_t parse_filter(const option_texts_t texts)
{
    const bool is_always_active = has_value(texts, ACTIVATION, "always");
    if (!is_always_active && !has_value(texts, ACTIVATION, "adaptive")) {
        fail(ACTIVATION, texts[ACTIVATION], "choose adaptive or always");
    }
    if (has_value(texts, FILTER, "none")) {
        return MCP_ASDF_OFF;
    }
    if (has_value(texts, FILTER, "robust")) {
        if (is_always_active) {
            fail(ACTIVATION, texts[ACTIVATION], "leave it out, or choose --filter asdf-plus");
        }
        return MCP_ASDF_ROBUST;
    }
    if (!has_value(texts, FILTER, "asdf-plus")) {
        fail(FILTER, texts[FILTER], "choose none, asdf-plus or robust");
    }
    return is_always_active ? MCP_ASDF_ALWAYS : MCP_ASDF_ADAPTIVE;
}

/* ---- The command line ------------------------------------------------------------------------------- */

/* Find the text of each option on the command line, or its default; of a repeated option the last one counts.
 * Ends the program if there is an unknown option, or an argument that belongs to none. */
static void collect_texts(option_texts_t texts, int argument_count, char *const arguments[])
{
    /* getopt_long() returns FIRST_CODE + i for option i, and a character, which is less, for an error. */
    enum { FIRST_CODE = 256 };
    struct option options[OPTION_COUNT + 1] = {0}; /* an entry of zeros at the end, for getopt_long() */
    for (int i = 0; i < OPTION_COUNT; ++i) {
        texts[i] = option_table[i].default_text;
        options[i].name = option_table[i].name;
        options[i].has_arg = i < FIRST_WITHOUT_ARGUMENT ? required_argument : no_argument;
        options[i].val = FIRST_CODE + i;
    }
    int code;
    while ((code = getopt_long(argument_count, arguments, "", options, NULL)) != -1) {
        if (code < FIRST_CODE) {
            exit(EXIT_USAGE); /* getopt_long() has printed the reason */
        }
        texts[code - FIRST_CODE] = optarg != NULL ? optarg : "";
    }
    if (optind < argument_count) {
        (void)fprintf(stderr, "mcp_asdf_node: %s belongs to no option; see --help\n", arguments[optind]);
        exit(EXIT_USAGE);
    }
}

/* Print the help or the version and end the program, if the command line asks for it. */
static void print_help_or_version(const option_texts_t texts)
{
    if (texts[HELP] != NULL) {
        (void)fputs(usage, stdout);
        exit(EXIT_SUCCESS);
    }
    if (texts[VERSION] != NULL) {
        (void)printf("mcp_asdf_node %d.%d.%d\n", MCP_ASDF_VERSION_MAJOR, MCP_ASDF_VERSION_MINOR,
                     MCP_ASDF_VERSION_PATCH);
        exit(EXIT_SUCCESS);
    }
}

/* ---- Checks: each ends the program if options do not fit together ----------------------------------- */

/* Check that --interface and --id are there, and exactly one of --lockstep, --observations and --sensor. If
 * not, fail() ends the program with a message. If none or several of the three are there, the message begins
 * with --lockstep. */
static void check_required_options(const option_texts_t texts)
{
    if (texts[INTERFACE] == NULL) {
        fail(INTERFACE, "missing", "see --help");
    }
    if (texts[ID] == NULL) {
        fail(ID, "missing", "see --help");
    }
    const enum option_index sources[] = {LOCKSTEP, OBSERVATIONS, SENSOR};
    int source_count = 0;
    for (size_t i = 0; i < sizeof sources / sizeof sources[0]; ++i) {
        if (texts[sources[i]] != NULL) {
            ++source_count;
        }
    }
    if (source_count != 1) {
        fail(LOCKSTEP, texts[LOCKSTEP] == NULL ? "not given" : "given",
             "choose one of --lockstep, --observations, --sensor");
    }
}

/* Check what no option shows alone: that the filter period is a multiple of the broadcast period, the memory
 * a multiple of 4, and the three subjects differ. Their ranges have been checked by parse_number(). If one of
 * these fails, the program ends with a message that names the option, its value and the fix, by fail(). */
static void check_node_settings(const node_settings_t *settings, const option_texts_t texts)
{
    const uint16_t estimate_subject = settings->estimate_format.subject;
    const uint16_t telemetry_subject = settings->telemetry_format.subject;
    const uint16_t command_subject = settings->command_format.subject;
    if (settings->filter_period % settings->comms_period != 0) {
        fail(FILTER_PERIOD, texts[FILTER_PERIOD], "choose a multiple of --comms-period");
    }
    if (settings->memory % 4 != 0) {
        fail(MEMORY, texts[MEMORY], "choose a multiple of 4");
    }
    const bool are_subjects_different = estimate_subject != telemetry_subject &&
                                        estimate_subject != command_subject &&
                                        telemetry_subject != command_subject;
    if (!are_subjects_different) {
        fail(SUBJECT, texts[SUBJECT],
             "choose three different subjects for estimates, telemetry and commands");
    }
}

/* Check that --network and --hop-limit, which concern multicast alone, are only given with an --interface
 * udp:GROUP:PORT. Ends the program with a message, by fail(), if not. */
static void check_multicast_options(const option_texts_t texts)
{
    static const enum option_index multicast_options[] = {NETWORK, HOP_LIMIT};
    const bool is_multicast = strncmp(texts[INTERFACE], "udp:", 4) == 0;
    for (size_t i = 0; i < sizeof multicast_options / sizeof multicast_options[0]; ++i) {
        const enum option_index option = multicast_options[i];
        /* Compared by address: a text on the command line may be the same as the default. */
        const bool is_given = texts[option] != option_table[option].default_text;
        if (is_given && !is_multicast) {
            fail(option, texts[option], "leave it out, or choose an --interface udp:GROUP:PORT");
        }
    }
}

/* ---- All options ------------------------------------------------------------------------------------ */

/* Convert the options that are settings of the node. Ends the program if one is malformed. */
static node_settings_t parse_node_settings(const option_texts_t texts)
{
    node_settings_t settings = {.table = MCP_ASDF_NODE_TABLE,
                                .comms_period = parse_number(texts, COMMS_PERIOD),
                                .filter_period = parse_number(texts, FILTER_PERIOD),
                                .memory = parse_number(texts, MEMORY),
                                .filter = parse_filter(texts),
                                .estimate_format = MCP_ASDF_FORMAT_ESTIMATE,
                                .telemetry_format = MCP_ASDF_FORMAT_TELEMETRY,
                                .command_format = MCP_ASDF_FORMAT_COMMAND,
                                .b_hat = parse_b_hat(texts[B_HAT]),
                                .ticks_per_second = parse_number(texts, RATE),
                                .telemetry_period = parse_number(texts, TELEMETRY_PERIOD),
                                .id = (uint8_t)parse_number(texts, ID),
                                .lockstep = texts[LOCKSTEP] != NULL};
    /* The priorities are those of the formats. */
    settings.estimate_format.subject = (uint16_t)parse_number(texts, SUBJECT);
    settings.telemetry_format.subject = (uint16_t)parse_number(texts, TELEMETRY_SUBJECT);
    settings.command_format.subject = (uint16_t)parse_number(texts, COMMAND_SUBJECT);
    if (texts[ALLOW] != NULL) {
        parse_allowed_senders(settings.ignored_senders, texts[ALLOW]);
    }
    return settings;
}

/* Parse the command line, and check it. Ends the program after --help, --version, and errors. */
void options_read(options_t *options, int argument_count, char *const arguments[])
{
    option_texts_t texts;
    collect_texts(texts, argument_count, arguments);
    print_help_or_version(texts);
    check_required_options(texts);
    const options_t parsed = {.node = parse_node_settings(texts),
                              .interface = texts[INTERFACE],
                              .network = texts[NETWORK],
                              .observations = texts[OBSERVATIONS],
                              .sensor = texts[SENSOR],
                              .state = texts[STATE],
                              .save_period = parse_number(texts, SAVE_PERIOD),
                              .ticks = parse_number(texts, TICKS),
                              .receive_buffer = parse_number(texts, RECEIVE_BUFFER),
                              .hop_limit = parse_number(texts, HOP_LIMIT)};
    check_multicast_options(texts);
    check_node_settings(&parsed.node, texts);
    *options = parsed;
}
