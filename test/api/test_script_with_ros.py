"""The example that calibrates over ROS 2, on a live simulated cell."""

import os
import re
import sys
from pathlib import Path

import pytest
import warm

import rotcal_ros as rc
from rotcal_ros.foundation.machine_load import load_scaled_timeout

ROOT = Path(__file__).parents[2]
pytestmark = [pytest.mark.ros, pytest.mark.slow]


@pytest.fixture
def cell(tmp_path, monkeypatch):
    """A live cell with a short plan, which ends with the test."""
    monkeypatch.syspath_prepend(ROOT / "test" / "nodes")
    monkeypatch.setenv("PYTHONPATH", os.pathsep.join([str(ROOT), *filter(None, sys.path)]))
    from live_cell import DEMO, SHORT, LiveCell

    made = LiveCell(tmp_path, rc.read_configuration(DEMO, *SHORT))
    yield made
    made.processes.end()


def test_the_script_calibrates_the_simulated_cell(cell):
    cell.start("planner", "capture", "solver", "recorder", "simulated_cell")
    script = ROOT / "examples" / "11_calibrate_from_a_script.py"
    done = warm.run([sys.executable, script, cell.file], timeout=load_scaled_timeout(120))
    assert done.returncode == 0, done.stderr
    assert "verdict ok" in done.stdout
    assert float(re.search(r"truth: (\S+) standard", done.stdout)[1]) < 3.5
    assert str(cell.bag) in done.stdout
    assert rc.read_bag(cell.bag).same_as_recorded
