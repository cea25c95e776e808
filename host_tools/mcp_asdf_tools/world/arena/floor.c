/* The floor and the ground sensor. A tile's colour is a hash of the seed and the tile's column and row, so
 * that no floor is stored however large it is; a picture is read from the caller's memory.
 */
#include "arena_private.h"
#include "splitmix.h"

/* Of the ground sensor, from the centre. */
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

static inline bool tile_is_black(const mcp_asdf_arena_t *arena, double x, double y)
{
    /* Processors have an instruction for signed numbers. */
    const uint64_t column = (uint64_t)(int64_t)((x + arena->config.width / 2) * arena->tiles_per_metre);
    const uint64_t row = (uint64_t)(int64_t)((y + arena->config.height / 2) * arena->tiles_per_metre);
    return (double)(splitmix(arena->colours + (column << 32 | row)) >> 11) < arena->colour_limit;
}

int mcp_asdf_arena_is_black(const mcp_asdf_arena_t *arena, double x, double y)
{
    return arena->config.image != NULL ? pixel_is_black(&arena->config, x, y) : tile_is_black(arena, x, y);
}

void arena_see_floor(mcp_asdf_arena_t *arena)
{
    for (uint32_t i = 0; i < arena->config.robots; ++i) {
        const double cx = arena->cx[i], cy = arena->cy[i];
        const double x = arena->x[i] + SENSOR_FORWARD * cx + SENSOR_RIGHT * cy;
        const double y = arena->y[i] + SENSOR_FORWARD * cy - SENSOR_RIGHT * cx;
        arena->black[i] = (uint8_t)mcp_asdf_arena_is_black(arena, x, y);
    }
}
