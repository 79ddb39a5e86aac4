"""The tests on the real LinuxCNC are skipped where there is none, unless that is forbidden."""

import os

import pytest
from real_linuxcnc import Axis, why_not


def pytest_collection_modifyitems(items):
    marked = [item for item in items if item.get_closest_marker("linuxcnc")]
    reason = why_not() if marked and not os.environ.get("ROTCAL_REQUIRE_LINUXCNC") else ""
    for item in marked if reason else []:
        item.add_marker(pytest.mark.skip(reason=reason))


@pytest.fixture
def axis(tmp_path):
    return Axis(tmp_path / "axis")
