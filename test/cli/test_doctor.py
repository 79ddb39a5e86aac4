"""rotcal doctor: it must say what is wrong, and what to do."""

import json
import re
import shutil
import subprocess
from collections import namedtuple
from importlib import metadata, util
from types import SimpleNamespace

import pytest
from click.testing import CliRunner

from rotcal_ros.cli import doctor, main


def run(*arguments):
    return CliRunner().invoke(main.rotcal, ["doctor", *arguments])


@pytest.fixture
def no_ros(monkeypatch):
    """Hide ROS, as on a laptop that only solves bags."""
    find = util.find_spec
    hidden = {"rclpy", "rotcal_msgs"}
    monkeypatch.setattr(util, "find_spec", lambda name: None if name in hidden else find(name))


def test_without_ros_it_says_what_that_means(no_ros, tmp_path):
    result = run("--output", str(tmp_path))
    assert result.exit_code == 1
    bad = [line for line in result.stdout.splitlines() if line.startswith("✗")]
    assert [line.split(":")[0] for line in bad] == ["✗ ROS 2", "✗ rotcal_msgs"]
    assert all("needed for live calibration only" in line for line in bad)


def test_json_holds_every_check(no_ros, tmp_path):
    data = json.loads(run("--json", "--output", str(tmp_path)).stdout)
    assert data["ok"] is False
    assert {c["name"]: c["ok"] for c in data["checks"]} == {
        "Python": True,
        "C and C++ compiler": True,
        "Python packages": True,
        "ROS 2": False,
        "rotcal_msgs": False,
        "Output folder": True,
        "Disk space": True,
    }


MACHINE = """[TRAJ]
ANGULAR_UNITS = degree
[KINS]
KINEMATICS = trivkins coordinates=A
[JOINT_0]
TYPE = ANGULAR
MIN_LIMIT = 0
MAX_LIMIT = 360
"""


def test_the_tables_of_a_linuxcnc(tmp_path):
    path = tmp_path / "machine.ini"
    path.write_text(MACHINE)
    (check,) = doctor.check_linuxcnc_tables(path)
    assert (check.ok, check.found) == (False, f"{path} names none")
    path.write_text(MACHINE + "COMP_FILE = a.comp\nCOMP_FILE_TYPE = 1\n")
    (tmp_path / "a.comp").write_text("0 0 0\n180 0.01 0.01\n360 0 0\n")
    (check,) = doctor.check_linuxcnc_tables(path)
    assert (check.ok, check.found) == (True, "[JOINT_0] a.comp, type 1")
    path.write_text(path.read_text().replace("TYPE = 1", "TYPE = 0"))
    (check,) = doctor.check_linuxcnc_tables(path)
    assert not check.ok
    assert "read as type 0 the largest trim is 360 deg" in check.found
    assert "rotcal export --machine-ini" in check.advice
    (check,) = doctor.check_linuxcnc_tables(tmp_path / "none.ini")
    assert "cannot read the machine's ini file" in check.found


def test_a_missing_compiler(monkeypatch):
    monkeypatch.setenv("CXX", "no-such-compiler")
    check = doctor.check_compiler()
    assert not check.ok
    assert "apt install g++" in check.advice


def test_a_missing_package(monkeypatch):
    needed = ["numpy", "no-such-package", 'no-other-package; extra == "many"']
    monkeypatch.setattr(metadata, "requires", lambda _: needed)
    check = doctor.check_packages()
    assert not check.ok
    assert check.found == "missing no-such-package"


def test_a_folder_that_cannot_be_written():
    check = doctor.check_writable(doctor.Path("/proc/rotcal"))
    assert not check.ok
    assert check.found.startswith("/proc: ")


def test_a_full_disk(monkeypatch, tmp_path):
    usage = namedtuple("usage", "total used free")(10, 9, 1_000_000)
    monkeypatch.setattr(shutil, "disk_usage", lambda _: usage)
    assert not doctor.check_disk_space(tmp_path).ok


@pytest.mark.parametrize(
    ("rclpy", "sourced", "ok", "found"),
    [
        ("7.1.5", "", True, "Jazzy, rclpy 7.1.5"),
        ("9.1.2", "kilted", True, "Kilted, rclpy 9.1.2"),
        ("9.1.2", "jazzy", False, "Kilted, rclpy 9.1.2, but ROS_DISTRO=jazzy"),
        ("3.3.16", "humble", False, "Humble, rclpy 3.3.16"),
        ("10.0.10", "lyrical", False, "Lyrical, rclpy 10.0.10"),
        ("11.0.0", "rolling", False, "unknown distribution, rclpy 11.0.0"),
    ],
)
def test_the_distribution_is_what_rclpy_says(monkeypatch, rclpy, sourced, ok, found):
    monkeypatch.setattr(util, "find_spec", lambda _: True)
    monkeypatch.setattr(doctor, "rclpy_version", lambda: rclpy)
    monkeypatch.setenv("ROS_DISTRO", sourced)
    check = doctor.check_ros()
    assert (check.ok, check.found) == (ok, found)


@pytest.mark.ros
def test_the_nodes_start():
    check = doctor.check_nodes()
    assert check.ok, check.found
    assert check.found.startswith("planner, capture, solver, recorder started")


@pytest.mark.ros
def test_a_node_that_cannot_start_is_seen(monkeypatch):
    start_trial = pytest.importorskip("rotcal_ros.nodes.check.start_trial")
    monkeypatch.setattr(start_trial, "NODES", ("no_such_node",))
    with pytest.raises(start_trial.NodeError) as wrong:
        start_trial.start_and_end_all_nodes()
    assert str(wrong.value).startswith("no_such_node ended with 1: ")
    assert "No module named 'rotcal_ros.nodes.no_such_node'" in str(wrong.value)


@pytest.mark.ros
def test_on_a_busy_machine_a_node_is_given_more_time_to_end(monkeypatch):
    start_trial = pytest.importorskip("rotcal_ros.nodes.check.start_trial")
    monkeypatch.setattr(start_trial, "load_scaled_timeout", lambda seconds: 4.0 * seconds)
    waited = []

    class Process:
        def wait(self, timeout):
            waited.append(timeout)
            raise subprocess.TimeoutExpired("planner", timeout)

    monkeypatch.setattr(start_trial.subprocess, "Popen", lambda *_, **__: Process())
    assert str(start_trial.TrialNode("planner").end()) == "planner did not end within 20 s"
    assert waited == [20.0]


@pytest.mark.ros
def test_the_rate_is_tried_with_all_that_recorder_and_capture_do(tmp_path):
    check = doctor.check_rate(tmp_path / "not made yet")
    assert re.match(r"\d+ of 5000 readings in 5 s came and were written, the longest", check.found)
    assert re.search(r"; load \d+\.\d on \d+ cores?$", check.found)
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(
    ("came", "written", "longest_s", "error", "ok"),
    [
        (5000, 5000, 0.04, "", True),
        (4999, 5000, 0.04, "", False),
        (5000, 4000, 0.04, "cannot write", False),
        (5000, 5000, 3.0, "", False),
    ],
)
def test_a_reading_that_is_missing_or_a_long_wait_is_told(came, written, longest_s, error, ok):
    rate_trial = pytest.importorskip("rotcal_ros.nodes.check.rate_trial")
    recording = SimpleNamespace(messages=written, finished=True, error=error)
    found, text = rate_trial.rate_verdict(5000, came, recording, longest_s)
    assert found is ok
    assert text.startswith(f"{min(came, written)} of 5000 readings")
    assert f"the longest wait was {1000 * longest_s:.0f} ms" in text
    assert error in text


@pytest.mark.ros
def test_a_message_comes_back():
    check = doctor.check_loopback()
    assert check.ok, check.found
    assert "came back" in check.found
