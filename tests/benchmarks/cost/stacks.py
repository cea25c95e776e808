"""The most stack that a function can use, from the disassembly and what the compiler says of its frames."""

from __future__ import annotations

import re
from collections import defaultdict

from .flow import CALL, Flow
from .images import Image, Instruction

_CLONE = re.compile(r"\.(constprop|part|isra|cold)\.\d+")
_MOVES = (
    (re.compile(r"(?:push|stmdb(?:\.w)? sp!,)(?:\.w)? \{(?P<list>.*)\}"), 1),
    (re.compile(r"(?:pop|ldmia(?:\.w)? sp!,)(?:\.w)? \{(?P<list>.*)\}"), -1),
    (re.compile(r"sub(?:w|\.w)? sp, (?:sp, )?#(?P<bytes>\d+)"), 1),
    (re.compile(r"add(?:w|\.w)? sp, (?:sp, )?#(?P<bytes>\d+)"), -1),
    (re.compile(r"strd?(?:\.w)? .*\[sp, #-(?P<bytes>\d+)\]!"), 1),
    (re.compile(r"ldrd?(?:\.w)? .*\[sp\], #(?P<bytes>\d+)"), -1),
    (re.compile(r"addi sp,sp,-(?P<bytes>\d+)"), 1),
    (re.compile(r"addi sp,sp,(?P<bytes>\d+)"), -1),
    (re.compile(r"push (?P<list>r\d+)$"), 1),
    (re.compile(r"pop (?P<list>r\d+)$"), -1),
)
"""Instructions that move the stack pointer by a constant, and whether down (1) or up (-1)."""


_MOST = 1000
"""Bytes that no function of a compiler's library takes."""


class Stacks:
    """Bounds of an image's functions.

    The bound of a compiled function is its frame, as the compiler reports it (-fstack-usage), and the largest
    bound of what it calls; where it ends with a jump to another function its frame is gone by then. Code of
    the compiler's own library is followed instruction by instruction.
    """

    def __init__(self, image: Image) -> None:
        self._frames, self._flow = image.frames, Flow(image)
        self._slot, self._return = (1, 2) if image.target.tools.startswith("avr") else (4, 0)
        self._functions: dict[str, list[Instruction]] = defaultdict(list)
        for line in image.code:
            self._functions[line.function].append(line)
        self._known: dict[int, int] = {}

    def deepest(self, name: str) -> int:
        """Bytes below the stack pointer before the call, a return address among them if the call pushes one.

        Raises ValueError if there is no bound: recursion, or a call of what a pointer leads to.
        """
        return self._bound(self._flow.start(name), ())

    def _bound(self, start: int, callers: tuple[int, ...]) -> int:
        name = self._flow.lines[start].function
        if start in callers:
            raise ValueError(f"{name} calls itself")
        if start not in self._known:
            frame = self._frames.get(name, self._frames.get(_CLONE.sub("", name)))
            below = (*callers, start)
            if frame is None:
                self._known[start] = self._of_library(start, below)
            else:
                self._known[start] = self._of_compiled(name, frame, below)
        return self._known[start]

    def _of_compiled(self, name: str, frame: int, callers: tuple[int, ...]) -> int:
        deepest = frame
        for line in self._functions[name]:
            target = self._flow.target(line)
            if target is not None and self._flow.lines[target].function != name:
                bound = self._bound(target, callers)
                deepest = max(deepest, bound + frame if CALL.fullmatch(line.name) else bound)
        return deepest

    def _of_library(self, start: int, callers: tuple[int, ...]) -> int:
        deepest, seen, left = self._return, dict[int, int](), [(start, self._return)]
        while left:
            number, depth = left.pop()
            if seen.get(number, -1) >= depth:
                continue
            seen[number] = depth
            if depth > _MOST or number >= len(self._flow.lines):
                raise ValueError(f"cannot follow {self._flow.lines[start].function}: it grows or has no end")
            line = self._flow.lines[number]
            target = self._flow.target(line)
            if target is not None and CALL.fullmatch(line.name):
                deepest = max(deepest, depth + self._bound(target, callers))
            depth += self._moved(line)
            deepest = max(deepest, depth)
            left += [(following, depth) for following in self._flow.following(number)]
        return deepest

    def _moved(self, line: Instruction) -> int:
        """Bytes by which an instruction moves the stack pointer down."""
        text = f"{line.name} {line.operands}"
        for pattern, sign in _MOVES:
            if match := pattern.match(text):
                parts = match.groupdict()
                slots = len(parts["list"].split(",")) if "list" in parts else 0
                return sign * (slots * self._slot if slots else int(parts["bytes"]))
        return 0
