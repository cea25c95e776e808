/* The robot of demo.c with floor, clock and ether in a script that comes over the serial line: a byte 0, 1 or
 * 2 is a tick on a white tile, a black one or none; a byte 2 + n is followed by n bytes that the radio
 * receives at once. Time stands still until the script goes on. */
#include "demo.h"
#include "port.h"
#include "radio.h"

#define NO_TILE 2

static uint8_t now; /* MCP_ASDF_WHITE, MCP_ASDF_BLACK or NO_TILE */

static uint8_t next_byte(void)
{
    int byte;
    do {
        byte = port_get();
    } while (byte < 0);
    return (uint8_t)byte;
}

void board_start(void) { port_put('?'); } /* what came before is lost on some machines */

bool board_has_tick_begun(void)
{
    const uint8_t byte = next_byte();
    if (byte <= NO_TILE) {
        now = byte;
        return true;
    }
    for (uint8_t left = byte - NO_TILE; left > 0; --left) {
        radio_receive_byte(next_byte());
    }
    return false;
}

bool board_read_tile(mcp_asdf_observation_t *tile)
{
    *tile = now == MCP_ASDF_BLACK ? MCP_ASDF_BLACK : MCP_ASDF_WHITE;
    return now != NO_TILE;
}
