/* Loops that become vector instructions, in the arena and in the engine: plain C, whose text is what every
 * processor computes. No sum is reordered and no a * b + c fused, so all vector sizes give the same bits.
 */
#ifndef MCP_ASDF_TARGETS_H
#define MCP_ASDF_TARGETS_H

#include <stddef.h>
#include <stdint.h>

/* Compiles a function for several vector sizes; the one for the processor at hand is chosen when the program
 * starts. Results are the same. Tests and benchmarks set it to compile for one of them. */
#ifndef FOR_EACH_TARGET
#if defined(__GNUC__) && !defined(__clang__) && defined(__x86_64__) && defined(__gnu_linux__)
#define FOR_EACH_TARGET __attribute__((target_clones("default", "arch=x86-64-v3", "arch=x86-64-v4")))
#else
#define FOR_EACH_TARGET
#endif
#endif

/* What such a function calls within its loops. */
#ifdef __GNUC__
#define IN_LOOPS static inline __attribute__((always_inline))
#else
#define IN_LOOPS static inline
#endif

/* Before a loop whose turns neither read nor write what others write: it becomes vectors, and is not unrolled
 * before that. */
#if defined(__GNUC__) && !defined(__clang__)
#define SIDE_BY_SIDE _Pragma("GCC ivdep") _Pragma("GCC unroll 1")
#else
#define SIDE_BY_SIDE
#endif

#define VECTOR 8U /* doubles in a vector */
#define VECTOR_BYTES 64U

/* Returns the number of bytes from `memory` to the next address that is a multiple of VECTOR_BYTES: 0 or
 * more. Negation modulo 2^64 gives this distance. */
static inline size_t bytes_before_vector(const void *memory) { return -(uintptr_t)memory % VECTOR_BYTES; }

/* The next multiple of a vector: the arena's memory has room for so many robots. */
#define WHOLE_VECTORS(count) (((count) + VECTOR - 1) / VECTOR * VECTOR)

#endif
