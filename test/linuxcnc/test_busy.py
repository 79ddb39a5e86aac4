"""Whether the real LinuxCNC is at work: the bridge changes no table meanwhile."""

import json
import subprocess

import pytest
from real_linuxcnc import HERE

from rotcal_ros.compensation.controllers import make_controller
from rotcal_ros.compensation.feed import ask_machine_activity
from rotcal_ros.compensation.linuxcnc_machine import AGENT
from rotcal_ros.foundation.machine_load import load_scaled_timeout


@pytest.mark.linuxcnc
def test_the_agent_tells_whether_the_machine_moves_or_a_program_runs(axis):
    python, agent = AGENT
    scenes = [python, str(HERE / "busy_scenes.py"), agent, str(axis.ini)]
    inside = [python, str(HERE / "by_hand.py"), str(axis.ini), *scenes]
    run = subprocess.run(
        ["unshare", "--ipc", *inside],
        capture_output=True,
        text=True,
        timeout=load_scaled_timeout(120),
        check=False,
    )
    assert run.returncode == 0, run.stderr
    found = json.loads(run.stdout.splitlines()[-1])
    assert {state: code for state, (code, _text) in found.items()} == {
        "at rest": 0, "moving": 1, "program": 1, "at rest again": 0,
        "jogging the joint": 1, "jogging the axis": 1,
    }  # fmt: skip
    assert "LinuxCNC runs a program" in found["program"][1]
    assert "LinuxCNC moves the machine" in found["jogging the joint"][1]


@pytest.mark.linuxcnc
def test_a_linuxcnc_that_does_not_run_is_not_at_work(axis):
    controller = make_controller("linuxcnc", {"machine_ini": str(axis.ini)})
    assert ask_machine_activity(controller.busy_command, 30.0) is None
    assert make_controller("linuxcnc").busy_command == ()
