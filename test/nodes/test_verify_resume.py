"""A newcomer interrupts the demonstration, in its first or its second half, and goes on."""

import json
import re
import signal
import sys
from pathlib import Path

import pytest
import warm
from live_cell import wait_until

from rotcal_ros.foundation.machine_load import load_scaled_timeout
from rotcal_ros.recordings.result_sources import read_source

pytest.importorskip("rclpy")
pytest.importorskip("rotcal_msgs")
pytestmark = pytest.mark.ros

CONFIG = Path(__file__).parents[2] / "config" / "verify_demo.yaml"
SMALL = ("plan.table_step_deg=30.0", "plan.table_positions=12", "plan.box_points=[2, 2, 2]")


@pytest.fixture
def verify():
    """Start ``rotcal verify``, with what it says in a file; what still runs is ended."""
    started = []

    def start(*arguments, log):
        command = [sys.executable, "-m", "rotcal_ros.cli.main", "verify", *map(str, arguments)]
        with log.open("w") as stream:
            child = warm.popen(command, stdout=stream, stderr=stream)
        started.append(child)
        return child

    yield start
    for child in started:
        if child.poll() is None:
            child.kill()
            child.wait()


@pytest.mark.long  # test_until_goal_live.py resumes one of its halves
@pytest.mark.parametrize(
    ("interrupt", "half"), [(signal.SIGINT, "before"), (signal.SIGKILL, "after")]
)
def test_an_interrupted_verification_ends_with_everything(verify, tmp_path, interrupt, half):
    folder, log = tmp_path / "demo", tmp_path / "first.log"
    changes = [part for change in SMALL for part in ("--set", change)]
    first = verify(CONFIG, "-o", folder, *changes, log=log)
    told = re.compile(rf"measuring {half} compensation.*?([3-9]\d) of 96 steps", re.DOTALL)
    wait_until(lambda: told.search(log.read_text()), f"some steps {half} compensation")
    first.send_signal(interrupt)
    first.wait(load_scaled_timeout(60))
    assert not (folder / "verification.json").exists()
    if interrupt == signal.SIGINT:
        assert first.returncode == 130
        assert f"to go on: rotcal verify --resume {folder}" in log.read_text()
    kept = (folder / "result.json").read_text() if half == "after" else None

    log = tmp_path / "second.log"
    second = verify("--resume", folder, log=log)
    assert second.wait(load_scaled_timeout(180)) == 0, log.read_text()
    assert "verdict ok (SIMULATED)" in log.read_text()
    for name in ("result.json", "truth.json", "report.html", "verification.json", "bag",
                 "compensation/c_csv_simulated.csv", "after/result.json"):  # fmt: skip
        assert (folder / name).exists(), name
    if kept is not None:
        assert (folder / "result.json").read_text() == kept
    data = json.loads((folder / "verification.json").read_text())
    assert data["before"]["systematic_E_arcsec"] > 50 * data["after"]["systematic_E_arcsec"]
    # One story: the table comes from the result beside it, and the second round had it in force.
    side = json.loads((folder / "compensation/c_csv_simulated.provenance.json").read_text())
    result = read_source(folder)
    assert side["sources_sha256"] == dict(result.sha256)
    assert read_source(folder / "after").result.measured_on == side["contents_sha256"]
    assert "Before and after compensation" in (folder / "report.html").read_text()

    third = verify("--resume", folder, log=tmp_path / "third.log")
    assert (
        third.wait(load_scaled_timeout(60)) == 0
    )  # nothing is left to do: the same figures again
    assert json.loads((folder / "verification.json").read_text()) == data


def test_a_folder_without_a_verification_is_named(verify, tmp_path):
    (tmp_path / "empty").mkdir()
    log = tmp_path / "log"
    assert verify("--resume", tmp_path / "empty", log=log).wait(load_scaled_timeout(60)) == 2
    assert "holds no verification: its verify.json is missing" in log.read_text()
    assert verify(log=log).wait(load_scaled_timeout(60)) == 2
    assert "give a CONFIG, or --resume FOLDER" in log.read_text()
