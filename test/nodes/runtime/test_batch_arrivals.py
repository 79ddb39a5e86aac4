"""When messages came: every message of a batch counts, so that a stall hides none of them."""

import pytest

pytest.importorskip("rclpy")

from builtin_interfaces.msg import Time
from sensor_msgs.msg import JointState

from rotcal_ros.capture.messages import stamp_ns
from rotcal_ros.capture.stamp_offsets import OffsetLimits, StampOffsets
from rotcal_ros.nodes.runtime.timers_and_subscriptions import received_ns, sent_ns

SECOND = 1_000_000_000
START_NS = 1_700_000_000 * SECOND


def batch(begin_s: float, end_s: float, behind_s: float):
    """Return messages every 20 ms, stamped behind the time at which they came."""
    pairs = []
    for k in range(round(begin_s * 50), round(end_s * 50)):
        came_ns = START_NS + k * SECOND // 50
        message = JointState()
        seconds, nanoseconds = divmod(came_ns - round(behind_s * SECOND), SECOND)
        message.header.stamp = Time(sec=seconds, nanosec=nanoseconds)
        pairs.append((message, {"received_timestamp": came_ns}))
    return pairs


def test_an_offset_stays_known_behind_a_stall_of_the_node():
    offsets = StampOffsets(OffsetLimits(1.0))
    for begin_s, end_s in ((0.0, 0.3), (0.3, 1.6)):  # after 0.3 s the node stands still
        for stream, behind_s in (("joint_states", 0.0), ("tracer_length", 4.0)):
            for message, info in batch(begin_s, end_s, behind_s):
                offsets.note(stream, stamp_ns(message.header.stamp), received_ns(info))
    assert "tracer_length are constantly 4.0 s behind" in offsets.reason_to_reject()


def test_a_middleware_that_does_not_tell_when_a_message_came_means_now():
    unknown = {"received_timestamp": 0, "source_timestamp": 0}
    assert received_ns(unknown) > START_NS
    assert sent_ns(unknown) > START_NS


def test_when_a_message_was_sent_is_the_same_for_every_listener():
    told = {"received_timestamp": START_NS + 3, "source_timestamp": START_NS + 1}
    assert sent_ns(told) == START_NS + 1
