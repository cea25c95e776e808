/* The MCP-ASDF firmware. mcp_asdf.h is the manual; docs/design.md derives the formulas and bounds.
 *
 * Notation in comments: [a, b) is the range of the integer on the left; "Q32" is a value in units of 2^-32.
 * Products of two 32-bit numbers are always formed in 64 bits by multiply(), or by multiply_high() where
 * only the upper word is wanted, so no product below can wrap unless its comment says it may.
 */
#include "mcp_asdf.h"

/* Three choices of speed, never of result. A target without a fast 32-bit divider estimates quotient digits
 * with a reciprocal; one without a 32 x 32 -> 64 multiplier splits operands into halves; one with registers
 * of eight bits, where products are dear and a shift is a loop of single bits, divides bit by bit and shifts
 * by bytes first. */
#ifndef MCP_ASDF_HARDWARE_DIVIDE
#if defined(__ARM_FEATURE_IDIV) || defined(__riscv_div)
#define MCP_ASDF_HARDWARE_DIVIDE 1
#else
#define MCP_ASDF_HARDWARE_DIVIDE 0
#endif
#endif
#ifndef MCP_ASDF_SPLIT_MULTIPLY
#if defined(__ARM_ARCH_6M__) || defined(__ARM_ARCH_8M_BASE__)
#define MCP_ASDF_SPLIT_MULTIPLY 1
#else
#define MCP_ASDF_SPLIT_MULTIPLY 0
#endif
#endif
#ifndef MCP_ASDF_EIGHT_BIT
#ifdef __AVR__
#define MCP_ASDF_EIGHT_BIT 1
#else
#define MCP_ASDF_EIGHT_BIT 0
#endif
#endif

/* The few functions on the way of every tick are worth repeating, unless size counts. */
#if defined(__GNUC__) && !defined(__OPTIMIZE_SIZE__)
#define HOT static inline __attribute__((always_inline))
#else
#define HOT static
#endif

/* A loop that is worth its call wherever it stands. */
#ifdef __GNUC__
#define APART static __attribute__((noinline))
#else
#define APART static
#endif

/* Whether receive() has a way of its own for messages that are added: not where size counts, nor where
 * products are calls. */
#if MCP_ASDF_SPLIT_MULTIPLY || MCP_ASDF_EIGHT_BIT || defined(__OPTIMIZE_SIZE__)
#define QUICK_RECEIVE 0
#else
#define QUICK_RECEIVE 1
#endif

/* What it calls for any other message must not take registers from it. */
#if defined(__GNUC__) && QUICK_RECEIVE
#define COLD static __attribute__((noinline))
#else
#define COLD static
#endif

/* HOT only where registers are many, as they are not on cores that split products. */
#if MCP_ASDF_SPLIT_MULTIPLY
#define NEAR static
#else
#define NEAR HOT
#endif

#define TABLE_MAGIC UINT32_C(0x4D435054)
#define TABLE_VERSION UINT32_C(1)
#define TABLE_HEADER 4
#define TABLE_OMEGA_MAX UINT32_C(3865470566) /* 0.9 in Q32 */
#define IMAGE_MAGIC (UINT32_C(0x4D435300) | MCP_ASDF_IMAGE_VERSION)
#define HASH_START UINT32_C(0x811C9DC5)
#define HASH_FACTOR UINT32_C(0x01000193)
#define INFORMATIVE_G (UINT32_C(1) << 20) /* |2 b_hat - 1| = 2^-12 in Q32 */
#define ALPHA_INFINITE UINT32_C(0x7F800000)
#define ALPHA_FRACTION UINT32_C(0x007FFFFF)
#define ALPHA_IMPLICIT UINT32_C(0x00800000)
#define ALPHA_UNIT_EXPONENT 126      /* biased exponent of binary32 numbers whose last bit is worth 2^-24 */
#define ALPHA_SHIFT_MAX 31           /* alpha = 24 bits shifted left by at most this */
#define MOST_LOW (UINT32_C(1) << 31) /* MCP_ASDF_ALPHA_MAX is MOST_HIGH 2^32 + MOST_LOW units */
#define MOST_HIGH ALPHA_FRACTION

/* ---- Words ------------------------------------------------------------------------------------------- */

#ifdef __AVR__
/* avr-gcc calls a loop even for a shift by 32. It is little-endian, and defines what another member reads. */
typedef union {
    uint64_t both;
    uint32_t word[2];
} words_t;

static inline uint64_t join(uint32_t high, uint32_t low)
{
    const words_t words = {.word = {low, high}};
    return words.both;
}

static inline uint32_t high_word(uint64_t value)
{
    const words_t words = {.both = value};
    return words.word[1];
}
#else
static inline uint64_t join(uint32_t high, uint32_t low) { return (uint64_t)high << 32 | low; }

static inline uint32_t high_word(uint64_t value) { return (uint32_t)(value >> 32); }
#endif

static inline uint32_t low_word(uint64_t value) { return (uint32_t)value; }

/* value 2^count modulo 2^32, and value / 2^count rounded down, for a count in [0, 31]. */
#if MCP_ASDF_EIGHT_BIT
APART uint32_t shift_left_by(uint32_t value, uint8_t count)
{
    for (; count >= 8; count = (uint8_t)(count - 8)) { /* at most 3 turns */
        value <<= 8;
    }
    return value << count;
}

APART uint32_t shift_right_by(uint32_t value, uint8_t count)
{
    for (; count >= 8; count = (uint8_t)(count - 8)) { /* at most 3 turns */
        value >>= 8;
    }
    return value >> count;
}

static inline uint32_t shift_left(uint32_t value, uint32_t count)
{
    return shift_left_by(value, (uint8_t)count);
}
static inline uint32_t shift_right(uint32_t value, uint32_t count)
{
    return shift_right_by(value, (uint8_t)count);
}
#else
static inline uint32_t shift_left(uint32_t value, uint32_t count) { return value << count; }
static inline uint32_t shift_right(uint32_t value, uint32_t count) { return value >> count; }
#endif

#if MCP_ASDF_SPLIT_MULTIPLY
static uint64_t multiply(uint32_t a, uint32_t b)
{
    const uint32_t a0 = a & 0xFFFF, a1 = a >> 16, b0 = b & 0xFFFF, b1 = b >> 16;
    const uint32_t low = a0 * b0;                         /* (2^16 - 1)^2 < 2^32, as are the others */
    const uint32_t middle = a1 * b0 + (low >> 16);        /* (2^16 - 1)^2 + 2^16 - 1 < 2^32 */
    const uint32_t middle2 = a0 * b1 + (middle & 0xFFFF); /* the same */
    const uint32_t high = a1 * b1 + (middle >> 16) + (middle2 >> 16); /* upper word of a product < 2^64 */
    return join(high, middle2 << 16 | (low & 0xFFFF));
}

/* Its upper word: the same without the rest. */
static uint32_t multiply_high(uint32_t a, uint32_t b)
{
    const uint32_t a1 = a >> 16, b1 = b >> 16;
    a &= 0xFFFF; /* in place: gcc then finds registers for all */
    b &= 0xFFFF;
    const uint32_t middle = a1 * b + (a * b >> 16);
    const uint32_t middle2 = a * b1 + (middle & 0xFFFF);
    return a1 * b1 + (middle >> 16) + (middle2 >> 16);
}

/* The upper word of a^2 = a1^2 2^32 + a1 a0 2^17 + a0^2. */
static uint32_t square_high(uint32_t a)
{
    const uint32_t a0 = a & 0xFFFF, a1 = a >> 16;
    return a1 * a1 + ((a1 * a0 + (a0 * a0 >> 17)) >> 15);
}

/* a b for a < 2^8 and b < 2^56. */
static uint64_t multiply_small(uint32_t a, uint64_t b)
{
    const uint32_t low = a * (low_word(b) & 0xFFFF);                               /* < 2^24 */
    const uint32_t middle = a * (low_word(b) >> 16) + (low >> 16);                 /* < 2^24 */
    return join(a * high_word(b) + (middle >> 16), middle << 16 | (low & 0xFFFF)); /* upper word: of < 2^64 */
}
#else
HOT uint64_t multiply(uint32_t a, uint32_t b) { return (uint64_t)a * b; }
HOT uint64_t multiply_small(uint32_t a, uint64_t b) { return a * b; }
HOT uint32_t multiply_high(uint32_t a, uint32_t b) { return high_word(multiply(a, b)); }
HOT uint32_t square_high(uint32_t a) { return multiply_high(a, a); }
#endif

/* Leading zeros of value > 0: [0, 31]; leading_zero() is for values from 2^30 on: 0 or 1. */
#if defined(__GNUC__) && (defined(__ARM_FEATURE_CLZ) || defined(__x86_64__) || defined(__i386__))
static inline uint32_t leading_zeros(uint32_t value) { return (uint32_t)__builtin_clz(value); }
static inline uint32_t leading_zero(uint32_t value) { return leading_zeros(value); }
#elif MCP_ASDF_EIGHT_BIT
static inline uint32_t leading_zero(uint32_t value) { return ~value >> 31; }

static uint32_t leading_zeros(uint32_t value)
{
    uint8_t zeros = 0;
    for (; value >> 24 == 0; value <<= 8) { /* at most 3 turns, as value > 0 */
        zeros = (uint8_t)(zeros + 8);
    }
    for (uint8_t top = (uint8_t)(value >> 24); top < 0x80; top = (uint8_t)(top << 1)) { /* at most 7 turns */
        ++zeros;
    }
    return zeros;
}
#else
static inline uint32_t leading_zero(uint32_t value) { return ~value >> 31; }

NEAR uint32_t leading_zeros(uint32_t value)
{
    uint32_t zeros = 0;
    if (value >> 16 == 0) {
        value <<= 16;
        zeros = 16;
    }
    if (value >> 24 == 0) {
        value <<= 8;
        zeros += 8;
    }
    if (value >> 28 == 0) {
        value <<= 4;
        zeros += 4;
    }
    if (value >> 30 == 0) {
        value <<= 2;
        zeros += 2;
    }
    return zeros + leading_zero(value);
}
#endif

/* Upper word of (high:low) 2^shift, shift in [0, 31]; needs high < 2^(32 - shift). */
static inline uint32_t upper(uint32_t high, uint32_t low, uint32_t shift)
{
    return shift_left(high, shift) | shift_right(low >> 1, 31 - shift);
}

static inline uint16_t add_saturating(uint16_t counter, uint32_t more)
{
    const uint32_t sum = counter + more;
    return (uint16_t)(sum | (0 - (sum >> 16 & 1))); /* sum < 2^17: all ones where bit 16 is set */
}

/* ---- Division ---------------------------------------------------------------------------------------- */

#if MCP_ASDF_EIGHT_BIT
/* floor(a 2^bits / d) modulo 2^32 for a < 2 d and d <= 2^31, which keeps a below 2^32. */
static uint32_t divide_bits(uint32_t a, uint32_t d, uint8_t bits)
{
    uint32_t quotient = 0;
    uint8_t turns = (uint8_t)(bits + 1); /* at most 33 */
    do {
        quotient <<= 1;
        if (a >= d) {
            a -= d;
            quotient |= 1;
        }
        a <<= 1; /* < 2 d */
    } while (--turns != 0);
    return quotient;
}

/* floor(a 2^32 / d) for a < d. */
static uint32_t divide(uint32_t a, uint32_t d) { return divide_bits(a, d, 32); }

/* floor(a 2^24 / d) for a < 2 d. */
static uint32_t divide_24(uint32_t a, uint32_t d) { return divide_bits(a, d, 24); }
#else
/* Long division in digits of 10 to 12 bits. A digit is estimated from the upper bits of remainder and
 * divisor, never too large and less than 2 too small, so a remainder stays in [0, 2 divisor) and arithmetic
 * modulo 2^32 gives it exactly; the last remainder corrects the quotient. Divisors are in [2^30, 2^31].
 */

#if MCP_ASDF_HARDWARE_DIVIDE
static inline uint32_t prepare(uint32_t divisor) { return (divisor >> 15) + 1; } /* > divisor / 2^15 */

/* remainder 2^bits / divisor, as (remainder / 2^(15 - bits)) / (divisor / 2^15). */
static inline uint32_t digit(uint32_t remainder, uint32_t prepared, uint32_t bits)
{
    return (remainder >> (15 - bits)) / prepared;
}
#else
/* 256 (1 / y - 1), rounded, and 1, at the middles y of 64 steps from 1/2 to 1, and at 1. */
static const uint8_t reciprocals[65] MCP_ASDF_ROM = {
    253, 245, 238, 230, 223, 216, 210, 203, 197, 191, 185, 179, 173, 168, 162, 157, 152,
    147, 142, 137, 133, 128, 124, 119, 115, 111, 107, 103, 99,  95,  92,  88,  85,  81,
    78,  74,  71,  68,  65,  62,  59,  56,  53,  50,  47,  44,  42,  39,  36,  34,  31,
    29,  26,  24,  22,  19,  17,  15,  12,  10,  8,   6,   4,   2,   1};

/* 2^46 / divisor, at most 0.71 2^-13 of it too small, never too large: [2^15 - 4, 2^16]. One Newton step
 * r (2 - y r) from below, as y = divisor / 2^31 is rounded up. */
static inline uint32_t prepare(uint32_t divisor)
{
    const uint32_t r =
        255 + (uint32_t)MCP_ASDF_READ_BYTE(&reciprocals[(divisor >> 24) - 64]); /* Q8, [256, 508] */
    const uint32_t y_r = ((divisor >> 8) + 1) * r;                              /* Q31, 1 +- 2^-6 */
    return (r * ((0 - y_r) >> 9)) >> 15; /* Q8 Q22 = Q30 <= 2.0; then Q15 */
}

/* remainder 2^bits / divisor, as (remainder / 2^15) (2^46 / divisor) / 2^(31 - bits); the product is < 2^32
 * for remainder < 2 divisor. */
static inline uint32_t digit(uint32_t remainder, uint32_t prepared, uint32_t bits)
{
    return ((remainder >> 15) * prepared) >> (31 - bits);
}
#endif

/* floor(a 2^32 / d) for a < d. */
HOT uint32_t divide(uint32_t a, uint32_t d)
{
    const uint32_t prepared = prepare(d);
    const uint32_t first = digit(a, prepared, 11);
    const uint32_t rest = (a << 11) - first * d; /* modulo 2^32; [0, 2d), as the next two */
    const uint32_t second = digit(rest, prepared, 11);
    const uint32_t rest2 = (rest << 11) - second * d;
    const uint32_t third = digit(rest2, prepared, 10);
    const uint32_t rest3 = (rest2 << 10) - third * d;
    return (first << 21) + (second << 10) + third + (rest3 >= d);
}

/* floor(a 2^24 / d) for a < 2 d: the same with two digits. */
HOT uint32_t divide_24(uint32_t a, uint32_t d)
{
    const uint32_t prepared = prepare(d);
    const uint32_t first = digit(a, prepared, 12);
    const uint32_t rest = (a << 12) - first * d;
    const uint32_t second = digit(rest, prepared, 12);
    const uint32_t rest2 = (rest << 12) - second * d;
    return (first << 12) + second + (rest2 >= d);
}
#endif

/* A quotient of at most 1 in 31-bit numbers, for divide() or divide_24(). */
typedef struct {
    uint32_t a;
    uint32_t d;
} ratio_t;

/* (whole + fraction / 2^32) / divisor, and up to 2^-29 less: the upper 31 bits of both numbers, the divisor's
 * rounded up, cost 2^-30 each. Needs a quotient of at most 1, which becomes less, and 0 < divisor < 2^62. */
static inline ratio_t ratio(uint64_t whole, uint32_t fraction, uint64_t divisor)
{
    uint32_t d1 = high_word(divisor), d0 = low_word(divisor), a1 = high_word(whole), a0 = low_word(whole);
    if (d1 == 0) {
        d1 = d0;
        d0 = 0;
        a1 = a0;
        a0 = fraction;
    }
    const uint32_t shift = leading_zeros(d1);
    const ratio_t found = {upper(a1, a0, shift) >> 1, (upper(d1, d0, shift) >> 1) + 1};
    return found;
}

/* 2^32 whole / divisor, rounded down and then by at most 2^3 too small. */
static inline uint32_t quotient(uint64_t whole, uint64_t divisor)
{
    const ratio_t found = ratio(whole, 0, divisor);
    return divide(found.a, found.d);
}

/* ---- Confidence on the grid -------------------------------------------------------------------------- */

/* Bits of the largest alpha on the grid not above mantissa 2^exponent units; mantissa in [2^22, 2^25),
 * exponent >= -22. */
HOT uint32_t alpha_bits(uint32_t mantissa, int32_t exponent)
{
    if (mantissa < ALPHA_IMPLICIT) {
        mantissa <<= 1;
        --exponent;
    } else if (mantissa >> 24 != 0) {
        mantissa >>= 1;
        ++exponent;
    }
    if (exponent < 0) {
        const uint32_t lost = (uint32_t)-exponent; /* bits worth less than a unit, at most 23 */
        mantissa = shift_left(shift_right(mantissa, lost), lost);
    } else if (exponent > ALPHA_SHIFT_MAX) {
        return MCP_ASDF_ALPHA_MAX;
    }
    /* exponent - 1 in [-24, 30] gives [102, 156]; the implicit bit of the mantissa adds one: < 2^31 */
    return shift_left((uint32_t)(exponent + ALPHA_UNIT_EXPONENT - 1), 23) + mantissa;
}

/* A received alpha is any binary32 number >= 0. From 1/2 to MCP_ASDF_ALPHA_MAX all its bits are on the grid,
 * and it is high 2^32 + low units, high < 2^23. Below 1/2 the shift wraps to a large number. */
static inline uint32_t alpha_shift(uint32_t alpha) { return shift_right(alpha, 23) - ALPHA_UNIT_EXPONENT; }

static inline uint32_t alpha_mantissa(uint32_t alpha) { return (alpha & ALPHA_FRACTION) | ALPHA_IMPLICIT; }

static inline bool on_grid(uint32_t alpha) { return alpha_shift(alpha) <= ALPHA_SHIFT_MAX; }

/* Modulo 2^32: high_units() are the bits that this shift loses. */
static inline uint32_t low_units(uint32_t alpha)
{
    return shift_left(alpha_mantissa(alpha), alpha_shift(alpha));
}

static inline uint32_t high_units(uint32_t alpha)
{
    return QUICK_RECEIVE ? multiply_high(alpha_mantissa(alpha), UINT32_C(1) << alpha_shift(alpha))
                         : shift_right(alpha_mantissa(alpha) >> 1, ALPHA_SHIFT_MAX - alpha_shift(alpha));
}

/* Units of an alpha below 1/2, rounded down; subnormal numbers lose everything, too. */
static inline uint32_t units_below_half(uint32_t alpha)
{
    const uint32_t lost = 0 - alpha_shift(alpha); /* the wrapped shift's size: [1, 126] */
    return lost > 23 ? 0 : shift_right(alpha_mantissa(alpha), lost);
}

/* The first half of adding a message, and the second. */
HOT void add_alpha(mcp_asdf_sums_t *sums, uint32_t x_hat, uint32_t low, uint32_t high)
{
    sums->alpha += join(high, low);            /* + 2^55 */
    sums->alpha_x_low += multiply(low, x_hat); /* + 2^55 */
}

HOT void add_rest(mcp_asdf_sums_t *sums, uint32_t x_hat, uint32_t high)
{
    sums->alpha_x_high += multiply(high, x_hat); /* + 2^46 */
    sums->x_squared += multiply(x_hat, x_hat);   /* + 2^46 */
    sums->x += x_hat;                            /* + 2^23 */
    ++sums->count;
}

HOT void add_units(mcp_asdf_sums_t *sums, uint32_t x_hat, uint32_t low, uint32_t high)
{
    add_alpha(sums, x_hat, low, high);
    add_rest(sums, x_hat, high);
}

HOT bool add_off_grid(mcp_asdf_sums_t *sums, uint32_t x_hat, uint32_t alpha)
{
    const uint32_t exponent = alpha >> 23;
    if (exponent > ALPHA_UNIT_EXPONENT) { /* above the largest: cut to it */
        add_units(sums, x_hat, MOST_LOW, MOST_HIGH);
        return true;
    }
    const uint32_t low = units_below_half(alpha);
    if (low == 0) {
        return false;
    }
    add_units(sums, x_hat, low, 0);
    return true;
}

HOT bool add(mcp_asdf_sums_t *sums, uint32_t x_hat, uint32_t alpha)
{
    if (!on_grid(alpha)) {
        return add_off_grid(sums, x_hat, alpha);
    }
    add_units(sums, x_hat, low_units(alpha), high_units(alpha));
    return true;
}

bool mcp_asdf_sums_add(mcp_asdf_sums_t *sums, uint32_t x_hat, uint32_t alpha)
{
    return add(sums, x_hat, alpha);
}

/* ---- Accuracy ---------------------------------------------------------------------------------------- */

/* (a / k)^2 = mantissa 2^(-30 - shift) for a and k in [2^31, 2^32): returns the mantissa, [2^31, 2^32), and
 * sets the shift, [0, 3]. The quotient has 24 or 25 bits. */
HOT uint32_t square_of_ratio(uint32_t a, uint32_t k, uint32_t *shift)
{
    const uint32_t quotient = divide_24(a >> 1, k >> 1) << 7; /* 2^31 a / k, in (2^30, 2^32) */
    const uint32_t half = leading_zero(quotient);
    const uint32_t square = square_high(quotient << half); /* [2^30, 2^32) */
    *shift = 2 * half + leading_zero(square);
    return square << leading_zero(square);
}

static void set_uninformative(mcp_asdf_accuracy_t *accuracy)
{
    accuracy->g_shift = MCP_ASDF_UNINFORMATIVE;
    accuracy->g_squared_shift = 0;
    accuracy->edge_shift = 0;
    accuracy->odds_left = 0;
    accuracy->odds_right = 0;
    accuracy->c = UINT32_MAX;
    accuracy->inverse_g = 0;
    accuracy->g_squared = 0;
    accuracy->edge = 0;
    accuracy->odds = 0;
}

static void set_accuracy(mcp_asdf_accuracy_t *accuracy, uint32_t b_hat)
{
    const uint32_t c = b_hat >> 31 == 0 ? b_hat : 0 - b_hat; /* [2^12, 2^31] */
    const uint32_t g = 0 - 2 * c;                            /* 2^32 - 2c: [0, 2^32 - 2^13] */
    accuracy->inverted = b_hat >> 31 == 0;
    if (g < INFORMATIVE_G) {
        set_uninformative(accuracy);
        return;
    }
    accuracy->c = c;
    const uint32_t g_shift = leading_zeros(g); /* [0, 11] */
    const uint32_t mantissa = shift_left(g, g_shift);
    accuracy->g_shift = (uint8_t)g_shift;
    accuracy->inverse_g = divide(UINT32_C(1) << 29, mantissa >> 1) + 1; /* > 2^62 / mantissa; g is even */

    const uint32_t square = square_high(mantissa); /* [2^30, 2^32) */
    const uint32_t square_shift = leading_zero(square);
    accuracy->g_squared = square << square_shift;
    accuracy->g_squared_shift = (uint8_t)(2 * g_shift + square_shift);

    uint32_t shift;
    accuracy->edge = square_of_ratio(mantissa, 0 - c, &shift);
    accuracy->edge_shift =
        (uint8_t)(2 * g_shift + shift - 2); /* g < 1 - c, so shift >= 2 where g_shift is 0 */

    const uint32_t c_shift = leading_zeros(c); /* [1, 19], as c < 2^31 */
    accuracy->odds = square_of_ratio(0 - c, shift_left(c, c_shift), &shift);
    const int32_t exponent = (int32_t)(2 * c_shift) - 30 - (int32_t)shift; /* [-31, 8] */
    const int32_t left = exponent > 0 ? exponent : 0;
    accuracy->odds_left = (uint8_t)left;
    accuracy->odds_right = (uint8_t)(left - exponent);
}

static void set_b_hat(mcp_asdf_t *robot, uint32_t b_hat)
{
    robot->b_hat = b_hat;
    set_accuracy(&robot->accuracy, b_hat);
}

/* ---- Observe ----------------------------------------------------------------------------------------- */

/* Confidence at the ends of the scale (eq. 4, first two cases), as
 * (g / (1 - c))^2 (rest + ((1 - c) / c)^2 part): returns its mantissa and adds to its exponent.
 * part < 2^31 (c + 2^-32) and c <= 2^-16 where odds_left > 0, at most 8, so part 2^odds_left < 2^31. */
HOT uint32_t confidence_at_end(const mcp_asdf_accuracy_t *accuracy, uint32_t part, uint32_t rest,
                               int32_t *exponent)
{
    const uint64_t sum =
        (multiply(shift_left(part, accuracy->odds_left), accuracy->odds) >> accuracy->odds_right) + rest;
    const uint32_t high = high_word(sum), low = low_word(sum); /* < 2^52; rest >= 2^29 */
    const uint32_t shift = leading_zeros(high != 0 ? high : low);
    const uint32_t mantissa = high != 0 ? upper(high, low, shift) : shift_left(low, shift);
    *exponent += (high != 0 ? 32 : 0) - (int32_t)shift - accuracy->edge_shift;
    return multiply_high(mantissa, accuracy->edge) >> 8; /* [2^22, 2^24) */
}

/* Confidence inside (eq. 4, last case), g^2 total / (nu (1 - nu)), nu in (0, 1/2] as Q32. */
HOT uint32_t confidence_inside(const mcp_asdf_accuracy_t *accuracy, uint32_t nu, uint32_t total,
                               int32_t *exponent)
{
    const uint32_t spread = multiply_high(nu, 0 - nu);                /* Q32, [2^11, 2^30] */
    const uint32_t shift = leading_zeros(spread) - 1;                 /* [0, 19] */
    const uint32_t scale = multiply_high(total, accuracy->g_squared); /* [2^29, 2^31) */
    *exponent += (int32_t)shift - accuracy->g_squared_shift;
    return divide_24(scale, shift_left(spread, shift)); /* scale < 2^31 <= 2 spread 2^shift */
}

/* Whether nu = floor(part 2^32 / total) <= c, which is part 2^32 < (c + 1) total. The compiler forms the
 * quotient once for this and for what follows; where products are cheap they spare it at an end. */
HOT bool at_end(uint32_t part, uint32_t total, uint32_t c)
{
    if (MCP_ASDF_SPLIT_MULTIPLY || MCP_ASDF_EIGHT_BIT) {
        return divide(part, total) <= c;
    }
    return part <= high_word(multiply(total, c) + (total - 1)); /* < 2^63 */
}

/* x_hat and alpha from t > 0, n and b_hat. White and black are mirror images, and so are b_hat and 1 - b_hat:
 * only the rarer colour is looked at, under the accuracy above 1/2. */
HOT void estimate(mcp_asdf_t *robot, uint32_t t, uint32_t n)
{
    const mcp_asdf_accuracy_t *const accuracy = &robot->accuracy;
    const uint32_t blacks = n, whites = t - n;
    const uint32_t shift = leading_zeros(t);
    const uint32_t total = shift_left(t, shift) >> 1; /* [2^30, 2^31); exact while t < 2^31 */
    const uint32_t part = shift_left(blacks < whites ? blacks : whites, shift) >> 1; /* <= total / 2 */
    int32_t exponent = 33 - (int32_t)shift;
    uint32_t x_hat, mantissa;
    if (at_end(part, total, accuracy->c)) { /* eq. 3, first two cases; always so without information */
        if (accuracy->g_shift == MCP_ASDF_UNINFORMATIVE) {
            robot->x_hat = MCP_ASDF_HALF;
            robot->alpha = 0;
            return;
        }
        x_hat = 0;
        mantissa = confidence_at_end(accuracy, part, total - part, &exponent);
    } else {
        const uint32_t nu = divide(part, total); /* Q32, [c, 2^31] */
        /* (nu - c) 2^g_shift <= g 2^g_shift / 2 with inverse_g rounded up give x_hat <= 2^22, equal at nu =
         * 1/2 */
        x_hat = multiply_high(shift_left(nu - accuracy->c, accuracy->g_shift), accuracy->inverse_g) >> 7;
        mantissa = confidence_inside(accuracy, nu, total, &exponent);
    }
    const bool mirrored = (blacks < whites) == accuracy->inverted;
    robot->x_hat = mirrored ? MCP_ASDF_ONE - x_hat : x_hat;
    robot->alpha = alpha_bits(mantissa, exponent);
}

HOT mcp_asdf_status_t observe(mcp_asdf_t *robot, mcp_asdf_observation_t z)
{
    const uint32_t black = (uint32_t)z;
    if (black > MCP_ASDF_NONE) {
        return MCP_ASDF_ERR_OBSERVATION;
    }
    if (black != MCP_ASDF_NONE) {
        uint32_t t = robot->t + 1, n = robot->n + black; /* < memory before, so no wrap */
        if (t == robot->config->memory) {
            t >>= 1;
            n = (n + (n >> 1 & 1)) >> 1; /* ties to even; <= t */
        }
        robot->t = t;
        robot->n = n;
        estimate(robot, t, n);
    }
    if (robot->comms_left != 0) { /* 0 if a round was not settled: it is still due */
        --robot->comms_left;
    }
    return robot->comms_left == 0 ? MCP_ASDF_DUE : MCP_ASDF_OK;
}

mcp_asdf_status_t mcp_asdf_observe(mcp_asdf_t *robot, mcp_asdf_observation_t z) { return observe(robot, z); }

/* ---- Receive ----------------------------------------------------------------------------------------- */

static mcp_asdf_status_t check_message(const mcp_asdf_t *robot, uint8_t sender, uint32_t x_hat,
                                       uint32_t alpha)
{
    if (sender > MCP_ASDF_MAX_ID || sender == robot->id) {
        return MCP_ASDF_ERR_SENDER;
    }
    if (x_hat > MCP_ASDF_ONE) {
        return MCP_ASDF_ERR_X_HAT;
    }
    return alpha >= ALPHA_INFINITE ? MCP_ASDF_ERR_ALPHA : MCP_ASDF_OK; /* sign bit, infinity, not a number */
}

/* Receive any message; with QUICK_RECEIVE, any that is not to be added: if it is sound, the round is full. */
COLD mcp_asdf_status_t receive_checked(mcp_asdf_t *robot, uint8_t sender, uint32_t x_hat, uint32_t alpha)
{
    mcp_asdf_status_t status = check_message(robot, sender, x_hat, alpha);
    uint8_t *const heard = &robot->heard.of[(sender & MCP_ASDF_MAX_ID) >> 3];
    const uint32_t bit = UINT32_C(1) << (sender & 7);
    if (status == MCP_ASDF_OK) {
        if ((*heard & bit) != 0) {
            robot->counters.repeated = add_saturating(robot->counters.repeated, 1);
            return MCP_ASDF_REPEATED;
        }
        if (QUICK_RECEIVE || robot->open.count >= MCP_ASDF_MAX_ID) { /* add_round() has filled the round */
            status = MCP_ASDF_ERR_SUMS;
        }
    }
    if (status != MCP_ASDF_OK) {
        robot->counters.rejected = add_saturating(robot->counters.rejected, 1);
        return status;
    }
    *heard = (uint8_t)(*heard | bit);
    if (!add(&robot->open, x_hat, alpha)) {
        ++robot->silent; /* <= 254: as many as senders, and 127 in add_round() */
    }
    return MCP_ASDF_OK;
}

/* A sender's byte of those heard, and what it becomes when it is marked. */
typedef struct {
    uint8_t *heard;
    uint32_t marked;
} mark_t;

/* Add a message and mark its sender. The mark is set between the sums: to the compiler a byte may be any part
 * of them, so it does not begin all at once and run out of registers. */
HOT void take(mcp_asdf_sums_t *sums, mark_t mark, uint32_t x_hat, uint32_t low, uint32_t high)
{
    add_alpha(sums, x_hat, low, high);
    *mark.heard = (uint8_t)mark.marked;
    add_rest(sums, x_hat, high);
}

/* Whether a message may come from this sender: not the robot's own id, which is in range, and none above. */
HOT bool is_neighbour(const mcp_asdf_t *robot, uint8_t sender)
{
    return (uint32_t)(sender ^ robot->id) - 1 < MCP_ASDF_MAX_ID; /* wraps for the own id */
}

/* Receive a message if it is to be added; else do nothing and return false. All checks are one here, and what
 * is wrong is left to receive_checked(). Each kind of alpha has a way of its own. */
HOT bool receive_quickly(mcp_asdf_t *robot, uint8_t sender, uint32_t x_hat, uint32_t alpha)
{
    mcp_asdf_sums_t *const open = &robot->open;
    if (!is_neighbour(robot, sender) || x_hat > MCP_ASDF_ONE) {
        return false;
    }
    uint8_t *const heard = &robot->heard.of[sender >> 3];
    const uint32_t before = *heard;
    const mark_t mark = {heard, before | UINT32_C(1) << (sender & 7)};
    if (mark.marked == before || open->count >= MCP_ASDF_MAX_ID) {
        return false;
    }
    if (on_grid(alpha)) {
        take(open, mark, x_hat, low_units(alpha), high_units(alpha));
        return true;
    }
    if (alpha_shift(alpha) < alpha_shift(ALPHA_INFINITE)) { /* above the largest: cut to it */
        take(open, mark, x_hat, MOST_LOW, MOST_HIGH);
        return true;
    }
    if (alpha >> 23 > ALPHA_UNIT_EXPONENT) {
        return false;
    }
    const uint32_t low = units_below_half(alpha);
    if (low != 0) {
        take(open, mark, x_hat, low, 0);
    } else {
        *heard = (uint8_t)mark.marked;
        ++robot->silent; /* <= 254, as in receive_checked() */
    }
    return true;
}

mcp_asdf_status_t mcp_asdf_receive(mcp_asdf_t *robot, uint8_t sender, uint32_t x_hat, uint32_t alpha)
{
    if (QUICK_RECEIVE && receive_quickly(robot, sender, x_hat, alpha)) {
        return MCP_ASDF_OK;
    }
    return receive_checked(robot, sender, x_hat, alpha);
}

/* Whether sums of alpha and of alpha x_hat are in range and give a mean of at most 1.0, as ratio() needs.
 */
static bool mean_possible(uint64_t alpha, uint64_t alpha_x_low, uint64_t alpha_x_high)
{
    const uint64_t middle = alpha_x_high + high_word(alpha_x_low); /* may wrap, but not within the limits */
    const uint64_t most = alpha >> 9;                              /* of middle, where the mean is 1.0 */
    return alpha <= multiply(MCP_ASDF_MAX_ID, UINT32_C(0xFFFFFF)) << ALPHA_SHIFT_MAX &&
           alpha_x_low < UINT64_C(1) << 62 && alpha_x_high < UINT64_C(1) << 53 &&
           (middle < most || (middle == most && low_word(alpha_x_low) <= low_word(alpha) << 23));
}

/* Whether `count` messages can have given these sums: each alpha at least one unit, none too large, no mean
 * above 1.0, no variance below 0. */
static bool sums_possible(const mcp_asdf_sums_t *sums)
{
    const uint32_t m = sums->count;
    return m <= MCP_ASDF_MAX_ID && sums->x <= m * MCP_ASDF_ONE && /* < 2^30 */
           sums->x_squared <= multiply(sums->x, MCP_ASDF_ONE) &&
           m * sums->x_squared >= multiply(sums->x, sums->x) && /* < 2^60 */
           sums->alpha >= m &&
           sums->alpha <= multiply(m, UINT32_C(0xFFFFFF)) << ALPHA_SHIFT_MAX && /* < 2^62 */
           sums->alpha_x_low <= multiply(sums->x, UINT32_MAX) &&
           sums->alpha_x_high <= multiply(sums->x, UINT32_C(0x7FFFFF)) &&
           mean_possible(sums->alpha, sums->alpha_x_low, sums->alpha_x_high);
}

mcp_asdf_status_t mcp_asdf_add_round(mcp_asdf_t *robot, const mcp_asdf_sums_t *sums, uint8_t messages)
{
    mcp_asdf_sums_t *const open = &robot->open;
    const uint32_t count = sums->count; /* read once: sums may be *open */
    if (!sums_possible(sums) || count > messages || open->count + count > MCP_ASDF_MAX_ID ||
        robot->silent + (messages - count) > MCP_ASDF_MAX_ID) {
        return MCP_ASDF_ERR_SUMS;
    }
    /* At most 127 messages in all, so each sum stays below what mcp_asdf_sums_t says. */
    open->alpha += sums->alpha;
    open->alpha_x_low += sums->alpha_x_low;
    open->alpha_x_high += sums->alpha_x_high;
    open->x_squared += sums->x_squared;
    open->x += sums->x;
    open->count += count;
    robot->silent = (uint8_t)(robot->silent + (messages - count));
    return MCP_ASDF_OK;
}

/* ---- Settle ------------------------------------------------------------------------------------------ */

/* floor(sum of alpha x_hat / sum of alpha) in units of x_hat; alpha > 0. The quotient's upper 23 bits
 * are right or one too small; the remainder, below 2 alpha, tells which. */
static inline uint32_t mean(uint64_t alpha, uint64_t alpha_x_low, uint64_t alpha_x_high)
{
    const uint64_t middle = alpha_x_high + high_word(alpha_x_low); /* < 2^53 + 2^30: the sum from bit 32 up */
    const uint64_t sum = join(low_word(middle), low_word(alpha_x_low)); /* modulo 2^64 */
    const ratio_t found = ratio(middle << 9 | low_word(alpha_x_low) >> 23, low_word(sum) << 9, alpha);
    const uint32_t estimate = divide_24(found.a, found.d) >> 1;
    const uint64_t product = multiply(estimate, low_word(alpha)) + join(estimate * high_word(alpha), 0);
    return estimate + (sum - product >= alpha);
}

HOT uint32_t social_estimate(const mcp_asdf_t *robot)
{
    if (robot->closed_alpha == 0) {
        return MCP_ASDF_HALF;
    }
    return mean(robot->closed_alpha, robot->closed_alpha_x_low, robot->closed_alpha_x_high);
}

uint32_t mcp_asdf_x_bar(const mcp_asdf_t *robot) { return social_estimate(robot); }

uint32_t mcp_asdf_x(const mcp_asdf_t *robot)
{
    const uint32_t x_hat = robot->settled_x_hat, own = robot->settled_alpha; /* own alpha is 0 or in range */
    const uint32_t low = on_grid(own) ? low_units(own) : units_below_half(own);
    const uint32_t high = on_grid(own) ? high_units(own) : 0;
    /* Of at most 128 robots: < 2^62, and the products as mcp_asdf_sums_t says. */
    const uint64_t alpha = robot->closed_alpha + join(high, low);
    if (alpha == 0) {
        return x_hat;
    }
    return mean(alpha, robot->closed_alpha_x_low + multiply(low, x_hat),
                robot->closed_alpha_x_high + multiply(high, x_hat));
}

/* Eq. 12 on the m >= 2 messages of the open round: (sum x - m x_hat)^2 > k (m sum x^2 - (sum x)^2). */
static bool test_rejects(const mcp_asdf_t *robot)
{
    const uint32_t *const table = robot->config->table;
    const mcp_asdf_sums_t *const open = &robot->open;
    const uint32_t m = open->count;
    const uint32_t shape = MCP_ASDF_READ_WORD(&table[1]);
    const uint32_t q = shape >> 16 & 0xFF, fraction_bits = shape >> 8 & 0xFF;
    const uint32_t k = MCP_ASDF_READ_WORD(&table[TABLE_HEADER + (m <= q ? m - 2 : q - 1)]);

    const uint32_t own = m * robot->x_hat; /* < 2^30 */
    const uint32_t difference = open->x > own ? open->x - own : own - open->x;
    /* m sum x^2 < 2^60, and at least (sum x)^2 (Cauchy); the difference is at most m^2 / 4 2^46 < 2^58 */
    const uint64_t spread = multiply_small(m, open->x_squared) - multiply(open->x, open->x);
    /* k spread / 2^fraction_bits, rounded down, < 2^6 2^58, from k spread = (high:low_word(low)) */
    const uint64_t low = multiply(k, low_word(spread));
    const uint64_t high = multiply(k, high_word(spread)) + high_word(low); /* < 2^59 */
    const uint64_t threshold =
        join(shift_left(high_word(high), 32 - fraction_bits) | shift_right(low_word(high), fraction_bits),
             shift_left(low_word(high), 32 - fraction_bits) | shift_right(low_word(low), fraction_bits));
    return multiply(difference, difference) > threshold; /* integer > real, so rounding down decides alike */
}

/* value as a sum of estimates of 1.0, value 2^23 < 2^55. */
static inline uint64_t times_one(uint32_t value) { return join(value >> 9, value << 23); }

/* b_hat from x_bar (eq. 8); false where x_bar says nothing: no confidence in the round, or x_bar = 1/2. */
static bool reestimate(mcp_asdf_t *robot)
{
    const uint32_t x_bar = social_estimate(robot); /* MCP_ASDF_HALF without confidence */
    if (x_bar == MCP_ASDF_HALF) {
        return false;
    }
    const bool inverted = x_bar < MCP_ASDF_HALF; /* eq. 8 at (n, x_bar) is eq. 8 at (t - n, 1 - x_bar) */
    const uint32_t rest = inverted ? x_bar : MCP_ASDF_ONE - x_bar; /* < 2^22 */
    const uint32_t blacks = inverted ? robot->t - robot->n : robot->n;
    const uint64_t whole = times_one(blacks), offset = multiply(robot->t, rest); /* < 2^55 */
    const uint64_t denominator = times_one(robot->t) - 2 * offset;               /* [2, 2^55) */
    uint32_t b_hat = 0;
    if (whole > offset) {
        const uint64_t numerator = whole - offset;
        b_hat = numerator < denominator ? quotient(numerator, denominator) : UINT32_MAX;
    }
    b_hat = b_hat < MCP_ASDF_B_HAT_MIN ? MCP_ASDF_B_HAT_MIN : b_hat;
    set_b_hat(robot, b_hat > MCP_ASDF_B_HAT_MAX ? MCP_ASDF_B_HAT_MAX : b_hat);
    return true;
}

static bool filter(mcp_asdf_t *robot)
{
    const uint8_t mode = robot->config->filter;
    if (mode == MCP_ASDF_OFF || robot->t == 0) {
        return false;
    }
    if (mode == MCP_ASDF_ADAPTIVE) {
        if (robot->open.count < 2) {
            return false;
        }
        robot->counters.tests = add_saturating(robot->counters.tests, 1);
        if (!test_rejects(robot)) {
            return false;
        }
    }
    if (!reestimate(robot)) {
        return false;
    }
    robot->counters.updates = add_saturating(robot->counters.updates, 1);
    return true;
}

HOT bool close_round(mcp_asdf_t *robot)
{
    bool updated = false;
    mcp_asdf_sums_t *const open = &robot->open;
    robot->closed_alpha = open->alpha;
    robot->closed_alpha_x_low = open->alpha_x_low;
    robot->closed_alpha_x_high = open->alpha_x_high;
    robot->counters.accepted = add_saturating(robot->counters.accepted, open->count + robot->silent);
    robot->filter_left -= robot->config->comms_period; /* both are multiples of it */
    if (robot->filter_left == 0) {
        robot->filter_left = robot->config->filter_period;
        updated = filter(robot);
    }
    robot->heard.all[0] = 0;
    robot->heard.all[1] = 0;
    open->alpha = 0; /* member by member: cheaper than the library call a compiler makes of a whole struct */
    open->alpha_x_low = 0;
    open->alpha_x_high = 0;
    open->x_squared = 0;
    open->x = 0;
    open->count = 0;
    robot->silent = 0;
    robot->comms_left = robot->config->comms_period;
    return updated;
}

HOT mcp_asdf_status_t settle(mcp_asdf_t *robot)
{
    robot->settled_x_hat = robot->x_hat;
    robot->settled_alpha = robot->alpha;
    return robot->comms_left == 0 && close_round(robot) ? MCP_ASDF_UPDATED : MCP_ASDF_OK;
}

mcp_asdf_status_t mcp_asdf_settle(mcp_asdf_t *robot) { return settle(robot); }

mcp_asdf_status_t mcp_asdf_step(mcp_asdf_t *robot, mcp_asdf_observation_t z)
{
    const mcp_asdf_status_t status = observe(robot, z);
    if (status >= MCP_ASDF_OK) {
        (void)settle(robot);
    }
    return status;
}

mcp_asdf_counters_t mcp_asdf_counters(const mcp_asdf_t *robot)
{
    mcp_asdf_counters_t counters = robot->counters;
    counters.accepted = add_saturating(counters.accepted, robot->open.count + robot->silent);
    return counters;
}

/* ---- Init -------------------------------------------------------------------------------------------- */

static uint32_t hash_word(uint32_t hash, uint32_t word)
{
    return (hash ^ word) * HASH_FACTOR; /* modulo 2^32 */
}

/* Entries fall, from below 64 to above 1, so that the test's products stay in 64 bits. */
static bool table_valid(const uint32_t *table)
{
    const uint32_t shape = MCP_ASDF_READ_WORD(&table[1]), omega = MCP_ASDF_READ_WORD(&table[2]);
    const uint32_t q = shape >> 16 & 0xFF, fraction_bits = shape >> 8 & 0xFF;
    if (MCP_ASDF_READ_WORD(&table[0]) != TABLE_MAGIC || shape >> 24 != TABLE_VERSION || (shape & 0xFF) != 0 ||
        q < 2 || q > MCP_ASDF_MAX_ID || fraction_bits < 1 || fraction_bits > 31 || omega == 0 ||
        omega > TABLE_OMEGA_MAX) {
        return false;
    }
    uint32_t hash = hash_word(hash_word(hash_word(HASH_START, TABLE_MAGIC), shape), omega);
    uint32_t previous = 0;
    for (uint32_t i = 0; i < q; ++i) {
        const uint32_t k = MCP_ASDF_READ_WORD(&table[TABLE_HEADER + i]);
        if ((i > 0 && k >= previous) || k >> fraction_bits >= 64) {
            return false;
        }
        previous = k;
        hash = hash_word(hash, k);
    }
    return previous > UINT32_C(1) << fraction_bits && hash == MCP_ASDF_READ_WORD(&table[3]);
}

static mcp_asdf_status_t check_config(const mcp_asdf_config_t *config)
{
    if (config->comms_period == 0 || config->filter_period == 0 ||
        config->filter_period % config->comms_period != 0 || config->memory < MCP_ASDF_MEMORY_MIN ||
        (config->memory & 1) != 0 || config->filter > MCP_ASDF_OFF) {
        return MCP_ASDF_ERR_CONFIG;
    }
    if (config->filter == MCP_ASDF_ADAPTIVE && (config->table == 0 || !table_valid(config->table))) {
        return MCP_ASDF_ERR_TABLE;
    }
    return MCP_ASDF_OK;
}

mcp_asdf_status_t mcp_asdf_init(mcp_asdf_t *robot, const mcp_asdf_config_t *config, uint8_t id,
                                uint32_t b_hat)
{
    const mcp_asdf_status_t status = check_config(config);
    if (status != MCP_ASDF_OK) {
        return status;
    }
    if (id > MCP_ASDF_MAX_ID) {
        return MCP_ASDF_ERR_ID;
    }
    if (b_hat < MCP_ASDF_B_HAT_MIN || b_hat > MCP_ASDF_B_HAT_MAX) {
        return MCP_ASDF_ERR_B_HAT;
    }
    *robot = (mcp_asdf_t){0};
    robot->config = config;
    robot->x_hat = MCP_ASDF_HALF;
    robot->settled_x_hat = MCP_ASDF_HALF;
    robot->comms_left = config->comms_period;
    robot->filter_left = config->filter_period;
    robot->id = id;
    set_b_hat(robot, b_hat);
    return MCP_ASDF_OK;
}

/* ---- Invariants, save and restore --------------------------------------------------------------------- */

static bool accuracy_current(const mcp_asdf_t *robot)
{
    const mcp_asdf_accuracy_t *const held = &robot->accuracy;
    mcp_asdf_accuracy_t now;
    set_accuracy(&now, robot->b_hat);
    return held->c == now.c && held->inverse_g == now.inverse_g && held->g_squared == now.g_squared &&
           held->edge == now.edge && held->odds == now.odds && held->g_shift == now.g_shift &&
           held->g_squared_shift == now.g_squared_shift && held->edge_shift == now.edge_shift &&
           held->odds_left == now.odds_left && held->odds_right == now.odds_right &&
           held->inverted == now.inverted;
}

/* x_hat <= 1; alpha on its grid; no confidence only with x_hat = 1/2. */
static bool estimate_possible(uint32_t x_hat, uint32_t alpha)
{
    if (alpha == 0) {
        return x_hat == MCP_ASDF_HALF;
    }
    const uint32_t exponent = alpha >> 23;
    const bool on_grid = exponent >= ALPHA_UNIT_EXPONENT ||
                         (exponent >= ALPHA_UNIT_EXPONENT - 23 &&
                          (alpha & ((UINT32_C(1) << (ALPHA_UNIT_EXPONENT - exponent)) - 1)) == 0);
    return x_hat <= MCP_ASDF_ONE && alpha <= MCP_ASDF_ALPHA_MAX && on_grid;
}

static bool senders_possible(const mcp_asdf_t *robot)
{
    const uint32_t messages = robot->open.count + robot->silent;
    uint32_t heard = 0;
    for (uint8_t id = 0; id <= MCP_ASDF_MAX_ID; ++id) {
        heard += robot->heard.of[id >> 3] >> (id & 7) & 1;
    }
    return robot->silent <= MCP_ASDF_MAX_ID + heard && heard <= messages &&
           (robot->heard.of[robot->id >> 3] >> (robot->id & 7) & 1) == 0;
}

bool mcp_asdf_invariants_hold(const mcp_asdf_t *robot)
{
    const mcp_asdf_config_t *const config = robot->config;
    return robot->id <= MCP_ASDF_MAX_ID && robot->t < config->memory && robot->n <= robot->t &&
           robot->b_hat >= MCP_ASDF_B_HAT_MIN && robot->b_hat <= MCP_ASDF_B_HAT_MAX &&
           accuracy_current(robot) && estimate_possible(robot->x_hat, robot->alpha) &&
           estimate_possible(robot->settled_x_hat, robot->settled_alpha) &&
           mean_possible(robot->closed_alpha, robot->closed_alpha_x_low, robot->closed_alpha_x_high) &&
           sums_possible(&robot->open) && senders_possible(robot) &&
           robot->comms_left <= config->comms_period && robot->filter_left != 0 &&
           robot->filter_left <= config->filter_period && robot->filter_left % config->comms_period == 0;
}

/* An image on its way out of a robot, into `target`, or into one, from `source`; the other is null. */
typedef struct {
    const uint8_t *source;
    uint8_t *target;
    bool reading;
    uint32_t hash;
} image_t;

/* Pass a word through the image: writing returns value itself, reading the image's next word. */
static uint32_t pass(image_t *image, uint32_t value)
{
    uint32_t passed = image->reading ? 0 : value;
    for (uint8_t shift = 0; shift < 32; shift = (uint8_t)(shift + 8)) {
        if (image->reading) {
            passed |= (uint32_t)*image->source++ << shift;
        } else {
            *image->target++ = (uint8_t)(value >> shift);
        }
    }
    image->hash = hash_word(image->hash, passed);
    return passed;
}

static void pass_double(image_t *image, uint64_t *value)
{
    const uint32_t low = pass(image, low_word(*value));
    *value = join(pass(image, high_word(*value)), low);
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
    for (uint8_t i = 0; i < 4; ++i) {
        word |= (uint32_t)bytes[i] << 8 * i;
    }
    word = pass(image, word);
    for (uint8_t i = 0; i < 4; ++i) {
        bytes[i] = (uint8_t)(word >> 8 * i);
    }
}

static void pass_sums(image_t *image, mcp_asdf_t *robot)
{
    pass_double(image, &robot->closed_alpha);
    pass_double(image, &robot->closed_alpha_x_low);
    pass_double(image, &robot->closed_alpha_x_high);
    pass_double(image, &robot->open.alpha);
    pass_double(image, &robot->open.alpha_x_low);
    pass_double(image, &robot->open.alpha_x_high);
    pass_double(image, &robot->open.x_squared);
    robot->open.x = pass(image, robot->open.x);
    robot->open.count = pass(image, robot->open.count);
    for (uint8_t i = 0; i < 16; i = (uint8_t)(i + 4)) {
        pass_bytes(image, &robot->heard.of[i]);
    }
}

/* The one list of what an image holds, for both directions; the accuracy follows from b_hat. */
static void pass_state(image_t *image, mcp_asdf_t *robot)
{
    robot->t = pass(image, robot->t);
    robot->n = pass(image, robot->n);
    robot->b_hat = pass(image, robot->b_hat);
    robot->x_hat = pass(image, robot->x_hat);
    robot->alpha = pass(image, robot->alpha);
    robot->settled_x_hat = pass(image, robot->settled_x_hat);
    robot->settled_alpha = pass(image, robot->settled_alpha);
    pass_sums(image, robot);
    robot->comms_left = pass(image, robot->comms_left);
    robot->filter_left = pass(image, robot->filter_left);
    pass_pair(image, &robot->counters.accepted, &robot->counters.repeated);
    pass_pair(image, &robot->counters.rejected, &robot->counters.tests);
    const uint32_t rest =
        pass(image, robot->counters.updates | (uint32_t)robot->silent << 16 | (uint32_t)robot->id << 24);
    robot->counters.updates = (uint16_t)rest;
    robot->silent = (uint8_t)(rest >> 16);
    robot->id = (uint8_t)(rest >> 24);
}

void mcp_asdf_save(const mcp_asdf_t *robot, uint8_t image[MCP_ASDF_IMAGE_SIZE])
{
    image_t out = {0, image, false, HASH_START};
    mcp_asdf_t copy = *robot;
    (void)pass(&out, IMAGE_MAGIC);
    pass_state(&out, &copy);
    (void)pass(&out, out.hash);
}

mcp_asdf_status_t mcp_asdf_restore(mcp_asdf_t *robot, const mcp_asdf_config_t *config,
                                   const uint8_t image[MCP_ASDF_IMAGE_SIZE])
{
    const mcp_asdf_status_t status = check_config(config);
    if (status != MCP_ASDF_OK) {
        return status;
    }
    image_t in = {image, 0, true, HASH_START};
    mcp_asdf_t copy = {0};
    copy.config = config;
    const bool magic = pass(&in, 0) == IMAGE_MAGIC;
    pass_state(&in, &copy);
    const uint32_t hash = in.hash;
    if (!magic || pass(&in, 0) != hash || copy.b_hat < MCP_ASDF_B_HAT_MIN ||
        copy.b_hat > MCP_ASDF_B_HAT_MAX) {
        return MCP_ASDF_ERR_IMAGE;
    }
    set_b_hat(&copy, copy.b_hat);
    if (!mcp_asdf_invariants_hold(&copy)) {
        return MCP_ASDF_ERR_IMAGE;
    }
    *robot = copy;
    return MCP_ASDF_OK;
}
