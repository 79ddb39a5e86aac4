"""The quality of service that a bag says its publishers offered, to offer it again."""

from __future__ import annotations

from typing import Any, Final

from rclpy.duration import Duration
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy

from rotcal_ros.bags.rosbag2_metadata import INFINITE_NS, qos_profiles

VOLATILE_DEPTH: Final = 5000
"""The graph tells no recorder how deep a publisher's queue was: so much is kept for slow ones."""
_BEST_EFFORT: Final = ("best_effort", 2)
_TRANSIENT_LOCAL: Final = ("transient_local", 1)
"""In words, and the numbers of older bags."""


def offered_qos(text: str) -> QoSProfile:
    """Return the profile that a channel's ``offered_qos_profiles`` asks for.

    Of several publishers it is what all offered; where the bag says nothing it is ROS's default.
    """
    profiles = qos_profiles(text)
    best_effort = any(p["reliability"] in _BEST_EFFORT for p in profiles)
    latched = bool(profiles) and all(p["durability"] in _TRANSIENT_LOCAL for p in profiles)
    known = max((p["depth"] for p in profiles if isinstance(p["depth"], int)), default=0)
    found = QoSProfile(
        depth=max(known, 1) if latched else max(known, VOLATILE_DEPTH),
        reliability=ReliabilityPolicy.BEST_EFFORT if best_effort else ReliabilityPolicy.RELIABLE,
        durability=(DurabilityPolicy.TRANSIENT_LOCAL if latched else DurabilityPolicy.VOLATILE),
    )
    for name in ("deadline", "lifespan"):
        limits = [ns for p in profiles if (ns := _finite_ns(p[name])) is not None]
        if limits:
            setattr(found, name, Duration(nanoseconds=max(limits)))
    return found


def _finite_ns(duration: Any) -> int | None:
    """Return a duration of a bag in ns; None where it is no limit."""
    try:
        nanoseconds = int(duration["sec"]) * 1_000_000_000 + int(duration["nsec"])
    except (KeyError, TypeError, ValueError):
        return None
    return nanoseconds if 0 < nanoseconds < INFINITE_NS else None
