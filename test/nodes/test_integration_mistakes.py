"""The commonest mistakes of those who integrate a cell: a check finds each before a run."""

import json
import os
import re
import subprocess
import sys
from pathlib import Path

import pytest
import warm

from rotcal_ros.foundation.machine_load import load_scaled_timeout

pytest.importorskip("rclpy")
pytest.importorskip("rotcal_msgs")
pytestmark = pytest.mark.ros

HERE = Path(__file__).parent
DIRECT = """/**:
  ros__parameters:
    method: tracer_multistation
    cell: {namespace: %s, joint: rotary}
    plan: {table_positions: 6, table_step_deg: 60.0, box_centre_m: [0.0, 0.0, 0.6],
           box_size_m: [0.8, 0.8, 0.4], box_points: [2, 2, 2], tracer_m: [0.3, 0.05, 0.15]}
    topics: {%s}
"""
ADAPTER = (
    DIRECT
    + """
    table_adapter: {controller: hw/table, feedback: hw/joint_states, lower_deg: -180.0,
                    upper_deg: 360.0, interface: %s}
"""
)
TOLD = {
    "": ("", "", ""),
    "other namespace": ("joint_states", "missing", "no node publishes"),
    "other joint": ("joint", "missing", "no joint 'rotary' (cell.joint), it has arm, C"),
    "degrees": ("joint", "doubt", "turns from zero: is it in deg?"),
    "no velocity": ("", "", ""),
    "5 Hz": ("joint_states", "doubt", "comes at 5 Hz: whether the table moves or rests is known"),
    "second table": ("joint_states", "missing", "2 publishers on"),
    "lengths in mm": ("tracer_length", "missing", "is it in mm?"),
    "lengths too small": ("tracer_length", "doubt", "converted to metres twice?"),
    "lengths called mm": ("tracer_length", "doubt", "Then set topics.length_unit: m"),
    "probe in mm": ("probe_point", "missing", "is it in mm?"),
    "probe too small": ("probe_point", "doubt", "converted to metres twice?"),
    "probe called mm": ("probe_point", "doubt", "Then set topics.position_unit: m"),
    "kelvin": ("temperature", "doubt", "degrees Celsius are expected: K?"),
    "tracer's clock": ("stamps", "doubt", "tracer_length are constantly 0.40 s behind"),
    "tracer's clock far": ("stamps", "missing", "tracer_length are constantly 4.0 s behind"),
    "table's clock": ("stamps", "doubt", "0.40 s"),
    "no stamps": ("tracer_length", "missing", "stamps stand still"),
    "other type": ("tracer_length", "missing", "std_msgs/msg/String"),
    "other frame": ("probe_point", "doubt", "is stamped with the frame base"),
    "latched orders": ("table_angle", "missing", "transient local"),
    "second planner": ("table_angle", "doubt", "foreign gives orders"),
    "no beam": ("tracer_length", "missing", "has not delivered a valid message"),
    "adapter": ("", "", ""),
    "adapter, other joint": ("joint", "missing", "has no joint 'rotary' (cell.joint), it has arm"),
    "adapter, degrees": ("joint", "missing", "if these are degrees"),
    "adapter, no velocity": ("", "", ""),
    "adapter, table's clock": ("stamps", "doubt", "0.40 s"),
    "adapter, 5 Hz": ("joint_states", "doubt", "comes at 5 Hz"),
    "adapter, second table": ("joint", "missing", "2 publishers publish the joint 'rotary'"),
    "adapter, positions": ("controller", "missing", "hw/table takes positions"),
    "adapter, not active": ("controller", "missing", "no node takes"),
}
"""Mistake -> name of the line that names it, its state, and what it says; empty: there is none."""
MOVED = {
    "": ("", "", ""),
    "adapter": ("", "", ""),
    "other sign": ("sign", "missing", "a sign is wrong"),
    "clockwise": ("handedness", "missing", "it turns clockwise"),
    "late feedback": ("lag", "doubt", "s after the lengths"),
    "rests": ("rest", "missing", "reported velocity 0 while the table moved"),
    "stands still": ("sign", "missing", "the table has not moved"),
    "degrees": ("", "", ""),
}
"""The same of mistakes that only a motion shows; none is made beside feedback in degrees."""
QUICK = ("adapter, second table", "lengths called mm")
SLOW = ("adapter, other joint", "clockwise")
"""Those that `make test` and those that CI tries; the others are long."""
UNITS = {"lengths called mm": "length_unit: mm", "probe called mm": "position_unit: mm"}


def marked(mistakes):
    """Return the mistakes as parameters, each with how often it is tried."""
    quick, slow = dict.fromkeys(QUICK, ()), dict.fromkeys(SLOW, pytest.mark.slow)
    marks = dict.fromkeys(mistakes, pytest.mark.long) | slow | quick
    return [pytest.param(mistake, marks=marks[mistake], id=mistake) for mistake in mistakes]


def names_of(mistake):
    return "/" + "_".join(["with", *re.findall(r"\w+", mistake)])


def configuration_of(mistake):
    place = "/elsewhere" if mistake == "other namespace" else names_of(mistake)
    topics = UNITS.get(mistake, "")
    if mistake.startswith("adapter"):
        return ADAPTER % (place, topics, "trajectory")
    return DIRECT % (place, topics)


def checked(folder, mistake, *options):
    """Return the report of a check beside a cell with a mistake; to each question it says yes."""
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join(filter(None, sys.path))}
    file = folder / "cell.yaml"
    file.write_text(configuration_of(mistake))
    script = [sys.executable, str(HERE / "mistaken_cell.py"), mistake]
    place = ["--ros-args", "-r", f"__ns:={names_of(mistake)}"]
    cell = warm.popen([*script, *place], env=environment)
    command = [sys.executable, "-m", "rotcal_ros.cli.main", "cell", "check", str(file), "--json"]
    try:
        process = warm.popen(
            [*command, "--time", str(max(6.0, load_scaled_timeout(4.0))), *options],
            env=environment,
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
        )
        out, error = process.communicate("y\n", timeout=load_scaled_timeout(120.0))
    finally:
        cell.kill()
        cell.wait(load_scaled_timeout(10))
    assert out, error
    return json.loads(out)


def bad_lines(report, *parts):
    """Return the lines that report a mistake, but those of some parts."""
    lines = (line for line in report["lines"] if line["part"] not in parts)
    return [line for line in lines if line["state"] in ("missing", "doubt")]


@pytest.mark.parametrize("mistake", marked(TOLD))
def test_a_mistake_is_told_before_anything_moves(tmp_path, mistake):
    name, state, words = TOLD[mistake]
    report = checked(tmp_path, mistake)
    bad = bad_lines(report, "plan", "cell")
    assert not report["moved"]
    if not name:
        assert not bad
        return
    told = [line for line in bad if line["name"] == name]
    assert any(line["state"] == state and words in line["found"] for line in told), bad
    assert report["complete"] == (state == "doubt")
    assert report["todo"]


@pytest.mark.parametrize("mistake", marked(MOVED))
def test_a_small_motion_proves_what_listening_cannot(tmp_path, mistake):
    name, state, words = MOVED[mistake]
    report = checked(tmp_path, mistake, "--move")
    assert report["moved"] == (mistake != "degrees")
    proven = {line["name"]: line for line in report["lines"] if line["part"] == "motion"}
    if not report["moved"]:
        assert not proven
    elif not name:
        assert list(proven) == ["sign", "lag", "rest", "handedness"]
        assert not [line for line in proven.values() if line["state"] != "good"]
    else:
        assert proven[name]["state"] == state
        assert words in proven[name]["found"]


def test_nothing_moves_without_a_yes_or_a_configuration(tmp_path):
    command = [sys.executable, "-m", "rotcal_ros.cli.main", "cell", "check", "--move"]
    done = warm.run(command)
    assert done.returncode == 2
    assert "--move needs CONFIG" in done.stderr
