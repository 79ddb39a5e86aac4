"""Static transforms from /tf_static, where tf2_msgs is installed."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy

from rotcal_ros.bags import names
from rotcal_ros.capture.messages import static_frames
from rotcal_ros.geometry.frames import StaticFrame

try:
    from tf2_msgs.msg import TFMessage
except ImportError:  # there is no wheel of it; a ROS installation has it
    TFMessage = None

_QOS = QoSProfile(
    depth=100, reliability=ReliabilityPolicy.RELIABLE, durability=DurabilityPolicy.TRANSIENT_LOCAL
)
"""As in tf2: late subscribers still get what was published."""


class StaticFrames:
    """The static transforms of the domain so far; for each child the last one counts."""

    def __init__(self, node: Node, guarded: Callable[..., Any] = lambda work: work) -> None:
        self.heard = TFMessage is not None
        self._frames: dict[str, StaticFrame] = {}
        if self.heard:
            node.create_subscription(TFMessage, names.TF_STATIC, guarded(self.take), _QOS)

    @property
    def frames(self) -> tuple[StaticFrame, ...]:
        """The transforms, one for each child."""
        return tuple(self._frames.values())

    def take(self, message: Any) -> None:
        """Take a tf2_msgs/TFMessage."""
        self._frames |= {frame.child: frame for frame in static_frames(message)}
