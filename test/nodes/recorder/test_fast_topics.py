"""What is fast is taken together by the recorder, and is there when a receipt asks for it."""

import sys
import time

import pytest

pytest.importorskip("rclpy")
pytest.importorskip("rotcal_msgs")

import rclpy
from rclpy.executors import SingleThreadedExecutor
from rotcal_msgs.msg import TracerLength

from rotcal_ros.foundation.machine_load import load_scaled_timeout
from rotcal_ros.foundation.node_state import NodeState, State
from rotcal_ros.nodes.recorder.node import FAST_PERIOD_S, TopicListener
from rotcal_ros.nodes.runtime.cell_node import CellNode
from rotcal_ros.nodes.runtime.qos import STREAM
from rotcal_ros.sessions.processes import node_environment

RATE_HZ, SECONDS = 200, 2.0


class Hearer(CellNode):
    """Listens to everything; notes how many messages came at a time."""

    def __init__(self):
        super().__init__("hearer", namespace="/fast_topics")
        self.batches = {"quick": [], "plain": []}

    def configure(self):
        self.listener = TopicListener(
            self, self._take, print, fast=lambda topic: topic.endswith("/quick")
        )

    def _take(self, topic, batch):
        self.batches.get(topic.channel.topic.rpartition("/")[2], []).append(len(batch))

    def _report(self):
        return NodeState(State.WORKING), {}


@pytest.mark.slow
def test_a_fast_topic_comes_whole_in_few_turns_and_at_once_when_asked_for(monkeypatch):
    for name, value in node_environment().items():
        monkeypatch.setenv(name, value)
    monkeypatch.setenv("AMENT_PREFIX_PATH", sys.prefix)
    rclpy.init()
    try:
        node, executor = Hearer(), SingleThreadedExecutor()
        node.autostart()
        executor.add_node(node)
        own = rclpy.create_node("publisher", namespace="/fast_topics")
        publishers = [own.create_publisher(TracerLength, name, STREAM) for name in node.batches]
        end = time.monotonic() + load_scaled_timeout(30.0)
        while not all(p.get_subscription_count() for p in publishers):
            executor.spin_once(timeout_sec=0.05)
            assert time.monotonic() < end
        sent, begin = 0, time.monotonic()
        while (passed := time.monotonic() - begin) < SECONDS:
            while sent < passed * RATE_HZ:
                sent += 1
                for publisher in publishers:
                    publisher.publish(TracerLength(length=float(sent)))
            executor.spin_once(timeout_sec=1.0 / RATE_HZ)
        while sum(node.batches["plain"]) < sent or sum(node.batches["quick"]) < sent:
            executor.spin_once(timeout_sec=0.05)
            assert time.monotonic() < end, node.batches
        assert sum(node.batches["quick"]) == sum(node.batches["plain"]) == sent
        assert len(node.batches["quick"]) < 1.5 * (time.monotonic() - begin) / FAST_PERIOD_S

        publishers[0].publish(TracerLength())
        while sum(node.batches["quick"]) == sent:  # without a turn of the executor
            node.listener.take_fast()
            assert time.monotonic() < end
    finally:
        rclpy.try_shutdown()
