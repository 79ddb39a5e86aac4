"""The recorder in the whole graph: splitting, disks that are small or read-only, losses."""

import signal
import subprocess
import sys
from pathlib import Path

import pytest
from live_cell import SUITE, wait_until

from rotcal_ros.bags import names
from rotcal_ros.bags.dropouts import loss_counters
from rotcal_ros.bags.reader import bag_files, check_files
from rotcal_ros.recordings.replay import read_recording

pytest.importorskip("rclpy")
pytest.importorskip("rotcal_msgs")
pytestmark = pytest.mark.ros

RECORDER_FAILED = 604


@pytest.fixture
def mounted(tmp_path):
    """Return a function that mounts a file system in memory; it is unmounted with the test."""
    folder = tmp_path / "mounted"
    folder.mkdir()

    def mount(options):
        command = ["mount", "-t", "tmpfs", "-o", options, "tmpfs", str(folder)]
        done = subprocess.run(command, capture_output=True, text=True)
        if done.returncode:
            pytest.skip(f"file systems cannot be mounted here: {done.stderr.strip()}")
        return folder

    yield mount
    subprocess.run(["umount", "--lazy", str(folder)], capture_output=True)


@pytest.mark.long  # test_until_goal_live.py reads two files as one
def test_a_split_session_is_one_to_the_solver(cell):
    live = cell("recorder.writer.split_bytes=150000")
    outcome = live.calibrate()
    assert outcome["error_code"] == 0, outcome["error_msg"]
    files = bag_files(live.bag)
    assert len(files) >= 3
    assert [file.name for file in files] == [f"bag_{number}.mcap" for number in range(len(files))]
    assert all(v.state == "complete" and not v.losses_recorded for v in check_files(files))
    recording = read_recording(live.bag)
    assert recording.same_as_recorded
    assert recording.solve().to_json() == (live.session / "result.json").read_text()


def accepted_before_the_end(live, outcome):
    """Check that every step that the planner had as accepted is in the bag; return the verdict."""
    recording = read_recording(live.bag)
    recorded = {(o.step, o.attempt) for o in recording.recorded if o.accepted}
    replayed = {(o.step, o.attempt) for o in recording.observations if o.accepted}
    assert outcome["n_used"] >= 3
    assert len({step for step, _ in recorded & replayed}) >= outcome["n_used"]
    (verdict,) = recording.verdicts
    return verdict


@pytest.mark.long  # test_kill_graph.py has a full disk
def test_a_disk_that_fills_up_costs_nothing_that_was_accepted(cell, mounted):
    live = cell("recorder.writer.min_free_bytes=0")
    live.recordings = mounted("size=160k")
    outcome = live.calibrate()
    assert outcome["error_code"] == RECORDER_FAILED, outcome["error_msg"]
    assert "the disk is full" in outcome["error_msg"]
    verdict = accepted_before_the_end(live, outcome)
    assert verdict.state == "truncated"
    assert not verdict.lost


@pytest.mark.long  # test_kill_graph.py has a full disk
def test_recording_stops_in_good_order_before_the_disk_is_full(cell, mounted):
    live = cell("recorder.writer.min_free_bytes=100000")
    live.recordings = mounted("size=400k")
    outcome = live.calibrate()
    assert outcome["error_code"] == RECORDER_FAILED, outcome["error_msg"]
    assert "MB that recording keeps free; recording stopped" in outcome["error_msg"]
    assert accepted_before_the_end(live, outcome).state == "complete"


def test_a_read_only_folder_is_refused_before_the_first_step(cell, mounted):
    live = cell()
    live.recordings = mounted("ro")
    outcome = live.calibrate()
    assert outcome["error_code"] == RECORDER_FAILED, outcome["error_msg"]
    assert "the file system is read-only" in outcome["error_msg"]
    assert outcome["n_used"] == 0


@pytest.mark.long  # test_dropouts*.py count what is missing
def test_a_stream_that_falls_silent_is_counted(cell):
    live = cell(
        "simulation.temperature.rate_hz=0.01",
        "capture.temperature_expected=false",
        "recorder.silence_s=0.5",
    )
    outcome = live.calibrate()
    assert outcome["error_code"] == 0, outcome["error_msg"]
    recording = read_recording(live.bag)
    (verdict,) = recording.verdicts
    assert verdict.losses_recorded["silent /cell/temperature"] == 1
    assert loss_counters(verdict.dropouts) == verdict.losses_recorded
    (silence,) = (d for d in verdict.dropouts if d.topic == "/cell/temperature")
    (start_ns, end_ns) = (verdict.start_ns, verdict.end_ns)
    assert silence.to_ns - silence.from_ns > 0.5 * (end_ns - start_ns)  # one message, then none
    assert "/cell/temperature fell silent (1 times)" in recording.warnings()


@pytest.mark.long
def test_pressure_and_humidity_are_captured_live_as_offline(cell):
    live = cell(
        "simulation.air.published=true",
        "simulation.air.pressure_swing_pa=500.0",
        "capture.pressure_expected=true",
        "capture.humidity_expected=true",
    )
    outcome = live.calibrate()
    assert outcome["error_code"] == 0, outcome["error_msg"]
    recording = read_recording(live.bag)
    assert recording.same_as_recorded
    accepted = [o for o in recording.recorded if o.accepted]
    assert len({o.pressure_pa for o in accepted}) > 3
    assert {o.humidity for o in accepted} == {0.5}


def test_a_step_that_a_loss_touches_is_measured_again(cell):
    # Windows so long that the cell is held in one of them, on a busy machine too.
    live = cell("simulation.hold_s=0.7", "capture.window_samples=100")
    late = str(Path(__file__).with_name("late_publisher.py"))
    live.processes.start("late_publisher", [sys.executable, late])
    live.start(*SUITE, "simulated_cell")
    live.wait_for_log("late_publisher", "ready")
    client = live.client()
    # Step 9 is blocked; a loss during its rejected attempts would touch no accepted step.
    client.wait_for_step(15)
    with live.held():
        live.processes.signal("late_publisher", signal.SIGUSR1)
        live.wait_for_log("late_publisher", "here")
        # on a busy machine the recorder hears of it only after the last step
        wait_until(
            lambda: check_files(bag_files(live.bag))[0].losses_recorded, "the loss is noted"
        )
    outcome = client.result()
    assert outcome["error_code"] == 0, outcome["error_msg"]
    recording = read_recording(live.bag)
    accepted = [(o.step, o.attempt) for o in recording.recorded if o.accepted]
    again = {step for step, attempt in accepted if (step, attempt + 1) in accepted}
    assert len(again) == 1
    (verdict,) = recording.verdicts
    assert verdict.losses_recorded == {f"incompatible publisher /cell/{names.TRACER_LENGTH}": 1}
    assert loss_counters(verdict.dropouts) == verdict.losses_recorded
    assert outcome["n_used"] == 59
    assert recording.same_as_recorded
