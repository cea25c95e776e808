/* The robot of demo.c with floor, clock and ether in a script that comes over the serial line: a byte 0, 1 or
 * 2 is a tick with the observation of that number; a byte 2 + n is followed by n bytes that the radio
 * receives at once. Time stands still until the script goes on. */
#include "demo.h"
#include "port.h"
#include "radio.h"

static mcp_asdf_observation_t tile;

static uint8_t next_byte(void)
{
    int byte;
    do {
        byte = port_get();
    } while (byte < 0);
    return (uint8_t)byte;
}

void board_start(void) { port_put('?'); } /* what came before is lost on some machines */

bool board_tick(void)
{
    const uint8_t byte = next_byte();
    if (byte <= MCP_ASDF_NONE) {
        tile = (mcp_asdf_observation_t)byte;
        return true;
    }
    for (uint8_t left = byte - MCP_ASDF_NONE; left > 0; --left) {
        radio_hear(next_byte());
    }
    return false;
}

mcp_asdf_observation_t board_tile(void) { return tile; }
