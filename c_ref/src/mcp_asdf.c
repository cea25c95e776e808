/* The method of MCP-ASDF, in the order of the paper. mcp_asdf.h is the manual, docs/design.md the
 * specification of every bit; words, products and quotients are those of mcp_asdf_arithmetic.h.
 *
 * A sum or product below cannot wrap unless its comment says that it may.
 */
#include "mcp_asdf.h"

#include <stddef.h>

#include "mcp_asdf_arithmetic.h"
#include "mcp_asdf_robust.h"

#define ONE_HALF (UINT32_C(1) << 31) /* as Q32 */
/* |2 p - 1| = 2^-12 as Q32: closer to 1/2, a probability says nothing. */
#define INFORMATIVE (UINT32_C(1) << 20)
#define TABLE_MAGIC UINT32_C(0x4D435400)     /* its last byte is q */
#define TABLE_OMEGA_MAX UINT32_C(3865470566) /* 0.9 as Q32 */
#define K_ONE (UINT32_C(1) << 26)            /* k_m is Q26 in 32 bits: below 64 */

/* The filters that are built. */
#define FILTER_FIRST ((uint32_t)(MCP_ASDF_WITH_ASDF ? MCP_ASDF_ADAPTIVE : MCP_ASDF_ROBUST))
#define FILTER_LAST ((uint32_t)(MCP_ASDF_WITH_ROBUST ? MCP_ASDF_ROBUST : MCP_ASDF_OFF))

/* Bounds that the comments rely on, as far as the compiler can see them. */
#define ASSERT(name, condition) typedef char assert_##name[(condition) ? 1 : -1]
ASSERT(enough_senders, sizeof(((mcp_asdf_t *)0)->heard) * 8 == MCP_ASDF_MAX_ID + 1);
ASSERT(size_is_stated, sizeof(mcp_asdf_t) <= MCP_ASDF_SIZE_MAX);
ASSERT(t_is_a_word, MCP_ASDF_MEMORY_MAX <= ONE_HALF);
ASSERT(halves_mirror, MCP_ASDF_MEMORY_MIN % 4 == 0);
ASSERT(b_hat_mirrors, MCP_ASDF_B_HAT_MIN + MCP_ASDF_B_HAT_MAX == 0); /* modulo 2^32 */

/* ---- The local estimate: eq. 3 and 4 ---- */

/* (g / p)^2 as Q30, for g and p in [2^31, 2^32), from a quotient of 24 or 25 bits. */
static uint32_t square_of_ratio(uint32_t g, uint32_t p)
{
    const uint32_t ratio = divide_24(g >> 1, p >> 1) << 7; /* Q31, in (2^30, 2^32) */
    return multiply_high(ratio, ratio);                    /* [2^28, 2^32) */
}

static void set_b_hat(mcp_asdf_t *robot, uint32_t b_hat)
{
    mcp_asdf_accuracy_t *const accuracy = &robot->accuracy;
    const uint32_t c = b_hat < ONE_HALF ? b_hat : 0U - b_hat;              /* [2^12, 2^31] */
    const uint32_t g = 0U - 2U * c;                                        /* 2^32 - 2c: [0, 2^32 - 2^13] */
    const uint32_t g_shift = leading_zeros(g), c_shift = leading_zeros(c); /* [0, 31], [0, 19] */
    accuracy->b_hat = b_hat;
    accuracy->c = g < INFORMATIVE ? UINT32_MAX : c;
    accuracy->common = square_of_ratio(shift_left(g, g_shift), 0U - c);
    accuracy->rare = square_of_ratio(shift_left(g, g_shift), shift_left(c, c_shift));
    accuracy->g_shift = g_shift;
    accuracy->rare_shift = 2U * c_shift;
}

typedef struct {
    uint32_t x_hat, alpha;
} message_t;

/* The alpha word of mantissa 2^exponent units, rounded down to whole units; mantissa in [2^23, 2^24),
 * exponent modulo 2^32. */
HOT uint32_t alpha_word(uint32_t mantissa, uint32_t exponent)
{
    if (exponent >> 31 != 0U) { /* negative, by at most 22 */
        return shift_right(mantissa, (0U - exponent) & 31U) << 8;
    }
    return exponent <= ALPHA_SHIFT_MAX ? mantissa << 8 | exponent : ALPHA_MAX;
}

/* Eq. 3 and 4 for t > 0. White and black are mirror images, and so are b_hat and 1 - b_hat: only the rarer
 * colour is looked at, under the accuracy above 1/2. With p = part / t, all cases of eq. 4 are
 * part (g / p')^2 + (t - part) (g / (1 - p'))^2, where p' is p, but at least c. */
HOT message_t estimate(uint32_t t, uint32_t n, const mcp_asdf_accuracy_t *accuracy)
{
    const uint32_t g_shift = accuracy->g_shift & 31U; /* whatever damaged memory holds */
    const uint32_t white = t - n, part = n < white ? n : white;
    const uint32_t shift = leading_zeros(t);
    const uint32_t total = shift_left(t, shift);              /* [2^31, 2^32) */
    const uint32_t rarer = shift_left(part, shift);           /* <= total / 2 */
    const uint32_t least = multiply_high(accuracy->c, total); /* c t */
    uint32_t x = 0, mantissa, exponent;                       /* the exponent modulo 2^32 */
    if (rarer <= least) {                                     /* p' = c; always so without information */
        if (accuracy->c == UINT32_MAX) {
            const message_t nothing = {MCP_ASDF_HALF, 0};
            return nothing;
        }
        uint64_t sum = multiply(t - part, accuracy->common); /* < 2^63 */
        exponent = 34U - 2U * g_shift; /* 40 bits below the mantissa + 24 of alpha - 30 of the weights */
        if (part != 0U) {
            sum = multiply(part, accuracy->rare) + shift_right_64(sum, accuracy->rare_shift); /* < 2^64 */
            exponent += accuracy->rare_shift;
        }
        if (high_word(sum) == 0U) {
            sum = join(low_word(sum), 0);
            exponent -= 32U;
        }
        const uint32_t sum_shift = leading_zeros(high_word(sum));
        mantissa = upper(sum, sum_shift) >> 8;
        exponent -= sum_shift;
    } else { /* p' = p: x = (p - c) / g, and alpha = g^2 t / (p (1 - p)) */
        const uint32_t scale = shift_left(total - 2U * least, g_shift); /* g t: [2^30, 2^32) */
        const uint32_t above = shift_left(rarer - least, g_shift);      /* <= scale / 2, where x is 1/2 */
        x = divide_24(above, scale >> 1) >> 2;
        const uint32_t square = multiply_high(multiply_high(scale, scale), total); /* [2^27, 2^32) */
        const uint64_t spread = multiply(rarer, total - rarer);                    /* [2^41, 2^62] */
        const uint32_t square_shift = leading_zeros(square), spread_shift = leading_zeros(high_word(spread));
        /* 32 = 64 bits below the products + 24 of alpha - 32 below the divisor - 24 of the quotient */
        exponent = 32U - 2U * g_shift - shift + spread_shift - square_shift;
        mantissa = divide_24(shift_left(square, square_shift) >> 1, upper(spread, spread_shift) >> 1);
        const uint32_t excess = mantissa >> 24 & 1U; /* the quotient is in [2^23, 2^25) */
        mantissa >>= excess;                         /* a shift by at most 1 */
        exponent += excess;
    }
    const bool mirrored =
        ((n - white) ^ accuracy->b_hat) >> 31 != 0U; /* either white is rarer or b_hat < 1/2 */
    const message_t found = {mirrored ? MCP_ASDF_ONE - x : x, alpha_word(mantissa, exponent)};
    return found;
}

HOT_PUBLIC mcp_asdf_status_t mcp_asdf_observe(mcp_asdf_t *robot, mcp_asdf_observation_t z)
{
    if ((uint32_t)z > (uint32_t)MCP_ASDF_BLACK) {
        return MCP_ASDF_ERR_OBSERVATION;
    }
    uint32_t t = robot->t + 1U, n = robot->n + (uint32_t)z; /* <= 2^31 */
    if (t >= robot->config->memory) {
        t >>= 1;
        n = (n + (n >> 1 & 1U)) >> 1; /* to nearest, ties to even */
    }
    robot->t = t;
    robot->n = n;
    robot->updated = 0;
    const message_t own = estimate(t, n, &robot->accuracy);
    robot->x_hat = own.x_hat;
    robot->alpha = own.alpha;
    return MCP_ASDF_OK;
}

/* ---- The round: eq. 5 to 7, and 12 ---- */

#if MCP_ASDF_WITH_ASDF

/* An alpha in units of 2^-24, below 2^55. */
ALWAYS_INLINE word_pair_t units(uint32_t alpha) { return shift_left_wide(alpha >> 8, alpha); }

/* A neighbour's message with alpha > 0 into the sums of the open round. */
HOT void add_message(mcp_asdf_t *robot, uint32_t x_hat, uint32_t alpha)
{
    mcp_asdf_open_t *const open = &robot->open;
    const word_pair_t said = units(alpha);
    add(&open->alpha, join(said.high, said.low));         /* + 2^55 */
    add(&open->alpha_x_low, multiply(said.low, x_hat));   /* + 2^55 */
    add(&open->alpha_x_high, multiply(said.high, x_hat)); /* + 2^46 */
    add(&open->x_squared, multiply(x_hat, x_hat));        /* + 2^46 */
    open->x += x_hat;                                     /* + 2^23 */
    ++open->count;
}

/* Sum of alpha x_hat over sum of alpha > 0 (eq. 5 and 7), which is at most 1.0, as Q32. */
HOT uint32_t mean(uint64_t alpha, uint64_t alpha_x_low, uint64_t alpha_x_high)
{
    const uint64_t middle = alpha_x_high + high_word(alpha_x_low); /* < 2^53 + 2^30: the sum from bit 32 up */
    const uint32_t low = low_word(alpha_x_low);
    uint64_t whole = middle << 9 | low >> 23; /* in units of alpha: <= alpha < 2^62 */
    if (high_word(alpha) == 0U) {             /* then alpha_x_low is all, and the fraction is left */
        whole = join(low_word(whole), low << 9);
        alpha = join(low_word(alpha), 0);
    }
    return quotient(whole, alpha);
}

/* Eq. 7, where the own estimate is one message more: the exact quotient, rounded down. The upper 23 bits of
 * the quotient are right or one too small; the rest of the division, which is below 2 alpha, shows which. */
HOT uint32_t informed_estimate(const mcp_asdf_closed_t *closed, uint32_t x_hat, uint32_t own_alpha)
{
    const word_pair_t own = units(own_alpha);
    const uint64_t alpha = closed->alpha + join(own.high, own.low); /* of 128 robots: < 2^62 */
    if (alpha == 0U) {
        return x_hat;
    }
    const uint64_t alpha_x_low = closed->alpha_x_low + multiply(own.low, x_hat);
    const uint64_t alpha_x_high = closed->alpha_x_high + multiply(own.high, x_hat);
    const uint32_t x = mean(alpha, alpha_x_low, alpha_x_high) >> 9;
    const uint64_t sum = alpha_x_low + join(low_word(alpha_x_high), 0);                    /* modulo 2^64 */
    const uint64_t product = multiply(x, low_word(alpha)) + join(x * high_word(alpha), 0); /* the same */
    return x + (uint32_t)(sum - product >= alpha);
}

/* The last closed round with an own estimate: eq. 7. Eq. 5 is eq. 7 for a robot that knows nothing. */
ALWAYS_INLINE uint32_t round_x(const mcp_asdf_t *robot, uint32_t x_hat, uint32_t alpha)
{
    return informed_estimate(&robot->closed, x_hat, alpha);
}

/* Eq. 12 on m >= 2 messages, multiplied out: (sum x - m x_hat)^2 > k_m (m sum x^2 - (sum x)^2). An integer
 * compared with a real, so rounding the right side down decides alike. */
static bool test_rejects(const mcp_asdf_t *robot)
{
    const uint32_t *const table = robot->config->table;
    const uint32_t q = MCP_ASDF_READ_WORD(&table[0]) & 0xFFU, m = robot->open.count;
    const uint32_t k = MCP_ASDF_READ_WORD(&table[m <= q ? m : q + 1U]);
    const uint32_t x = robot->open.x, own = m * robot->x_hat; /* < 2^30 */
    const uint32_t difference = x > own ? x - own : own - x;  /* < 2^30 */
    const uint64_t spread =
        m * robot->open.x_squared - multiply(x, x);                  /* [0, m^2 / 4 2^46] (Cauchy): < 2^58 */
    const uint64_t upper_part = multiply(k, high_word(spread)) << 6; /* < 2^64 */
    return multiply(difference, difference) > upper_part + (multiply(k, low_word(spread)) >> 26);
}

/* What b_hat becomes after a round, for t > 0; 0 if it stays. */
ALWAYS_INLINE uint32_t round_b_hat(mcp_asdf_t *robot)
{
    const mcp_asdf_closed_t *const closed = &robot->closed;
    const uint8_t mode = robot->config->filter;
    if (mode == MCP_ASDF_OFF || robot->open.count < (mode == MCP_ASDF_ADAPTIVE ? 2U : 1U)) {
        return 0;
    }
    if (mode == MCP_ASDF_ADAPTIVE) {
        ++robot->counters.tests;
        if (!test_rejects(robot)) {
            return 0;
        }
    }
    return reestimate(robot, mean(closed->alpha, closed->alpha_x_low, closed->alpha_x_high));
}

ALWAYS_INLINE void close_round(mcp_asdf_t *robot)
{
    const mcp_asdf_open_t *const open = &robot->open;
    robot->closed.alpha = open->alpha;
    robot->closed.alpha_x_low = open->alpha_x_low;
    robot->closed.alpha_x_high = open->alpha_x_high;
}

/* Member by member: cheaper than the library call a compiler makes of a whole struct. */
ALWAYS_INLINE void open_round(mcp_asdf_t *robot)
{
    mcp_asdf_open_t *const open = &robot->open;
    open->alpha = 0;
    open->alpha_x_low = 0;
    open->alpha_x_high = 0;
    open->x_squared = 0;
    open->x = 0;
    open->count = 0;
}

/* Words 0 .. q + 1 are magic and q, omega, k_2 .. k_q, and k for m > q; the last is FNV-1a over them, by
 * words. The k fall strictly and stay above 1. */
static bool table_valid(const uint32_t *table)
{
    const uint32_t head = MCP_ASDF_READ_WORD(&table[0]);
    const uint8_t end = (uint8_t)(head + 2U); /* q + 2, where the hash is */
    if (head < TABLE_MAGIC + 2U || head > TABLE_MAGIC + MCP_ASDF_MAX_ID) {
        return false;
    }
    uint32_t hash = HASH_START, previous = 0;
    for (uint8_t i = 0; i < end; ++i) { /* at most 129 turns */
        const uint32_t word = MCP_ASDF_READ_WORD(&table[i]);
        if (word >= previous && i > 2U) {
            return false;
        }
        previous = word;
        hash = hash_word(hash, word);
    }
    return previous > K_ONE && hash == MCP_ASDF_READ_WORD(&table[end]) &&
           MCP_ASDF_READ_WORD(&table[1]) - 1U < TABLE_OMEGA_MAX;
}

#else /* the robust filter alone: calls of what follows disappear */

ALWAYS_INLINE void add_message(const mcp_asdf_t *robot, uint32_t x_hat, uint32_t alpha)
{
    (void)robot, (void)x_hat, (void)alpha;
}
ALWAYS_INLINE uint32_t round_x(const mcp_asdf_t *robot, uint32_t x_hat, uint32_t alpha)
{
    return (void)robot, (void)alpha, x_hat;
}
ALWAYS_INLINE uint32_t round_b_hat(const mcp_asdf_t *robot) { return (void)robot, 0; }
ALWAYS_INLINE void close_round(const mcp_asdf_t *robot) { (void)robot; }
ALWAYS_INLINE void open_round(const mcp_asdf_t *robot) { (void)robot; }
ALWAYS_INLINE bool table_valid(const uint32_t *table) { return (void)table, true; }

#endif

uint32_t mcp_asdf_x(const mcp_asdf_t *robot)
{
    return mcp_asdf_is_robust(robot->config) ? crowd_x(robot, robot->x_hat)
                                             : round_x(robot, robot->x_hat, robot->alpha);
}

uint32_t mcp_asdf_x_bar(const mcp_asdf_t *robot)
{
    return mcp_asdf_is_robust(robot->config) ? crowd_x(robot, MCP_ASDF_HALF)
                                             : round_x(robot, MCP_ASDF_HALF, 0);
}

/* ---- Receive ---- */

mcp_asdf_status_t mcp_asdf_receive(mcp_asdf_t *robot, uint8_t sender, uint32_t x_hat, uint32_t alpha)
{
    if (sender > MCP_ASDF_MAX_ID || sender == robot->id) {
        ++robot->counters.rejected;
        return MCP_ASDF_ERR_SENDER;
    }
    if (x_hat > MCP_ASDF_ONE) {
        ++robot->counters.rejected;
        return MCP_ASDF_ERR_X_HAT;
    }
    uint8_t *const heard = &robot->heard.of[sender >> 3];
    const uint32_t before = *heard, after = before | UINT32_C(1) << (sender & 7U);
    if (before == after) {
        ++robot->counters.repeated;
        return MCP_ASDF_REPEATED;
    }
    ++robot->counters.accepted;
    *heard = (uint8_t)after;
    if (alpha >> 8 == 0U) {
        return MCP_ASDF_OK;
    }
    if (mcp_asdf_is_robust(robot->config)) {
        vote(robot, sender, x_hat);
    } else {
        add_message(robot, x_hat, alpha);
    }
    return MCP_ASDF_OK;
}

/* ---- The filter: eq. 8 ---- */

/* Eq. 8 with x_bar = a: b_hat = (n / t + a - 1) / (2a - 1), which is (1 - n / t - a) / (1 - 2a) with both
 * colours exchanged. 0 where a says nothing. */
static uint32_t reestimate(const mcp_asdf_t *robot, uint32_t a)
{
    const uint32_t t = robot->t;
    uint32_t n = robot->n;
    if (a < ONE_HALF) {
        a = ~a; /* 1 - a, and 2^-32 less */
        n = t - n;
    }
    const uint32_t g = 2U * a; /* 2a - 1 as Q32 */
    if (g < INFORMATIVE) {
        return 0;
    }
    const uint64_t span = multiply(t, g);                         /* t (2a - 1): < 2^63 */
    const uint64_t difference = join(n, 0) - multiply(t, 0U - a); /* n - t (1 - a): within 2^63 of 0 */
    const uint64_t above = difference >> 63 == 0U ? difference : 0U;
    uint32_t b_hat = quotient(above < span ? above : span, span);
    b_hat = b_hat > MCP_ASDF_B_HAT_MIN ? b_hat : MCP_ASDF_B_HAT_MIN;
    return b_hat < MCP_ASDF_B_HAT_MAX ? b_hat : MCP_ASDF_B_HAT_MAX;
}

NOINLINE mcp_asdf_status_t filter(mcp_asdf_t *robot)
{
    if (robot->t == 0U) {
        return MCP_ASDF_OK;
    }
    const uint32_t b_hat = mcp_asdf_is_robust(robot->config) ? crowd_b_hat(robot) : round_b_hat(robot);
    if (b_hat == 0U) {
        return MCP_ASDF_OK;
    }
    set_b_hat(robot, b_hat);
    ++robot->counters.updates;
    robot->updated = 1;
    return MCP_ASDF_UPDATED;
}

/* ---- Rounds ---- */

HOT_PUBLIC mcp_asdf_status_t mcp_asdf_settle(mcp_asdf_t *robot)
{
    mcp_asdf_status_t status = MCP_ASDF_OK;
    close_round(robot);
    if (--robot->filter_left == 0U) {
        robot->filter_left = robot->config->filter_period;
        status = filter(robot);
    }
    open_round(robot);
    robot->heard.all[0] = 0;
    robot->heard.all[1] = 0;
    return status;
}

mcp_asdf_status_t mcp_asdf_step(mcp_asdf_t *robot, mcp_asdf_observation_t z)
{
    const mcp_asdf_status_t status = mcp_asdf_observe(robot, z);
    return status == MCP_ASDF_OK ? mcp_asdf_settle(robot) : status;
}

/* ---- Init ---- */

static mcp_asdf_status_t check(const mcp_asdf_config_t *config, uint8_t id, uint32_t b_hat)
{
    if (config->filter_period == 0U || config->memory < MCP_ASDF_MEMORY_MIN ||
        config->memory > MCP_ASDF_MEMORY_MAX || config->memory % 4U != 0U ||
        (uint32_t)config->filter - FILTER_FIRST > FILTER_LAST - FILTER_FIRST) {
        return MCP_ASDF_ERR_CONFIG;
    }
    if (config->filter == MCP_ASDF_ADAPTIVE && (config->table == NULL || !table_valid(config->table))) {
        return MCP_ASDF_ERR_TABLE;
    }
    if (id > MCP_ASDF_MAX_ID) {
        return MCP_ASDF_ERR_ID;
    }
    return b_hat - MCP_ASDF_B_HAT_MIN > MCP_ASDF_B_HAT_MAX - MCP_ASDF_B_HAT_MIN ? MCP_ASDF_ERR_B_HAT
                                                                                : MCP_ASDF_OK;
}

mcp_asdf_status_t mcp_asdf_init(mcp_asdf_t *robot, const mcp_asdf_config_t *config, uint8_t id,
                                uint32_t b_hat)
{
    const mcp_asdf_status_t status = check(config, id, b_hat);
    if (status == MCP_ASDF_OK) {
        *robot = (mcp_asdf_t){
            .id = id, .config = config, .x_hat = MCP_ASDF_HALF, .filter_left = config->filter_period};
        start_crowd(robot, b_hat);
        set_b_hat(robot, b_hat);
    }
    return status;
}
