/* How a world begins: settings are checked, robots are placed at random, and they look around for the first
 * time.
 */
#include "arena_private.h"
#include "splitmix.h"

#define MAX_SIDE 1000.0
#define MAX_TILES 100000.0 /* along a side, so that the number of a column or row fits 32 bits */
#define MAX_SPEED 0.814
#define PLACING_ATTEMPTS 100000

/* Different draws for places and colours from one seed. */
#define PLACES 0x706C616365U
#define COLOURS 0x636F6C6F7572U

/* In all these checks a NaN fails. */
static bool has_side(double side) { return side > DIAMETER && side <= MAX_SIDE; }

static bool has_floor(const mcp_asdf_arena_config_t *config)
{
    if (config->image != NULL) {
        return config->columns > 0 && config->rows > 0;
    }
    return config->tile * MAX_TILES >= larger(config->width, config->height) && !isinf(config->tile) &&
           config->fill_ratio >= 0 && config->fill_ratio <= 1;
}

static bool is_valid(const mcp_asdf_arena_config_t *config)
{
    return config->robots >= 1 && config->robots <= MCP_ASDF_ARENA_MAX_ROBOTS && has_side(config->width) &&
           has_side(config->height) && config->speed > 0 && config->speed <= MAX_SPEED && config->range > 0 &&
           config->range <= MAX_SIDE && config->tick > 0 &&
           2 * config->speed / WHEEL_DISTANCE * config->tick <= LARGEST_TURN && has_floor(config);
}

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

static mcp_asdf_arena_status_t place(mcp_asdf_arena_t *arena, uint32_t i, uint64_t *counter)
{
    for (int attempt = 0; attempt < PLACING_ATTEMPTS; ++attempt) {
        arena->x[i] = (splitmix_uniform(counter) - 0.5) * (arena->config.width - DIAMETER);
        arena->y[i] = (splitmix_uniform(counter) - 0.5) * (arena->config.height - DIAMETER);
        if (!overlaps(arena, i)) {
            return MCP_ASDF_ARENA_OK;
        }
    }
    return MCP_ASDF_ARENA_ERR_CROWDED;
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
static void prepare(mcp_asdf_arena_t *arena, const mcp_asdf_arena_config_t *config)
{
    memset(arena, 0, sizeof *arena);
    arena->config = *config;
    arena->colours = splitmix(config->seed ^ COLOURS);
    arena->colour_limit = config->fill_ratio * 0x1p53;
    arena->tiles_per_metre = 1 / config->tile;
    arena->part = config->tick / PARTS;
    arena->motor = ACCELERATION * arena->part;
}

mcp_asdf_arena_status_t mcp_asdf_arena_init(mcp_asdf_arena_t *arena, const mcp_asdf_arena_config_t *config)
{
    uint64_t counter = splitmix(config->seed ^ PLACES);
    mcp_asdf_arena_status_t status = is_valid(config) ? MCP_ASDF_ARENA_OK : MCP_ASDF_ARENA_ERR_CONFIG;
    prepare(arena, config);
    for (uint32_t i = 0; i < config->robots && status == MCP_ASDF_ARENA_OK; ++i) {
        status = place(arena, i, &counter);
        face_anywhere(arena, i, &counter);
        mcp_asdf_arena_steer(arena, i, 0, 0);
    }
    if (status == MCP_ASDF_ARENA_OK) {
        arena_look(arena);
    }
    return status;
}
