"""The whole firmware of a Kilobot: core, t-table, frame codec and the main loop of c_ref/ports/demo.c."""

from __future__ import annotations

import re
from pathlib import Path

from .images import FIRMWARE, PORTS, ROOT, TARGETS, Image, build
from .stacks import Stacks

AVR = TARGETS[0]
FLASH, RAM = 32 * 1024, 2 * 1024
"""Bytes of an ATmega328P."""
CLOCK = 8_000_000
"""Of a Kilobot, hertz."""
BAUD = 38_400
"""Of its serial line: 115200 is out of an 8 MHz UART's reach."""

_SOURCES = (
    PORTS / "demo.c",
    PORTS / "packet_radio.c",
    PORTS / "avr" / "demo_atmega.c",
    PORTS / "avr" / "atmega.c",
    FIRMWARE / "mcp_asdf.c",
    FIRMWARE / "mcp_asdf_image.c",
    FIRMWARE / "mcp_asdf_frame.c",
    ROOT / "tables" / "t_table_omega05_q30.c",
)
_INTERRUPT = re.compile(r"__vector_\d+")


def demo_image(folder: Path) -> Image:
    """The firmware, built in a new folder for a Kilobot's clock."""
    clock = (f"-DF_CPU={CLOCK}UL", f"-DBAUD={BAUD}")
    return build(AVR, folder, list(_SOURCES), "-Os", f"-I{PORTS}", *clock)


def measure_demo(folder: Path) -> dict[str, int]:
    """Bytes of flash, of variables, and of stack: the main loop's and an interrupt's on top of it."""
    image = demo_image(folder)
    stacks = Stacks(image)
    handlers = [
        name
        for name, symbol in image.symbols.items()
        if _INTERRUPT.fullmatch(name) and symbol["st_info"]["bind"] == "STB_GLOBAL"  # others are not handled
    ]
    return {
        "flash": image.flash(),
        "variables": image.ram(),
        "stack": stacks.deepest("main") + max(map(stacks.deepest, handlers)),
    }
