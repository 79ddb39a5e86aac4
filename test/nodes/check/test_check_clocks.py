"""A check of a cell holds clocks against each other as the configuration states them; no graph."""

import numpy as np
import pytest

pytest.importorskip("rclpy")
pytest.importorskip("rotcal_msgs")

from rotcal_ros.bags.settings import TopicSettings
from rotcal_ros.capture.instruments.conventions import Conventions
from rotcal_ros.capture.stamp_offsets import OffsetLimits, StampOffsets
from rotcal_ros.nodes.check.cell_check import ListeningNodes

SECOND = 1_000_000_000
START = 1_700_000_000 * SECOND


@pytest.mark.parametrize(
    ("settings", "told"),
    [
        (TopicSettings(), True),
        (TopicSettings(length_clock_offset_s=0.8), False),
        (TopicSettings(length_clock="sent"), False),
    ],
)
def test_a_stated_clock_is_no_fault(settings, told):
    listening = ListeningNodes.__new__(ListeningNodes)
    listening._conventions = Conventions(settings)
    listening._offsets = StampOffsets(OffsetLimits(2.0, 0.5))
    for now in (START + np.arange(0, 4 * SECOND, SECOND // 50)).tolist():
        listening._stamped("joint_states", now, now, now)
        listening._stamped("tracer_length", now + 4 * SECOND // 5, now, now)
    assert listening._offsets.compared() == ("tracer_length",)
    reason = listening._offsets.reason_to_reject()
    assert (reason is not None) is told
    assert reason is None or "0.80 s ahead" in reason
    assert listening._offsets.doubt() is None
