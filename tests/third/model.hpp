/* A second robot, written from docs/design.md and the public headers alone, never from the C or its mirror.
 * Please keep it so: where it differs from the C, the page decides who is right, and where the page does not
 * decide, the page needs another sentence. Numbers in comments are sections of that page.
 *
 * It is made to be compared with the page by eye, not to be fast or small: formulas stand as on the page, in
 * 128 bits where that saves a thought about overflow. */
#ifndef THIRD_MODEL_HPP
#define THIRD_MODEL_HPP

#include "mcp_asdf_image.h"

#include <algorithm>
#include <array>
#include <cstddef>
#include <cstdint>
#include <cstdlib>
#include <type_traits>
#include <utility>
#include <vector>

namespace third
{
__extension__ typedef unsigned __int128 uint128_t;
__extension__ typedef __int128 int128_t;

constexpr uint64_t two31 = uint64_t(1) << 31;
constexpr uint64_t two32 = uint64_t(1) << 32;
constexpr uint32_t informative = uint32_t(1) << 20; /* smallest g and G that say something */

inline uint32_t u32(uint64_t v) { return static_cast<uint32_t>(v); }
template <typename Integer> uint64_t u64(Integer v) { return static_cast<uint64_t>(v); }
inline int bits(uint64_t v) { return v == 0 ? 0 : 64 - __builtin_clzll(v); }
inline int lz(uint64_t v) { return 32 - bits(v); }

/* 3: what an alpha word is worth, in units of 2^-24. */
inline uint64_t units(uint32_t alpha) { return uint64_t(alpha >> 8) << (alpha & 31); }

/* 9: the checksum of tables and images. */
template <typename Words> uint32_t checksum(const Words &words, std::size_t count)
{
    uint32_t h = 0x811C9DC5;
    for (std::size_t i = 0; i < count; ++i)
        h = (h ^ words[i]) * 0x01000193;
    return h;
}

/* 9: k_m is word m, k for every m > q is word q + 1, the checksum is word q + 2. */
inline bool table_is_sound(const uint32_t *table)
{
    if (table == nullptr)
        return false;
    uint32_t q = table[0] - 0x4D435400;
    if (q < 2 || q > 127 || table[1] == 0 || table[1] > 3865470566 /* 0.9 */)
        return false;
    for (uint32_t m = 2; m <= q; ++m)
        if (table[m] <= table[m + 1])
            return false;
    return table[q + 1] > uint32_t(1) << 26 && table[q + 2] == checksum(table, q + 2);
}

/* 4. */
inline uint64_t square(uint64_t u, uint64_t v)
{
    uint64_t r = (((u >> 1) << 24) / (v >> 1)) << 7;
    return r * r >> 32;
}

/* 5: x_hat and alpha as t, n and b_hat give them. */
struct Local {
    uint32_t x_hat = MCP_ASDF_HALF;
    uint32_t alpha = 0;
};

inline Local form(uint64_t t, uint64_t n, uint32_t b_hat)
{
    uint64_t c = std::min<uint64_t>(b_hat, two32 - b_hat);
    uint64_t g = two32 - 2 * c;
    if (t == 0 || g < informative)
        return {};
    int g_shift = lz(g);

    uint64_t part = std::min(n, t - n);
    int shift = lz(t);
    uint64_t total = t << shift;
    uint64_t rarer = part << shift;
    uint64_t least = c * total >> 32;
    uint64_t x;
    uint64_t mantissa;
    int exponent;
    if (rarer <= least) {
        int c_shift = lz(c);
        uint64_t common = square(g << g_shift, two32 - c);
        uint64_t rare = square(g << g_shift, c << c_shift);
        uint64_t S = t * common;
        int E = -6 - 2 * g_shift;
        if (part != 0) {
            S = part * rare + ((t - part) * common >> 2 * c_shift);
            E += 2 * c_shift;
        }
        int s = bits(S) - 24;
        x = 0;
        mantissa = S >> s;
        exponent = E + s;
    } else {
        uint64_t scale = (total - 2 * least) << g_shift;
        x = (((rarer - least) << g_shift) << 22) / (scale >> 1);
        uint64_t squared = (scale * scale >> 32) * total >> 32;
        uint64_t spread = rarer * (total - rarer);
        uint64_t a = squared << lz(squared) >> 1;
        uint64_t d = spread >> (bits(spread) - 31);
        uint64_t ratio = (a << 24) / d;
        int excess = static_cast<int>(ratio >> 24);
        mantissa = ratio >> excess;
        exponent = 32 + (64 - bits(spread)) - lz(squared) - 2 * g_shift - shift + excess;
    }

    if (exponent > 31) {
        mantissa = 0xFFFFFF;
        exponent = 31;
    } else if (exponent < 0) {
        mantissa >>= -exponent;
        exponent = 0;
    }
    bool complement = (n < t - n) == (b_hat < two31);
    return {u32(complement ? MCP_ASDF_ONE - x : x), u32(mantissa << 8 | static_cast<uint64_t>(exponent))};
}

/* 8: 2^32 N / D of the upper bits, for 0 <= N <= D and D > 0. */
inline uint64_t upper(uint64_t N, uint64_t D)
{
    if (D < two32) {
        N <<= 32;
        D <<= 32;
    }
    int s = bits(D) - 32;
    return ((N >> s) << 31) / ((D >> (s + 1)) + 1);
}

/* 6: the sums of a round. */
struct Round {
    uint64_t alpha = 0, low_x = 0, high_x = 0, x_squared = 0;
    uint32_t x = 0, m = 0;

    uint128_t alpha_x() const { return low_x + (uint128_t(high_x) << 32); }
};

/* 13. */
inline uint64_t mulhi(uint64_t u, uint64_t v) { return u64(uint128_t(u) * v >> 32); }

inline uint64_t distance_between(uint64_t u, uint64_t v) { return u > v ? u - v : v - u; }

/* 13, test: the estimates of the filled slots in ascending order, their centre C and their spread S, all in
 * units of 2^-24. */
class TestedEstimates
{
  public:
    explicit TestedEstimates(std::vector<int64_t> values) : ascending(std::move(values))
    {
        std::sort(ascending.begin(), ascending.end());
        int64_t M = twice_the_median(ascending) / 2;
        std::vector<int64_t> distances;
        for (int64_t estimate : ascending)
            distances.push_back(std::abs(estimate - M));
        std::sort(distances.begin(), distances.end());
        S = std::clamp<int64_t>(twice_the_median(distances) / 2, 1 << 12, 1 << 22);

        C = M;
        for (int times = 0; times < 3; ++times)
            move_centre();
    }

    std::vector<int64_t> ascending;
    int64_t C, S;

  private:
    static int64_t twice_the_median(const std::vector<int64_t> &sorted)
    {
        return sorted[(sorted.size() - 1) / 2] + sorted[sorted.size() / 2];
    }

    void move_centre()
    {
        int64_t sum = 0;
        int64_t near = 0;
        for (int64_t estimate : ascending) {
            sum += std::clamp(estimate - C, -S, S);
            near += std::abs(estimate - C) <= S;
        }
        int64_t d = std::max<int64_t>(1, near) << 24;
        auto quotient = upper(u64(std::min(std::abs(sum), d)), u64(d));
        auto step = static_cast<int64_t>(quotient >> 8);
        C = sum < 0 ? std::max<int64_t>(C - step, 0) : std::min<int64_t>(C + step, (1 << 24) - (1 << 8));
    }
};

/* 13: what a robot with the robust filter keeps. The page calls centre r, spread s, initial_b_hat b_0,
 * batch_t t', batch_n n' and dispersion phi. */
struct Robust {
    uint32_t centre = uint32_t(1) << 29, spread = uint32_t(1) << 28, initial_b_hat = 0, filled_slots = 0;
    uint32_t batch_t = 0, batch_n = 0;
    uint16_t votes = 0, dispersion = 1 << 8;
    uint32_t turn = 0;
    std::array<uint16_t, MCP_ASDF_SLOTS> estimates{};

    bool is_filled(uint32_t slot) const { return (filled_slots >> slot & 1) != 0; }
    int filled_count() const { return __builtin_popcount(filled_slots); }

    void keep_estimate(uint8_t sender, uint32_t x_hat)
    {
        uint32_t slot = sender % MCP_ASDF_SLOTS;
        estimates[slot] = static_cast<uint16_t>(std::min<uint32_t>((x_hat + 64) >> 7, 0xFFFF));
        filled_slots |= uint32_t(1) << slot;
    }

    /* The vote of a settle; `own` is the robot's own estimate. */
    void take_vote(const Local &own)
    {
        if (filled_slots == 0)
            return;
        uint32_t slot = first_filled_slot_from(turn);
        if (slot == MCP_ASDF_SLOTS && units(own.alpha) != 0) {
            turn = 0;
            move(own.x_hat << 7);
            return;
        }
        if (slot == MCP_ASDF_SLOTS)
            slot = first_filled_slot_from(0);
        turn = slot + 1;
        move(uint32_t(estimates[slot]) << 14);
    }

    /* MCP_ASDF_SLOTS if there is none. */
    uint32_t first_filled_slot_from(uint32_t slot) const
    {
        while (slot < MCP_ASDF_SLOTS && !is_filled(slot))
            ++slot;
        return slot;
    }

    void move(uint32_t vote)
    {
        auto distance = static_cast<uint32_t>(distance_between(vote, centre));
        uint32_t pull = std::min(distance, spread);
        votes = std::min<uint16_t>(static_cast<uint16_t>(votes + 1), 1 << 9);
        int shift = std::max(bits(votes) - 3, 3);
        uint32_t step = pull >> shift;
        uint32_t change = spread >> (shift + 1);
        centre = vote > centre ? centre + step : centre - step;
        spread =
            std::clamp<uint32_t>(distance > spread ? spread + change : spread - change, 1 << 18, 1 << 28);
    }

    /* The filter's first point: the batch of observations that ends at t and n changes the dispersion. */
    void end_batch(uint32_t t, uint32_t n)
    {
        uint64_t share = upper(n, t);
        uint64_t d = t - batch_t;
        uint64_t v = mulhi(share, two32 - share);
        uint64_t c = 12 * uint64_t(dispersion);
        auto limit = u64(uint128_t(c) * d * v >> 18);
        uint64_t deviation = distance_between(uint64_t(n - batch_n) << 32, d * share);
        uint64_t e = std::min(deviation >> 21, two32 - 1);
        if (limit != 0) {
            uint64_t ratio = mulhi(c, upper(std::min(e * e, limit), limit));
            uint64_t mean = (7 * uint64_t(dispersion) + ratio) >> 3;
            dispersion = static_cast<uint16_t>(std::clamp<uint64_t>(mean, 1 << 8, 0xFFFF));
        }
        batch_t = t;
        batch_n = n;
    }

    TestedEstimates tested_estimates() const
    {
        std::vector<int64_t> values;
        for (uint32_t slot = 0; slot < MCP_ASDF_SLOTS; ++slot)
            if (is_filled(slot))
                values.push_back(int64_t(estimates[slot]) << 8);
        return TestedEstimates(std::move(values));
    }

    /* The share of black readings of a sensor with the accuracy b_0 where the fill ratio is X. */
    uint64_t p(uint64_t X) const
    {
        return mulhi(initial_b_hat, X) + mulhi(two32 - 1 - initial_b_hat, two32 - 1 - X);
    }

    /* Whether n of t black readings reject b_0. */
    bool rejects(const TestedEstimates &tested, uint32_t t, uint32_t n) const
    {
        uint64_t share = upper(n, t);
        uint64_t p_centre = p(u64(tested.C) << 8);
        uint64_t v = std::max(mulhi(p_centre, two32 - p_centre), mulhi(share, two32 - share));
        uint64_t g = distance_between(2 * uint64_t(initial_b_hat), two32);
        uint128_t reach = mulhi(g, u64(tested.S) << 8);
        uint128_t least = 12 * reach * reach;
        uint128_t difference = distance_between(share, p_centre);
        uint128_t square = difference * difference;
        return square > least && t * (square - least) >> 32 > uint128_t(12) * dispersion * v >> 8;
    }

    /* Whether more than two fifths of the estimates support the robot. */
    bool is_supported(const TestedEstimates &tested, uint32_t t, uint32_t n) const
    {
        uint64_t share = upper(n, t);
        uint64_t p_centre = p(u64(tested.C) << 8);
        std::size_t supporters = 0;
        for (int64_t estimate : tested.ascending) {
            uint64_t p_estimate = p(u64(estimate) << 8);
            supporters += distance_between(p_estimate, share) < distance_between(p_estimate, p_centre);
        }
        return 5 * supporters > 2 * tested.ascending.size();
    }

    /* 10: what the page says of it, for a robot with these t, n and b_hat. */
    bool is_possible(uint32_t t, uint32_t n, uint32_t b_hat) const
    {
        for (uint32_t slot = 0; slot < MCP_ASDF_SLOTS; ++slot)
            if (!is_filled(slot) && estimates[slot] != 0)
                return false;
        bool is_initial = b_hat == initial_b_hat;
        bool has_new_votes = centre == uint32_t(1) << 29 && spread == 1 << 28 && turn == 0;
        bool has_votes = filled_slots != 0 && votes <= 1 << 9 && centre <= uint32_t(1) << 30 &&
                         spread >= 1 << 18 && spread <= 1 << 28 &&
                         (turn == 0 || (turn <= MCP_ASDF_SLOTS && is_filled(turn - 1)));
        return initial_b_hat >= 1 << 12 && initial_b_hat <= two32 - (1 << 12) && dispersion >= 1 << 8 &&
               batch_n <= batch_t && batch_n <= n && batch_t - batch_n <= t - n &&
               (filled_count() >= 5 || is_initial) &&
               (batch_t != 0 || (is_initial && dispersion == 1 << 8)) &&
               (votes == 0 ? has_new_votes : has_votes);
    }
};

/* Large enough for every filter; another filter than the robust one leaves the last bytes unused. */
using Image = std::array<uint8_t, MCP_ASDF_IMAGE_SIZE>;

struct Robot {
    mcp_asdf_config_t config{};
    uint8_t id = 0;
    uint32_t b_hat = 0, t = 0, n = 0, filter_left = 0;
    Local local;
    Round open, closed; /* of the closed round, only alpha, low_x and high_x outlive settle */
    Robust robust;
    std::array<uint32_t, 4> heard{};
    mcp_asdf_counters_t counters{};
    uint8_t updated = 0; /* u */

    bool is_robust() const { return config.filter == MCP_ASDF_ROBUST; }
    uint32_t image_version() const { return is_robust() ? 0x4D435383 : 0x4D435303; }

    /* 2 and 9, in the order of the header, which also says what is built. */
    static mcp_asdf_status_t check(const mcp_asdf_config_t &config)
    {
        if (config.filter_period == 0 || config.memory % 4 != 0 || config.memory < MCP_ASDF_MEMORY_MIN ||
            config.memory > MCP_ASDF_MEMORY_MAX || config.filter > MCP_ASDF_ROBUST ||
            !(config.filter == MCP_ASDF_ROBUST ? MCP_ASDF_WITH_ROBUST : MCP_ASDF_WITH_ASDF))
            return MCP_ASDF_ERR_CONFIG;
        if (config.filter == MCP_ASDF_ADAPTIVE && !table_is_sound(config.table))
            return MCP_ASDF_ERR_TABLE;
        return MCP_ASDF_OK;
    }

    mcp_asdf_status_t init(const mcp_asdf_config_t &new_config, uint8_t new_id, uint32_t new_b_hat)
    {
        mcp_asdf_status_t status = check(new_config);
        if (status != MCP_ASDF_OK)
            return status;
        if (new_id > MCP_ASDF_MAX_ID)
            return MCP_ASDF_ERR_ID;
        if (new_b_hat < MCP_ASDF_B_HAT_MIN || new_b_hat > MCP_ASDF_B_HAT_MAX)
            return MCP_ASDF_ERR_B_HAT;
        *this = Robot();
        config = new_config;
        id = new_id;
        b_hat = new_b_hat;
        filter_left = config.filter_period;
        robust.initial_b_hat = is_robust() ? b_hat : 0;
        return MCP_ASDF_OK;
    }

    mcp_asdf_status_t observe(uint32_t z)
    {
        if (z > 1)
            return MCP_ASDF_ERR_OBSERVATION;
        t += 1;
        n += z;
        if (t == config.memory) {
            t = config.memory / 2;
            n = n / 2 + (n % 4 == 3 ? 1 : 0); /* to nearest, ties to even */
            if (is_robust()) {
                robust.batch_t = t;
                robust.batch_n = n;
            }
        }
        local = form(t, n, b_hat);
        updated = 0;
        return MCP_ASDF_OK;
    }

    mcp_asdf_status_t receive(uint8_t sender, uint32_t x_hat, uint32_t alpha)
    {
        if (sender > MCP_ASDF_MAX_ID || sender == id || x_hat > MCP_ASDF_ONE) {
            ++counters.rejected;
            return sender > MCP_ASDF_MAX_ID || sender == id ? MCP_ASDF_ERR_SENDER : MCP_ASDF_ERR_X_HAT;
        }
        if (has_heard(sender)) {
            ++counters.repeated;
            return MCP_ASDF_REPEATED;
        }
        ++counters.accepted;
        heard[sender / 32] |= uint32_t(1) << sender % 32;
        uint64_t worth = units(alpha);
        if (worth != 0 && is_robust()) {
            robust.keep_estimate(sender, x_hat);
        } else if (worth != 0) {
            open.alpha += worth;
            open.low_x += (worth % two32) * x_hat;
            open.high_x += (worth / two32) * x_hat;
            open.x_squared += uint64_t(x_hat) * x_hat;
            open.x += x_hat;
            open.m += 1;
        }
        return MCP_ASDF_OK;
    }

    bool has_heard(uint8_t sender) const { return (heard[sender / 32] >> sender % 32 & 1) != 0; }

    mcp_asdf_status_t settle()
    {
        bool changed = false;
        closed = open;
        if (is_robust())
            robust.take_vote(local);
        if (--filter_left == 0) {
            filter_left = config.filter_period;
            changed = is_robust() ? robust_filter() : filter();
        }
        open = Round();
        heard = {};
        return changed ? MCP_ASDF_UPDATED : MCP_ASDF_OK;
    }

    mcp_asdf_status_t step(uint32_t z)
    {
        mcp_asdf_status_t status = observe(z);
        return status == MCP_ASDF_OK ? settle() : status;
    }

    /* 7 and 13. */
    uint32_t x() const
    {
        if (is_robust())
            return robust.votes == 0 ? local.x_hat : robust.centre >> 7;
        uint128_t denominator = uint128_t(units(local.alpha)) + closed.alpha;
        uint128_t numerator = uint128_t(units(local.alpha)) * local.x_hat + closed.alpha_x();
        return denominator == 0 ? local.x_hat : static_cast<uint32_t>(numerator / denominator);
    }
    uint32_t x_bar() const
    {
        if (is_robust())
            return robust.votes == 0 ? MCP_ASDF_HALF : robust.centre >> 7;
        return closed.alpha == 0 ? MCP_ASDF_HALF : static_cast<uint32_t>(closed.alpha_x() / closed.alpha);
    }
    uint64_t beta() const { return closed.alpha; }

    /* 8, of the round just closed. */
    bool rejects() const
    {
        int128_t m = closed.m;
        int128_t sum_x = closed.x;
        int128_t left = (sum_x - m * local.x_hat) * (sum_x - m * local.x_hat);
        int128_t k = config.table[std::min(closed.m, config.table[0] - 0x4D435400 + 1)];
        return left > k * (m * closed.x_squared - sum_x * sum_x) >> 26;
    }

    bool filter()
    {
        if (config.filter == MCP_ASDF_OFF || t == 0 ||
            closed.m < (config.filter == MCP_ASDF_ADAPTIVE ? 2u : 1u))
            return false;
        if (config.filter == MCP_ASDF_ADAPTIVE) {
            ++counters.tests;
            if (!rejects())
                return false;
        }

        uint128_t widen = closed.alpha < two32 ? two32 : 1;
        return reestimate(upper(static_cast<uint64_t>(closed.alpha_x() * widen >> 23),
                                static_cast<uint64_t>(closed.alpha * widen)));
    }

    bool reestimate(uint64_t A)
    {
        uint64_t black = n;
        if (A < two31) {
            A = two32 - 1 - A;
            black = t - n;
        }
        uint64_t G = 2 * A - two32;
        if (G < informative)
            return false;
        int128_t N = int128_t(two32) * black - int128_t(t) * (two32 - A);
        int128_t D = int128_t(t) * G;
        if (N <= 0)
            return update(MCP_ASDF_B_HAT_MIN);
        if (N >= D)
            return update(MCP_ASDF_B_HAT_MAX);
        return update(std::clamp<uint64_t>(upper(static_cast<uint64_t>(N), static_cast<uint64_t>(D)),
                                           MCP_ASDF_B_HAT_MIN, MCP_ASDF_B_HAT_MAX));
    }

    bool update(uint64_t found)
    {
        b_hat = u32(found);
        ++counters.updates;
        updated = 1;
        return true;
    }

    /* 13. */
    bool robust_filter()
    {
        if (t == 0)
            return false;
        robust.end_batch(t, n);
        if (robust.filled_count() < 5)
            return false;
        ++counters.tests;
        TestedEstimates tested = robust.tested_estimates();
        if (robust.rejects(tested, t, n) && !robust.is_supported(tested, t, n))
            return reestimate(u64(tested.C) << 8);
        return b_hat != robust.initial_b_hat && update(robust.initial_b_hat);
    }

    /* 10: the image is the members in this order, each little-endian, between the first word and the
     * checksum. */
    template <typename Self, typename Each> static void image_members(Self &r, Each each)
    {
        each(r.b_hat), each(r.t), each(r.n), each(r.local.x_hat), each(r.local.alpha), each(r.filter_left);
        if (r.is_robust()) {
            each(r.robust.centre), each(r.robust.spread), each(r.robust.initial_b_hat);
            each(r.robust.filled_slots), each(r.robust.batch_t), each(r.robust.batch_n);
            each(r.robust.votes), each(r.robust.dispersion), each(r.robust.turn);
            for (auto &estimate : r.robust.estimates)
                each(estimate);
        } else {
            each(r.closed.alpha), each(r.closed.low_x), each(r.closed.high_x);
            each(r.open.alpha), each(r.open.low_x), each(r.open.high_x), each(r.open.x_squared);
            each(r.open.x), each(r.open.m);
        }
        each(r.heard[0]), each(r.heard[1]), each(r.heard[2]), each(r.heard[3]);
        each(r.counters.accepted), each(r.counters.repeated), each(r.counters.rejected);
        each(r.counters.tests), each(r.counters.updates), each(r.updated), each(r.id);
    }

    std::size_t image_word_count() const { return is_robust() ? 39 : 31; }

    /* The words of the robot's image. */
    std::vector<uint32_t> save() const
    {
        std::vector<uint8_t> bytes;
        auto put = [&](auto v) {
            for (uint32_t i = 0; i < sizeof v; ++i)
                bytes.push_back(static_cast<uint8_t>(uint64_t(v) >> 8 * i));
        };
        put(image_version());
        image_members(*this, put);
        std::vector<uint32_t> words = to_words(bytes.data(), bytes.size() / 4);
        words.push_back(checksum(words, words.size()));
        return words;
    }

    mcp_asdf_status_t restore(const mcp_asdf_config_t &new_config, const Image &image)
    {
        mcp_asdf_status_t status = check(new_config);
        if (status != MCP_ASDF_OK)
            return status;
        Robot r;
        r.config = new_config;
        std::vector<uint32_t> words = to_words(image.data(), r.image_word_count());
        if (words.front() != r.image_version() || words.back() != checksum(words, words.size() - 1))
            return MCP_ASDF_ERR_IMAGE;
        uint32_t at = 4;
        image_members(r, [&](auto &member) {
            uint64_t v = 0;
            for (uint32_t i = 0; i < sizeof member; ++i)
                v |= uint64_t(image[at++]) << 8 * i;
            member = static_cast<std::decay_t<decltype(member)>>(v);
        });
        if (!r.is_possible())
            return MCP_ASDF_ERR_IMAGE;
        *this = r;
        return MCP_ASDF_OK;
    }

    /* The first words of little-endian bytes. */
    static std::vector<uint32_t> to_words(const uint8_t *bytes, std::size_t count)
    {
        std::vector<uint32_t> words(count);
        for (std::size_t i = 0; i < 4 * count; ++i)
            words[i / 4] |= uint32_t(bytes[i]) << 8 * (i % 4);
        return words;
    }

    /* What the page says of every robot, as far as one state can show it. */
    bool is_possible() const
    {
        uint32_t senders = 0;
        for (uint32_t word : heard)
            senders += static_cast<uint32_t>(__builtin_popcount(word));
        if (id > MCP_ASDF_MAX_ID || b_hat < MCP_ASDF_B_HAT_MIN || b_hat > MCP_ASDF_B_HAT_MAX ||
            t >= config.memory || n > t || filter_left == 0 || filter_left > config.filter_period ||
            has_heard(id) || open.m > senders || (is_robust() && !robust.is_possible(t, n, b_hat)))
            return false;

        /* With u = 1, x_hat and alpha are of a b_hat that is no longer known. */
        Local now = form(t, n, b_hat);
        if (updated == 0 ? local.x_hat != now.x_hat || local.alpha != now.alpha
                         : updated != 1 || t == 0 || local.x_hat > MCP_ASDF_ONE || !is_canonical(local.alpha))
            return false;

        /* What 3 and 6 say of sums: every alpha is 1 unit or more and at most the largest; no low is above
         * 2^32 - 1, no high above 2^23 - 1 and no x_hat above 2^23; and the square of a sum is at most m sums
         * of squares. */
        return is_possible(open, open.m) && is_possible(closed, MCP_ASDF_MAX_ID) && open.alpha >= open.m &&
               open.low_x <= uint128_t(0xFFFFFFFF) * open.x && open.high_x <= uint64_t(0x7FFFFF) * open.x &&
               open.x_squared <= uint64_t(open.x) << 23 &&
               uint64_t(open.x) * open.x <= uint128_t(open.x_squared) * open.m;
    }
    static bool is_canonical(uint32_t alpha)
    {
        return (alpha & 0xE0) == 0 && (alpha >= 0x80000000 || (alpha & 0x1F) == 0);
    }

    static bool is_possible(const Round &round, uint64_t most)
    {
        return round.alpha <= most * units(0xFFFFFF1F) && round.alpha_x() <= uint128_t(round.alpha) << 23 &&
               round.low_x >> 62 == 0;
    }
};
} // namespace third

#endif
