/* Who is near whom: links between robots that hear each other, bodies near enough to be seen or touched. All
 * pairs are compared once in a while only; a pair too far apart to matter until the next time is skipped,
 * because no robot is faster than its wheels. Where robots are many, a grid finds the pairs to compare.
 */
#include "arena_private.h"

#define FEW 128 /* robots up to which comparing all pairs is fastest */

/* Pairs of all robots near enough, in ascending order. */
static uint32_t watch_all(mcp_asdf_arena_t *arena, double limit)
{
    uint32_t count = 0;
    for (uint32_t i = 0; i < arena->config.robots; ++i) {
        for (uint32_t j = i + 1; j < arena->config.robots; ++j) {
            /* Written always, kept if near: a branch here could not be predicted. */
            arena->watched[count] = (mcp_asdf_pair_t){(uint16_t)i, (uint16_t)j};
            count += squared_distance(arena, i, j) < limit * limit;
        }
    }
    return count;
}

/* ---- A grid for many robots ------------------------------------------------------------------------------
 */

static uint32_t cells_along(double side, double cell, uint32_t most)
{
    return (uint32_t)clamp(side / cell, 1, most);
}

/* Cell of a place among `cells` along a side whose middle is 0. */
static uint32_t cell_at(double place, double side, uint32_t cells)
{
    return (uint32_t)clamp((place / side + 0.5) * cells, 0, cells - 1);
}

/* Sort the robots into cells whose sides are above `limit`, by counting. The cells are no more than robots.
 */
static void fill_grid(mcp_asdf_arena_t *arena, double limit)
{
    mcp_asdf_grid_t *const grid = &arena->grid;
    const double width = arena->config.width, height = arena->config.height;
    const uint32_t robots = arena->config.robots;
    const double cell = larger(1.000001 * limit, sqrt(width * height / robots));
    grid->columns = cells_along(width, cell, robots);
    grid->rows = cells_along(height, cell, robots);
    const uint32_t cells = grid->columns * grid->rows;
    memset(grid->first, 0, cells * sizeof *grid->first);
    for (uint32_t i = 0; i < robots; ++i) {
        const uint32_t row = cell_at(arena->y[i], height, grid->rows);
        grid->cell[i] = row * grid->columns + cell_at(arena->x[i], width, grid->columns);
        ++grid->first[grid->cell[i]];
    }
    for (uint32_t c = 1; c < cells; ++c) {
        grid->first[c] += grid->first[c - 1]; /* the end of each cell */
    }
    grid->first[cells] = robots;
    for (uint32_t i = robots; i-- > 0;) { /* which moves to its beginning as it fills */
        grid->robots[--grid->first[grid->cell[i]]] = (uint16_t)i;
    }
}

/* List robot i's pairs with higher robots near enough of three cells or, at a wall, two in a row; returns how
 * many pairs there are now. */
static uint32_t watch_row(mcp_asdf_arena_t *arena, uint32_t i, uint32_t row, double limit, uint32_t count)
{
    const mcp_asdf_grid_t *const grid = &arena->grid;
    const uint32_t column = grid->cell[i] % grid->columns, start = row * grid->columns;
    const uint32_t from = column == 0 ? 0 : column - 1,
                   last = column + 1 < grid->columns ? column + 1 : column;
    for (uint32_t k = grid->first[start + from]; k < grid->first[start + last + 1]; ++k) {
        const uint32_t j = grid->robots[k];
        arena->watched[count] = (mcp_asdf_pair_t){(uint16_t)i, (uint16_t)j};
        count += (j > i) & (squared_distance(arena, i, j) < limit * limit);
    }
    return count;
}

/* Bring pairs of one robot into ascending order: they are few. */
static void sort_pairs(mcp_asdf_pair_t *pairs, uint32_t count)
{
    for (uint32_t p = 1; p < count; ++p) {
        const mcp_asdf_pair_t pair = pairs[p];
        uint32_t place = p;
        for (; place > 0 && pairs[place - 1].b > pair.b; --place) {
            pairs[place] = pairs[place - 1];
        }
        pairs[place] = pair;
    }
}

/* The same pairs as watch_all(), found by cells. */
static uint32_t watch_cells(mcp_asdf_arena_t *arena, double limit)
{
    const mcp_asdf_grid_t *const grid = &arena->grid;
    uint32_t count = 0;
    fill_grid(arena, limit);
    for (uint32_t i = 0; i < arena->config.robots; ++i) {
        const uint32_t row = grid->cell[i] / grid->columns, before = count;
        for (uint32_t r = row == 0 ? 0 : row - 1; r <= row + 1 && r < grid->rows; ++r) {
            count = watch_row(arena, i, r, limit, count);
        }
        sort_pairs(arena->watched + before, count - before);
    }
    return count;
}

/* ---- Links -----------------------------------------------------------------------------------------------
 */

/* The watched robots of each, from the pairs. */
static void list_watched(mcp_asdf_arena_t *arena)
{
    const mcp_asdf_pair_t *const pairs = arena->watched;
    uint32_t *const first = arena->first_around, robots = arena->config.robots;
    memset(first, 0, (robots + 1) * sizeof *first);
    for (uint32_t p = 0; p < arena->watched_count; ++p) {
        ++first[pairs[p].a];
        ++first[pairs[p].b];
    }
    for (uint32_t i = 0; i < robots; ++i) {
        first[i + 1] += first[i]; /* the end of each list, which moves to its beginning */
    }
    for (uint32_t p = 0; p < arena->watched_count; ++p) {
        arena->around[--first[pairs[p].a]] = pairs[p].b;
        arena->around[--first[pairs[p].b]] = pairs[p].a;
    }
}

/* List the pairs that could matter before the next look at all of them. */
static void watch(mcp_asdf_arena_t *arena)
{
    const double limit = watching_distance(&arena->config);
    arena->watched_count = arena->config.robots <= FEW ? watch_all(arena, limit) : watch_cells(arena, limit);
    list_watched(arena);
    arena->ticks_to_watch = TICKS_BETWEEN_LOOKS;
}

FOR_EACH_TARGET static void forget_pairs(mcp_asdf_arena_t *arena)
{
    const uint32_t robots = arena->config.robots;
    const double distance = arena->config.speed * arena->config.tick;
    const double touch_x = place_before_wall(arena->config.width, distance);
    const double touch_y = place_before_wall(arena->config.height, distance);
    const double see_x = place_before_wall(arena->config.width, SENSOR_REACH);
    const double see_y = place_before_wall(arena->config.height, SENSOR_REACH);
    const double *const x = arena->x, *const y = arena->y;
    uint64_t *const may_touch = arena->may_touch, *const looks = arena->looks;
    memset(arena->in_range, 0, robots * sizeof *arena->in_range);
    SIDE_BY_SIDE
    for (uint32_t i = 0; i < WHOLE_VECTORS(robots); ++i) {
        may_touch[i] = (fabs(x[i]) > touch_x) | (fabs(y[i]) > touch_y);
        looks[i] |= (fabs(x[i]) > see_x) | (fabs(y[i]) > see_y);
    }
    arena->link_count = arena->near_count = arena->close_count = 0;
}

static void note_near(mcp_asdf_arena_t *arena, mcp_asdf_pair_t pair, double squared)
{
    const double touching = touching_distance(&arena->config);
    if (squared < SEEING_DISTANCE * SEEING_DISTANCE) {
        arena->looks[pair.a] = arena->looks[pair.b] = 1;
        arena->near[arena->near_count++] = pair;
    }
    if (squared < touching * touching) {
        arena->may_touch[pair.a] = arena->may_touch[pair.b] = 1;
        arena->close[arena->close_count++] = pair;
    }
}

static void note_pairs(mcp_asdf_arena_t *arena)
{
    const double range = arena->config.range;
    const double matters = larger(touching_distance(&arena->config), SEEING_DISTANCE);
    const mcp_asdf_pair_t *const watched = arena->watched;
    mcp_asdf_pair_t *const links = arena->links;
    const uint32_t count = arena->watched_count;
    uint64_t *const in_range = arena->in_range;
    uint32_t linked = 0;
    for (uint32_t p = 0; p < count; ++p) {
        const double squared = squared_distance(arena, watched[p].a, watched[p].b);
        const uint64_t is_linked = squared < range * range;
        links[linked] = watched[p]; /* kept if so: half of them are, which no branch could predict */
        linked += (uint32_t)is_linked;
        in_range[watched[p].a] |= is_linked << watched[p].b % 64;
        in_range[watched[p].b] |= is_linked << watched[p].a % 64;
        if (squared < matters * matters) {
            note_near(arena, watched[p], squared);
        }
    }
    arena->link_count = linked;
}

/* Whether body k reaches into the line from i to j. */
static bool stands_between(const mcp_asdf_arena_t *arena, uint32_t i, uint32_t j, uint32_t k)
{
    const double dx = arena->x[j] - arena->x[i], dy = arena->y[j] - arena->y[i];
    const double mx = arena->x[k] - arena->x[i], my = arena->y[k] - arena->y[i];
    const double squared = dx * dx + dy * dy, along = mx * dx + my * dy, across = mx * dy - my * dx;
    return (along > 0) & (along < squared) & (across * across < BODY_RADIUS * BODY_RADIUS * squared);
}

/* Bodies do not overlap, so one between two others is closer to each than they are to each other: it is
 * in range of both, which the sets show without a doubt where they have no robot in common. */
static bool is_blocked(const mcp_asdf_arena_t *arena, uint32_t i, uint32_t j)
{
    if ((arena->in_range[i] & arena->in_range[j]) == 0) {
        return false;
    }
    bool blocked = false;
    for (uint32_t k = arena->first_around[i]; k < arena->first_around[i + 1]; ++k) {
        blocked |= stands_between(arena, i, j, arena->around[k]); /* j itself does not */
    }
    return blocked;
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
