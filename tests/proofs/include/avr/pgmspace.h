/* Flash of an AVR, which to the proofs is memory like any other. */
#ifndef PROOFS_PGMSPACE_H
#define PROOFS_PGMSPACE_H

#define PROGMEM
#define pgm_read_byte(address) (*(address))
#define pgm_read_dword(address) (*(address))

#endif
