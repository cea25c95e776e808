/* Declarations shared by the C files of the arena, private to them. arena.c lists the files. */
#ifndef MCP_ASDF_ARENA_PRIVATE_H
#define MCP_ASDF_ARENA_PRIVATE_H

#include "arena.h"

#include <math.h>
#include <stdbool.h>
#include <stddef.h>
#include <string.h>

/* Fusing a * b + c would change the bits. gcc does not know the pragma, but -std=c99 stops it. */
#if defined(__clang__)
#pragma STDC FP_CONTRACT OFF
#endif

/* The Khepera IV, in metres; docs/arena.md has the sources. */
#define BODY_RADIUS 0.0704
#define DIAMETER (2 * BODY_RADIUS)
#define WHEEL_DISTANCE 0.1054
#define SENSOR_REACH 0.12        /* of a proximity sensor, from the edge of the body */
#define ACCELERATION (1.5 / 0.4) /* of the motors: 1.5 N on 0.4 kg */
#define PI 3.14159265358979323846

#define PARTS 10         /* of a tick; in each, bodies move by the velocities of the part before */
#define LARGEST_TURN 1.6 /* in a tick; arena_rotate() takes no more */

static inline double larger(double a, double b) { return a > b ? a : b; }

static inline double smaller(double a, double b) { return a < b ? a : b; }

static inline double clamp(double value, double low, double high)
{
    return larger(low, smaller(high, value));
}

/* Below these distances of their centres one robot may see another, two may meet within a tick, or a pair may
 * do either or hear each other within so many ticks. */
#define SEEING_DISTANCE (DIAMETER + SENSOR_REACH)
#define TICKS_BETWEEN_LOOKS 12

static inline double touching_distance(const mcp_asdf_arena_config_t *config)
{
    return DIAMETER + 2 * config->speed * config->tick;
}

static inline double watching_distance(const mcp_asdf_arena_config_t *config)
{
    const double matters = larger(config->range, larger(touching_distance(config), SEEING_DISTANCE));
    return matters + 2 * config->speed * config->tick * TICKS_BETWEEN_LOOKS;
}

/* A body has room for six others around it, which makes three pairs, and two walls. */
#define CONTACTS_OF_A_BODY 5

/* The robots that robot i may see: near_count[i] of them. */
static inline uint16_t *near_of(const mcp_asdf_arena_t *arena, uint32_t i)
{
    return arena->near + (size_t)i * arena->most_near;
}

static inline double squared_distance(const mcp_asdf_arena_t *arena, uint32_t i, uint32_t j)
{
    const double dx = arena->x[j] - arena->x[i], dy = arena->y[j] - arena->y[i];
    return dx * dx + dy * dy;
}

/* Whether a wall is less than `distance` from the edge of body i. */
static inline bool wall_within(const mcp_asdf_arena_t *arena, uint32_t i, double distance)
{
    const double margin = BODY_RADIUS + distance;
    return fabs(arena->x[i]) > arena->config.width / 2 - margin ||
           fabs(arena->y[i]) > arena->config.height / 2 - margin;
}

/* Rotate (*cx, *cy), of length 1, by at most LARGEST_TURN either way. Error up to 1e-13. */
void arena_rotate(double *cx, double *cy, double angle);

/* Unsigned angle between (x, y) and straight ahead, in [0, pi]. */
double arena_bearing(double x, double y);

/* exp(-x) for x in [0, 4]. Relative error below 1e-12. */
double arena_fading(double x);

/* The steps of a tick: move all bodies; find who is near and who hears whom; set wheels from the sensors. */
void arena_move(mcp_asdf_arena_t *arena);
void arena_find_links(mcp_asdf_arena_t *arena);
void arena_set_wheels(mcp_asdf_arena_t *arena);

#endif
