/* Sensing obstacles and steering away from them. Eight proximity sensors look along rays straight outwards
 * from the body; the obstacle vector is the sum of their directions weighted by their readings. A robot that
 * senses an obstacle heads the opposite way, turning on the spot or while driving depending on how far its
 * heading is off; otherwise it drives straight on.
 */
#include "arena_private.h"

#define SENSORS 8
#define HALF_ROOT 0.70710678118654752440 /* cosine and sine of 45 degrees */

/* Directions of the sensors in the robot's own frame, from straight ahead counterclockwise. */
static const double AHEAD[SENSORS] = {1, HALF_ROOT, 0, -HALF_ROOT, -1, -HALF_ROOT, 0, HALF_ROOT};
static const double LEFT[SENSORS] = {0, HALF_ROOT, 1, HALF_ROOT, 0, -HALF_ROOT, -1, -HALF_ROOT};

/* A robot's rays: directions on the floor, and the free distance along each from the edge of the body. */
typedef struct {
    double dx[SENSORS];
    double dy[SENSORS];
    double clear[SENSORS];
} rays_t;

IN_LOOPS void point_rays(rays_t *rays, double cx, double cy)
{
    SIDE_BY_SIDE
    for (uint32_t k = 0; k < SENSORS; ++k) {
        rays->dx[k] = cx * AHEAD[k] - cy * LEFT[k];
        rays->dy[k] = cx * LEFT[k] + cy * AHEAD[k];
        rays->clear[k] = 2 * SENSOR_REACH;
    }
}

/* Shorten the rays that meet a body at (mx, my) from the robot's centre. */
IN_LOOPS void meet_body(rays_t *rays, double mx, double my)
{
    const double radius_squared = BODY_RADIUS * BODY_RADIUS, squared = mx * mx + my * my;
    SIDE_BY_SIDE
    for (uint32_t k = 0; k < SENSORS; ++k) {
        const double along = mx * rays->dx[k] + my * rays->dy[k];
        const double inside = radius_squared - (squared - along * along);
        const double distance = along - BODY_RADIUS - sqrt(larger(inside, 0));
        const bool meets = (along > 0) & (inside >= 0) & (distance < rays->clear[k]);
        rays->clear[k] = meets ? distance : rays->clear[k];
    }
}

/* Shorten the rays that meet one of the two walls across an axis. The walls are `room` from the middle of the
 * floor, the robot is at `place`, and the rays have these components of `direction` along the axis. */
IN_LOOPS void meet_walls(double *restrict clear, const double *restrict direction, double room, double place)
{
    const double reach = BODY_RADIUS + SENSOR_REACH;
    if (fabs(place) < room - reach) {
        return;
    }
    SIDE_BY_SIDE
    for (uint32_t k = 0; k < SENSORS; ++k) {
        const double gap = direction[k] > 0 ? room - place : room + place, slope = fabs(direction[k]);
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
    arena->unsettled[robot] = wheels != MCP_ASDF_STRAIGHT || !weak;
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
    const uint32_t robot = busy->robot[n];
    const double x = arena->x[robot], y = arena->y[robot];
    const uint16_t *const near = near_of(arena, robot);
    rays_t rays;
    point_rays(&rays, arena->cx[robot], arena->cy[robot]);
    for (uint32_t k = 0; k < arena->near_count[robot]; ++k) {
        meet_body(&rays, arena->x[near[k]] - x, arena->y[near[k]] - y);
    }
    meet_walls(rays.clear, rays.dx, arena->config.width / 2, x);
    meet_walls(rays.clear, rays.dy, arena->config.height / 2, y);
    for (uint32_t k = 0; k < SENSORS; ++k) { /* written always, kept if seen */
        busy->ray[busy->seen] = n * SENSORS + k;
        busy->distance[busy->seen] = rays.clear[k];
        busy->seen += rays.clear[k] <= SENSOR_REACH;
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

/* Which robots have something near or do not drive straight on: the others' wheels are set already. */
FOR_EACH_TARGET static void find_busy(const mcp_asdf_arena_t *arena, uint32_t first, uint32_t count,
                                      uint64_t *restrict is_busy)
{
    const double room_x = place_before_wall(arena->config.width, SENSOR_REACH);
    const double room_y = place_before_wall(arena->config.height, SENSOR_REACH);
    const double *const x = arena->x + first, *const y = arena->y + first;
    const uint32_t *const near = arena->near_count + first;
    const uint64_t *const unsettled = arena->unsettled + first;
    SIDE_BY_SIDE
    for (uint32_t i = 0; i < count; ++i) {
        is_busy[i] = (fabs(x[i]) > room_x) | (fabs(y[i]) > room_y) | (near[i] != 0) | (unsettled[i] != 0);
    }
}

void arena_set_wheels(mcp_asdf_arena_t *arenas, uint32_t count)
{
    busy_t busy;
    uint64_t is_busy[AT_ONCE] = {0};
    busy.count = 0;
    for (uint32_t a = 0; a < count; ++a) {
        mcp_asdf_arena_t *const arena = &arenas[a];
        const uint32_t robots = arena->config.robots;
        for (uint32_t first = 0; first < robots; first += AT_ONCE) {
            const uint32_t some = robots - first < AT_ONCE ? robots - first : AT_ONCE;
            find_busy(arena, first, WHOLE_VECTORS(some), is_busy);
            for (uint32_t i = 0; i < some; ++i) {
                busy.arena[busy.count] = arena; /* written always, kept if busy */
                busy.robot[busy.count] = first + i;
                busy.count += is_busy[i] != 0;
                if (busy.count == AT_ONCE) {
                    steer_busy(&busy);
                }
            }
        }
    }
    steer_busy(&busy);
}
