"""Fixtures for all tests."""

import pytest

from rotcal_ros.cli.domains import free_domain


@pytest.fixture(autouse=True)
def _own_domain(request, monkeypatch):
    """Give each test marked ``ros`` a domain of its own, on this machine only."""
    if request.node.get_closest_marker("ros"):
        monkeypatch.setenv("ROS_DOMAIN_ID", str(free_domain()))
        monkeypatch.setenv("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")
