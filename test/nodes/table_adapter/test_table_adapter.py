"""The adapter to ros2_control beside a controller of somebody else, over DDS."""

import json
import os
import sys
from pathlib import Path

import numpy as np
import pytest
from live_cell import SUITE, wait_until
from lone_adapters import expect
from test_slow_nodes import stand_still

from rotcal_ros.foundation.results import Result
from rotcal_ros.methods.configuration import parse_configuration
from rotcal_ros.methods.simulation.table import true_deviations
from rotcal_ros.recordings.replay import read_recording

pytest.importorskip("rclpy")
pytest.importorskip("rotcal_msgs")


pytestmark = pytest.mark.ros

MACHINE = Path(__file__).parents[2] / "nodes" / "joint_controller.py"
CHANGES = (
    "cell.joint=rotary",
    "table_adapter.controller=/drive",
    "table_adapter.speed_deg_s=60.0",
    "table_adapter.acceleration_deg_s2=3600.0",
    "simulation.table.external=true",
    "simulation.time_scale=1.0",
    "simulation.probe.speed_m_s=20.0",
    "simulation.probe.acceleration_m_s2=1000.0",
    "simulation.faults.blocked_targets=[]",
    "capture.settle_time_s=0.05",
    "capture.step_timeout_s=10.0",
    "plan.table_positions=4",
    "plan.box_points=[2, 2, 2]",
    "plan.order=targets_per_station",
)


@pytest.fixture
def adapted(cell):
    """Return a function that makes a cell with its machine, and starts the nodes named."""

    def make(*changes, wrong="", since=0, nodes=("table_adapter",)):
        live = cell(*CHANGES, *changes)
        command = [sys.executable, str(MACHINE), wrong, str(since), "--ros-args", "-r",
                   "__ns:=/cell"]  # fmt: skip
        live.processes.start("machine", command)
        live.start(*nodes)
        return live

    return make


@pytest.mark.long  # test_two_cells.py has the trajectory
@pytest.mark.parametrize("interface", ["trajectory", "positions"])
def test_a_calibration_through_the_controller_finds_the_truth(adapted, interface):
    live = adapted(
        f"table_adapter.interface={interface}", nodes=(*SUITE, "simulated_cell", "table_adapter")
    )
    outcome = live.client().result()
    assert outcome["error_code"] == 0, outcome["error_msg"]
    assert outcome["n_used"] == 32
    result = Result.from_dict(json.loads((live.session / "result.json").read_text()))
    settings = parse_configuration(live.file.read_text()).simulation
    truth = true_deviations(settings.table, result.angles)["ECC"]
    error = result.deviations["ECC"] - truth
    assert np.all(np.abs(error - error[0]) <= 5 * result.std["ECC"] + 1e-12)
    recording = read_recording(live.bag)
    assert recording.same_as_recorded
    assert recording.verdicts[0].topics["/cell/joint_states"].messages > 100


@pytest.mark.long  # test_slow_nodes.py stops the suite's nodes
@pytest.mark.parametrize("name", ["table_adapter", "machine"])
def test_an_adapter_or_a_machine_that_stands_still_for_a_while_ends_nothing(adapted, name):
    live = adapted(nodes=(*SUITE, "simulated_cell", "table_adapter"))
    client = live.client()
    client.wait_for_step(6)
    stand_still(live, name)
    outcome = client.result()
    assert outcome["error_code"] == 0, outcome["error_msg"]
    assert outcome["n_used"] == 32
    recording = read_recording(live.bag)
    assert recording.same_as_recorded
    assert {o.run for o in recording.observations} == {0}


WRONG = {
    "degrees": ("30", "rad were ordered: its feedback is in degrees"),
    "rejects": ("30", "joint 'rotary' of /drive: the table has not moved for"),
    "falls silent": ("30", "joint 'rotary' of /drive: no feedback of the table for"),
    "other name": ("30", "no joint 'rotary' in /joint_states, which has arm, table"),
}  # fmt: skip
"""What a machine does that is sent trajectories by topic, to which angles, what is said then."""


def test_what_the_controller_does_wrong_is_named(tmp_path, monkeypatch):
    monkeypatch.setenv("PYTHONPATH", os.pathsep.join(filter(None, sys.path)))
    expect(tmp_path, "joint_controller.py", WRONG, {})


@pytest.mark.long  # test_dme_live.py tells a person, too
def test_the_person_at_a_calibration_is_told_too(adapted):
    live = adapted("table_adapter.silence_s=0.5", "capture.step_timeout_s=5.0", wrong="stalls",
                   since=1, nodes=(*SUITE, "simulated_cell", "table_adapter"))  # fmt: skip
    client = live.client()
    said = "table_adapter: joint 'rotary' of /drive: the table stopped at"
    told = client.wait_for("warning", where=lambda event: event["text"].startswith(said))
    assert "arcsec from where it was sent" in told["text"]


def test_without_a_joint_it_does_not_start(cell):
    live = cell("cell.joint=''", "table_adapter.controller=/drive")
    live.start("table_adapter")
    process = live.processes.children["table_adapter"]
    wait_until(lambda: process.poll() is not None, "the adapter ends")
    assert "cell.joint is not set" in live.log("table_adapter")
