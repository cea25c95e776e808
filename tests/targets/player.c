/* Plays the golden vectors on the firmware of this image and prints the verdict; docs/targets.md has their
 * format. tests/targets/golden_vectors.py is the same player in Python, function by function. A scenario's
 * digest covers every call; where it is not the expected one the scenario is played again with a line for
 * every call, as `golden_vectors.py --scenario N` prints them of a robot that is right.
 */
#include "mcp_asdf_arithmetic.h"
#include "mcp_asdf_image.h"
#include "port.h"

#define MAGIC UINT32_C(0x5647434D)
#define STATE_WORDS (MCP_ASDF_IMAGE_SIZE / 4U)

enum { END, OBSERVE, STEP, SETTLE, RECEIVE, RESTORE, DAMAGE };

extern const uint8_t golden_vectors[]; /* files one behind the other, then a word that starts none */
extern const uint32_t mcp_asdf_t_table_omega05_q30[33];

static mcp_asdf_config_t config;
static mcp_asdf_t robot;
static uint8_t image[MCP_ASDF_IMAGE_SIZE];
static const uint8_t *next; /* in golden_vectors */
static uint32_t digest, number, calls, ticks;
static bool alive;   /* there is a robot */
static bool telling; /* a line for every call */

/* ---- Printing ---- */

static void print(const char *text)
{
    while (*text != 0) {
        port_put(*text++);
    }
}

static void print_number(const char *name, uint32_t value)
{
    char digits[11] = "";
    uint8_t at = sizeof digits - 1;
    do {
        digits[--at] = (char)('0' + value % 10);
        value /= 10;
    } while (value > 0);
    print(name);
    print(digits + at);
}

/* ---- Reading ---- */

static uint32_t take(uint8_t bytes)
{
    uint32_t value = 0;
    for (uint8_t i = 0; i < bytes; ++i) {
        value |= (uint32_t)MCP_ASDF_READ_BYTE(next) << 8 * i;
        ++next;
    }
    return value;
}

static uint32_t image_word(uint8_t index)
{
    const uint8_t *const at = &image[4U * index];
    return (uint32_t)at[3] << 24 | (uint32_t)at[2] << 16 | (uint32_t)at[1] << 8 | at[0];
}

static void set_image_word(uint8_t index, uint32_t value)
{
    for (uint8_t i = 0; i < 4; ++i) {
        image[4U * index + i] = (uint8_t)(value >> 8 * i);
    }
}

/* ---- The digest ---- */

static uint32_t mix(uint32_t hash, uint32_t word)
{
    hash = (hash ^ word) * UINT32_C(0x9E3779B1);
    return hash ^ hash >> 15;
}

/* Of all members but the config: what b_hat alone decides is not in an image. */
static uint32_t digest_of_state(void)
{
    const mcp_asdf_accuracy_t *const accuracy = &robot.accuracy;
    uint32_t hash = mix(mix(0, mcp_asdf_x(&robot)), mcp_asdf_x_bar(&robot));
    mcp_asdf_save(&robot, image);
    for (uint8_t i = 0; i < STATE_WORDS; ++i) {
        hash = mix(hash, image_word(i));
    }
    hash = mix(mix(mix(hash, accuracy->c), accuracy->common), accuracy->rare);
    return mix(hash, (uint32_t)accuracy->rare_shift << 8 | accuracy->g_shift);
}

/* Take a call's outcome into the digest: its status and, where `whole`, all that can be seen of the robot. */
static void note(int32_t status, bool whole)
{
    const uint32_t state = alive && (whole || telling) ? digest_of_state() : 0;
    digest = mix(digest, (uint32_t)status);
    if (whole) {
        digest = mix(digest, state);
    }
    if (telling) {
        print_number("call ", number);
        print_number(" status ", (uint32_t)status);
        print_number(" state ", state);
        print("\n");
    }
    ++number;
}

/* ---- Calls ---- */

static void receive(void)
{
    const uint8_t sender = (uint8_t)take(1);
    const uint32_t x_hat = take(4);
    note(mcp_asdf_receive(&robot, sender, x_hat, take(4)), false);
}

/* Replace words of the robot's image and make its checksum right again; the robot becomes what it says. */
static void restore(void)
{
    mcp_asdf_save(&robot, image);
    for (uint32_t left = take(1); left > 0; --left) {
        const uint8_t index = (uint8_t)take(1);
        set_image_word(index, take(4));
    }
    uint32_t hash = UINT32_C(0x811C9DC5);
    for (uint8_t i = 0; i < STATE_WORDS - 1; ++i) {
        hash = (hash ^ image_word(i)) * UINT32_C(0x01000193);
    }
    set_image_word(STATE_WORDS - 1, hash);
    note(mcp_asdf_restore(&robot, &config, image), true);
}

static void damage(void)
{
    mcp_asdf_save(&robot, image);
    uint8_t *const byte = &image[take(1)];
    *byte = (uint8_t)(*byte ^ take(1));
    note(mcp_asdf_restore(&robot, &config, image), true);
}

/* ---- Scenarios ---- */

static void make_robot(void)
{
    config.filter = (uint8_t)take(1);
    config.table = take(1) == 0 ? 0 : mcp_asdf_t_table_omega05_q30;
    const uint8_t id = (uint8_t)take(1);
    config.filter_period = take(4);
    config.memory = take(4);
    const mcp_asdf_status_t status = mcp_asdf_init(&robot, &config, id, take(4));
    alive = status == MCP_ASDF_OK;
    note(status, true);
}

/* Play a call; false at the end of the scenario. */
static bool play_call(void)
{
    switch (take(1)) {
    case OBSERVE:
        note(mcp_asdf_observe(&robot, (mcp_asdf_observation_t)take(1)), true);
        ++ticks;
        break;
    case STEP:
        note(mcp_asdf_step(&robot, (mcp_asdf_observation_t)take(1)), true);
        ++ticks;
        break;
    case SETTLE:
        note(mcp_asdf_settle(&robot), true);
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

/* The last outcome of a scenario, in place of a status: messages accepted, and whether the invariants hold.
 */
static void finish(void)
{
    const int32_t accepted = alive ? mcp_asdf_counters(&robot).accepted : 0;
    note(2 * accepted + (alive && mcp_asdf_invariants_hold(&robot)), true);
}

static void play(void)
{
    digest = 0;
    number = 0;
    make_robot();
    while (play_call()) {
    }
    finish();
    calls += number;
}

static bool scenario_passes(uint32_t index)
{
    const uint32_t expected = take(4);
    const uint8_t *const start = next;
    play();
    if (digest == expected) {
        return true;
    }
    print_number("scenario ", index);
    print_number(" expected ", expected);
    print_number(" found ", digest);
    print("\n");
    next = start;
    telling = true;
    play();
    return false;
}

int main(void)
{
    uint32_t scenarios = 0;
    next = golden_vectors;
    while (take(4) == MAGIC) {
        for (uint32_t left = take(2); left > 0; --left) {
            if (!scenario_passes(scenarios)) {
                print("FAIL\n");
                port_exit(1);
            }
            ++scenarios;
        }
    }
    print_number("PASS scenarios ", scenarios);
    print_number(" calls ", calls);
    print_number(" ticks ", ticks);
    print("\n");
    port_exit(0);
    return 0;
}
