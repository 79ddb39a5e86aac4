"""A calibration that is interrupted and resumed comes to its history, which informs the cell."""

import re
import signal

import pytest
from live_cell import wait_until

from rotcal_history.database import ParkHistory, result_of
from rotcal_ros.foundation.machine_load import load_scaled_timeout

pytest.importorskip("rclpy")
pytest.importorskip("rotcal_msgs")
pytestmark = pytest.mark.ros

STEP = re.compile(r"[1-9]\d* of 60 steps")


@pytest.mark.slow
def test_a_run_is_in_the_history_once_it_is_done(rotcal, cell, tmp_path):
    folder, database = tmp_path / "out", tmp_path / "history.db"
    cut, log = tmp_path / "cut.log", tmp_path / "resumed.log"
    kept = ("--history", database, "--no-page", "--no-export")
    own = ("identity.serial=4711", "simulation.time_scale=5.0")
    status = ("-p", f"history.database:={database}", "-p", "history.period_s:=1.0")
    live = cell()
    live.start("calibration_status", arguments=status)

    run = rotcal("--output", folder, *kept, log=cut, changes=own)
    wait_until(lambda: STEP.search(cut.read_text()), "a step is done")
    run.send_signal(signal.SIGINT)
    assert run.wait(load_scaled_timeout(60)) == 130
    assert not database.exists()

    run = rotcal("--resume", folder, *kept, log=log, changes=own)
    assert run.wait(load_scaled_timeout(120)) == 0
    assert "history: entry 1: result of 4711/C" in log.read_text()
    live.wait_for_log("calibration_status", "reported: 1 tables")
    with ParkHistory(str(database)) as history:
        result, report = history.entries(content=True)
        assert history.check() == []
    assert result_of(result).to_json() == (folder / "result.json").read_text()
    assert report.content == (folder / "report.html").read_bytes()
