"""A controller from a package of somebody else, installed as they would install it."""

import json
import os
import shutil
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from compensation_examples import TAU, even, result_of, wavy
from warm import WarmServer

from rotcal_ros.foundation.units import ARCSEC

pytestmark = pytest.mark.slow

EXAMPLE = Path(__file__).parents[2] / "examples" / "own_controller"
BRIDGE = """
from rotcal_ros.compensation.bridge_settings import BridgeSettings
from rotcal_ros.foundation.settings import load
import sys
print(load(BridgeSettings, {"controller": "mydrive", "options": sys.argv[1:]}, "bridge").options)
"""


@pytest.fixture(scope="module")
def environment(tmp_path_factory):
    """The environment of a process that has the example installed; pip needs no network."""
    folder = tmp_path_factory.mktemp("own")
    source, target = folder / "source", folder / "installed"
    shutil.copytree(EXAMPLE, source, ignore=shutil.ignore_patterns("build", "*.egg-info"))
    offline = ["--no-deps", "--no-build-isolation", "--no-index", "--quiet"]
    subprocess.run(
        [sys.executable, "-m", "pip", "install", *offline, "--target", str(target), str(source)],
        check=True,
    )
    paths = [str(target), *filter(None, [os.environ.get("PYTHONPATH")])]
    return {**os.environ, "PYTHONPATH": os.pathsep.join(paths)}


def python(environment, *words):
    command = [sys.executable, *map(str, words)]
    return subprocess.run(command, env=environment, capture_output=True, text=True, check=False)


@pytest.fixture(scope="module")
def warm_own(environment):
    process = WarmServer(environment)
    yield process
    process.close()


@pytest.fixture
def export(warm_own, tmp_path):
    result = tmp_path / "result.json"
    result.write_text(result_of(even(72), wavy(even(72))).to_json())

    def run(*words):
        words = ("export", result, "--replace", "--spacing", 5, "--out", tmp_path / "out", *words)
        return warm_own.run("rotcal", *words)

    return run


def test_its_files_are_written_and_take_the_deviation_away(export, tmp_path):
    """The rule of the drive is worked out here from the text of the file alone."""
    run = export("--to", "mydrive", "--axis", "B", "--json")
    assert run.returncode == 0, run.stderr
    title, count, *lines = (tmp_path / "out" / "b_mydrive.mdt").read_text().splitlines()
    assert (title, count) == ("MYDRIVE ERROR TABLE B", "ROWS 73")
    rows = np.loadtxt(lines)
    np.testing.assert_array_equal(rows[:, 0], np.arange(73) * 5.0)
    command = np.linspace(0.0, TAU, 2000)
    moved = command - np.interp(np.rad2deg(command), *rows[:, :2].T) * 0.1 * ARCSEC
    left = moved + wavy(moved) - wavy(0.0) - command
    stated = json.loads(run.stdout)["provenance"]["residual_arcsec"]["stated"]
    assert stated < 0.25
    assert np.max(np.abs(left)) < stated * ARCSEC
    assert np.max(np.abs(wavy(command) - wavy(0.0))) > 10.0 * ARCSEC


@pytest.mark.parametrize(
    ("words", "error"),
    [
        (["--to", "mydriv"], "unknown controller 'mydriv'; did you mean 'mydrive'?"),
        (["--to", "mydrive", "--set", "max_row=9"], "mydrive: unknown setting 'max_row'; did you"),
        (
            ["--to", "mydrive", "--set", "max_rows=9"],
            "mydrive: rows: 73, and the controller holds 9",
        ),
        (["--to", "mydrive", "--set", "max_rows=999"], "999 is out of range 3 to 400"),
    ],
)
def test_its_settings_are_checked_like_those_of_any_other(export, tmp_path, words, error):
    run = export(*words)
    assert run.returncode == 2
    assert error in run.stderr
    assert not (tmp_path / "out").exists()


def test_a_bridge_can_be_configured_for_it(environment):
    good = python(environment, "-c", BRIDGE, "max_rows=100")
    assert good.stdout == "('max_rows=100',)\n", good.stderr
    bad = python(environment, "-c", BRIDGE, "rows=100")
    assert "options: unknown setting 'rows'; did you mean 'max_rows'?" in bad.stderr
