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
IN_LOOPS void advance(mcp_asdf_arena_t *arena, uint32_t i, double time)
{
    arena->x[i] += arena->vx[i] * time;
    arena->y[i] += arena->vy[i] * time;
}

/* Angle of body i's turn in a whole tick: one part of it with the spin it had, the rest with the wanted one,
 * because the motors are strong enough to reach any spin within a part. */
IN_LOOPS double turning(const mcp_asdf_arena_t *arena, uint32_t i)
{
    return (arena->spin[i] + (PARTS - 1) * arena->wanted_spin[i]) * arena->part;
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
        const uint32_t i = crowd->member[m];
        arena_rotate(&arena->cx[i], &arena->cy[i], turning(arena, i));
        arena->spin[i] = arena->wanted_spin[i];
    }
}

/* Bodies that move on their own but do not just go on, of one arena or several. */
typedef struct {
    uint32_t count;
    mcp_asdf_arena_t *arena[AT_ONCE];
    uint32_t robot[AT_ONCE];
    double x[AT_ONCE], y[AT_ONCE], vx[AT_ONCE], vy[AT_ONCE], wanted_x[AT_ONCE], wanted_y[AT_ONCE];
    double part[AT_ONCE], limit[AT_ONCE], parts_left[AT_ONCE];
    double cx[AT_ONCE], cy[AT_ONCE], angle[AT_ONCE];
} loners_t;

/* A part of the tick: bodies move, and the motors bring each velocity closer to the wanted one, by at most
 * its limit; those that have it wait. Returns how many do not have it yet. */
IN_LOOPS uint64_t drive(loners_t *l)
{
    uint64_t driving = 0;
    SIDE_BY_SIDE
    for (uint32_t n = 0; n < l->count; ++n) {
        const bool drives = (l->vx[n] != l->wanted_x[n]) | (l->vy[n] != l->wanted_y[n]);
        const double dx = l->wanted_x[n] - l->vx[n], dy = l->wanted_y[n] - l->vy[n];
        const double change = dx * dx + dy * dy, squared = l->limit[n] * l->limit[n];
        const double share = change > squared ? l->limit[n] / sqrt(change) : 1;
        l->x[n] = drives ? l->x[n] + l->vx[n] * l->part[n] : l->x[n];
        l->y[n] = drives ? l->y[n] + l->vy[n] * l->part[n] : l->y[n];
        l->vx[n] = share < 1 ? l->vx[n] + share * dx : l->wanted_x[n];
        l->vy[n] = share < 1 ? l->vy[n] + share * dy : l->wanted_y[n];
        l->parts_left[n] -= drives ? 1 : 0;
        driving += share < 1 ? 1 : 0;
    }
    return driving;
}

/* The goal is along the heading at the start of the tick, although the heading changes during it. Once it is
 * reached, the remaining parts are one. */
FOR_EACH_TARGET static void move_loners(loners_t *l)
{
    for (uint32_t n = 0; n < l->count; ++n) {
        const mcp_asdf_arena_t *const arena = l->arena[n];
        const uint32_t i = l->robot[n];
        l->x[n] = arena->x[i];
        l->y[n] = arena->y[i];
        l->vx[n] = arena->vx[i];
        l->vy[n] = arena->vy[i];
        l->wanted_x[n] = arena->wanted_speed[i] * arena->cx[i];
        l->wanted_y[n] = arena->wanted_speed[i] * arena->cy[i];
        l->part[n] = arena->part;
        l->limit[n] = arena->motor;
        l->parts_left[n] = PARTS;
        l->cx[n] = arena->cx[i];
        l->cy[n] = arena->cy[i];
        l->angle[n] = turning(arena, i);
    }
    for (int part = 0; part < PARTS && drive(l) != 0; ++part) {
    }
    SIDE_BY_SIDE
    for (uint32_t n = 0; n < l->count; ++n) {
        arena_rotate(&l->cx[n], &l->cy[n], l->angle[n]);
    }
    for (uint32_t n = 0; n < l->count; ++n) {
        mcp_asdf_arena_t *const arena = l->arena[n];
        const uint32_t i = l->robot[n];
        arena->x[i] = l->x[n] + l->vx[n] * (l->parts_left[n] * l->part[n]);
        arena->y[i] = l->y[n] + l->vy[n] * (l->parts_left[n] * l->part[n]);
        arena->vx[i] = l->vx[n];
        arena->vy[i] = l->vy[n];
        arena->cx[i] = l->cx[n];
        arena->cy[i] = l->cy[n];
        arena->spin[i] = arena->wanted_spin[i];
    }
    l->count = 0;
}

/* Move those of `count` bodies from `first` on that touch nothing and go on as they do, as move_loners()
 * does; mark the others as `left` unless they might touch something. Returns whether some might. */
FOR_EACH_TARGET static bool cruise(mcp_asdf_arena_t *arena, uint32_t first, uint32_t count,
                                   uint64_t *restrict left)
{
    double *restrict const x = arena->x + first, *restrict const y = arena->y + first;
    const double *const cx = arena->cx + first, *const cy = arena->cy + first;
    const double *const vx = arena->vx + first, *const vy = arena->vy + first;
    const double *const speed = arena->wanted_speed + first;
    const double *const spin = arena->spin + first, *const wanted_spin = arena->wanted_spin + first;
    const uint64_t *const may_touch = arena->may_touch + first;
    const double time = PARTS * arena->part;
    uint64_t crowded = 0;
    SIDE_BY_SIDE
    for (uint32_t i = 0; i < count; ++i) {
        const bool drives = (vx[i] != speed[i] * cx[i]) | (vy[i] != speed[i] * cy[i]) | (spin[i] != 0) |
                            (wanted_spin[i] != 0);
        const bool goes_on = (!drives) & (may_touch[i] == 0);
        x[i] = goes_on ? x[i] + vx[i] * time : x[i];
        y[i] = goes_on ? y[i] + vy[i] * time : y[i];
        left[i] = (drives & (may_touch[i] == 0)) != 0;
        crowded |= may_touch[i];
    }
    return crowded != 0;
}

/* Move the bodies of an arena that touch nothing and go on, and all that might touch something; list the
 * others. */
static void move_most(mcp_asdf_arena_t *arena, loners_t *loners)
{
    const uint32_t robots = arena->config.robots;
    bool crowded = false;
    for (uint32_t first = 0; first < robots; first += AT_ONCE) {
        uint64_t left[AT_ONCE] = {0};
        const uint32_t rest = robots - first, count = rest < AT_ONCE ? rest : AT_ONCE;
        crowded |= cruise(arena, first, WHOLE_VECTORS(count), left);
        for (uint32_t i = 0; i < count; ++i) {
            loners->arena[loners->count] = arena; /* written always, kept if left */
            loners->robot[loners->count] = first + i;
            loners->count += (uint32_t)left[i];
            if (loners->count == AT_ONCE) {
                move_loners(loners);
            }
        }
    }
    if (crowded) {
        move_crowd(arena);
    }
}

void arena_move(mcp_asdf_arena_t *arenas, uint32_t count)
{
    loners_t loners;
    loners.count = 0;
    for (uint32_t a = 0; a < count; ++a) {
        move_most(&arenas[a], &loners);
    }
    move_loners(&loners);
}
