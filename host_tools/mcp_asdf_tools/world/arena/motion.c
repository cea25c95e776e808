/* Motion: bodies that cannot touch anything in a tick move on their own, all others together. In each part of
 * a tick bodies move with their velocities; then motors, and contacts in turn with them, change the
 * velocities for the next part. This is the method of the Chipmunk physics library, which ARGoS3 uses:
 * contacts push and rub, do not bounce, and leave the spins alone, because the motors hold those with far
 * more torque than friction has.
 */
#include "arena_private.h"

#define PASSES 10 /* of motors and contacts, in each part */
#define FRICTION_ROBOTS 0.49
#define FRICTION_WALL 0.07

/* Move body i for `time` at its present velocity. */
static void advance(mcp_asdf_arena_t *arena, uint32_t i, double time)
{
    arena->x[i] += arena->vx[i] * time;
    arena->y[i] += arena->vy[i] * time;
}

/* Turn body i through a whole tick: one part of it with the spin it had, the rest with the wanted one,
 * because the motors are strong enough to reach any spin within a part. */
static void turn(mcp_asdf_arena_t *arena, uint32_t i)
{
    const double angle = (arena->spin[i] + (PARTS - 1) * arena->wanted_spin[i]) * arena->part;
    arena->spin[i] = arena->wanted_spin[i];
    if (angle != 0) {
        arena_rotate(&arena->cx[i], &arena->cy[i], angle);
    }
}

static void gather(const mcp_asdf_arena_t *arena, mcp_asdf_bodies_t *crowd)
{
    crowd->count = 0;
    for (uint32_t i = 0; i < arena->config.robots; ++i) {
        if (arena->may_touch[i]) {
            crowd->wanted_x[crowd->count] = arena->wanted_speed[i] * arena->cx[i];
            crowd->wanted_y[crowd->count] = arena->wanted_speed[i] * arena->cy[i];
            crowd->member[crowd->count++] = (uint16_t)i;
        }
    }
}

static void add_contact(const mcp_asdf_arena_t *arena, mcp_asdf_bodies_t *crowd, mcp_asdf_contact_t contact)
{
    if (crowd->contact_count < CONTACTS_OF_A_BODY * arena->config.robots) {
        crowd->contacts[crowd->contact_count++] = contact;
    }
}

static void touch_robots(const mcp_asdf_arena_t *arena, mcp_asdf_bodies_t *crowd, double margin)
{
    const double limit = (DIAMETER + margin) * (DIAMETER + margin);
    for (uint32_t p = 0; p < arena->close_count; ++p) {
        const uint32_t a = arena->close[p].a, b = arena->close[p].b;
        const double squared = squared_distance(arena, a, b);
        if (squared < limit) {
            const double d = sqrt(squared), dx = arena->x[b] - arena->x[a], dy = arena->y[b] - arena->y[a];
            add_contact(arena, crowd,
                        (mcp_asdf_contact_t){(int)a, (int)b, dx / d, dy / d, d - DIAMETER, 0, 0});
        }
    }
}

static void touch_walls(const mcp_asdf_arena_t *arena, mcp_asdf_bodies_t *crowd, uint32_t i, double margin)
{
    const double x = arena->x[i], y = arena->y[i];
    const double gap_x = arena->config.width / 2 - BODY_RADIUS - fabs(x);
    const double gap_y = arena->config.height / 2 - BODY_RADIUS - fabs(y);
    if (gap_x < margin) {
        add_contact(arena, crowd, (mcp_asdf_contact_t){(int)i, -1, x > 0 ? 1 : -1, 0, gap_x, 0, 0});
    }
    if (gap_y < margin) {
        add_contact(arena, crowd, (mcp_asdf_contact_t){(int)i, -1, 0, y > 0 ? 1 : -1, gap_y, 0, 0});
    }
}

/* Walls come last, so that no wall gives way where the passes end before everything has settled. */
static void find_contacts(const mcp_asdf_arena_t *arena, mcp_asdf_bodies_t *crowd)
{
    const double margin = 2 * arena->config.speed * arena->part;
    crowd->contact_count = 0;
    touch_robots(arena, crowd, margin);
    for (uint32_t m = 0; m < crowd->count; ++m) {
        touch_walls(arena, crowd, crowd->member[m], margin);
    }
}

/* One pass of the motors: towards the wanted velocities. Over all passes together they change a velocity by
 * at most what they can give in a part. */
static void drive_crowd(mcp_asdf_arena_t *arena, mcp_asdf_bodies_t *crowd)
{
    const double limit = arena->motor;
    for (uint32_t m = 0; m < crowd->count; ++m) {
        const uint32_t i = crowd->member[m];
        double gx = crowd->given_x[m] + crowd->wanted_x[m] - arena->vx[i];
        double gy = crowd->given_y[m] + crowd->wanted_y[m] - arena->vy[i];
        const double squared = gx * gx + gy * gy, share = squared > limit * limit ? limit / sqrt(squared) : 1;
        gx *= share;
        gy *= share;
        arena->vx[i] += gx - crowd->given_x[m];
        arena->vy[i] += gy - crowd->given_y[m];
        crowd->given_x[m] = gx;
        crowd->given_y[m] = gy;
    }
}

/* One pass of a contact: take away the approach that would close more than the gap, and rub against sliding
 * within the cone of friction. Two robots share each change, a wall takes none. */
static void resolve(mcp_asdf_arena_t *arena, mcp_asdf_contact_t *c)
{
    const int a = c->a, b = c->b;
    const double share = b < 0 ? 1 : 0.5, friction = b < 0 ? FRICTION_WALL : FRICTION_ROBOTS;
    const double spins = BODY_RADIUS * (arena->wanted_spin[a] + (b < 0 ? 0 : arena->wanted_spin[b]));
    const double rx = arena->vx[a] - (b < 0 ? 0 : arena->vx[b]);
    const double ry = arena->vy[a] - (b < 0 ? 0 : arena->vy[b]);
    const double closing = rx * c->nx + ry * c->ny, sliding = ry * c->nx - rx * c->ny + spins;
    const double push = larger(0, c->push + share * (closing - c->gap / arena->part));
    const double rub = clamp(c->rub + share * sliding, -friction * push, friction * push);
    const double along = push - c->push, across = rub - c->rub;
    const double dx = along * c->nx - across * c->ny, dy = along * c->ny + across * c->nx;
    c->push = push;
    c->rub = rub;
    arena->vx[a] -= dx;
    arena->vy[a] -= dy;
    if (b >= 0) {
        arena->vx[b] += dx;
        arena->vy[b] += dy;
    }
}

/* No body may be pushed faster than it can drive: links.c relies on it. */
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

/* Contacts come after motors: what has not settled after the last pass leaves a body slow, not inside
 * another.
 */
static void settle_velocities(mcp_asdf_arena_t *arena, mcp_asdf_bodies_t *crowd)
{
    memset(crowd->given_x, 0, crowd->count * sizeof *crowd->given_x);
    memset(crowd->given_y, 0, crowd->count * sizeof *crowd->given_y);
    for (int pass = 0; pass < PASSES; ++pass) {
        drive_crowd(arena, crowd);
        for (uint32_t c = 0; c < crowd->contact_count; ++c) {
            resolve(arena, &crowd->contacts[c]);
        }
    }
    for (uint32_t m = 0; m < crowd->count; ++m) {
        limit_speed(arena, crowd->member[m]);
    }
}

static void move_crowd(mcp_asdf_arena_t *arena)
{
    mcp_asdf_bodies_t *const crowd = &arena->crowd;
    gather(arena, crowd);
    for (int part = 0; part < PARTS; ++part) {
        for (uint32_t m = 0; m < crowd->count; ++m) {
            advance(arena, crowd->member[m], arena->part);
        }
        find_contacts(arena, crowd);
        settle_velocities(arena, crowd);
    }
    for (uint32_t m = 0; m < crowd->count; ++m) {
        turn(arena, crowd->member[m]);
    }
}

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

/* Move those of `count` bodies from `first` on that go on as they do, as move_alone() does; the others are
 * left. */
FOR_EACH_TARGET static void cruise(mcp_asdf_arena_t *arena, uint32_t first, uint32_t count,
                                   uint64_t *restrict left)
{
    double *restrict const x = arena->x + first, *restrict const y = arena->y + first;
    const double *const cx = arena->cx + first, *const cy = arena->cy + first;
    const double *const vx = arena->vx + first, *const vy = arena->vy + first;
    const double *const speed = arena->wanted_speed + first;
    const double *const spin = arena->spin + first, *const wanted_spin = arena->wanted_spin + first;
    const uint64_t *const may_touch = arena->may_touch + first;
    const double time = PARTS * arena->part;
    SIDE_BY_SIDE
    for (uint32_t i = 0; i < count; ++i) {
        const bool goes_on = (vx[i] == speed[i] * cx[i]) & (vy[i] == speed[i] * cy[i]) & (spin[i] == 0) &
                             (wanted_spin[i] == 0) & (may_touch[i] == 0);
        x[i] = goes_on ? x[i] + vx[i] * time : x[i];
        y[i] = goes_on ? y[i] + vy[i] * time : y[i];
        left[i] = goes_on ? 0 : 1;
    }
}

void arena_move(mcp_asdf_arena_t *arena)
{
    bool crowded = false;
    for (uint32_t first = 0; first < arena->config.robots; first += AT_ONCE) {
        uint64_t left[AT_ONCE] = {0};
        const uint32_t rest = arena->config.robots - first, count = rest < AT_ONCE ? rest : AT_ONCE;
        cruise(arena, first, WHOLE_VECTORS(count), left);
        for (uint32_t i = 0; i < count; ++i) {
            if (left[i] == 0) {
                continue;
            }
            if (arena->may_touch[first + i]) {
                crowded = true;
            } else {
                move_alone(arena, first + i);
            }
        }
    }
    if (crowded) {
        move_crowd(arena);
    }
}
