"""Exceptions about parameters."""


class ParameterException(Exception):  # noqa: N818 (ROS's name)
    """A parameter that cannot be used."""


class InvalidParameterTypeException(ParameterException):
    """A parameter of another type than it is declared with."""
