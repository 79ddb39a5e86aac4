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
    versions = {"rotcal_ros": __version__, "python": platform.python_version()}
    for name in _PACKAGES:
        try:
            versions[name] = version(name)
        except PackageNotFoundError:
            continue
    versions["system"] = platform.platform()
    versions["ros_distro"] = os.environ.get("ROS_DISTRO", "")
    versions["rmw"] = get_rmw_implementation_identifier()
    return json.dumps(versions, indent=1)
