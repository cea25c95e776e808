/* A world from its settings: its floor, its start, a tick. arena.h is the manual; docs/arena.md states the
 * model and where its numbers come from.
 *
 *   arena.c        robots are placed and the floor coloured; a tick
 *   motion.c       bodies move as their motors and contacts drive them
 *   links.c        which pairs are near, and which hear each other
 *   steering.c     proximity sensors, and wheels that turn the robot away from obstacles
 *   elementary.h   sines, angles and exponentials without a mathematics library
 *   targets.h      loops that become vector instructions
 *
 * The C files share arena_private.h. Units are metres, seconds and radians throughout.
 */
#include "arena_private.h"

/* splitmix64: random numbers from a counter and a mixing function that is also a good hash. G. L. Steele,
 * D. Lea, C. H. Flood, "Fast splittable pseudorandom number generators", OOPSLA 2014. */
IN_LOOPS uint64_t splitmix(uint64_t z)
{
    z = (z ^ (z >> 30)) * 0xBF58476D1CE4E5B9U;
    z = (z ^ (z >> 27)) * 0x94D049BB133111EBU;
    return z ^ (z >> 31);
}

/* The next number, uniform in [0, 1), of 53 bits. */
static inline double splitmix_uniform(uint64_t *counter)
{
    *counter += 0x9E3779B97F4A7C15U;
    return (double)(splitmix(*counter) >> 11) * 0x1p-53;
}

/* ---- The floor -------------------------------------------------------------------------------------------
 *
 * A tile's colour is a hash of the seed and the tile's column and row, so that no floor is stored however
 * large it is; a picture is read from the caller's memory. */

/* Place of the ground sensor, from the centre. */
#define SENSOR_FORWARD 0.0614
#define SENSOR_RIGHT 0.01

/* A point on the edge of the floor, or beyond by rounding, belongs to the nearest pixel. */
static bool pixel_is_black(const mcp_asdf_arena_config_t *config, double x, double y)
{
    const double across = (x / config->width + 0.5) * config->columns;
    const double down = (0.5 - y / config->height) * config->rows;
    const uint32_t column = across > 0 ? (uint32_t)across : 0, row = down > 0 ? (uint32_t)down : 0;
    const uint32_t last_column = config->columns - 1, last_row = config->rows - 1;
    const size_t line = row < last_row ? row : last_row;
    return config->image[line * config->columns + (column < last_column ? column : last_column)] != 0;
}

IN_LOOPS bool tile_is_black(const mcp_asdf_arena_t *arena, double x, double y)
{
    /* Processors have an instruction for signed numbers. */
    const uint64_t column = (uint64_t)(int64_t)((x + arena->config.width / 2) * arena->tiles_per_metre);
    const uint64_t row = (uint64_t)(int64_t)((y + arena->config.height / 2) * arena->tiles_per_metre);
    return (double)(int64_t)(splitmix(arena->colours + (column << 32 | row)) >> 11) < arena->colour_limit;
}

int mcp_asdf_arena_is_black(const mcp_asdf_arena_t *arena, double x, double y)
{
    return arena->config.image != NULL ? pixel_is_black(&arena->config, x, y) : tile_is_black(arena, x, y);
}

/* Place of robot i's ground sensor. */
IN_LOOPS double sensor_x(const mcp_asdf_arena_t *arena, size_t i)
{
    return arena->x[i] + SENSOR_FORWARD * arena->cx[i] + SENSOR_RIGHT * arena->cy[i];
}

IN_LOOPS double sensor_y(const mcp_asdf_arena_t *arena, size_t i)
{
    return arena->y[i] + SENSOR_FORWARD * arena->cy[i] - SENSOR_RIGHT * arena->cx[i];
}

/* Whether tiles are black under all robots. Indices that cannot wrap around become vectors. */
FOR_EACH_TARGET static void see_tiles(const mcp_asdf_arena_t *arena)
{
    for (size_t first = 0; first < arena->config.robots; first += VECTOR) {
        uint64_t is_black[VECTOR];
        SIDE_BY_SIDE
        for (size_t i = 0; i < VECTOR; ++i) {
            is_black[i] = tile_is_black(arena, sensor_x(arena, first + i), sensor_y(arena, first + i));
        }
        for (size_t i = 0; i < VECTOR; ++i) {
            arena->black[first + i] = (uint8_t)is_black[i];
        }
    }
}

static void see_floor(const mcp_asdf_arena_t *arena)
{
    if (arena->config.image == NULL) {
        see_tiles(arena);
        return;
    }
    for (uint32_t i = 0; i < arena->config.robots; ++i) {
        arena->black[i] = pixel_is_black(&arena->config, sensor_x(arena, i), sensor_y(arena, i));
    }
}

/* ---- Memory -----------------------------------------------------------------------------------------------
 */

/* The next `count` entries of `size` bytes, and room to whole vectors, so that they can be read to their end.
 */
static void *take(uint8_t *memory, size_t *used, size_t count, size_t size)
{
    void *const taken = memory == NULL ? NULL : memory + *used;
    *used += (count * size + VECTOR_BYTES - 1) / VECTOR_BYTES * VECTOR_BYTES;
    return taken;
}

/* Most centres of other bodies within `distance` of one. A disc that holds them all has room for the area of
 * each; bodies fill nine tenths of it at most, so the little by which they may overlap does no harm. */
static uint32_t most_within(const mcp_asdf_arena_config_t *config, double distance)
{
    const double bodies = (distance / BODY_RADIUS + 1) * (distance / BODY_RADIUS + 1) - 1;
    return bodies < config->robots ? (uint32_t)bodies : config->robots - 1;
}

static mcp_asdf_pair_t *take_pairs(const mcp_asdf_arena_config_t *config, double distance, uint8_t *memory,
                                   size_t *used)
{
    const size_t most = (size_t)config->robots * most_within(config, distance) / 2;
    return take(memory, used, most + 1, sizeof(mcp_asdf_pair_t)); /* one that is written and not kept */
}

/* Point the arena's arrays into its memory, or to nowhere if that is NULL; returns the bytes that it takes.
 */
static size_t lay_out(mcp_asdf_arena_t *arena, const mcp_asdf_arena_config_t *config, uint8_t *memory)
{
    const uint32_t robots = config->robots;
    mcp_asdf_bodies_t *const crowd = &arena->crowd;
    double **const numbers[] = {&arena->x,           &arena->y,        &arena->cx,       &arena->cy,
                                &arena->vx,          &arena->vy,       &arena->spin,     &arena->wanted_speed,
                                &arena->wanted_spin, &crowd->wanted_x, &crowd->wanted_y, &crowd->given_x,
                                &crowd->given_y};
    uint8_t **const flags[] = {&arena->black, &arena->wheels, &arena->avoids};
    size_t used =
        memory == NULL ? VECTOR_BYTES - 1 : -(uintptr_t)memory % VECTOR_BYTES; /* to align vectors */
    for (size_t k = 0; k < sizeof numbers / sizeof *numbers; ++k) {
        *numbers[k] = take(memory, &used, robots, sizeof(double));
    }
    for (size_t k = 0; k < sizeof flags / sizeof *flags; ++k) {
        *flags[k] = take(memory, &used, robots, 1);
    }
    arena->may_touch = take(memory, &used, robots, sizeof *arena->may_touch);
    arena->looks = take(memory, &used, robots, sizeof *arena->looks);
    arena->clear = take(memory, &used, (size_t)robots * SENSORS, sizeof *arena->clear);
    arena->in_range = take(memory, &used, robots, sizeof *arena->in_range);
    arena->links = take_pairs(config, config->range, memory, &used);
    arena->near = take_pairs(config, SEEING_DISTANCE, memory, &used);
    arena->close = take_pairs(config, touching_distance(config), memory, &used);
    arena->watched = take_pairs(config, watching_distance(config), memory, &used);
    const size_t most_around = (size_t)robots * most_within(config, watching_distance(config));
    arena->first_around = take(memory, &used, (size_t)robots + 1, sizeof *arena->first_around);
    arena->around = take(memory, &used, most_around, sizeof *arena->around);
    arena->grid.first = take(memory, &used, (size_t)robots + 1, sizeof *arena->grid.first);
    arena->grid.robots = take(memory, &used, robots, sizeof *arena->grid.robots);
    arena->grid.cell = take(memory, &used, robots, sizeof *arena->grid.cell);
    crowd->member = take(memory, &used, robots, sizeof *crowd->member);
    crowd->contacts = take(memory, &used, (size_t)robots * CONTACTS_OF_A_BODY, sizeof *crowd->contacts);
    return used;
}

size_t mcp_asdf_arena_bytes(const mcp_asdf_arena_config_t *config)
{
    mcp_asdf_arena_t arena;
    return lay_out(&arena, config, NULL);
}

/* ---- The start ----------------------------------------------------------------------------------------- */

static void look(mcp_asdf_arena_t *arenas, uint32_t count)
{
    for (uint32_t a = 0; a < count; ++a) {
        arena_find_links(&arenas[a]);
    }
    arena_set_wheels(arenas, count);
    for (uint32_t a = 0; a < count; ++a) {
        see_floor(&arenas[a]);
    }
}

#define PLACING_ATTEMPTS 100000

/* Different draws for places and colours from one seed. */
#define PLACES 0x706C616365U
#define COLOURS 0x636F6C6F7572U

/* Whether body i overlaps one that was placed before. */
static bool overlaps(const mcp_asdf_arena_t *arena, uint32_t i)
{
    for (uint32_t j = 0; j < i; ++j) {
        if (squared_distance(arena, i, j) < DIAMETER * DIAMETER) {
            return true;
        }
    }
    return false;
}

static bool place(mcp_asdf_arena_t *arena, uint32_t i, uint64_t *counter)
{
    for (int attempt = 0; attempt < PLACING_ATTEMPTS; ++attempt) {
        arena->x[i] = (splitmix_uniform(counter) - 0.5) * (arena->config.width - DIAMETER);
        arena->y[i] = (splitmix_uniform(counter) - 0.5) * (arena->config.height - DIAMETER);
        if (!overlaps(arena, i)) {
            return true;
        }
    }
    return false;
}

/* The direction of a point that is uniform in a disc is uniform as well, and needs no sine. */
static void face_anywhere(mcp_asdf_arena_t *arena, uint32_t i, uint64_t *counter)
{
    double x, y, squared;
    do {
        x = 2 * splitmix_uniform(counter) - 1;
        y = 2 * splitmix_uniform(counter) - 1;
        squared = x * x + y * y;
    } while (squared > 1 || squared < 0.01); /* too close to the middle, rounding would show */
    arena->cx[i] = x / sqrt(squared);
    arena->cy[i] = y / sqrt(squared);
}

/* Everything that follows from the settings alone. */
static void prepare(mcp_asdf_arena_t *arena, const mcp_asdf_arena_config_t *config, void *memory)
{
    memset(arena, 0, sizeof *arena);
    memset(memory, 0, lay_out(arena, config, memory));
    arena->config = *config;
    arena->colours = splitmix(config->seed ^ COLOURS);
    arena->colour_limit = config->fill_ratio * 0x1p53;
    arena->tiles_per_metre = 1 / config->tile;
    arena->part = config->tick / PARTS;
    arena->motor = ACCELERATION * arena->part;
}

int mcp_asdf_arena_init(mcp_asdf_arena_t *arena, const mcp_asdf_arena_config_t *config, void *memory)
{
    uint64_t counter = splitmix(config->seed ^ PLACES);
    prepare(arena, config, memory);
    for (uint32_t i = 0; i < config->robots; ++i) {
        if (!place(arena, i, &counter)) {
            return 0;
        }
        face_anywhere(arena, i, &counter);
        mcp_asdf_arena_steer(arena, i, 0, 0);
    }
    look(arena, 1);
    return 1;
}

/* ---- Ticks --------------------------------------------------------------------------------------------- */

void mcp_asdf_arena_step(mcp_asdf_arena_t *arenas, uint32_t count)
{
    arena_move(arenas, count);
    look(arenas, count);
}
