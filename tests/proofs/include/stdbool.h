/* bool, for the proofs' parser. */
#ifndef PROOFS_STDBOOL_H
#define PROOFS_STDBOOL_H

#define bool _Bool
#define false ((bool)0)
#define true ((bool)1)

#endif
