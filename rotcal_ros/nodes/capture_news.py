"""What the capture tells people of its attempts: on the console, in its beat and diagnostics."""

from __future__ import annotations

import time
from typing import Any

from rotcal_ros.capture.rejections import Rejections, kind_of
from rotcal_ros.capture.stamp_offsets import StampOffsets
from rotcal_ros.nodes.concerns import CLOCK_DOUBT, COMPLAINT, OFFSET, REJECTED, show
from rotcal_ros.observations import Observation


class CaptureNews:
    """Tells of rejections and of what keeps an order from being measured, each kind once."""

    def __init__(self, health: Any, logger: Any) -> None:
        self._health, self._logger = health, logger
        self.begin()

    def begin(self) -> None:
        """Forget what belongs to an earlier plan."""
        self._rejections, self._kinds = Rejections(), dict[str, str]()
        for key in (REJECTED, COMPLAINT):
            show(self._health, key, "")

    def observed(self, observation: Observation) -> None:
        """Take an observation: three rejected running are an error, fewer a warning."""
        if line := self._rejections.note(observation, time.monotonic()):
            self._logger.warning(line)
        alarm, text = self._rejections.alarming, self._rejections.in_words()
        show(self._health, REJECTED, text, alarm=alarm)

    def complain(self, text: str) -> None:
        """Take what is wrong with the present order; empty: nothing."""
        self._tell(COMPLAINT, text)

    def offset(self, offsets: StampOffsets) -> None:
        """Take which clocks differ, beyond what is rejected or less."""
        self._tell(OFFSET, offsets.in_words())
        self._tell(CLOCK_DOUBT, offsets.doubt_in_words())

    def _tell(self, key: str, text: str) -> None:
        """Show a text as long as it lasts; each kind is one line."""
        if text and kind_of(text) != self._kinds.get(key):
            self._logger.warning(text)
            self._kinds[key] = kind_of(text)
        show(self._health, key, text)
