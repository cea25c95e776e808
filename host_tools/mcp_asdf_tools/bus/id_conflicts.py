"""Detection of two nodes with one id on a bus, from the frames that one receiver hears."""

from __future__ import annotations

from collections import deque
from enum import Enum

from mcp_asdf_tools.bus.frames import TRANSFER_IDS, Command, Heartbeat, Message, Telemetry

_WINDOW, _ENOUGH = 32, 12
"""Signs of two senders needed (``_ENOUGH``) among that many messages (``_WINDOW``).

Measured over millions of messages: one sender gives at most 10, at any loss, with messages repeated or up to
20 places late, and with restarts all the time; two give 13 and more while less than 30 % is lost.
"""


class IdConflict(Enum):
    """Rule that found a conflict; the value describes it."""

    OWN_ID = "another node sends under this node's own id"
    TWO_SENDERS = "two nodes send under one id"


class IdConflictWatch:
    """Detector of nodes that share an id. O(1) time for each message, O(1) memory for each id and kind.

    Pass it every legal message that the connection receives, but none that this node has sent itself:
    on a bus that returns those, their frames have ``is_rx`` false.

    A message under the own id proves a conflict. Conflicts of other ids show in their transfer-ids, which
    count each sender's messages modulo 32: when two nodes count at about the same rate under one id, numbers
    come twice with different content. Two nodes that send the same content at the same time cannot be
    distinguished, nor can a node that sends much more rarely than the other.

    Attributes:
        found: The rule that found each conflict so far, by id.
    """

    def __init__(self, own: int | None = None) -> None:
        """Watch for the node ``own``, 0 .. 127, or for a listener without an id."""
        self.found: dict[int, IdConflict] = {}
        self._own = own
        self._sequences: dict[tuple[int, type], _Sequence] = {}

    def hear(self, message: Message | Heartbeat | Telemetry | Command) -> IdConflict | None:
        """Take a message; returns the conflict that it proves if that is new."""
        sender = message.sender
        if sender in self.found:
            return None
        if sender == self._own:
            return self._note(sender, IdConflict.OWN_ID)
        sequence = self._sequences.setdefault((sender, type(message)), _Sequence())
        return self._note(sender, IdConflict.TWO_SENDERS) if sequence.is_shared(message) else None

    def _note(self, sender: int, conflict: IdConflict) -> IdConflict:
        self.found[sender] = conflict
        return conflict


class _Sequence:
    """One kind of message under one id, numbered on beyond 31."""

    def __init__(self) -> None:
        self._newest = 0
        self._heard: dict[int, tuple[int, object]] = {}
        self._advanced = deque([False, False], maxlen=2)
        self._signs = deque([False], maxlen=_WINDOW)

    def is_shared(self, message: Message | Heartbeat | Telemetry | Command) -> bool:
        """Take a message; returns whether two nodes must be sending these.

        A sign is a number heard with two contents while the count goes on: after a restart of a single
        sender the numbers come again, too, but no new ones between them.
        """
        place = message.transfer_id
        if not self._heard:
            self._newest = place
        # At most 15 places ahead of the newest, else it is late.
        ahead = (place - self._newest + TRANSFER_IDS // 2) % TRANSFER_IDS - TRANSFER_IDS // 2
        number = self._newest + ahead
        before = self._heard.get(place)
        if before == (number, message):
            return False
        is_taken = before is not None and before[0] == number
        if not is_taken:
            self._heard[place] = number, message
            self._newest = max(self._newest, number)
        self._signs.append(is_taken and any(self._advanced))
        self._advanced.append(not is_taken and ahead > 0)
        return sum(self._signs) >= _ENOUGH
