/* The functions that mcp_asdf.h defines inline, as symbols of a library: for other languages, which link the
 * library but cannot compile the header. C and C++ programs do not need this file.
 */
#define MCP_ASDF_INLINE inline
#include "mcp_asdf.h"

extern inline bool mcp_asdf_is_robust(const mcp_asdf_config_t *config);
extern inline uint8_t mcp_asdf_id(const mcp_asdf_t *robot);
extern inline uint32_t mcp_asdf_t_count(const mcp_asdf_t *robot);
extern inline uint32_t mcp_asdf_n_count(const mcp_asdf_t *robot);
extern inline uint32_t mcp_asdf_b_hat(const mcp_asdf_t *robot);
extern inline uint32_t mcp_asdf_x_hat(const mcp_asdf_t *robot);
extern inline uint32_t mcp_asdf_alpha(const mcp_asdf_t *robot);
#if MCP_ASDF_WITH_ASDF
extern inline uint64_t mcp_asdf_beta(const mcp_asdf_t *robot);
#endif
#if MCP_ASDF_WITH_ROBUST
extern inline mcp_asdf_robust_t mcp_asdf_robust(const mcp_asdf_t *robot);
#endif
extern inline mcp_asdf_counters_t mcp_asdf_counters(const mcp_asdf_t *robot);
extern inline uint16_t mcp_asdf_thousandths(uint32_t x);
