"""The joints that the table's feedback tells of, in the heartbeat of the capture."""

from __future__ import annotations

import math

from sensor_msgs.msg import JointState

from rotcal_ros.nodes.latest import JOINT, MOST_JOINTS


class JointReadings:
    """The latest angle (rad) and velocity (rad/s) of each joint."""

    def __init__(self) -> None:
        self._joints: dict[str, tuple[float, float]] = {}

    def note(self, message: JointState, chosen: str) -> None:
        """Note what a message says of its joints; the ``chosen`` one is told in any case."""
        velocities = (*message.velocity, *(math.nan for _ in message.position))
        for name, angle, velocity in zip(message.name, message.position, velocities, strict=False):
            if name in self._joints or name == chosen or len(self._joints) < MOST_JOINTS:
                self._joints[name] = angle, velocity

    def values(self) -> dict[str, str]:
        """Return what is told of the joints, in the order in which they were first heard."""
        return {f"{JOINT}{n}": f"{a:.9f} {v:.9f}" for n, (a, v) in self._joints.items()}
