/* Motion: bodies that cannot touch anything in a tick move on their own, all others together. In each substep
 * of a tick bodies move with their velocities; then motors, and contacts in turn with them, change the
 * velocities for the next substep. This is the method of the Chipmunk physics library, which ARGoS3 uses:
 * contacts push and rub, do not bounce, and leave the spins alone, because the motors hold those with far
 * more torque than friction has.
 */
#include "arena_private.h"

/* Numbers of ARGoS3's physics engine and its Khepera IV (docs/internals/arena.md). */
#define PASSES 10            /* of motors and contacts, in each substep */
#define FRICTION_ROBOTS 0.49 /* friction coefficient between two bodies */
#define FRICTION_WALL 0.07   /* friction coefficient between a body and a wall */

#define WALL (-1) /* in place of the second body of a contact */

/* Move body i for `time` seconds at its present velocity. */
IN_LOOPS void move_body(mcp_asdf_arena_t *arena, uint32_t i, double time)
{
    arena->x[i] += arena->vx[i] * time;
    arena->y[i] += arena->vy[i] * time;
}

/* Returns the angle by which body i turns in a tick, in radians: for one substep with its present spin, then
 * with the spin that the wheels ask for, because the motors are strong enough to reach any spin within a
 * substep. */
IN_LOOPS double turn_in_tick(const mcp_asdf_arena_t *arena, uint32_t i)
{
    return (arena->spin[i] + (SUBSTEPS - 1) * arena->target_spin[i]) * arena->substep;
}

/* List in *bodies the bodies that may touch something in this tick, in ascending order, with the velocities
 * that their wheels ask for: target_speed along the heading (cx, cy), its cosine and sine. */
static void collect_touching_bodies(const mcp_asdf_arena_t *arena, mcp_asdf_bodies_t *bodies)
{
    bodies->count = 0;
    for (uint32_t i = 0; i < arena->config.robots; ++i) {
        if (arena->may_touch[i]) {
            const uint32_t entry = bodies->count;
            bodies->robot[entry] = (uint16_t)i;
            bodies->target_vx[entry] = arena->target_speed[i] * arena->cx[i];
            bodies->target_vy[entry] = arena->target_speed[i] * arena->cy[i];
            ++bodies->count;
        }
    }
}

/* Append a contact to the list in *bodies. There is room for CONTACTS_PER_BODY contacts of each robot: as
 * many as fit around bodies of one size. A contact beyond that, which no arena has, is dropped. */
static void add_contact(const mcp_asdf_arena_t *arena, mcp_asdf_bodies_t *bodies, mcp_asdf_contact_t contact)
{
    if (bodies->contact_count < CONTACTS_PER_BODY * arena->config.robots) {
        bodies->contacts[bodies->contact_count++] = contact;
    }
}

/* Add a contact for each pair of bodies that are closer than `margin` to each other, edge to edge. */
static void find_robot_contacts(const mcp_asdf_arena_t *arena, mcp_asdf_bodies_t *bodies, double margin)
{
    const double squared_limit = (DIAMETER + margin) * (DIAMETER + margin);
    for (uint32_t p = 0; p < arena->touchable_count; ++p) {
        const uint32_t a = arena->touchable[p].a, b = arena->touchable[p].b;
        const double squared = squared_distance(arena, a, b);
        if (squared < squared_limit) {
            const double distance = sqrt(squared);
            const double dx = arena->x[b] - arena->x[a], dy = arena->y[b] - arena->y[a];
            add_contact(arena, bodies,
                        (mcp_asdf_contact_t){.a = (int)a,
                                             .b = (int)b,
                                             .normal_x = dx / distance,
                                             .normal_y = dy / distance,
                                             .gap = distance - DIAMETER});
        }
    }
}

/* Add a contact of body i with each wall that is closer than `margin`. */
static void find_wall_contacts(const mcp_asdf_arena_t *arena, mcp_asdf_bodies_t *bodies, uint32_t i,
                               double margin)
{
    const double x = arena->x[i], y = arena->y[i];
    const double gap_x = arena->config.width / 2 - BODY_RADIUS - fabs(x);
    const double gap_y = arena->config.height / 2 - BODY_RADIUS - fabs(y);
    if (gap_x < margin) { /* the wall in the east, or in the west */
        const double normal_x = x > 0 ? 1 : -1;
        add_contact(arena, bodies,
                    (mcp_asdf_contact_t){.a = (int)i, .b = WALL, .normal_x = normal_x, .gap = gap_x});
    }
    if (gap_y < margin) { /* the wall in the north, or in the south */
        const double normal_y = y > 0 ? 1 : -1;
        add_contact(arena, bodies,
                    (mcp_asdf_contact_t){.a = (int)i, .b = WALL, .normal_y = normal_y, .gap = gap_y});
    }
}

/* Find all contacts of this substep: what is nearer than two robots can come to each other in it. Walls come
 * last, so that no wall gives way where the passes end before all velocities have settled. */
static void find_contacts(const mcp_asdf_arena_t *arena, mcp_asdf_bodies_t *bodies)
{
    const double margin = 2 * arena->config.speed * arena->substep;
    bodies->contact_count = 0;
    find_robot_contacts(arena, bodies, margin);
    for (uint32_t entry = 0; entry < bodies->count; ++entry) {
        find_wall_contacts(arena, bodies, bodies->robot[entry], margin);
    }
}

/* One pass of the motors: they change velocities towards those that the wheels ask for. The changes of all
 * passes of a substep together are limited to arena->max_motor_change, so a pass undoes the change of the
 * ones before it and makes the new one. */
static void run_motors(mcp_asdf_arena_t *arena, mcp_asdf_bodies_t *bodies)
{
    const double limit = arena->max_motor_change;
    for (uint32_t entry = 0; entry < bodies->count; ++entry) {
        const uint32_t i = bodies->robot[entry];
        /* What all passes together would have to change for the body to reach its target velocity now: what
         * the passes before have changed, and what is left. It is shortened to the limit if it is longer. */
        double change_x = bodies->motor_change_x[entry] + bodies->target_vx[entry] - arena->vx[i];
        double change_y = bodies->motor_change_y[entry] + bodies->target_vy[entry] - arena->vy[i];
        const double squared = change_x * change_x + change_y * change_y;
        const double share = squared > limit * limit ? limit / sqrt(squared) : 1; /* of the change */
        change_x *= share;
        change_y *= share;
        /* This pass adds only what the passes before have not changed yet. */
        arena->vx[i] += change_x - bodies->motor_change_x[entry];
        arena->vy[i] += change_y - bodies->motor_change_y[entry];
        bodies->motor_change_x[entry] = change_x;
        bodies->motor_change_y[entry] = change_y;
    }
}

/* Change the velocities of body a and of body b, or of a alone at a wall (b < 0), by one pass over their
 * contact. If they approach each other so fast that a substep would more than close the gap, what is too much
 * is taken from their speed along the normal, which points from a to the other. Friction takes the speed at
 * which they slide along each other, but at most `friction` times the change along the normal. Each of two
 * bodies gets half of a change; at a wall the body gets all of it. The limits hold for the changes of all
 * passes of a substep together: *contact has these sums. */
static void resolve_contact(mcp_asdf_arena_t *arena, mcp_asdf_contact_t *contact)
{
    const int a = contact->a, b = contact->b;
    const bool is_wall = b < 0;
    const double share = is_wall ? 1 : 0.5; /* of each change of velocity, for body a */
    const double friction = is_wall ? FRICTION_WALL : FRICTION_ROBOTS;
    const double normal_x = contact->normal_x, normal_y = contact->normal_y;
    /* The velocity of a's centre relative to b's, and of a's surface relative to b's, along a tangent that is
     * the normal turned to the left. Where both bodies turn to the left, their surfaces move in opposite
     * directions, so that the spins add up; the motors hold those that the wheels ask for. */
    const double other_vx = is_wall ? 0 : arena->vx[b], other_vy = is_wall ? 0 : arena->vy[b];
    const double other_spin = is_wall ? 0 : arena->target_spin[b];
    const double surface_speed = BODY_RADIUS * (arena->target_spin[a] + other_spin);
    const double relative_vx = arena->vx[a] - other_vx;
    const double relative_vy = arena->vy[a] - other_vy;
    const double closing_speed = relative_vx * normal_x + relative_vy * normal_y;
    const double sliding_speed = relative_vy * normal_x - relative_vx * normal_y + surface_speed;
    /* normal_change and tangent_change are the sums over the passes of this substep. They are limited, not
     * what each pass changes: so a later pass may take back what was too much. */
    const double allowed_speed = contact->gap / arena->substep;
    const double new_normal_change =
        max_of(0, contact->normal_change + share * (closing_speed - allowed_speed));
    const double max_tangent_change = friction * new_normal_change;
    const double new_tangent_change =
        clamp(contact->tangent_change + share * sliding_speed, -max_tangent_change, max_tangent_change);
    /* What this pass changes, along the normal and across it, and then along x and y. */
    const double change_along = new_normal_change - contact->normal_change;
    const double change_across = new_tangent_change - contact->tangent_change;
    const double change_x = change_along * normal_x - change_across * normal_y;
    const double change_y = change_along * normal_y + change_across * normal_x;
    contact->normal_change = new_normal_change;
    contact->tangent_change = new_tangent_change;
    arena->vx[a] -= change_x;
    arena->vy[a] -= change_y;
    if (!is_wall) {
        arena->vx[b] += change_x;
        arena->vy[b] += change_y;
    }
}

/* Slow body i down to config.speed, in its direction, if contacts have pushed it faster: pairs that no robot
 * can close at this speed before the next search are left out of the candidates for links and contacts. */
static void limit_speed(mcp_asdf_arena_t *arena, uint32_t i)
{
    const double limit = arena->config.speed;
    const double squared = arena->vx[i] * arena->vx[i] + arena->vy[i] * arena->vy[i];
    if (squared > limit * limit) {
        const double share = limit / sqrt(squared);
        arena->vx[i] *= share;
        arena->vy[i] *= share;
    }
}

/* Change the velocities of the bodies to those of the next substep, by several passes of motors and contacts.
 * Contacts come after motors: what has not settled after the last pass leaves a body slow, not inside
 * another.
 */
static void change_velocities(mcp_asdf_arena_t *arena, mcp_asdf_bodies_t *bodies)
{
    memset(bodies->motor_change_x, 0, bodies->count * sizeof *bodies->motor_change_x);
    memset(bodies->motor_change_y, 0, bodies->count * sizeof *bodies->motor_change_y);
    for (int pass = 0; pass < PASSES; ++pass) {
        run_motors(arena, bodies);
        for (uint32_t c = 0; c < bodies->contact_count; ++c) {
            resolve_contact(arena, &bodies->contacts[c]);
        }
    }
    for (uint32_t entry = 0; entry < bodies->count; ++entry) {
        limit_speed(arena, bodies->robot[entry]);
    }
}

/* Move the bodies of an arena that may touch something for one tick, substep by substep, and turn them at its
 * end: contacts do not depend on headings. */
static void move_touching_bodies(mcp_asdf_arena_t *arena)
{
    mcp_asdf_bodies_t *const bodies = &arena->touching;
    collect_touching_bodies(arena, bodies);
    for (int substep = 0; substep < SUBSTEPS; ++substep) {
        for (uint32_t entry = 0; entry < bodies->count; ++entry) {
            move_body(arena, bodies->robot[entry], arena->substep);
        }
        find_contacts(arena, bodies);
        change_velocities(arena, bodies);
    }
    for (uint32_t entry = 0; entry < bodies->count; ++entry) {
        const uint32_t i = bodies->robot[entry];
        arena_rotate(&arena->cx[i], &arena->cy[i], turn_in_tick(arena, i));
        arena->spin[i] = arena->target_spin[i];
    }
}

/* A list of bodies that touch nothing in this tick but change their velocities or turn, of one arena or
 * several. Entry n of each array describes the n-th of `count` bodies.
 *   arena, robot              which body it is
 *   x .. vy, cx, cy           position, velocity, and heading as its cosine and sine
 *   target_vx, target_vy      velocity that the wheels ask for
 *   substep                   seconds in a substep
 *   max_change                maximum change of velocity in a substep
 *   substeps_left             substeps for which the body has not been moved yet: when motors have run, those
 *                             after it reached its target velocity
 *   turn                      angle by which it turns in the whole tick, in radians */
typedef struct {
    uint32_t count;
    mcp_asdf_arena_t *arena[BATCH];
    uint32_t robot[BATCH];
    double x[BATCH], y[BATCH], vx[BATCH], vy[BATCH], target_vx[BATCH], target_vy[BATCH];
    double substep[BATCH], max_change[BATCH], substeps_left[BATCH];
    double cx[BATCH], cy[BATCH], turn[BATCH];
} free_bodies_t;

/* Move the listed bodies for one substep, and let the motors change each velocity towards its target, by at
 * most the body's limit. A body that had its target velocity already waits: store_free_bodies() moves it for
 * all its remaining substeps at once. Returns how many bodies have not reached their target yet. */
IN_LOOPS uint64_t drive_free_bodies(free_bodies_t *bodies)
{
    uint64_t accelerating_count = 0;
    SIDE_BY_SIDE
    for (uint32_t n = 0; n < bodies->count; ++n) {
        const bool accelerates =
            (bodies->vx[n] != bodies->target_vx[n]) | (bodies->vy[n] != bodies->target_vy[n]);
        const double change_x = bodies->target_vx[n] - bodies->vx[n];
        const double change_y = bodies->target_vy[n] - bodies->vy[n];
        const double squared_change = change_x * change_x + change_y * change_y;
        const double max_change = bodies->max_change[n], squared_limit = max_change * max_change;
        /* The share of the change that the motors can make in a substep; 1 if it is within the limit. */
        const double share = squared_change > squared_limit ? max_change / sqrt(squared_change) : 1;
        const bool falls_short = share < 1;
        /* Moved by the velocity before the change. No branches, as vectors have none. */
        bodies->x[n] = accelerates ? bodies->x[n] + bodies->vx[n] * bodies->substep[n] : bodies->x[n];
        bodies->y[n] = accelerates ? bodies->y[n] + bodies->vy[n] * bodies->substep[n] : bodies->y[n];
        bodies->vx[n] = falls_short ? bodies->vx[n] + share * change_x : bodies->target_vx[n];
        bodies->vy[n] = falls_short ? bodies->vy[n] + share * change_y : bodies->target_vy[n];
        bodies->substeps_left[n] -= accelerates ? 1 : 0;
        accelerating_count += falls_short ? 1 : 0;
    }
    return accelerating_count;
}

/* Fill in all of the list but count, arena and robot, from the arenas of its bodies. None of the tick's
 * substeps has been made. The target velocity is along the heading at the start of the tick, although the
 * heading changes during it. */
IN_LOOPS void load_free_bodies(free_bodies_t *bodies)
{
    for (uint32_t n = 0; n < bodies->count; ++n) {
        const mcp_asdf_arena_t *const arena = bodies->arena[n];
        const uint32_t i = bodies->robot[n];
        bodies->x[n] = arena->x[i];
        bodies->y[n] = arena->y[i];
        bodies->vx[n] = arena->vx[i];
        bodies->vy[n] = arena->vy[i];
        bodies->target_vx[n] = arena->target_speed[i] * arena->cx[i];
        bodies->target_vy[n] = arena->target_speed[i] * arena->cy[i];
        bodies->substep[n] = arena->substep;
        bodies->max_change[n] = arena->max_motor_change;
        bodies->substeps_left[n] = SUBSTEPS;
        bodies->cx[n] = arena->cx[i];
        bodies->cy[n] = arena->cy[i];
        bodies->turn[n] = turn_in_tick(arena, i);
    }
}

/* Copy the free bodies on the list, at the end of their tick, back into their arenas: positions, velocities
 * and headings. A body that reached its target velocity before the last substep is first moved for the
 * substeps that it has left, all at once. Also stores the present spin of each body: the spin that its wheels
 * ask for. */
IN_LOOPS void store_free_bodies(const free_bodies_t *bodies)
{
    for (uint32_t n = 0; n < bodies->count; ++n) {
        mcp_asdf_arena_t *const arena = bodies->arena[n];
        const uint32_t i = bodies->robot[n];
        /* substeps_left is 0 for a body that accelerated to the end: this adds nothing then. */
        arena->x[i] = bodies->x[n] + bodies->vx[n] * (bodies->substeps_left[n] * bodies->substep[n]);
        arena->y[i] = bodies->y[n] + bodies->vy[n] * (bodies->substeps_left[n] * bodies->substep[n]);
        arena->vx[i] = bodies->vx[n];
        arena->vy[i] = bodies->vy[n];
        arena->cx[i] = bodies->cx[n];
        arena->cy[i] = bodies->cy[n];
        /* The motors have reached the spin within the first substep (turn_in_tick()). */
        arena->spin[i] = arena->target_spin[i];
    }
}

/* Move and turn the free bodies on the list for one tick, store them in their arenas, and empty the list. */
FOR_EACH_TARGET static void move_free_bodies(free_bodies_t *bodies)
{
    uint64_t accelerating_count = bodies->count; /* bodies that may not have reached their target velocity */
    load_free_bodies(bodies);
    /* Once all have reached it, store_free_bodies() moves them for the substeps that are left. */
    for (int substep = 0; substep < SUBSTEPS && accelerating_count != 0; ++substep) {
        accelerating_count = drive_free_bodies(bodies);
    }
    SIDE_BY_SIDE
    for (uint32_t n = 0; n < bodies->count; ++n) {
        arena_rotate(&bodies->cx[n], &bodies->cy[n], bodies->turn[n]);
    }
    store_free_bodies(bodies);
    bodies->count = 0;
}

/* Sort `count` bodies, from number `first` on, into three kinds, and move the first kind for one tick:
 *   cruising       touches nothing in this tick, keeps its velocity and does not turn
 *   free           touches nothing, but changes its velocity or turns: left to move_free_bodies()
 *   may touch      left to move_touching_bodies()
 * is_free[i] becomes 1 for each free body first + i, and 0 for all others. Returns whether any body may touch
 * something. Cruising bodies get the same bits as move_free_bodies() would give them, at less cost. */
FOR_EACH_TARGET static bool move_cruising_bodies(mcp_asdf_arena_t *arena, uint32_t first, uint32_t count,
                                                 uint64_t *restrict is_free)
{
    double *restrict const x = arena->x + first, *restrict const y = arena->y + first;
    const double *const cx = arena->cx + first, *const cy = arena->cy + first;
    const double *const vx = arena->vx + first, *const vy = arena->vy + first;
    const double *const speed = arena->target_speed + first;
    const double *const spin = arena->spin + first, *const target_spin = arena->target_spin + first;
    const uint64_t *const may_touch = arena->may_touch + first;
    const double tick = SUBSTEPS * arena->substep; /* in seconds */
    uint64_t some_may_touch = 0;                   /* 1 as soon as one body may touch something */
    SIDE_BY_SIDE
    for (uint32_t i = 0; i < count; ++i) {
        /* With | and & in place of || and &&, as vectors have no branches. */
        const bool changes_velocity = (vx[i] != speed[i] * cx[i]) | (vy[i] != speed[i] * cy[i]);
        const bool turns = (spin[i] != 0) | (target_spin[i] != 0);
        const bool changes_motion = changes_velocity | turns;
        const bool is_cruising = (!changes_motion) & (may_touch[i] == 0);
        x[i] = is_cruising ? x[i] + vx[i] * tick : x[i];
        y[i] = is_cruising ? y[i] + vy[i] * tick : y[i];
        is_free[i] = (changes_motion & (may_touch[i] == 0)) != 0;
        some_may_touch |= may_touch[i];
    }
    return some_may_touch != 0;
}

/* Move the bodies of an arena for one tick: first those that cruise, and at the end those that may touch
 * something. The rest, the free bodies, which touch nothing but change their velocity or turn, are appended
 * to the list `free_bodies`. Whenever it has BATCH bodies they are moved, and the list is empty again; those
 * on the list at the end are left to the caller. */
static void move_bodies_of(mcp_asdf_arena_t *arena, free_bodies_t *free_bodies)
{
    const uint32_t robots = arena->config.robots;
    bool some_may_touch = false;
    for (uint32_t first = 0; first < robots; first += BATCH) {
        uint64_t is_free[BATCH] = {0};
        const uint32_t robots_left = robots - first;
        const uint32_t count = robots_left < BATCH ? robots_left : BATCH;
        /* Entries behind the last robot, up to a whole vector, are computed too, and not used. */
        some_may_touch |= move_cruising_bodies(arena, first, WHOLE_VECTORS(count), is_free);
        for (uint32_t i = 0; i < count; ++i) {
            /* A branch could not be predicted: so every body is written behind the end of the list, and only
             * if it is free the end moves on. Otherwise the next body overwrites it. */
            free_bodies->arena[free_bodies->count] = arena;
            free_bodies->robot[free_bodies->count] = first + i;
            free_bodies->count += (uint32_t)is_free[i]; /* 1 or 0 */
            if (free_bodies->count == BATCH) {
                move_free_bodies(free_bodies);
            }
        }
    }
    if (some_may_touch) {
        move_touching_bodies(arena);
    }
}

/* Move all bodies of `count` arenas for one tick. The free ones, which touch nothing but change their
 * velocity or turn, are collected over all arenas, and moved many at a time, side by side. */
void arena_move(mcp_asdf_arena_t *arenas, uint32_t count)
{
    free_bodies_t free_bodies;
    free_bodies.count = 0;
    for (uint32_t a = 0; a < count; ++a) {
        move_bodies_of(&arenas[a], &free_bodies);
    }
    move_free_bodies(&free_bodies); /* those that are left on the list */
}
