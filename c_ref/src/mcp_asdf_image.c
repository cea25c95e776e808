/* Save, restore and invariants. mcp_asdf_image.h is the manual, docs/internals/properties.md lists what is
 * checked.
 */
#include "mcp_asdf_image.h"

#include <stddef.h>

#include "mcp_asdf_arithmetic.h"

#define IMAGE_MAGIC (UINT32_C(0x4D435300) | MCP_ASDF_IMAGE_VERSION)
#define ROBUST_IMAGE UINT32_C(0x80) /* added to the magic word if the filter is the robust one */
/* The largest alpha is ALPHA_MANTISSA times 2^31 units. */
#define ALPHA_MANTISSA ((uint64_t)ALPHA_MANTISSA_MAX)
/* Bits 5 to 7 of an alpha word, between its shift and its mantissa. */
#define ALPHA_UNUSED_BITS UINT32_C(0xE0)

/* ---- Invariants ---- */

/* Compute in *fresh a robot with the settings `config` that has just formed x_hat and alpha from the t, n and
 * b_hat of `robot`, to compare the two. It is a new robot that is given all observations but one, and makes
 * the last one itself. Returns false, with *fresh of no use, if there can be no such robot: n is above t, or
 * the id or b_hat is out of range. */
static bool recompute_estimate(const mcp_asdf_t *robot, const mcp_asdf_config_t *config, mcp_asdf_t *fresh)
{
    if (robot->n > robot->t ||
        mcp_asdf_init(fresh, config, robot->id, robot->accuracy.b_hat) != MCP_ASDF_OK) {
        return false;
    }
    if (robot->t != 0U) {
        /* The order of observations does not matter: if any was black, a black one may be the last. */
        const mcp_asdf_observation_t last = robot->n != 0U ? MCP_ASDF_BLACK : MCP_ASDF_WHITE;
        fresh->t = robot->t - 1U;
        fresh->n = robot->n - (uint32_t)last;
        (void)mcp_asdf_observe(fresh, last);
    }
    return true;
}

/* Whether an alpha word is one that a robot can form: bits 5 to 7 are 0, and the shift (bits 0 to 4) is 0
 * unless the highest bit of the mantissa (bit 31) is set, so that no smaller shift would do. */
static bool is_possible_alpha(uint32_t alpha)
{
    /* ALPHA_SHIFT_MAX, 31, is also the mask of the 5 bits that hold the shift. */
    return (alpha & ALPHA_UNUSED_BITS) == 0U && ((alpha >> 31) != 0U || (alpha & ALPHA_SHIFT_MAX) == 0U);
}

/* Whether two accuracies with the same b_hat agree in all that follows from it. */
static bool has_same_accuracy(const mcp_asdf_accuracy_t *accuracy, const mcp_asdf_accuracy_t *fresh)
{
    return accuracy->c == fresh->c && accuracy->common == fresh->common && accuracy->rare == fresh->rare &&
           accuracy->g_shift == fresh->g_shift && accuracy->rare_shift == fresh->rare_shift;
}

/* Whether n <= t < memory, id and b_hat are in their ranges, and x_hat, alpha and all that is derived from
 * b_hat have the bits that a robot forms from t, n and b_hat. There is one exception: with `updated` 1, b_hat
 * was re-estimated after the last observation. x_hat and alpha then follow from an earlier b_hat, which is
 * not known, and may be any that a robot can form.
 *
 * The caller lends *fresh, memory for a robot that is computed to compare with: a small stack may have no
 * room for a second robot. That robot never settles, so its filter does not matter. It has a filter without a
 * t-table: OFF or, where only the robust filter is built, the robust filter. */
static bool is_valid_estimate(const mcp_asdf_t *robot, mcp_asdf_t *fresh)
{
    mcp_asdf_config_t config = *robot->config; /* a constant one would take RAM on an AVR */
    config.filter = MCP_ASDF_WITH_ASDF ? MCP_ASDF_OFF : MCP_ASDF_ROBUST;
    /* recompute_estimate() fails for an id or b_hat out of range, and for n > t. */
    if (robot->t >= config.memory || !recompute_estimate(robot, &config, fresh) ||
        !has_same_accuracy(&robot->accuracy, &fresh->accuracy)) {
        return false;
    }
    if (robot->updated == 1U) {
        /* No filter runs before the first observation, so that t is not 0. */
        return robot->t != 0U && robot->x_hat <= MCP_ASDF_ONE && is_possible_alpha(robot->alpha);
    }
    /* `updated` has no other values than 0 and 1. */
    return robot->updated == 0U && robot->x_hat == fresh->x_hat && robot->alpha == fresh->alpha;
}

#if MCP_ASDF_WITH_ASDF

/* Whether sums over at most 127 messages of a round can be these, and give a mean of x_hat weighted by alpha
 * of at most 1.0. `alpha` is the sum of alpha in units of 2^-24. The sum of alpha x_hat in units of 2^-47 is
 * 2^32 alpha_x_high + alpha_x_low: with alpha = 2^32 high + low, the sums of high x_hat and of low x_hat.
 *
 * The mean is at most 1.0, which is 2^23 as x_hat, if the sum of alpha x_hat is at most 2^23 alpha. Neither
 * fits in 64 bits, so that both are compared in two pieces:
 *
 *                      from bit 32 up                      bits 31 to 0
 *     sum              alpha_x_high + alpha_x_low / 2^32   those of alpha_x_low
 *     2^23 alpha       alpha / 2^9                         the lowest 9 bits of alpha, times 2^23 */
static bool is_valid_mean(uint64_t alpha, uint64_t alpha_x_low, uint64_t alpha_x_high)
{
    /* The sum wraps only if alpha_x_high is at least 2^64 - 2^32, which is out of its range: this is checked
     * before the sum is used. */
    const uint64_t upper_sum = alpha_x_high + (alpha_x_low >> 32);
    const uint64_t upper_limit = alpha >> 9; /* 2^23 alpha / 2^32 */
    /* Of one message alpha is at most ALPHA_MANTISSA 2^31, which is below 2^55: its upper word is below 2^23,
     * its lower word below 2^32, and x_hat is at most 2^23. A robot receives from up to 127 others, which is
     * also MCP_ASDF_MAX_ID, and less than 2^7. */
    const uint64_t largest_alpha_sum = (MCP_ASDF_MAX_ID * ALPHA_MANTISSA) << 31;
    return alpha <= largest_alpha_sum && alpha_x_low < (UINT64_C(1) << 62) && /* 2^7 2^32 2^23 */
           alpha_x_high < (UINT64_C(1) << 53) &&                              /* 2^7 2^23 2^23 */
           (upper_sum < upper_limit ||
            /* The lower 32 bits decide if the upper ones are equal. The shift keeps 9 bits of alpha. */
            (upper_sum == upper_limit && (uint32_t)alpha_x_low <= ((uint32_t)alpha << 23)));
}

/* Whether open->count estimates with alpha > 0, at most 127, can have the sums in *open. Each condition is
 * about one sum or about two. All are necessary, but do not prove that such estimates exist. The numbers at
 * the right show that no product wraps. */
static bool are_valid_sums(const mcp_asdf_open_t *open)
{
    const uint32_t m = open->count;
    return m <= MCP_ASDF_MAX_ID &&
           /* each x_hat is at most 1.0, and its square at most x_hat */
           open->x <= m * MCP_ASDF_ONE && /* < 2^30 */
           open->x_squared <= (uint64_t)open->x * MCP_ASDF_ONE &&
           /* m^2 times the variance of the x_hat is not negative */
           m * open->x_squared >= (uint64_t)open->x * open->x && /* < 2^60 */
           /* each alpha is at least one unit of 2^-24, and at most ALPHA_MANTISSA 2^31 of them */
           open->alpha >= m && open->alpha <= (m * ALPHA_MANTISSA) << 31 && /* < 2^62 */
           /* the lower word of such an alpha is at most 2^32 - 1, the upper one ALPHA_MANTISSA 2^31 / 2^32 */
           open->alpha_x_low <= (uint64_t)open->x * UINT32_MAX &&
           open->alpha_x_high <= open->x * (ALPHA_MANTISSA >> 1) &&
           /* the mean of the x_hat, weighted by alpha, is at most 1.0 */
           is_valid_mean(open->alpha, open->alpha_x_low, open->alpha_x_high);
}

/* Whether received estimates can have led to the sums of the closed and of the open round. A closed round
 * keeps only the sums of the weighted mean, and these are checked. True with the robust filter, which keeps
 * no sums. */
static bool are_valid_rounds(const mcp_asdf_t *robot)
{
    return mcp_asdf_is_robust(robot->config) ||
           (is_valid_mean(robot->received.sums.closed.alpha, robot->received.sums.closed.alpha_x_low,
                          robot->received.sums.closed.alpha_x_high) &&
            are_valid_sums(&robot->received.sums.open));
}

/* Returns the number of estimates in the sums of the open round, 0 if there are no sums. */
static uint32_t count_of_open_round(const mcp_asdf_t *robot)
{
    return mcp_asdf_is_robust(robot->config) ? 0U : robot->received.sums.open.count;
}

#else

static bool are_valid_rounds(const mcp_asdf_t *robot) { return (void)robot, true; }
static uint32_t count_of_open_round(const mcp_asdf_t *robot) { return (void)robot, 0; }

#endif
#if MCP_ASDF_WITH_ROBUST

/* Whether *robust is as in a new robot, but for its initial b_hat. */
static bool is_new_filter(const mcp_asdf_robust_t *robust)
{
    return robust->centre == MCP_ASDF_CENTRE_START && robust->spread == MCP_ASDF_SPREAD_MAX &&
           robust->filled_slots == 0U && robust->batch_t == 0U && robust->batch_n == 0U &&
           robust->votes == 0U && robust->dispersion == MCP_ASDF_DISPERSION_MIN && robust->turn == 0U;
}

/* Whether slot i has an estimate. */
static bool is_filled(const mcp_asdf_robust_t *robust, uint8_t i)
{
    return ((robust->filled_slots >> i) & 1U) != 0U;
}

/* Whether calls of the firmware can have led to the estimates that a robot with the robust filter keeps, and
 * to its b_hat: slots that are not filled are 0, and while less than five are filled no test has changed
 * b_hat. */
static bool are_valid_slots(const mcp_asdf_t *robot)
{
    uint32_t filled_count = 0;
    for (uint8_t i = 0; i < MCP_ASDF_SLOTS; ++i) { /* at most 32 turns */
        const bool is_slot_filled = is_filled(&robot->robust, i);
        filled_count += is_slot_filled ? 1U : 0U;
        if (!is_slot_filled && robot->received.estimates[i] != 0U) {
            return false;
        }
    }
    return filled_count >= MCP_ASDF_TESTED_ESTIMATES_MIN ||
           robot->robust.initial_b_hat == robot->accuracy.b_hat;
}

/* Whether calls of the firmware can have led to the votes of the robust filter. Without any, centre, spread
 * and turn are as in a new robot. Else a slot is filled, the number of votes, the centre and the spread are
 * in their ranges, and the turn is slot 0 or the slot after a filled slot. */
static bool are_valid_votes(const mcp_asdf_robust_t *robust)
{
    if (robust->votes == 0U) {
        return robust->centre == MCP_ASDF_CENTRE_START && robust->spread == MCP_ASDF_SPREAD_MAX &&
               robust->turn == 0U;
    }
    return robust->votes <= MCP_ASDF_VOTES_MAX && robust->filled_slots != 0U &&
           robust->centre <= MCP_ASDF_ONE << 7 && /* 1.0 as Q30 */
           robust->spread >= MCP_ASDF_SPREAD_MIN && robust->spread <= MCP_ASDF_SPREAD_MAX &&
           (robust->turn == 0U ||
            (robust->turn <= MCP_ASDF_SLOTS && is_filled(robust, (uint8_t)(robust->turn - 1U))));
}

/* Returns how many of t observations were white, if n of them were black. */
static uint32_t white_observations(uint32_t t, uint32_t n) { return t - n; }

/* Whether calls of the firmware can have led to what the robust filter keeps of batches. A batch is the set
 * of observations since the filter last ran or t was last halved, whichever was later; batch_t and batch_n
 * are the counts of all and of black observations when the batch began, and t and n the counts now.
 *
 * Within a batch neither the count of black observations nor the count of white ones (t - n) ever falls. The
 * first batch begins at t = 0. In it the dispersion and b_hat are those of a new robot: the dispersion
 * changes when a batch ends, and b_hat in a test, which ends one, too. */
static bool is_valid_batch(const mcp_asdf_t *robot)
{
    const mcp_asdf_robust_t *const robust = &robot->robust;
    const bool is_first_batch = robust->batch_t == 0U;
    return robust->batch_n <= robust->batch_t && /* black ones and all, then */
           robust->batch_n <= robot->n &&        /* the black observations, then and now */
           white_observations(robust->batch_t, robust->batch_n) <= white_observations(robot->t, robot->n) &&
           robust->dispersion >= MCP_ASDF_DISPERSION_MIN &&
           (!is_first_batch || (robust->dispersion == MCP_ASDF_DISPERSION_MIN &&
                                robust->initial_b_hat == robot->accuracy.b_hat));
}

/* Whether all that the robust filter remembers is something to which calls of the firmware can lead. With
 * another filter it is as in a new robot, and its initial b_hat is 0. */
static bool is_valid_robust_filter(const mcp_asdf_t *robot)
{
    const mcp_asdf_robust_t *const robust = &robot->robust;
    if (!mcp_asdf_is_robust(robot->config)) {
        return is_new_filter(robust) && robust->initial_b_hat == 0U;
    }
    return robust->initial_b_hat >= MCP_ASDF_B_HAT_MIN && robust->initial_b_hat <= MCP_ASDF_B_HAT_MAX &&
           are_valid_slots(robot) && are_valid_votes(robust) && is_valid_batch(robot);
}

#else

static bool is_valid_robust_filter(const mcp_asdf_t *robot) { return (void)robot, true; }

#endif

/* Whether `id` (0 .. 127) is among the senders of the open round. Its bit is bit (id mod 8) of byte
 * (id div 8). */
static bool has_sender(const mcp_asdf_t *robot, uint8_t id)
{
    return ((robot->heard.of[id >> 3] >> (id & 7)) & 1) != 0;
}

/* Whether the set of senders fits the open round: it has at least as many members as the sums have estimates,
 * and the robot itself is no sender. There may be more senders, as an estimate with alpha 0 enters no sum. */
static bool are_valid_senders(const mcp_asdf_t *robot)
{
    uint32_t sender_count = 0;
    for (uint8_t id = 0; id <= MCP_ASDF_MAX_ID; ++id) { /* at most 128 turns */
        sender_count += has_sender(robot, id) ? 1U : 0U;
    }
    return count_of_open_round(robot) <= sender_count && !has_sender(robot, robot->id);
}

/* Whether calls of the firmware can have led to this state, as far as that shows without a search: a damaged
 * state may pass, but none to which calls have led is refused. The local estimate must follow from the
 * observations; the sums of rounds, or what the robust filter keeps, and the set of senders must be possible;
 * and filter_left must be from 1 to filter_period. The counters may have any values.
 *
 * The caller lends *fresh, memory in which another robot is computed to compare with; its contents do not
 * matter, before or after. */
static bool is_valid_state(const mcp_asdf_t *robot, mcp_asdf_t *fresh)
{
    const mcp_asdf_config_t *const config = robot->config;
    /* The estimate comes first: this checks the robot's id, on which are_valid_senders() relies. */
    return is_valid_estimate(robot, fresh) && are_valid_rounds(robot) && is_valid_robust_filter(robot) &&
           are_valid_senders(robot) &&
           /* Rounds until the filter runs: it starts at filter_period, and is set to it again at 0. */
           robot->filter_left != 0U && robot->filter_left <= config->filter_period;
}

/* Whether calls of the firmware can have led to the state of `robot`: no such state is refused, but a damaged
 * one may pass. */
bool mcp_asdf_invariants_hold(const mcp_asdf_t *robot)
{
    mcp_asdf_t fresh;
    return is_valid_state(robot, &fresh);
}

/* ---- Save and restore ---- */

/* An image that is written from a robot or read into one. One list of members serves for both directions:
 * every pass_...() function passes members through the image, which writes them, or replaces them by what it
 * reads.
 *   source   where the image is read from; null if it is written
 *   target   where the image is written to; null if it is read
 *   hash     FNV-1a over the words so far
 *   is_read  whether the image is read */
typedef struct {
    const uint8_t *source;
    uint8_t *target;
    uint32_t hash;
    bool is_read;
} image_t;

/* Pass a word through the image, little-endian: append `value` if the image is written, or take its next word
 * if it is read, where `value` does not matter. Returns the word, moves the image's source or target on by
 * its 4 bytes, and adds it to the image's hash. */
static uint32_t pass_word(image_t *image, uint32_t value)
{
    uint32_t word = image->is_read ? 0U : value;
    for (uint8_t shift = 0; shift < 32U; shift = (uint8_t)(shift + 8U)) { /* at most 4 turns */
        if (image->is_read) {
            word |= (uint32_t)*image->source++ << shift;
        } else {
            *image->target++ = (uint8_t)(value >> shift); /* the lowest 8 bits of what is left */
        }
    }
    image->hash = hash_word(image->hash, word);
    return word;
}

/* Pass *first and *second through the image as one word, *first in bits 0 to 15 and *second in bits 16 to 31.
 * If the image is read, both are replaced. */
static void pass_half_words(image_t *image, uint16_t *first, uint16_t *second)
{
    const uint32_t word = pass_word(image, ((uint32_t)*second << 16) | *first);
    *first = (uint16_t)word; /* bits 0 to 15 */
    *second = (uint16_t)(word >> 16);
}

/* Pass the four bytes at `bytes` through the image as one word, the lowest byte first. If the image is read,
 * they are replaced. */
static void pass_bytes(image_t *image, uint8_t *bytes)
{
    uint32_t word = 0;
    for (uint8_t i = 0; i < 4U; ++i) { /* at most 4 turns */
        word |= (uint32_t)bytes[i] << (8 * i);
    }
    word = pass_word(image, word);
    for (uint8_t i = 0; i < 4U; ++i) { /* at most 4 turns */
        bytes[i] = (uint8_t)(word >> (8 * i));
    }
}

#if MCP_ASDF_WITH_ASDF

/* Pass *sum through the image as two words, the lower one first. If the image is read, it is replaced. */
static void pass_sum(image_t *image, uint64_t *sum)
{
    const uint32_t low = pass_word(image, (uint32_t)*sum);
    const uint32_t high = pass_word(image, (uint32_t)(*sum >> 32));
    *sum = ((uint64_t)high << 32) | low;
}

/* Pass the sums of the closed and of the open round through the image: 16 words. */
static void pass_rounds(image_t *image, mcp_asdf_t *robot)
{
    pass_sum(image, &robot->received.sums.closed.alpha);
    pass_sum(image, &robot->received.sums.closed.alpha_x_low);
    pass_sum(image, &robot->received.sums.closed.alpha_x_high);
    pass_sum(image, &robot->received.sums.open.alpha);
    pass_sum(image, &robot->received.sums.open.alpha_x_low);
    pass_sum(image, &robot->received.sums.open.alpha_x_high);
    pass_sum(image, &robot->received.sums.open.x_squared);
    robot->received.sums.open.x = pass_word(image, robot->received.sums.open.x);
    robot->received.sums.open.count = pass_word(image, robot->received.sums.open.count);
}

#else

static void pass_rounds(image_t *image, mcp_asdf_t *robot) { (void)image, (void)robot; }

#endif
#if MCP_ASDF_WITH_ROBUST

/* Pass what the robust filter remembers through the image, in place of the 16 words of the rounds: centre,
 * spread, initial b_hat, filled slots, t and n of the batch, votes with dispersion, the turn, and 16 words
 * with two estimates each. */
static void pass_robust_filter(image_t *image, mcp_asdf_t *robot)
{
    mcp_asdf_robust_t *const robust = &robot->robust;
    uint16_t *const estimates = robot->received.estimates;
    robust->centre = pass_word(image, robust->centre);
    robust->spread = pass_word(image, robust->spread);
    robust->initial_b_hat = pass_word(image, robust->initial_b_hat);
    robust->filled_slots = pass_word(image, robust->filled_slots);
    robust->batch_t = pass_word(image, robust->batch_t);
    robust->batch_n = pass_word(image, robust->batch_n);
    pass_half_words(image, &robust->votes, &robust->dispersion);
    /* A word that is no turn becomes one that are_valid_votes() refuses. */
    const uint32_t turn = pass_word(image, robust->turn);
    robust->turn = turn <= MCP_ASDF_SLOTS ? (uint8_t)turn : UINT8_MAX;
    for (uint8_t i = 0; i < MCP_ASDF_SLOTS; i = (uint8_t)(i + 2U)) { /* at most 16 turns */
        pass_half_words(image, &estimates[i], &estimates[i + 1U]);
    }
}

/* Give the robust filter of `robot` the memory of the new robot `fresh`. */
static void reset_robust_filter(mcp_asdf_t *robot, const mcp_asdf_t *fresh) { robot->robust = fresh->robust; }

#else

static void pass_robust_filter(image_t *image, mcp_asdf_t *robot) { (void)image, (void)robot; }
static void reset_robust_filter(mcp_asdf_t *robot, const mcp_asdf_t *fresh) { (void)robot, (void)fresh; }

#endif

/* Pass all members of `robot` through the image, except the config and what follows from b_hat alone. If the
 * image is read, they are replaced, unchecked. With `is_robust` the image has the robust filter's memory in
 * place of the rounds. */
static void pass_state(image_t *image, mcp_asdf_t *robot, bool is_robust)
{
    robot->accuracy.b_hat = pass_word(image, robot->accuracy.b_hat);
    robot->t = pass_word(image, robot->t);
    robot->n = pass_word(image, robot->n);
    robot->x_hat = pass_word(image, robot->x_hat);
    robot->alpha = pass_word(image, robot->alpha);
    robot->filter_left = pass_word(image, robot->filter_left);
    if (is_robust) {
        pass_robust_filter(image, robot);
    } else {
        pass_rounds(image, robot);
    }
    for (uint8_t i = 0; i < 16U; i = (uint8_t)(i + 4U)) { /* at most 4 turns */
        pass_bytes(image, &robot->heard.of[i]);
    }
    pass_half_words(image, &robot->counters.accepted, &robot->counters.repeated);
    pass_half_words(image, &robot->counters.rejected, &robot->counters.tests);
    /* The last word: updates in bits 0 to 15, `updated` in bits 16 to 23, the id in bits 24 to 31. */
    const uint32_t upper_half = ((uint32_t)robot->updated << 16) | ((uint32_t)robot->id << 24);
    const uint32_t last_word = pass_word(image, robot->counters.updates | upper_half);
    robot->counters.updates = (uint16_t)last_word;
    robot->updated = (uint8_t)(last_word >> 16);
    robot->id = (uint8_t)(last_word >> 24);
}

/* Returns the first word of an image, by which its format and its kind of filter (the robust one, or any
 * other) are recognised. */
static uint32_t magic_word(bool is_robust) { return is_robust ? IMAGE_MAGIC | ROBUST_IMAGE : IMAGE_MAGIC; }

/* Returns the next word of an image that is read. The value that is passed does not matter then. */
ALWAYS_INLINE uint32_t read_word(image_t *image) { return pass_word(image, 0); }

/* Write the image of `robot` to `image`: the magic word, the state, and the hash of both. */
void mcp_asdf_save(const mcp_asdf_t *robot, uint8_t image[MCP_ASDF_IMAGE_SIZE])
{
    image_t output = {.source = NULL, .target = image, .hash = HASH_START, .is_read = false};
    /* pass_state() serves for reading, too: it assigns to all members what pass_word() returns. */
    mcp_asdf_t copy = *robot;
    const bool is_robust = mcp_asdf_is_robust(robot->config);
    (void)pass_word(&output, magic_word(is_robust));
    pass_state(&output, &copy, is_robust);
    (void)pass_word(&output, output.hash); /* the hash of all words before this one */
}

/* Read a robot from `image`, check it, and only then write *robot. Returns OK; ERR_CONFIG or ERR_TABLE if
 * `config` is not valid; or ERR_IMAGE if the image is damaged, belongs to another filter, or holds a state to
 * which no calls lead. */
mcp_asdf_status_t mcp_asdf_restore(mcp_asdf_t *robot, const mcp_asdf_config_t *config,
                                   const uint8_t image[MCP_ASDF_IMAGE_SIZE])
{
    image_t input = {.source = image, .target = NULL, .hash = HASH_START, .is_read = true};
    mcp_asdf_t restored = {0}, fresh; /* `fresh` is first a new robot, then lent to is_valid_state() */
    const bool is_robust = mcp_asdf_is_robust(config);
    const bool has_magic_word = read_word(&input) == magic_word(is_robust);
    pass_state(&input, &restored, is_robust);
    const uint32_t hash = input.hash; /* of all words but the last, which is next and should equal it */
    const bool is_undamaged = has_magic_word && read_word(&input) == hash;
    /* Errors of the config come before those of the image. The new robot gives the restored one what an image
     * leaves out: what follows from b_hat, and the robust filter's memory where the filter is another. */
    const mcp_asdf_status_t status = mcp_asdf_init(&fresh, config, restored.id, restored.accuracy.b_hat);
    if (status == MCP_ASDF_ERR_CONFIG || status == MCP_ASDF_ERR_TABLE) {
        return status;
    }
    if (!is_undamaged || status != MCP_ASDF_OK) {
        return MCP_ASDF_ERR_IMAGE;
    }
    if (!is_robust) {
        reset_robust_filter(&restored, &fresh); /* images of other filters have none */
    }
    restored.config = config;
    restored.accuracy = fresh.accuracy;
    if (!is_valid_state(&restored, &fresh)) {
        return MCP_ASDF_ERR_IMAGE;
    }
    *robot = restored;
    return MCP_ASDF_OK;
}
