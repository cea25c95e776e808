"""Nodes that exchange messages within one process: a message is delivered as soon as it is published."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

from rclpy.exceptions import InvalidParameterTypeException


@dataclass
class Environment:
    """What surrounds nodes: their topics, and how the next node is started.

    Attributes:
        namespace: Of the next node, such as "/robot_3".
        parameters: Of the next node.
        callbacks: Of all subscriptions, by the whole name of the topic.
        published: Messages so far, by the whole name of the topic.
    """

    namespace: str = ""
    parameters: dict[str, Any] = field(default_factory=dict)
    callbacks: defaultdict[str, list[Callable[[Any], None]]] = field(
        default_factory=lambda: defaultdict(list)
    )
    published: defaultdict[str, list[Any]] = field(default_factory=lambda: defaultdict(list))

    def publish(self, topic: str, message: Any) -> None:
        """Deliver a message to all subscriptions of a topic."""
        self.published[topic].append(message)
        for callback in self.callbacks[topic]:
            callback(message)


environment = Environment()


@dataclass(frozen=True)
class Parameter:
    """A parameter of a node."""

    value: Any


class Publisher:
    """Publishes messages of one type on a topic."""

    def __init__(self, message_type: type, topic: str) -> None:
        self._message_type = message_type
        self._topic = topic

    def publish(self, message: Any) -> None:
        assert isinstance(message, self._message_type)
        environment.publish(self._topic, message)


class Node:
    """A node in the namespace, and with the parameters, that the environment has at its start.

    Attributes:
        timers: Period in seconds and callback of each timer.
        defaults: Default of each declared parameter, by name.
    """

    def __init__(self, name: str) -> None:
        self.name = name
        self.timers: list[tuple[float, Callable[[], None]]] = []
        self.defaults: dict[str, Any] = {}
        self._namespace = environment.namespace
        self._parameter_overrides = environment.parameters

    def _whole_name(self, topic: str) -> str:
        return topic if topic.startswith("/") else f"{self._namespace}/{topic}"

    def declare_parameter(self, name: str, value: Any) -> Parameter:
        """Return the parameter. Raises InvalidParameterTypeException if its type is not the default's."""
        self.defaults[name] = value
        parameter_value = self._parameter_overrides.get(name, value)
        if type(parameter_value) is not type(value):
            raise InvalidParameterTypeException(
                f"{name} is {parameter_value!r}, and not {type(value).__name__}"
            )
        return Parameter(parameter_value)

    def create_publisher(self, message_type: type, topic: str, queue_depth: int) -> Publisher:
        assert queue_depth > 0
        return Publisher(message_type, self._whole_name(topic))

    def create_subscription(
        self, message_type: type, topic: str, callback: Callable[[Any], None], queue_depth: int
    ) -> None:
        assert queue_depth > 0
        environment.callbacks[self._whole_name(topic)].append(callback)

    def create_timer(self, period: float, callback: Callable[[], None]) -> None:
        self.timers.append((period, callback))
