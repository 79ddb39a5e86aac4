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
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import suppress
from pathlib import Path
from typing import Any

import rclpy
from rclpy._rclpy_pybind11 import RCLError
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from rclpy.serialization import serialize_message
from rotcal_msgs.msg import TracerLength
from rotcal_msgs.srv import StartRecording, StopRecording

from rotcal_ros.bags.reader import bag_files, check_files
from rotcal_ros.nodes.runtime.qos import STREAM, adapted_qos
from rotcal_ros.sessions.processes import node_environment

TRACER, TABLE = TOPICS = ("tracer_length", "table_stream")
"""A cell's load: readings of a fast tracer, and every tenth message of a slower stream."""
TURN_S = 0.005
RATES = (4000, 6000, 8000, 10_000, 12_000, 14_000, 16_000, 20_000, 24_000, 32_000)
LOADS = 2
"""Publishing processes, each with a share of the rate."""
SHORT_S = 20.0
"""Longest run with a rate that is being searched, s."""
WARM_S = 5.0
"""Time in which the recorder's buffers reach their size; later growth would be a leak."""


def publish(rate: float, seconds: float) -> None:
    """Publish ``rate`` messages per second in all, evenly, and print how many there were."""
    node = rclpy.create_node(f"load_{os.getpid()}")
    tracer, table = (node.create_publisher(TracerLength, topic, STREAM) for topic in TOPICS)
    while not (tracer.get_subscription_count() and table.get_subscription_count()):
        time.sleep(0.05)
    time.sleep(1.0)
    message = serialize_message(TracerLength(length=0.5, status=1))
    sent, begin = 0, time.monotonic()
    while (passed := time.monotonic() - begin) < seconds:
        with suppress(RCLError):  # the middleware takes no more now: this load is the limit
            while sent < passed * rate:
                (tracer if sent % 10 else table).publish(message)
                sent += 1
        time.sleep(TURN_S)
    print(sent / passed, sent, flush=True)
    time.sleep(2.0)


def listen(seconds: float) -> None:
    """Count messages with the usual executor; the subscriptions are as deep as the recorder's."""
    node, counts = rclpy.create_node("plain"), [0]

    def count(_: TracerLength) -> None:
        counts[0] += 1

    for topic in TOPICS:
        node.create_subscription(TracerLength, topic, count, adapted_qos([STREAM]))
    executor = SingleThreadedExecutor()
    executor.add_node(node)
    last, end = -1, time.monotonic() + seconds + 20.0
    while time.monotonic() < end and not (counts[0] and counts[0] == last):
        last, until = counts[0], time.monotonic() + 1.5
        while time.monotonic() < until:
            executor.spin_once(timeout_sec=0.05)
    print(counts[0], flush=True)


def started(*command: str) -> subprocess.Popen[str]:
    return subprocess.Popen([sys.executable, *command], stdout=subprocess.PIPE, text=True)


def loaded(rate: float, seconds: float) -> tuple[float, int]:
    """Let all loads publish; return the rate in all and how many messages there were."""
    share = str(rate / LOADS)
    loads = [started(__file__, "publish", share, str(seconds)) for _ in range(LOADS)]
    counts = [load.communicate()[0].split() for load in loads]
    return sum(float(t[0]) for t in counts), sum(int(t[1]) for t in counts)


def plain(rate: float, seconds: float) -> tuple[float, int]:
    """Return the rate that was really sent and how many messages were lost."""
    listener = started(__file__, "listen", str(seconds))
    real, sent = loaded(rate, seconds)
    taken = listener.communicate()[0].split()[-1]
    return real, sent - int(taken)


class Recorder:
    """The recorder as a process, driven by its services."""

    def __init__(self, folder: Path) -> None:
        self._process = started(
            "-m", "rotcal_ros.nodes.recorder.node", "--ros-args",
            "-p", f"recorder.folder:={json.dumps(str(folder))}",
        )  # fmt: skip
        rclpy.init()
        self._node = Node("bench", start_parameter_services=False)

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
        opened = self.call(
            StartRecording, "start_recording", StartRecording.Request(plan_id="bench")
        )
        before, _ = self._usage()
        with ThreadPoolExecutor(1) as pool:
            running = pool.submit(loaded, rate, seconds)
            memory = self._memory(running)
        real, sent = running.result()
        used, _ = self._usage()
        answer = self.call(StopRecording, "stop_recording", StopRecording.Request())
        (verdict,) = check_files(bag_files(Path(opened.folder) / "bag"))
        recorded = sum(verdict.topics[f"/{topic}"].messages for topic in TOPICS)
        assert answer.success, answer.message
        return {
            "rate": real,
            "lost": sent - recorded,
            "noticed": answer.lost,
            "cpu_percent": 100 * (used - before) / seconds,
            "memory_mb": max(memory),
            "growth_mb": max(memory) - memory[0],
        }

    def _memory(self, running: Future[Any]) -> list[float]:
        """Return the resident megabytes while ``running``, from when the recorder is warm."""
        warm, found = time.monotonic() + WARM_S, []
        while not running.done():
            time.sleep(0.2)
            if time.monotonic() >= warm:
                found.append(self._usage()[1])
        return found

    def _usage(self) -> tuple[float, float]:
        """Return CPU seconds and resident megabytes."""
        root = Path("/proc") / str(self._process.pid)
        fields = (root / "stat").read_text().rpartition(")")[2].split()
        seconds = (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")
        return seconds, int(fields[21]) * os.sysconf("SC_PAGE_SIZE") / 1e6


def rows(seconds: float) -> Iterator[dict[str, Any]]:
    """Yield what both take without a loss: the rate of the plain one is raised until it loses.

    The recorder gets 10,500 messages/s for ``seconds``, four times what the plain one took, and
    as much as the loads can send.
    """
    os.environ.update(node_environment())
    best, short = 0.0, min(seconds, SHORT_S)
    for rate in RATES:
        real, lost = plain(rate, short)
        if lost or real < 0.95 * rate:
            break
        best = real
    name = f"plain rclpy subscription, best rate without loss for {short:g} s"
    yield {"name": name, "rate": best, "unit": "messages/s", "lost": 0}
    with tempfile.TemporaryDirectory(prefix="rotcal_bench_") as folder:
        recorder = Recorder(Path(folder))
        try:
            for name, rate, length in (
                ("recorder", 10_500, seconds),
                ("recorder, more than four times the plain one", 4.1 * best, short),
                ("recorder, all that the loads can send", 200_000, short),
            ):
                values = recorder.measure(rate, length)
                ratio = values["rate"] / best if best else None
                yield {
                    "name": f"{name}, {length:g} s", "unit": "messages/s", "ratio": ratio,
                    **values,
                }  # fmt: skip
        finally:
            recorder.end()


if __name__ == "__main__":
    rclpy.init()
    {"publish": publish, "listen": listen}[sys.argv[1]](*map(float, sys.argv[2:]))
