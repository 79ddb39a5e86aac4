"""Fixtures for all tests."""

import signal

import pytest

from rotcal_ros.sessions.domains import free_domain

if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:
    # Started in the background by a shell: the processes under test would never hear Ctrl-C.
    signal.signal(signal.SIGINT, signal.default_int_handler)


@pytest.fixture(autouse=True)
def _own_domain(request, monkeypatch):
    """Give each test marked ``ros`` a domain of its own, on this machine only."""
    if request.node.get_closest_marker("ros"):
        monkeypatch.setenv("ROS_DOMAIN_ID", str(free_domain()))
        monkeypatch.setenv("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")
