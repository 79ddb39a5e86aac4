"""A calibration without extensions: as if none was installed, the core does what is its own."""

import json
import subprocess
import sys
from pathlib import Path

import pytest

from rotcal_ros.cli.main import OWN_VERBS

BAG = Path(__file__).parents[2] / "examples" / "data" / "ball_plate_bag"
WITHOUT_EXTENSIONS = """
import importlib.metadata as metadata
import sys
from importlib.abc import MetaPathFinder
class Missing(MetaPathFinder):
    def find_spec(self, name, *_):
        if name.startswith("rotcal_ros.extensions."):
            raise ModuleNotFoundError(f"No module named {name!r}", name=name)
installed = metadata.entry_points
metadata.entry_points = lambda **asked: [
    point for point in installed(**asked) if ".extensions." not in point.value
]
sys.meta_path.insert(0, Missing())
from rotcal_ros.cli.main import main
main()
"""


def run(*arguments):
    command = [sys.executable, "-c", WITHOUT_EXTENSIONS, *map(str, arguments)]
    return subprocess.run(command, capture_output=True, text=True)


def test_only_the_verbs_of_extensions_are_missing():
    listed = run("--help").stdout.partition("Verbs:")[2].splitlines()
    verbs = [line.split()[0] for line in listed if line[:2] == "  " and line[2:3].strip()]
    assert verbs[: len(OWN_VERBS)] == list(OWN_VERBS)
    missing = run("reprocess", BAG)
    assert (missing.returncode, "no verb 'reprocess'" in missing.stderr) == (2, True)


@pytest.mark.slow
def test_a_bag_is_solved_propagated_and_reported(tmp_path):
    solved = run("solve", BAG, "--json")
    assert json.loads(solved.stdout)["verdict"] == "ok", solved.stderr
    trials = run("uncertainty", BAG, "--trials", 100)
    assert trials.returncode == 0, trials.stderr
    report = run("report", BAG, "-o", tmp_path / "report.html")
    assert report.returncode == 0, report.stderr
