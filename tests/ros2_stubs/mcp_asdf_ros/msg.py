"""The messages of c_ref/examples/ros2, as ROS generates them. A test compares them with the .msg files."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass
class Estimate:
    """``Estimate.msg``."""

    sender: int = 0
    x_hat: int = 0
    alpha: int = 0


@dataclass
class State:
    """``State.msg``."""

    x: float = 0.0
    x_hat: float = 0.0
    b_hat: float = 0.0
    observations: int = 0
    accepted: int = 0
    rejected: int = 0
    updates: int = 0
