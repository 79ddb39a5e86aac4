"""A topic that a recorder listens to, and how far its messages have come."""

from __future__ import annotations

import struct
import time
from collections import deque
from dataclasses import dataclass, field
from typing import Final

from rotcal_ros.capture.instruments.conventions import Conventions
from rotcal_ros.capture.instruments.forms import form_of
from rotcal_ros.nodes.writing.bookkeeping import TopicLosses
from rotcal_ros.nodes.writing.recording import Channel, Messages

MOST_LATCHED: Final = 100
"""So many batches of static transforms are kept for the next bag."""
_STAMP: Final = struct.Struct("<4xiI")
"""CDR encapsulation, then the stamp that begins every message with a header."""


@dataclass
class HeardTopic:
    """A topic that is listened to: its channel and how far it has come.

    ``heard_s`` is the monotonic time of the latest batch, or of the subscription, ``heard_ns`` the
    log time of the latest message; ``latched`` is what was published once for late subscribers.
    """

    channel: Channel
    heard_s: float = field(default_factory=time.monotonic)
    heard_ns: int = field(default_factory=time.time_ns)
    sent_ns: int = 0
    latest: bytes = b""
    latched: deque[Messages] = field(default_factory=lambda: deque(maxlen=MOST_LATCHED))
    losses: TopicLosses = field(default_factory=TopicLosses)

    def taken_ns(self, role: str, conventions: Conventions) -> int:
        """Return when the newest message was taken, by the common clock; 0: none came."""
        if not self.latest:
            return 0
        form = form_of(role, self.channel.type_name)
        if form is not None and not form.stamped:
            return int(conventions.taken_ns(role, self.sent_ns, self.sent_ns))
        seconds, nanoseconds = _STAMP.unpack_from(self.latest)
        stamp_ns = int(seconds) * 1_000_000_000 + int(nanoseconds)
        return int(conventions.taken_ns(role, stamp_ns, self.sent_ns))
