/* A world from its settings: its floor, its start, a tick. arena.h is the manual; docs/internals/arena.md
 * states the model and where its numbers come from.
 *
 *   arena.c        robots are placed and the floor coloured; a tick
 *   motion.c       bodies move as their motors and contacts drive them
 *   links.c        which pairs are near, and which receive from each other
 *   steering.c     proximity sensors, and wheels that turn the robot away from obstacles
 *   elementary.h   sines, angles and exponentials without a mathematics library
 *   targets.h      loops that become vector instructions
 *
 * The C files share arena_private.h. Units are metres, seconds and radians throughout.
 */
#include "arena_private.h"

/* Returns a hash of z, the mixing function of splitmix64, a generator of random numbers that mixes the values
 * of a counter. G. L. Steele, D. Lea, C. H. Flood, "Fast splittable pseudorandom number generators", OOPSLA
 * 2014. The multipliers and the step of the counter below are the paper's. */
IN_LOOPS uint64_t splitmix(uint64_t z)
{
    z = (z ^ (z >> 30)) * 0xBF58476D1CE4E5B9U;
    z = (z ^ (z >> 27)) * 0x94D049BB133111EBU;
    return z ^ (z >> 31);
}

/* Returns the next random number, uniform in [0, 1), and moves the counter on. It has the 53 bits that a
 * double has, of the 64 of the hash. */
static inline double splitmix_uniform(uint64_t *counter)
{
    *counter += 0x9E3779B97F4A7C15U;
    const uint64_t random_53_bits = splitmix(*counter) >> (64 - 53);
    return (double)random_53_bits * 0x1p-53;
}

/* ---- The floor -------------------------------------------------------------------------------------------
 *
 * A tile's colour is a hash of the seed and the tile's column and row, so that no floor is stored however
 * large it is; a picture is read from the caller's memory. */

/* Position of the Khepera IV's ground sensor, from the centre, in metres (docs/internals/arena.md). */
#define SENSOR_FORWARD 0.0614
#define SENSOR_RIGHT 0.01

/* Returns the index of the pixel at `position`, in pixels from the first one's edge, among `count` in a row
 * or a column. A point on the edge of the floor, or beyond it by rounding, belongs to the nearest pixel. */
static uint32_t pixel_index(double position, uint32_t count)
{
    const uint32_t index = position > 0 ? (uint32_t)position : 0;
    return index < count - 1 ? index : count - 1;
}

/* Whether the picture is black at (x, y). It is stretched over the floor, with its first row in the north and
 * its first column in the west; the origin of x and y is the middle of the floor. */
static bool pixel_is_black(const mcp_asdf_arena_config_t *config, double x, double y)
{
    const uint32_t column = pixel_index((x / config->width + 0.5) * config->columns, config->columns);
    const size_t row = pixel_index((0.5 - y / config->height) * config->rows, config->rows);
    return config->image[row * config->columns + column] != 0;
}

/* Whether the tile at (x, y) is black: if the hash of its column and row, as a number of 53 bits, is below
 * the limit. */
IN_LOOPS bool tile_is_black(const mcp_asdf_arena_t *arena, double x, double y)
{
    /* Counted from the south-west corner. Numbers are converted by way of signed integers, for which
     * processors have an instruction. */
    const uint64_t column = (uint64_t)(int64_t)((x + arena->config.width / 2) * arena->tiles_per_metre);
    const uint64_t row = (uint64_t)(int64_t)((y + arena->config.height / 2) * arena->tiles_per_metre);
    const uint64_t tile_number = (column << 32) | row;
    const uint64_t hash = splitmix(arena->colour_seed + tile_number);
    const uint64_t hash_of_53_bits = hash >> (64 - 53);
    return (double)(int64_t)hash_of_53_bits < arena->black_limit;
}

/* Returns 1 if the floor, a picture or tiles, is black at (x, y), else 0. */
int mcp_asdf_arena_is_black(const mcp_asdf_arena_t *arena, double x, double y)
{
    return arena->config.image != NULL ? pixel_is_black(&arena->config, x, y) : tile_is_black(arena, x, y);
}

/* Returns the x coordinate in metres of robot i's ground sensor: its position in the robot's frame, turned by
 * the heading (cx, cy), from the robot's centre. */
IN_LOOPS double ground_sensor_x(const mcp_asdf_arena_t *arena, size_t i)
{
    return arena->x[i] + SENSOR_FORWARD * arena->cx[i] + SENSOR_RIGHT * arena->cy[i];
}

/* Returns the y coordinate of robot i's ground sensor, likewise. */
IN_LOOPS double ground_sensor_y(const mcp_asdf_arena_t *arena, size_t i)
{
    return arena->y[i] + SENSOR_FORWARD * arena->cy[i] - SENSOR_RIGHT * arena->cx[i];
}

/* Store in arena->black 1 for each robot whose ground sensor is on a black tile, else 0. Robots are taken a
 * vector at a time, and the last vector may go beyond the last robot: allocate() has made room for that in
 * all arrays. Indices are size_t, as loops whose index cannot wrap around become vectors. */
FOR_EACH_TARGET static void read_tiles(const mcp_asdf_arena_t *arena)
{
    for (size_t first = 0; first < arena->config.robots; first += VECTOR) { /* `first` and those after it */
        uint64_t is_black[VECTOR]; /* as wide as the coordinates, so that one vector holds as many */
        SIDE_BY_SIDE
        for (size_t i = 0; i < VECTOR; ++i) {
            is_black[i] =
                tile_is_black(arena, ground_sensor_x(arena, first + i), ground_sensor_y(arena, first + i));
        }
        for (size_t i = 0; i < VECTOR; ++i) {
            arena->black[first + i] = (uint8_t)is_black[i];
        }
    }
}

/* Store in arena->black 1 for each robot whose ground sensor is on a black floor, tiles or a picture; else
 * 0. */
static void read_floor(const mcp_asdf_arena_t *arena)
{
    if (arena->config.image == NULL) {
        read_tiles(arena);
        return;
    }
    for (uint32_t i = 0; i < arena->config.robots; ++i) {
        arena->black[i] =
            pixel_is_black(&arena->config, ground_sensor_x(arena, i), ground_sensor_y(arena, i));
    }
}

/* ---- Memory -----------------------------------------------------------------------------------------------
 */

/* Reserve the next `count` entries of `size` bytes behind the first *used bytes of `memory`, rounded up to
 * whole vectors, so that these can be read to their end. Returns their address, or NULL if `memory` is NULL,
 * and adds their bytes to *used. */
static void *allocate(uint8_t *memory, size_t *used, size_t count, size_t size)
{
    void *const entries = memory == NULL ? NULL : memory + *used;
    const size_t whole_vectors = (count * size + VECTOR_BYTES - 1) / VECTOR_BYTES; /* rounded up */
    *used += whole_vectors * VECTOR_BYTES;
    return entries;
}

/* Returns an upper limit of how many other bodies have their centres within `distance` of a body's centre. A
 * disc of radius distance + BODY_RADIUS holds them all and that body, so its area is at least their area.
 * Circles fill nine tenths of a disc at most, so the little by which bodies may overlap does no harm.
 */
static uint32_t max_neighbours_within(const mcp_asdf_arena_config_t *config, double distance)
{
    const double disc_radius = distance / BODY_RADIUS + 1; /* in radii of a body */
    const double disc_area = disc_radius * disc_radius;    /* in areas of a body */
    const double max_neighbours = disc_area - 1;           /* without the body in the middle */
    return max_neighbours < config->robots ? (uint32_t)max_neighbours : config->robots - 1;
}

/* Reserve memory, as allocate() does, for all pairs of robots that can be within `distance` of each other. */
static mcp_asdf_pair_t *allocate_pairs(const mcp_asdf_arena_config_t *config, double distance,
                                       uint8_t *memory, size_t *used)
{
    /* Each pair is in the neighbourhoods of two robots. */
    const size_t max_pairs = (size_t)config->robots * max_neighbours_within(config, distance) / 2;
    /* One more, as loops write a pair behind the last before they know whether to keep it. */
    return allocate(memory, used, max_pairs + 1, sizeof(mcp_asdf_pair_t));
}

/* Point the arena's arrays into its memory, or to NULL if that is NULL. Returns the number of bytes that they
 * take, with those that align the first one. */
static size_t lay_out_memory(mcp_asdf_arena_t *arena, const mcp_asdf_arena_config_t *config, uint8_t *memory)
{
    const uint32_t robots = config->robots;
    mcp_asdf_bodies_t *const bodies = &arena->touching;
    /* The addresses of those members that point to arrays of doubles or of bytes. */
    double **const double_arrays[] = {&arena->x,
                                      &arena->y,
                                      &arena->cx,
                                      &arena->cy,
                                      &arena->vx,
                                      &arena->vy,
                                      &arena->spin,
                                      &arena->target_speed,
                                      &arena->target_spin,
                                      &bodies->target_vx,
                                      &bodies->target_vy,
                                      &bodies->motor_change_x,
                                      &bodies->motor_change_y};
    uint8_t **const byte_arrays[] = {&arena->black, &arena->wheels, &arena->avoids};
    /* The first array begins at a whole vector, behind so many unused bytes. Without memory it is not known
     * where that is, and the most that there can be are counted. */
    size_t used = memory == NULL ? VECTOR_BYTES - 1 : bytes_before_vector(memory);
    for (size_t k = 0; k < sizeof double_arrays / sizeof *double_arrays; ++k) {
        *double_arrays[k] = allocate(memory, &used, robots, sizeof(double));
    }
    for (size_t k = 0; k < sizeof byte_arrays / sizeof *byte_arrays; ++k) {
        *byte_arrays[k] = allocate(memory, &used, robots, sizeof(uint8_t));
    }
    arena->may_touch = allocate(memory, &used, robots, sizeof *arena->may_touch);
    arena->needs_steering = allocate(memory, &used, robots, sizeof *arena->needs_steering);
    arena->free_distance = allocate(memory, &used, (size_t)robots * SENSORS, sizeof *arena->free_distance);
    arena->in_range = allocate(memory, &used, robots, sizeof *arena->in_range);
    arena->links = allocate_pairs(config, config->range, memory, &used);
    arena->visible = allocate_pairs(config, SEEING_DISTANCE, memory, &used);
    arena->touchable = allocate_pairs(config, touching_distance(config), memory, &used);
    arena->candidates = allocate_pairs(config, candidate_distance(config), memory, &used);
    const size_t max_entries = (size_t)robots * max_neighbours_within(config, candidate_distance(config));
    arena->first_candidate = allocate(memory, &used, (size_t)robots + 1, sizeof *arena->first_candidate);
    arena->candidates_of = allocate(memory, &used, max_entries, sizeof *arena->candidates_of);
    arena->grid.first_of_cell =
        allocate(memory, &used, (size_t)robots + 1, sizeof *arena->grid.first_of_cell);
    arena->grid.robots_by_cell = allocate(memory, &used, robots, sizeof *arena->grid.robots_by_cell);
    arena->grid.cell_of_robot = allocate(memory, &used, robots, sizeof *arena->grid.cell_of_robot);
    bodies->robot = allocate(memory, &used, robots, sizeof *bodies->robot);
    bodies->contacts = allocate(memory, &used, (size_t)robots * CONTACTS_PER_BODY, sizeof *bodies->contacts);
    return used;
}

/* Returns the bytes of an arena with these settings, by laying it out without memory. */
size_t mcp_asdf_arena_bytes(const mcp_asdf_arena_config_t *config)
{
    mcp_asdf_arena_t arena;
    return lay_out_memory(&arena, config, NULL);
}

/* ---- The start ----------------------------------------------------------------------------------------- */

/* Update, in each of `count` arenas, what depends on the present positions of the robots: the links, that is
 * which robots receive from each other; the wheels, which turn a robot away from obstacles that it senses;
 * and the colour of the floor under each robot. */
static void sense_surroundings(mcp_asdf_arena_t *arenas, uint32_t count)
{
    for (uint32_t a = 0; a < count; ++a) {
        arena_find_links(&arenas[a]);
    }
    arena_set_wheels(arenas, count); /* of all arenas at once, as batches of robots may be of several */
    for (uint32_t a = 0; a < count; ++a) {
        read_floor(&arenas[a]);
    }
}

/* Draws for a robot's position before the arena counts as full: where a robot still fits in a share of
 * 1/10000 of the floor, all draws fail once in e^10 times. */
#define PLACING_ATTEMPTS 100000

/* Mixed into the seed, so that positions and colours have different draws: "place" and "colour" in ASCII. */
#define POSITION_STREAM 0x706C616365U
#define COLOUR_STREAM 0x636F6C6F7572U

/* Whether body i overlaps one with a lower number: robots are placed in this order. */
static bool overlaps_earlier_robot(const mcp_asdf_arena_t *arena, uint32_t i)
{
    for (uint32_t j = 0; j < i; ++j) {
        if (squared_distance(arena, i, j) < DIAMETER * DIAMETER) {
            return true;
        }
    }
    return false;
}

/* Put robot i at a random position where it overlaps no robot placed before, with numbers that *counter gives
 * and moves on. Returns false if none was found in PLACING_ATTEMPTS draws; the robot is then at the last one.
 */
static bool place_robot(mcp_asdf_arena_t *arena, uint32_t i, uint64_t *counter)
{
    for (int attempt = 0; attempt < PLACING_ATTEMPTS; ++attempt) {
        arena->x[i] = (splitmix_uniform(counter) - 0.5) * (arena->config.width - DIAMETER);
        arena->y[i] = (splitmix_uniform(counter) - 0.5) * (arena->config.height - DIAMETER);
        if (!overlaps_earlier_robot(arena, i)) {
            return true;
        }
    }
    return false;
}

/* Turn robot i to a random heading, with numbers that *counter gives and moves on. The direction of a point
 * that is uniform in a disc is uniform as well, and needs no sine. */
static void draw_heading(mcp_asdf_arena_t *arena, uint32_t i, uint64_t *counter)
{
    double x, y, squared;
    do {
        x = 2 * splitmix_uniform(counter) - 1;
        y = 2 * splitmix_uniform(counter) - 1;
        squared = x * x + y * y;
    } while (squared > 1 || squared < 0.01); /* near the middle rounding would show */
    arena->cx[i] = x / sqrt(squared);
    arena->cy[i] = y / sqrt(squared);
}

/* Set all that follows from the configuration alone, point the arena's arrays into `memory`, and set the rest
 * of both to 0. */
static void set_constants(mcp_asdf_arena_t *arena, const mcp_asdf_arena_config_t *config, void *memory)
{
    memset(arena, 0, sizeof *arena);
    memset(memory, 0, lay_out_memory(arena, config, memory));
    arena->config = *config;
    arena->colour_seed = splitmix(config->seed ^ COLOUR_STREAM);
    arena->black_limit = config->fill_ratio * 0x1p53; /* hashes of tiles have 53 bits */
    arena->tiles_per_metre = 1 / config->tile;
    arena->substep = config->tick / SUBSTEPS;
    arena->max_motor_change = ACCELERATION * arena->substep;
}

/* Place all robots at rest, with random headings, and let them sense their surroundings. Returns 1; or 0 if
 * there is no room for one of them, and the arena is then of no use. */
int mcp_asdf_arena_init(mcp_asdf_arena_t *arena, const mcp_asdf_arena_config_t *config, void *memory)
{
    uint64_t counter = splitmix(config->seed ^ POSITION_STREAM);
    set_constants(arena, config, memory);
    for (uint32_t i = 0; i < config->robots; ++i) {
        if (!place_robot(arena, i, &counter)) {
            return 0;
        }
        draw_heading(arena, i, &counter);
        mcp_asdf_arena_steer(arena, i, 0, 0); /* no obstacle: straight on */
    }
    sense_surroundings(arena, 1);
    return 1;
}

/* ---- Ticks --------------------------------------------------------------------------------------------- */

/* Move the bodies for one tick, then let the robots sense their new surroundings. */
void mcp_asdf_arena_step(mcp_asdf_arena_t *arenas, uint32_t count)
{
    arena_move(arenas, count);
    sense_surroundings(arenas, count);
}
