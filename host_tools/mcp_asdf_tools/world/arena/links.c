/* Links between robots that receive from each other, and pairs near enough to see or touch each other. The
 * candidates for these are searched among all pairs once in several ticks only: a pair too far apart to
 * matter before the next search is left out, because no robot is faster than its wheels. Where robots are
 * many, a grid finds the candidates.
 */
#include "arena_private.h"

#define MAX_ROBOTS_WITHOUT_GRID 128 /* for up to so many, comparing all pairs is fastest */

/* Write all pairs whose centres are closer than `limit` metres to arena->candidates: (i, j) with i < j,
 * ordered by i and then by j. Returns their number. */
static uint32_t find_candidates_among_all(mcp_asdf_arena_t *arena, double limit)
{
    uint32_t count = 0;
    for (uint32_t i = 0; i < arena->config.robots; ++i) {
        for (uint32_t j = i + 1; j < arena->config.robots; ++j) {
            /* Every pair is written, and the next one overwrites it unless it is near: this takes no branch,
             * which a processor could not predict. */
            const bool is_near = squared_distance(arena, i, j) < limit * limit;
            arena->candidates[count] = (mcp_asdf_pair_t){(uint16_t)i, (uint16_t)j};
            count += is_near ? 1 : 0;
        }
    }
    return count;
}

/* ---- A grid for many robots ------------------------------------------------------------------------------
 */

/* Returns the number of cells of at least `cell_size` metres along a side, 1 .. max_cells. */
static uint32_t count_cells(double side, double cell_size, uint32_t max_cells)
{
    return (uint32_t)clamp(side / cell_size, 1, max_cells);
}

/* Returns the index of the cell in which a coordinate lies, among `cells` along a side whose middle is 0. */
static uint32_t cell_index(double coordinate, double side, uint32_t cells)
{
    return (uint32_t)clamp((coordinate / side + 0.5) * cells, 0, cells - 1);
}

/* Sort the robots into the cells of arena->grid, whose sides are above `limit` metres, so that a pair that is
 * closer lies in one cell or in two that touch. There are at most as many cells as robots.
 *
 * It is a counting sort: count the robots of each cell, sum the counts up to where the cells end in the
 * sorted list, and fill each cell from its end. Counts, ends and beginnings are in the same array in turn. */
static void sort_robots_into_cells(mcp_asdf_arena_t *arena, double limit)
{
    mcp_asdf_grid_t *const grid = &arena->grid;
    const double width = arena->config.width, height = arena->config.height;
    const uint32_t robots = arena->config.robots;
    /* The factor keeps a cell above the limit when the division by it is rounded. */
    const double cell_size = max_of(1.000001 * limit, sqrt(width * height / robots));
    grid->columns = count_cells(width, cell_size, robots);
    grid->rows = count_cells(height, cell_size, robots);
    const uint32_t cells = grid->columns * grid->rows;
    /* First the array has the number of robots in each cell. */
    memset(grid->first_of_cell, 0, cells * sizeof *grid->first_of_cell);
    for (uint32_t i = 0; i < robots; ++i) {
        const uint32_t row = cell_index(arena->y[i], height, grid->rows);
        const uint32_t column = cell_index(arena->x[i], width, grid->columns);
        grid->cell_of_robot[i] = row * grid->columns + column;
        ++grid->first_of_cell[grid->cell_of_robot[i]];
    }
    /* Then it has the end of each cell in the sorted list: the end of the cell before, and its number. */
    for (uint32_t cell = 1; cell < cells; ++cell) {
        grid->first_of_cell[cell] += grid->first_of_cell[cell - 1];
    }
    grid->first_of_cell[cells] = robots; /* where a cell behind the last one would begin */
    /* Each robot takes the last free entry of its cell, whose end so moves down. When all robots are in their
     * cells it is the beginning, and they are in ascending order, as they came in descending order. */
    for (uint32_t i = robots; i-- > 0;) {
        const uint32_t cell = grid->cell_of_robot[i];
        grid->robots_by_cell[--grid->first_of_cell[cell]] = (uint16_t)i;
    }
}

/* Append to arena->candidates the pairs of robot i with robots of higher numbers that are closer than `limit`
 * metres, in the cells of a row around its column: three cells or, at a wall, two. `count` is the number of
 * candidates so far; returns the number after that. */
static uint32_t add_candidates_of_row(mcp_asdf_arena_t *arena, uint32_t i, uint32_t row, double limit,
                                      uint32_t count)
{
    const mcp_asdf_grid_t *const grid = &arena->grid;
    const uint32_t column = grid->cell_of_robot[i] % grid->columns;
    const uint32_t first_column = column == 0 ? 0 : column - 1;
    const uint32_t last_column = column + 1 < grid->columns ? column + 1 : column;
    /* Cells of a row follow each other, and so do their robots. */
    const uint32_t first_cell = row * grid->columns + first_column;
    const uint32_t last_cell = row * grid->columns + last_column;
    for (uint32_t entry = grid->first_of_cell[first_cell]; entry < grid->first_of_cell[last_cell + 1];
         ++entry) {
        const uint32_t j = grid->robots_by_cell[entry];
        const bool is_candidate = (j > i) & (squared_distance(arena, i, j) < limit * limit);
        /* A branch could not be predicted: every pair is written, and the next one overwrites it unless it is
         * a candidate. */
        arena->candidates[count] = (mcp_asdf_pair_t){(uint16_t)i, (uint16_t)j};
        count += is_candidate ? 1 : 0;
    }
    return count;
}

/* Sort `count` pairs with the same first robot by their second robot, by insertion, as they are few. */
static void sort_by_second_robot(mcp_asdf_pair_t *pairs, uint32_t count)
{
    for (uint32_t sorted_count = 1; sorted_count < count; ++sorted_count) {
        const mcp_asdf_pair_t pair = pairs[sorted_count];
        uint32_t index = sorted_count; /* where the pair belongs; those above it make room */
        while (index > 0 && pairs[index - 1].b > pair.b) {
            pairs[index] = pairs[index - 1];
            --index;
        }
        pairs[index] = pair;
    }
}

/* Write all pairs whose centres are closer than `limit` metres to arena->candidates, as
 * find_candidates_among_all() does and in the same order, but search only cells that touch. Returns their
 * number. */
static uint32_t find_candidates_in_cells(mcp_asdf_arena_t *arena, double limit)
{
    const mcp_asdf_grid_t *const grid = &arena->grid;
    uint32_t count = 0;
    sort_robots_into_cells(arena, limit);
    for (uint32_t i = 0; i < arena->config.robots; ++i) {
        const uint32_t count_before = count; /* the pairs of robot i begin here */
        const uint32_t row = grid->cell_of_robot[i] / grid->columns;
        const uint32_t first_row = row == 0 ? 0 : row - 1;
        const uint32_t last_row = row + 1 < grid->rows ? row + 1 : row;
        for (uint32_t near_row = first_row; near_row <= last_row; ++near_row) {
            count = add_candidates_of_row(arena, i, near_row, limit, count);
        }
        sort_by_second_robot(arena->candidates + count_before, count - count_before);
    }
    return count;
}

/* ---- Links -----------------------------------------------------------------------------------------------
 */

/* Store for each robot the other robots of its candidate pairs: those of robot i in candidates_of, from entry
 * first_candidate[i] to below entry first_candidate[i + 1]. It is a counting sort of the pairs, each of which
 * counts for both of its robots. first_candidate has the lengths of the lists first, then their ends, and
 * last their beginnings. */
static void list_candidates_by_robot(mcp_asdf_arena_t *arena)
{
    const mcp_asdf_pair_t *const pairs = arena->candidates;
    uint32_t *const length_of_list = arena->first_candidate, *const end_of_list = length_of_list;
    const uint32_t robots = arena->config.robots;
    memset(length_of_list, 0, (robots + 1) * sizeof *length_of_list);
    for (uint32_t p = 0; p < arena->candidate_count; ++p) {
        ++length_of_list[pairs[p].a];
        ++length_of_list[pairs[p].b];
    }
    for (uint32_t i = 0; i < robots; ++i) {
        end_of_list[i + 1] += end_of_list[i]; /* its length, so far, plus the end of the list before it */
    }
    for (uint32_t p = 0; p < arena->candidate_count; ++p) {
        const uint16_t a = pairs[p].a, b = pairs[p].b;
        /* The end of a list moves down as it fills, and is its beginning when all are in their lists. */
        arena->candidates_of[--end_of_list[a]] = b;
        arena->candidates_of[--end_of_list[b]] = a;
    }
}

/* Search for the candidates, the pairs that could be linked, visible or touchable before the next search, and
 * store them in arena->candidates and, as lists by robot, in candidates_of. Starts the countdown to the next
 * search. */
static void find_candidates(mcp_asdf_arena_t *arena)
{
    const double limit = candidate_distance(&arena->config);
    arena->candidate_count = arena->config.robots <= MAX_ROBOTS_WITHOUT_GRID
                                 ? find_candidates_among_all(arena, limit)
                                 : find_candidates_in_cells(arena, limit);
    list_candidates_by_robot(arena);
    arena->ticks_to_search = TICKS_BETWEEN_SEARCHES;
}

/* Clear the pairs and sets of the tick before. Robots near a wall are marked in may_touch and in
 * needs_steering; in the latter those that turn or avoid something have been marked by their steering. */
FOR_EACH_TARGET static void reset_tick(mcp_asdf_arena_t *arena)
{
    const uint32_t robots = arena->config.robots;
    const double max_distance = arena->config.speed * arena->config.tick; /* of a body in this tick */
    /* Beyond these coordinates a body may touch a wall, or its sensors may see one. All coordinates are
     * counted from the centre of the arena. */
    const double touch_x = position_before_wall(arena->config.width, max_distance);
    const double touch_y = position_before_wall(arena->config.height, max_distance);
    const double see_x = position_before_wall(arena->config.width, SENSOR_REACH);
    const double see_y = position_before_wall(arena->config.height, SENSOR_REACH);
    const double *const x = arena->x, *const y = arena->y;
    uint64_t *const may_touch = arena->may_touch, *const needs_steering = arena->needs_steering;
    memset(arena->in_range, 0, robots * sizeof *arena->in_range);
    /* With | in place of ||, as vectors have no branches. */
    SIDE_BY_SIDE
    for (uint32_t i = 0; i < WHOLE_VECTORS(robots); ++i) {
        may_touch[i] = (fabs(x[i]) > touch_x) | (fabs(y[i]) > touch_y);
        needs_steering[i] |= (fabs(x[i]) > see_x) | (fabs(y[i]) > see_y);
    }
    arena->link_count = 0;
    arena->visible_count = 0;
    arena->touchable_count = 0;
}

/* Add `pair`, whose squared distance is `squared` (m^2), to the visible pairs and to the touchable ones if it
 * is near enough. Both robots of a visible pair are marked in needs_steering, of a touchable one in
 * may_touch. */
static void add_near_pair(mcp_asdf_arena_t *arena, mcp_asdf_pair_t pair, double squared)
{
    const double touching_limit = touching_distance(&arena->config);
    if (squared < SEEING_DISTANCE * SEEING_DISTANCE) {
        arena->needs_steering[pair.a] = arena->needs_steering[pair.b] = 1;
        arena->visible[arena->visible_count++] = pair;
    }
    if (squared < touching_limit * touching_limit) {
        arena->may_touch[pair.a] = arena->may_touch[pair.b] = 1;
        arena->touchable[arena->touchable_count++] = pair;
    }
}

/* Store in arena->links the candidates in range of each other; remove_blocked_links() removes some of them
 * later. Store in in_range, for each robot, the other robots in its range. Finds the visible and the
 * touchable pairs, too. */
static void classify_candidates(mcp_asdf_arena_t *arena)
{
    const double range = arena->config.range;
    const double near_distance = max_of(touching_distance(&arena->config), SEEING_DISTANCE);
    const mcp_asdf_pair_t *const candidates = arena->candidates;
    mcp_asdf_pair_t *const links = arena->links;
    const uint32_t count = arena->candidate_count;
    uint64_t *const in_range = arena->in_range;
    uint32_t link_count = 0;
    for (uint32_t p = 0; p < count; ++p) {
        const mcp_asdf_pair_t pair = candidates[p];
        const double squared = squared_distance(arena, pair.a, pair.b);
        const uint64_t is_in_range = squared < range * range; /* 1 or 0 */
        /* Every pair is written, and the next one overwrites it unless it is in range: about half are, which
         * no branch could predict. */
        links[link_count] = pair;
        link_count += (uint32_t)is_in_range;
        /* A set has 64 bits: robot j is bit j % 64, which other robots may share. A pair out of range sets no
         * bit. */
        in_range[pair.a] |= is_in_range << (pair.b % 64);
        in_range[pair.b] |= is_in_range << (pair.a % 64);
        if (squared < near_distance * near_distance) {
            add_near_pair(arena, pair, squared);
        }
    }
    arena->link_count = link_count;
}

/* Whether body k reaches into the line between the centres of i and j: its centre is beside the line, between
 * both ends, and nearer to it than a radius. */
static bool blocks_line(const mcp_asdf_arena_t *arena, uint32_t i, uint32_t j, uint32_t k)
{
    const double dx = arena->x[j] - arena->x[i], dy = arena->y[j] - arena->y[i];
    const double body_x = arena->x[k] - arena->x[i], body_y = arena->y[k] - arena->y[i];
    /* Where the body is along the line and across it. Both are multiplied by the length of the line, so that
     * no root is needed: the far end is at along = squared. */
    const double squared = dx * dx + dy * dy; /* length of the line */
    const double along = body_x * dx + body_y * dy, across = body_x * dy - body_y * dx;
    const bool is_between_ends = (along > 0) & (along < squared);
    const bool is_near_line = across * across < BODY_RADIUS * BODY_RADIUS * squared;
    return is_between_ends & is_near_line;
}

/* Whether a body is on the line between robots i and j. Bodies do not overlap, so one between two others is
 * closer to each than they are to each other, and in range of both. in_range has a set of bits for each
 * robot, which stand for the robots in its range. If two sets have no bit in common, there is no such body.
 * If they have one, which several robots may share, all robots in a candidate pair with i are tried. */
static bool is_blocked(const mcp_asdf_arena_t *arena, uint32_t i, uint32_t j)
{
    if ((arena->in_range[i] & arena->in_range[j]) == 0) {
        return false;
    }
    bool blocked = false;
    for (uint32_t k = arena->first_candidate[i]; k < arena->first_candidate[i + 1]; ++k) {
        blocked |= blocks_line(arena, i, j, arena->candidates_of[k]); /* j itself does not block */
    }
    return blocked;
}

/* Remove the links whose line a body blocks, and keep the order of the others. */
static void remove_blocked_links(mcp_asdf_arena_t *arena)
{
    uint32_t kept_count = 0; /* never above p: a link that is kept moves down or stays where it is */
    for (uint32_t p = 0; p < arena->link_count; ++p) {
        if (!is_blocked(arena, arena->links[p].a, arena->links[p].b)) {
            arena->links[kept_count++] = arena->links[p];
        }
    }
    arena->link_count = kept_count;
}

/* Find the links, and the visible and touchable pairs, of this tick among the candidates. ticks_to_search
 * counts the ticks down for which the candidates still hold; at 0 they are searched again first, as other
 * robots may have come near. */
void arena_find_links(mcp_asdf_arena_t *arena)
{
    if (arena->ticks_to_search == 0) {
        find_candidates(arena);
    } else {
        --arena->ticks_to_search;
    }
    reset_tick(arena);
    classify_candidates(arena);
    remove_blocked_links(arena);
}
