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

static void point_rays(rays_t *rays, double cx, double cy)
{
    for (int k = 0; k < SENSORS; ++k) {
        rays->dx[k] = cx * AHEAD[k] - cy * LEFT[k];
        rays->dy[k] = cx * LEFT[k] + cy * AHEAD[k];
        rays->clear[k] = 2 * SENSOR_REACH;
    }
}

/* Shorten the rays that meet a body at (mx, my) from the robot's centre. */
static void meet_body(rays_t *rays, double mx, double my)
{
    const double radius_squared = BODY_RADIUS * BODY_RADIUS;
    for (int k = 0; k < SENSORS; ++k) {
        const double along = mx * rays->dx[k] + my * rays->dy[k];
        const double inside = radius_squared - (mx * mx + my * my - along * along);
        if (along <= 0 || inside < 0) {
            continue;
        }
        const double distance = along - BODY_RADIUS - sqrt(inside);
        if (distance < rays->clear[k]) {
            rays->clear[k] = distance;
        }
    }
}

/* Shorten the rays that meet one of the two walls across an axis. The walls are `room` from the middle of the
 * floor, the robot is at `place`, and the rays have these components of `direction` along the axis. */
static void meet_walls(double *clear, const double direction[SENSORS], double room, double place)
{
    const double reach = BODY_RADIUS + SENSOR_REACH;
    if (fabs(place) < room - reach) {
        return;
    }
    for (int k = 0; k < SENSORS; ++k) {
        const double gap = direction[k] > 0 ? room - place : room + place, slope = fabs(direction[k]);
        if (gap < reach * slope && gap / slope - BODY_RADIUS < clear[k]) {
            clear[k] = gap / slope - BODY_RADIUS;
        }
    }
}

double mcp_asdf_arena_reading(double distance)
{
    if (distance < 0.04) {
        return 1;
    }
    if (distance > SENSOR_REACH) {
        return 0;
    }
    return clamp(4.14 * arena_fading(33 * distance) - 0.085, 0, 1);
}

static void add_readings(const rays_t *rays, double *ahead, double *left)
{
    *ahead = *left = 0;
    for (int k = 0; k < SENSORS; ++k) {
        if (rays->clear[k] <= SENSOR_REACH) {
            const double weight = mcp_asdf_arena_reading(rays->clear[k]);
            *ahead += weight * AHEAD[k];
            *left += weight * LEFT[k];
        }
    }
}

void mcp_asdf_arena_obstacle(const mcp_asdf_arena_t *arena, uint32_t robot, double *ahead, double *left)
{
    const double x = arena->x[robot], y = arena->y[robot];
    const uint16_t *const near = near_of(arena, robot);
    rays_t rays;
    point_rays(&rays, arena->cx[robot], arena->cy[robot]);
    for (uint32_t k = 0; k < arena->near_count[robot]; ++k) {
        meet_body(&rays, arena->x[near[k]] - x, arena->y[near[k]] - y);
    }
    meet_walls(rays.clear, rays.dx, arena->config.width / 2, x);
    meet_walls(rays.clear, rays.dy, arena->config.height / 2, y);
    add_readings(&rays, ahead, left);
}

#define DEGREE (PI / 180)
#define WEAK 0.1 /* a shorter obstacle vector is ignored if it points ahead, within 5 degrees */
#define TAN_5_DEGREES 0.08748866352592400522

/* State of the wheels after `state`, with the wanted heading `angle` away. A turn on the spot begins at 90
 * degrees and ends at 70. Exactly 90 is no rare tie: it is what a side sensor alone gives. It counts as a
 * turn on the spot because it does so in the physics simulation. */
static uint8_t next_wheels(uint8_t state, double angle)
{
    if (angle >= PI / 2 || (state == MCP_ASDF_HARD_TURN && angle > 70 * DEGREE)) {
        return MCP_ASDF_HARD_TURN;
    }
    return angle > 10 * DEGREE ? MCP_ASDF_SOFT_TURN : MCP_ASDF_STRAIGHT;
}

/* Speed of the wheel on the inner side of the turn. */
static double inner_speed(uint8_t wheels, double speed, double angle)
{
    if (wheels == MCP_ASDF_HARD_TURN) {
        return -speed;
    }
    return wheels == MCP_ASDF_SOFT_TURN ? speed * (1 - angle / (PI / 2)) : speed;
}

void mcp_asdf_arena_steer(mcp_asdf_arena_t *arena, uint32_t robot, double ahead, double left)
{
    const bool weak = ahead * ahead + left * left < WEAK * WEAK && fabs(left) <= ahead * TAN_5_DEGREES;
    const double angle = weak ? 0 : arena_bearing(-ahead, -left);
    const uint8_t wheels = next_wheels(arena->wheels[robot], angle);
    const double outer = arena->config.speed, inner = inner_speed(wheels, outer, angle);
    arena->avoids[robot] = !weak;
    arena->wheels[robot] = wheels;
    arena->wanted_speed[robot] = (outer + inner) / 2;
    /* To the right, away from an obstacle on the left, unless it is on the right. */
    arena->wanted_spin[robot] = (left < 0 ? outer - inner : inner - outer) / WHEEL_DISTANCE;
}

static void set_wheels(mcp_asdf_arena_t *arena, uint32_t i)
{
    double ahead = 0, left = 0;
    if (arena->near_count[i] != 0 || wall_within(arena, i, SENSOR_REACH)) {
        mcp_asdf_arena_obstacle(arena, i, &ahead, &left);
    } else if (arena->wheels[i] == MCP_ASDF_STRAIGHT && !arena->avoids[i]) {
        return; /* the usual case: the wheels are set already */
    }
    mcp_asdf_arena_steer(arena, i, ahead, left);
}

void arena_set_wheels(mcp_asdf_arena_t *arena)
{
    for (uint32_t i = 0; i < arena->config.robots; ++i) {
        set_wheels(arena, i);
    }
}
