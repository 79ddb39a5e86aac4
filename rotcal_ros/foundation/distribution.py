"""Which distribution of ROS 2 this is, as its rclpy says; a sourced shell's word may be stale."""

from __future__ import annotations

from importlib.metadata import distributions
from typing import Final

SUPPORTED: Final = ("jazzy", "kilted")
_OF_RCLPY: Final = {3: "humble", 4: "iron", 7: "jazzy", 9: "kilted"}
_PACKAGES: Final = ("rclpy", "ros-rclpy")
"""As an installation names it, and as the wheels do."""


def rclpy_version() -> str:
    """Return the version of rclpy, empty where none is installed."""
    installed = (found for package in _PACKAGES for found in distributions(name=package))
    return next((package.version for package in installed), "")


def distribution(rclpy: str) -> str:
    """Return the distribution with this version of rclpy, as in ROS_DISTRO; empty: unknown."""
    major = rclpy.partition(".")[0]
    return _OF_RCLPY.get(int(major), "") if major.isdecimal() else ""
