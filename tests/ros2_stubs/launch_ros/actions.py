"""Actions of ROS."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any


@dataclass
class Node:
    """Starts a node."""

    package: str
    executable: str
    namespace: str
    parameters: list[dict[str, Any]]
