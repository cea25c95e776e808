/* NULL, for the proofs' parser. */
#ifndef PROOFS_STDDEF_H
#define PROOFS_STDDEF_H

#define NULL ((void *)0)

#endif
