/* The firmware as a table of functions, so that builds for several targets fit into one program. */
#ifndef FUZZ_VARIANT_H
#define FUZZ_VARIANT_H

#include "mcp_asdf_image.h"

#ifdef __cplusplus
extern "C" {
#endif

typedef struct {
    mcp_asdf_status_t (*init)(mcp_asdf_t *, const mcp_asdf_config_t *, uint8_t, uint32_t);
    mcp_asdf_status_t (*observe)(mcp_asdf_t *, mcp_asdf_observation_t);
    mcp_asdf_status_t (*receive)(mcp_asdf_t *, uint8_t, uint32_t, uint32_t);
    mcp_asdf_status_t (*settle)(mcp_asdf_t *);
    mcp_asdf_status_t (*step)(mcp_asdf_t *, mcp_asdf_observation_t);
    uint32_t (*x)(const mcp_asdf_t *);
    uint32_t (*x_bar)(const mcp_asdf_t *);
    bool (*invariants_hold)(const mcp_asdf_t *);
    void (*save)(const mcp_asdf_t *, uint8_t *);
    mcp_asdf_status_t (*restore)(mcp_asdf_t *, const mcp_asdf_config_t *, const uint8_t *);
} firmware_t;

extern const firmware_t firmware_1001, firmware_2100, firmware_3010, firmware_4000;

#ifdef __cplusplus
}
#endif

#endif
