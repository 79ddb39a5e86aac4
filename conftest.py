"""Fixtures for all tests."""

import os
import signal
import sys
from pathlib import Path

import hypothesis
import pytest
from warm import WARM_SUBPROCESS, WarmServer

from rotcal_ros.sessions import processes
from rotcal_ros.sessions.domains import free_domain, release_domains

if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:
    # Started in the background by a shell: the processes under test would never hear Ctrl-C.
    signal.signal(signal.SIGINT, signal.default_int_handler)
if signal.getsignal(signal.SIGHUP) is signal.SIG_IGN:
    # Started by nohup: nor would they hear of a terminal that is gone.
    signal.signal(signal.SIGHUP, signal.SIG_DFL)

# What is compiled is kept, for all workers and for every process that a test starts.
sys.dont_write_bytecode = False
os.environ.pop("PYTHONDONTWRITEBYTECODE", None)

# A busy machine is no fault: examples have no deadline.
hypothesis.settings.register_profile("quick", max_examples=15, deadline=None)
hypothesis.settings.register_profile("long", max_examples=300, deadline=None)
hypothesis.settings.load_profile("long" if os.environ.get("ROTCAL_LONG_TESTS") else "quick")

LIVE = ("ros", "linuxcnc")
"""Marks of tests that start nodes or LinuxCNC."""


def pytest_addoption(parser):
    parser.addoption(
        "--live", choices=("only", "never"), help="tests that start ROS 2 nodes or LinuxCNC"
    )
    parser.addoption("--quick", action="store_true", help="without those that are marked slow")


def pytest_ignore_collect(collection_path, config):
    """Leave files without a live test unread where those alone are wanted."""
    if config.getoption("--live") != "only" or collection_path.suffix != ".py":
        return None
    text = collection_path.read_text(encoding="utf-8")
    return None if any(f"mark.{name}" in text for name in LIVE) else True


def pytest_runtest_setup(item):
    """Leave long tests to those who ask for them."""
    if item.get_closest_marker("long") and not os.environ.get("ROTCAL_LONG_TESTS"):
        pytest.skip("long: ROTCAL_LONG_TESTS=1 runs it")


def pytest_collection_modifyitems(config, items):
    """Keep what the options ask for; slow files first, or one core waits at the end."""
    live, quick = config.getoption("--live"), config.getoption("--quick")
    kept, left = [], []
    for item in items:
        is_live = any(item.get_closest_marker(name) for name in LIVE)
        wanted = live is None or is_live == (live == "only")
        slow = item.get_closest_marker("slow")
        (kept if wanted and not (quick and slow) else left).append(item)
    slow = {item.path for item in kept if item.get_closest_marker("slow")}
    items[:] = sorted(kept, key=lambda item: item.path not in slow)
    config.hook.pytest_deselected(items=left)


def pytest_terminal_summary(terminalreporter):
    """Note for scripts/test.sh what could not be tried here, one reason a line."""
    place = os.environ.get("ROTCAL_NOT_TRIED")
    if not place:
        return
    skipped = terminalreporter.stats.get("skipped", [])
    reasons = [str(report.longrepr[2]).removeprefix("Skipped: ") for report in skipped]
    with Path(place).open("a", encoding="utf-8") as noted:
        noted.writelines(f"{reason}\n" for reason in reasons if not reason.startswith("long: "))


@pytest.fixture(scope="session")
def warm():
    """Return what runs ``rotcal`` and ``python`` without their imports."""
    process = WarmServer()
    yield process
    process.close()


@pytest.fixture
def without_figures(monkeypatch):
    """Draw nothing: for tests of the words of pages, whose figures take most of their time."""
    monkeypatch.setattr(
        "rotcal_ros.methods.figures.style.svg", lambda _: '<svg viewBox="0 0 9 9"></svg>'
    )


@pytest.fixture(autouse=True)
def _live(request, monkeypatch):
    """Give each test marked ``ros`` a domain of its own on this machine, and nodes as copies."""
    if not request.node.get_closest_marker("ros"):
        yield
        return
    monkeypatch.setattr(processes, "subprocess", WARM_SUBPROCESS)
    monkeypatch.setenv("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")
    monkeypatch.setenv("ROS_DOMAIN_ID", str(free_domain()))
    yield
    release_domains()
