"""The small program that uses the library in every way of getting it, and what it must print."""

from __future__ import annotations

import re
from functools import cache

from mcp_asdf.fixed_point import alpha_to_word
from mcp_asdf.mirror import MirrorRobot
from mcp_asdf.robot import Config, Observation
from mcp_asdf_tools.tables.thresholds import generate, parse_omega
from support import HEADER

CONSUMER = """
#include "mcp_asdf.h"

#include <stdio.h>

extern const uint32_t mcp_asdf_t_table_omega05_q30[33];

int main(void)
{
    static const mcp_asdf_config_t config = MCP_ASDF_CONFIG(mcp_asdf_t_table_omega05_q30);
    mcp_asdf_t robot;
    if (mcp_asdf_init(&robot, &config, 1, 0xC0000000) != MCP_ASDF_OK) {
        return 1;
    }
    for (int tick = 0; tick < 2000; ++tick) {
        mcp_asdf_receive(&robot, 2, MCP_ASDF_ONE / 10 * 9, 0x80000006);
        mcp_asdf_receive(&robot, 3, MCP_ASDF_ONE / 9 * 8, 0x80000006);
        mcp_asdf_step(&robot, tick % 3 == 0 ? MCP_ASDF_BLACK : MCP_ASDF_WHITE);
    }
    printf("%lu %lu\\n", (unsigned long)mcp_asdf_x(&robot), (unsigned long)mcp_asdf_b_hat(&robot));
    return 0;
}
"""

ALPHA = alpha_to_word(32.0)
"""The word 0x80000006 of the program."""


@cache
def answer() -> str:
    """Expected output of the program, by the mirror; the run passes through an update of b_hat."""
    robot = MirrorRobot(Config(generate(parse_omega("0.05"), 30)), 1, 0.75)
    for tick in range(2000):
        robot.receive_raw(2, 2**23 // 10 * 9, ALPHA)
        robot.receive_raw(3, 2**23 // 9 * 8, ALPHA)
        robot.step(Observation(tick % 3 == 0))
    assert robot.counters.updates == 1
    return f"{robot.x_raw} {robot.b_hat_raw}\n"


def version_of_header() -> str:
    """The one place where the version stands."""
    text = HEADER.read_text(encoding="utf-8")
    return ".".join(
        re.findall(rf"^#define MCP_ASDF_VERSION_{part} (\d+)$", text, re.MULTILINE)[0]
        for part in ("MAJOR", "MINOR", "PATCH")
    )
