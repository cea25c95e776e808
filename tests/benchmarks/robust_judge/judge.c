/* Trials of the project's integer core (linked in) in the project's own arena. All filters of a call meet the
 * same worlds: what they observe, lose, and when they restart depends on seed, world and trial alone.
 *
 *   judge key=value ... filter=none filter=minus filter=robust
 *
 * Prints one JSON object on one line: for each filter, an object of lists with one number for each trial. */
#include <math.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "arena.h"
#include "mcp_asdf.h"

/* Centre and spread of the estimates a robot with the robust filter received, Q30: a clever liar's view. */
#define CENTRE(robot) ((robot)->robust.centre)
#define SPREAD(robot) ((robot)->robust.spread)

extern const uint32_t mcp_asdf_t_table_omega05_q30[];

#define MAX_ROBOTS 1024
#define MAX_TRIALS 256
#define ALPHA_LARGEST UINT32_C(0xFFFFFF1F)
#define FAR_OFF 0.05
#define TILE .01
#define READING_STEPS 20 /* from one reading of x and b_hat to the next */

/* ---- Settings ---- */

typedef struct {
    const char *name;
    double value;
} setting_t;

static setting_t settings[] = {
    {"seed", 1},      {"world", 0},  {"trials", 12},           {"N", 20}, /* robots */
    {"top", 1}, /* 0: all hear all, 1: moving, 2: ring with 4 neighbours, 3: grid of 4 x 5 */
    {"steps", 20000}, {"tau", 1000}, {"memory", 2147483648.0}, {"f", .55}, /* fill ratio */
    {"f2", -1},                     /* fill ratio from half time on; -1: none */
    {"b", .95},                     /* accuracy of all sensors, and b_hat of sound robots */
    {"fb", .55},                    /* b_hat of flawed robots */
    {"share", .3},                  /* of flawed robots */
    {"cluster", 0},                 /* 1: flawed robots are side by side */
    {"D", 1},                       /* density of moving robots */
    {"speed", .1414}, {"loss", 0},  /* probability that a message is lost */
    {"hrate", 1},                   /* probability that a sound robot sends in a step */
    {"hper", 0},                    /* sound robots send once in so many steps; 0: in every one */
    {"liars", 0},     {"strat", 0}, /* 0: liars say 0, 1: they say r + dir s */
    {"dir", -1},      {"evict", 0}, /* 1: each liar's id is a sound robot's plus 32, and its messages come
                                       last */
    {"restart", 0},                 /* probability that a robot restarts in a step; its tau counts anew */
    {"age", 0},                     /* sensors age, 1: all alike, 2: each in its own way */
    {"death", 0},                   /* at half time die, 1: a flawed and a sound robot, 2: all flawed ones */
    {"ids", 0},                     /* 1: ids are 0 .. N/2-1 and 32 .. 32+N/2-1 */
};

static double get(const char *name)
{
    for (size_t i = 0; i < sizeof settings / sizeof *settings; ++i) {
        if (strcmp(settings[i].name, name) == 0) {
            return settings[i].value;
        }
    }
    fprintf(stderr, "no setting %s\n", name);
    exit(2);
}

static void set(const char *name, double value)
{
    (void)get(name);
    for (size_t i = 0; i < sizeof settings / sizeof *settings; ++i) {
        if (strcmp(settings[i].name, name) == 0) {
            settings[i].value = value;
        }
    }
}

/* ---- Random numbers: one stream for each purpose ---- */

typedef struct {
    uint64_t state;
} stream_t;
enum { ROLES, ARENA, FLOOR, SENSOR, AGEING, RESTARTS, ORDER, SENDING, LOSSES };

static inline uint64_t mixed(uint64_t z)
{
    z = (z ^ (z >> 30)) * 0xBF58476D1CE4E5B9U;
    z = (z ^ (z >> 27)) * 0x94D049BB133111EBU;
    return z ^ (z >> 31);
}
static inline uint64_t draw(stream_t *s) { return mixed(s->state += 0x9E3779B97F4A7C15U); }
static inline double uniform(stream_t *s) { return (double)(draw(s) >> 11) * 0x1p-53; }
static double normal(stream_t *s)
{
    const double u = 1 - uniform(s), v = uniform(s);
    return sqrt(-2 * log(u)) * cos(2 * M_PI * v);
}
static stream_t open_stream(uint64_t seed, uint64_t world, int trial, uint64_t purpose)
{
    const uint64_t a = mixed(seed + 0x9E3779B97F4A7C15U), b = mixed(a ^ (world + 0x632BE59BD9B4E019U));
    return (stream_t){
        mixed(mixed(b ^ ((uint64_t)trial * 0xD1342543DE82EF95U + 1)) ^ (purpose * 0x2545F4914F6CDD1DU + 7))};
}

/* ---- A world ---- */

static int N, top, liars;
static long T, tau, readings; /* readings: of x, one in READING_STEPS steps */
static double f, f2, b, fb, share, loss;

static uint8_t *black;     /* [T][N] what the sensors show */
static float *accuracies;  /* [readings][N] true ones */
static size_t *first_link; /* [T + 1] */
static mcp_asdf_pair_t *links;
static size_t link_room;
static uint8_t is_flawed[MAX_ROBOTS], is_liar[MAX_ROBOTS], dies[MAX_ROBOTS], ids[MAX_ROBOTS];
static double b0_of[MAX_ROBOTS];

static void add_link(size_t index, int a, int c)
{
    if (index >= link_room) {
        link_room = 2 * link_room + 1024;
        links = realloc(links, link_room * sizeof *links);
    }
    links[index] = (mcp_asdf_pair_t){(uint16_t)a, (uint16_t)c};
}

static void assign_roles(uint64_t seed, uint64_t world, int trial)
{
    stream_t s = open_stream(seed, world, trial, ROLES);
    const int flawed = (int)floor(share * N + .5), evict = get("evict") != 0, death = (int)get("death");
    const int shuffled = evict ? N - liars : N;
    int rank[MAX_ROBOTS];
    for (int i = 0; i < N; ++i) {
        rank[i] = i;
    }
    if (get("cluster") == 0) {
        for (int i = shuffled - 1; i > 0; --i) {
            const int j = (int)(draw(&s) % (unsigned)(i + 1)), kept = rank[i];
            rank[i] = rank[j];
            rank[j] = kept;
        }
    }
    int dead_flawed = 0, dead_sound = 0;
    for (int i = 0; i < N; ++i) {
        is_liar[i] = rank[i] >= N - liars;
        is_flawed[i] = !is_liar[i] && rank[i] < flawed;
        b0_of[i] = is_flawed[i] ? fb : b;
        ids[i] = (uint8_t)(i % 128);
        if (get("ids") != 0 && i >= N / 2) {
            ids[i] = (uint8_t)(32 + i - N / 2);
        }
        dies[i] = 0;
        if (is_flawed[i]) {
            dies[i] = death == 2 || (death == 1 && dead_flawed++ == 0);
        } else if (!is_liar[i]) {
            dies[i] = death == 1 && dead_sound++ == 0;
        }
    }
    if (evict) {
        int victim = 0;
        for (int i = N - liars; i < N; ++i, ++victim) {
            while (is_flawed[victim]) {
                ++victim;
            }
            ids[i] = (uint8_t)(32 + ids[victim]);
        }
    }
}

static void build_graph(void)
{
    size_t count = 0;
    for (int i = 0; top == 0 && i < N; ++i) {
        for (int j = i + 1; j < N; ++j) {
            add_link(count++, i, j);
        }
    }
    for (int i = 0; top == 2 && i < N; ++i) {
        add_link(count++, i, (i + 1) % N);
        add_link(count++, i, (i + 2) % N);
    }
    for (int i = 0; top == 3 && i < N; ++i) {
        if (i % 5 < 4) {
            add_link(count++, i, i + 1);
        }
        if (i + 5 < N) {
            add_link(count++, i, i + 5);
        }
    }
    for (long t = 0; t <= T; ++t) {
        first_link[t] = t == 0 ? 0 : count; /* graphs have the same links in every step: see run_filter */
    }
}

static void move_robots(uint64_t seed, uint64_t world, int trial)
{
    stream_t s = open_stream(seed, world, trial, ARENA);
    mcp_asdf_arena_config_t config = {.seed = draw(&s),
                                      .robots = (uint32_t)N,
                                      .speed = get("speed"),
                                      .range = .7,
                                      .tick = .1,
                                      .tile = TILE,
                                      .fill_ratio = f};
    config.width = config.height = .7 * sqrt(N * M_PI / get("D"));
    mcp_asdf_arena_t arena;
    memset(&arena, 0, sizeof arena);
    void *memory = malloc(mcp_asdf_arena_bytes(&config) + 64);
    if (!mcp_asdf_arena_init(&arena, &config, memory)) {
        fprintf(stderr, "no room for the robots\n");
        exit(2);
    }
    size_t count = 0;
    for (long t = 0; t < T; ++t) {
        if (f2 >= 0 && t == T / 2) {
            arena.black_limit = arena.black_limit / f * f2;
        }
        mcp_asdf_arena_step(&arena, 1);
        first_link[t] = count;
        for (uint32_t l = 0; l < arena.link_count; ++l) {
            add_link(count++, arena.links[l].a, arena.links[l].b);
        }
        memcpy(black + t * N, arena.black, (size_t)N);
    }
    first_link[T] = count;
    free(memory);
}

static void make_world(uint64_t seed, uint64_t world, int trial)
{
    assign_roles(seed, world, trial);
    if (top == 1) {
        move_robots(seed, world, trial);
    } else {
        build_graph();
        stream_t s = open_stream(seed, world, trial, FLOOR);
        for (long t = 0; t < T; ++t) {
            for (int i = 0; i < N; ++i) {
                black[t * N + i] = uniform(&s) < (f2 >= 0 && t >= T / 2 ? f2 : f);
            }
        }
    }
    stream_t sensor = open_stream(seed, world, trial, SENSOR),
             ageing = open_stream(seed, world, trial, AGEING);
    static double wandered[MAX_ROBOTS];
    memset(wandered, 0, sizeof wandered);
    const int age = (int)get("age");
    for (long t = 0; t < T; ++t) {
        for (int i = 0; i < N; ++i) {
            double change = 0;
            if (age == 1) {
                change = -1e-5 * (double)t;
            } else if (age == 2) {
                wandered[i] += t > 0 ? .001 * normal(&ageing) : 0;
                change = wandered[i];
            }
            const double accuracy = age == 0 ? b : fmin(1, fmax(.5, b + change));
            black[t * N + i] ^= uniform(&sensor) >= accuracy;
            if (t % READING_STEPS == 0) {
                accuracies[t / READING_STEPS * N + i] = (float)accuracy;
            }
        }
    }
}

/* ---- A run of one filter in it ---- */

typedef struct {
    double error, score, harmed, unfixed;
} result_t;

static mcp_asdf_t robots[MAX_ROBOTS];
static mcp_asdf_config_t config_filter, config_off;
static float *series; /* [N][readings] of x */

static uint32_t q32(double p) { return (uint32_t)llround(p * 4294967296.0); }

static void deliver(int from, int to, uint32_t x_hat, uint32_t alpha)
{
    mcp_asdf_t *const robot = &robots[to];
    if (N <= 128) {
        (void)mcp_asdf_receive(robot, ids[from], x_hat, alpha);
        return;
    }
    const uint8_t own = robot->id; /* ids repeat: as the project's engine does */
    robot->heard.all[0] = robot->heard.all[1] = 0;
    robot->id = ids[from] ^ 1;
    (void)mcp_asdf_receive(robot, ids[from], x_hat, alpha);
    robot->id = own;
}

static uint32_t lie_of(int i, int is_robust)
{
    double x = 0;
    if (get("strat") == 1) {
        const double centre = is_robust ? CENTRE(&robots[i]) * 0x1p-30 : .5;
        const double spread = is_robust ? SPREAD(&robots[i]) * 0x1p-30 : .25;
        x = centre + get("dir") * spread;
    }
    return (uint32_t)llround(fmin(1, fmax(0, x)) * 0x1p23);
}

static int compare(const void *a, const void *c)
{
    const double x = *(const double *)a, y = *(const double *)c;
    return (x > y) - (x < y);
}

static double quantile(const double *values, int count, double share_below)
{
    static double sorted[MAX_ROBOTS];
    memcpy(sorted, values, (size_t)count * sizeof *sorted);
    qsort(sorted, (size_t)count, sizeof *sorted, compare);
    const double place = share_below * (count - 1);
    const int low = (int)place;
    return low + 1 < count ? sorted[low] + (place - low) * (sorted[low + 1] - sorted[low]) : sorted[low];
}

/* The paper's score H, of x read every READING_STEPS steps. Its quartiles are interpolated between two
 * robots, where the tools' score takes the middle of both. */
static double score(double fill)
{
    static double settled[MAX_ROBOTS], errors[MAX_ROBOTS];
    int count = 0;
    double mean_settled = 0, mean_error = 0;
    for (int i = 0; i < N; ++i) {
        if (is_liar[i] || dies[i]) {
            continue;
        }
        const float *x = series + (size_t)i * (size_t)readings;
        double low = 1e9, high = -1e9, error = 0;
        long k = readings - 1;
        for (long z = readings - 1; z >= 0; --z) {
            const double value = (double)x[z];
            low = fmin(low, value);
            high = fmax(high, value);
            if (high - low >= .02) {
                break;
            }
            if (high - value < .01 && value - low < .01) {
                k = z;
            }
        }
        for (long z = k; z < readings; ++z) {
            error += fabs((double)x[z] - fill);
        }
        settled[count] = (double)k * READING_STEPS;
        errors[count] = error / (double)(readings - k);
        mean_settled += settled[count];
        mean_error += errors[count];
        ++count;
    }
    mean_settled /= count;
    mean_error /= count;
    const double settled_range = quantile(settled, count, .75) - quantile(settled, count, .25);
    const double error_range = quantile(errors, count, .75) - quantile(errors, count, .25);
    return 50 * ((1 - mean_settled / (double)T) * exp(-settled_range / (double)T) +
                 (1 - mean_error / .45) * exp(-error_range / .45));
}

static void start_robot(int i, const mcp_asdf_config_t *config)
{
    const mcp_asdf_status_t status = mcp_asdf_init(&robots[i], config, ids[i], q32(b0_of[i]));
    if (status != MCP_ASDF_OK) {
        fprintf(stderr, "init: status %d\n", status);
        exit(2);
    }
}

static result_t run_filter(const char *filter, uint64_t seed, uint64_t world, int trial)
{
    const int is_robust = strcmp(filter, "robust") == 0, is_minus = strcmp(filter, "minus") == 0;
    const double restart = get("restart"), hrate = get("hrate");
    const int evict = get("evict") != 0, has_deaths = get("death") != 0;
    const long hper = (long)get("hper");
    const uint32_t memory = (uint32_t)get("memory");
    config_filter = (mcp_asdf_config_t){mcp_asdf_t_table_omega05_q30, (uint32_t)tau, memory,
                                        is_robust ? MCP_ASDF_ROBUST : MCP_ASDF_ADAPTIVE};
    config_off = (mcp_asdf_config_t){NULL, (uint32_t)tau, memory, MCP_ASDF_OFF};
    const mcp_asdf_config_t *configs[MAX_ROBOTS];
    for (int i = 0; i < N; ++i) {
        configs[i] = is_robust || (is_minus && is_flawed[i]) ? &config_filter : &config_off;
        start_robot(i, configs[i]);
    }
    stream_t restarts = open_stream(seed, world, trial, RESTARTS),
             order = open_stream(seed, world, trial, ORDER);
    stream_t sending = open_stream(seed, world, trial, SENDING),
             losses = open_stream(seed, world, trial, LOSSES);
    double fill = f, error_sum = 0, harmed_sum = 0, unfixed_sum = 0;
    long count_of_readings = 0;
    for (long t = 0; t < T; ++t) {
        static uint32_t x_hat[MAX_ROBOTS], alpha[MAX_ROBOTS];
        static uint8_t sends[MAX_ROBOTS];
        const int after_death = has_deaths && t >= T / 2;
        if (f2 >= 0 && t == T / 2) {
            fill = f2;
        }
        for (int i = 0; i < N; ++i) {
            if (restart > 0 && uniform(&restarts) < restart) {
                start_robot(i, configs[i]);
            }
            (void)mcp_asdf_observe(&robots[i], black[t * N + i] ? MCP_ASDF_BLACK : MCP_ASDF_WHITE);
        }
        for (int i = 0; i < N; ++i) {
            const double rate = is_flawed[i] || is_liar[i] ? 1 : hrate;
            sends[i] = rate >= 1 || uniform(&sending) < rate;
            if (hper != 0 && !is_flawed[i] && t % hper != i % hper) {
                sends[i] = 0;
            }
            if (after_death && dies[i]) {
                sends[i] = 0;
            }
            x_hat[i] = is_liar[i] ? lie_of(i, is_robust) : mcp_asdf_x_hat(&robots[i]);
            alpha[i] = is_liar[i] ? ALPHA_LARGEST : mcp_asdf_alpha(&robots[i]);
        }
        const int first = (int)(draw(&order) % (unsigned)N);
        if (top == 0) { /* senders in an order that turns; a liar that evicts comes last */
            for (int z = 0; z < N; ++z) {
                const int i = evict ? z : (z + first) % N;
                for (int j = 0; sends[i] && j < N; ++j) {
                    if (j != i && !(loss > 0 && uniform(&losses) < loss)) {
                        deliver(i, j, x_hat[i], alpha[i]);
                    }
                }
            }
        } else {
            const size_t start = top == 1 ? first_link[t] : 0,
                         end = top == 1 ? first_link[t + 1] : first_link[T];
            for (size_t l = start; l < end; ++l) {
                const int i = links[l].a, j = links[l].b;
                if (sends[i] && !(loss > 0 && uniform(&losses) < loss)) {
                    deliver(i, j, x_hat[i], alpha[i]);
                }
                if (sends[j] && !(loss > 0 && uniform(&losses) < loss)) {
                    deliver(j, i, x_hat[j], alpha[j]);
                }
            }
        }
        for (int i = 0; i < N; ++i) {
            (void)mcp_asdf_settle(&robots[i]);
        }
        if (t % READING_STEPS != 0) {
            continue;
        }
        double error = 0;
        int honest = 0, sound = 0, flawed = 0, harmed = 0, unfixed = 0;
        for (int i = 0; i < N; ++i) {
            const double x = mcp_asdf_x(&robots[i]) * 0x1p-23;
            series[i * readings + t / READING_STEPS] = (float)x;
            if (is_liar[i] || dies[i]) {
                continue;
            }
            error += fabs(x - fill);
            ++honest;
            const int is_off = fabs(mcp_asdf_b_hat(&robots[i]) * 0x1p-32 -
                                    (double)accuracies[t / READING_STEPS * N + i]) > FAR_OFF;
            sound += !is_flawed[i];
            flawed += is_flawed[i];
            harmed += !is_flawed[i] && is_off;
            unfixed += is_flawed[i] && is_off;
        }
        if (t >= T * 3 / 4) {
            error_sum += error / honest;
            harmed_sum += sound ? 100.0 * harmed / sound : 0;
            unfixed_sum += flawed ? 100.0 * unfixed / flawed : 0;
            ++count_of_readings;
        }
    }
    return (result_t){error_sum / (double)count_of_readings, score(fill),
                      harmed_sum / (double)count_of_readings, unfixed_sum / (double)count_of_readings};
}

/* ---- The command ---- */

static void print_list(const char *name, const double *values, int count, const char *end)
{
    printf("\"%s\": [", name);
    for (int i = 0; i < count; ++i) {
        printf("%s%.6g", i == 0 ? "" : ", ", values[i]);
    }
    printf("]%s", end);
}

int main(int argc, char **argv)
{
    const char *filters[8];
    int filter_count = 0;
    for (int i = 1; i < argc; ++i) {
        char *equals = strchr(argv[i], '=');
        if (equals == NULL) {
            fprintf(stderr, "key=value, not %s\n", argv[i]);
            return 2;
        }
        *equals = 0;
        if (strcmp(argv[i], "filter") == 0) {
            filters[filter_count++] = equals + 1;
        } else {
            set(argv[i], atof(equals + 1));
        }
    }
    const uint64_t seed = (uint64_t)get("seed"), world = (uint64_t)get("world");
    const int trials = (int)get("trials");
    N = (int)get("N"), top = (int)get("top"), liars = (int)get("liars");
    T = (long)get("steps"), tau = (long)get("tau"), readings = (T + READING_STEPS - 1) / READING_STEPS;
    f = get("f"), f2 = get("f2"), b = get("b"), fb = get("fb");
    share = get("share"), loss = get("loss");
    if (trials > MAX_TRIALS || N > MAX_ROBOTS || filter_count == 0 || filter_count > 4) {
        fprintf(stderr, "too many trials or robots, or no filter\n");
        return 2;
    }
    black = malloc((size_t)T * (size_t)N);
    accuracies = malloc(sizeof *accuracies * (size_t)readings * (size_t)N);
    series = malloc(sizeof *series * (size_t)readings * (size_t)N);
    first_link = malloc(sizeof *first_link * (size_t)(T + 1));
    static double values[4][4][MAX_TRIALS];
    for (int trial = 0; trial < trials; ++trial) {
        make_world(seed, world, trial);
        for (int k = 0; k < filter_count; ++k) {
            const result_t r = run_filter(filters[k], seed, world, trial);
            const double all[4] = {r.error, r.score, r.harmed, r.unfixed};
            for (int v = 0; v < 4; ++v) {
                values[k][v][trial] = all[v];
            }
        }
    }
    printf("{");
    for (int k = 0; k < filter_count; ++k) {
        printf("\"%s\": {", filters[k]);
        print_list("error", values[k][0], trials, ", ");
        print_list("score", values[k][1], trials, ", ");
        print_list("harmed", values[k][2], trials, ", ");
        print_list("unfixed", values[k][3], trials, k + 1 < filter_count ? "}, " : "}");
    }
    printf("}\n");
    return 0;
}
