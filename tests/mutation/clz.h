/* For compilers without this function of gcc's, so that the code that asks for it can be tried. Of 0 it may
 * be any number. */
static inline int mutation_clz(unsigned value)
{
    int zeros = 0;
    for (; zeros < 32 && value >> (31 - zeros) == 0; ++zeros) {
    }
    return zeros;
}
#define __builtin_clz(value) mutation_clz(value)
