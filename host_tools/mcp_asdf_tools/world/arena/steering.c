/* Sensing obstacles and steering away from them. Eight proximity sensors look along rays straight outwards
 * from the body; the obstacle vector is the sum of their directions weighted by their readings. A robot that
 * senses an obstacle heads the opposite way, turning on the spot or while driving depending on how far its
 * heading is off; otherwise it drives straight on.
 */
#include "arena_private.h"

#define HALF_ROOT 0.70710678118654752440 /* cosine and sine of 45 degrees */
#define BEYOND_REACH (2 * SENSOR_REACH)  /* free distance of a ray that meets nothing: above the reach */

/* Directions of the sensors in the robot's own frame, from straight ahead counterclockwise. */
static const double SENSOR_AHEAD[SENSORS] = {1, HALF_ROOT, 0, -HALF_ROOT, -1, -HALF_ROOT, 0, HALF_ROOT};
static const double SENSOR_LEFT[SENSORS] = {0, HALF_ROOT, 1, HALF_ROOT, 0, -HALF_ROOT, -1, -HALF_ROOT};

/* Returns the component along x of the direction on the floor in which sensor k looks, for a robot with the
 * heading (cx, cy), cosine and sine. To get the component along y, call it with (cy, -cx): this is the
 * heading turned to the right by 90 degrees, which brings the y axis to where the x axis was. */
IN_LOOPS double ray_component(double cx, double cy, uint32_t k)
{
    return cx * SENSOR_AHEAD[k] - cy * SENSOR_LEFT[k];
}

/* Shorten the rays of robot i that meet robot j: a ray that passes its centre at less than a radius ends at
 * the near side of the circle. */
IN_LOOPS void shorten_rays_at_body(const mcp_asdf_arena_t *arena, uint32_t i, uint32_t j)
{
    const double dx = arena->x[j] - arena->x[i], dy = arena->y[j] - arena->y[i]; /* to the other's centre */
    const double cx = arena->cx[i], cy = arena->cy[i];
    const double radius_squared = BODY_RADIUS * BODY_RADIUS, centres_squared = dx * dx + dy * dy;
    double *const free_distance = arena->free_distance + (size_t)i * SENSORS;
    SIDE_BY_SIDE
    for (uint32_t k = 0; k < SENSORS; ++k) {
        /* The ray passes the other robot's centre after `along` metres. By Pythagoras it passes the centre at
         * the squared distance centres_squared - along^2. By Pythagoras again, half of the chord within the
         * circle has the square radius^2 - passing_squared, which is negative if the ray misses the circle.
         */
        const double along = dx * ray_component(cx, cy, k) + dy * ray_component(cy, -cx, k);
        const double passing_squared = centres_squared - along * along;
        const double half_chord_squared = radius_squared - passing_squared;
        const double distance = along - BODY_RADIUS - sqrt(max_of(half_chord_squared, 0)); /* from the edge */
        /* Without branches, so that the rays become a vector. A body behind the robot has along < 0. */
        const bool meets = (along > 0) & (half_chord_squared >= 0) & (distance < free_distance[k]);
        free_distance[k] = meets ? distance : free_distance[k];
    }
}

/* Store in arena->free_distance how far the rays of all robots reach before they meet another body, or more
 * than SENSOR_REACH if there is none. */
FOR_EACH_TARGET static void shorten_rays_at_bodies(const mcp_asdf_arena_t *arena)
{
    double *const free_distance = arena->free_distance;
    for (size_t ray = 0; ray < (size_t)arena->config.robots * SENSORS; ++ray) {
        free_distance[ray] = BEYOND_REACH;
    }
    for (uint32_t p = 0; p < arena->visible_count; ++p) {
        shorten_rays_at_body(arena, arena->visible[p].a, arena->visible[p].b);
        shorten_rays_at_body(arena, arena->visible[p].b, arena->visible[p].a);
    }
}

/* Shorten the rays of a robot that meet one of the two walls across the x axis or the y axis. Along that axis
 * the walls are `wall_coordinate` from the middle of the floor, and the robot is at `position`. (cx, cy) is
 * the heading for the x axis, and for the y axis the heading turned to the right by 90 degrees, which
 * ray_component() takes then. free_distance[k] is how far the ray of sensor k reaches, from the edge of the
 * body, in metres. */
IN_LOOPS void shorten_rays_at_walls(double *free_distance, double cx, double cy, double wall_coordinate,
                                    double position)
{
    const double reach = BODY_RADIUS + SENSOR_REACH;
    if (fabs(position) < wall_coordinate - reach) {
        return;
    }
    SIDE_BY_SIDE
    for (uint32_t k = 0; k < SENSORS; ++k) {
        const double direction = ray_component(cx, cy, k); /* along the axis, -1 .. 1 */
        const double slope = fabs(direction);
        /* From the robot's centre to the wall that the ray approaches, along the axis; along the ray it is
         * gap / slope. */
        const double gap = direction > 0 ? wall_coordinate - position : wall_coordinate + position;
        const double distance = gap / slope - BODY_RADIUS;
        /* The ray meets the wall if gap / slope < reach. Written as a product this is false for a slope of 0,
         * a ray along the wall, whose distance above is of no use. With & in place of &&, as vectors have no
         * branches. */
        const bool meets = (gap < reach * slope) & (distance < free_distance[k]);
        free_distance[k] = meets ? distance : free_distance[k];
    }
}

/* Returns the reading, 0 .. 1, of a sensor whose ray meets something at `distance` metres from the edge of
 * the body, within its reach: 1 when near, and then falling exponentially. docs/internals/arena.md has the
 * source of the numbers. */
IN_LOOPS double sensor_reading(double distance)
{
    const double fading = arena_fading(33 * distance); /* exp(-33 distance) */
    const double far_reading = clamp(4.14 * fading - 0.085, 0, 1);
    return distance < 0.04 ? 1 : far_reading;
}

/* Angles and lengths of the authors' controller (docs/internals/arena.md). */
#define DEGREE (PI / 180)
#define WEAK_OBSTACLE 0.1 /* a shorter obstacle vector is ignored if it points ahead, within 5 degrees */
#define TAN_5_DEGREES 0.08748866352592400522

/* Returns the next state of the wheels, a mcp_asdf_wheels_t, after `state`, where the heading to turn to is
 * `angle` away, 0 .. pi: straight on up to 10 degrees, then a soft turn. A hard turn, on the spot, begins at
 * 90 degrees and ends at 70. Exactly 90 is no rare tie: it is what a side sensor alone gives. It counts as a
 * turn on the spot because it does so in the physics simulation. */
IN_LOOPS uint8_t next_wheels(uint8_t state, double angle)
{
    if (angle >= PI / 2 || (state == MCP_ASDF_HARD_TURN && angle > 70 * DEGREE)) {
        return MCP_ASDF_HARD_TURN;
    }
    return angle > 10 * DEGREE ? MCP_ASDF_SOFT_TURN : MCP_ASDF_STRAIGHT;
}

/* Returns the speed in m/s of the wheel on the inner side of the turn, where the outer one has `speed`, for
 * the state of the wheels and the angle to turn by. */
IN_LOOPS double inner_speed(uint8_t wheels, double speed, double angle)
{
    if (wheels == MCP_ASDF_HARD_TURN) {
        return -speed;
    }
    return wheels == MCP_ASDF_SOFT_TURN ? speed * (1 - angle / (PI / 2)) : speed;
}

/* Set how `robot` drives on, from its obstacle vector (`ahead`, `left`), in its own frame and without a unit,
 * whose opposite is `away` from straight ahead, 0 .. pi. Sets avoids, wheels, needs_steering, target_speed
 * (m/s) and target_spin (rad/s, counterclockwise) of the robot. */
IN_LOOPS void steer(mcp_asdf_arena_t *arena, uint32_t robot, double ahead, double left, double away)
{
    /* Short, and straight ahead: |left| <= ahead tan 5 degrees holds for no vector that points backwards. The
     * null vector is weak, too. */
    const bool is_weak =
        ahead * ahead + left * left < WEAK_OBSTACLE * WEAK_OBSTACLE && fabs(left) <= ahead * TAN_5_DEGREES;
    const double angle = is_weak ? 0 : away;
    const uint8_t wheels = next_wheels(arena->wheels[robot], angle);
    const double outer_speed = arena->config.speed;
    const double slower_speed = inner_speed(wheels, outer_speed, angle); /* of the inner wheel */
    arena->avoids[robot] = !is_weak;
    arena->wheels[robot] = wheels;
    arena->needs_steering[robot] = wheels != MCP_ASDF_STRAIGHT || !is_weak;
    arena->target_speed[robot] = (outer_speed + slower_speed) / 2;
    /* An obstacle on the right turns the robot to the left, which is a positive spin, and any other one to
     * the right. */
    const bool is_obstacle_right = left < 0;
    arena->target_spin[robot] =
        (is_obstacle_right ? outer_speed - slower_speed : slower_speed - outer_speed) / WHEEL_DISTANCE;
}

/* Set the wheels of a robot, and so its speed and spin for the coming tick, so that it turns away from the
 * obstacle vector (ahead, left), in the robot's own frame. A weak one is ignored. */
void mcp_asdf_arena_steer(mcp_asdf_arena_t *arena, uint32_t robot, double ahead, double left)
{
    steer(arena, robot, ahead, left, arena_bearing(-ahead, -left));
}

/* A batch of robots whose wheels may change, of one arena or several, and what they sense.
 *   ahead, left     obstacle vector in the robot's own frame: the sum of rays weighted by readings
 *   away            angle of its opposite from straight ahead
 *   ray, distance   of the `hit_count` rays that meet something within reach: that of sensor ray % SENSORS of
 *                   the robot in entry ray / SENSORS */
typedef struct {
    uint32_t count;
    uint32_t hit_count;
    mcp_asdf_arena_t *arena[BATCH];
    uint32_t robot[BATCH];
    double ahead[BATCH], left[BATCH], away[BATCH];
    uint32_t ray[BATCH * SENSORS + 1];
    double distance[BATCH * SENSORS + 1];
} steered_t;

/* Append to the batch's hits the rays of its n-th robot that meet something within reach. free_distance[k] is
 * how far the ray of the robot's sensor k reaches. A ray is written behind the hits in any case, and becomes
 * a hit only if it meets something; else the next ray overwrites it. This needs no branch, which could not be
 * predicted. */
IN_LOOPS void append_hits(steered_t *batch, uint32_t n, const double *free_distance)
{
    for (uint32_t k = 0; k < SENSORS; ++k) {
        batch->ray[batch->hit_count] = n * SENSORS + k;
        batch->distance[batch->hit_count] = free_distance[k];
        const bool is_hit = free_distance[k] <= SENSOR_REACH;
        batch->hit_count += is_hit ? 1 : 0;
    }
}

/* Find which rays of the n-th robot of a batch meet a wall or another body within reach, and append them to
 * the batch's hits. arena->free_distance has how far the rays reach up to other bodies, which
 * shorten_rays_at_bodies() has stored there; here it is shortened further where a wall is nearer. Sets the
 * robot's obstacle vector, (batch->ahead[n], batch->left[n]), to 0: its rays are added up later. */
IN_LOOPS void cast_rays(steered_t *batch, uint32_t n)
{
    const mcp_asdf_arena_t *const arena = batch->arena[n];
    const uint32_t i = batch->robot[n];
    double *const free_distance = arena->free_distance + (size_t)i * SENSORS;
    /* The walls in the east and the west, then those in the north and the south, for which ray_component()
     * takes the heading (cx, cy) as (cy, -cx). */
    shorten_rays_at_walls(free_distance, arena->cx[i], arena->cy[i], arena->config.width / 2, arena->x[i]);
    shorten_rays_at_walls(free_distance, arena->cy[i], -arena->cx[i], arena->config.height / 2, arena->y[i]);
    append_hits(batch, n, free_distance);
    batch->ahead[n] = batch->left[n] = 0;
}

/* Set the wheels of the robots of a batch from what their sensors read, and empty the batch. Each step is a
 * loop of its own over all robots or hits, so that the costly ones become vectors. */
FOR_EACH_TARGET static void steer_batch(steered_t *batch)
{
    double reading[BATCH * SENSORS];
    batch->hit_count = 0;
    for (uint32_t n = 0; n < batch->count; ++n) {
        cast_rays(batch, n);
    }
    SIDE_BY_SIDE
    for (uint32_t hit = 0; hit < batch->hit_count; ++hit) {
        reading[hit] = sensor_reading(batch->distance[hit]);
    }
    /* The obstacle vector of a robot is the sum of its sensors' directions, weighted by their readings. */
    for (uint32_t hit = 0; hit < batch->hit_count; ++hit) {
        const uint32_t n = batch->ray[hit] / SENSORS, sensor = batch->ray[hit] % SENSORS;
        batch->ahead[n] += reading[hit] * SENSOR_AHEAD[sensor];
        batch->left[n] += reading[hit] * SENSOR_LEFT[sensor];
    }
    SIDE_BY_SIDE
    for (uint32_t n = 0; n < batch->count; ++n) {
        batch->away[n] = arena_bearing(-batch->ahead[n], -batch->left[n]); /* of the opposite direction */
    }
    for (uint32_t n = 0; n < batch->count; ++n) {
        steer(batch->arena[n], batch->robot[n], batch->ahead[n], batch->left[n], batch->away[n]);
    }
    batch->count = 0;
}

/* Set the wheels of the robots of `count` arenas, so that they turn away from obstacles that they sense. Only
 * robots marked in needs_steering are computed, in batches, which may have robots of several arenas: the
 * others drive straight on with nothing near, and their wheels are set already. */
void arena_set_wheels(mcp_asdf_arena_t *arenas, uint32_t count)
{
    steered_t batch;
    batch.count = 0;
    for (uint32_t a = 0; a < count; ++a) {
        mcp_asdf_arena_t *const arena = &arenas[a];
        shorten_rays_at_bodies(arena);
        for (uint32_t i = 0; i < arena->config.robots; ++i) {
            /* A branch could not be predicted: so every robot is written behind the end of the batch, and
             * only if it needs steering the end moves on. Otherwise the next robot overwrites it. */
            batch.arena[batch.count] = arena;
            batch.robot[batch.count] = i;
            batch.count += (uint32_t)arena->needs_steering[i]; /* 1 or 0 */
            if (batch.count == BATCH) {
                steer_batch(&batch);
            }
        }
    }
    steer_batch(&batch); /* the robots that are left */
}
