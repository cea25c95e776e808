/* The integer types, for the proofs' parser. They have these names' ranges on every target; how wide an int
 * is, which differs, the proofs know by themselves. */
#ifndef PROOFS_STDINT_H
#define PROOFS_STDINT_H

typedef unsigned char uint8_t;
typedef unsigned short uint16_t;
typedef unsigned int uint32_t;
typedef unsigned long long uint64_t;
typedef signed char int8_t;
typedef short int16_t;
typedef int int32_t;
typedef long long int64_t;

#define UINT16_MAX 0xFFFFU
#define UINT8_MAX 255
#define UINT32_MAX ((uint32_t)0xFFFFFFFF)
#define UINT32_C(value) ((uint32_t)value)
#define UINT64_C(value) ((uint64_t)value)

#endif
