/* Runs the model of model.hpp and the C side by side on random calls and compares every reading after every
 * call. `test_third SEED CALLS` repeats a run; a difference prints that line and exits with 1.
 *
 * Calls come in lives of some hundred. A life begins with random settings and either a new robot or one of
 * any age, whose image the model writes and the C restores. */
#include "model.hpp"

#include <cinttypes>
#include <cstdio>
#include <cstdlib>
#include <functional>

extern "C" const uint32_t mcp_asdf_t_table_omega05_q30[33];

using namespace third;

namespace
{
/* splitmix64 */
class Random
{
  public:
    explicit Random(uint64_t seed) : state(seed) {}
    uint64_t next()
    {
        uint64_t z = state += 0x9E3779B97F4A7C15;
        z = (z ^ z >> 30) * 0xBF58476D1CE4E5B9;
        z = (z ^ z >> 27) * 0x94D049BB133111EB;
        return z ^ z >> 31;
    }
    uint32_t word() { return u32(next() >> 32); }
    uint32_t below(uint64_t limit) { return u32(next() >> 32) % u32(limit); } /* limit below 2^32 */
    bool one_in(uint32_t k) { return below(k) == 0; }
    uint32_t among(std::initializer_list<uint32_t> words) { return words.begin()[below(words.size())]; }
    /* Of every length up to so many bits, and so often small. */
    uint32_t any_length(uint32_t most) { return u32((next() >> 32) >> (32 - most) >> below(most)); }
    /* v or nearly v, held within 0 .. limit. */
    uint32_t near(int64_t v, int64_t limit)
    {
        int64_t offset = one_in(2) ? int64_t(below(9)) - 4 : int64_t(any_length(24)) * (one_in(2) ? 1 : -1);
        return static_cast<uint32_t>(std::clamp<int64_t>(v + offset, 0, limit));
    }

  private:
    uint64_t state;
};

/* A t-table of up to q = 128, one more than init may accept. */
struct Table {
    uint32_t words[131] = {};
    void seal(uint32_t q) { words[q + 2] = checksum(words, q + 2); }
};

/* What a robot in C keeps pointers to. */
struct Settings {
    mcp_asdf_config_t config{};
    Table table;
};

class Run
{
  public:
    Run(uint64_t seed, uint64_t limit) : seed_(seed), limit_(limit), random(seed)
    {
        std::copy(std::begin(mcp_asdf_t_table_omega05_q30), std::end(mcp_asdf_t_table_omega05_q30),
                  real.words);
        expect("soundness of the real table", table_is_sound(real.words), 1);
    }

    bool go()
    {
        while (same && calls < limit_)
            live();
        if (!same)
            return false;
        std::printf("third: %" PRIu64 " calls of seed %" PRIu64 " in %" PRIu64 " lives without a difference"
                    " (%" PRIu64 " updates of b_hat, %" PRIu64 " images restored)\n",
                    calls, seed_, lives, updates, restored);
        return true;
    }

  private:
    uint64_t seed_, limit_;
    Random random;
    Table real;
    Settings slots[2], *current = &slots[0], *spare = &slots[1];
    mcp_asdf_t c{};
    Robot model;
    bool same = true;
    uint64_t calls = 0, lives = 0, updates = 0, restored = 0;
    uint32_t sender = 0, stride = 1, centre = 0, spread = 0, alphas = 0;
    const char *call = "";
    uint32_t arguments[3] = {};

    /* Counts a call and notes it for the report. */
    void note(const char *name, uint32_t a = 0, uint32_t b = 0, uint32_t d = 0)
    {
        ++calls;
        call = name;
        arguments[0] = a, arguments[1] = b, arguments[2] = d;
    }
    void differ(const char *what, uint64_t page, uint64_t in_c)
    {
        if (!same)
            return;
        same = false;
        std::printf("third: call %" PRIu64 ", %s(%" PRIu32 ", %" PRIu32 ", %" PRIu32 "): %s is 0x%" PRIX64
                    " by the page and 0x%" PRIX64 " in the C\n",
                    calls, call, arguments[0], arguments[1], arguments[2], what, page, in_c);
        std::printf("robot %u: b_hat 0x%" PRIX32 ", t %" PRIu32 ", n %" PRIu32 ", m %" PRIu32
                    ", memory 0x%" PRIX32 ", filter %u every %" PRIu32 "\n",
                    model.id, model.b_hat, model.t, model.n, model.open.m, current->config.memory,
                    current->config.filter, current->config.filter_period);
        std::printf("repeat with: test_third %" PRIu64 " %" PRIu64 "\n", seed_, calls);
    }
    void expect(const char *what, uint64_t page, uint64_t in_c)
    {
        if (page != in_c)
            differ(what, page, in_c);
    }
    void compare(mcp_asdf_status_t status_by_page, mcp_asdf_status_t status_in_c)
    {
        updates += status_by_page == MCP_ASDF_UPDATED;
        mcp_asdf_counters_t a = model.counters;
        mcp_asdf_counters_t b = mcp_asdf_counters(&c);
        expect("status, as 32 bits,", u32(u64(status_by_page)), u32(u64(status_in_c)));
        expect("id", model.id, mcp_asdf_id(&c));
        expect("t", model.t, mcp_asdf_t_count(&c));
        expect("n", model.n, mcp_asdf_n_count(&c));
        expect("b_hat", model.b_hat, mcp_asdf_b_hat(&c));
        expect("x_hat", model.local.x_hat, mcp_asdf_x_hat(&c));
        expect("alpha", model.local.alpha, mcp_asdf_alpha(&c));
        expect("x", model.x(), mcp_asdf_x(&c));
        expect("x_bar", model.x_bar(), mcp_asdf_x_bar(&c));
#if MCP_ASDF_WITH_ASDF
        expect("beta", model.beta(), mcp_asdf_beta(&c));
#endif
#if MCP_ASDF_WITH_ROBUST
        const Robust &page = model.robust;
        mcp_asdf_robust_t in_c = mcp_asdf_robust(&c);
        expect("centre", page.centre, in_c.centre);
        expect("spread", page.spread, in_c.spread);
        expect("initial_b_hat", page.initial_b_hat, in_c.initial_b_hat);
        expect("filled_slots", page.filled_slots, in_c.filled_slots);
        expect("batch_t", page.batch_t, in_c.batch_t);
        expect("batch_n", page.batch_n, in_c.batch_n);
        expect("votes", page.votes, in_c.votes);
        expect("dispersion", page.dispersion, in_c.dispersion);
        expect("turn", page.turn, in_c.turn);
        for (uint32_t slot = 0; model.is_robust() && slot < MCP_ASDF_SLOTS; ++slot)
            expect("an estimate", page.estimates[slot], c.received.estimates[slot]);
#endif
        expect("accepted", a.accepted, b.accepted);
        expect("repeated", a.repeated, b.repeated);
        expect("rejected", a.rejected, b.rejected);
        expect("tests", a.tests, b.tests);
        expect("updates", a.updates, b.updates);
    }

    /* Does one of these, or of the first ones. */
    void any_of(std::initializer_list<std::function<void()>> acts, uint64_t first = ~uint64_t(0))
    {
        acts.begin()[random.below(std::min<uint64_t>(first, acts.size()))]();
    }

    uint32_t some_b_hat()
    {
        uint32_t offset = random.any_length(31);
        uint32_t b_hat = random.among({random.word(), MCP_ASDF_B_HAT_MIN + offset, u32(two31) + offset,
                                       u32(two31 + informative / 2) + random.below(9) - 4, /* g nearly 2^20 */
                                       u32(two31) + random.word() / 2, MCP_ASDF_B_HAT_MAX,
                                       0xF0000000 + random.below(16) * 0x1000000});
        b_hat = random.one_in(3) ? u32(two32 - b_hat) : b_hat;
        return std::clamp(b_hat, MCP_ASDF_B_HAT_MIN, MCP_ASDF_B_HAT_MAX);
    }

    uint32_t some_memory()
    {
        uint32_t any = std::clamp(random.any_length(31) & ~3u, MCP_ASDF_MEMORY_MIN, MCP_ASDF_MEMORY_MAX);
        return random.among({MCP_ASDF_MEMORY_MAX, 64 + 4 * random.below(20), any, any});
    }

    uint8_t some_filter()
    {
        if (!MCP_ASDF_WITH_ASDF || (MCP_ASDF_WITH_ROBUST && random.one_in(2)))
            return MCP_ASDF_ROBUST;
        return static_cast<uint8_t>(random.one_in(3) ? random.below(3) : 0u);
    }

    void some_settings(Settings &settings)
    {
        mcp_asdf_config_t &config = settings.config;
        config.memory = some_memory();
        config.filter = some_filter();
        config.filter_period =
            random.one_in(2) ? 1 : std::max(1u, random.any_length(random.one_in(4) ? 32 : 5));
        settings.table = random.one_in(4) ? real : falling(2 + random.below(random.one_in(2) ? 6 : 126));
        config.table = settings.table.words;
        if (config.filter != MCP_ASDF_ADAPTIVE && random.one_in(2))
            config.table = nullptr;
    }

    /* Any falling numbers above 1. */
    Table falling(uint32_t q)
    {
        Table table;
        uint64_t k = (uint64_t(1) << 26) + 200 + random.any_length(32) % (two32 - (uint64_t(1) << 26) - 200);
        table.words[0] = 0x4D435400 + q;
        table.words[1] = 1 + random.below(3865470566);
        for (uint32_t m = 2; m <= q + 1; ++m) {
            uint64_t room = k - (uint64_t(1) << 26) - (q + 2 - m);
            k -= 1 + (random.one_in(8) ? random.word() : random.any_length(26)) % room;
            table.words[m] = u32(k);
        }
        table.seal(q);
        return table;
    }

    /* n for a t, of every kind that section 5 tells apart. */
    uint32_t some_n(uint32_t t, uint32_t b_hat)
    {
        uint32_t end = u32(uint64_t(b_hat) * t >> 32); /* where x_hat reaches an end */
        uint32_t n = random.among({0, random.near(0, t), random.near(t / 2, t), t / 2, random.near(end, t),
                                   u32(random.next() % (uint64_t(t) + 1))});
        return random.one_in(2) ? n : t - n;
    }

    /* The state of a new robot, or any state that the model's t, n and b_hat allow, often at an end of a
     * range. */
    Robust some_robust_state()
    {
        Robust robust;
        robust.initial_b_hat = model.b_hat;
        if (random.one_in(16))
            return robust;
        some_estimates(robust);
        some_votes(robust);
        if (random.one_in(8))
            return robust; /* before the filter has run */

        const uint32_t blacks = model.n;
        const uint32_t whites = model.t - model.n;
        robust.batch_n = random.among({0, blacks, random.any_length(31) % (blacks + 1)});
        robust.batch_t = robust.batch_n + random.among({0, whites, random.any_length(31) % (whites + 1)});
        if (robust.batch_t == 0)
            return robust;
        robust.dispersion = static_cast<uint16_t>(256 + random.any_length(16) % (65536 - 256));
        if (random.one_in(8))
            robust.dispersion = 65535;
        if (robust.filled_count() >= 5 && random.one_in(4))
            robust.initial_b_hat = some_b_hat();
        return robust;
    }

    /* Estimates around a point, of some or of all slots. */
    void some_estimates(Robust &robust)
    {
        robust.filled_slots = random.among({1, 0x80000000, 0x1F, 0x3F << 13, 0xFFFFFFFF, random.word(),
                                            random.word(), random.word() & random.word() & random.word()});
        int64_t middle = random.among({0, 0xFFFF, 0x8000, random.below(65536)});
        uint32_t width = random.any_length(17);
        for (uint32_t slot = 0; slot < MCP_ASDF_SLOTS; ++slot) {
            int64_t estimate = middle + random.below(2 * width + 1) - width;
            if (random.one_in(8))
                estimate = random.below(65536);
            if (robust.is_filled(slot))
                robust.estimates[slot] = static_cast<uint16_t>(std::clamp<int64_t>(estimate, 0, 0xFFFF));
        }
    }

    /* Votes, and a centre, a spread and a turn that these allow. */
    void some_votes(Robust &robust)
    {
        if (robust.filled_slots == 0 || random.one_in(16))
            return;
        const uint32_t votes = random.among({1 << 9, 63, 1, random.below(513)});
        robust.votes = static_cast<uint16_t>(std::max(1u, random.near(votes, 1 << 9)));
        robust.spread = random.near(random.one_in(2) ? 1 << 18 : 1 << 28, 1 << 28);
        if (random.one_in(2))
            robust.spread = random.any_length(28);
        robust.spread = std::max(robust.spread, uint32_t(1) << 18);
        robust.centre = random.near(random.one_in(2) ? 0 : 1 << 30, 1 << 30);
        if (random.one_in(4)) { /* so that a vote may be as far from the centre as the spread */
            robust.centre &= ~0x3FFFu;
            robust.spread &= ~0x3FFFu;
        }
        uint32_t slot = robust.first_filled_slot_from(random.below(32));
        robust.turn = slot == MCP_ASDF_SLOTS ? 0 : slot + 1;
    }

    /* Lets the robot's own estimate vote next, and makes it one of an earlier b_hat, which nothing but the
     * formats of x_hat and alpha restricts. The model has t > 0 and a filled slot. */
    void make_own_vote_stale()
    {
        Robust &robust = model.robust;
        robust.turn = static_cast<uint32_t>(bits(robust.filled_slots));
        robust.votes = std::max<uint16_t>(robust.votes, 1);
        model.updated = 1;
        model.local.x_hat = random.below(MCP_ASDF_ONE + 1);
        model.local.alpha = random.among({0, 0x100, 0x200, 0x1000000, 0x80000000, 0x80000001});
    }

    /* Gives the model, which has t > 0, an initial b_hat beside which the filter decides otherwise, if a few
     * tries find one. */
    void bring_to_the_threshold()
    {
        Robust &robust = model.robust;
        const TestedEstimates tested = robust.tested_estimates();
        auto is_recalibrated = [&](uint32_t initial_b_hat) {
            robust.initial_b_hat = initial_b_hat;
            return robust.rejects(tested, model.t, model.n) && !robust.is_supported(tested, model.t, model.n);
        };
        uint32_t ends[] = {robust.initial_b_hat, robust.initial_b_hat};
        for (uint32_t tries = 0; tries < 8 && is_recalibrated(ends[0]) == is_recalibrated(ends[1]); ++tries)
            ends[1] = some_b_hat();
        while (is_recalibrated(ends[0]) != is_recalibrated(ends[1]) &&
               distance_between(ends[0], ends[1]) > 1) {
            auto middle = u32((uint64_t(ends[0]) + ends[1]) / 2);
            ends[is_recalibrated(middle) == is_recalibrated(ends[1])] = middle;
        }
        robust.initial_b_hat = ends[random.below(2)];
    }

    /* A word nothing is known of, for alpha. */
    uint32_t some_alpha()
    {
        const uint32_t words[] = {random.word(),
                                  (random.word() | 0x80000000) & 0xFFFFFF1F,
                                  random.below(8) << 8 | (random.one_in(8) ? random.below(256) : 0),
                                  random.one_in(2) ? 0xFFFFFFFF : 0xFFFFFF1F,
                                  model.local.alpha,
                                  random.any_length(24) << 8 | random.below(12)};
        return words[random.one_in(4) ? random.below(6) : alphas];
    }

    uint32_t some_x_hat()
    {
        if (random.one_in(50))
            return random.one_in(2) ? random.word() : MCP_ASDF_ONE + random.below(3);
        if (random.one_in(8)) { /* as far from the centre as the spread */
            int64_t edge =
                int64_t(model.robust.centre) + (random.one_in(2) ? 1 : -1) * int64_t(model.robust.spread);
            return random.near(edge >> 7, MCP_ASDF_ONE);
        }
        int64_t x = int64_t(centre) + random.below(2 * uint64_t(spread) + 1) - spread;
        return static_cast<uint32_t>(std::clamp<int64_t>(x, 0, MCP_ASDF_ONE));
    }

    /* Where the next messages lie. */
    void some_centre()
    {
        uint32_t any = random.below(MCP_ASDF_ONE + 1);
        centre = random.among({model.local.x_hat, model.robust.centre >> 7,
                               random.near(MCP_ASDF_HALF, MCP_ASDF_ONE), random.one_in(2) ? 0 : MCP_ASDF_ONE,
                               MCP_ASDF_HALF + (random.one_in(2) ? 1024 : -1024u), /* G is nearly 2^20 */
                               any, any});
        spread = random.one_in(4) ? 0 : random.any_length(random.one_in(2) ? 3 : 23);
        alphas = random.below(6);
    }

    void do_observe(uint32_t odds)
    {
        static const uint32_t wrong[] = {2, 3, 255, 256, 257, 0x80000000, 0xFFFFFFFF};
        uint32_t z = random.one_in(100) ? wrong[random.below(7)] : random.below(256) < odds;
        auto as_enum = static_cast<mcp_asdf_observation_t>(z);
        if (random.one_in(4)) {
            note("step", z);
            mcp_asdf_status_t page = model.step(z);
            compare(page, mcp_asdf_step(&c, as_enum));
        } else {
            note("observe", z);
            mcp_asdf_status_t page = model.observe(z);
            compare(page, mcp_asdf_observe(&c, as_enum));
        }
    }

    void do_receive()
    {
        if (random.one_in(16))
            sender = random.below(256);
        else
            sender = random.one_in(4) ? random.below(128) : (sender + stride) % 128;
        uint32_t x_hat = some_x_hat();
        uint32_t alpha = some_alpha();
        note("receive", sender, x_hat, alpha);
        mcp_asdf_status_t page = model.receive(static_cast<uint8_t>(sender), x_hat, alpha);
        compare(page, mcp_asdf_receive(&c, static_cast<uint8_t>(sender), x_hat, alpha));
    }

    void do_settle()
    {
        note("settle");
        mcp_asdf_status_t page = model.settle();
        compare(page, mcp_asdf_settle(&c));
        some_centre();
    }

    /* Compares the words that both save; the C writes no byte beyond them. */
    std::vector<uint32_t> saved()
    {
        std::vector<uint32_t> page = model.save();
        const Image untouched = to_image({});
        Image in_c = untouched;
        mcp_asdf_save(&c, in_c.data());
        std::vector<uint32_t> words_in_c = Robot::to_words(in_c.data(), page.size());
        for (uint32_t i = 0; i < page.size(); ++i)
            if (page[i] != words_in_c[i]) {
                char what[32];
                std::snprintf(what, sizeof what, "word %" PRIu32 " of the image", i);
                differ(what, page[i], words_in_c[i]);
            }
        auto used = static_cast<std::ptrdiff_t>(4 * page.size());
        expect("rest of the image untouched", 1,
               std::equal(in_c.begin() + used, in_c.end(), untouched.begin() + used));
        expect("invariants_hold", 1, mcp_asdf_invariants_hold(&c));
        return page;
    }

    /* Bytes that no word fills hold anything. */
    static Image to_image(const std::vector<uint32_t> &words)
    {
        Image image{};
        image.fill(0xA5);
        for (std::size_t i = 0; i < 4 * words.size(); ++i)
            image[i] = static_cast<uint8_t>(words[i / 4] >> 8 * (i % 4));
        return image;
    }

    /* Both take an image; where they refuse it, both stay as they were. */
    void do_restore(const char *name, const std::vector<uint32_t> &words, uint32_t a = 0, uint32_t b = 0,
                    uint32_t d = 0)
    {
        note(name, a, b, d);
        const Image image = to_image(words);
        mcp_asdf_status_t page = model.restore(current->config, image);
        compare(page, mcp_asdf_restore(&c, &current->config, image.data()));
        restored += page == MCP_ASDF_OK;
    }

    /* An image with wrong words. */
    void do_damage()
    {
        std::vector<uint32_t> words = saved();
        uint32_t i = 0;
        uint32_t before = 0;
        do {
            i = random.below(words.size());
            before = words[i];
            words[i] = random.one_in(2) ? before ^ 1u << random.below(32) : random.any_length(32);
            if (random.one_in(8))
                words[i] = random.near(before, 0xFFFFFFFF);
        } while (random.one_in(4));
        if (!random.one_in(8))
            words.back() = checksum(words, words.size() - 1);
        do_restore("restore of a damaged image", words, i, before, words[i]);
        saved();
    }

    /* Breaks one rule of the robust filter's state, or just keeps it. */
    void make_doubtful(Robust &robust)
    {
        uint16_t over = random.one_in(2);
        uint32_t slot = random.below(MCP_ASDF_SLOTS);
        any_of({
            [&] { robust.centre = (1 << 30) + over; },
            [&] { robust.spread = (1 << 28) + over; },
            [&] { robust.spread = (1 << 18) - over; },
            [&] { robust.votes = static_cast<uint16_t>((1 << 9) + over); },
            [&] { robust.turn = random.among({32, 33, slot + 1, slot + 1 + 256}); },
            [&] { robust.initial_b_hat = MCP_ASDF_B_HAT_MIN - over; },
            [&] { robust.initial_b_hat = MCP_ASDF_B_HAT_MAX + over; },
            [&] { robust.initial_b_hat = model.b_hat + over; },
            [&] { robust.dispersion = static_cast<uint16_t>(256 - over); },
            [&] { robust.batch_n = robust.batch_t + over; },
            [&] { robust.batch_n = model.n + over, robust.batch_t = model.t; },
            [&] { robust.batch_n = 0, robust.batch_t = model.t - model.n + over; },
            [&] {
                robust.batch_n = robust.batch_t = 0, robust.dispersion = static_cast<uint16_t>(256 + over);
            },
            [&] { robust.batch_n = robust.batch_t = 0, robust.dispersion = 256; },
            [&] { robust.filled_slots = random.among({0, 0xF, 0x1F}) << over; },
            [&] { robust.filled_slots ^= uint32_t(1) << slot, robust.estimates[slot] = over; },
            [&] { /* four or five estimates, and another b_hat than the initial one */
                  robust.filled_slots = over == 0 ? 0xF : 0x1F;
                  for (uint32_t other = 4 + over; other < MCP_ASDF_SLOTS; ++other)
                      robust.estimates[other] = 0;
                  robust.turn = 0;
                  robust.initial_b_hat = model.b_hat ^ 0x10000;
            },
            [&] { robust.filled_slots = robust.votes = 0, robust.estimates = {}; },
            [&] { /* without votes, one member as no new robot has it */
                  robust.votes = 0;
                  robust.centre = uint32_t(1) << 29;
                  robust.spread = 1 << 28;
                  robust.turn = 0;
                  uint32_t *const members[] = {&robust.centre, &robust.spread, &robust.turn};
                  *members[random.below(3)] -= over;
            },
        });
    }

    /* A closed round whose mean or range is at its end, or beyond. */
    Round some_closed()
    {
        uint64_t alpha = random.among({0, 5, 511, 512}), most = MCP_ASDF_MAX_ID * units(0xFFFFFF1F), one = 1;
        const Round rounds[] = {{alpha, alpha * MCP_ASDF_ONE + random.below(2)},
                                {511 + random.below(2), random.below(2), 1},
                                {most + random.below(2), (one << 62) - random.below(2)},
                                {most, 0, MCP_ASDF_MAX_ID * 0x7FFFFF * (one << 23)},
                                {512, one << 32, UINT64_MAX}};
        return rounds[random.below(5)];
    }

    /* A robot that can nearly be: it breaks one rule, or just keeps it. */
    void do_doubtful()
    {
        Robot robot = model;
        Round &open = robot.open;
        if (robot.is_robust() && random.one_in(2))
            make_doubtful(robot.robust);
        any_of({
                   [&] { robot.t = random.near(current->config.memory, 0xFFFFFFFF); },
                   [&] { robot.t = robot.n = 0, robot.updated = static_cast<uint8_t>(random.below(3)); },
                   [&] {
                       robot.updated = 1;
                       robot.local.alpha = random.word() & random.among({0xFFFFFFFF, 0xFFFFFF1F, 0x7FFFFF01});
                   },
                   [&] { robot.filter_left = random.near(current->config.filter_period, 0xFFFFFFFF); },
                   [&] { robot.filter_left = random.below(2); },
                   [&] { robot.heard[robot.id / 32] ^= uint32_t(1) << robot.id % 32; },
                   [&] { open.m = random.near(open.m, 0xFFFFFFFF); },
                   [&] {
                       open = {128, 0, 0, 0, 0, 127 + random.below(2)};
                       robot.heard = {UINT32_MAX, UINT32_MAX, UINT32_MAX, UINT32_MAX};
                       robot.heard[robot.id / 32] ^= uint32_t(1) << robot.id % 32;
                   },
                   [&] { open.alpha = random.near(open.m, 256), open.low_x = open.high_x = 0; },
                   [&] { open.low_x = 0xFFFFFFFF * uint64_t(open.x) + random.below(2); },
                   [&] { open.high_x = 0x7FFFFF * uint64_t(open.x) + random.below(2); },
                   [&] { robot.closed = some_closed(); },
               },
               robot.is_robust() ? 7 : 12);
        if (robot.updated == 0)
            robot.local = form(robot.t, std::min(robot.n, robot.t), robot.b_hat);
        do_restore("restore of a doubtful robot", robot.save());
        saved();
    }

    /* Settings that may have a fault. */
    void some_hostile_settings(Settings &settings)
    {
        some_settings(settings);
        mcp_asdf_config_t &config = settings.config;
        if (random.one_in(2)) /* the own kind of filter */
            config.filter = current->config.filter;
        bool is_of_table = random.one_in(3);
        if (MCP_ASDF_WITH_ASDF && is_of_table) /* the only one that has a table */
            config.filter = MCP_ASDF_ADAPTIVE;
        if (is_of_table) {
            some_wrong_table(settings);
            return;
        }
        any_of({
            [&] { config.filter_period = random.below(2); },
            [&] { config.memory = random.near(random.one_in(2) ? 64 : int64_t(two31), 0xFFFFFFFF); },
            [&] { config.filter = static_cast<uint8_t>(random.below(random.one_in(2) ? 6 : 256)); },
            [] {},
        });
    }

    void some_wrong_table(Settings &settings)
    {
        uint32_t *words = settings.table.words;
        uint32_t q = words[0] - 0x4D435400;
        uint32_t word = random.below(q + 3);
        settings.config.table = random.one_in(16) ? nullptr : words;
        any_of({
            [&] { words[word] ^= 1u << random.below(32); },
            [&] { settings.table = falling(random.one_in(2) ? 1 : 128); },
            [&] {
                words[1] = random.near(random.one_in(2) ? 0 : 3865470566, 0xFFFFFFFF), settings.table.seal(q);
            },
            [&] { words[q + 1] = random.near(int64_t(1) << 26, 0xFFFFFFFF), settings.table.seal(q); },
            [&] { words[word] = random.near(words[word], 0xFFFFFFFF), settings.table.seal(q); },
        });
    }

    /* A new robot; where init fails, the old one stays. */
    void do_init(bool hostile)
    {
        uint32_t id = random.below(hostile && random.one_in(8) ? 256 : 128);
        uint32_t b_hat = some_b_hat();
        if (hostile)
            some_hostile_settings(*spare);
        else
            some_settings(*spare);
        if (hostile && random.one_in(8))
            b_hat = random.word() << (random.one_in(2) ? 0 : 20);
        note("init", id, b_hat, spare->config.memory);
        mcp_asdf_status_t page = model.init(spare->config, static_cast<uint8_t>(id), b_hat);
        compare(page, mcp_asdf_init(&c, &spare->config, static_cast<uint8_t>(id), b_hat));
        if (page == MCP_ASDF_OK)
            std::swap(current, spare);
        saved();
    }

    /* The robot moves to other settings, if they let it. */
    void do_move()
    {
        some_hostile_settings(*spare);
        const Image image = to_image(saved());
        note("restore with other settings", spare->config.memory, spare->config.filter_period);
        mcp_asdf_status_t page = model.restore(spare->config, image);
        compare(page, mcp_asdf_restore(&c, &spare->config, image.data()));
        if (page == MCP_ASDF_OK)
            std::swap(current, spare);
        saved();
    }

    /* The robot gets any age. */
    void do_age()
    {
        uint32_t memory = current->config.memory;
        model.t = random.one_in(3) ? memory - 1 - random.below(4) : random.below(memory);
        if (random.one_in(3))
            model.t = random.any_length(31) % memory;
        model.n = some_n(model.t, model.b_hat);
        model.local = form(model.t, model.n, model.b_hat);
        model.updated = 0;
        model.filter_left = 1 + random.word() % current->config.filter_period;
        if (model.is_robust())
            model.robust = some_robust_state();
        bool is_tested = model.robust.filled_count() >= 5 && model.robust.batch_t != 0 && random.one_in(2);
        if (is_tested) {
            bring_to_the_threshold();
            model.filter_left = 1;
        }
        bool is_stale = !is_tested && model.t != 0 && model.robust.filled_slots != 0 && random.one_in(4);
        if (is_stale)
            make_own_vote_stale();
        if (random.one_in(8))
            model.counters = {0xFFFF, 0xFFFF, 0xFFFF, 0xFFFF, 0xFFFF};
        do_restore("restore of an age", model.save());
        if (is_tested || is_stale)
            do_settle();
    }

    void live()
    {
        ++lives;
        do_init(false);
        if (random.one_in(2))
            do_age();
        some_centre();

        static const uint32_t lengths[] = {1, 3, 10, 40, 200, 1000};
        uint32_t length = lengths[random.below(6)];
        uint32_t odds = random.below(257);
        stride = random.one_in(4) ? 32 : 1;
        bool undisturbed = random.one_in(300); /* and so long that votes reach their limit */
        for (uint32_t left = undisturbed ? 4000 : 1 + random.below(400); same && calls < limit_ && left > 0;
             --left) {
            if (!undisturbed && random.one_in(24)) {
                any_of({[&] { note("save"), saved(); }, [&] { do_restore("restore", saved()); },
                        [&] { do_damage(); }, [&] { do_doubtful(); }, [&] { do_move(); },
                        [&] { do_init(true); }, [&] { do_age(); }, [&] { do_age(); }, [&] { do_age(); }});
            } else if (random.one_in(length)) {
                do_settle();
            } else if (random.one_in(4)) {
                do_observe(odds);
            } else {
                do_receive();
            }
        }
        if (same)
            saved();
    }
};
} // namespace

int main(int argc, char **argv)
{
    uint64_t seed = argc > 1 ? std::strtoull(argv[1], nullptr, 0) : 1;
    uint64_t limit = argc > 2 ? std::strtoull(argv[2], nullptr, 0) : 2000000;
    return Run(seed, limit).go() ? 0 : 1;
}
