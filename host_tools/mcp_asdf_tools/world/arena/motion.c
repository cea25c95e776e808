/* Motion of bodies that cannot touch anything in this tick: the motors bring each to the velocity that its
 * wheels ask for, part by part of the tick. contacts.c moves the others.
 */
#include "arena_private.h"

/* Bring the velocity of body i closer to the wanted one, by at most `limit`. */
static void drive(mcp_asdf_arena_t *arena, uint32_t i, double wanted_x, double wanted_y, double limit)
{
    const double dx = wanted_x - arena->vx[i], dy = wanted_y - arena->vy[i], change = dx * dx + dy * dy;
    const double share = change > limit * limit ? limit / sqrt(change) : 1;
    arena->vx[i] = share < 1 ? arena->vx[i] + share * dx : wanted_x;
    arena->vy[i] = share < 1 ? arena->vy[i] + share * dy : wanted_y;
}

/* The goal is along the heading at the start of the tick, although the heading changes during it. Once it is
 * reached, the remaining parts are one. */
static void move_alone(mcp_asdf_arena_t *arena, uint32_t i)
{
    const double wanted_x = arena->wanted_speed[i] * arena->cx[i];
    const double wanted_y = arena->wanted_speed[i] * arena->cy[i];
    int part = 0;
    for (; part < PARTS && (arena->vx[i] != wanted_x || arena->vy[i] != wanted_y); ++part) {
        advance(arena, i, arena->part);
        drive(arena, i, wanted_x, wanted_y, arena->motor);
    }
    advance(arena, i, (PARTS - part) * arena->part);
    turn(arena, i);
}

void arena_move(mcp_asdf_arena_t *arena)
{
    bool crowded = false;
    for (uint32_t i = 0; i < arena->config.robots; ++i) {
        if (arena->may_touch[i]) {
            crowded = true;
        } else {
            move_alone(arena, i);
        }
    }
    if (crowded) {
        arena_move_crowd(arena);
    }
}
