"""Versions of everything that took part, for the bag."""

from __future__ import annotations

import json
import os
import platform
from importlib.metadata import PackageNotFoundError, version

from rclpy.utilities import get_rmw_implementation_identifier

from rotcal_ros import __version__

_PACKAGES = ("numpy", "scipy", "mcap", "rclpy", "ros-rclpy", "rotcal_msgs")


def versions_json() -> str:
    """Return the versions of packages, Python, operating system and middleware as JSON."""
    installed = {package: _version(package) for package in _PACKAGES}
    versions = {
        "rotcal_ros": __version__,
        "python": platform.python_version(),
        **{package: found for package, found in installed.items() if found},
        "system": platform.platform(),
        "ros_distro": os.environ.get("ROS_DISTRO", ""),
        "rmw": get_rmw_implementation_identifier(),
    }
    return json.dumps(versions, indent=1)


def _version(package: str) -> str:
    try:
        return version(package)
    except PackageNotFoundError:
        return ""
