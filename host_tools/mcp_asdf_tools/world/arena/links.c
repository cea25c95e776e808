/* Who is near whom: links between robots that hear each other, bodies near enough to be seen or touched. All
 * pairs are compared once in a while only; a pair too far apart to matter until the next time is skipped,
 * because no robot is faster than its wheels.
 */
#include "arena_private.h"

#define TICKS_BETWEEN_LOOKS 12

/* Below these distances of their centres one robot may see another, or two may meet within a tick. */
#define SEEING_DISTANCE (DIAMETER + SENSOR_REACH)

static double touching_distance(const mcp_asdf_arena_t *arena)
{
    return DIAMETER + 2 * arena->config.speed * arena->config.tick;
}

/* List the pairs that could matter before the next look at all of them. */
static void watch(mcp_asdf_arena_t *arena)
{
    const double matters = larger(arena->config.range, larger(touching_distance(arena), SEEING_DISTANCE));
    const double limit = matters + 2 * arena->config.speed * arena->config.tick * TICKS_BETWEEN_LOOKS;
    uint32_t count = 0;
    for (uint32_t i = 0; i < arena->config.robots; ++i) {
        for (uint32_t j = i + 1; j < arena->config.robots; ++j) {
            /* Written always, kept if near: a branch here could not be predicted. */
            arena->watched[count].a = (uint8_t)i;
            arena->watched[count].b = (uint8_t)j;
            count += squared_distance(arena, i, j) < limit * limit;
        }
    }
    arena->watched_count = count;
    arena->ticks_to_watch = TICKS_BETWEEN_LOOKS;
}

static void forget_pairs(mcp_asdf_arena_t *arena)
{
    for (uint32_t i = 0; i < arena->config.robots; ++i) {
        arena->in_range[i][0] = arena->in_range[i][1] = 0;
        arena->near[i][0] = arena->near[i][1] = 0;
        arena->may_touch[i] = wall_within(arena, i, arena->config.speed * arena->config.tick);
    }
    arena->link_count = arena->close_count = 0;
}

static void note_near(mcp_asdf_arena_t *arena, mcp_asdf_pair_t pair, double squared)
{
    const double touching = touching_distance(arena);
    if (squared < SEEING_DISTANCE * SEEING_DISTANCE) {
        set_bit(arena->near[pair.a], pair.b);
        set_bit(arena->near[pair.b], pair.a);
    }
    if (squared < touching * touching) {
        arena->may_touch[pair.a] = arena->may_touch[pair.b] = 1;
        arena->close[arena->close_count++] = pair;
    }
}

static void note_pairs(mcp_asdf_arena_t *arena)
{
    const double range = arena->config.range, matters = larger(touching_distance(arena), SEEING_DISTANCE);
    for (uint32_t p = 0; p < arena->watched_count; ++p) {
        const mcp_asdf_pair_t pair = arena->watched[p];
        const double squared = squared_distance(arena, pair.a, pair.b);
        if (squared < range * range) {
            set_bit(arena->in_range[pair.a], pair.b);
            set_bit(arena->in_range[pair.b], pair.a);
            arena->links[arena->link_count++] = pair;
        }
        if (squared < matters * matters) {
            note_near(arena, pair, squared);
        }
    }
}

/* Whether body k reaches into the line from i to j. */
static bool stands_between(const mcp_asdf_arena_t *arena, uint32_t i, uint32_t j, uint32_t k)
{
    const double dx = arena->x[j] - arena->x[i], dy = arena->y[j] - arena->y[i];
    const double mx = arena->x[k] - arena->x[i], my = arena->y[k] - arena->y[i];
    const double squared = dx * dx + dy * dy, along = mx * dx + my * dy, across = mx * dy - my * dx;
    return along > 0 && along < squared && across * across < BODY_RADIUS * BODY_RADIUS * squared;
}

/* Bodies do not overlap, so one between two others is closer to each than they are to each other: it is in
 * range of both. */
static bool is_blocked(const mcp_asdf_arena_t *arena, uint32_t i, uint32_t j)
{
    uint64_t both[2] = {arena->in_range[i][0] & arena->in_range[j][0],
                        arena->in_range[i][1] & arena->in_range[j][1]};
    for (int k = take_bit(both); k >= 0; k = take_bit(both)) {
        if (stands_between(arena, i, j, (uint32_t)k)) {
            return true;
        }
    }
    return false;
}

static void drop_blocked_links(mcp_asdf_arena_t *arena)
{
    uint32_t kept = 0;
    for (uint32_t p = 0; p < arena->link_count; ++p) {
        if (!is_blocked(arena, arena->links[p].a, arena->links[p].b)) {
            arena->links[kept++] = arena->links[p];
        }
    }
    arena->link_count = kept;
}

void arena_find_links(mcp_asdf_arena_t *arena)
{
    if (arena->ticks_to_watch == 0) {
        watch(arena);
    } else {
        --arena->ticks_to_watch;
    }
    forget_pairs(arena);
    note_pairs(arena);
    drop_blocked_links(arena);
}
