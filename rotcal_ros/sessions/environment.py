"""What the nodes need around them: ROS, and a domain and a middleware of this machine alone."""

from __future__ import annotations

import os
import time
from importlib.util import find_spec
from typing import Final

from rotcal_ros.foundation.errors import ConfigurationError
from rotcal_ros.foundation.middleware import middleware
from rotcal_ros.report.terminal.console import say
from rotcal_ros.sessions.domains import DEFAULT_DOMAIN, free_domain

_OF_THE_PAGE: Final = ("sse_starlette", "starlette", "uvicorn")


def require_ros() -> None:
    """Raise ConfigurationError when the nodes cannot run here."""
    missing = [name for name in ("rclpy", "rotcal_msgs") if find_spec(name) is None]
    if missing:
        raise ConfigurationError(
            f"live calibration needs ROS 2; not found: {', '.join(missing)}; run it from the "
            "project's environment (make setup) or source a ROS 2 workspace; recorded bags are "
            "solved without ROS: rotcal solve BAG"
        )


def page_can_be_served() -> bool:
    """Return whether what the operator's page needs is installed; print what is missing."""
    missing = [name for name in _OF_THE_PAGE if find_spec(name) is None]
    if missing:
        say(f"no page: not installed: {', '.join(missing)} (pip install 'rotcal_ros[page]')")
    return not missing


def node_environment(*, alone: bool = True) -> dict[str, str]:
    """Return the variables for the nodes; what the user has set stays.

    ``alone``: they need no other nodes and get a domain of their own, else ROS's default.
    """
    domain = os.environ.get("ROS_DOMAIN_ID") or str(free_domain() if alone else DEFAULT_DOMAIN)
    usual = {"PYTHONUNBUFFERED": "1", "OMP_NUM_THREADS": "1"}
    environment = {name: os.environ.get(name) or value for name, value in usual.items()}
    environment |= {"ROS_DOMAIN_ID": domain, **middleware(os.environ)}
    session = f"{time.monotonic_ns()}-{os.getpid()}"
    return environment | {"ROTCAL_SUPERVISOR": str(os.getpid()), "ROTCAL_SESSION": session}
