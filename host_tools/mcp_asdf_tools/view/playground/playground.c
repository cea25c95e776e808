/* The playground: trials of a swarm, and the motion of one, for a page in a browser, which writes `settings`
 * and reads what comes out from this module's memory (view/page/worker.js). Firmware, engine and arena are
 * compiled into it as they are, so its bits are those of `mcp-asdf simulate`. */
#include "engine.h"
#include "philox.h"

#define MAX_ROBOTS 127
#define MAX_STEPS 10000
#define MAX_SAMPLES 1000 /* of the MAX_STEPS, beside step 0 */
#define MAX_PIXELS 512   /* along a side of the floor */
#define FILTER_PERIOD 1000
#define ALL 0        /* density at which robots stand still and everybody hears everybody */
#define SPEED 0.1414 /* defaults of world/settings.py */
#define RADIO_RANGE 0.7
#define TICK 0.1
#define TILE 0.01
#define PI 3.14159265358979323846
#define LEAST_ACCURACY 0x1p-20

/* Of a run.
 *   fill_ratio, accuracy  f, and b of every sensor
 *   wrong         b_hat of flawed robots at the start; the others begin with b
 *   density       D, or ALL
 *   flawed        number of flawed robots, the first ones
 *   liars         number of liars, the last ones, who claim x = 0 with alpha = 10^6
 *   interval      steps between samples */
typedef struct {
    double fill_ratio;
    double accuracy;
    double wrong;
    double density;
    uint32_t seed;
    uint32_t robots;
    uint32_t flawed;
    uint32_t liars;
    uint32_t steps;
    uint32_t interval;
} settings_t;

typedef enum { NONE, ASDF_MINUS, ASDF_PLUS, ROBUST } filtering_t;

extern const uint32_t mcp_asdf_t_table_omega05_q127[];

/* What the page writes and reads.
 *   records    [samples][robots] of the trial that was recorded last
 *   errors     [samples + 1] of the last trial: mean |x - f| of the robots that do not lie
 *   positions  [samples + 1][robots][x, y] of trial 0
 *   links      [samples + 1] bits i robots + j: robot i hears j; each sample in whole bytes
 *   pixels     [rows][bytes] of the floor from the north, 1 for black, the first one in bit 7 */
settings_t settings;
mcp_asdf_record_t records[MAX_SAMPLES * MAX_ROBOTS];
double errors[MAX_SAMPLES + 1];
double positions[(MAX_SAMPLES + 1) * MAX_ROBOTS * 2];
uint8_t links[(MAX_SAMPLES + 1) * ((MAX_ROBOTS * MAX_ROBOTS + 7) / 8)];
uint8_t pixels[MAX_PIXELS * MAX_PIXELS / 8];

int run(filtering_t filtering, uint32_t trial, bool is_recorded);
double side(void);
uint32_t film(void);

static mcp_asdf_t robots[MAX_ROBOTS];
static uint32_t x[MAX_ROBOTS * (MAX_STEPS + 1)];
static uint32_t b_hat[MAX_STEPS / FILTER_PERIOD * MAX_ROBOTS];
static mcp_asdf_arena_t arena;
static double memory[1 << 17]; /* of an engine or an arena: 1 MiB */

/* Side of the arena in metres. */
double side(void) { return RADIO_RANGE * __builtin_sqrt((double)settings.robots * PI / settings.density); }

static mcp_asdf_arena_config_t arena_of(uint32_t trial)
{
    const philox_t world = philox((philox_t){{0, 0, trial, 2}}, settings.seed, 0);
    return (mcp_asdf_arena_config_t){.seed = (uint64_t)world.word[1] << 32 | world.word[0],
                                     .robots = settings.robots,
                                     .width = side(),
                                     .height = side(),
                                     .speed = SPEED,
                                     .range = RADIO_RANGE,
                                     .tick = TICK,
                                     .tile = TILE,
                                     .fill_ratio = settings.fill_ratio};
}

/* Probability to observe black, as world/sensors.py has it. */
static uint32_t black_probability(void)
{
    const double f = settings.fill_ratio, b = settings.accuracy;
    const double p = settings.density == ALL ? f * b + (1 - f) * (1 - b) : b;
    return (uint32_t)__builtin_rint(p * MCP_ASDF_ENGINE_CERTAIN);
}

static uint32_t b_hat_at_start(bool is_flawed)
{
    double b = is_flawed ? settings.wrong : settings.accuracy;
    b = b < LEAST_ACCURACY ? LEAST_ACCURACY : b;
    return (uint32_t)__builtin_rint((b > 1 - LEAST_ACCURACY ? 1 - LEAST_ACCURACY : b) * 0x1p32);
}

static void measure(uint32_t columns)
{
    const uint32_t honest = settings.robots - settings.liars;
    const size_t length = (size_t)settings.steps + 1;
    for (uint32_t step = 0; step <= settings.steps; step += settings.interval) {
        double sum = 0;
        for (uint32_t j = 0; j < honest; ++j) {
            const double estimate = x[(columns == 1 ? 0 : j * length) + step] * 0x1p-23;
            sum += __builtin_fabs(estimate - settings.fill_ratio);
        }
        errors[step / settings.interval] = sum / honest;
    }
}

/* Run a trial for its errors and, if asked for, its records; returns the firmware's status. */
int run(filtering_t filtering, uint32_t trial, bool is_recorded)
{
    const mcp_asdf_config_t off = {mcp_asdf_t_table_omega05_q127, FILTER_PERIOD, MCP_ASDF_MEMORY_MAX,
                                   MCP_ASDF_OFF};
    mcp_asdf_config_t on = off;
    on.filter = filtering == ROBUST ? MCP_ASDF_ROBUST : MCP_ASDF_ADAPTIVE;
    const mcp_asdf_config_t *configs[MAX_ROBOTS];
    uint32_t starts[MAX_ROBOTS];
    for (uint32_t j = 0; j < settings.robots; ++j) {
        const bool is_flawed = j < settings.flawed;
        configs[j] = filtering == NONE || (filtering == ASDF_MINUS && !is_flawed) ? &off : &on;
        starts[j] = b_hat_at_start(is_flawed);
    }
    const mcp_asdf_arena_config_t world = arena_of(trial);
    const uint32_t black = black_probability();
    const mcp_asdf_experiment_t experiment = {.seed = settings.seed,
                                              .first_trial = trial,
                                              .trials = 1,
                                              .robots = settings.robots,
                                              .steps = settings.steps,
                                              .configs = configs,
                                              .comms_period = 1,
                                              .b_hat = starts,
                                              .black = &black,
                                              .sampling_interval = is_recorded ? settings.interval : 0,
                                              .observation_period = 1,
                                              .arenas = settings.density == ALL ? NULL : &world,
                                              .liars = settings.liars,
                                              .lie = {0, UINT32_C(16000000) << 8 | 20}};
    const mcp_asdf_outcome_t outcome = {robots, x, b_hat, records};
    if (mcp_asdf_engine_bytes(&experiment) > sizeof memory) {
        return MCP_ASDF_ERR_CONFIG;
    }
    const mcp_asdf_status_t status = mcp_asdf_engine_run(&experiment, false, &outcome, memory);
    measure(mcp_asdf_engine_columns(&experiment));
    return status;
}

static void keep(uint32_t sample)
{
    const uint32_t count = settings.robots;
    uint8_t *const bits = links + (size_t)sample * ((count * count + 7) / 8);
    for (uint32_t p = 0; p < arena.link_count; ++p) {
        const uint32_t a = arena.links[p].a, b = arena.links[p].b;
        bits[(a * count + b) / 8] |= (uint8_t)(1U << (a * count + b) % 8);
        bits[(b * count + a) / 8] |= (uint8_t)(1U << (b * count + a) % 8);
    }
    for (uint32_t j = 0; j < count; ++j) {
        positions[2 * ((size_t)sample * count + j)] = arena.x[j];
        positions[2 * ((size_t)sample * count + j) + 1] = arena.y[j];
    }
}

/* Film the motion of trial 0, and its floor; returns how many pixels a side has. Only where robots move. */
uint32_t film(void)
{
    const mcp_asdf_arena_config_t config = arena_of(0);
    const double wanted = config.width / TILE;
    const uint32_t size = (wanted < MAX_PIXELS ? (uint32_t)wanted : MAX_PIXELS) / 8 * 8;
    for (size_t i = 0; i < sizeof links; ++i) {
        links[i] = 0;
    }
    (void)mcp_asdf_arena_init(&arena, &config, memory); /* which is less than its engine has */
    for (uint32_t i = 0; i < size * size; ++i) {
        const uint32_t row = i / size, column = i % size;
        const double across = (column + 0.5) / size - 0.5, up = 0.5 - (row + 0.5) / size;
        const int black = mcp_asdf_arena_is_black(&arena, across * config.width, up * config.height);
        pixels[i / 8] = (uint8_t)(pixels[i / 8] << 1 | black);
    }
    keep(0);
    for (uint32_t step = 1; step <= settings.steps; ++step) {
        mcp_asdf_arena_step(&arena, 1);
        if (step % settings.interval == 0) {
            keep(step / settings.interval);
        }
    }
    return size;
}
