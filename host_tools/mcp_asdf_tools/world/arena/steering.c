/* Steering: a robot that senses an obstacle heads the opposite way, turning on the spot or while driving
 * depending on how far its heading is off; otherwise it drives straight on.
 */
#include "arena_private.h"

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

static void steer(mcp_asdf_arena_t *arena, uint32_t i, double ahead, double left)
{
    const bool weak = ahead * ahead + left * left < WEAK * WEAK && fabs(left) <= ahead * TAN_5_DEGREES;
    const double angle = weak ? 0 : arena_bearing(-ahead, -left);
    const uint8_t wheels = next_wheels(arena->wheels[i], angle);
    const double outer = arena->config.speed, inner = inner_speed(wheels, outer, angle);
    arena->avoids[i] = !weak;
    arena->wheels[i] = wheels;
    arena->wanted_speed[i] = (outer + inner) / 2;
    /* To the right, away from an obstacle on the left, unless it is on the right. */
    arena->wanted_spin[i] = (left < 0 ? outer - inner : inner - outer) / WHEEL_DISTANCE;
}

void mcp_asdf_arena_steer(mcp_asdf_arena_t *arena, uint32_t robot, double ahead, double left)
{
    steer(arena, robot, ahead, left);
}

static void set_wheels(mcp_asdf_arena_t *arena, uint32_t i)
{
    double ahead = 0, left = 0;
    arena->sees_robot[i] = 0;
    if ((arena->near[i][0] | arena->near[i][1]) != 0 || wall_within(arena, i, SENSOR_REACH)) {
        mcp_asdf_arena_obstacle(arena, i, &ahead, &left, &arena->sees_robot[i]);
    } else if (arena->wheels[i] == MCP_ASDF_STRAIGHT && !arena->avoids[i]) {
        return; /* the usual case: the wheels are set already */
    }
    steer(arena, i, ahead, left);
}

void arena_set_wheels(mcp_asdf_arena_t *arena)
{
    for (uint32_t i = 0; i < arena->config.robots; ++i) {
        set_wheels(arena, i);
    }
}
