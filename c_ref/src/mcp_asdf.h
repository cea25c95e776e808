/* MCP-ASDF: collective perception of a fill ratio by robots that calibrate their own sensors.
 *
 * The method is Algorithm 1 of "Minimalistic Collective Perception with an Adaptive Sensor
 * Degradation Filter" (arXiv 2410.21546); "eq." below means an equation of that paper. This header is
 * the manual of the firmware; docs/design.md gives every rounding rule and the bounds behind it.
 *
 * A robot calls, once per control tick,
 *
 *     if (mcp_asdf_observe(&robot, MCP_ASDF_BLACK) == MCP_ASDF_DUE)
 *         broadcast(mcp_asdf_x_hat(&robot), mcp_asdf_alpha(&robot));
 *     mcp_asdf_settle(&robot);
 *
 * and mcp_asdf_receive() whenever a neighbour's message arrives. mcp_asdf_x() is the answer.
 *
 * What holds for every function
 *   - C99, freestanding. No floating point, heap, recursion, mutable static data or libc call. Every
 *     function is O(1) in t and in the number of messages; only init and restore read the whole table.
 *   - The caller owns all memory. A pointer argument must be valid and, for robots, filled by
 *     mcp_asdf_init() or mcp_asdf_restore(); this is not checked.
 *   - Functions touch nothing but their arguments, so different robots may run in different threads or
 *     interrupts. One robot is not reentrant: if receive() runs in an interrupt, mask that interrupt
 *     around every other call with the same robot, or queue its messages.
 *   - Every range below is inclusive. Unsigned integers; int may have 16 bits.
 *   - An error (negative status) leaves the robot as it was, except for the counter `rejected` where
 *     a function says so.
 *
 * Formats (one unit of the integer)
 *   x_hat, x_bar, x   2^-23       0 .. 2^23, which is 1.0
 *   b_hat             2^-32       MCP_ASDF_B_HAT_MIN .. MCP_ASDF_B_HAT_MAX, 2^-20 .. 1 - 2^-20
 *   alpha             binary32    the bits of the IEEE 754 number, as on the wire; the value is a multiple
 *                                 of 2^-24 with at most 24 significant bits, 0 .. 2^31 - 2^7
 *   sums of alpha     2^-24       alpha <= 2^55 units, so 128 of them stay below 2^62
 */
#ifndef MCP_ASDF_H
#define MCP_ASDF_H

#include <stdbool.h>
#include <stdint.h>

#ifdef __cplusplus
extern "C" {
#endif

/* Version of the library, and of the image that mcp_asdf_save() writes. */
#define MCP_ASDF_VERSION_MAJOR 0
#define MCP_ASDF_VERSION_MINOR 1
#define MCP_ASDF_VERSION_PATCH 0
#define MCP_ASDF_IMAGE_VERSION 1

/* Where constant tables live, and how a word or byte of one is read. On an AVR they stay in flash. Define all
 * three or none. */
#if !defined(MCP_ASDF_ROM) && !defined(MCP_ASDF_READ_WORD) && !defined(MCP_ASDF_READ_BYTE)
#ifdef __AVR__
#include <avr/pgmspace.h>
#define MCP_ASDF_ROM PROGMEM
#define MCP_ASDF_READ_WORD(address) pgm_read_dword(address)
#define MCP_ASDF_READ_BYTE(address) pgm_read_byte(address)
#else
#define MCP_ASDF_ROM
#define MCP_ASDF_READ_WORD(address) (*(address))
#define MCP_ASDF_READ_BYTE(address) (*(address))
#endif
#elif !defined(MCP_ASDF_ROM) || !defined(MCP_ASDF_READ_WORD) || !defined(MCP_ASDF_READ_BYTE)
#error "define all of MCP_ASDF_ROM, MCP_ASDF_READ_WORD and MCP_ASDF_READ_BYTE, or none"
#endif

#define MCP_ASDF_MAX_ID 127
#define MCP_ASDF_ONE (UINT32_C(1) << 23)  /* 1.0 as x_hat, x_bar or x */
#define MCP_ASDF_HALF (UINT32_C(1) << 22) /* 0.5 as x_hat, x_bar or x */
#define MCP_ASDF_B_HAT_MIN (UINT32_C(1) << 12)
#define MCP_ASDF_B_HAT_MAX UINT32_C(0xFFFFF000)
#define MCP_ASDF_ALPHA_MAX UINT32_C(0x4EFFFFFF) /* 2^31 - 2^7 */
#define MCP_ASDF_MEMORY_MIN UINT32_C(64)
#define MCP_ASDF_MEMORY_MAX UINT32_C(0xFFFFFFFE)
#define MCP_ASDF_IMAGE_SIZE 136 /* bytes */

typedef enum {
    MCP_ASDF_OK = 0,
    MCP_ASDF_DUE = 1,      /* observe, step: broadcast x_hat and alpha now */
    MCP_ASDF_REPEATED = 2, /* receive: this sender was heard in this round already; counted, ignored */
    MCP_ASDF_UPDATED = 3,  /* settle: b_hat was re-estimated */
    MCP_ASDF_ERR_CONFIG = -1,
    MCP_ASDF_ERR_TABLE = -2,
    MCP_ASDF_ERR_ID = -3,
    MCP_ASDF_ERR_B_HAT = -4,
    MCP_ASDF_ERR_OBSERVATION = -5,
    MCP_ASDF_ERR_SENDER = -6,
    MCP_ASDF_ERR_X_HAT = -7,
    MCP_ASDF_ERR_ALPHA = -8,
    MCP_ASDF_ERR_SUMS = -9,
    MCP_ASDF_ERR_IMAGE = -10
} mcp_asdf_status_t;

typedef enum { MCP_ASDF_WHITE = 0, MCP_ASDF_BLACK = 1, MCP_ASDF_NONE = 2 } mcp_asdf_observation_t;

/* When b_hat is re-estimated, every filter_period ticks: if the test of eq. 12 rejects (ASDF); without
 * a test; never. */
typedef enum { MCP_ASDF_ADAPTIVE = 0, MCP_ASDF_ALWAYS = 1, MCP_ASDF_OFF = 2 } mcp_asdf_filter_t;

/* Settings, shared by any number of robots and never written: may be const, though on an AVR not in PROGMEM,
 * as they are read like any variable. Both the struct and the table must outlive the robots.
 *   table          t-table as `mcp-asdf table` generates it (docs/tables.md); not read and may be null
 *                  unless filter is MCP_ASDF_ADAPTIVE
 *   comms_period   ticks between broadcasts, 1 .. 2^32 - 1
 *   filter_period  nominal filtering period tau, ticks: a multiple of comms_period
 *   memory         even, 64 .. 2^32 - 2: when t reaches it, t and n are halved (n to nearest, ties to
 *                  even). Small values forget, for sensors that drift
 *   filter         a mcp_asdf_filter_t */
typedef struct {
    const uint32_t *table;
    uint32_t comms_period;
    uint32_t filter_period;
    uint32_t memory;
    uint8_t filter;
} mcp_asdf_config_t;

/* The usual settings: broadcast every tick, tau = 1000, longest memory, adaptive filter. */
#define MCP_ASDF_CONFIG(t_table) {(t_table), 1, 1000, MCP_ASDF_MEMORY_MAX, MCP_ASDF_ADAPTIVE}

/* Exact sums over the messages of a round that have alpha > 0 (eq. 5, 6 and 12). With alpha in units of
 * 2^-24 split into alpha = high 2^32 + low, the product alpha x_hat is summed in two parts that need no
 * carry between them. Sums of robots add and subtract member by member.
 *   alpha         sum of alpha                      < 2^62, unit 2^-24
 *   alpha_x_low   sum of low x_hat                  < 2^62, unit 2^-47
 *   alpha_x_high  sum of high x_hat                 < 2^53, unit 2^-15
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
} mcp_asdf_sums_t;

/* Diagnostics; each stops at 65535. */
typedef struct {
    uint16_t accepted; /* messages that entered a round, those with alpha = 0 included */
    uint16_t repeated; /* further messages of a sender in one round */
    uint16_t rejected; /* invalid messages */
    uint16_t tests;    /* hypothesis tests run */
    uint16_t updates;  /* re-estimates of b_hat */
} mcp_asdf_counters_t;

/* What depends on b_hat alone, formed when b_hat changes. With c = min(b_hat, 1 - b_hat) and g = 1 - 2c,
 * each member is a mantissa with a binary exponent; a shift is its exponent's size. */
typedef struct {
    uint8_t inverted;        /* 1 if b_hat < 1/2 */
    uint8_t g_shift;         /* 0 .. 11, or MCP_ASDF_UNINFORMATIVE */
    uint8_t g_squared_shift; /* 0 .. 23 */
    uint8_t edge_shift;      /* 0 .. 22 */
    uint8_t odds_left;       /* 0 .. 8 */
    uint8_t odds_right;      /* 0 .. 31; one of the two is 0 */
    uint32_t c;              /* unit 2^-32; 2^32 - 1 where b_hat says nothing, |2 b_hat - 1| < 2^-12 */
    uint32_t inverse_g;      /* 1 / g = inverse_g 2^(g_shift - 30), rounded up */
    uint32_t g_squared;      /* g^2 = g_squared 2^(-32 - g_squared_shift) */
    uint32_t edge;           /* (g / (1 - c))^2 = edge 2^(-32 - edge_shift) */
    uint32_t odds;           /* ((1 - c) / c)^2 = odds 2^(odds_left - odds_right) */
} mcp_asdf_accuracy_t;

#define MCP_ASDF_UNINFORMATIVE 255

/* A robot. Its members are the state; read them through the functions below. The order keeps what a tick
 * touches within reach of short load and store instructions. */
typedef struct {
    const mcp_asdf_config_t *config;
    uint8_t id;
    uint8_t silent;               /* messages of the open round with alpha = 0 */
    mcp_asdf_counters_t counters; /* accepted: without the open round */
    mcp_asdf_accuracy_t accuracy;
    uint32_t t;
    uint32_t n;
    uint32_t comms_left; /* ticks until a broadcast is due; 0 from then until settle */
    uint32_t x_hat;      /* of the last observation */
    uint32_t alpha;
    uint32_t settled_x_hat; /* the same as the last settle found them: x is formed from these */
    uint32_t settled_alpha;
    union {
        uint8_t of[16];  /* senders of the open round, bit (id mod 8) of byte (id div 8) */
        uint64_t all[2]; /* the same, to forget them at once */
    } heard;
    mcp_asdf_sums_t open;  /* the open round */
    uint64_t closed_alpha; /* sums of the last closed round */
    uint64_t closed_alpha_x_low;
    uint64_t closed_alpha_x_high;
    uint32_t filter_left; /* ticks until the filter runs, counted at the ends of rounds */
    uint32_t b_hat;
} mcp_asdf_t;

/* Make a robot: no observations, no messages. Writes every member. O(q) for the table.
 *   id     0 .. 127, unique among neighbours
 *   b_hat  assumed sensor accuracy, the same for both colours, MCP_ASDF_B_HAT_MIN .. MCP_ASDF_B_HAT_MAX
 * Fails if a period is 0, filter_period is no multiple of comms_period, memory is odd or out of range, or
 * filter is unknown (ERR_CONFIG); the filter is adaptive and the table is null, damaged, out of order or
 * of another format (ERR_TABLE; where the damage is to its number of entries, up to 131 words are read); id >
 * 127 (ERR_ID); b_hat is out of range (ERR_B_HAT). On failure *robot is unchanged. */
mcp_asdf_status_t mcp_asdf_init(mcp_asdf_t *robot, const mcp_asdf_config_t *config, uint8_t id,
                                uint32_t b_hat);

/* First half of a control tick: count the observation z and form x_hat (eq. 3) and alpha (eq. 4).
 * MCP_ASDF_NONE counts nothing and leaves both as they are. Returns MCP_ASDF_DUE every comms_period ticks.
 * Fails if z is no observation (ERR_OBSERVATION); that is no tick. */
mcp_asdf_status_t mcp_asdf_observe(mcp_asdf_t *robot, mcp_asdf_observation_t z);

/* Take a neighbour's message into the open round. x_hat and alpha are as in its frame: any 32 bits. An alpha
 * off the grid is rounded down to it, one above MCP_ASDF_ALPHA_MAX becomes that; a message whose alpha is
 * then 0 is accepted and enters no sum. Returns MCP_ASDF_REPEATED, and counts `repeated`, for a sender
 * heard in this round already.
 * Fails if sender > 127 or is the robot's own id (ERR_SENDER), x_hat > 1.0 (ERR_X_HAT), or alpha has its
 * sign bit set, is infinite or is no number (ERR_ALPHA), or add_round() has filled the round with 127
 * messages (ERR_SUMS): counts `rejected`. */
mcp_asdf_status_t mcp_asdf_receive(mcp_asdf_t *robot, uint8_t sender, uint32_t x_hat, uint32_t alpha);

/* Second half of a tick: if a broadcast was due, close the round and, every filter_period ticks, run the
 * filter: test the round against x_hat (eq. 12) and on rejection re-estimate b_hat from x_bar (eq. 8), which
 * shows in x_hat and alpha at the next observation. From here on x() is the informed estimate of this tick.
 * Returns MCP_ASDF_UPDATED after a re-estimate, else MCP_ASDF_OK. Cannot fail. */
mcp_asdf_status_t mcp_asdf_settle(mcp_asdf_t *robot);

/* A whole tick: observe(z), then settle(). Returns what observe returned and fails as it does; then
 * nothing is settled. */
mcp_asdf_status_t mcp_asdf_step(mcp_asdf_t *robot, mcp_asdf_observation_t z);

/* Social estimate (eq. 5) of the last closed round, unit 2^-23, rounded down; MCP_ASDF_HALF if beta is 0. */
uint32_t mcp_asdf_x_bar(const mcp_asdf_t *robot);

/* Informed estimate (eq. 7) of the last settle, unit 2^-23: the exact quotient of the sums, rounded down;
 * x_hat of that time if both confidences are 0. Formed when asked for, at the price of one division. */
uint32_t mcp_asdf_x(const mcp_asdf_t *robot);

/* Diagnostics since init. */
mcp_asdf_counters_t mcp_asdf_counters(const mcp_asdf_t *robot);

/* Add one message to sums. Needs x_hat <= 1.0 and alpha within 0 .. MCP_ASDF_ALPHA_MAX after rounding, that
 * is any alpha that receive() accepts; returns whether it entered (alpha > 0 on the grid). */
bool mcp_asdf_sums_add(mcp_asdf_sums_t *sums, uint32_t x_hat, uint32_t alpha);

/* Add the sums of many messages to the open round at once: what receiving `messages` messages from
 * different senders would do, the memory of who was heard apart. For simulators.
 * Fails if the open round would hold more than 127 messages with alpha > 0 or more than 127 without,
 * sums->count exceeds messages, or that many messages cannot give these sums: one is too large, alpha is less
 * than a unit each, their mean is above 1.0, or their variance below 0 (ERR_SUMS). */
mcp_asdf_status_t mcp_asdf_add_round(mcp_asdf_t *robot, const mcp_asdf_sums_t *sums, uint8_t messages);

/* Write the robot's state to an image: little-endian, the same on every target, with version and checksum.
 * Needs up to 240 bytes of stack, among them a copy of the robot (docs/cost.md). */
void mcp_asdf_save(const mcp_asdf_t *robot, uint8_t image[MCP_ASDF_IMAGE_SIZE]);

/* Make a robot from an image; it goes on as the saved one would have, bit for bit. Needs up to 350
 * bytes of stack, among them a copy. Fails as init does for config and table, and if the image is damaged, of
 * another version, or does not fit the config's periods and memory (ERR_IMAGE). On failure *robot is
 * unchanged. */
mcp_asdf_status_t mcp_asdf_restore(mcp_asdf_t *robot, const mcp_asdf_config_t *config,
                                   const uint8_t image[MCP_ASDF_IMAGE_SIZE]);

/* Whether the state could have come from calls of these functions (docs/invariants.md): false after a
 * stray write or a bit flip that breaks a relation between members. O(1), writes nothing. */
bool mcp_asdf_invariants_hold(const mcp_asdf_t *robot);

/* Own id, 0 .. 127. */
static inline uint8_t mcp_asdf_id(const mcp_asdf_t *robot) { return robot->id; }

/* Observations counted, and the black ones among them. */
static inline uint32_t mcp_asdf_t_count(const mcp_asdf_t *robot) { return robot->t; }
static inline uint32_t mcp_asdf_n_count(const mcp_asdf_t *robot) { return robot->n; }

/* Assumed accuracy, unit 2^-32. */
static inline uint32_t mcp_asdf_b_hat(const mcp_asdf_t *robot) { return robot->b_hat; }

/* Local estimate (eq. 3), unit 2^-23, and local confidence (eq. 4), binary32 bits: what to broadcast. */
static inline uint32_t mcp_asdf_x_hat(const mcp_asdf_t *robot) { return robot->x_hat; }
static inline uint32_t mcp_asdf_alpha(const mcp_asdf_t *robot) { return robot->alpha; }

/* Social confidence (eq. 6) of the last closed round, unit 2^-24, below 2^62. */
static inline uint64_t mcp_asdf_beta(const mcp_asdf_t *robot) { return robot->closed_alpha; }

#ifdef __cplusplus
}
#endif

#endif
