#include "arena.h"

#include <math.h>
#include <stddef.h>
#include <string.h>

#if defined(__clang__)
#pragma STDC FP_CONTRACT OFF
#endif

#define MAX_SIDE 1000.0
#define MAX_TILES 100000.0 /* along a side, so that their numbers fit 32 bits */
#define MAX_SPEED 0.814
#define BODY_RADIUS 0.0704
#define WHEEL_DISTANCE 0.1054
#define SENSOR_REACH 0.12 /* from the body's edge */
#define PI 3.14159265358979323846
#define DEGREE (PI / 180)
#define HALF_ROOT 0.70710678118654752440
#define TAN_5_DEGREES 0.08748866352592400522
#define WEAK 0.1 /* an obstacle vector ahead that is shorter is ignored */
#define SENSORS 8
#define SENSOR_FORWARD 0.0614 /* of the ground sensor, from the centre */
#define SENSOR_RIGHT 0.01

/* Bodies are moved in parts of a tick, with a few passes over contacts and motors in each. */
#define PARTS 10
#define PASSES 10
#define ACCELERATION (1.5 / 0.4) /* of the motors: 1.5 N on 0.4 kg */
#define LARGEST_TURN 1.6         /* in a tick, for rotate() */
#define FRICTION_ROBOTS 0.49
#define FRICTION_WALL 0.07

#define TICKS_BETWEEN_LOOKS 12
#define PLACING_ATTEMPTS 100000
#define DIAMETER (2 * BODY_RADIUS)
#define MAX_CONTACTS                                                                                         \
    (5 * MCP_ASDF_ARENA_MAX_ROBOTS) /* a body has room for six others around it, and two walls */

/* ---------------------------------------------------------------- random numbers */

static uint64_t mix(uint64_t z)
{
    z = (z ^ (z >> 30)) * 0xBF58476D1CE4E5B9U;
    z = (z ^ (z >> 27)) * 0x94D049BB133111EBU;
    return z ^ (z >> 31);
}

/* The generator splitmix64: a counter through a mixer. In [0, 1), 53 bits. */
static double uniform(uint64_t *counter)
{
    *counter += 0x9E3779B97F4A7C15U;
    return (double)(mix(*counter) >> 11) * 0x1p-53;
}

/* ---------------------------------------------------------------- geometry without a mathematics library */

static double larger(double a, double b) { return a > b ? a : b; }

static double smaller(double a, double b) { return a < b ? a : b; }

static double clamp(double value, double low, double high) { return larger(low, smaller(high, value)); }

/* 1 / n, for series: dividing in them would cost more than all else. */
static const double INVERSE[] = {0,       1,       1. / 2,  1. / 3,  1. / 4,  1. / 5,  1. / 6,  1. / 7,
                                 1. / 8,  1. / 9,  1. / 10, 1. / 11, 1. / 12, 1. / 13, 1. / 14, 1. / 15,
                                 1. / 16, 1. / 17, 1. / 18, 1. / 19, 1. / 20, 1. / 21};

/* Rotate (*cx, *cy) by an angle of at most LARGEST_TURN and keep its length 1; series up to a^17, wrong by
 * 1e-13 at most. */
static void rotate(double *cx, double *cy, double angle)
{
    const double q = angle * angle;
    double sine = 1, cosine = 1;
    for (int n = 17; n >= 3; n -= 2) {
        sine = 1 - sine * q * (INVERSE[n] * INVERSE[n - 1]);
        cosine = 1 - cosine * q * (INVERSE[n - 1] * INVERSE[n - 2]);
    }
    sine *= angle;
    const double x = *cx * cosine - *cy * sine, y = *cx * sine + *cy * cosine;
    const double scale = 1.5 - 0.5 * (x * x + y * y);
    *cx = x * scale;
    *cy = y * scale;
}

/* Arc tangent of z in [0, 1]: two halvings of the angle bring it below 0.2, where a series is good to 1e-16.
 */
static double arc_tangent(double z)
{
    for (int halving = 0; halving < 2; halving++) {
        z = z / (1 + sqrt(1 + z * z));
    }
    const double q = z * z;
    double sum = 0;
    for (int n = 21; n >= 1; n -= 2) {
        sum = INVERSE[n] - q * sum;
    }
    return 4 * z * sum;
}

/* Unsigned angle of (x, y) from straight ahead, in [0, pi]. */
static double bearing(double x, double y)
{
    const double along = fabs(x), across = fabs(y);
    const double acute = across < along ? arc_tangent(across / along) : PI / 2 - arc_tangent(along / across);
    return x < 0 ? PI - acute : acute;
}

static void set_bit(uint64_t mask[2], uint32_t bit) { mask[bit >> 6] |= (uint64_t)1 << (bit & 63); }

/* Takes the lowest set bit out and returns its number; -1 if there is none. */
static int take_bit(uint64_t mask[2])
{
    for (int word = 0; word < 2; word++) {
        if (mask[word] == 0) {
            continue;
        }
        uint64_t low = mask[word] & (~mask[word] + 1);
        mask[word] ^= low;
        int bit = 64 * word;
        for (int half = 32; half > 0; half >>= 1) {
            if (low >> half) {
                low >>= half;
                bit += half;
            }
        }
        return bit;
    }
    return -1;
}

static double squared_distance(const mcp_asdf_arena_t *arena, uint32_t i, uint32_t j)
{
    const double dx = arena->x[j] - arena->x[i], dy = arena->y[j] - arena->y[i];
    return dx * dx + dy * dy;
}

/* ---------------------------------------------------------------- floor */

static int pixel(const mcp_asdf_arena_config_t *config, double x, double y)
{
    const double across = (x / config->width + 0.5) * config->columns,
                 down = (0.5 - y / config->height) * config->rows;
    const uint32_t column = across > 0 ? (uint32_t)across : 0, row = down > 0 ? (uint32_t)down : 0;
    const uint32_t last_column = config->columns - 1, last_row = config->rows - 1;
    return config->image[(size_t)(row < last_row ? row : last_row) * config->columns +
                         (column < last_column ? column : last_column)] != 0;
}

int mcp_asdf_arena_is_black(const mcp_asdf_arena_t *arena, double x, double y)
{
    const mcp_asdf_arena_config_t *config = &arena->config;
    if (config->image != NULL) {
        return pixel(config, x, y);
    }
    /* By way of signed numbers, for which processors have an instruction. */
    const uint64_t column = (uint64_t)(int64_t)((x + config->width / 2) * arena->tiles_per_metre);
    const uint64_t row = (uint64_t)(int64_t)((y + config->height / 2) * arena->tiles_per_metre);
    return (double)(mix(arena->colours + (column << 32 | row)) >> 11) < arena->colour_limit;
}

static void look_down(mcp_asdf_arena_t *arena, uint32_t i)
{
    const double cx = arena->cx[i], cy = arena->cy[i];
    arena->black[i] =
        (uint8_t)mcp_asdf_arena_is_black(arena, arena->x[i] + SENSOR_FORWARD * cx + SENSOR_RIGHT * cy,
                                         arena->y[i] + SENSOR_FORWARD * cy - SENSOR_RIGHT * cx);
}

/* ---------------------------------------------------------------- proximity sensors */

/* exp(-x) for x in [0, 4] as the 16th power of a series; relative error below 1e-12. */
static double fading(double x)
{
    const double part = x / 16;
    double sum = 1;
    for (int n = 10; n >= 1; n--) {
        sum = 1 - sum * part * INVERSE[n];
    }
    sum *= sum;
    sum *= sum;
    sum *= sum;
    return sum * sum;
}

double mcp_asdf_arena_reading(double distance)
{
    if (distance < 0.04) {
        return 1;
    }
    if (distance > SENSOR_REACH) {
        return 0;
    }
    return clamp(4.14 * fading(33 * distance) - 0.085, 0, 1);
}

/* Directions of the sensors in the robot's own frame, from ahead to the left and around. */
static const double AHEAD[SENSORS] = {1, HALF_ROOT, 0, -HALF_ROOT, -1, -HALF_ROOT, 0, HALF_ROOT};
static const double LEFT[SENSORS] = {0, HALF_ROOT, 1, HALF_ROOT, 0, -HALF_ROOT, -1, -HALF_ROOT};

/* The same on the floor, if the robot heads to (cx, cy). */
static void directions(double cx, double cy, double dx[SENSORS], double dy[SENSORS])
{
    for (int k = 0; k < SENSORS; k++) {
        dx[k] = cx * AHEAD[k] - cy * LEFT[k];
        dy[k] = cx * LEFT[k] + cy * AHEAD[k];
    }
}

/* Shorten the free distances along the rays by a body at (mx, my) from the robot's centre. Tells whether any
 * ray meets it within reach. */
static uint8_t see_body(double mx, double my, const double dx[SENSORS], const double dy[SENSORS],
                        double *clear)
{
    const double radius_squared = BODY_RADIUS * BODY_RADIUS;
    uint8_t seen = 0;
    for (int k = 0; k < SENSORS; k++) {
        const double along = mx * dx[k] + my * dy[k],
                     inside = radius_squared - (mx * mx + my * my - along * along);
        if (along <= 0 || inside < 0) {
            continue;
        }
        const double distance = along - BODY_RADIUS - sqrt(inside);
        seen |= distance <= SENSOR_REACH;
        if (distance < clear[k]) {
            clear[k] = distance;
        }
    }
    return seen;
}

/* The same for the two walls across one axis, `room` from the centre in both directions, the robot at
 * `place`. */
static void see_walls(double room, double place, const double direction[SENSORS], double *clear)
{
    const double reach = BODY_RADIUS + SENSOR_REACH;
    if (fabs(place) < room - reach) {
        return;
    }
    for (int k = 0; k < SENSORS; k++) {
        const double gap = direction[k] > 0 ? room - place : room + place, slope = fabs(direction[k]);
        if (gap < reach * slope && gap / slope - BODY_RADIUS < clear[k]) {
            clear[k] = gap / slope - BODY_RADIUS;
        }
    }
}

void mcp_asdf_arena_obstacle(const mcp_asdf_arena_t *arena, uint32_t robot, double *ahead, double *left,
                             uint8_t *sees_robot)
{
    double dx[SENSORS], dy[SENSORS], clear[SENSORS];
    uint64_t near[2] = {arena->near[robot][0], arena->near[robot][1]};
    const double x = arena->x[robot], y = arena->y[robot];
    directions(arena->cx[robot], arena->cy[robot], dx, dy);
    for (int k = 0; k < SENSORS; k++) {
        clear[k] = 2 * SENSOR_REACH;
    }
    *sees_robot = 0;
    for (int j = take_bit(near); j >= 0; j = take_bit(near)) {
        *sees_robot |= see_body(arena->x[j] - x, arena->y[j] - y, dx, dy, clear);
    }
    see_walls(arena->config.width / 2, x, dx, clear);
    see_walls(arena->config.height / 2, y, dy, clear);
    *ahead = *left = 0;
    for (int k = 0; k < SENSORS; k++) {
        if (clear[k] <= SENSOR_REACH) {
            const double reading = mcp_asdf_arena_reading(clear[k]);
            *ahead += reading * AHEAD[k];
            *left += reading * LEFT[k];
        }
    }
}

/* ---------------------------------------------------------------- wheels */

/* The wheels' state that follows on `state` for a heading `angle` away, with the two thresholds of a hard
 * turn. Exactly 90 degrees is what a side sensor alone gives, so it is no rare tie; it came out as beyond in
 * the simulation that the model is compared with. */
static uint8_t next_wheels(uint8_t state, double angle)
{
    if (angle >= PI / 2 || (state == MCP_ASDF_HARD_TURN && angle > 70 * DEGREE)) {
        return MCP_ASDF_HARD_TURN;
    }
    return angle > 10 * DEGREE ? MCP_ASDF_SOFT_TURN : MCP_ASDF_STRAIGHT;
}

void mcp_asdf_arena_steer(mcp_asdf_arena_t *arena, uint32_t robot, double ahead, double left)
{
    const int weak = ahead * ahead + left * left < WEAK * WEAK && fabs(left) <= ahead * TAN_5_DEGREES;
    const double speed = arena->config.speed, angle = weak ? 0 : bearing(-ahead, -left);
    const uint8_t wheels = next_wheels(arena->wheels[robot], angle);
    double inner = speed;
    if (wheels == MCP_ASDF_HARD_TURN) {
        inner = -speed;
    } else if (wheels == MCP_ASDF_SOFT_TURN) {
        inner = speed * (1 - angle / (PI / 2));
    }
    arena->avoids[robot] = !weak;
    arena->wheels[robot] = wheels;
    arena->wanted_speed[robot] = (speed + inner) / 2;
    /* The turn is away from what is on the left, so to the right, unless it is on the right. */
    arena->wanted_spin[robot] = (left < 0 ? speed - inner : inner - speed) / WHEEL_DISTANCE;
}

static int wall_within(const mcp_asdf_arena_t *arena, uint32_t i, double distance)
{
    const double margin = BODY_RADIUS + distance;
    return fabs(arena->x[i]) > arena->config.width / 2 - margin ||
           fabs(arena->y[i]) > arena->config.height / 2 - margin;
}

static void look_around(mcp_asdf_arena_t *arena, uint32_t i)
{
    double ahead = 0, left = 0;
    arena->sees_robot[i] = 0;
    if ((arena->near[i][0] | arena->near[i][1]) != 0 || wall_within(arena, i, SENSOR_REACH)) {
        mcp_asdf_arena_obstacle(arena, i, &ahead, &left, &arena->sees_robot[i]);
    } else if (arena->wheels[i] == MCP_ASDF_STRAIGHT && !arena->avoids[i]) {
        return; /* as most often: the wheels are set already */
    }
    mcp_asdf_arena_steer(arena, i, ahead, left);
}

/* ---------------------------------------------------------------- motion */

/* Bring a robot's velocity towards the wanted one by at most `limit`. */
static void drive(mcp_asdf_arena_t *arena, uint32_t i, double wanted_x, double wanted_y, double limit)
{
    const double dx = wanted_x - arena->vx[i], dy = wanted_y - arena->vy[i], change = dx * dx + dy * dy;
    const double share = change > limit * limit ? limit / sqrt(change) : 1;
    arena->vx[i] = share < 1 ? arena->vx[i] + share * dx : wanted_x;
    arena->vy[i] = share < 1 ? arena->vy[i] + share * dy : wanted_y;
}

static void advance(mcp_asdf_arena_t *arena, uint32_t i, double time)
{
    arena->x[i] += arena->vx[i] * time;
    arena->y[i] += arena->vy[i] * time;
}

/* The motors' goal for this tick: along the heading at its start, though the heading changes during it. The
 * body turns for one part of the tick as before; the motors are strong enough for any turn. */
static void turn(mcp_asdf_arena_t *arena, uint32_t i)
{
    const double angle = (arena->spin[i] + (PARTS - 1) * arena->wanted_spin[i]) * arena->part;
    arena->spin[i] = arena->wanted_spin[i];
    if (angle != 0) {
        rotate(&arena->cx[i], &arena->cy[i], angle);
    }
}

static void move_alone(mcp_asdf_arena_t *arena, uint32_t i)
{
    const double wanted_x = arena->wanted_speed[i] * arena->cx[i],
                 wanted_y = arena->wanted_speed[i] * arena->cy[i];
    int part = 0;
    for (; part < PARTS && (arena->vx[i] != wanted_x || arena->vy[i] != wanted_y); part++) {
        advance(arena, i, arena->part);
        drive(arena, i, wanted_x, wanted_y, arena->motor);
    }
    advance(arena, i, (PARTS - part) * arena->part);
    turn(arena, i);
}

/* A place where a body may touch another (b) or a wall (b < 0) within a part: normal from a, gap left, and
 * the changes of velocity along the normal and across it that have been given so far. */
struct contact {
    int a, b;
    double nx, ny, gap, push, rub;
};

/* The bodies that may touch something, where their motors want them to go, and what the motors have given so
 * far. */
struct crowd {
    uint32_t count, contact_count;
    uint8_t member[MCP_ASDF_ARENA_MAX_ROBOTS];
    double wanted_x[MCP_ASDF_ARENA_MAX_ROBOTS], wanted_y[MCP_ASDF_ARENA_MAX_ROBOTS],
        given_x[MCP_ASDF_ARENA_MAX_ROBOTS], given_y[MCP_ASDF_ARENA_MAX_ROBOTS];
    struct contact contacts[MAX_CONTACTS];
};

static void gather(const mcp_asdf_arena_t *arena, struct crowd *crowd)
{
    crowd->count = 0;
    for (uint32_t i = 0; i < arena->config.robots; i++) {
        if (arena->may_touch[i]) {
            crowd->wanted_x[crowd->count] = arena->wanted_speed[i] * arena->cx[i];
            crowd->wanted_y[crowd->count] = arena->wanted_speed[i] * arena->cy[i];
            crowd->member[crowd->count++] = (uint8_t)i;
        }
    }
}

static void add_contact(struct crowd *crowd, struct contact contact)
{
    if (crowd->contact_count < MAX_CONTACTS) {
        crowd->contacts[crowd->contact_count++] = contact;
    }
}

static void touch_walls(const mcp_asdf_arena_t *arena, struct crowd *crowd, uint32_t i, double margin)
{
    const double x = arena->x[i], y = arena->y[i];
    const double gap_x = arena->config.width / 2 - BODY_RADIUS - fabs(x);
    const double gap_y = arena->config.height / 2 - BODY_RADIUS - fabs(y);
    if (gap_x < margin) {
        add_contact(crowd, (struct contact){(int)i, -1, x > 0 ? 1 : -1, 0, gap_x, 0, 0});
    }
    if (gap_y < margin) {
        add_contact(crowd, (struct contact){(int)i, -1, 0, y > 0 ? 1 : -1, gap_y, 0, 0});
    }
}

/* Walls last: where the passes of `settle_velocities` end undecided, it is not the wall that gives way. */
static void find_contacts(const mcp_asdf_arena_t *arena, struct crowd *crowd)
{
    const double margin = 2 * arena->config.speed * arena->part,
                 limit = (DIAMETER + margin) * (DIAMETER + margin);
    crowd->contact_count = 0;
    for (uint32_t p = 0; p < arena->close_count; p++) {
        const uint32_t a = arena->close[p].a, b = arena->close[p].b;
        const double squared = squared_distance(arena, a, b);
        if (squared >= limit) {
            continue;
        }
        const double d = sqrt(squared), dx = arena->x[b] - arena->x[a], dy = arena->y[b] - arena->y[a];
        add_contact(crowd, (struct contact){(int)a, (int)b, dx / d, dy / d, d - DIAMETER, 0, 0});
    }
    for (uint32_t m = 0; m < crowd->count; m++) {
        touch_walls(arena, crowd, crowd->member[m], margin);
    }
}

/* The motors' share of a pass: towards the wanted velocity, all passes together at most what they can give in
 * a part. */
static void drive_crowd(mcp_asdf_arena_t *arena, struct crowd *crowd)
{
    const double limit = arena->motor;
    for (uint32_t m = 0; m < crowd->count; m++) {
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

/* Take away the approach that would close more than the gap, and rub against sliding within the cone of
 * friction. Spins stay: the wheels hold them with far more torque than friction has. */
static void resolve(mcp_asdf_arena_t *arena, struct contact *c)
{
    const int a = c->a, b = c->b;
    const double share = b < 0 ? 1 : 0.5, friction = b < 0 ? FRICTION_WALL : FRICTION_ROBOTS;
    const double spins = BODY_RADIUS * (arena->wanted_spin[a] + (b < 0 ? 0 : arena->wanted_spin[b]));
    const double rx = arena->vx[a] - (b < 0 ? 0 : arena->vx[b]),
                 ry = arena->vy[a] - (b < 0 ? 0 : arena->vy[b]);
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

/* Nothing is pushed faster than it can drive, on which `watch` and `find_links` rely. */
static void limit_speed(mcp_asdf_arena_t *arena, uint32_t i)
{
    const double limit = arena->config.speed,
                 squared = arena->vx[i] * arena->vx[i] + arena->vy[i] * arena->vy[i];
    if (squared > limit * limit) {
        const double share = limit / sqrt(squared);
        arena->vx[i] *= share;
        arena->vy[i] *= share;
    }
}

/* Motors first, contacts last: what is not settled after the passes leaves a body slower, not inside another.
 */
static void settle_velocities(mcp_asdf_arena_t *arena, struct crowd *crowd)
{
    memset(crowd->given_x, 0, sizeof crowd->given_x);
    memset(crowd->given_y, 0, sizeof crowd->given_y);
    for (int pass = 0; pass < PASSES; pass++) {
        drive_crowd(arena, crowd);
        for (uint32_t c = 0; c < crowd->contact_count; c++) {
            resolve(arena, &crowd->contacts[c]);
        }
    }
    for (uint32_t m = 0; m < crowd->count; m++) {
        limit_speed(arena, crowd->member[m]);
    }
}

static void move_crowd(mcp_asdf_arena_t *arena)
{
    struct crowd crowd;
    gather(arena, &crowd);
    for (int part = 0; part < PARTS; part++) {
        for (uint32_t m = 0; m < crowd.count; m++) {
            advance(arena, crowd.member[m], arena->part);
        }
        find_contacts(arena, &crowd);
        settle_velocities(arena, &crowd);
    }
    for (uint32_t m = 0; m < crowd.count; m++) {
        turn(arena, crowd.member[m]);
    }
}

static void move_all(mcp_asdf_arena_t *arena)
{
    int crowded = 0;
    for (uint32_t i = 0; i < arena->config.robots; i++) {
        if (arena->may_touch[i]) {
            crowded = 1;
        } else {
            move_alone(arena, i);
        }
    }
    if (crowded) {
        move_crowd(arena);
    }
}

/* ---------------------------------------------------------------- who is near whom */

/* Distance of centres within which two bodies could meet in one tick. */
static double touching_distance(const mcp_asdf_arena_t *arena)
{
    return DIAMETER + 2 * arena->config.speed * arena->config.tick;
}

/* Distance of centres within which a sensor could see a body. */
#define SEEING_DISTANCE (DIAMETER + SENSOR_REACH)

/* List the pairs that could matter before the next such look, given how far two robots can come closer by
 * then. */
static void watch(mcp_asdf_arena_t *arena)
{
    const double matters = larger(arena->config.range, larger(touching_distance(arena), SEEING_DISTANCE));
    const double limit = matters + 2 * arena->config.speed * arena->config.tick * TICKS_BETWEEN_LOOKS;
    uint32_t count = 0;
    for (uint32_t i = 0; i < arena->config.robots; i++) {
        for (uint32_t j = i + 1; j < arena->config.robots; j++) {
            /* Written always, kept if near: without a branch, as chance decides it. */
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
    for (uint32_t i = 0; i < arena->config.robots; i++) {
        arena->in_range[i][0] = arena->in_range[i][1] = 0;
        arena->near[i][0] = arena->near[i][1] = 0;
        arena->may_touch[i] = (uint8_t)wall_within(arena, i, arena->config.speed * arena->config.tick);
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

/* Whether body k stands in the line from i to j. */
static int stands_between(const mcp_asdf_arena_t *arena, uint32_t i, uint32_t j, uint32_t k)
{
    const double dx = arena->x[j] - arena->x[i], dy = arena->y[j] - arena->y[i];
    const double mx = arena->x[k] - arena->x[i], my = arena->y[k] - arena->y[i];
    const double squared = dx * dx + dy * dy, along = mx * dx + my * dy, across = mx * dy - my * dx;
    return along > 0 && along < squared && across * across < BODY_RADIUS * BODY_RADIUS * squared;
}

/* Bodies do not overlap, so one between two others is nearer to each than they are to each other. */
static int is_blocked(const mcp_asdf_arena_t *arena, uint32_t i, uint32_t j)
{
    uint64_t both[2] = {arena->in_range[i][0] & arena->in_range[j][0],
                        arena->in_range[i][1] & arena->in_range[j][1]};
    for (int k = take_bit(both); k >= 0; k = take_bit(both)) {
        if (stands_between(arena, i, j, (uint32_t)k)) {
            return 1;
        }
    }
    return 0;
}

static void drop_blocked_links(mcp_asdf_arena_t *arena)
{
    uint32_t kept = 0;
    for (uint32_t p = 0; p < arena->link_count; p++) {
        if (!is_blocked(arena, arena->links[p].a, arena->links[p].b)) {
            arena->links[kept++] = arena->links[p];
        }
    }
    arena->link_count = kept;
}

static void find_links(mcp_asdf_arena_t *arena)
{
    const double range = arena->config.range, matters = larger(touching_distance(arena), SEEING_DISTANCE);
    if (arena->ticks_to_watch-- == 0) {
        watch(arena);
    }
    forget_pairs(arena);
    for (uint32_t p = 0; p < arena->watched_count; p++) {
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
    if (!arena->config.see_past) {
        drop_blocked_links(arena);
    }
}

/* ---------------------------------------------------------------- the whole */

static void look(mcp_asdf_arena_t *arena)
{
    find_links(arena);
    for (uint32_t i = 0; i < arena->config.robots; i++) {
        look_around(arena, i);
        look_down(arena, i);
    }
}

static int check_side(double side) { return side > DIAMETER && side <= MAX_SIDE; }

/* Comparisons are such that a NaN fails. */
static mcp_asdf_arena_status_t check_floor(const mcp_asdf_arena_config_t *config)
{
    if (config->image != NULL) {
        return config->columns > 0 && config->rows > 0 ? MCP_ASDF_ARENA_OK : MCP_ASDF_ARENA_ERR_IMAGE;
    }
    if (!(config->tile * MAX_TILES >= larger(config->width, config->height)) || isinf(config->tile)) {
        return MCP_ASDF_ARENA_ERR_TILE;
    }
    return config->fill_ratio >= 0 && config->fill_ratio <= 1 ? MCP_ASDF_ARENA_OK
                                                              : MCP_ASDF_ARENA_ERR_FILL_RATIO;
}

static mcp_asdf_arena_status_t check(const mcp_asdf_arena_config_t *config)
{
    if (config->robots < 1 || config->robots > MCP_ASDF_ARENA_MAX_ROBOTS) {
        return MCP_ASDF_ARENA_ERR_ROBOTS;
    }
    if (!check_side(config->width) || !check_side(config->height)) {
        return MCP_ASDF_ARENA_ERR_SIDE;
    }
    if (!(config->speed > 0 && config->speed <= MAX_SPEED)) {
        return MCP_ASDF_ARENA_ERR_SPEED;
    }
    if (!(config->range > 0 && config->range <= MAX_SIDE)) {
        return MCP_ASDF_ARENA_ERR_RANGE;
    }
    if (!(config->tick > 0 && 2 * config->speed / WHEEL_DISTANCE * config->tick <= LARGEST_TURN)) {
        return MCP_ASDF_ARENA_ERR_TICK;
    }
    return check_floor(config);
}

static int overlaps(const mcp_asdf_arena_t *arena, uint32_t i)
{
    for (uint32_t j = 0; j < i; j++) {
        if (squared_distance(arena, i, j) < DIAMETER * DIAMETER) {
            return 1;
        }
    }
    return 0;
}

static mcp_asdf_arena_status_t place(mcp_asdf_arena_t *arena, uint32_t i, uint64_t *counter)
{
    for (int attempt = 0; attempt < PLACING_ATTEMPTS; attempt++) {
        arena->x[i] = (uniform(counter) - 0.5) * (arena->config.width - DIAMETER);
        arena->y[i] = (uniform(counter) - 0.5) * (arena->config.height - DIAMETER);
        if (!overlaps(arena, i)) {
            return MCP_ASDF_ARENA_OK;
        }
    }
    return MCP_ASDF_ARENA_ERR_CROWDED;
}

/* A point that is uniform in a disc has a direction that is uniform too. */
static void face_anywhere(mcp_asdf_arena_t *arena, uint32_t i, uint64_t *counter)
{
    double x, y, squared;
    do {
        x = 2 * uniform(counter) - 1;
        y = 2 * uniform(counter) - 1;
        squared = x * x + y * y;
    } while (squared > 1 || squared < 0.01);
    arena->cx[i] = x / sqrt(squared);
    arena->cy[i] = y / sqrt(squared);
}

mcp_asdf_arena_status_t mcp_asdf_arena_init(mcp_asdf_arena_t *arena, const mcp_asdf_arena_config_t *config)
{
    uint64_t counter = mix(config->seed ^ 0x706C616365);
    mcp_asdf_arena_status_t status = check(config);
    memset(arena, 0, sizeof *arena);
    arena->config = *config;
    arena->colour_limit = config->fill_ratio * 0x1p53;
    arena->colours = mix(config->seed ^ 0x636F6C6F7572);
    arena->tiles_per_metre = 1 / config->tile;
    arena->part = config->tick / PARTS;
    arena->motor = ACCELERATION * arena->part;
    for (uint32_t i = 0; i < config->robots && status == MCP_ASDF_ARENA_OK; i++) {
        status = place(arena, i, &counter);
        face_anywhere(arena, i, &counter);
        mcp_asdf_arena_steer(arena, i, 0, 0);
    }
    if (status == MCP_ASDF_ARENA_OK) {
        look(arena);
    }
    return status;
}

void mcp_asdf_arena_step(mcp_asdf_arena_t *arena)
{
    arena->ticks++;
    move_all(arena);
    look(arena);
}

void mcp_asdf_arena_links(const mcp_asdf_arena_t *arena, uint64_t *linked)
{
    memset(linked, 0, 2 * sizeof *linked * arena->config.robots);
    for (uint32_t p = 0; p < arena->link_count; p++) {
        const mcp_asdf_pair_t pair = arena->links[p];
        set_bit(linked + (size_t)2 * pair.a, pair.b);
        set_bit(linked + (size_t)2 * pair.b, pair.a);
    }
}

/* Writes what the arena's tick left to line `line` of the record. */
static void write_record(const mcp_asdf_arena_t *arena, const mcp_asdf_arena_record_t *record, size_t line)
{
    const uint32_t robots = arena->config.robots;
    const size_t first = line * robots;
    for (uint32_t i = 0; i < robots; i++) {
        if (record->position != NULL) {
            record->position[2 * (first + i)] = arena->x[i];
            record->position[2 * (first + i) + 1] = arena->y[i];
        }
        if (record->heading != NULL) {
            record->heading[2 * (first + i)] = arena->cx[i];
            record->heading[2 * (first + i) + 1] = arena->cy[i];
        }
    }
    if (record->black != NULL) {
        memcpy(record->black + first, arena->black, robots);
    }
    if (record->wheels != NULL) {
        memcpy(record->wheels + first, arena->wheels, robots);
    }
    if (record->avoids != NULL) {
        memcpy(record->avoids + first, arena->avoids, robots);
    }
    if (record->sees_robot != NULL) {
        memcpy(record->sees_robot + first, arena->sees_robot, robots);
    }
    if (record->linked != NULL) {
        mcp_asdf_arena_links(arena, record->linked + 2 * first);
    }
}

void mcp_asdf_arena_run(mcp_asdf_arena_t *arena, uint32_t ticks, const mcp_asdf_arena_record_t *record)
{
    for (uint32_t tick = 0; tick < ticks; tick++) {
        mcp_asdf_arena_step(arena);
        write_record(arena, record, tick);
    }
}
