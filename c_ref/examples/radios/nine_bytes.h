/* An estimate as a message of nine bytes, for radios that carry short packets: the sender's id and the data
 * of the estimate's CAN frame (mcp_asdf_frame.h). The Kilobot of docs/platforms/kilobot.md sends the same.
 */
#ifndef MCP_ASDF_NINE_BYTES_H
#define MCP_ASDF_NINE_BYTES_H

#include "mcp_asdf.h"
#include "mcp_asdf_frame.h"

#include <string.h>

#define MESSAGE_SIZE 9

static const mcp_asdf_frame_format_t estimate_format = MCP_ASDF_FORMAT_ESTIMATE;

/* Write the robot's present estimate to `message`. The transfer id is the number of earlier messages, of
 * which only the last five bits are sent. */
static inline void write_message(uint8_t message[MESSAGE_SIZE], const mcp_asdf_t *robot, uint8_t transfer_id)
{
    const mcp_asdf_estimate_t estimate = {.node = mcp_asdf_id(robot),
                                          .transfer_id = transfer_id,
                                          .x_hat = mcp_asdf_x_hat(robot),
                                          .alpha = mcp_asdf_alpha(robot)};
    mcp_asdf_frame_t frame = {.length = 0}; /* all else is 0, too */
    /* A robot's own estimate is always in range, so the encoder does not fail. */
    (void)mcp_asdf_encode_estimate(&frame, &estimate_format, &estimate);
    message[0] = estimate.node;
    memcpy(message + 1, frame.data, sizeof frame.data);
}

/* Convert a message to the CAN frame of an estimate, decode it, and let the robot receive it. A message that
 * is no estimate is ignored. */
static inline void receive_message(mcp_asdf_t *robot, const uint8_t message[MESSAGE_SIZE])
{
    /* The id of a CAN frame has the subject and the sender, which is the first byte of the message. */
    mcp_asdf_frame_t frame = {.id = MCP_ASDF_FRAME_FILTER(estimate_format.subject) | message[0],
                              .length = sizeof frame.data};
    mcp_asdf_estimate_t estimate;
    memcpy(frame.data, message + 1, sizeof frame.data);
    if (mcp_asdf_decode_estimate(&estimate, estimate_format.subject, &frame) == MCP_ASDF_FRAME_OK) {
        (void)mcp_asdf_receive(robot, estimate.node, estimate.x_hat, estimate.alpha);
    }
}

#endif
