"""The folder and the configuration of a run; nothing here starts a node."""

from pathlib import Path

import pytest

from rotcal_ros.catalogue.configuration import changed, read_configuration
from rotcal_ros.errors import ConfigurationError
from rotcal_ros.sessions.display import describe
from rotcal_ros.sessions.environment import node_environment
from rotcal_ros.sessions.session import free_name, prepare_session

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
        ("plan.box_points=[1", "not a YAML value"),
        ("planer.max_attempts=2", "unknown group 'planer'"),
        ("planner.max_attempts=0", "out of range"),
        ("recorder.writer.sync_interval_s=5.0", "out of range"),
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
    assert free_name(tmp_path / "out") == tmp_path / "out-2"


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
    assert Path(node_environment()["FASTDDS_DEFAULT_PROFILES_FILE"]).is_file()


def test_feedback_in_words():
    feedback = {"activity": "solving", "current_std_rad": None, "time_left_s": None}
    assert describe(feedback) == "solving"
    feedback = {"activity": "target 3", "current_std_rad": 4.8481368e-6, "time_left_s": 12.3}
    assert describe(feedback) == "target 3, std 1.00 arcsec, 12 s left"
    feedback |= {"goal_rad": 9.6962736e-6, "uncertainty_rad": None}
    words = "target 3, goal U 2.00 arcsec, known once all stations are placed, 12 s left"
    assert describe(feedback) == words
    feedback["uncertainty_rad"] = 1.45444104e-5
    assert describe(feedback) == "target 3, U 3.00 of 2.00 arcsec, 12 s left"
