"""A node that feeds recorders like a cell does and reports the receipts they give.

usage: feeder.py WINDOW [DEPTH]

A tracer at 1 kHz and an observation after every WINDOW readings, all numbered. With DEPTH only so
many readings are kept for a reader that does not answer, and large messages at best effort fill
its socket within a second. A line NAME on standard input: open a bag at the
recorder whose service is ``start_NAME``. Standard output gets a line of JSON per receipt of
``receipts_NAME``: {"recorder": NAME, "step": ...}, and one when NAME gives up:
{"recorder": NAME, "failure": ...}. An empty line is answered by {"recorder": "", "step": ...},
the latest observation, behind all receipts that have arrived.
"""

import json
import sys
import time
from functools import partial
from queue import Empty, SimpleQueue
from threading import Thread

import rclpy
from rclpy.node import Node
from rclpy.qos import QoSProfile
from rclpy.serialization import serialize_message
from rotcal_msgs.msg import NodeState as NodeStateMsg
from rotcal_msgs.msg import Observation, RecordedObservation, TracerLength
from rotcal_msgs.srv import StartRecording
from std_msgs.msg import String

from rotcal_ros.foundation.node_state import Why
from rotcal_ros.nodes.runtime.conversions import node_state, time_message
from rotcal_ros.nodes.runtime.qos import EVENT, STREAM, VIEW

PERIOD_S = 0.005
READINGS = 5
"""Readings per period."""
FILLING_BYTES = 30_000
"""Size of what fills the sockets, per period."""


class Feeder(Node):
    def __init__(self, window, names, depth):
        super().__init__("feeder", namespace="/cell")
        self._window = window
        self._names = names
        self._number = 0
        self._clients_to_be = {}
        self._tracer = self.create_publisher(TracerLength, "tracer_length", depth or STREAM)
        self._observation = self.create_publisher(Observation, "observation", EVENT)
        self._filling = depth and self.create_publisher(String, "filling", VIEW)
        self._large = serialize_message(String(data=" " * FILLING_BYTES))
        self._failed = set()
        self.create_subscription(NodeStateMsg, "heartbeat", self._hear, QoSProfile(depth=100))
        self.create_timer(PERIOD_S, self._feed)
        self.create_timer(0.1, self._open)

    def _feed(self):
        if self._filling:
            self._filling.publish(self._large)
        for _ in range(READINGS):
            stamp = time_message(time.time_ns())
            reading = TracerLength(sequence=self._number, length=0.5, status=1)
            reading.header.stamp = stamp
            self._tracer.publish(reading)
            self._number += 1
            if self._number % self._window == 0:
                observation = Observation(step=self._number // self._window, window_end=stamp)
                self._observation.publish(observation)

    def _open(self):
        """Call the recorders that were named, once they are there."""
        try:
            while True:
                name = self._names.get_nowait()
                if not name:
                    self._say(name, step=self._number // self._window)
                    continue
                client = self.create_client(StartRecording, f"start_{name}")
                self._clients_to_be[name] = client
                tell = partial(self._tell, name)
                self.create_subscription(RecordedObservation, f"receipts_{name}", tell, EVENT)
        except Empty:
            pass
        for name, client in list(self._clients_to_be.items()):
            if client.service_is_ready():
                client.call_async(StartRecording.Request(plan_id="kill"))
                del self._clients_to_be[name]

    def _tell(self, name, receipt):
        self._say(name, step=receipt.step)

    def _hear(self, beat):
        state = node_state(beat)
        if state.has(Why.RECORDING_FAILED) and beat.node not in self._failed:
            self._failed.add(beat.node)
            self._say(beat.node, failure=state.describe())

    def _say(self, name, **what):
        sys.stdout.write(json.dumps({"recorder": name, **what}) + "\n")
        sys.stdout.flush()


def read(names):
    for line in sys.stdin:
        names.put(line.strip())


if __name__ == "__main__":
    rclpy.init()
    named = SimpleQueue()
    Thread(target=read, args=(named,), daemon=True).start()
    rclpy.spin(Feeder(int(sys.argv[1]), named, int(sys.argv[2]) if sys.argv[2:] else 0))
