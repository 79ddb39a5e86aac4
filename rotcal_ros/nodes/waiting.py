"""What an executor waits for in every turn: a turn costs as much as it waits for things.

rclpy gives every publisher and subscription two handlers of events or more, as of a lost message,
and builds them into the set of every wait: most of what a node with many topics costs.
"""

from __future__ import annotations

from typing import Any, Final

from rclpy.callback_groups import CallbackGroup
from rclpy.event_handler import EventHandler
from rclpy.node import Node


class Unwaited(CallbackGroup):
    """What no executor waits for: somebody looks after it regularly."""

    def can_execute(self, entity: Any) -> bool:
        """Return that none of it is work of a turn."""
        return False

    def beginning_execution(self, entity: Any) -> bool:
        """Return that none of it begins."""
        return False

    def ending_execution(self, entity: Any) -> None:
        """Leave it: none of it has begun."""


UNWAITED: Final = Unwaited()


def with_unwaited_events(entity: Any) -> Any:
    """Return a publisher or subscription whose events :func:`handle_events` looks for."""
    for handler in entity.event_handlers:
        handler.callback_group = UNWAITED
    return entity


def handle_events(node: Node) -> None:
    """Call those who want to know of the events since the last time; the middleware keeps them."""
    for handler in [each for each in node.waitables if isinstance(each, EventHandler)]:
        handler._ready_to_take_data = True
        event = handler.take_data()
        if event is not None and event.total_count_change:
            handler.callback(event)
