/* A t-table for MCP-ASDF: thresholds of the hypothesis test. Generated; to change it, make another.
 *
 *   omega               0.05 (type II error probability)
 *   q                   30 (most messages in a round that have an entry of their own)
 *   degrees of freedom  m - 1, for m messages
 *   entries             k_m = (t_{m-1,(1-omega)/2} / sqrt(m) + 1)^2 m / (m - 1) for m = 2 .. q, to nearest;
 *                       one more for all m > q: k at m = q + 1 with the normal quantile in place of t
 *   format              version 1: 4 header words, then entries in units of 2^-30
 *   size                136 bytes = 16 + 4 q
 *   threshold error     relative, at most 1.97e-10 for m <= q (at most 1.83% for q < m <= 127)
 *   generator version   1
 *
 * made with   mcp-asdf table --omega 0.05 --neighbours 30 --output .
 * check with  mcp-asdf table --check t_table_omega05_q30.c
 * use with    extern const uint32_t mcp_asdf_t_table_omega05_q30[34];
 */
#include "mcp_asdf.h"

extern const uint32_t mcp_asdf_t_table_omega05_q30[34];

/* clang-format off */
const uint32_t mcp_asdf_t_table_omega05_q30[34] MCP_ASDF_ROM = {
    0x4D435054U, /* magic */
    0x011E1E00U, /* version, q, F */
    0x0CCCCCCDU, /* omega * 2^32 */
    0x728DB690U, /* checksum */
    0x8EA497FBU, /* m = 2: 2.228796001 */
    0x68023299U, /* m = 3: 1.625134134 */
    0x5B3E0BD5U, /* m = 4: 1.425662001 */
    0x54D88FE2U, /* m = 5: 1.325717898 */
    0x50FD2AA1U, /* m = 6: 1.265452058 */
    0x4E66F287U, /* m = 7: 1.225033409 */
    0x4C8AECEEU, /* m = 8: 1.195979340 */
    0x4B239CEFU, /* m = 9: 1.174048646 */
    0x4A0A5DBAU, /* m = 10: 1.156882698 */
    0x4927F5DEU, /* m = 11: 1.143063990 */
    0x486D9634U, /* m = 12: 1.131688643 */
    0x47D1598EU, /* m = 13: 1.122152699 */
    0x474C61E5U, /* m = 14: 1.114037012 */
    0x46D9C44FU, /* m = 15: 1.107041433 */
    0x4675E32EU, /* m = 16: 1.100945277 */
    0x461E0679U, /* m = 17: 1.095582598 */
    0x45D0187FU, /* m = 18: 1.090826153 */
    0x458A7911U, /* m = 19: 1.086576716 */
    0x454BDEBAU, /* m = 20: 1.082755739 */
    0x4513413AU, /* m = 21: 1.079300219 */
    0x44DFCA16U, /* m = 22: 1.076159021 */
    0x44B0C95AU, /* m = 23: 1.073290193 */
    0x4485AD4FU, /* m = 24: 1.070658996 */
    0x445DFC35U, /* m = 25: 1.068236400 */
    0x44394F86U, /* m = 26: 1.065997964 */
    0x44175049U, /* m = 27: 1.063922950 */
    0x43F7B43BU, /* m = 28: 1.061993654 */
    0x43DA3B89U, /* m = 29: 1.060194858 */
    0x43BEAF0EU, /* m = 30: 1.058513416 */
    0x43A1A18CU, /* m > 30: 1.056740176 */
};
