"""The folder and the configuration of a run; nothing here starts a node."""

from pathlib import Path

import pytest

from rotcal_ros.foundation.errors import BagError, ConfigurationError
from rotcal_ros.foundation.folder_lock import FolderLock
from rotcal_ros.foundation.node_state import Why
from rotcal_ros.methods import prepare
from rotcal_ros.methods.configuration import changed, read_configuration
from rotcal_ros.sessions.person import describe_feedback
from rotcal_ros.sessions.processes import node_environment
from rotcal_ros.sessions.session import expected_bytes, free_folder_name, prepare_session

DEMO = Path(__file__).parents[2] / "config" / "tracer_paper.yaml"


def test_without_changes_the_configuration_is_kept_byte_for_byte(tmp_path):
    session = prepare_session(DEMO, tmp_path / "out", [])
    assert session.folder.configuration.read_bytes() == DEMO.read_bytes()
    assert session.configuration.plan_id == read_configuration(DEMO).plan_id
    assert session.configuration.simulated
    assert session.log_folder.is_dir()
    assert not session.finished


def test_changes_reach_their_settings(tmp_path):
    changes = ["plan.table_positions=6", "simulation.table.ecc.amplitudes_arcsec=[1.0, 2.0]"]
    session = prepare_session(DEMO, tmp_path / "out", changes)
    kept = read_configuration(session.folder.configuration)
    assert kept.plan.table_positions == 6
    assert list(kept.simulation.table.ecc.amplitudes_arcsec) == [1.0, 2.0]
    assert kept.capture == read_configuration(DEMO).capture
    assert len(session.calibration.plan.steps) == 6 * 64


@pytest.mark.parametrize(
    ("change", "finding"),
    [
        ("plan.table_positions", "expected GROUP.NAME=VALUE"),
        ("plan.table_positions=1", "out of range"),
        ("plan.tabel_positions=9", "did you mean 'table_positions'"),
        ("plan.box_points.x=9", "box_points is a value"),
        ("plan.box_points=[1", "not valid YAML"),
        ("planer.max_attempts=2", "unknown group 'planer'; did you mean 'planner'"),
        ("table_positions=12", "unknown setting 'table_positions'; .*plan.table_positions"),
        ("writer.sync_interval_s=1", "unknown group 'writer'; .*recorder.writer"),
        ("plan=3", "plan: expected a group of settings, found 3"),
        ("plan=[3]", "plan: expected a group of settings"),
        ("plan=text", "plan: expected a group of settings"),
        ('cell.namespace="/cell "', "'/cell ' is not a name in ROS"),
        ("planner.max_attempts=0", "out of range"),
        ("recorder.writer.min_free_bytes=-1", "out of range"),
        ("recorder.writer.sync_interval_s=5.0", "no longer a setting: it is always 0.5 .*crash"),
        ("method=unheard", "unknown method 'unheard'"),
    ],
)
def test_a_wrong_change_is_told_before_anything_is_made(tmp_path, change, finding):
    with pytest.raises(ConfigurationError, match=finding.replace("[", r"\[")):
        prepare_session(DEMO, tmp_path / "out", [change])
    assert not (tmp_path / "out").exists()


def test_an_existing_folder_is_never_touched(tmp_path):
    (tmp_path / "out").mkdir()
    (tmp_path / "out" / "old").write_text("old")
    with pytest.raises(ConfigurationError, match="exists already"):
        prepare_session(DEMO, tmp_path / "out", [])
    prepare_session(DEMO, tmp_path / "out", [], keep_previous=True)
    assert (tmp_path / "out-1" / "old").read_text() == "old"
    assert not (tmp_path / "out" / "old").exists()
    assert free_folder_name(tmp_path / "out") == tmp_path / "out-2"


def test_what_a_run_left_before_anything_was_recorded_is_taken_again(tmp_path):
    first = prepare_session(DEMO, tmp_path / "out", [])
    (first.log_folder / "planner.log").write_text("no answer")
    first.folder.parameters.write_text("")
    first.folder.bag.mkdir()
    again = prepare_session(DEMO, tmp_path / "out", ["plan.table_positions=6"])
    assert again.configuration.plan.table_positions == 6
    assert read_configuration(again.folder.configuration).plan.table_positions == 6
    assert not list(again.log_folder.iterdir())


@pytest.mark.parametrize("data", ["bag/bag_0.mcap", "result.json", "notes.txt", "log_1/x.log"])
def test_a_folder_with_anything_else_is_kept(tmp_path, data):
    kept = prepare_session(DEMO, tmp_path / "out", []).folder.path / data
    kept.parent.mkdir(exist_ok=True)
    kept.write_text("mine")
    with pytest.raises(ConfigurationError, match="exists already"):
        prepare_session(DEMO, tmp_path / "out", [])
    assert kept.read_text() == "mine"


def test_a_folder_where_a_run_is_at_work_is_kept(tmp_path):
    session = prepare_session(DEMO, tmp_path / "out", [])
    lock = FolderLock(session.folder.path)
    with pytest.raises(BagError, match="another process"):
        prepare_session(DEMO, tmp_path / "out", [])
    lock.release()
    assert session.log_folder.is_dir()


def test_a_full_disk_is_told_before_anything_is_made(tmp_path):
    with pytest.raises(ConfigurationError, match=r"MB free, 1,000,\d+,\d+ MB are needed"):
        prepare_session(DEMO, tmp_path / "out", [f"recorder.writer.min_free_bytes={10**15}"])
    assert not (tmp_path / "out").exists()


def test_the_size_of_a_bag_follows_from_steps_turns_and_rates():
    calm = ["simulation.tracer.rate_hz=1000", "simulation.table.feedback_rate_hz=99"]
    slow = ["planner.step_s=5", "planner.turn_s=10", "simulation.temperature.rate_hz=1"]
    calibration = prepare(changed(read_configuration(DEMO), calm + slow))
    # 704 steps, the table turns to every one: 703 turns of 10 s; 1100 messages of 100 bytes a s
    assert expected_bytes(calibration) == pytest.approx((704 * 5 + 703 * 10) * 1100 * 100)
    assert expected_bytes(calibration, 352) == pytest.approx(expected_bytes(calibration) / 2)


def test_changes_do_not_alter_the_given_configuration():
    given = read_configuration(DEMO)
    before = list(given.simulation.table.ecc.amplitudes_arcsec)
    other = changed(given, ["simulation.table.ecc.amplitudes_arcsec=[9.0]"])
    assert list(given.simulation.table.ecc.amplitudes_arcsec) == before
    assert list(other.simulation.table.ecc.amplitudes_arcsec) == [9.0]


def test_the_users_domain_stays(monkeypatch):
    monkeypatch.setenv("ROS_DOMAIN_ID", "42")
    assert node_environment()["ROS_DOMAIN_ID"] == "42"
    monkeypatch.delenv("ROS_DOMAIN_ID")
    assert 1 <= int(node_environment()["ROS_DOMAIN_ID"]) <= 100
    told = node_environment()
    profiles = [told[name] for name in told if name.endswith("_DEFAULT_PROFILES_FILE")]
    assert profiles
    assert all(Path(profile).is_file() for profile in profiles)


def test_feedback_in_words():
    feedback = {"activity": "solving", "doing": Why.SOLVING, "current_std_rad": None,
                "time_left_s": None}  # fmt: skip
    assert describe_feedback(feedback) == "solving"
    assert describe_feedback(feedback | {"doing": Why.WORK}) == "waiting for a person"
    assert describe_feedback(feedback | {"doing": Why.RELEASED}) == "stopped by an emergency stop"
    feedback = {"activity": "target 3", "doing": Why.MEASURING, "current_std_rad": 4.8481368e-6,
                "time_left_s": 12.3}  # fmt: skip
    assert describe_feedback(feedback) == "target 3, U (k = 2) at most 2.0 arcsec, 12 s left"
    feedback |= {"goal_rad": 9.6962736e-6, "uncertainty_rad": None}
    words = "target 3, goal: rms of U 2.00 arcsec, known once all stations are placed, 12 s left"
    assert describe_feedback(feedback) == words
    feedback["uncertainty_rad"] = 1.45444104e-5
    assert (
        describe_feedback(feedback) == "target 3, goal: rms of U 2.00 arcsec, now 3.00, 12 s left"
    )
