/* What test_sabotage.py says falsehoods about. */
#include <stdint.h>

uint32_t shifted(uint32_t value, uint32_t count) { return value << count; }

uint32_t same(uint32_t value) { return value; }

uint32_t caller(uint32_t value) { return same(value); }

uint32_t caller_where_large(uint32_t value)
{
    if (value > 7U) {
        return same(value);
    }
    return value;
}

uint32_t counted(uint32_t value)
{
    uint32_t count = 0;
    const uint32_t before = value > 7U ? count++ : 0U;
    return value < 3U && ++count == 1U ? count + 1U : count + before;
}

uint32_t turned(uint32_t value)
{
    for (uint8_t i = 0; i < 4U; ++i) { /* at most 3 turns */
        value += i;
    }
    return value;
}
