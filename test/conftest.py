"""Fixtures for all tests."""

import itertools
import os

import pytest

from rotcal_ros.cli.domain import free_domain

_domains = itertools.count(os.getpid())


@pytest.fixture(autouse=True)
def _own_domain(request, monkeypatch):
    """Give each test marked ``ros`` a domain of its own, on this machine only."""
    if request.node.get_closest_marker("ros"):
        monkeypatch.setenv("ROS_DOMAIN_ID", str(free_domain(next(_domains))))
        monkeypatch.setenv("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")
