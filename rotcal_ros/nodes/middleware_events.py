"""Events of the middleware, as a lost message: looked for now and then instead of waited for.

rclpy gives every publisher and subscription two events or more, and an executor gathers all that
it waits for anew in every turn: the events were more than half of that.
"""

from __future__ import annotations

from typing import Any

from rclpy.callback_groups import CallbackGroup
from rclpy.event_handler import EventHandler
from rclpy.node import Node


class _Unwaited(CallbackGroup):
    """What no executor waits for."""

    def can_execute(self, entity: Any) -> bool:
        """Return that none of it is a turn's work."""
        return False

    def beginning_execution(self, entity: Any) -> bool:
        """Return that none begins."""
        return False

    def ending_execution(self, entity: Any) -> None:
        """Leave it: none has begun."""


def unwaited(entity: Any) -> Any:
    """Return a publisher or subscription whose events no executor waits for."""
    for handler in entity.event_handlers:
        handler.callback_group = _UNWAITED
    return entity


def handle_events(node: Node) -> None:
    """Call those who want to know of the events of a node since the last time."""
    for handler in [each for each in node.waitables if isinstance(each, EventHandler)]:
        handler._ready_to_take_data = True
        event = handler.take_data()
        if event is not None and event.total_count_change:
            handler.callback(event)


_UNWAITED = _Unwaited()
