"""The recorder against a plain rclpy subscription, on the same load over DDS.

usage: live_recording.py publish RATE SECONDS | listen SECONDS     (started by bench_recording)
"""

import json
import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import rclpy
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from rotcal_msgs.msg import TracerLength
from rotcal_msgs.srv import StartRecording, StopRecording

from rotcal_ros.bags.reader import bag_files, check_files
from rotcal_ros.cli.session import node_environment
from rotcal_ros.nodes.qos import STREAM

TOPICS = ("tracer_length", "second_length")
TURN_S = 0.005
RATES = (1000, 2000, 3000, 4000, 6000, 8000, 10_000, 12_000, 16_000)


def publish(rate: float, seconds: float) -> None:
    """Publish ``rate`` messages per second in all, evenly, and print how many there were."""
    node = rclpy.create_node("load")
    publishers = [node.create_publisher(TracerLength, topic, STREAM) for topic in TOPICS]
    while not all(publisher.get_subscription_count() for publisher in publishers):
        time.sleep(0.05)
    time.sleep(1.0)
    message, sent, begin = TracerLength(length=0.5, status=1), 0, time.monotonic()
    while (passed := time.monotonic() - begin) < seconds:
        while sent < passed * rate:
            message.sequence = sent
            publishers[sent % len(publishers)].publish(message)
            sent += 1
        time.sleep(TURN_S)
    print(sent / passed, sent, flush=True)
    time.sleep(2.0)


def listen(seconds: float) -> None:
    """Count messages with plain subscriptions and the usual executor."""
    node, counts = rclpy.create_node("plain"), [0]

    def count(_: TracerLength) -> None:
        counts[0] += 1

    for topic in TOPICS:
        node.create_subscription(TracerLength, topic, count, STREAM)
    executor = SingleThreadedExecutor()
    executor.add_node(node)
    print("ready", flush=True)
    last, end = -1, time.monotonic() + seconds + 20.0
    while time.monotonic() < end and not (counts[0] and counts[0] == last):
        last, until = counts[0], time.monotonic() + 1.5
        while time.monotonic() < until:
            executor.spin_once(timeout_sec=0.05)
    print(counts[0], flush=True)


def started(*command: str) -> subprocess.Popen[str]:
    return subprocess.Popen(
        [sys.executable, *command], stdout=subprocess.PIPE, text=True, env=environment()
    )


def environment() -> dict[str, str]:
    return {**os.environ, **node_environment()}


def plain(rate: float, seconds: float) -> tuple[float, int]:
    """Return the rate that was really sent and how many messages were lost."""
    listener = started(__file__, "listen", str(seconds))
    load = started(__file__, "publish", str(rate), str(seconds))
    real, sent = load.communicate()[0].split()
    taken = listener.communicate()[0].split()[-1]
    return float(real), int(sent) - int(taken)


class Recorder:
    """The recorder as a process, driven by its services."""

    def __init__(self, folder: Path) -> None:
        self._folder = folder
        self._process = started(
            "-m", "rotcal_ros.nodes.recorder", "--ros-args",
            "-p", f"recorder.folder:={json.dumps(str(folder))}", "-p", "recorder.session:=run",
        )  # fmt: skip
        os.environ.update(environment())
        rclpy.init()
        self._node = Node("bench")

    def call(self, kind: type, name: str, request: Any) -> Any:
        client = self._node.create_client(kind, name)
        client.wait_for_service(30.0)
        future = client.call_async(request)
        rclpy.spin_until_future_complete(self._node, future, timeout_sec=60.0)
        return future.result()

    def end(self) -> None:
        self._process.terminate()
        self._process.wait(30)
        self._node.destroy_node()
        rclpy.shutdown()

    def measure(self, rate: float, seconds: float) -> dict[str, Any]:
        self.call(StartRecording, "start_recording", StartRecording.Request(plan_id="bench"))
        load = started(__file__, "publish", str(rate), str(seconds))
        before, begin = self._usage(), time.monotonic()
        time.sleep(seconds / 2)
        middle = self._usage()[1]
        real, sent = load.communicate()[0].split()
        used, memory = self._usage()
        passed = time.monotonic() - begin
        answer = self.call(StopRecording, "stop_recording", StopRecording.Request())
        (verdict,) = check_files(bag_files(self._folder / "run" / "bag"))
        recorded = sum(verdict.topics[f"/{topic}"].messages for topic in TOPICS)
        assert answer.success, answer.message
        return {
            "rate": float(real),
            "lost": int(sent) - recorded,
            "cpu_percent": 100 * (used - before[0]) / passed,
            "memory_mb": memory,
            "growth_mb": memory - middle,
        }

    def _usage(self) -> tuple[float, float]:
        """Return CPU seconds and resident megabytes."""
        root = Path("/proc") / str(self._process.pid)
        fields = (root / "stat").read_text().rpartition(")")[2].split()
        seconds = (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")
        return seconds, int(fields[21]) * os.sysconf("SC_PAGE_SIZE") / 1e6


def rows(seconds: float) -> Iterator[dict[str, Any]]:
    """Yield the best rate without loss of both; the plain one is raised until it loses."""
    best = 0.0
    for rate in RATES:
        real, lost = plain(rate, min(seconds, 5.0))
        if lost or real < 0.97 * rate:
            break
        best = real
    yield {
        "name": "plain rclpy subscription, without loss",
        "rate": best,
        "unit": "messages/s",
        "lost": 0,
    }
    with tempfile.TemporaryDirectory(prefix="rotcal_bench_") as folder:
        recorder = Recorder(Path(folder))
        try:
            found = recorder.measure(11_000, seconds)
        finally:
            recorder.end()
    found.pop("growth_mb")
    yield {
        "name": f"recorder, {seconds:g} s",
        "unit": "messages/s",
        "ratio": found["rate"] / best if best else None,
        **found,
    }


if __name__ == "__main__":
    rclpy.init()
    {"publish": publish, "listen": listen}[sys.argv[1]](*map(float, sys.argv[2:]))
