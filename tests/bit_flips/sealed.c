/* An experiment: a robot sealed from the end of a tick to the start of the next, in two ways, to see what it
 * costs. Not part of the firmware. */
#include "mcp_asdf_image.h"
#include "robot.h"

extern mcp_asdf_t robot;
extern uint8_t image[MCP_ASDF_IMAGE_SIZE];
uint8_t sealed[MCP_ASDF_IMAGE_SIZE];

/* FNV-1a over all words of the robot: to seal, and once more to check. */
uint32_t seal_words(const mcp_asdf_t *sealed_robot)
{
    const uint32_t *const words = (const uint32_t *)(const void *)sealed_robot;
    uint32_t hash = UINT32_C(0x811C9DC5);
    for (uint8_t i = 0; i < sizeof *sealed_robot / 4; ++i) {
        hash = (hash ^ words[i]) * UINT32_C(0x01000193);
    }
    return hash;
}

/* An image, to seal; another one to compare, to check; and then the first is there to restore. */
uint32_t seal_image(const mcp_asdf_t *sealed_robot)
{
    uint32_t differences = 0;
    mcp_asdf_save(sealed_robot, image);
    for (uint8_t i = 0; i < MCP_ASDF_IMAGE_SIZE; ++i) {
        differences |= image[i] ^ sealed[i];
    }
    return differences;
}
