/* The frames that robots exchange on a CAN bus: a codec for any driver, between a driver's frame and the
 * numbers of mcp_asdf.h. It is optional: the core does not use it, and it uses nothing of the core.
 *
 * Every message is one classic CAN 2.0B data frame with a 29-bit identifier and 8 bytes, and also one
 * OpenCyphal v1 single-frame message; docs/design.md gives every bit. There are four kinds:
 *
 *   estimate    a robot's broadcast (x_hat, alpha); every robot sends and receives these
 *   heartbeat   Cyphal's sign of life, once a second from every node
 *   telemetry   x, b_hat and the number of updates, for watchers (optional)
 *   command     a simulator's order to observe or to settle, for lockstep (optional)
 *
 * A robot sends the first three, and receives estimates and commands. Tools read and write all four
 * (docs/design.md).
 *
 * When its broadcast timer expires, a robot sends
 *
 *     const mcp_asdf_estimate_t estimate = {id, count++, mcp_asdf_x_hat(&robot), mcp_asdf_alpha(&robot)};
 *     if (mcp_asdf_encode_estimate(&frame, &format, &estimate) == MCP_ASDF_FRAME_OK)
 *         driver_send(&frame);
 *
 * with `mcp_asdf_frame_format_t format = MCP_ASDF_FORMAT_ESTIMATE` and a uint8_t count, and for every frame
 * that the driver receives
 *
 *     if (mcp_asdf_decode_estimate(&estimate, format.subject, &frame) == MCP_ASDF_FRAME_OK)
 *         mcp_asdf_receive(&robot, estimate.node, estimate.x_hat, estimate.alpha);
 *
 * What holds for every function
 *   - C99, freestanding. No floating point, heap, recursion, static data that changes or libc call; O(1). int
 *     may have 16 bits; no 64-bit arithmetic.
 *   - Pointers must be valid; this is not checked. Functions touch nothing but their arguments.
 *   - A decoder takes any frame whatever, looks at no byte beyond its length, and on any status but OK leaves
 *     *message as it was. An encoder refuses what the decoder would refuse, and then leaves *frame as it was.
 *   - Every range below is inclusive.
 */
#ifndef MCP_ASDF_FRAME_H
#define MCP_ASDF_FRAME_H

#include <stdint.h>

#ifdef __cplusplus
extern "C" {
#endif

/* A CAN frame. A driver's frame is copied into one before it is decoded, and out of one after encoding.
 *   id       identifier without flags: 29 bits, or 11 with MCP_ASDF_FRAME_STANDARD
 *   flags    MCP_ASDF_FRAME_...; 0 for a classic data frame with a 29-bit identifier, which all of ours are.
 *            Other bits are ignored
 *   length   bytes of data; the true number even of a longer (FD) frame, of which only 8 need to be copied
 *   data     bytes in the order of transmission */
typedef struct {
    uint32_t id;
    uint8_t flags;
    uint8_t length;
    uint8_t data[8];
} mcp_asdf_frame_t;

#define MCP_ASDF_FRAME_STANDARD 1U /* 11-bit identifier */
#define MCP_ASDF_FRAME_REMOTE 2U   /* remote transmission request */
#define MCP_ASDF_FRAME_ERROR 4U    /* a driver's report of an error on the bus, no frame at all */
#define MCP_ASDF_FRAME_FD 8U       /* CAN FD */

/* Reasons to refuse a frame or a message. Decoders check in this order. Encoders check the node first, then
 * the format, then the members of the message, the health before the mode. The numbers are none of
 * mcp_asdf_status_t's, so that one log may hold both; host_tools/mcp_asdf_tools/bus/frames.py uses the same.
 */
typedef enum {
    MCP_ASDF_FRAME_OK = 0,
    MCP_ASDF_FRAME_ERR_ERROR_FRAME = -21,
    MCP_ASDF_FRAME_ERR_REMOTE_FRAME = -22,
    MCP_ASDF_FRAME_ERR_FD_FRAME = -23,
    MCP_ASDF_FRAME_ERR_STANDARD_ID = -24,
    MCP_ASDF_FRAME_ERR_SERVICE = -25,       /* a service transfer, not a message */
    MCP_ASDF_FRAME_ERR_ANONYMOUS = -26,     /* the sender has no node id */
    MCP_ASDF_FRAME_ERR_RESERVED_BITS = -27, /* bit 23 or 7 of the identifier is set: not Cyphal v1 */
    MCP_ASDF_FRAME_ERR_SUBJECT = -28,       /* another kind of message, or more than 29 bits */
    MCP_ASDF_FRAME_ERR_LENGTH = -29,        /* not 8 bytes */
    MCP_ASDF_FRAME_ERR_MULTI_FRAME = -30,   /* start, end and toggle bit are not all set */
    MCP_ASDF_FRAME_ERR_X_HAT = -31,         /* above 1.0 */
    MCP_ASDF_FRAME_ERR_ALPHA = -32,         /* sign bit set, infinite or NaN */
    MCP_ASDF_FRAME_ERR_MODE = -33,          /* not a mcp_asdf_mode_t */
    MCP_ASDF_FRAME_ERR_X = -34,             /* above 1.0 */
    MCP_ASDF_FRAME_ERR_B_HAT = -35,         /* outside MCP_ASDF_FRAME_B_HAT_MIN .. _MAX */
    MCP_ASDF_FRAME_ERR_TARGET = -36,        /* neither 0 .. 127 nor MCP_ASDF_EVERY_ROBOT */
    MCP_ASDF_FRAME_ERR_ACTION = -37,        /* not a mcp_asdf_action_t */
    MCP_ASDF_FRAME_ERR_NODE = -38,          /* encoders only: node above 127 */
    MCP_ASDF_FRAME_ERR_FORMAT = -39,        /* encoders only: subject above 6143 or priority above 7 */
    MCP_ASDF_FRAME_ERR_HEALTH = -40         /* encoders only: not a mcp_asdf_health_t */
} mcp_asdf_frame_status_t;

/* Subject and priority of one kind of message, the same on all nodes.
 *   subject    Cyphal subject identifier, 0 .. 6143
 *   priority   0 (wins arbitration) .. 7; receivers ignore it */
typedef struct {
    uint16_t subject;
    uint8_t priority;
} mcp_asdf_frame_format_t;

#define MCP_ASDF_FORMAT_ESTIMATE {3000, 4}
#define MCP_ASDF_FORMAT_TELEMETRY {3001, 6}
#define MCP_ASDF_FORMAT_COMMAND {3002, 3}
#define MCP_ASDF_SUBJECT_HEARTBEAT 7509U
#define MCP_ASDF_SUBJECT_MAX 6143U
#define MCP_ASDF_PRIORITY_MAX 7U
#define MCP_ASDF_NODE_MAX 127U

/* For acceptance filters in hardware or kernel: data frames with a 29-bit identifier `id` for which
 * (id & MASK) == FILTER(subject) are exactly those whose identifier decode accepts. */
#define MCP_ASDF_FRAME_MASK UINT32_C(0x039FFF80)
#define MCP_ASDF_FRAME_FILTER(subject) ((uint32_t)(subject) << 8)

/* Members that all messages have: `node` is the sender's id, 0 .. 127; `transfer_id` is the number of the
 * sender's message of this kind modulo 32, from 0 at start. Encoders take any number and send it modulo 32.
 */

/* A robot's broadcast.
 *   x_hat   local estimate, unit 2^-23, 0 .. 2^23
 *   alpha   local confidence, a word as in mcp_asdf.h. The frame carries it as a binary32 number, exactly; a
 *           number off the grid of 2^-24 is rounded down to it, and one above the largest confidence,
 *           2^31 - 2^7, becomes that */
typedef struct {
    uint8_t node;
    uint8_t transfer_id;
    uint32_t x_hat;
    uint32_t alpha;
} mcp_asdf_estimate_t;

typedef enum {
    MCP_ASDF_HEALTH_NOMINAL = 0,
    MCP_ASDF_HEALTH_ADVISORY = 1,
    MCP_ASDF_HEALTH_CAUTION = 2,
    MCP_ASDF_HEALTH_WARNING = 3
} mcp_asdf_health_t;

typedef enum {
    MCP_ASDF_MODE_OPERATIONAL = 0,
    MCP_ASDF_MODE_INITIALIZATION = 1,
    MCP_ASDF_MODE_MAINTENANCE = 2,
    MCP_ASDF_MODE_SOFTWARE_UPDATE = 3
} mcp_asdf_mode_t;

/* A node's sign of life, due at least once a second.
 *   health          a mcp_asdf_health_t
 *   mode            a mcp_asdf_mode_t
 *   vendor_status   the application's own code, any
 *   uptime          whole seconds since start, any */
typedef struct {
    uint8_t node;
    uint8_t transfer_id;
    uint8_t health;
    uint8_t mode;
    uint8_t vendor_status;
    uint32_t uptime;
} mcp_asdf_heartbeat_t;

#define MCP_ASDF_FRAME_B_HAT_MIN UINT32_C(0x000010) /* 2^-20 */
#define MCP_ASDF_FRAME_B_HAT_MAX UINT32_C(0xFFFFF0) /* 1 - 2^-20 */

/* State of a robot for observers of the bus.
 *   x         informed estimate, unit 2^-23, 0 .. 2^23
 *   b_hat     assumed accuracy, unit 2^-24, MCP_ASDF_FRAME_B_HAT_MIN .. _MAX: mcp_asdf_b_hat() >> 8
 *   updates   number of re-estimates of b_hat modulo 256 */
typedef struct {
    uint8_t node;
    uint8_t transfer_id;
    uint8_t updates;
    uint32_t x;
    uint32_t b_hat;
} mcp_asdf_telemetry_t;

#define MCP_ASDF_EVERY_ROBOT 255U

/* What a command asks for: to begin a control tick with an observation or without, or to end it. The first
 * three numbers are those of mcp_asdf_observation_t. */
typedef enum {
    MCP_ASDF_OBSERVE_WHITE = 0,
    MCP_ASDF_OBSERVE_BLACK = 1,
    MCP_ASDF_OBSERVE_NONE = 2,
    MCP_ASDF_SETTLE = 3
} mcp_asdf_action_t;

/* A simulator's command.
 *   target   id of the robot that is to follow it, 0 .. 127, or MCP_ASDF_EVERY_ROBOT
 *   action   a mcp_asdf_action_t
 *   tick     number of the control tick, any */
typedef struct {
    uint8_t node;
    uint8_t transfer_id;
    uint8_t target;
    uint8_t action;
    uint32_t tick;
} mcp_asdf_command_t;

/* Write a message to a frame. All encoders fail if node or format is out of range (ERR_NODE, ERR_FORMAT), and
 * as listed, with the first reason in this order. The heartbeat's subject is fixed. */

/* Fails if x_hat is out of range (ERR_X_HAT); every alpha is valid. */
mcp_asdf_frame_status_t mcp_asdf_encode_estimate(mcp_asdf_frame_t *frame,
                                                 const mcp_asdf_frame_format_t *format,
                                                 const mcp_asdf_estimate_t *message);

/* Fails if health or mode is unknown (ERR_HEALTH, ERR_MODE). */
mcp_asdf_frame_status_t mcp_asdf_encode_heartbeat(mcp_asdf_frame_t *frame, uint8_t priority,
                                                  const mcp_asdf_heartbeat_t *message);

/* Fails if x or b_hat is out of range (ERR_X, ERR_B_HAT). */
mcp_asdf_frame_status_t mcp_asdf_encode_telemetry(mcp_asdf_frame_t *frame,
                                                  const mcp_asdf_frame_format_t *format,
                                                  const mcp_asdf_telemetry_t *message);

/* Read an estimate from a frame. `subject` is that of estimates, 0 .. 6143; no frame has a larger one. Fails
 * with the first reason to refuse the frame, in the order of mcp_asdf_frame_status_t. */
mcp_asdf_frame_status_t mcp_asdf_decode_estimate(mcp_asdf_estimate_t *message, uint16_t subject,
                                                 const mcp_asdf_frame_t *frame);

/* Read a command from a frame, likewise. The spare byte is ignored, as Cyphal asks. */
mcp_asdf_frame_status_t mcp_asdf_decode_command(mcp_asdf_command_t *message, uint16_t subject,
                                                const mcp_asdf_frame_t *frame);

#ifdef __cplusplus
}
#endif

#endif
