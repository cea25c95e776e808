/* A t-table for MCP-ASDF: thresholds of the hypothesis test. Generated; to change it, make another.
 *
 *   omega               0.05 (type II error probability)
 *   q                   30 (maximum number of messages in a round that has an entry of its own)
 *   degrees of freedom  m - 1, for m messages
 *   entries             k_m = (t_{m-1,(1-omega)/2} / sqrt(m) + 1)^2 m / (m - 1) for m = 2 .. q, to nearest;
 *                       one more for all m > q: k at m = q + 1 with the normal quantile in place of t
 *   format              version 2: magic and q, omega, entries (2^-26), checksum
 *   size                132 bytes = 12 + 4 q
 *   threshold error     relative, at most 3.16e-09 for m <= q (at most 1.83% for q < m <= 127)
 *   generator version   2
 *
 * made with   mcp-asdf table --omega 0.05 --neighbours 30 --output .
 * check with  mcp-asdf table --check t_table_omega05_q30.c
 * use with    extern const uint32_t mcp_asdf_t_table_omega05_q30[33];
 */
#include "mcp_asdf_rom.h"

extern const uint32_t mcp_asdf_t_table_omega05_q30[33];

/* clang-format off */
const uint32_t mcp_asdf_t_table_omega05_q30[33] MCP_ASDF_ROM = {
    0x4D43541EU, /* magic, q */
    0x0CCCCCCDU, /* omega * 2^32 */
    0x08EA4980U, /* m = 2: 2.228796005 */
    0x0680232AU, /* m = 3: 1.625134140 */
    0x05B3E0BDU, /* m = 4: 1.425661996 */
    0x054D88FEU, /* m = 5: 1.325717896 */
    0x050FD2AAU, /* m = 6: 1.265452057 */
    0x04E66F28U, /* m = 7: 1.225033402 */
    0x04C8AECFU, /* m = 8: 1.195979342 */
    0x04B239CFU, /* m = 9: 1.174048647 */
    0x04A0A5DCU, /* m = 10: 1.156882703 */
    0x04927F5EU, /* m = 11: 1.143063992 */
    0x0486D963U, /* m = 12: 1.131688640 */
    0x047D1599U, /* m = 13: 1.122152701 */
    0x0474C61EU, /* m = 14: 1.114037007 */
    0x046D9C45U, /* m = 15: 1.107041433 */
    0x04675E33U, /* m = 16: 1.100945279 */
    0x0461E068U, /* m = 17: 1.095582604 */
    0x045D0188U, /* m = 18: 1.090826154 */
    0x0458A791U, /* m = 19: 1.086576715 */
    0x0454BDECU, /* m = 20: 1.082755744 */
    0x04513414U, /* m = 21: 1.079300225 */
    0x044DFCA1U, /* m = 22: 1.076159015 */
    0x044B0C96U, /* m = 23: 1.073290199 */
    0x04485AD5U, /* m = 24: 1.070658997 */
    0x0445DFC3U, /* m = 25: 1.068236396 */
    0x044394F8U, /* m = 26: 1.065997958 */
    0x04417505U, /* m = 27: 1.063922957 */
    0x043F7B44U, /* m = 28: 1.061993659 */
    0x043DA3B9U, /* m = 29: 1.060194865 */
    0x043BEAF1U, /* m = 30: 1.058513418 */
    0x043A1A19U, /* m > 30: 1.056740180 */
    0x235CF62BU, /* checksum */
};
