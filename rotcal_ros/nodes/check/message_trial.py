"""Sends a message there and back over DDS, for ``rotcal doctor``.

    python -m rotcal_ros.nodes.check.message_trial

Two contexts are two DDS participants, so the message travels as between two processes.
Prints one line and exits with 0, or says what failed and exits with 1.
"""

from __future__ import annotations

import sys
import time
from typing import Final

from rclpy.utilities import get_rmw_implementation_identifier
from rotcal_msgs.msg import TableAngle

from rotcal_ros.nodes.runtime.qos import LATCHED
from rotcal_ros.nodes.runtime.running import PeerNode

DEADLINE_S: Final = 10.0
TURN_S: Final = 0.02


def measure_round_trip() -> float | None:
    """Return the seconds from the first sign of life to the answer; None after the deadline."""
    here, there = PeerNode("doctor_here"), PeerNode("doctor_there")
    returned: list[TableAngle] = []
    echo = there.node.create_publisher(TableAngle, "doctor_back", LATCHED)
    there.node.create_subscription(TableAngle, "doctor_out", echo.publish, LATCHED)
    here.node.create_subscription(TableAngle, "doctor_back", returned.append, LATCHED)
    start = time.monotonic()
    here.node.create_publisher(TableAngle, "doctor_out", LATCHED).publish(TableAngle(step=7))
    try:
        while time.monotonic() < start + DEADLINE_S:
            there.work_until(lambda: False, TURN_S)
            if here.work_until(lambda: bool(returned), TURN_S):
                return time.monotonic() - start
        return None
    finally:
        here.close()
        there.close()


def main() -> int:
    """Run the self-test and print the outcome in one line."""
    seconds = measure_round_trip()
    rmw = get_rmw_implementation_identifier()
    if seconds is None:
        sys.stdout.write(f"{rmw}: no message came back within {DEADLINE_S:g} s\n")
        return 1
    sys.stdout.write(f"{rmw}: a message came back after {seconds * 1e3:.0f} ms\n")
    return 0


if __name__ == "__main__":
    sys.exit(main())
