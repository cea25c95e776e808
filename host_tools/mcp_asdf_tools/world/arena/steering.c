/* Sensing obstacles and steering away from them. Eight proximity sensors look along rays straight outwards
 * from the body; the obstacle vector is the sum of their directions weighted by their readings. A robot that
 * senses an obstacle heads the opposite way, turning on the spot or while driving depending on how far its
 * heading is off; otherwise it drives straight on.
 */
#include "arena_private.h"

#define HALF_ROOT 0.70710678118654752440 /* cosine and sine of 45 degrees */

/* Directions of the sensors in the robot's own frame, from straight ahead counterclockwise. */
static const double AHEAD[SENSORS] = {1, HALF_ROOT, 0, -HALF_ROOT, -1, -HALF_ROOT, 0, HALF_ROOT};
static const double LEFT[SENSORS] = {0, HALF_ROOT, 1, HALF_ROOT, 0, -HALF_ROOT, -1, -HALF_ROOT};

/* Component along x of the direction on the floor of sensor k, with heading (cx, cy); along y with (cy, -cx).
 */
IN_LOOPS double ray(double cx, double cy, uint32_t k) { return cx * AHEAD[k] - cy * LEFT[k]; }

/* Shorten the rays of robot i that meet robot j. */
IN_LOOPS void meet_body(const mcp_asdf_arena_t *arena, uint32_t i, uint32_t j)
{
    const double mx = arena->x[j] - arena->x[i], my = arena->y[j] - arena->y[i];
    const double cx = arena->cx[i], cy = arena->cy[i];
    const double radius_squared = BODY_RADIUS * BODY_RADIUS, squared = mx * mx + my * my;
    double *const clear = arena->clear + (size_t)i * SENSORS;
    SIDE_BY_SIDE
    for (uint32_t k = 0; k < SENSORS; ++k) {
        const double along = mx * ray(cx, cy, k) + my * ray(cy, -cx, k);
        const double inside = radius_squared - (squared - along * along);
        const double distance = along - BODY_RADIUS - sqrt(larger(inside, 0));
        const bool meets = (along > 0) & (inside >= 0) & (distance < clear[k]);
        clear[k] = meets ? distance : clear[k];
    }
}

/* Shorten the rays of all robots that meet others. */
FOR_EACH_TARGET static void meet_bodies(const mcp_asdf_arena_t *arena)
{
    double *const clear = arena->clear;
    for (size_t r = 0; r < (size_t)arena->config.robots * SENSORS; ++r) {
        clear[r] = 2 * SENSOR_REACH;
    }
    for (uint32_t p = 0; p < arena->near_count; ++p) {
        meet_body(arena, arena->near[p].a, arena->near[p].b);
        meet_body(arena, arena->near[p].b, arena->near[p].a);
    }
}

/* Shorten the rays that meet one of the two walls across an axis. The walls are `room` from the middle of the
 * floor, the robot is at `place`, and (cx, cy) is as ray() has it for the axis. */
IN_LOOPS void meet_walls(double *clear, double cx, double cy, double room, double place)
{
    const double reach = BODY_RADIUS + SENSOR_REACH;
    if (fabs(place) < room - reach) {
        return;
    }
    SIDE_BY_SIDE
    for (uint32_t k = 0; k < SENSORS; ++k) {
        const double direction = ray(cx, cy, k), slope = fabs(direction);
        const double gap = direction > 0 ? room - place : room + place;
        const double distance = gap / slope - BODY_RADIUS;
        const bool meets = (gap < reach * slope) & (distance < clear[k]);
        clear[k] = meets ? distance : clear[k];
    }
}

/* Reading, 0 .. 1, of a sensor whose ray meets something at `distance` from the edge of the body, within its
 * reach. */
IN_LOOPS double reading(double distance)
{
    const double far = clamp(4.14 * arena_fading(33 * distance) - 0.085, 0, 1);
    return distance < 0.04 ? 1 : far;
}

#define DEGREE (PI / 180)
#define WEAK 0.1 /* a shorter obstacle vector is ignored if it points ahead, within 5 degrees */
#define TAN_5_DEGREES 0.08748866352592400522

/* State of the wheels after `state`, with the wanted heading `angle` away. A turn on the spot begins at 90
 * degrees and ends at 70. Exactly 90 is no rare tie: it is what a side sensor alone gives. It counts as a
 * turn on the spot because it does so in the physics simulation. */
IN_LOOPS uint8_t next_wheels(uint8_t state, double angle)
{
    if (angle >= PI / 2 || (state == MCP_ASDF_HARD_TURN && angle > 70 * DEGREE)) {
        return MCP_ASDF_HARD_TURN;
    }
    return angle > 10 * DEGREE ? MCP_ASDF_SOFT_TURN : MCP_ASDF_STRAIGHT;
}

/* Speed of the wheel on the inner side of the turn. */
IN_LOOPS double inner_speed(uint8_t wheels, double speed, double angle)
{
    if (wheels == MCP_ASDF_HARD_TURN) {
        return -speed;
    }
    return wheels == MCP_ASDF_SOFT_TURN ? speed * (1 - angle / (PI / 2)) : speed;
}

/* Set the wheels of a robot with an obstacle vector whose opposite is `angle` from straight ahead. */
IN_LOOPS void steer(mcp_asdf_arena_t *arena, uint32_t robot, double ahead, double left, double away)
{
    const bool weak = ahead * ahead + left * left < WEAK * WEAK && fabs(left) <= ahead * TAN_5_DEGREES;
    const double angle = weak ? 0 : away;
    const uint8_t wheels = next_wheels(arena->wheels[robot], angle);
    const double outer = arena->config.speed, inner = inner_speed(wheels, outer, angle);
    arena->avoids[robot] = !weak;
    arena->wheels[robot] = wheels;
    arena->looks[robot] = wheels != MCP_ASDF_STRAIGHT || !weak;
    arena->wanted_speed[robot] = (outer + inner) / 2;
    /* To the right, away from an obstacle on the left, unless it is on the right. */
    arena->wanted_spin[robot] = (left < 0 ? outer - inner : inner - outer) / WHEEL_DISTANCE;
}

void mcp_asdf_arena_steer(mcp_asdf_arena_t *arena, uint32_t robot, double ahead, double left)
{
    steer(arena, robot, ahead, left, arena_bearing(-ahead, -left));
}

/* Robots whose wheels may change, of one arena or several, and what they sense.
 *   ahead, left     obstacle vector of each in its own frame
 *   away            angle of its opposite from straight ahead
 *   ray, distance   of the `seen` rays that meet something within reach: sensor ray % SENSORS of busy robot
 *                   ray / SENSORS */
typedef struct {
    uint32_t count;
    uint32_t seen;
    mcp_asdf_arena_t *arena[AT_ONCE];
    uint32_t robot[AT_ONCE];
    double ahead[AT_ONCE], left[AT_ONCE], away[AT_ONCE];
    uint32_t ray[AT_ONCE * SENSORS + 1];
    double distance[AT_ONCE * SENSORS + 1];
} busy_t;

/* Look along the rays of the n-th busy robot. */
IN_LOOPS void look_around(busy_t *busy, uint32_t n)
{
    const mcp_asdf_arena_t *const arena = busy->arena[n];
    const uint32_t i = busy->robot[n];
    double *const clear = arena->clear + (size_t)i * SENSORS;
    meet_walls(clear, arena->cx[i], arena->cy[i], arena->config.width / 2, arena->x[i]);
    meet_walls(clear, arena->cy[i], -arena->cx[i], arena->config.height / 2, arena->y[i]);
    for (uint32_t k = 0; k < SENSORS; ++k) { /* written always, kept if seen */
        busy->ray[busy->seen] = n * SENSORS + k;
        busy->distance[busy->seen] = clear[k];
        busy->seen += clear[k] <= SENSOR_REACH;
    }
    busy->ahead[n] = busy->left[n] = 0;
}

FOR_EACH_TARGET static void steer_busy(busy_t *busy)
{
    double weight[AT_ONCE * SENSORS];
    busy->seen = 0;
    for (uint32_t n = 0; n < busy->count; ++n) {
        look_around(busy, n);
    }
    SIDE_BY_SIDE
    for (uint32_t r = 0; r < busy->seen; ++r) {
        weight[r] = reading(busy->distance[r]);
    }
    for (uint32_t r = 0; r < busy->seen; ++r) {
        const uint32_t n = busy->ray[r] / SENSORS, k = busy->ray[r] % SENSORS;
        busy->ahead[n] += weight[r] * AHEAD[k];
        busy->left[n] += weight[r] * LEFT[k];
    }
    SIDE_BY_SIDE
    for (uint32_t n = 0; n < busy->count; ++n) {
        busy->away[n] = arena_bearing(-busy->ahead[n], -busy->left[n]);
    }
    for (uint32_t n = 0; n < busy->count; ++n) {
        steer(busy->arena[n], busy->robot[n], busy->ahead[n], busy->left[n], busy->away[n]);
    }
    busy->count = 0;
}

/* The wheels of robots with nothing near that drive straight on are set already. */
void arena_set_wheels(mcp_asdf_arena_t *arenas, uint32_t count)
{
    busy_t busy;
    busy.count = 0;
    for (uint32_t a = 0; a < count; ++a) {
        mcp_asdf_arena_t *const arena = &arenas[a];
        meet_bodies(arena);
        for (uint32_t i = 0; i < arena->config.robots; ++i) {
            busy.arena[busy.count] = arena; /* written always, kept if busy */
            busy.robot[busy.count] = i;
            busy.count += (uint32_t)arena->looks[i];
            if (busy.count == AT_ONCE) {
                steer_busy(&busy);
            }
        }
    }
    steer_busy(&busy);
}
