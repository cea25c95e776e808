/* MCP-ASDF: collective perception of a fill ratio by robots that calibrate their own sensors.
 *
 * The method is Algorithm 1 of "Adaptive Self-Calibration for Minimalistic Collective Perception by
 * Imperfect Robot Swarms" (K. Y. Chin, C. Pinciroli, arXiv 2410.21546); "eq." below means an equation of
 * that paper. This header is the manual of the firmware; docs/design.md states every rounding rule.
 *
 * A robot calls mcp_asdf_receive() whenever a neighbour's message arrives, and once per control tick
 *
 *     mcp_asdf_observe(&robot, MCP_ASDF_BLACK);                      if the sensor saw a tile
 *     if (broadcast_timer_expired()) {
 *         broadcast(mcp_asdf_x_hat(&robot), mcp_asdf_alpha(&robot)); mcp_asdf_frame.h encodes it for CAN
 *         mcp_asdf_settle(&robot);                                   closes the round
 *     }
 *
 * A round is what a robot receives from one settle to the next, so the caller's broadcast timer sets its
 * length. mcp_asdf_x() is the answer, at any time; mcp_asdf_thousandths() makes it fit for printing.
 *
 * The functions marked MCP_ASDF_INLINE are compiled into their callers. mcp_asdf_accessors.c has them as
 * symbols of a library, for callers in other languages.
 *
 * What holds for every function
 *   - C99, freestanding. No floating point, heap, recursion, mutable static data or libc call, but for memcpy
 *     and memset where a compiler inserts them. Every function takes constant time in t and in the number of
 *     messages; only init reads the whole table.
 *   - The caller owns all memory. A pointer argument must be valid and, for robots, filled by mcp_asdf_init()
 *     or mcp_asdf_restore(); this is not checked. Whatever a fault then does to the robot's memory, apart
 *     from its config pointer, every call still returns within its usual time.
 *   - Functions touch nothing but their arguments, so different robots may run in different threads or
 *     interrupts. One robot is not reentrant: if receive() runs in an interrupt, mask that interrupt around
 *     every other call with the same robot, or queue its messages.
 *   - Every range below is inclusive. Unsigned integers; int may have 16 bits.
 *   - An error (negative status) leaves the robot as it was, except for the counter `rejected` where a
 *     function says so.
 *
 * Formats (one unit of the integer)
 *   x_hat, x_bar, x   2^-23   0 .. 2^23, which is 1.0
 *   b_hat             2^-32   MCP_ASDF_B_HAT_MIN .. MCP_ASDF_B_HAT_MAX, 2^-20 .. 1 - 2^-20
 *   alpha             a word: mantissa (bits 31..8) times 2^shift (bits 4..0) units of 2^-24; bits 7..5 are
 *                     ignored on input and 0 on output. Every word is valid: 0 .. 2^31 - 2^7
 *   sums of alpha     2^-24   an alpha is below 2^55 units, so 128 of them stay below 2^62
 */
#ifndef MCP_ASDF_H
#define MCP_ASDF_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

#ifdef __cplusplus
extern "C" {
#endif

/* Linkage of the short functions whose body stands in this header. A generator of bindings for another
 * language sees them as symbols of the library if it reads the header with -DMCP_ASDF_INLINE=extern. */
#ifndef MCP_ASDF_INLINE
#define MCP_ASDF_INLINE static inline
#endif

#define MCP_ASDF_VERSION_MAJOR 0
#define MCP_ASDF_VERSION_MINOR 2
#define MCP_ASDF_VERSION_PATCH 0

#define MCP_ASDF_MAX_ID 127U
#define MCP_ASDF_SIZE_MAX 184             /* bytes of a robot on any machine, at most */
#define MCP_ASDF_ONE (UINT32_C(1) << 23)  /* 1.0 as x_hat, x_bar or x */
#define MCP_ASDF_HALF (UINT32_C(1) << 22) /* 0.5 as x_hat, x_bar or x */
#define MCP_ASDF_B_HAT_MIN (UINT32_C(1) << 12)
#define MCP_ASDF_B_HAT_MAX UINT32_C(0xFFFFF000)
/* Of the robust filter: the number of slots, how many of them must be filled for a test, and the limits and
 * first values of members of mcp_asdf_robust_t, in their units. */
#define MCP_ASDF_SLOTS 32U
#define MCP_ASDF_TESTED_ESTIMATES_MIN 5U          /* of five, two that are wrong can be outvoted */
#define MCP_ASDF_CENTRE_START (UINT32_C(1) << 29) /* 1/2 */
#define MCP_ASDF_SPREAD_MIN (UINT32_C(1) << 18)   /* 2^-12: below what a score or a tile can show */
#define MCP_ASDF_SPREAD_MAX (UINT32_C(1) << 28)   /* 1/4: that of estimates anywhere in [0, 1] */
#define MCP_ASDF_VOTES_MAX (UINT32_C(1) << 9)
#define MCP_ASDF_DISPERSION_MIN (UINT32_C(1) << 8) /* 1: that of independent observations */
/* Limits of the memory in a config. */
#define MCP_ASDF_MEMORY_MIN UINT32_C(64)
#define MCP_ASDF_MEMORY_MAX (UINT32_C(1) << 31)

typedef enum {
    MCP_ASDF_OK = 0,
    MCP_ASDF_REPEATED = 1, /* receive: not the sender's first message in this round; counted, ignored */
    MCP_ASDF_UPDATED = 2,  /* settle, step: b_hat was re-estimated */
    MCP_ASDF_ERR_CONFIG = -1,
    MCP_ASDF_ERR_TABLE = -2,
    MCP_ASDF_ERR_ID = -3,
    MCP_ASDF_ERR_B_HAT = -4,
    MCP_ASDF_ERR_OBSERVATION = -5,
    MCP_ASDF_ERR_SENDER = -6,
    MCP_ASDF_ERR_X_HAT = -7,
    MCP_ASDF_ERR_IMAGE = -8
} mcp_asdf_status_t;

typedef enum { MCP_ASDF_WHITE = 0, MCP_ASDF_BLACK = 1 } mcp_asdf_observation_t;

/* What is built: the paper's filter and the robust one, unless a project defines one of these as 0, for all
 * sources alike. Without the robust filter a robot is smaller by 29 to 32 bytes. Without the paper's it is as
 * large, since both keep what they received in the same memory. */
#ifndef MCP_ASDF_WITH_ASDF
#define MCP_ASDF_WITH_ASDF 1
#endif
#ifndef MCP_ASDF_WITH_ROBUST
#define MCP_ASDF_WITH_ROBUST 1
#endif
#if !MCP_ASDF_WITH_ASDF && !MCP_ASDF_WITH_ROBUST
#error "no filter is left: set MCP_ASDF_WITH_ASDF or MCP_ASDF_WITH_ROBUST to 1"
#endif

/* What a robot does every filter_period rounds.
 *   ADAPTIVE  re-estimate b_hat if the test of eq. 12 rejects (the paper's ASDF)
 *   ALWAYS    re-estimate it without a test
 *   OFF       nothing
 *   ROBUST    test the initial b_hat against the estimates it has kept; this filter is not the paper's,
 *             and needs no table (docs/internals/robust.md). Where it alone is built, it is the only choice
 */
typedef enum {
    MCP_ASDF_ADAPTIVE = 0,
    MCP_ASDF_ALWAYS = 1,
    MCP_ASDF_OFF = 2,
    MCP_ASDF_ROBUST = 3
} mcp_asdf_filter_t;

/* Settings, shared by any number of robots and never written: may be const, though on an AVR not in PROGMEM,
 * as they are read like any variable. Both the struct and the table must outlive the robots.
 *   table          t-table as `mcp-asdf table` generates it (docs/porting.md); not read and may be null
 *                  unless filter is MCP_ASDF_ADAPTIVE
 *   filter_period  rounds from one run of the filter to the next, 1 .. 2^32 - 1: the paper's tau divided by
 *                  the caller's broadcast period
 *   memory         a multiple of 4, 64 .. 2^31: when t reaches it, t and n are halved (n to nearest, ties to
 *                  even). Small values forget, for sensors that drift
 *   filter         a mcp_asdf_filter_t */
typedef struct {
    const uint32_t *table;
    uint32_t filter_period;
    uint32_t memory;
    uint8_t filter;
} mcp_asdf_config_t;

/* Initialisers of mcp_asdf_config_t, named after the filter: it runs every 1000 rounds, and the memory is the
 * longest. docs/advice.md says which filter suits a swarm; a build has the initialisers of its filters only.
 */
#if MCP_ASDF_WITH_ROBUST
/* For all robots of a swarm in which nobody knows whose sensor is wrong. */
#define MCP_ASDF_CONFIG_ROBUST {NULL, 1000, MCP_ASDF_MEMORY_MAX, MCP_ASDF_ROBUST}
#endif
#if MCP_ASDF_WITH_ASDF
/* For robots whose sensors you doubt. In robots with a good sensor it does harm: give them one of the others.
 */
#define MCP_ASDF_CONFIG_ASDF(t_table) {(t_table), 1000, MCP_ASDF_MEMORY_MAX, MCP_ASDF_ADAPTIVE}
/* For robots whose sensors are known to be calibrated: b_hat stays. */
#define MCP_ASDF_CONFIG_OFF {NULL, 1000, MCP_ASDF_MEMORY_MAX, MCP_ASDF_OFF}
#endif

/* b_hat of a sensor that is right so many times out of so many: MCP_ASDF_PROBABILITY(95, 100) is 0.95 in
 * units of 2^-32, rounded to nearest, halves up. A constant expression where both are integer constants,
 * which may be 0 .. 2^32 - 1. One and more become 2^32 - 1, which mcp_asdf_init() refuses, as it does 0.
 * Where right < all, the dividend is below 2^64 - 2^32 and the quotient below 2^32. */
#define MCP_ASDF_PROBABILITY(right, all)                                                                     \
    ((right) < (all) ? (uint32_t)((((uint64_t)(right) << 32) + (uint64_t)(all) / 2U) / (uint64_t)(all))      \
                     : UINT32_MAX)

/* Whether a robot with these settings has the robust filter; a constant where there is no choice. */
MCP_ASDF_INLINE bool mcp_asdf_is_robust(const mcp_asdf_config_t *config)
{
    return MCP_ASDF_WITH_ROBUST && (!MCP_ASDF_WITH_ASDF || config->filter == MCP_ASDF_ROBUST);
}

/* Diagnostics, each modulo 2^16: take differences. */
typedef struct {
    uint16_t accepted; /* messages that entered a round, those with alpha = 0 included */
    uint16_t repeated; /* further messages of a sender in one round */
    uint16_t rejected; /* invalid messages */
    uint16_t tests;    /* hypothesis tests run */
    uint16_t updates;  /* re-estimates of b_hat */
} mcp_asdf_counters_t;

/* b_hat and what follows from it alone, formed when it changes, with c = min(b_hat, 1 - b_hat) and
 * g = 1 - 2c. */
typedef struct {
    uint32_t b_hat;      /* unit 2^-32 */
    uint32_t c;          /* unit 2^-32; 2^32 - 1 if |2 b_hat - 1| < 2^-12: no information */
    uint32_t common;     /* (g / (1 - c))^2, unit 2^(-30 - 2 g_shift): weight of the common colour in eq. 4 */
    uint32_t rare;       /* (g / c)^2, unit 2^(rare_shift - 30 - 2 g_shift): weight of the rare colour */
    uint32_t g_shift;    /* 0 .. 31; above 11 only without information */
    uint32_t rare_shift; /* even, 0 .. 38 */
} mcp_asdf_accuracy_t;

/* Sums over the messages of a closed round that have alpha > 0 (eq. 5 and 6). With alpha in units of 2^-24
 * split into alpha = high 2^32 + low, the product alpha x_hat is summed in two parts that need no carry
 * between them.
 *   alpha         sum of alpha        < 2^62, unit 2^-24
 *   alpha_x_low   sum of low x_hat    < 2^62, unit 2^-47
 *   alpha_x_high  sum of high x_hat   < 2^53, unit 2^-15 */
typedef struct {
    uint64_t alpha;
    uint64_t alpha_x_low;
    uint64_t alpha_x_high;
} mcp_asdf_closed_t;

/* The same of the open round, with what its test needs (eq. 12).
 *   x_squared     sum of x_hat^2                    < 2^53, unit 2^-46
 *   x             sum of x_hat                      < 2^30, unit 2^-23
 *   count         m, the number of these messages   0 .. 127 */
typedef struct {
    uint64_t alpha;
    uint64_t alpha_x_low;
    uint64_t alpha_x_high;
    uint64_t x_squared;
    uint32_t x;
    uint32_t count;
} mcp_asdf_open_t;

/* The sums of the open round and of the last closed one. */
typedef struct {
    mcp_asdf_open_t open;
    mcp_asdf_closed_t closed;
} mcp_asdf_sums_t;

/* What a robot received. With the robust filter it keeps the latest estimate of each sender, in slot id mod
 * 32; with the others the sums of rounds, in the same memory.
 *   estimates   x_hat of a message with alpha > 0, unit 2^-16, to nearest; 2^16 - 1 for 1.0 */
typedef union {
    uint16_t estimates[MCP_ASDF_SLOTS];
#if MCP_ASDF_WITH_ASDF
    mcp_asdf_sums_t sums;
#endif
} mcp_asdf_received_t;

/* What a robot with the robust filter keeps beside the estimates received.
 *   centre         of the votes, unit 2^-30: 0 .. 2^30; MCP_ASDF_CENTRE_START before any
 *   spread         their median distance from it, unit 2^-30: 2^18 .. 2^28
 *   initial_b_hat  unit 2^-32: what the test is about; 0 with other filters
 *   filled_slots   bit i is set if slot i has an estimate
 *   batch_t        t and n when the present batch of observations began: at the last run of the filter or,
 *   batch_n        if that was later, at the last halving of t
 *   votes          how many were taken, up to 2^9: the more, the less the next changes centre and spread
 *   dispersion     how many times as large the variance of n from batch to batch is as that of independent
 *                  observations, unit 2^-8: 2^8 .. 2^16 - 1
 *   turn           0 .. 32: the next filled slot from this one on votes; if there is none, the robot's own
 *                  estimate does, unless it has no confidence */
typedef struct {
    uint32_t centre;
    uint32_t spread;
    uint32_t initial_b_hat;
    uint32_t filled_slots;
    uint32_t batch_t;
    uint32_t batch_n;
    uint16_t votes;
    uint16_t dispersion;
    uint8_t turn;
} mcp_asdf_robust_t;

/* A set of senders, in two forms. */
typedef union {
    uint8_t of[16];  /* bit (id mod 8) of byte (id div 8) */
    uint64_t all[2]; /* the same, to forget them at once */
} mcp_asdf_senders_t;

/* A robot. Its members are the state; read them through the functions below. The order keeps them within
 * reach of short instructions: bytes first, then half words, then what a tick touches. Whoever has no header
 * to ask for its size takes MCP_ASDF_SIZE_MAX bytes, aligned as a uint64_t. */
typedef struct {
    mcp_asdf_senders_t heard; /* senders of the open round */
    uint8_t id;
    uint8_t updated; /* 1 if b_hat was re-estimated since the last observation, else 0 */
    mcp_asdf_counters_t counters;
    mcp_asdf_accuracy_t accuracy;
    const mcp_asdf_config_t *config;
    uint32_t t; /* observations counted, and the black ones among them */
    uint32_t n;
    uint32_t x_hat; /* of the last observation */
    uint32_t alpha;
    uint32_t filter_left; /* rounds until the filter runs */
#if MCP_ASDF_WITH_ROBUST
    mcp_asdf_robust_t robust;
#endif
    mcp_asdf_received_t received;
} mcp_asdf_t;

/* Make a robot: no observations, no messages. Writes every member. O(q) for the table.
 *   id     0 .. 127, unique among neighbours
 *   b_hat  assumed sensor accuracy, the same for both colours, MCP_ASDF_B_HAT_MIN .. MCP_ASDF_B_HAT_MAX
 * Fails if filter_period is 0, memory is out of range or no multiple of 4, or filter is unknown
 * (ERR_CONFIG); the filter is adaptive and the table is null, damaged, out of order or of another format
 * (ERR_TABLE; where the damage is to its number of entries, up to 130 words are read); id > 127 (ERR_ID);
 * b_hat is out of range (ERR_B_HAT). On failure *robot is unchanged. */
mcp_asdf_status_t mcp_asdf_init(mcp_asdf_t *robot, const mcp_asdf_config_t *config, uint8_t id,
                                uint32_t b_hat);

/* Count the observation z and form x_hat (eq. 3) and alpha (eq. 4). In a tick without an observation, do not
 * call it.
 * Fails if z is neither MCP_ASDF_WHITE nor MCP_ASDF_BLACK (ERR_OBSERVATION). */
mcp_asdf_status_t mcp_asdf_observe(mcp_asdf_t *robot, mcp_asdf_observation_t z);

/* Add a neighbour's message to the open round, at any time. A message with alpha = 0 is accepted, but enters
 * no sum: it carries no information. Returns MCP_ASDF_REPEATED, and counts `repeated`, for all but the first
 * message of a sender in a round; this is normal where clocks are not aligned. Fails if sender > 127 or is
 * the robot's own id (ERR_SENDER), or x_hat > 1.0 (ERR_X_HAT): counts `rejected`. */
mcp_asdf_status_t mcp_asdf_receive(mcp_asdf_t *robot, uint8_t sender, uint32_t x_hat, uint32_t alpha);

/* Close the open round; the next one starts empty. Every filter_period rounds, run the filter: test the round
 * against x_hat (eq. 12) and on rejection re-estimate b_hat from x_bar (eq. 8), which shows in x_hat and
 * alpha at the next observation. Returns MCP_ASDF_UPDATED after a re-estimate, else MCP_ASDF_OK. Cannot
 * fail. */
mcp_asdf_status_t mcp_asdf_settle(mcp_asdf_t *robot);

/* observe(z), then settle(): a tick that is a round. Returns what settle returns; fails as observe does, and
 * then nothing is settled. */
mcp_asdf_status_t mcp_asdf_step(mcp_asdf_t *robot, mcp_asdf_observation_t z);

/* Social estimate (eq. 5) of the last closed round, unit 2^-23, rounded down; MCP_ASDF_HALF if beta is 0.
 * With the robust filter the centre, rounded down. */
uint32_t mcp_asdf_x_bar(const mcp_asdf_t *robot);

/* Informed estimate (eq. 7) of the present x_hat and alpha and the last closed round, unit 2^-23: the exact
 * quotient of the sums, rounded down; x_hat if both confidences are 0. Formed when asked for, at the price of
 * one division. With the robust filter the centre, rounded down; x_hat before the first message. */
uint32_t mcp_asdf_x(const mcp_asdf_t *robot);

/* Own id, 0 .. 127. */
MCP_ASDF_INLINE uint8_t mcp_asdf_id(const mcp_asdf_t *robot) { return robot->id; }

/* Observations counted, and the black ones among them. */
MCP_ASDF_INLINE uint32_t mcp_asdf_t_count(const mcp_asdf_t *robot) { return robot->t; }
MCP_ASDF_INLINE uint32_t mcp_asdf_n_count(const mcp_asdf_t *robot) { return robot->n; }

/* Assumed accuracy, unit 2^-32. */
MCP_ASDF_INLINE uint32_t mcp_asdf_b_hat(const mcp_asdf_t *robot) { return robot->accuracy.b_hat; }

/* Local estimate (eq. 3), unit 2^-23, and local confidence (eq. 4), an alpha word: what to broadcast. */
MCP_ASDF_INLINE uint32_t mcp_asdf_x_hat(const mcp_asdf_t *robot) { return robot->x_hat; }
MCP_ASDF_INLINE uint32_t mcp_asdf_alpha(const mcp_asdf_t *robot) { return robot->alpha; }

#if MCP_ASDF_WITH_ASDF
/* Social confidence (eq. 6) of the last closed round, unit 2^-24, below 2^62; 0 with the robust filter. */
MCP_ASDF_INLINE uint64_t mcp_asdf_beta(const mcp_asdf_t *robot)
{
    return mcp_asdf_is_robust(robot->config) ? 0U : robot->received.sums.closed.alpha;
}
#endif

#if MCP_ASDF_WITH_ROBUST
/* What a robot with the robust filter knows of the others. */
MCP_ASDF_INLINE mcp_asdf_robust_t mcp_asdf_robust(const mcp_asdf_t *robot) { return robot->robust; }
#endif

/* Diagnostics since init. */
MCP_ASDF_INLINE mcp_asdf_counters_t mcp_asdf_counters(const mcp_asdf_t *robot) { return robot->counters; }

/* x, x_bar or x_hat in thousandths, 0 .. 1000, rounded to nearest, halves up; of b_hat it takes b_hat >> 9.
 * For people to read, without floating point, a 64-bit product, or an overflow of whatever has 32 bits:
 *
 *     const unsigned share = mcp_asdf_thousandths(mcp_asdf_x(&robot));
 *     printf("%u.%03u", share / 1000, share % 1000);
 */
MCP_ASDF_INLINE uint16_t mcp_asdf_thousandths(uint32_t x)
{
    const uint32_t half = UINT32_C(1) << 19; /* of 2^20, to round to nearest */
    /* 1000 x / 2^23 is 125 x / 2^20, and 125 2^23 + 2^19 < 2^30. */
    return (uint16_t)((x * 125U + half) >> 20);
}

#ifdef __cplusplus
}
#endif

#endif
