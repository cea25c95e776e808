/* A moving world for swarms. Robots the size of a Khepera IV diffuse through a walled arena with a black and
 * white floor, avoid what their proximity sensors see, and receive from every robot within range and line of
 * sight.
 * For PCs only.
 *
 * The model is that of the paper's dynamic experiments, written anew from the authors' controller, the ARGoS3
 * simulator and its Khepera IV plugin. docs/internals/arena.md states it number by number, with the sources,
 * and compares the motion with that of the authors' programs.
 *
 * Units are metres, seconds and radians. The origin is the middle of the floor, x points east, y north.
 *
 * The same settings give the same bits on every machine with IEEE 754 doubles: only + - * / and square roots
 * are used, and no compiler may fuse a * b + c. With gcc that takes -std=c99; clang is told by a pragma.
 *
 * Nothing is allocated and nothing is static. The caller owns the arena and its memory, which grows linearly
 * with the robots, and any number of threads may run arenas of their own.
 */
#ifndef MCP_ASDF_ARENA_H
#define MCP_ASDF_ARENA_H

#include <stddef.h>
#include <stdint.h>

#define MCP_ASDF_ARENA_MAX_ROBOTS 65536 /* ids of 16 bits */

/* Modes of the wheels: both at full speed, the inner one slower, or turning on the spot. */
typedef enum { MCP_ASDF_STRAIGHT = 0, MCP_ASDF_SOFT_TURN = 1, MCP_ASDF_HARD_TURN = 2 } mcp_asdf_wheels_t;

/* Settings of a world, which must be in these ranges: the tools check them (settings.py).
 *   seed         for the robots' positions and the colours of the tiles
 *   robots       1 .. MCP_ASDF_ARENA_MAX_ROBOTS
 *   width        inner side along x: above 0.1408, the diameter of a body, up to 1000
 *   height       inner side along y, same range
 *   speed        maximum speed of a wheel: above 0, up to 0.814, the limit of the Khepera IV
 *   range        of communication, between centres: above 0, up to 1000. Memory grows with its square until
 *                all robots have room within it
 *   tick         seconds: above 0, and short enough that a robot turning on the spot turns by at most 1.6,
 *                which is 0.0843 m divided by the speed
 *   tile         side of a tile, at least 1/100000 of the longer side
 *   fill_ratio   probability that a tile is black, 0 .. 1
 *   image        NULL for tiles. Otherwise rows * columns pixels stretched over the floor, row by row from
 *                the north: 0 is white, anything else black. It must outlive the arena; tile and fill_ratio
 *                are then ignored
 *   columns      of the image, above 0
 *   rows         of the image, above 0 */
typedef struct {
    uint64_t seed;
    uint32_t robots;
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
    uint16_t a;
    uint16_t b;
} mcp_asdf_pair_t;

/* Private: a grid of at most as many cells as robots, row by row from the south-west.
 *   columns, rows    numbers of cells
 *   first_of_cell    [cells + 1] where the robots of each cell begin in robots_by_cell
 *   robots_by_cell   the robots sorted by cells, and in each cell in ascending order
 *   cell_of_robot    the cell that each robot is in */
typedef struct {
    uint32_t columns;
    uint32_t rows;
    uint32_t *first_of_cell;
    uint16_t *robots_by_cell;
    uint32_t *cell_of_robot;
} mcp_asdf_grid_t;

/* Private: a point at which a body may touch another body or a wall within a substep.
 *   a, b                 bodies; b is -1 for a wall
 *   normal_x, normal_y   unit vector away from a
 *   gap                  distance that is left
 *   normal_change        change of velocity along the normal that the contact has made in this substep
 *   tangent_change       the same across the normal: friction */
typedef struct {
    int a;
    int b;
    double normal_x;
    double normal_y;
    double gap;
    double normal_change;
    double tangent_change;
} mcp_asdf_contact_t;

/* Private: bodies that may touch something within a tick, and their contacts in the present substep. An
 * entry of all arrays together describes one of these bodies.
 *   robot                            number of the body in the arena
 *   target_vx, target_vy             velocity that the wheels ask for
 *   motor_change_x, motor_change_y   change of velocity that the motors have made so far in this substep */
typedef struct {
    uint32_t count;
    uint32_t contact_count;
    uint16_t *robot;
    double *target_vx;
    double *target_vy;
    double *motor_change_x;
    double *motor_change_y;
    mcp_asdf_contact_t *contacts;
} mcp_asdf_bodies_t;

/* A world after a tick. Entries 0 .. robots - 1 of the arrays are in use, and up to the next multiple of 8
 * may be read; do not write.
 *   x, y         centres
 *   cx, cy       headings: cosine and sine, of length 1 up to rounding
 *   black        1 if the floor under the ground sensor is black
 *   wheels       mcp_asdf_wheels_t for the coming tick
 *   avoids       1 if the robot heads away from an obstacle
 *   links        the link_count pairs a < b that receive from each other, in ascending order of a, then of b:
 *                so the neighbours of each robot come in ascending order
 * Private, below links:
 *   vx, vy, spin                  present velocities
 *   target_speed, target_spin     velocities that the wheels ask for
 *   in_range                      a set of the robots in range of each: bit j % 64 if robot j is among them
 *   may_touch                     1 for each robot that could touch something within a tick
 *   needs_steering                1 for each robot that may sense something, or turns or avoids something
 *   free_distance                 [robots * 8] distance to the nearest body along each sensor's ray
 *   visible                       the visible_count pairs close enough to see each other
 *   touchable                     the touchable_count pairs that could touch within a tick
 *   candidates                    the candidate_count pairs that could be linked, visible or touchable in the
 *                                 coming ticks, which are searched again after ticks_to_search ticks
 *   first_candidate, candidates_of   the robots in a candidate pair with robot i: candidates_of from
 *                                 first_candidate[i] to below first_candidate[i + 1]
 *   grid                          robots by cells of the floor, to find the candidates
 *   touching                      the robots that may touch something, as motion.c needs them
 *   tiles_per_metre               number of tiles per metre
 *   colour_seed                   base of the hashes that decide the tiles' colours
 *   black_limit                   a tile is black if its 53-bit hash is below this
 *   substep                       seconds in a substep of a tick
 *   max_motor_change              maximum change of velocity by the motors in a substep */
typedef struct {
    mcp_asdf_arena_config_t config;
    double *x;
    double *y;
    double *cx;
    double *cy;
    uint8_t *black;
    uint8_t *wheels;
    uint8_t *avoids;
    uint32_t link_count;
    mcp_asdf_pair_t *links;

    /* Private. */
    double *vx;
    double *vy;
    double *spin;
    double *target_speed;
    double *target_spin;
    uint64_t *in_range;
    uint64_t *may_touch;
    uint64_t *needs_steering;
    double *free_distance;
    uint32_t visible_count;
    uint32_t touchable_count;
    uint32_t candidate_count;
    uint32_t ticks_to_search;
    mcp_asdf_pair_t *visible;
    mcp_asdf_pair_t *touchable;
    mcp_asdf_pair_t *candidates;
    uint32_t *first_candidate;
    uint16_t *candidates_of;
    mcp_asdf_grid_t grid;
    mcp_asdf_bodies_t touching;
    double tiles_per_metre;
    uint64_t colour_seed;
    double black_limit;
    double substep;
    double max_motor_change;
} mcp_asdf_arena_t;

/* Bytes of memory that an arena needs: about 1.7 KB a robot with a range of 0.7 at the usual speed, less for
 * few robots. O(1). */
size_t mcp_asdf_arena_bytes(const mcp_asdf_arena_config_t *config);

/* Place the robots at random without overlap, with headings uniform too, and let them sense their
 * surroundings: tick 0, all at rest. `memory`, of mcp_asdf_arena_bytes() and aligned for doubles, belongs to
 * the arena from now on. Returns 1, or 0 if they find no room: the arena must then not be used. O(robots^2)
 * where there is room to spare, otherwise up to 10^5 attempts per robot. */
int mcp_asdf_arena_init(mcp_asdf_arena_t *arena, const mcp_asdf_arena_config_t *config, void *memory);

/* One tick of `count` arenas side by side, which is faster than one by one: bodies move as their wheels were
 * set; then, from their new places, robots find their neighbours, sense obstacles and floor, and set their
 * wheels. O(robots + pairs nearby). */
void mcp_asdf_arena_step(mcp_asdf_arena_t *arenas, uint32_t count);

/* 1 if the floor is black at (x, y), which must be on the floor; otherwise 0. O(1). */
int mcp_asdf_arena_is_black(const mcp_asdf_arena_t *arena, double x, double y);

/* Set the wheels of robot `robot` so that it turns away from an obstacle vector, (ahead, left) in its own
 * frame. O(1). */
void mcp_asdf_arena_steer(mcp_asdf_arena_t *arena, uint32_t robot, double ahead, double left);

#endif
