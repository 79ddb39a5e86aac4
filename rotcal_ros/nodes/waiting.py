"""What an executor waits for in every turn: a turn costs as much as it waits for things.

rclpy gives every publisher and subscription three or four handlers of events, such as a lost
message, and builds them into the set of every wait: most of what a node with many topics costs.
"""

from __future__ import annotations

import time
from typing import Any, Final

from rclpy.callback_groups import MutuallyExclusiveCallbackGroup
from rclpy.event_handler import EventHandler
from rclpy.subscription import Subscription

EVENTS_S: Final = 0.2
"""So often events are looked for; none is lost, the middleware keeps them."""
_LOOK_S: Final = 0.002
"""So long after the first look: what was waited for is still to be taken."""


class Seldom(MutuallyExclusiveCallbackGroup):
    """Everything of a node is waited for, its events a few times a second."""

    def __init__(self) -> None:
        super().__init__()
        self._looked_s = -EVENTS_S

    def can_execute(self, entity: Any) -> bool:
        """Return whether an executor may wait for ``entity``, or handle it."""
        if isinstance(entity, EventHandler):
            now_s = time.monotonic()
            if now_s >= self._looked_s + EVENTS_S:
                self._looked_s = now_s
            if now_s > self._looked_s + _LOOK_S:
                return False
        return super().can_execute(entity)


class Unwaited(Seldom):
    """Subscriptions for whose messages no executor wakes: somebody drains them regularly.

    Their events are not waited for all the time either: a message wakes who waits for an event.
    """

    def can_execute(self, entity: Any) -> bool:
        """Return whether an executor may wait for ``entity``, or handle it."""
        return not isinstance(entity, Subscription) and super().can_execute(entity)
