/* A moving world for swarms: robots of the Khepera IV's size diffuse through a walled arena over a black and
 * white floor, avoid what their proximity sensors see, and hear whoever is near and in line of sight. For PCs
 * only.
 *
 * The model and its sources are in docs/arena.md. Units: metres, seconds, radians; the origin is the middle
 * of the floor, x to the east, y to the north. The same configuration gives the same bits on
 * every machine with IEEE 754 doubles, since only + - * / and square roots are used (build without
 * contraction of a * b + c, which is what -std=c99 means to gcc; for clang arena.c says so itself).
 *
 * Nothing is allocated and nothing is static: an arena is the caller's and may be copied. Any number of
 * threads may use arenas of their own at once.
 */
#ifndef MCP_ASDF_ARENA_H
#define MCP_ASDF_ARENA_H

#include <stdint.h>

#define MCP_ASDF_ARENA_MAX_ROBOTS 128
#define MCP_ASDF_ARENA_MAX_PAIRS 8128 /* 128 * 127 / 2 */

/* What mcp_asdf_arena_init() answers; an error names the one setting that is out of its range. */
typedef enum {
    MCP_ASDF_ARENA_OK = 0,
    MCP_ASDF_ARENA_ERR_ROBOTS = -1,
    MCP_ASDF_ARENA_ERR_SIDE = -2,
    MCP_ASDF_ARENA_ERR_SPEED = -3,
    MCP_ASDF_ARENA_ERR_RANGE = -4,
    MCP_ASDF_ARENA_ERR_TILE = -5,
    MCP_ASDF_ARENA_ERR_FILL_RATIO = -6,
    MCP_ASDF_ARENA_ERR_IMAGE = -7,
    MCP_ASDF_ARENA_ERR_CROWDED = -8, /* no room was found for all robots */
    MCP_ASDF_ARENA_ERR_TICK = -9
} mcp_asdf_arena_status_t;

typedef enum { MCP_ASDF_STRAIGHT = 0, MCP_ASDF_SOFT_TURN = 1, MCP_ASDF_HARD_TURN = 2 } mcp_asdf_wheels_t;

/* The world's settings.
 *   seed         of the robots' places and the tiles' colours
 *   robots       1 .. MCP_ASDF_ARENA_MAX_ROBOTS
 *   see_past     0: a body between two robots cuts their link; 1: it does not
 *   width        inner side along x, more than a body's 0.1408 .. 1000
 *   height       inner side along y, likewise
 *   speed        limit of a wheel, above 0 .. 0.814, the Khepera IV's own
 *   range        of communication, between centres, above 0 .. 1000
 *   tick         seconds, above 0 and such that a robot turns on the spot by at most 1.6 in a tick: up to
 *                0.0843 m divided by the speed
 *   tile         side of a tile, at least a hundred-thousandth of the longer side
 *   fill_ratio   chance that a tile is black, 0 .. 1
 *   image        NULL for tiles. Otherwise rows * columns pixels stretched over the floor, the first row in
 *                the north: 0 is white, all else black. It must outlive the arena; tile and fill_ratio are
 *                then not looked at
 *   columns      of the image, above 0
 *   rows         of the image, above 0 */
typedef struct {
    uint64_t seed;
    uint32_t robots;
    uint32_t see_past;
    double width;
    double height;
    double speed;
    double range;
    double tick;
    double tile;
    double fill_ratio;
    const uint8_t *image;
    uint32_t columns;
    uint32_t rows;
} mcp_asdf_arena_config_t;

/* Two robots, a < b. */
typedef struct {
    uint8_t a;
    uint8_t b;
} mcp_asdf_pair_t;

/* A world after a tick; entries 0 .. robots - 1 of the arrays are in use. To be read only, down to links.
 *   x, y         centres
 *   cx, cy       headings, of length 1 up to rounding
 *   black        1 if the floor under the ground sensor is black
 *   wheels       mcp_asdf_wheels_t for the coming tick
 *   avoids       1 if the robot heads away from an obstacle
 *   sees_robot   1 if a proximity sensor of the robot meets another robot
 *   links        the link_count pairs that hear each other, in no promised order */
typedef struct {
    mcp_asdf_arena_config_t config;
    uint64_t ticks;
    double x[MCP_ASDF_ARENA_MAX_ROBOTS];
    double y[MCP_ASDF_ARENA_MAX_ROBOTS];
    double cx[MCP_ASDF_ARENA_MAX_ROBOTS];
    double cy[MCP_ASDF_ARENA_MAX_ROBOTS];
    uint8_t black[MCP_ASDF_ARENA_MAX_ROBOTS];
    uint8_t wheels[MCP_ASDF_ARENA_MAX_ROBOTS];
    uint8_t avoids[MCP_ASDF_ARENA_MAX_ROBOTS];
    uint8_t sees_robot[MCP_ASDF_ARENA_MAX_ROBOTS];
    uint32_t link_count;
    mcp_asdf_pair_t links[MCP_ASDF_ARENA_MAX_PAIRS];

    /* Private. Velocities now, and what the wheels ask for; who is in range or could be seen, by bit j % 64
     * of word j / 64; the robots and pairs that could touch within a tick; the pairs that could matter within
     * ticks_to_watch ticks; tiles in a metre, where their hashes start and the limit below which one is
     * black; seconds of a part of a tick and the change of velocity that motors can give in it. */
    double vx[MCP_ASDF_ARENA_MAX_ROBOTS];
    double vy[MCP_ASDF_ARENA_MAX_ROBOTS];
    double spin[MCP_ASDF_ARENA_MAX_ROBOTS];
    double wanted_speed[MCP_ASDF_ARENA_MAX_ROBOTS];
    double wanted_spin[MCP_ASDF_ARENA_MAX_ROBOTS];
    uint64_t in_range[MCP_ASDF_ARENA_MAX_ROBOTS][2];
    uint64_t near[MCP_ASDF_ARENA_MAX_ROBOTS][2];
    uint8_t may_touch[MCP_ASDF_ARENA_MAX_ROBOTS];
    uint32_t close_count;
    uint32_t watched_count;
    uint32_t ticks_to_watch;
    mcp_asdf_pair_t close[MCP_ASDF_ARENA_MAX_PAIRS];
    mcp_asdf_pair_t watched[MCP_ASDF_ARENA_MAX_PAIRS];
    double tiles_per_metre;
    uint64_t colours;
    double colour_limit;
    double part;
    double motor;
} mcp_asdf_arena_t;

/* Where mcp_asdf_arena_run() writes what each tick leaves: arrays of [ticks][robots], with a last axis of [2]
 * for position (x, y), heading (cx, cy) and linked (mcp_asdf_arena_links()), or NULL for what is not wanted.
 */
typedef struct {
    double *position;
    double *heading;
    uint8_t *black;
    uint8_t *wheels;
    uint8_t *avoids;
    uint8_t *sees_robot;
    uint64_t *linked;
} mcp_asdf_arena_record_t;

/* Check the settings, put the robots on the floor, every place without overlap and every heading equally
 * likely, and let them look around: tick 0. Fails as mcp_asdf_arena_status_t says; the arena is then of no
 * use. O(robots^2) if there is room to spare, else up to 10^5 attempts a robot. */
mcp_asdf_arena_status_t mcp_asdf_arena_init(mcp_asdf_arena_t *arena, const mcp_asdf_arena_config_t *config);

/* A tick: bodies move as the wheels were set, look at floor, obstacles and neighbours from their new places,
 * and set their wheels. O(robots + pairs in range), and O(robots^2) every few ticks. */
void mcp_asdf_arena_step(mcp_asdf_arena_t *arena);

/* `ticks` ticks, each written down. */
void mcp_asdf_arena_run(mcp_asdf_arena_t *arena, uint32_t ticks, const mcp_asdf_arena_record_t *record);

/* Links as bits: bit j % 64 of linked[2 i + j / 64] is set if robots i and j hear each other. linked has 2 *
 * robots words. */
void mcp_asdf_arena_links(const mcp_asdf_arena_t *arena, uint64_t *linked);

/* 1 if the floor is black at (x, y), a point of the floor. O(1). */
int mcp_asdf_arena_is_black(const mcp_asdf_arena_t *arena, double x, double y);

/* Reading of a proximity sensor whose ray meets something `distance` from the body's edge, 0 .. 1. O(1). */
double mcp_asdf_arena_reading(double distance);

/* The obstacle vector of robot `robot`: its readings along their sensors' directions, in its own frame;
 * *ahead and *left are added up, *sees_robot is set to 1 or 0. O(bodies that could be seen). */
void mcp_asdf_arena_obstacle(const mcp_asdf_arena_t *arena, uint32_t robot, double *ahead, double *left,
                             uint8_t *sees_robot);

/* Set the wheels of robot `robot` for an obstacle vector. O(1). */
void mcp_asdf_arena_steer(mcp_asdf_arena_t *arena, uint32_t robot, double ahead, double left);

#endif
