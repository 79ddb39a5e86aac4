"""Fixtures for all tests."""

import itertools
import os
import signal

import pytest

from rotcal_ros.sessions import domains

if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:
    # Started in the background by a shell: the processes under test would never hear Ctrl-C.
    signal.signal(signal.SIGINT, signal.default_int_handler)


LIVE = ("ros", "linuxcnc")
"""Marks of tests that start nodes or LinuxCNC."""
HALVES = ("cells", "beside")


def pytest_addoption(parser):
    parser.addoption(
        "--live", choices=("only", "never", *HALVES),
        help="tests that start ROS 2 nodes or LinuxCNC: only these, none, or one half of them: "
        "those with whole cells, or those that need little processor time",
    )  # fmt: skip


def pytest_configure(config):
    """Give each half a share of the domains: both start nodes at the same time."""
    if (half := config.getoption("--live")) in HALVES:
        domains._turn = itertools.count(2 * os.getpid() + HALVES.index(half), 2)


def pytest_ignore_collect(collection_path, config):
    """Leave files without a live test unread where those alone are wanted."""
    if config.getoption("--live") in (None, "never") or collection_path.suffix != ".py":
        return None
    text = collection_path.read_text(encoding="utf-8")
    return None if any(f"mark.{name}" in text for name in LIVE) else True


def half_of(item):
    """A cell needs both cores at times; a LinuxCNC by itself, and a bridge, mostly wait."""
    waits = not item.get_closest_marker("ros") or "bridge" in item.path.stem
    return "beside" if waits else "cells"


def pytest_collection_modifyitems(config, items):
    """Keep what ``--live`` asks for."""
    wanted = config.getoption("--live")
    if wanted is None:
        return
    kept, left = [], []
    for item in items:
        live = any(item.get_closest_marker(name) for name in LIVE)
        matching = ("only", half_of(item)) if live else ("never",)
        (kept if wanted in matching else left).append(item)
    items[:] = kept
    config.hook.pytest_deselected(items=left)


@pytest.fixture(autouse=True)
def _own_domain(request, monkeypatch):
    """Give each test marked ``ros`` a domain of its own, on this machine only."""
    if request.node.get_closest_marker("ros"):
        monkeypatch.setenv("ROS_DOMAIN_ID", str(domains.free_domain()))
        monkeypatch.setenv("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")
