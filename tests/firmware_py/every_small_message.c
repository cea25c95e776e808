/* Decodes and encodes every small message there is, and counts those that do not come back as they were or
 * whose numbers are out of range. */
#include "mcp_asdf_small.h"

#include <stdbool.h>
#include <stdio.h>
#include <string.h>

static bool comes_back(uint32_t word)
{
    const uint8_t bytes[] = {(uint8_t)word, (uint8_t)(word >> 8), (uint8_t)(word >> 16),
                             (uint8_t)(word >> 24)};
    uint8_t again[MCP_ASDF_SMALL_BYTES];
    mcp_asdf_small_message_t message;
    mcp_asdf_decode_small(&message, bytes);
    const bool is_encoded = mcp_asdf_encode_small(again, &message) == MCP_ASDF_OK;
    return is_encoded && message.node <= MCP_ASDF_MAX_ID && memcmp(again, bytes, sizeof bytes) == 0;
}

int main(void)
{
    unsigned long long words = 0, wrong = 0;
    uint32_t word = 0;
    do {
        ++words;
        wrong += !comes_back(word);
    } while (++word != 0);
    printf("%llu words, %llu wrong\n", words, wrong);
    return 0;
}
