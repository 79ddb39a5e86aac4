"""How far a recorded stream has come, whatever its type and its clock."""

import struct
from types import SimpleNamespace

import pytest

pytest.importorskip("rclpy")

from rotcal_ros.bags import names
from rotcal_ros.bags.settings import TopicSettings
from rotcal_ros.capture.instruments.conventions import Conventions
from rotcal_ros.nodes.recorder import node as recorder
from rotcal_ros.nodes.recorder.node import RecordedTopic
from rotcal_ros.nodes.recorder.recording import Channel

SECOND = 1_000_000_000


def heard(type_name, data):
    channel = Channel("/t", type_name, *("",) * (len(Channel.__dataclass_fields__) - 2))
    return RecordedTopic(channel, latest=data, sent_ns=9 * SECOND)


def test_a_number_without_header_is_no_stamp():
    topic = heard("std_msgs/msg/Float64", b"\0\1\0\0" + struct.pack("<d", 72.5))
    assert topic.measured_at_ns(names.TRACER_LENGTH, Conventions(TopicSettings())) == 9 * SECOND


@pytest.mark.parametrize(("settings", "seconds"), [
    (TopicSettings(), 5.0),
    (TopicSettings(length_clock_offset_s=-4.0), 9.0),
    (TopicSettings(length_clock="sent", length_clock_offset_s=0.5), 8.5),
])  # fmt: skip
def test_a_stamp_is_read_by_the_common_clock(settings, seconds):
    topic = heard("sensor_msgs/msg/Range", struct.pack("<4xiI", 5, 0))
    taken_ns = topic.measured_at_ns(names.TRACER_LENGTH, Conventions(settings))
    assert taken_ns == round(seconds * SECOND)


def test_a_topic_whose_subscription_fails_is_tried_again(monkeypatch):
    tried = []

    def subscribe(topic, *_kind):
        tried.append(topic)
        if len(tried) == 1:
            raise RuntimeError("the graph has just changed")

    for name in ("message_type", "adapted_qos", "described_channel"):
        monkeypatch.setattr(recorder, name, lambda *_arguments: SimpleNamespace())
    monkeypatch.setattr(recorder, "_wanted_topics", lambda *_: {"/cell/plan": "a type"})
    listener = object.__new__(recorder.TopicListener)
    listener.topics, listener.refused, listener._stop = {}, {}, []
    publisher = SimpleNamespace(qos_profile=None)
    listener._node = SimpleNamespace(get_publishers_info_by_topic=lambda _name: [publisher])
    listener._further, listener._subscribe = list, subscribe
    with pytest.raises(RuntimeError, match="just changed"):
        listener._look()
    listener._look()
    listener._look()
    assert len(tried) == 2
    assert listener.topics == {"/cell/plan": tried[1]}
