"""What the node of c_ref/examples/ros2 uses of rclpy, for nodes of one process without a network."""

from __future__ import annotations

from rclpy.node import Node

spun_nodes: list[Node] = []
"""Nodes that ``spin`` has been called with."""


def init() -> None:
    pass


def spin(node: Node) -> None:
    """Keep the node in ``spun_nodes``, and end as if somebody had pressed Ctrl-C."""
    spun_nodes.append(node)
    raise KeyboardInterrupt


def try_shutdown() -> None:
    pass
