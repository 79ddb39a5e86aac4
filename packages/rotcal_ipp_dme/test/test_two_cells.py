"""Two cells of others in one domain, calibrated at the same time, each against its own truth.

On the left a table behind a controller as those of ros2_control, with the tracer of
examples/own_cell; on the right a measuring machine behind I++ DME over TCP. Nothing simulates a
cell by topics here.
"""

import json
import os
import re
import runpy
import sys
from pathlib import Path

import numpy as np
import pytest
from known_truth import require_injected_truth, require_truth
from live_cell import DEADLINE_S, wait_until

from rotcal_ros.api.reading import read_result
from rotcal_ros.foundation.components import COMPONENTS
from rotcal_ros.foundation.machine_load import load_scaled_timeout
from rotcal_ros.methods import prepare
from rotcal_ros.methods.configuration import read_configuration
from rotcal_ros.recordings.replay import read_recording
from rotcal_ros.sessions.domains import free_domain
from rotcal_ros.sessions.processes import Processes, node_environment

pytest.importorskip("rclpy")
pytest.importorskip("rotcal_msgs")
pytestmark = pytest.mark.ros

ROOT = Path(__file__).parents[3]
NODES = ROOT / "test" / "nodes"
OWN = ROOT / "examples" / "own_cell"
RIGHT = Path(__file__).parents[1] / "config" / "ball_plate_dme.yaml"
POSITIONS = 6
LEFT = {
    "cell.namespace": "/left",
    "table_adapter.controller": "/drive",
    "table_adapter.speed_deg_s": 180.0,
    "table_adapter.acceleration_deg_s2": 3600.0,
    "plan.table_step_deg": 360.0 / POSITIONS,
    "plan.table_positions": POSITIONS,
    "capture.step_timeout_s": 20.0,
    "capture.window_samples": 20,
    "solver.length_std_m": 4.5e-8,
    "solver.target_std_m": 1.0e-8,
}


@pytest.fixture
def cells(tmp_path, monkeypatch):
    """Return the processes of one domain; all of them end with the test."""
    monkeypatch.setenv("PYTHONPATH", os.pathsep.join(filter(None, sys.path)))
    monkeypatch.setenv("ROS_DOMAIN_ID", str(free_domain()))
    environment = node_environment()
    for name in ("ROTCAL_SUPERVISOR", "ROTCAL_SESSION"):  # each rotcal run has its own
        environment.pop(name)
    with Processes(tmp_path, environment) as processes:
        yield processes


def own_process(name, *more):
    return [sys.executable, str(NODES / name), *more, "--ros-args", "-r", "__ns:=/left"]


def rotcal(*arguments):
    return [sys.executable, "-m", "rotcal_ros.cli.main", *map(str, arguments)]


def run(configuration, folder, changes):
    changed = [part for name, value in changes.items() for part in ("--set", f"{name}={value}")]
    return rotcal(
        "run", configuration, "--output", folder, "--json", "--no-report", "--no-page", *changed
    )


def truth_of_the_own_cell(result):
    """Return ECC of the own cell's table, counted from the first angle."""
    error_rad = runpy.run_path(str(OWN / "own_cell.py"))["error_rad"]
    truth = np.array([error_rad(angle) for angle in result.angles])
    assert np.ptp(truth) > 4e-5
    return {"ECC": truth - truth[0]}


def outcome_of(folder, name, steps):
    """Return the result of a cell, which has heard of itself alone and left no step out."""
    text = (folder / f"{name}.log").read_text()
    outcome = json.loads(text[text.index("\n{") : text.rindex("}") + 1])
    told = (outcome["verdict"], outcome["n_used"], outcome["skipped_steps"])
    assert told == ("ok", steps, []), text
    assert outcome["n_rejected"] <= load_scaled_timeout(steps // 20), text
    recording = read_recording(folder / f"out_{name}" / "bag")
    assert recording.same_as_recorded
    topics = [topic.split("/")[1] for topic in recording.verdicts[0].topics]
    assert set(topics) & {"left", "right"} == {name}
    return read_result(folder / f"out_{name}" / "result.json")


@pytest.mark.long  # CI runs it on the other distribution: make test-kilted
def test_two_cells_in_one_domain_find_their_own_truth(cells, tmp_path):
    cells.start("drive", own_process("joint_controller.py", "", "0"))
    cells.start("tracer", [*own_process("own_tracer.py"), "-r", "joint_states:=own_table"])
    cells.start("server", rotcal("dme", "serve", RIGHT, "--port", "0"))
    wait_until(lambda: "I++ DME" in cells.log_tail("server"), "the DME server listens")
    port = re.search(r"127\.0\.0\.1:(\d+)", cells.log_tail("server"))[1]
    cells.start("left", run(OWN / "own_cell.yaml", tmp_path / "out_left", LEFT))
    wait_until(
        lambda: f"{8 * POSITIONS} steps" in cells.log_tail("left"), "the left cell measures"
    )
    changes = {"cell.namespace": "/right", "dme.port": port}
    cells.start("right", run(RIGHT, tmp_path / "out_right", changes))
    for name in ("left", "right"):
        assert cells.children[name].wait(load_scaled_timeout(2 * DEADLINE_S)) == 0, cells.log_tail(
            name, 50
        )

    left = outcome_of(tmp_path, "left", 8 * POSITIONS)
    right = outcome_of(tmp_path, "right", 78)
    calibration = prepare(read_configuration(tmp_path / "out_right" / "configuration.yaml"))
    assert set(right.components) == set(COMPONENTS)
    require_truth(left, truth_of_the_own_cell(left))
    require_injected_truth(calibration, right)
