"""The qualities of service of the cell, one profile per kind of topic."""

from collections.abc import Sequence
from typing import Final

from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy

LATCHED: Final = QoSProfile(
    depth=1, reliability=ReliabilityPolicy.RELIABLE, durability=DurabilityPolicy.TRANSIENT_LOCAL
)
"""Goals, plans and results: late subscribers still get the last one."""

EVENT: Final = QoSProfile(depth=100, reliability=ReliabilityPolicy.RELIABLE)
"""Orders, observations, receipts: none may be lost."""

STREAM: Final = QoSProfile(depth=5000, reliability=ReliabilityPolicy.RELIABLE)
"""Readings at kilohertz rates, published reliably by our own nodes."""

VIEW: Final = QoSProfile(depth=10, reliability=ReliabilityPolicy.BEST_EFFORT)
"""For nodes that only watch: no publisher repeats anything for them or waits for them."""

LISTENING_DEPTH: Final = 50_000
"""Messages that the middleware keeps for a busy listener: a second of the fastest load."""


def adapted_qos(profiles: Sequence[QoSProfile]) -> QoSProfile:
    """Return the strictest profile that matches all publishers, as rosbag2 chooses it.

    All reliable: reliable, else best effort; all transient local: transient local, else
    volatile; everything else is left open.
    """
    reliable = all(p.reliability == ReliabilityPolicy.RELIABLE for p in profiles)
    latched = all(p.durability == DurabilityPolicy.TRANSIENT_LOCAL for p in profiles)
    return QoSProfile(
        depth=LISTENING_DEPTH,
        reliability=ReliabilityPolicy.RELIABLE if reliable else ReliabilityPolicy.BEST_EFFORT,
        durability=DurabilityPolicy.TRANSIENT_LOCAL if latched else DurabilityPolicy.VOLATILE,
    )
