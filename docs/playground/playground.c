/* The playground: runs trials of a swarm, and records the motion of one, for a page in a browser. The page
 * writes `settings` and reads the results from this module's memory (worker.js). Firmware, engine and arena
 * are compiled into the module as they are, so its bits are those of `mcp-asdf simulate`. */
#include "engine.h"
#include "philox.h"

#define MAX_ROBOTS 127
#define MAX_STEPS 10000
#define MAX_SAMPLES 1000 /* of the MAX_STEPS, in addition to step 0 */
#define MAX_PIXELS 512   /* along a side of the floor */
#define FILTER_PERIOD 1000
#define FULLY_CONNECTED 0 /* density that stands for robots at rest, all of which receive each other */
#define PI 3.14159265358979323846
#define X_UNIT 0x1p-23
#define MIN_ACCURACY 0x1p-20     /* of b_hat at the start; the largest is 1 - MIN_ACCURACY */
#define ARENA_STREAM UINT32_C(2) /* of random numbers, see world/philox.py */

/* Defaults of world/settings.py. */
#define SPEED 0.1414
#define RADIO_RANGE 0.7
#define TICK_SECONDS 0.1
#define TILE 0.01

/* Settings of a run, in the order in which worker.js writes them.
 *   fill_ratio     f, share of black tiles
 *   true_accuracy  b of every sensor
 *   flawed_b_hat   b_hat of flawed robots at the start; that of the others is b
 *   density        D, or FULLY_CONNECTED
 *   flawed         number of flawed robots, the first ones
 *   liars          number of liars, the last ones, who claim x_hat = 0 with alpha = 10^6
 *   interval       steps between samples */
typedef struct {
    double fill_ratio;
    double true_accuracy;
    double flawed_b_hat;
    double density;
    uint32_t seed;
    uint32_t robots;
    uint32_t flawed;
    uint32_t liars;
    uint32_t steps;
    uint32_t interval;
} settings_t;

/* Filters, in the order of worker.js. */
typedef enum { NO_FILTER, ASDF_MINUS, ASDF_PLUS, ROBUST_FILTER } filter_t;

extern const uint32_t mcp_asdf_t_table_omega05_q127[];

/* What the page writes and reads.
 *   records    [samples][robots] of the trial that was recorded last
 *   errors     [samples + 1] of the last trial: mean |x - f| of the robots that do not lie
 *   positions  [samples + 1][robots][x, y] of trial 0, in metres from the middle
 *   links      [samples + 1] bits i robots + j: whether robot i receives from j; each sample in whole bytes
 *   pixels     [rows][bytes] of the floor from the north, 1 for black, the first one in bit 7 */
settings_t settings;
mcp_asdf_record_t records[MAX_SAMPLES * MAX_ROBOTS];
double errors[MAX_SAMPLES + 1];
double positions[(MAX_SAMPLES + 1) * MAX_ROBOTS * 2];
uint8_t links[(MAX_SAMPLES + 1) * ((MAX_ROBOTS * MAX_ROBOTS + 7) / 8)];
uint8_t pixels[MAX_PIXELS * MAX_PIXELS / 8];

int run_trial(filter_t filter, uint32_t trial, bool is_recorded);
double arena_side(void);
uint32_t record_motion(void);

static mcp_asdf_t robots[MAX_ROBOTS];
static uint32_t x[MAX_ROBOTS * (MAX_STEPS + 1)];
static uint32_t b_hat[MAX_STEPS / FILTER_PERIOD * MAX_ROBOTS];
static mcp_asdf_arena_t arena;
static double memory[1 << 17]; /* 1 MiB for an engine or an arena, which are never needed at once */

/* Returns the side of the arena in metres, which follows from the density D = N pi r^2 / L^2. */
double arena_side(void)
{
    return RADIO_RANGE * __builtin_sqrt((double)settings.robots * PI / settings.density);
}

/* Returns the configuration of a trial's arena, with the seed that the tools give it. */
static mcp_asdf_arena_config_t arena_config(uint32_t trial)
{
    const philox_t random = philox((philox_t){{0, 0, trial, ARENA_STREAM}}, settings.seed, 0);
    return (mcp_asdf_arena_config_t){.seed = (uint64_t)random.word[1] << 32 | random.word[0],
                                     .robots = settings.robots,
                                     .width = arena_side(),
                                     .height = arena_side(),
                                     .speed = SPEED,
                                     .range = RADIO_RANGE,
                                     .tick = TICK_SECONDS,
                                     .tile = TILE,
                                     .fill_ratio = settings.fill_ratio};
}

/* Returns what the engine takes as `black`: in a fully connected swarm the probability to observe black; in
 * an arena, where the tile decides, that to observe its colour correctly. */
static uint32_t black_probability(void)
{
    const double f = settings.fill_ratio;
    const double b = settings.true_accuracy;
    const double probability = settings.density == FULLY_CONNECTED ? f * b + (1 - f) * (1 - b) : b;
    return (uint32_t)__builtin_rint(probability * MCP_ASDF_ENGINE_CERTAIN);
}

/* Returns b_hat at the start, in units of 2^-32. */
static uint32_t initial_b_hat(bool is_flawed)
{
    double accuracy = is_flawed ? settings.flawed_b_hat : settings.true_accuracy;
    if (accuracy < MIN_ACCURACY) {
        accuracy = MIN_ACCURACY;
    }
    if (accuracy > 1 - MIN_ACCURACY) {
        accuracy = 1 - MIN_ACCURACY;
    }
    return (uint32_t)__builtin_rint(accuracy * 0x1p32);
}

/* Compute the errors of the trial that has just run. If its x has one column, that is all robots' x. */
static void compute_errors(uint32_t columns)
{
    const uint32_t honest_robots = settings.robots - settings.liars;
    const size_t column_length = (size_t)settings.steps + 1;
    for (uint32_t step = 0; step <= settings.steps; step += settings.interval) {
        double sum = 0;
        for (uint32_t robot = 0; robot < honest_robots; ++robot) {
            const size_t column_start = columns == 1 ? 0 : robot * column_length;
            const double estimate = x[column_start + step] * X_UNIT;
            sum += __builtin_fabs(estimate - settings.fill_ratio);
        }
        errors[step / settings.interval] = sum / honest_robots;
    }
}

/* Run a trial, compute its errors and, if it is recorded, store its records. Returns the status. */
int run_trial(filter_t filter, uint32_t trial, bool is_recorded)
{
    const mcp_asdf_config_t filter_off = {mcp_asdf_t_table_omega05_q127, FILTER_PERIOD, MCP_ASDF_MEMORY_MAX,
                                          MCP_ASDF_OFF};
    mcp_asdf_config_t filter_on = filter_off;
    filter_on.filter = filter == ROBUST_FILTER ? MCP_ASDF_ROBUST : MCP_ASDF_ADAPTIVE;
    const mcp_asdf_config_t *configs[MAX_ROBOTS];
    uint32_t initial_b_hats[MAX_ROBOTS];
    for (uint32_t robot = 0; robot < settings.robots; ++robot) {
        const bool is_flawed = robot < settings.flawed;
        const bool is_filtering = filter != NO_FILTER && (filter != ASDF_MINUS || is_flawed);
        configs[robot] = is_filtering ? &filter_on : &filter_off;
        initial_b_hats[robot] = initial_b_hat(is_flawed);
    }
    const mcp_asdf_arena_config_t world = arena_config(trial);
    const uint32_t black = black_probability();
    const mcp_asdf_experiment_t experiment = {.seed = settings.seed,
                                              .first_trial = trial,
                                              .trials = 1,
                                              .robots = settings.robots,
                                              .steps = settings.steps,
                                              .configs = configs,
                                              .comms_period = 1,
                                              .b_hat = initial_b_hats,
                                              .black = &black,
                                              .sampling_interval = is_recorded ? settings.interval : 0,
                                              .observation_period = 1,
                                              .arenas = settings.density == FULLY_CONNECTED ? NULL : &world,
                                              .liars = settings.liars,
                                              /* x_hat 0, and 10^6 as an alpha word: mantissa above shift */
                                              .lie = {0, (UINT32_C(16000000) << 8) | 20}};
    const mcp_asdf_outcome_t outcome = {robots, x, b_hat, records};
    if (mcp_asdf_engine_bytes(&experiment) > sizeof memory) {
        return MCP_ASDF_ERR_CONFIG;
    }
    const mcp_asdf_status_t status = mcp_asdf_engine_run(&experiment, false, &outcome, memory);
    compute_errors(mcp_asdf_engine_columns(&experiment));
    return status;
}

/* Set the bit that says that a robot receives from another. */
static void set_link(uint8_t *bits, uint32_t receiver, uint32_t sender)
{
    const uint32_t bit = receiver * settings.robots + sender;
    bits[bit / 8] |= (uint8_t)(1U << (bit % 8));
}

/* Record links and positions of the arena's present state. */
static void record_arena(uint32_t sample)
{
    const uint32_t count = settings.robots;
    const size_t bytes_per_sample = (count * count + 7) / 8;
    uint8_t *const bits = links + sample * bytes_per_sample;
    for (uint32_t index = 0; index < arena.link_count; ++index) {
        const uint32_t a = arena.links[index].a;
        const uint32_t b = arena.links[index].b;
        set_link(bits, a, b);
        set_link(bits, b, a);
    }
    double *const sample_positions = positions + (size_t)sample * count * 2;
    for (uint32_t robot = 0; robot < count; ++robot) {
        sample_positions[2 * robot] = arena.x[robot];
        sample_positions[2 * robot + 1] = arena.y[robot];
    }
}

/* Record the colour in the middle of each of size x size pixels of the arena's floor. */
static void record_floor(uint32_t size, double side)
{
    for (uint32_t index = 0; index < size * size; ++index) {
        const uint32_t row = index / size;
        const uint32_t column = index % size;
        const double east = (column + 0.5) / size - 0.5;
        const double north = 0.5 - (row + 0.5) / size;
        const int is_black = mcp_asdf_arena_is_black(&arena, east * side, north * side);
        pixels[index / 8] =
            (uint8_t)(pixels[index / 8] << 1 | is_black); /* the first of eight ends in bit 7 */
    }
}

/* Record motion and floor of trial 0, where robots move. Returns how many pixels a side of the floor has. */
uint32_t record_motion(void)
{
    const mcp_asdf_arena_config_t config = arena_config(0);
    const double tiles = config.width / TILE;
    uint32_t size = tiles < MAX_PIXELS ? (uint32_t)tiles : MAX_PIXELS;
    size = size / 8 * 8; /* rows of whole bytes */
    for (size_t i = 0; i < sizeof links; ++i) {
        links[i] = 0;
    }
    (void)mcp_asdf_arena_init(&arena, &config, memory); /* an arena needs less memory than its engine has */
    record_floor(size, config.width);
    record_arena(0);
    for (uint32_t step = 1; step <= settings.steps; ++step) {
        mcp_asdf_arena_step(&arena, 1);
        if (step % settings.interval == 0) {
            record_arena(step / settings.interval);
        }
    }
    return size;
}
