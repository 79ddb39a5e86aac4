"""Asking an instrument for a length, where it wants to be asked (std_srvs/Trigger)."""

from __future__ import annotations

import time
from typing import Any, Final

from std_srvs.srv import Trigger

from rotcal_ros.nodes.cell_node import CellNode

PERIOD_S: Final = 0.02
"""How often it is looked whether a length is wanted."""
PATIENCE_S: Final = 2.0
"""So long after an answer the reading may take to come before it is asked for again."""
ANSWER_S: Final = 30.0
"""So long an instrument may take to answer."""


class LengthTrigger:
    """Calls the service ``name`` whenever ``wanted`` tells a new number of readings wanted.

    ``complaint`` says what the instrument answered when it could not measure, or that it does not.
    """

    def __init__(self, node: CellNode) -> None:
        self._node = node
        self._client: Any = None
        self._call: Any = None
        self._since_s, self._asked = 0.0, -1
        self.complaint = ""

    def serve(self, name: str) -> None:
        """Ask this service from now on; empty: none."""
        if self._client is not None:
            self._node.destroy_client(self._client)
        self._client = self._node.create_client(Trigger, name) if name else None
        self._call = None
        self._asked, self.complaint = -1, ""

    def look(self, received: int, *, wanted: bool) -> None:
        """Ask for a length where one is ``wanted``; ``received`` counts the readings so far."""
        if self._client is None or not self._is_free() or not wanted:
            return
        late = time.monotonic() - self._since_s > PATIENCE_S
        if received == self._asked and not late:
            return
        if not self._client.service_is_ready():
            self.complaint = f"nobody offers the service {self._client.srv_name} (length_trigger)"
            return
        self._asked, self._since_s = received, time.monotonic()
        self._call = self._client.call_async(Trigger.Request())

    def _is_free(self) -> bool:
        """Return whether no answer is awaited any more; hear the one that came."""
        if self._call is None:
            return True
        if not self._call.done():
            if time.monotonic() - self._since_s <= ANSWER_S:
                return False
            silent = f"no answer to {self._client.srv_name} in {ANSWER_S:g} s"
            self.complaint = f"the instrument took no length: {silent} (length_trigger)"
            self._client.remove_pending_request(self._call)
            self._call = None
            return True
        answer, self._call = self._call.result(), None
        self._since_s = time.monotonic()
        self.complaint = (
            ""
            if answer.success
            else (f"the instrument took no length ({self._client.srv_name}): {answer.message}")
        )
        return True
