"""Messages of ROS."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass
class Bool:
    """A truth value."""

    data: bool = False
