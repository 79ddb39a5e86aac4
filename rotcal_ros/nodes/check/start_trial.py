"""Start the suite's nodes and end them, for ``rotcal doctor``.

    python -m rotcal_ros.nodes.check.start_trial

They are processes as in a calibration: each has to beat, and to end cleanly when told to. Prints
one line and exits with 0, or says what failed and exits with 1.
"""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import tempfile
import time
from contextlib import ExitStack
from typing import Final

from rclpy.qos import QoSProfile
from rotcal_msgs.msg import NodeState as NodeStateMsg

from rotcal_ros.bags import names
from rotcal_ros.foundation.errors import RotcalError
from rotcal_ros.foundation.machine_load import load_scaled_timeout
from rotcal_ros.foundation.node_names import NODES
from rotcal_ros.nodes.runtime.running import SUPERVISOR_VARIABLE, PeerNode

START_S: Final = 40.0
END_S: Final = 5.0
_NAMESPACE: Final = "/doctor"


class NodeError(RotcalError):
    """A node did not start, beat or end as it should."""


class TrialNode:
    """One node as a process; its output goes to a file without a name."""

    def __init__(self, name: str) -> None:
        self.name = name
        self._output = tempfile.TemporaryFile("w+")  # noqa: SIM115 - closed with the process
        module = f"rotcal_ros.nodes.{name}.node"
        self._process = subprocess.Popen(
            [sys.executable, "-m", module, "--ros-args", "-r", f"__ns:={_NAMESPACE}"],
            env=os.environ | {SUPERVISOR_VARIABLE: str(os.getpid())},
            stdout=self._output,
            stderr=subprocess.STDOUT,
        )

    def running(self) -> bool:
        """Return whether the process runs."""
        return self._process.poll() is None

    def interrupt(self) -> None:
        """Tell it to end, as Ctrl-C does."""
        self._process.send_signal(signal.SIGINT)

    def end(self) -> NodeError | None:
        """Wait until it has ended; return what went wrong, if anything."""
        try:
            code = self._process.wait(load_scaled_timeout(END_S))
        except subprocess.TimeoutExpired as late:
            return NodeError(f"{self.name} did not end within {late.timeout:.0f} s")
        return NodeError(self.last_words()) if code else None

    def last_words(self) -> str:
        """Return how the process ended."""
        self._output.seek(0)
        lines = self._output.read().strip().splitlines() or ["it said nothing"]
        return f"{self.name} ended with {self._process.returncode}: {lines[-1]}"

    def close(self) -> None:
        """Leave nothing behind."""
        self._process.kill()
        self._process.wait()
        self._output.close()


def start_and_end_all_nodes() -> float:
    """Start all nodes and end them; return the seconds until all beat. Raises NodeError."""
    beating: set[str] = set()

    def receive(beat: NodeStateMsg) -> None:
        beating.add(beat.node)

    with ExitStack() as stack:
        peer = PeerNode("doctor", _NAMESPACE)
        stack.callback(peer.close)
        qos, start = QoSProfile(depth=100), time.monotonic()
        nodes = []
        for name in NODES:
            nodes.append(node := TrialNode(name))
            stack.callback(node.close)

        def settled() -> bool:
            return beating >= set(NODES) or not all(node.running() for node in nodes)

        # Two ends that the middleware never connects: a new one it does connect.
        for _ in range(2):
            listening = peer.node.create_subscription(NodeStateMsg, names.HEARTBEAT, receive, qos)
            if peer.work_until(settled, load_scaled_timeout(0.5 * START_S)):
                break
            peer.node.destroy_subscription(listening)
        took = time.monotonic() - start
        if dead := [node.last_words() for node in nodes if not node.running()]:
            raise NodeError("; ".join(dead))
        if silent := [name for name in NODES if name not in beating]:
            raise NodeError(f"no sign of life within {START_S:g} s: {', '.join(silent)}")
        for node in nodes:
            node.interrupt()
        wrong = [str(error) for node in nodes if (error := node.end()) is not None]
        if wrong:
            raise NodeError("; ".join(wrong))
        return took


def main() -> int:
    """Run the trial and print the outcome in one line."""
    try:
        took = start_and_end_all_nodes()
    except NodeError as error:
        sys.stdout.write(f"{error}\n")
        return 1
    sys.stdout.write(f"{', '.join(NODES)} started, beat after {took:.1f} s and ended cleanly\n")
    return 0


if __name__ == "__main__":
    sys.exit(main())
