"""Solving a small bag takes less time than loading what other verbs and methods need."""

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
    "rotcal_ros.simulation.cell",
    "scipy.interpolate",
    "scipy.optimize",
    "scipy.stats",
)
SCRIPT = """
import sys
from rotcal_ros.cli.main import rotcal
try:
    rotcal(["solve", sys.argv[1], "--json"])
except SystemExit as end:
    assert end.code == 0, end.code
print(*sys.modules, file=sys.stderr)
"""


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
