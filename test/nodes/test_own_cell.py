"""The template for machines of others, as its README starts it, against its own truth."""

import json
import os
import runpy
import sys
from pathlib import Path

import numpy as np
import pytest
import warm
from known_truth import require_truth

from rotcal_ros.api.reading import read_result
from rotcal_ros.foundation.machine_load import load_scaled_timeout

pytest.importorskip("rclpy")
pytest.importorskip("rotcal_msgs")
pytestmark = pytest.mark.ros

OWN = Path(__file__).parents[2] / "examples" / "own_cell"
SCRIPT = OWN / "own_cell.py"
DEADLINE_S = 180.0
BY_CHANCE = "appear to be off together"
"""What a few of 100 sound runs are suspected of: its noise goes by the clock."""


def test_the_readme_s_commands_find_the_error_of_its_table(tmp_path, monkeypatch):
    monkeypatch.setenv("PYTHONPATH", os.pathsep.join(filter(None, sys.path)))
    log = (tmp_path / "own.log").open("w")
    own = warm.popen(
        [sys.executable, SCRIPT, "--ros-args", "-r", "__ns:=/cell"], stdout=log, stderr=log
    )
    try:
        done = warm.run(
            [sys.executable, "-m", "rotcal_ros.cli.main", "run", str(OWN / "own_cell.yaml"),
             "--output", str(tmp_path / "out"), "--no-page", "--json"],
            timeout=load_scaled_timeout(DEADLINE_S),
        )  # fmt: skip
    finally:
        own.terminate()
        own.wait(load_scaled_timeout(10))
    assert done.stdout, (done.returncode, done.stderr)
    outcome = json.loads(done.stdout)
    result = read_result(tmp_path / "out" / "result.json")
    by_chance = any(BY_CHANCE in warning for warning in result.warnings)
    expected = (1, "suspect") if by_chance else (0, "ok")
    assert (done.returncode, outcome["verdict"]) == expected, (
        done.stdout + done.stderr + (tmp_path / "own.log").read_text()
    )
    assert not outcome["verdict_line"].count("SIMULATED")
    error_rad = runpy.run_path(str(SCRIPT))["error_rad"]
    truth = np.array([error_rad(angle) for angle in result.angles])
    assert np.ptp(truth) > 4e-5
    require_truth(result, {"ECC": truth - truth[0]})


def test_the_template_is_short():
    assert len(SCRIPT.read_text().splitlines()) < 150
