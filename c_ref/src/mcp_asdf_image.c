/* Save, restore and invariants. mcp_asdf_image.h is the manual, docs/invariants.md the list of what is
 * checked.
 */
#include "mcp_asdf_image.h"

#include <stddef.h>

#include "mcp_asdf_arithmetic.h"

#define IMAGE_MAGIC (UINT32_C(0x4D435300) | MCP_ASDF_IMAGE_VERSION)
#define ROBUST_IMAGE UINT32_C(0x80)               /* added to it where the filter is the robust one */
#define ALPHA_MOST ((uint64_t)ALPHA_MANTISSA_MAX) /* times 2^31 units */

/* ---- Invariants ---- */

/* A robot like this one that has just formed x_hat and alpha from the same t, n and b_hat. False if there can
 * be none. */
static bool form_anew(const mcp_asdf_t *robot, const mcp_asdf_config_t *unfiltered, mcp_asdf_t *fresh)
{
    if (robot->n > robot->t ||
        mcp_asdf_init(fresh, unfiltered, robot->id, robot->accuracy.b_hat) != MCP_ASDF_OK) {
        return false;
    }
    if (robot->t != 0U) {
        const mcp_asdf_observation_t last = robot->n != 0U ? MCP_ASDF_BLACK : MCP_ASDF_WHITE;
        fresh->t = robot->t - 1U;
        fresh->n = robot->n - (uint32_t)last;
        (void)mcp_asdf_observe(fresh, last);
    }
    return true;
}

/* A word that a robot forms: bits 7..5 zero, and the smallest shift. */
static bool is_canonical(uint32_t alpha)
{
    return (alpha & 0xE0U) == 0U && (alpha >> 31 != 0U || (alpha & 0x1FU) == 0U);
}

/* I4 and I5, with room for another robot: the caller's, since a stack may have room for few. */
static bool estimate_current(const mcp_asdf_t *robot, mcp_asdf_t *fresh)
{
    const mcp_asdf_accuracy_t *const held = &robot->accuracy;
    mcp_asdf_config_t unfiltered = *robot->config; /* a constant would take RAM on an AVR */
    unfiltered.filter = MCP_ASDF_WITH_ASDF ? MCP_ASDF_OFF : MCP_ASDF_ROBUST;
    return robot->t < unfiltered.memory && form_anew(robot, &unfiltered, fresh) &&
           held->c == fresh->accuracy.c && held->common == fresh->accuracy.common &&
           held->rare == fresh->accuracy.rare && held->g_shift == fresh->accuracy.g_shift &&
           held->rare_shift == fresh->accuracy.rare_shift &&
           ((robot->updated == 1U && robot->t != 0U && robot->x_hat <= MCP_ASDF_ONE &&
             is_canonical(robot->alpha)) ||
            (robot->updated == 0U && robot->x_hat == fresh->x_hat && robot->alpha == fresh->alpha));
}

#if MCP_ASDF_WITH_ASDF

/* Whether sums of alpha and of alpha x_hat are in range and give a mean of at most 1.0. */
static bool mean_possible(uint64_t alpha, uint64_t alpha_x_low, uint64_t alpha_x_high)
{
    const uint64_t middle = alpha_x_high + (alpha_x_low >> 32); /* may wrap, but not within the limits */
    const uint64_t most = alpha >> 9;                           /* of middle, where the mean is 1.0 */
    return alpha <= MCP_ASDF_MAX_ID * ALPHA_MOST << 31 && alpha_x_low < UINT64_C(1) << 62 &&
           alpha_x_high < UINT64_C(1) << 53 &&
           (middle < most || (middle == most && (uint32_t)alpha_x_low <= (uint32_t)alpha << 23));
}

/* Whether `count` messages can have given these sums: each alpha at least one unit, none too large, no mean
 * above 1.0, no variance below 0. */
static bool open_possible(const mcp_asdf_open_t *open)
{
    const uint32_t m = open->count;
    return m <= MCP_ASDF_MAX_ID && open->x <= m * MCP_ASDF_ONE && /* < 2^30 */
           open->x_squared <= (uint64_t)open->x * MCP_ASDF_ONE &&
           m * open->x_squared >= (uint64_t)open->x * open->x &&      /* < 2^60 */
           open->alpha >= m && open->alpha <= m * ALPHA_MOST << 31 && /* < 2^62 */
           open->alpha_x_low <= (uint64_t)open->x * UINT32_MAX &&
           open->alpha_x_high <= open->x * (ALPHA_MOST >> 1) &&
           mean_possible(open->alpha, open->alpha_x_low, open->alpha_x_high);
}

/* Whether both rounds can have come about; with the robust filter they are empty. */
static bool rounds_possible(const mcp_asdf_t *robot)
{
    return mean_possible(robot->closed.alpha, robot->closed.alpha_x_low, robot->closed.alpha_x_high) &&
           open_possible(&robot->open) &&
           (!mcp_asdf_is_robust(robot->config) || (robot->open.count == 0U && robot->closed.alpha == 0U));
}

static uint32_t messages(const mcp_asdf_t *robot) { return robot->open.count; }

#else

static bool rounds_possible(const mcp_asdf_t *robot) { return (void)robot, true; }
static uint32_t messages(const mcp_asdf_t *robot) { return (void)robot, 0; }

#endif
#if MCP_ASDF_WITH_ROBUST

/* Whether votes can have made a crowd so; other filters have none. */
static bool crowd_possible(const mcp_asdf_t *robot)
{
    const mcp_asdf_crowd_t *const crowd = &robot->crowd;
    const bool is_new = crowd->centre == MCP_ASDF_CENTRE_START && crowd->spread == MCP_ASDF_SPREAD_MAX &&
                        crowd->voices == 0U && crowd->votes == 0U && crowd->trend == MCP_ASDF_TREND_START;
    if (!mcp_asdf_is_robust(robot->config)) {
        return is_new && crowd->first == 0U;
    }
    if (crowd->votes == 0U) {
        return is_new && crowd->first == robot->accuracy.b_hat;
    }
    return crowd->first - MCP_ASDF_B_HAT_MIN <= MCP_ASDF_B_HAT_MAX - MCP_ASDF_B_HAT_MIN &&
           crowd->votes <= MCP_ASDF_VOTES_MAX && crowd->voices != 0U && crowd->centre <= MCP_ASDF_ONE << 7 &&
           crowd->spread >= MCP_ASDF_SPREAD_MIN && crowd->spread <= MCP_ASDF_SPREAD_MAX;
}

#else

static bool crowd_possible(const mcp_asdf_t *robot) { return (void)robot, true; }

#endif

/* At least as many senders as messages with alpha > 0, none of them the robot itself. */
static bool senders_possible(const mcp_asdf_t *robot)
{
    uint32_t heard = 0;
    for (uint8_t id = 0; id <= MCP_ASDF_MAX_ID; ++id) { /* at most 128 turns */
        heard += robot->heard.of[id >> 3] >> (id & 7) & 1;
    }
    return messages(robot) <= heard && (robot->heard.of[robot->id >> 3] >> (robot->id & 7) & 1) == 0;
}

static bool state_possible(const mcp_asdf_t *robot, mcp_asdf_t *fresh)
{
    const mcp_asdf_config_t *const config = robot->config;
    return estimate_current(robot, fresh) && /* checks the id, too */
           rounds_possible(robot) && crowd_possible(robot) && senders_possible(robot) &&
           robot->filter_left != 0U && robot->filter_left <= config->filter_period;
}

bool mcp_asdf_invariants_hold(const mcp_asdf_t *robot)
{
    mcp_asdf_t fresh;
    return state_possible(robot, &fresh);
}

/* ---- Save and restore ---- */

/* An image on its way out of a robot, into `target`, or into one, from `source`; the other is null. */
typedef struct {
    const uint8_t *source;
    uint8_t *target;
    uint32_t hash; /* FNV-1a over the words so far */
} image_t;

/* Pass a word through the image: writing returns value itself, reading the image's next word. */
static uint32_t pass(image_t *image, uint32_t value)
{
    uint32_t passed = image->target == NULL ? 0U : value;
    for (uint8_t shift = 0; shift < 32U; shift = (uint8_t)(shift + 8U)) { /* at most 4 turns */
        if (image->target == NULL) {
            passed |= (uint32_t)*image->source++ << shift;
        } else {
            *image->target++ = (uint8_t)(value >> shift);
        }
    }
    image->hash = hash_word(image->hash, passed);
    return passed;
}

static void pass_pair(image_t *image, uint16_t *first, uint16_t *second)
{
    const uint32_t both = pass(image, (uint32_t)*second << 16 | *first);
    *first = (uint16_t)both;
    *second = (uint16_t)(both >> 16);
}

/* Four bytes as the word of which they are the little-endian bytes. */
static void pass_bytes(image_t *image, uint8_t *bytes)
{
    uint32_t word = 0;
    for (uint8_t i = 0; i < 4U; ++i) { /* at most 4 turns */
        word |= (uint32_t)bytes[i] << 8 * i;
    }
    word = pass(image, word);
    for (uint8_t i = 0; i < 4U; ++i) { /* at most 4 turns */
        bytes[i] = (uint8_t)(word >> 8 * i);
    }
}

#if MCP_ASDF_WITH_ASDF

static void pass_double(image_t *image, uint64_t *value)
{
    const uint32_t low = pass(image, (uint32_t)*value);
    *value = (uint64_t)pass(image, (uint32_t)(*value >> 32)) << 32 | low;
}

static void pass_rounds(image_t *image, mcp_asdf_t *robot)
{
    pass_double(image, &robot->closed.alpha);
    pass_double(image, &robot->closed.alpha_x_low);
    pass_double(image, &robot->closed.alpha_x_high);
    pass_double(image, &robot->open.alpha);
    pass_double(image, &robot->open.alpha_x_low);
    pass_double(image, &robot->open.alpha_x_high);
    pass_double(image, &robot->open.x_squared);
    robot->open.x = pass(image, robot->open.x);
    robot->open.count = pass(image, robot->open.count);
}

#else

static void pass_rounds(image_t *image, mcp_asdf_t *robot) { (void)image, (void)robot; }

#endif
#if MCP_ASDF_WITH_ROBUST

/* The crowd in place of the rounds. What is left of their words is 0: no robot has a crowd with more. */
static void pass_crowd(image_t *image, mcp_asdf_t *robot)
{
    mcp_asdf_crowd_t *const crowd = &robot->crowd;
    uint32_t rest = 0;
    crowd->centre = pass(image, crowd->centre);
    crowd->spread = pass(image, crowd->spread);
    crowd->voices = pass(image, crowd->voices);
    crowd->first = pass(image, crowd->first);
    pass_pair(image, &crowd->votes, &crowd->trend);
    for (uint8_t i = 0; i < 11U; ++i) { /* at most 11 turns */
        rest |= pass(image, 0);
    }
    crowd->spread = rest == 0U ? crowd->spread : 0U; /* which no crowd has */
}

/* Images of other filters hold no crowd: it is as in a new robot. */
static void keep_crowd(mcp_asdf_t *robot, const mcp_asdf_t *fresh) { robot->crowd = fresh->crowd; }

#else

static void pass_crowd(image_t *image, mcp_asdf_t *robot) { (void)image, (void)robot; }
static void keep_crowd(mcp_asdf_t *robot, const mcp_asdf_t *fresh) { (void)robot, (void)fresh; }

#endif

/* The one list of what an image holds, for both directions; what follows from b_hat alone is left out. */
static void pass_state(image_t *image, mcp_asdf_t *robot, bool robust)
{
    robot->accuracy.b_hat = pass(image, robot->accuracy.b_hat);
    robot->t = pass(image, robot->t);
    robot->n = pass(image, robot->n);
    robot->x_hat = pass(image, robot->x_hat);
    robot->alpha = pass(image, robot->alpha);
    robot->filter_left = pass(image, robot->filter_left);
    if (robust) {
        pass_crowd(image, robot);
    } else {
        pass_rounds(image, robot);
    }
    for (uint8_t i = 0; i < 16U; i = (uint8_t)(i + 4U)) { /* at most 4 turns */
        pass_bytes(image, &robot->heard.of[i]);
    }
    pass_pair(image, &robot->counters.accepted, &robot->counters.repeated);
    pass_pair(image, &robot->counters.rejected, &robot->counters.tests);
    const uint32_t rest =
        pass(image, robot->counters.updates | (uint32_t)robot->updated << 16 | (uint32_t)robot->id << 24);
    robot->counters.updates = (uint16_t)rest;
    robot->updated = (uint8_t)(rest >> 16);
    robot->id = (uint8_t)(rest >> 24);
}

static uint32_t magic(bool robust) { return robust ? IMAGE_MAGIC | ROBUST_IMAGE : IMAGE_MAGIC; }

void mcp_asdf_save(const mcp_asdf_t *robot, uint8_t image[MCP_ASDF_IMAGE_SIZE])
{
    image_t out = {NULL, image, HASH_START};
    mcp_asdf_t copy = *robot;
    const bool robust = mcp_asdf_is_robust(robot->config);
    (void)pass(&out, magic(robust));
    pass_state(&out, &copy, robust);
    (void)pass(&out, out.hash);
}

mcp_asdf_status_t mcp_asdf_restore(mcp_asdf_t *robot, const mcp_asdf_config_t *config,
                                   const uint8_t image[MCP_ASDF_IMAGE_SIZE])
{
    image_t in = {image, NULL, HASH_START};
    mcp_asdf_t read = {0}, fresh;
    const bool robust = mcp_asdf_is_robust(config), known = pass(&in, 0) == magic(robust);
    pass_state(&in, &read, robust);
    const uint32_t hash = in.hash;
    const bool sound = known && pass(&in, 0) == hash;
    const mcp_asdf_status_t status = mcp_asdf_init(&fresh, config, read.id, read.accuracy.b_hat);
    if (status == MCP_ASDF_ERR_CONFIG || status == MCP_ASDF_ERR_TABLE) {
        return status;
    }
    if (!sound || status != MCP_ASDF_OK) {
        return MCP_ASDF_ERR_IMAGE;
    }
    if (!robust) {
        keep_crowd(&read, &fresh);
    }
    read.config = config;
    read.accuracy = fresh.accuracy;
    if (!state_possible(&read, &fresh)) {
        return MCP_ASDF_ERR_IMAGE;
    }
    *robot = read;
    return MCP_ASDF_OK;
}
