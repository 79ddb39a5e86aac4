"""The tests on the real LinuxCNC are skipped where there is none, unless that is forbidden."""

import fcntl
import os
import tempfile
from pathlib import Path

import pytest
from real_linuxcnc import Axis, why_not


def pytest_collection_modifyitems(items):
    marked = [item for item in items if item.get_closest_marker("linuxcnc")]
    reason = why_not() if marked and not os.environ.get("ROTCAL_REQUIRE_LINUXCNC") else ""
    for item in marked if reason else []:
        item.add_marker(pytest.mark.skip(reason=reason))


@pytest.fixture(autouse=True)
def alone(request):
    """Keep others from starting a LinuxCNC meanwhile: a machine holds one, and tests are many."""
    if not request.node.get_closest_marker("linuxcnc"):
        yield
        return
    with Path(tempfile.gettempdir(), "rotcal_linuxcnc.lock").open("w") as held:
        fcntl.flock(held, fcntl.LOCK_EX)
        yield


@pytest.fixture
def axis(tmp_path):
    return Axis(tmp_path / "axis")
