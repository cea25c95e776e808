/* What the arena takes from a mathematics library: instructions of WebAssembly. */
#ifndef PLAYGROUND_MATH_H
#define PLAYGROUND_MATH_H

#define sqrt __builtin_sqrt
#define fabs __builtin_fabs

#endif
