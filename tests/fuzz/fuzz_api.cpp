/* Sequences of calls of the firmware, for the choices of four targets side by side with the model of
 * tests/third, which is written from docs/design.md alone: every status and reading is the same in all five.
 * Tables, settings, images and arguments are as hostile as the fuzzer likes. In a second mode memory is
 * damaged, and then only sanitizers look. */
#include "../third/model.hpp"
#include "input.h"
#include "variant.h"

#include <cstring>

extern "C" const uint32_t mcp_asdf_t_table_omega05_q30[33];

using namespace third;

namespace
{
const firmware_t *const targets[] = {&firmware_1001, &firmware_2100, &firmware_3010, &firmware_4000};
constexpr std::size_t count = sizeof targets / sizeof *targets;
constexpr uint32_t magic = 0x4D435400;

/* What lives from call to call: nothing is allocated. */
struct World {
    uint32_t words[131];
    mcp_asdf_config_t config;
    mcp_asdf_t robots[count];
    Robot model;
};

/* Words of a table: a real one, or any falling ones; then perhaps one of them is wrong, and the checksum
 * right again or not. */
void some_table(World &w, input_t *in)
{
    uint32_t kind = input_take(in, 1);
    std::memset(w.words, 0, sizeof w.words);
    if (kind & 1) {
        std::memcpy(w.words, mcp_asdf_t_table_omega05_q30, sizeof mcp_asdf_t_table_omega05_q30);
    } else {
        uint32_t q = 2 + (kind >> 1 & 7) * 17;
        uint32_t step = 1 + (input_take(in, 1) << 16);
        w.words[0] = magic + q;
        w.words[1] = 0x0CCCCCCD;
        for (uint32_t m = 2; m <= q + 1; ++m)
            w.words[m] = 0xFF000000 - (m - 1) * step;
        w.words[q + 2] = checksum(w.words, q + 2);
    }
    if (kind & 0x10) {
        w.words[input_take(in, 1) % 131] = kind & 0x20 ? input_word(in) : 1u << (input_take(in, 1) & 31);
        uint32_t q = w.words[0] - magic;
        if (kind & 0x40 && q <= 128)
            w.words[q + 2] = checksum(w.words, q + 2);
    }
}

void some_settings(World &w, input_t *in)
{
    uint32_t kind = input_take(in, 1);
    w.config.table = kind & 1 ? nullptr : w.words;
    w.config.filter_period = kind & 2 ? input_word(in) : 1 + (kind >> 6);
    w.config.memory = kind & 4 ? input_word(in) : kind & 8 ? MCP_ASDF_MEMORY_MAX : 64;
    w.config.filter = static_cast<uint8_t>(kind & 16 ? input_take(in, 1) : kind >> 5 & 2);
    if (!(kind & 17))
        some_table(w, in);
    else
        std::memcpy(w.words, mcp_asdf_t_table_omega05_q30, sizeof mcp_asdf_t_table_omega05_q30);
}

/* Every target does what the model does. */
template <typename Call> void all(World &w, mcp_asdf_status_t expected, Call call)
{
    for (std::size_t i = 0; i < count; ++i)
        MUST(call(*targets[i], &w.robots[i]) == expected);
}

Image image_of(World &w)
{
    Image image = w.model.save();
    for (std::size_t i = 0; i < count; ++i) {
        Image in_c;
        targets[i]->save(&w.robots[i], in_c.data());
        MUST(in_c == image);
        MUST(targets[i]->invariants_hold(&w.robots[i]));
    }
    return image;
}

void compare(const World &w)
{
    for (std::size_t i = 0; i < count; ++i) {
        const mcp_asdf_t &robot = w.robots[i];
        MUST(robot.x_hat == w.model.local.x_hat && robot.alpha == w.model.local.alpha);
        MUST(robot.accuracy.b_hat == w.model.b_hat);
        MUST(targets[i]->x(&robot) == w.model.x());
        MUST(targets[i]->x_bar(&robot) == w.model.x_bar());
    }
}

bool init(World &w, input_t *in)
{
    uint8_t id = static_cast<uint8_t>(input_take(in, 1));
    uint32_t b_hat = input_word(in);
    std::memset(w.robots, 0xA5, sizeof w.robots);
    mcp_asdf_status_t expected = w.model.init(w.config, id, b_hat);
    all(w, expected, [&](const firmware_t &c, mcp_asdf_t *r) { return c.init(r, &w.config, id, b_hat); });
    return expected == MCP_ASDF_OK;
}

/* An image with a few words of which any may be wrong, usually under a right checksum. */
void restore(World &w, input_t *in)
{
    auto words = Robot::to_words(image_of(w));
    uint32_t kind = input_take(in, 1);
    for (uint32_t left = kind & 3; left > 0; --left) {
        uint32_t &word = words[input_take(in, 1) % words.size()];
        word = kind & 4 ? input_word(in) : word ^ 1u << (input_take(in, 1) & 31);
    }
    if (!(kind & 8))
        words.back() = checksum(words, words.size() - 1);
    Image image{};
    for (uint32_t at = 0; at < image.size(); ++at)
        image[at] = static_cast<uint8_t>(words[at / 4] >> 8 * (at % 4));
    mcp_asdf_status_t expected = w.model.restore(w.config, image);
    all(w, expected,
        [&](const firmware_t &c, mcp_asdf_t *r) { return c.restore(r, &w.config, image.data()); });
}

/* Any age, by way of an image that is sound. */
void age(World &w, input_t *in)
{
    w.model.t = input_word(in) % w.config.memory;
    w.model.n = input_word(in) % (w.model.t + 1);
    w.model.local = form(w.model.t, w.model.n, w.model.b_hat);
    w.model.updated = 0;
    Image image = w.model.save();
    all(w, MCP_ASDF_OK,
        [&](const firmware_t &c, mcp_asdf_t *r) { return c.restore(r, &w.config, image.data()); });
}

uint32_t some_x_hat(input_t *in, const World &w)
{
    uint32_t kind = input_take(in, 1);
    if (kind < 64)
        return w.model.local.x_hat ^ (kind >> 3);
    return kind < 128   ? (kind & 31) << 18
           : kind < 192 ? MCP_ASDF_HALF + 1024 - (kind & 63) * 32
                        : input_word(in);
}

void receive(World &w, uint8_t sender, uint32_t x_hat, uint32_t alpha)
{
    mcp_asdf_status_t expected = w.model.receive(sender, x_hat, alpha);
    all(w, expected, [&](const firmware_t &c, mcp_asdf_t *r) { return c.receive(r, sender, x_hat, alpha); });
}

void one_call(World &w, input_t *in)
{
    uint32_t what = input_take(in, 1);
    uint32_t detail = what >> 3;
    switch (what & 7) {
    case 0:
    case 1: {
        uint32_t z = detail == 31 ? input_word(in) : detail & 1;
        mcp_asdf_status_t expected = what & 1 ? w.model.step(z) : w.model.observe(z);
        all(w, expected, [&](const firmware_t &c, mcp_asdf_t *r) {
            return (what & 1 ? c.step : c.observe)(r, static_cast<mcp_asdf_observation_t>(z));
        });
        break;
    }
    case 2: {
        mcp_asdf_status_t expected = w.model.settle();
        all(w, expected, [&](const firmware_t &c, mcp_asdf_t *r) { return c.settle(r); });
        break;
    }
    case 3:
        restore(w, in);
        break;
    case 4:
        age(w, in);
        break;
    case 5: {
        uint32_t x_hat = some_x_hat(in, w);
        uint32_t alpha = input_word(in);
        for (uint32_t sender = 0; sender < (detail == 31 ? 127 : detail / 2 + 2); ++sender)
            receive(w, static_cast<uint8_t>(sender), x_hat, alpha);
        return;
    }
    default: {
        uint8_t sender = static_cast<uint8_t>(input_take(in, 1));
        uint32_t x_hat = some_x_hat(in, w);
        receive(w, sender, x_hat, input_word(in));
        return; /* no reading has changed; sums show in the image */
    }
    }
    compare(w);
}

/* Any memory contents but for the pointer: each target by itself, as their meaningless results may differ. */
void damaged(World &w, input_t *in)
{
    input_t begin = *in;
    for (std::size_t i = 0; i < count; ++i) {
        const firmware_t &c = *targets[i];
        mcp_asdf_t *robot = &w.robots[i];
        Image image;
        *in = begin;
        while (in->left > 0) {
            uint32_t what = input_take(in, 1);
            uint32_t at = input_take(in, 1) % sizeof *robot;
            reinterpret_cast<uint8_t *>(robot)[at] ^= static_cast<uint8_t>(input_take(in, 1));
            robot->config = &w.config;
            switch (what & 7) {
            case 0:
                c.observe(robot, static_cast<mcp_asdf_observation_t>(what >> 3 & 3));
                break;
            case 1:
                c.step(robot, static_cast<mcp_asdf_observation_t>(what >> 3 & 3));
                break;
            case 2:
                c.settle(robot);
                break;
            case 3:
                c.save(robot, image.data());
                c.restore(robot, &w.config, image.data());
                break;
            case 4:
                c.x(robot), c.x_bar(robot), c.invariants_hold(robot);
                break;
            default:
                c.receive(robot, static_cast<uint8_t>(what >> 3), input_word(in), input_word(in));
            }
        }
    }
}
} // namespace

extern "C" int LLVMFuzzerTestOneInput(const uint8_t *data, std::size_t size)
{
    static World w;
    input_t in = {data, size};
    uint32_t mode = input_take(&in, 1);
    some_settings(w, &in);
    if (!init(w, &in))
        return 0;
    if (mode & 1) {
        damaged(w, &in);
        return 0;
    }
    while (in.left > 0)
        one_call(w, &in);
    image_of(w);
    return 0;
}
