"""What all nodes of a cell share: they beat, take their parameters, and end in good order."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable
from typing import Any, TypeVar

from rclpy.node import Node
from rclpy.qos import QoSProfile

from rotcal_ros.nodes.health import Health, Values
from rotcal_ros.nodes.parameters import declare_settings, given_parameters

T = TypeVar("T")


class CellNode(Node, ABC):
    """A node of the cell. ``given`` holds the parameters it was started with, in groups."""

    def __init__(self, name: str, **options: Any) -> None:
        super().__init__(name, **options)
        self.given = given_parameters(self)
        self.health = Health(self, self._report, self._node_lost)

    def settings(self, group: str, cls: type[T], *, read_only: bool = True) -> T:
        """Declare a group of settings as parameters and return their values."""
        return declare_settings(self, self.given, group, cls, read_only=read_only)

    def listen(
        self, kind: type, topic: str, handle: Callable[[Any], None], qos: QoSProfile
    ) -> None:
        """Subscribe to a topic; an exception in ``handle`` is counted and logged."""
        self.create_subscription(kind, topic, self.health.guarded(handle), qos)

    def every(self, period_s: float, work: Callable[[], None]) -> None:
        """Do ``work`` regularly; an exception in it is counted and logged."""
        self.create_timer(period_s, self.health.guarded(work))

    def begin_stop(self) -> None:
        """Begin to end: give up running work, close files."""

    def stopped(self) -> bool:
        """Return whether nothing is left to do before the end."""
        return True

    def finished(self) -> bool:
        """Return whether the work is done without being told to end."""
        return False

    @abstractmethod
    def _report(self) -> tuple[str, Values]:
        """Return the state in words and values; asked for every beat."""

    def _node_lost(self, name: str) -> None:
        """Hear that another node fell silent."""
