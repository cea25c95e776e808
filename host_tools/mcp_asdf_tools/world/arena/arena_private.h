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

/* The Khepera IV, in metres; docs/internals/arena.md has the sources. */
#define BODY_RADIUS 0.0704
#define DIAMETER (2 * BODY_RADIUS)
#define WHEEL_DISTANCE 0.1054
#define SENSORS 8                /* of proximity */
#define SENSOR_REACH 0.12        /* from the edge of the body */
#define ACCELERATION (1.5 / 0.4) /* of the motors: 1.5 N on 0.4 kg */

#define BATCH 32    /* robots side by side: a multiple of the 8 that memory has room for */
#define SUBSTEPS 10 /* of a tick; in each, bodies move by the velocities of the substep before */

/* The larger number, without a branch. */
static inline double max_of(double a, double b) { return a > b ? a : b; }

/* The smaller number, without a branch. */
static inline double min_of(double a, double b) { return a < b ? a : b; }

/* The number of low .. high that is nearest to `value`. */
static inline double clamp(double value, double low, double high) { return max_of(low, min_of(high, value)); }

#define TICKS_BETWEEN_SEARCHES 12 /* for candidates */

/* Distance of two centres below which the sensors of one robot may see the other. */
#define SEEING_DISTANCE (DIAMETER + SENSOR_REACH)

/* Distance of two centres in metres below which the bodies may touch within a tick. */
static inline double touching_distance(const mcp_asdf_arena_config_t *config)
{
    return DIAMETER + 2 * config->speed * config->tick;
}

/* Distance of two centres in metres below which a pair may be linked, visible or touchable before the next
 * search: no robot is faster than its wheels. */
static inline double candidate_distance(const mcp_asdf_arena_config_t *config)
{
    const double farthest_use = max_of(config->range, max_of(touching_distance(config), SEEING_DISTANCE));
    return farthest_use + 2 * config->speed * config->tick * TICKS_BETWEEN_SEARCHES;
}

/* A body has room for six others around it, which makes three pairs, and two walls. */
#define CONTACTS_PER_BODY 5

/* Square of the distance between the centres of robots i and j. */
static inline double squared_distance(const mcp_asdf_arena_t *arena, uint32_t i, uint32_t j)
{
    const double dx = arena->x[j] - arena->x[i], dy = arena->y[j] - arena->y[i];
    return dx * dx + dy * dy;
}

/* Coordinate of a centre whose body has its edge `distance` from a wall. The walls are `side` apart, and the
 * origin is in the middle between them. */
static inline double position_before_wall(double side, double distance)
{
    return side / 2 - (BODY_RADIUS + distance);
}

/* Move all bodies of `count` arenas for one tick, as their wheels were set. */
void arena_move(mcp_asdf_arena_t *arenas, uint32_t count);

/* Find the pairs of robots that are linked, visible and touchable now. */
void arena_find_links(mcp_asdf_arena_t *arena);

/* Set the wheels of all robots in `count` arenas from what their proximity sensors see. */
void arena_set_wheels(mcp_asdf_arena_t *arenas, uint32_t count);

#endif
