"""`rotcal cell check`: three cells and an empty domain looked at, and what a person is told."""

import json
import os
import shutil
import signal
import struct
import subprocess
import sys
import time
from pathlib import Path

import pytest
import warm

from rotcal_ros.foundation.machine_load import load_scaled_timeout
from rotcal_ros.sessions.domains import domains_in_use, free_domain

pytest.importorskip("rclpy")
pytest.importorskip("rotcal_msgs")

HERE = Path(__file__).parent
OWN = HERE.parents[1] / "examples" / "own_cell"
CONFIGURATION = OWN / "own_cell.yaml"
DEADLINE_S = 90.0


def checking(*options, **environment):
    return warm.popen(
        [sys.executable, "-m", "rotcal_ros.cli.main", "cell", "check", *map(str, options)],
        stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True,
        env={**os.environ, **environment},
    )  # fmt: skip


def answer(process):
    out, error = process.communicate(timeout=load_scaled_timeout(DEADLINE_S))
    assert "Traceback" not in error
    return process.returncode, out, error


@pytest.fixture
def cells(tmp_path, monkeypatch):
    """The template in /cell, one with everything wrong in /lab."""
    monkeypatch.setenv("PYTHONPATH", os.pathsep.join(filter(None, sys.path)))
    scripts = {"/cell": "my_cell/own_cell.py", "/lab": HERE / "wrong_cell.py"}
    shutil.copytree(OWN, tmp_path / "my_cell")
    monkeypatch.chdir(tmp_path)
    running = [
        warm.popen([sys.executable, script, "--ros-args", "-r", f"__ns:={place}"])
        for place, script in scripts.items()
    ]
    yield
    for process in running:
        process.kill()  # nothing of theirs is to be kept
    for process in running:
        process.wait(load_scaled_timeout(10))


@pytest.mark.slow
@pytest.mark.ros
def test_every_thing_of_a_cell_is_named(cells):
    good = checking("my_cell/own_cell.yaml", "--json", "--time", 4)
    wrong = checking(CONFIGURATION, "--json", "--time", 4, "--namespace", "/lab")
    astray = checking(CONFIGURATION, "--json", "--time", 4, "--namespace", "/else")
    alone = checking(CONFIGURATION, "--time", 3, ROS_DOMAIN_ID=str(free_domain()))
    _good(*answer(good))
    _wrong(*answer(wrong))
    _astray(*answer(astray))
    code, out, _ = answer(alone)
    assert code == 1
    assert "no node in domain" in out
    assert f"{os.environ['ROS_DOMAIN_ID']}" in out  # where they are
    assert "ROS_AUTOMATIC_DISCOVERY_RANGE" in out


def _lines(out):
    return {(line["part"], line["name"]): line for line in json.loads(out)["lines"]}


def _good(code, out, error):
    lines = _lines(out)
    assert code == 0, (error, lines)
    assert {lines[key]["state"] for key in lines if key[0] not in ("plan", "cell")} <= {
        "good", "note"
    }  # fmt: skip
    assert 50 < lines["table", "joint_states"]["rate_hz"] < 150
    assert 250 < lines["tracer", "tracer_length"]["rate_hz"] < 750
    assert abs(lines["tracer", "tracer_length"]["stamp_offset_s"]) < 0.5
    assert "own_cell obeys it" in lines["table", "table_angle"]["found"]
    assert "rotary at 0 rad" in lines["table", "joint"]["found"]
    assert "table to 0°" in lines["plan", "first order"]["found"]
    assert "48 steps: 6 table angles, 8 targets" in lines["plan", "steps"]["found"]


def _wrong(code, out, _error):
    lines = _lines(out)
    assert code == 1
    states = {name: line["state"] for (_, name), line in lines.items()}
    assert states["joint"] == states["tracer_length"] == states["stamps"] == "missing"
    assert states["temperature"] == states["probe_point"] == "doubt"
    frames = lines["frames", "probe_point"]["found"]
    assert "probe_point is stamped with the frame base" in frames
    assert "no joint 'rotary' (cell.joint), it has C" in lines["table", "joint"]["found"]
    assert "is it in mm?" in lines["tracer", "tracer_length"]["found"]
    assert "degrees Celsius are expected: K?" in lines["air", "temperature"]["found"]
    assert "probe_point are constantly 4.0 s behind" in lines["clocks", "stamps"]["found"]
    assert lines["probe", "probe_point"]["stamp_offset_s"] == pytest.approx(-4.0, abs=0.3)
    assert "base in probe_point" in lines["frames", "headers"]["found"]
    assert "no node obeys /lab/probe_target" in lines["probe", "probe_target"]["found"]
    found = [line["found"] for line in json.loads(out)["lines"] if line["name"] == "table_angle"]
    assert "transient local" in found[0]
    assert "foreign also gives orders on /lab/table_angle" in found[1]


def _astray(code, out, _error):
    report = json.loads(out)
    assert code == 1
    assert any(
        "--namespace /cell" in todo or "--namespace /lab" in todo for todo in report["todo"]
    )
    assert "no node publishes /else/joint_states" in _lines(out)["table", "joint_states"]["found"]


@pytest.mark.ros
def test_ctrl_c_ends_it_at_once_and_leaves_nothing_behind():
    process = checking(CONFIGURATION, "--time", 600)
    domain = int(os.environ["ROS_DOMAIN_ID"])
    deadline = time.monotonic() + load_scaled_timeout(DEADLINE_S)
    while domain not in domains_in_use() and time.monotonic() < deadline:
        time.sleep(0.05)
    process.send_signal(signal.SIGINT)
    code, _, error = answer(process)
    assert code == 130
    assert "interrupted" in error
    assert domain not in domains_in_use()


def test_a_header_is_read_in_both_byte_orders_and_where_there_is_none():
    from rotcal_ros.nodes.check.snapshot import read_header

    for order, mark in (("<", 1), (">", 0)):
        data = bytes([0, mark, 0, 0]) + struct.pack(f"{order}iII", 12, 34, 5) + b"base\0rest"
        assert read_header(data) == (12_000_000_034, "base")
    assert read_header(b"") == read_header(b"\0\1\0\0abc") == (0, "")


@pytest.mark.slow
def test_a_configuration_that_cannot_be_used_is_an_error_before_anybody_listens(tmp_path):
    broken = tmp_path / "cell.yaml"
    broken.write_text("/**: {ros__parameters: {method: tracer_multistation, cel: {}}}")
    code, _, error = answer(checking(broken))
    assert code == 2
    assert "unknown group 'cel'; do you mean 'cell'?" in error or "unknown group 'cel'" in error
