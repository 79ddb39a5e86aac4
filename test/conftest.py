"""Fixtures for all tests."""

import itertools
import os

import pytest

# Domains 1 to 100 use ports below the range that the kernel gives to outgoing connections.
_domains = itertools.count(os.getpid())


@pytest.fixture(autouse=True)
def _own_domain(request, monkeypatch):
    """Give each test marked ``ros`` a domain of its own, on this machine only."""
    if request.node.get_closest_marker("ros"):
        monkeypatch.setenv("ROS_DOMAIN_ID", str(1 + next(_domains) % 100))
        monkeypatch.setenv("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")
