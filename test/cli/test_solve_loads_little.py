"""Solving a small bag takes less time than loading what other verbs and methods need."""

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
    "rotcal_ros.planning.policy.lengths",
    "rotcal_ros.planning.tracer_design.candidates",
    "rotcal_ros.simulation.cell",
    "scipy.interpolate",
    "scipy.optimize",
    "scipy.stats",
)
BUDGET = 1.2
SCRIPT = """
import sys
from rotcal_ros.cli.main import rotcal
try:
    rotcal(["solve", sys.argv[1], "--json"])
except SystemExit as end:
    assert end.code == 0, end.code
print(*sys.modules, file=sys.stderr)
"""


def test_loading_costs_little_beside_what_nobody_can_do_without(tmp_path):
    """The import budget: all of ours together, in times of loading numpy and scipy."""
    command = [sys.executable, "-X", "importtime", "-c", SCRIPT, str(GOLDEN / "tracer" / "bag")]
    compiled = {"PYTHONPYCACHEPREFIX": str(tmp_path), "PYTHONDONTWRITEBYTECODE": ""}
    found = []
    for _ in range(4):  # the first may have to compile
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


@pytest.mark.parametrize("method", METHODS)
def test_a_bag_is_solved_with_its_own_method_alone(method):
    ran = subprocess.run(
        [sys.executable, "-c", SCRIPT, str(GOLDEN / method / "bag")],
        check=True, capture_output=True, text=True,
    )  # fmt: skip
    loaded = set(ran.stderr.splitlines()[-1].split())
    assert f"rotcal_ros.methods.{method}" in loaded
    others = {f"rotcal_ros.{room}.{m}" for room in ("methods", "catalogue") for m in METHODS}
    others -= {f"rotcal_ros.{room}.{method}" for room in ("methods", "catalogue")}
    assert not loaded & (others | set(NEVER))
