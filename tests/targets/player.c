/* Plays the golden vectors on the firmware of this image and prints the verdict; docs/internals/targets.md
 * has their format. tests/targets/golden_vectors.py is the same player in Python, function by function. A
 * scenario's digest covers every call; where it is not the expected one the scenario is played again with a
 * line for every call, as `golden_vectors.py --scenario N` prints them of a robot that is right.
 */
#include "mcp_asdf_arithmetic.h"
#include "mcp_asdf_image.h"
#include "port.h"

#define MAGIC UINT32_C(0x5647434D)

enum { END, OBSERVE, STEP, SETTLE, RECEIVE, RESTORE, DAMAGE };

extern const uint8_t golden_vectors[]; /* files in a row, then a word that starts no file */
extern const uint32_t mcp_asdf_t_table_omega05_q30[33];

static mcp_asdf_config_t config;
static mcp_asdf_t robot;
static uint8_t image[MCP_ASDF_IMAGE_SIZE];
static const uint8_t *next;             /* in golden_vectors */
static uint32_t digest;                 /* of the scenario so far */
static uint32_t call_number;            /* in the scenario, from 0 */
static uint32_t call_count, tick_count; /* in all scenarios */
static bool has_robot;                  /* whether the scenario's robot could be initialised */
static bool is_verbose;                 /* whether to print a line for every call */

/* ---- Printing ---- */

/* Send a text to the serial line. */
static void print(const char *text)
{
    while (*text != 0) {
        port_put(*text++);
    }
}

/* Print a name and a number in decimal digits, without a C library. */
static void print_number(const char *name, uint32_t value)
{
    char digits[11] = "";
    uint8_t first_digit = sizeof digits - 1; /* the last character ends the text */
    do {
        digits[--first_digit] = (char)('0' + value % 10);
        value /= 10;
    } while (value > 0);
    print(name);
    print(digits + first_digit);
}

/* ---- Reading ---- */

/* Returns the next number of the vectors, of so many little-endian bytes. */
static uint32_t read_number(uint8_t bytes)
{
    uint32_t value = 0;
    for (uint8_t i = 0; i < bytes; ++i) {
        value |= (uint32_t)MCP_ASDF_READ_BYTE(next) << (8 * i);
        ++next;
    }
    return value;
}

/* Returns the number of words in an image of the scenario's robot. */
static uint8_t image_word_count(void)
{
    return (config.filter == MCP_ASDF_ROBUST ? MCP_ASDF_IMAGE_SIZE : MCP_ASDF_ASDF_IMAGE_SIZE) / 4;
}

/* Returns a word of the image, by its index. */
static uint32_t image_word(uint8_t index)
{
    const uint8_t *const bytes = &image[4U * index];
    return ((uint32_t)bytes[3] << 24) | ((uint32_t)bytes[2] << 16) | ((uint32_t)bytes[1] << 8) | bytes[0];
}

/* Replace a word of the image. */
static void set_image_word(uint8_t index, uint32_t value)
{
    for (uint8_t i = 0; i < 4; ++i) {
        image[4U * index + i] = (uint8_t)(value >> (8 * i));
    }
}

/* ---- The digest ---- */

/* Returns a hash that a word has been added to. */
static uint32_t mix(uint32_t hash, uint32_t word)
{
    hash = (hash ^ word) * UINT32_C(0x9E3779B1);
    return hash ^ (hash >> 15);
}

/* Returns a hash of all that can be observed of the robot: x, x_bar, its image, and what follows from b_hat,
 * which is not in an image. */
static uint32_t digest_of_state(void)
{
    const mcp_asdf_accuracy_t *const accuracy = &robot.accuracy;
    uint32_t hash = mix(mix(0, mcp_asdf_x(&robot)), mcp_asdf_x_bar(&robot));
    mcp_asdf_save(&robot, image);
    for (uint8_t i = 0; i < image_word_count(); ++i) {
        hash = mix(hash, image_word(i));
    }
    hash = mix(mix(mix(hash, accuracy->c), accuracy->common), accuracy->rare);
    return mix(hash, (uint32_t)accuracy->rare_shift << 8 | accuracy->g_shift);
}

/* Add the outcome of a call to the scenario's digest: its status and, with `with_state`, the robot's state.
 * Prints both if is_verbose. */
static void record_outcome(int32_t status, bool with_state)
{
    const uint32_t state = has_robot && (with_state || is_verbose) ? digest_of_state() : 0;
    digest = mix(digest, (uint32_t)status);
    if (with_state) {
        digest = mix(digest, state);
    }
    if (is_verbose) {
        print_number("call ", call_number);
        print_number(" status ", (uint32_t)status);
        print_number(" state ", state);
        print("\n");
    }
    ++call_number;
}

/* ---- Calls ---- */

/* Play a message: sender, x_hat, alpha. */
static void receive(void)
{
    const uint8_t sender = (uint8_t)read_number(1);
    const uint32_t x_hat = read_number(4);
    record_outcome(mcp_asdf_receive(&robot, sender, x_hat, read_number(4)), false);
}

/* Replace blocks of the robot's image, with a checksum that is right, and restore the robot from it. */
static void restore(void)
{
    mcp_asdf_save(&robot, image);
    for (uint32_t left = read_number(1); left > 0; --left) {
        uint8_t *const block = &image[read_number(1)];
        const uint32_t size = read_number(1);
        for (uint32_t i = 0; i < size; ++i) {
            block[i] = (uint8_t)read_number(1);
        }
    }
    const uint8_t hash_index = (uint8_t)(image_word_count() - 1U);
    uint32_t hash = UINT32_C(0x811C9DC5);
    for (uint8_t i = 0; i < hash_index; ++i) {
        hash = (hash ^ image_word(i)) * UINT32_C(0x01000193);
    }
    set_image_word(hash_index, hash);
    record_outcome(mcp_asdf_restore(&robot, &config, image), true);
}

/* Change a byte of the robot's image, so that its checksum is wrong, and restore the robot from it. */
static void damage(void)
{
    mcp_asdf_save(&robot, image);
    uint8_t *const byte = &image[read_number(1)];
    *byte = (uint8_t)(*byte ^ read_number(1));
    record_outcome(mcp_asdf_restore(&robot, &config, image), true);
}

/* ---- Scenarios ---- */

/* Initialise the scenario's robot with the settings that come first. */
static void make_robot(void)
{
    config.filter = (uint8_t)read_number(1);
    config.table = read_number(1) == 0 ? 0 : mcp_asdf_t_table_omega05_q30;
    const uint8_t id = (uint8_t)read_number(1);
    config.filter_period = read_number(4);
    config.memory = read_number(4);
    const mcp_asdf_status_t status = mcp_asdf_init(&robot, &config, id, read_number(4));
    has_robot = status == MCP_ASDF_OK;
    record_outcome(status, true);
}

/* Play the next call. Returns false at the end of the scenario. */
static bool play_call(void)
{
    switch (read_number(1)) {
    case OBSERVE:
        record_outcome(mcp_asdf_observe(&robot, (mcp_asdf_observation_t)read_number(1)), true);
        ++tick_count;
        break;
    case STEP:
        record_outcome(mcp_asdf_step(&robot, (mcp_asdf_observation_t)read_number(1)), true);
        ++tick_count;
        break;
    case SETTLE:
        record_outcome(mcp_asdf_settle(&robot), true);
        break;
    case RECEIVE:
        receive();
        break;
    case RESTORE:
        restore();
        break;
    case DAMAGE:
        damage();
        break;
    default:
        return false;
    }
    return true;
}

/* Record the last outcome of a scenario. In place of a status it has twice the number of accepted messages,
 * and 1 more if the invariants hold. */
static void record_end(void)
{
    const int32_t accepted = has_robot ? mcp_asdf_counters(&robot).accepted : 0;
    const bool is_valid = has_robot && mcp_asdf_invariants_hold(&robot);
    record_outcome(2 * accepted + (is_valid ? 1 : 0), true);
}

/* Play the scenario at `next`, and leave its digest in `digest`. */
static void play_scenario(void)
{
    digest = 0;
    call_number = 0;
    make_robot();
    while (play_call()) {
    }
    record_end();
    call_count += call_number;
}

/* Play the next scenario. Returns whether it has the expected digest; if not, plays it again with a line for
 * every call. */
static bool scenario_passes(uint32_t index)
{
    const uint32_t expected_digest = read_number(4);
    const uint8_t *const start = next;
    play_scenario();
    if (digest == expected_digest) {
        return true;
    }
    print_number("scenario ", index);
    print_number(" expected ", expected_digest);
    print_number(" found ", digest);
    print("\n");
    next = start;
    is_verbose = true;
    play_scenario();
    return false;
}

/* Play all scenarios up to the first that fails, and print the verdict. */
int main(void)
{
    uint32_t scenario_count = 0;
    next = golden_vectors;
    while (read_number(4) == MAGIC) {
        for (uint32_t left_in_file = read_number(2); left_in_file > 0; --left_in_file) {
            if (!scenario_passes(scenario_count)) {
                print("FAIL\n");
                port_exit(1);
            }
            ++scenario_count;
        }
    }
    print_number("PASS scenarios ", scenario_count);
    print_number(" calls ", call_count);
    print_number(" ticks ", tick_count);
    print("\n");
    port_exit(0);
    return 0;
}
