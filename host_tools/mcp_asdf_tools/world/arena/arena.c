/* A tick of the arena, and the record of many. arena.h is the manual; docs/arena.md states the model and
 * where its numbers come from.
 *
 * Each file here has one part of the model:
 *   start.c        settings are checked and robots placed
 *   motion.c       bodies move as their motors and contacts drive them
 *   links.c        which pairs are near, and which hear each other
 *   steering.c     proximity sensors, and wheels that turn the robot away from obstacles
 *   floor.c        colours of the floor, and the ground sensor
 *   elementary.c   sines, angles and exponentials without a mathematics library
 *   splitmix.h     random numbers
 * They share arena_private.h. Units are metres, seconds and radians throughout.
 */
#include "arena_private.h"

void arena_look(mcp_asdf_arena_t *arena)
{
    arena_find_links(arena);
    arena_set_wheels(arena);
    arena_see_floor(arena);
}

void mcp_asdf_arena_step(mcp_asdf_arena_t *arena)
{
    ++arena->ticks;
    arena_move(arena);
    arena_look(arena);
}

static void write_links(const mcp_asdf_arena_t *arena, uint64_t *linked)
{
    memset(linked, 0, 2 * sizeof *linked * arena->config.robots);
    for (uint32_t p = 0; p < arena->link_count; ++p) {
        const mcp_asdf_pair_t pair = arena->links[p];
        set_bit(linked + (size_t)2 * pair.a, pair.b);
        set_bit(linked + (size_t)2 * pair.b, pair.a);
    }
}

/* Columns go to entries `first` and on of an array, unless it is NULL: two of them as pairs, or one. */
static void write_pairs(double *array, size_t first, const double *x, const double *y, uint32_t robots)
{
    for (size_t i = 0; array != NULL && i < robots; ++i) {
        array[2 * (first + i)] = x[i];
        array[2 * (first + i) + 1] = y[i];
    }
}

static void write_flags(uint8_t *array, size_t first, const uint8_t *flags, uint32_t robots)
{
    if (array != NULL) {
        memcpy(array + first, flags, robots);
    }
}

static void write_record(const mcp_asdf_arena_t *arena, const mcp_asdf_arena_record_t *record, size_t tick)
{
    const uint32_t robots = arena->config.robots;
    const size_t first = tick * robots;
    write_pairs(record->position, first, arena->x, arena->y, robots);
    write_pairs(record->heading, first, arena->cx, arena->cy, robots);
    write_flags(record->black, first, arena->black, robots);
    write_flags(record->wheels, first, arena->wheels, robots);
    write_flags(record->avoids, first, arena->avoids, robots);
    if (record->linked != NULL) {
        write_links(arena, record->linked + 2 * first);
    }
}

void mcp_asdf_arena_run(mcp_asdf_arena_t *arena, uint32_t ticks, const mcp_asdf_arena_record_t *record)
{
    for (uint32_t tick = 0; tick < ticks; ++tick) {
        mcp_asdf_arena_step(arena);
        write_record(arena, record, tick);
    }
}
