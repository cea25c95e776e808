/* Proximity sensors: eight rays straight outwards from the body, and the obstacle vector, the sum of their
 * directions weighted by their readings.
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

/* Shorten the rays that meet a body at (mx, my) from the robot's centre. Returns whether one does within
 * reach. */
static uint8_t meet_body(rays_t *rays, double mx, double my)
{
    const double radius_squared = BODY_RADIUS * BODY_RADIUS;
    uint8_t seen = 0;
    for (int k = 0; k < SENSORS; ++k) {
        const double along = mx * rays->dx[k] + my * rays->dy[k];
        const double inside = radius_squared - (mx * mx + my * my - along * along);
        if (along <= 0 || inside < 0) {
            continue;
        }
        const double distance = along - BODY_RADIUS - sqrt(inside);
        seen |= distance <= SENSOR_REACH;
        if (distance < rays->clear[k]) {
            rays->clear[k] = distance;
        }
    }
    return seen;
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

static double reading(double distance)
{
    if (distance < 0.04) {
        return 1;
    }
    if (distance > SENSOR_REACH) {
        return 0;
    }
    return clamp(4.14 * arena_fading(33 * distance) - 0.085, 0, 1);
}

double mcp_asdf_arena_reading(double distance) { return reading(distance); }

static void add_readings(const rays_t *rays, double *ahead, double *left)
{
    *ahead = *left = 0;
    for (int k = 0; k < SENSORS; ++k) {
        if (rays->clear[k] <= SENSOR_REACH) {
            const double weight = reading(rays->clear[k]);
            *ahead += weight * AHEAD[k];
            *left += weight * LEFT[k];
        }
    }
}

void mcp_asdf_arena_obstacle(const mcp_asdf_arena_t *arena, uint32_t robot, double *ahead, double *left,
                             uint8_t *sees_robot)
{
    const double x = arena->x[robot], y = arena->y[robot];
    uint64_t near[2] = {arena->near[robot][0], arena->near[robot][1]};
    rays_t rays;
    point_rays(&rays, arena->cx[robot], arena->cy[robot]);
    *sees_robot = 0;
    for (int j = take_bit(near); j >= 0; j = take_bit(near)) {
        *sees_robot |= meet_body(&rays, arena->x[j] - x, arena->y[j] - y);
    }
    meet_walls(rays.clear, rays.dx, arena->config.width / 2, x);
    meet_walls(rays.clear, rays.dy, arena->config.height / 2, y);
    add_readings(&rays, ahead, left);
}
