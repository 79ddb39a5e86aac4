"""Solving a small bag, or showing what can be set, loads nothing that only others need."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

GOLDEN = Path(__file__).parents[1] / "golden"
METHODS = ("tracer", "ball_plate", "plane_mirror")
NEVER = (
    "matplotlib",
    "rich",
    "rosbags.rosbag2",
    "rotcal_ros.compensation.controller",
    "rotcal_ros.methods.tracer.policy.experiment",
    "rotcal_ros.methods.tracer.policy.information",
    "rotcal_ros.methods.simulation.cell",
    "scipy.interpolate",
    "scipy.optimize",
    "scipy.stats",
)
BUDGET = 1.2
SCRIPT = """
import sys
from rotcal_ros.cli.main import rotcal
try:
    rotcal(sys.argv[1:])
except SystemExit as end:
    assert end.code == 0, end.code
print(*sys.modules, file=sys.stderr)
"""


def solve(method):
    return "solve", str(GOLDEN / method / "bag"), "--json"


def loaded_by(*arguments):
    """Return the modules that are loaded when a verb has ended well."""
    ran = subprocess.run(
        [sys.executable, "-c", SCRIPT, *arguments], check=True, capture_output=True, text=True
    )
    return set(ran.stderr.splitlines()[-1].split())


@pytest.mark.slow
def test_loading_costs_little_beside_what_nobody_can_do_without(tmp_path):
    """The import budget: all of ours together, in times of loading numpy and scipy."""
    command = [sys.executable, "-X", "importtime", "-c", SCRIPT, *solve("tracer")]
    compiled = {"PYTHONPYCACHEPREFIX": str(tmp_path), "PYTHONDONTWRITEBYTECODE": ""}
    found = []
    for _ in range(3):  # the first may have to compile
        ran = subprocess.run(
            command, check=True, capture_output=True, text=True, env={**os.environ, **compiled}
        )
        spent = dict.fromkeys(("rotcal_ros", "numpy", "scipy"), 0)
        for line in ran.stderr.splitlines():
            own, _, name = line.removeprefix("import time:").partition("|")
            package = name.rpartition("|")[2].strip().partition(".")[0]
            if line.startswith("import time:") and package in spent:
                spent[package] += int(own)
        found.append(spent["rotcal_ros"] / (spent["numpy"] + spent["scipy"]))
    assert min(found) < BUDGET, found


@pytest.mark.slow
@pytest.mark.parametrize("method", METHODS)
def test_a_bag_is_solved_with_its_own_method_alone(method):
    loaded = loaded_by(*solve(method))
    assert f"rotcal_ros.methods.{method}.solver" in loaded
    others = {f"rotcal_ros.methods.{m}.solver" for m in METHODS if m != method}
    assert not loaded & (others | set(NEVER))


@pytest.mark.parametrize("method", [(), ("tracer_six",)])
def test_what_can_be_set_is_told_without_what_plans_captures_and_solves(method):
    loaded = loaded_by("settings", *method, "--json")
    assert "rotcal_ros.methods.settings_reference" in loaded
    solvers = {f"rotcal_ros.methods.{m}.solver" for m in (*METHODS, "tracer_six")}
    entries = {f"rotcal_ros.methods.{m}.method" for m in (*METHODS, "tracer_six")}
    never = {"rotcal_ros.methods.calibration", "rotcal_ros.capture.capture", "scipy"}
    assert not loaded & (solvers | entries | never | set(NEVER))
