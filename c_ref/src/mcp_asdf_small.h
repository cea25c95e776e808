/* Small messages: a robot's broadcast (sender, x_hat, alpha) in 4 bytes, for radios that carry no more, such
 * as the e-puck's range-and-bearing board. Optional: the method of mcp_asdf.h does not use it, and on a CAN
 * bus there is room for the exact numbers (mcp_asdf_frame.h).
 *
 * Only what is sent is rounded. A robot goes on with its own exact x_hat and alpha:
 *
 *     const mcp_asdf_small_message_t message = {id, mcp_asdf_x_hat(&robot), mcp_asdf_alpha(&robot)};
 *     uint8_t bytes[MCP_ASDF_SMALL_BYTES];
 *     if (mcp_asdf_encode_small(bytes, &message) == MCP_ASDF_OK)
 *         radio_send(bytes);
 *
 * and for every 4 bytes that the radio receives
 *
 *     mcp_asdf_small_message_t message;
 *     mcp_asdf_decode_small(&message, bytes);
 *     mcp_asdf_receive(&robot, message.node, message.x_hat, message.alpha);
 *
 * docs/design.md gives every bit and the rounding; docs/internals/small_messages.md shows how few bits
 * suffice. A message has no checksum: the radio has to drop damaged ones.
 *
 * What holds for every function: C99, freestanding; no floating point, heap, recursion, static data or libc
 * call; O(1). Pointers must be valid; this is not checked.
 */
#ifndef MCP_ASDF_SMALL_H
#define MCP_ASDF_SMALL_H

#include "mcp_asdf.h"

#ifdef __cplusplus
extern "C" {
#endif

#define MCP_ASDF_SMALL_BYTES 4
#define MCP_ASDF_SMALL_X_HAT_BITS 16U
#define MCP_ASDF_SMALL_ALPHA_BITS 9U

/* A robot's broadcast.
 *   node    id of the sender, 0 .. 127
 *   x_hat   local estimate, unit 2^-23, 0 .. 2^23
 *   alpha   local confidence, an alpha word as in mcp_asdf.h */
typedef struct {
    uint8_t node;
    uint32_t x_hat;
    uint32_t alpha;
} mcp_asdf_small_message_t;

/* Write a message to 4 bytes, with x_hat and alpha rounded. Fails if node is above 127 (ERR_SENDER) or x_hat
 * above 1.0 (ERR_X_HAT), and then leaves the bytes as they were. */
mcp_asdf_status_t mcp_asdf_encode_small(uint8_t bytes[MCP_ASDF_SMALL_BYTES],
                                        const mcp_asdf_small_message_t *message);

/* Read a message from 4 bytes. Any bytes are a valid message, and encoding it gives the same bytes again. */
void mcp_asdf_decode_small(mcp_asdf_small_message_t *message, const uint8_t bytes[MCP_ASDF_SMALL_BYTES]);

/* For messages with another number of bits: x_hat and alpha as codes of so many bits. Decoding is exact, and
 * encoding what was decoded gives the same code again. Decoders ignore the bits above. */

/* Returns the code of `bits` bits, 1 .. MCP_ASDF_X_HAT_BITS_MAX, that stands for the number nearest to x_hat,
 * which is 0 .. 2^23. Code 0 is 0.0 and the largest is 1.0. An x_hat of 1/2 lies halfway between two codes,
 * and gets the larger. */
#define MCP_ASDF_X_HAT_BITS_MAX 23U
uint32_t mcp_asdf_x_hat_to_code(uint32_t x_hat, uint32_t bits);

/* Returns the x_hat nearest to what a code stands for. */
uint32_t mcp_asdf_x_hat_from_code(uint32_t code, uint32_t bits);

/* Returns the code of `bits` bits, 1 .. MCP_ASDF_ALPHA_BITS_MAX, of the largest confidence not above that of
 * an alpha word. Code 0 is no confidence; even the smallest confidence above 0 gets code 1. */
#define MCP_ASDF_ALPHA_BITS_MAX 25U
uint32_t mcp_asdf_alpha_to_code(uint32_t alpha, uint32_t bits);

/* Returns the alpha word of a code, with the smallest shift. */
uint32_t mcp_asdf_alpha_from_code(uint32_t code, uint32_t bits);

#ifdef __cplusplus
}
#endif

#endif
