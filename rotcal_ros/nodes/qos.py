"""The qualities of service of the cell: one profile per kind of topic."""

from typing import Final

from rclpy.qos import (
    DurabilityPolicy,
    HistoryPolicy,
    QoSProfile,
    ReliabilityPolicy,
    qos_profile_sensor_data,
)

LATCHED: Final = QoSProfile(
    depth=1,
    history=HistoryPolicy.KEEP_LAST,
    reliability=ReliabilityPolicy.RELIABLE,
    durability=DurabilityPolicy.TRANSIENT_LOCAL,
)
"""Plans and results: whoever comes later still gets the last one."""

EVENT: Final = QoSProfile(depth=100, reliability=ReliabilityPolicy.RELIABLE)
"""Orders, observations, receipts: none may be lost."""

STREAM: Final = QoSProfile(depth=5000, reliability=ReliabilityPolicy.RELIABLE)
"""Readings at kilohertz rates, published reliably by our own nodes."""

ANY_STREAM: Final = QoSProfile(depth=5000, reliability=qos_profile_sensor_data.reliability)
"""For listening to instruments: best effort matches every publisher."""
