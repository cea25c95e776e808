/* Where constant tables live, and how a word or byte of one is read: in flash on an AVR, elsewhere like any
 * constant. For another machine with separate memories define all three on the compiler's command line. */
#ifndef MCP_ASDF_ROM_H
#define MCP_ASDF_ROM_H

#include <stdint.h>

#if !defined(MCP_ASDF_ROM) && !defined(MCP_ASDF_READ_WORD) && !defined(MCP_ASDF_READ_BYTE)
#ifdef __AVR__
#include <avr/pgmspace.h>
#define MCP_ASDF_ROM PROGMEM
#define MCP_ASDF_READ_WORD(address) pgm_read_dword(address)
#define MCP_ASDF_READ_BYTE(address) pgm_read_byte(address)
#else
#define MCP_ASDF_ROM
#define MCP_ASDF_READ_WORD(address) (*(address))
#define MCP_ASDF_READ_BYTE(address) (*(address))
#endif
#elif !defined(MCP_ASDF_ROM) || !defined(MCP_ASDF_READ_WORD) || !defined(MCP_ASDF_READ_BYTE)
#error "define all of MCP_ASDF_ROM, MCP_ASDF_READ_WORD and MCP_ASDF_READ_BYTE, or none"
#endif

#endif
