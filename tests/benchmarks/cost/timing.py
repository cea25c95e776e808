"""Cycles of an instruction, for bounds, and for processors whose emulator counts instructions only.

The figures are those of the makers' manuals for memory without wait states, and the largest where they give a
range: an estimate from above. Sources: Arm's technical reference manuals of the Cortex-M0+ (with the
single-cycle multiplier), M3 and M4, section "Instruction set summary"; for RV32IMC the Ibex manual, section
"Pipeline Details", with two stages and the single-cycle multiplier; for the ATmega328P Microchip's AVR
instruction set manual, columns "AVRe".
"""

from __future__ import annotations

import re
from dataclasses import dataclass

_LIST = re.compile(r"\{(.*)\}")
_CONDITIONAL = re.compile(
    r"br(eq|ne|cs|cc|sh|lo|mi|pl|ge|lt|hs|hc|ts|tc|vs|vc|ie|id)|"
    r"b(eq|ne|cs|cc|mi|pl|vs|vc|hi|ls|ge|lt|gt|le)(\.[nw])?|cbn?z|(c\.)?b(eq|ne|lt|ge|ltu|geu|gt|le|gtu|leu)z?"
)


@dataclass(frozen=True)
class Timing:
    """Cycles by the instruction's name.

    Attributes:
        rules: Pairs of a pattern of the name and cycles; the first that matches counts, others take 1.
        taken: Further cycles of a conditional branch that is taken.
        refill: Further cycles of an instruction that loads the program counter.
    """

    rules: tuple[tuple[str, int], ...]
    taken: int
    refill: int = 0

    def cycles(self, name: str, operands: str) -> int:
        """Of one instruction; a conditional branch as if it were not taken."""
        registers = _LIST.search(operands)
        if registers and "," not in operands[registers.end() :]:
            listed = [register.strip() for register in registers[1].split(",")]
            return 1 + len(listed) + (self.refill if "pc" in listed else 0)
        if is_conditional(name):
            return 1
        own = next((cycles for pattern, cycles in self.rules if re.match(pattern, name)), 1)
        return own + (self.refill if operands.startswith("pc,") else 0)


def is_conditional(name: str) -> bool:
    """True if an instruction of that name is a conditional branch."""
    return _CONDITIONAL.fullmatch(name) is not None


_ARM_JUMPS = r"b(\.[nw])?$|bx|blx|bl"
TIMINGS = {
    "ATmega328P": Timing(
        (
            (r"call$|reti?$", 4),
            (r"rcall$|icall$|jmp$|e?lpm$", 3),
            (r"rjmp$|ijmp$|ldd?$|lds$|std?$|sts$|push$|pop$|f?mul|adiw$|sbiw$|[cs]bi$", 2),
        ),
        taken=1,
    ),
    "Cortex-M0+": Timing(((r"bl$", 3), (_ARM_JUMPS, 2), (r"ldr|str", 2)), taken=1, refill=2),
    "Cortex-M3": Timing(
        (
            (_ARM_JUMPS, 4),
            (r"tb[bh]", 5),
            (r"(ldr|str)d", 3),
            (r"ldr|str", 2),
            (r"[us]mlal", 7),
            (r"[us]mull", 5),
            (r"ml[as]", 2),
            (r"[us]div", 12),
        ),
        taken=3,
        refill=3,
    ),
    "Cortex-M4": Timing(
        ((_ARM_JUMPS, 4), (r"tb[bh]", 5), (r"(ldr|str)d", 3), (r"ldr|str", 2), (r"[us]div", 12)),
        taken=3,
        refill=3,
    ),
    "RV32IMC": Timing(
        ((r"mulh", 2), (r"div|rem", 38), (r"(j|jal|jr|jalr|ret|tail|call)$", 2), (r"l[bhw]u?$|s[bhw]$", 2)),
        taken=2,
    ),
}
