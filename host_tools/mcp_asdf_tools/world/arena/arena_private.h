/* Declarations shared by the C files of the arena, private to them. arena.c lists the files. */
#ifndef MCP_ASDF_ARENA_PRIVATE_H
#define MCP_ASDF_ARENA_PRIVATE_H

#include "arena.h"
#include "elementary.h"

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
#define SENSORS 8                /* of proximity */
#define SENSOR_REACH 0.12        /* from the edge of the body */
#define ACCELERATION (1.5 / 0.4) /* of the motors: 1.5 N on 0.4 kg */

#define AT_ONCE 32 /* robots side by side: a multiple of the 8 that memory has room for */
#define PARTS 10   /* of a tick; in each, bodies move by the velocities of the part before */

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

static inline double squared_distance(const mcp_asdf_arena_t *arena, uint32_t i, uint32_t j)
{
    const double dx = arena->x[j] - arena->x[i], dy = arena->y[j] - arena->y[i];
    return dx * dx + dy * dy;
}

/* A body this far from the middle between two walls, `side` apart, has its edge `distance` from one. */
static inline double place_before_wall(double side, double distance)
{
    return side / 2 - (BODY_RADIUS + distance);
}

/* The steps of a tick: move all bodies; find who is near and who hears whom; set wheels from the sensors, in
 * several arenas. */
void arena_move(mcp_asdf_arena_t *arenas, uint32_t count);
void arena_find_links(mcp_asdf_arena_t *arena);
void arena_set_wheels(mcp_asdf_arena_t *arenas, uint32_t count);

#endif
