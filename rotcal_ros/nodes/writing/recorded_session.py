"""What the recorder has of a session: for a planner that continues, and a restarted solver."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from pathlib import Path

import numpy as np
from rclpy.serialization import deserialize_message
from rotcal_msgs.msg import Observation as ObservationMsg
from std_srvs.srv import Trigger

from rotcal_ros.bags.reader import read_blocks
from rotcal_ros.capture import messages
from rotcal_ros.foundation.errors import BagError
from rotcal_ros.foundation.observations import Observation
from rotcal_ros.methods.continuation import Recorded


class RecordedSession:
    """The observations of the session that is being recorded, all its runs, in their order."""

    def __init__(self) -> None:
        self._plan_id, self._run = "", 0
        self._observations: list[Observation] = []

    def begin(self, plan_id: str, run: int = 0, earlier: Iterable[Observation] = ()) -> None:
        """Begin a run; ``earlier`` are those of the runs before it."""
        self._plan_id, self._run = plan_id, run
        self._observations = list(earlier)

    def take(self, data: bytes) -> ObservationMsg:
        """Take an observation that is being recorded, and return its message."""
        message: ObservationMsg = deserialize_message(data, ObservationMsg)
        self._observations.append(messages.observation(message))
        return message

    def tell(self, _request: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        """Answer with all of it, as JSON."""
        recorded = Recorded(self._plan_id, self._run, tuple(self._observations))
        response.success, response.message = bool(self._plan_id), recorded.to_json()
        return response


def observations_in(files: Sequence[Path], topic: str) -> tuple[Observation, ...]:
    """Return the observations on ``topic`` in the files of a session, in their order.

    Raises BagError when a file cannot be read.
    """
    found: list[Observation] = []
    for scan, block in read_blocks(tuple(files)):
        here = [number for number, channel in scan.channels.items() if channel.topic == topic]
        if block is not None and here:
            rows = np.flatnonzero(np.isin(block.headers["channel"], here)).tolist()
            found += (_observation(block.payload(row), scan.path) for row in rows)
    return tuple(found)


def _observation(data: bytes, file: Path) -> Observation:
    """Return a message as the bag holds it; rclpy is quicker to begin than a decoder of ours."""
    try:
        return messages.observation(deserialize_message(data, ObservationMsg))
    except Exception as error:
        raise BagError(f"{file}: an observation of another version: {error}") from error
