"""Which instruction may follow which in an image."""

from __future__ import annotations

import re
from collections.abc import Collection, Sequence
from itertools import pairwise

from .images import Image, Instruction

CALL = re.compile(r"bl|jal|call|rcall")
_TARGET = re.compile(r"(?:0x)?([0-9a-f]+) <")
_BRANCH = re.compile(r"(?!bic|bf[ci]|bkpt)b\w+(\.[nw])?|b(\.[nw])?|cbn?z|j|jal|r?jmp|r?call")
_INDIRECT_CALL = re.compile(r"blx|jalr|e?icall")
_END = re.compile(r"(ret|reti|jr|bx|ijmp|tb[bh]|udf)\b|(pop|ldm\w*).*\bpc\b|(ldr|mov)(\.w)?\s+pc")
_JUMP = re.compile(r"b(\.[nw])?|j|r?jmp")
_SKIP = re.compile(r"cpse|sb[ri][cs]")


class Flow:
    """The instructions of an image by number, in the order of their addresses."""

    def __init__(self, image: Image) -> None:
        self.lines = image.code
        self._image = image
        self._numbers = {line.address: number for number, line in enumerate(image.code)}

    def start(self, name: str) -> int:
        """Number of a function's first instruction."""
        return self._numbers[self._image.address(name)]

    def target(self, line: Instruction) -> int | None:
        """Where a call or jump leads to. Raises ValueError for a call of a pointer."""
        if _INDIRECT_CALL.fullmatch(line.name):
            raise ValueError(f"{line.function} calls what a pointer leads to: {line.name} {line.operands}")
        match = _TARGET.search(line.operands) if _BRANCH.fullmatch(line.name) else None
        return self._numbers.get(int(match[1], 16)) if match else None

    def following(self, number: int) -> list[int]:
        """Numbers of what may run next within the same function or after a jump out of it; calls return."""
        line = self.lines[number]
        target = self.target(line)
        if _END.match(f"{line.name} {line.operands}"):
            return []
        jumped = [] if target is None or CALL.fullmatch(line.name) else [target]
        if _JUMP.fullmatch(line.name):
            return jumped
        return [*jumped, number + 1, *([number + 2] if _SKIP.fullmatch(line.name) else [])]


class SeenFlow(Flow):
    """The same as far as it was seen: a branch leads only where it led in one of some runs."""

    def __init__(self, image: Image, runs: Collection[Sequence[tuple[int, int]]]) -> None:
        """``runs`` have the addresses and bytes of blocks that ran one after the other."""
        super().__init__(image)
        ends = {block: self._last(*block) for run in runs for block in run}
        self._seen = {
            (ends[block], self._numbers.get(after)) for run in runs for block, (after, _) in pairwise(run)
        }

    def _last(self, address: int, size: int) -> int:
        return max(self._numbers.get(at, -1) for at in range(address, address + size, 2))

    def following(self, number: int) -> list[int]:
        """As of ``Flow``, without the turns that were not seen."""
        ways = super().following(number)
        return ways if len(ways) < 2 else [way for way in ways if (number, way) in self._seen]
