"""Exceptions of rclpy's executors."""


class ExternalShutdownException(Exception):  # noqa: N818 (ROS's name)
    """ROS has been shut down."""
