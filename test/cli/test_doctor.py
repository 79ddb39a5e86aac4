"""rotcal doctor: it must say what is wrong, and what to do."""

import json
import shutil
from collections import namedtuple
from importlib import metadata, util

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


def test_a_missing_compiler(monkeypatch):
    monkeypatch.setenv("CXX", "no-such-compiler")
    check = doctor.compiler()
    assert not check.ok
    assert "apt install g++" in check.advice


def test_a_missing_package(monkeypatch):
    needed = ["numpy", "no-such-package", 'no-other-package; extra == "many"']
    monkeypatch.setattr(metadata, "requires", lambda _: needed)
    check = doctor.packages()
    assert not check.ok
    assert check.found == "missing no-such-package"


def test_a_folder_that_cannot_be_written():
    check = doctor.writable(doctor.Path("/proc/rotcal"))
    assert not check.ok
    assert check.found.startswith("/proc: ")


def test_a_full_disk(monkeypatch, tmp_path):
    usage = namedtuple("usage", "total used free")(10, 9, 1_000_000)
    monkeypatch.setattr(shutil, "disk_usage", lambda _: usage)
    assert not doctor.space(tmp_path).ok


@pytest.mark.ros
def test_a_message_comes_back():
    check = doctor.loopback()
    assert check.ok, check.found
    assert "came back" in check.found
