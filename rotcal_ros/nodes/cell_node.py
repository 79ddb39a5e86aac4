"""What all nodes of a cell share: they beat, take their parameters, and end in good order."""

from __future__ import annotations

from typing import Any, TypeVar

from rclpy.node import Node

from rotcal_ros.nodes.health import Health, Values
from rotcal_ros.nodes.parameters import declare_settings, take_given

T = TypeVar("T")


class CellNode(Node):
    """A node of the cell. ``given`` holds the parameters it was started with, in groups."""

    def __init__(self, name: str, **options: Any) -> None:
        super().__init__(name, automatically_declare_parameters_from_overrides=True, **options)
        self.given = take_given(self)
        self.health = Health(self, self._report, self._node_lost)

    def settings(self, group: str, cls: type[T], *, read_only: bool = True) -> T:
        """Declare a group of settings as parameters and return their values."""
        return declare_settings(self, self.given, group, cls, read_only=read_only)

    def begin_stop(self) -> None:
        """Begin to end: give up running work, close files."""

    def stopped(self) -> bool:
        """Return whether nothing is left to do before the end."""
        return True

    def finished(self) -> bool:
        """Return whether the work is done without being told to end."""
        return False

    def _report(self) -> tuple[str, Values]:
        """Return the state in words and values; asked for every beat."""
        raise NotImplementedError

    def _node_lost(self, name: str) -> None:
        """Hear that another node fell silent."""
