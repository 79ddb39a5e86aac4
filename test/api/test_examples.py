"""Every example runs alone in an empty folder and finds the truth; its data can be made again."""

import re
from pathlib import Path

import pytest

import rotcal_ros as rc

pytestmark = pytest.mark.slow

EXAMPLES = Path(__file__).parents[2] / "examples"
DATA = EXAMPLES / "data"
KEY_FIGURES = {
    "01_lengths_from_csv": (r"against the truth: (\S+) arcsec", 0.0, 1.0),
    "02_ball_plate_from_csv": (r"rms error / stated standard uncertainty: (\S+)", 0.8, 1.2),
    "03_tracker_and_mirror": (r"joint .* rms error (\S+) arcsec", 0.0, 1.0),
    "04_solve_a_bag": (r"against the truth: (\S+) arcsec", 0.0, 0.15),
    "05_compare_two_results": (r"^agree: rms (\S+) arcsec", 0.0, 0.5),
    "06_iso230_of_repeated_runs": (r"mean reversal: (\S+) arcsec", -1.6, -1.4),
    "08_plan_a_ball_plate": (r"solver / prediction: (\S+)", 0.999999, 1.000001),
    "09_table_for_my_controller": (r"left: (\S+) arcsec", 0.0, 0.3),
    "12_six_deviations_from_lengths": (
        r"rms error / stated standard uncertainty: (\S+)",
        0.5,
        1.5,
    ),
}
"""Example -> its key figure, with the bounds that truth and uncertainty set."""
WITH_ROS = {"11_calibrate_from_a_script"}
WITH_A_DATA_SET = {"13_data_set_with_scipy"}
"""Run by evaluation/test_data_set.py."""
SCRIPTS = sorted(path.stem for path in EXAMPLES.glob("[0-9]*.py"))
NO_ROS_NO_NETWORK = """
import socket, sys, runpy
for name in ("rclpy", "rotcal_msgs"):
    sys.modules[name] = None
def refuse(*_): raise OSError("no network here")
socket.socket.connect = refuse
sys.path.insert(0, sys.argv[1].rpartition("/")[0])
sys.argv[:1] = []
runpy.run_path(sys.argv[0], run_name="__main__")
"""


@pytest.fixture(scope="module")
def run(warm):
    """Return a function that runs a script in a folder without ROS and network: what it prints."""

    def printed(script, folder, *words):
        done = warm.run("python", "-c", NO_ROS_NO_NETWORK, script, *words, folder=folder)
        assert done.returncode == 0, done.stderr
        return done.stdout

    return printed


def test_every_example_has_a_key_figure():
    assert set(SCRIPTS) - WITH_ROS - WITH_A_DATA_SET == set(KEY_FIGURES)


@pytest.mark.parametrize("name", KEY_FIGURES)
def test_an_example_finds_the_truth(name, tmp_path, run):
    pattern, low, high = KEY_FIGURES[name]
    found = re.findall(pattern, run(EXAMPLES / f"{name}.py", tmp_path), re.M)
    assert found
    assert all(low <= float(figure) <= high for figure in found), found


def test_examples_leave_what_they_say(tmp_path, run):
    run(EXAMPLES / "04_solve_a_bag.py", tmp_path)
    text = run(EXAMPLES / "09_table_for_my_controller.py", tmp_path)
    assert "<html" in (tmp_path / "out" / "report.html").read_text()
    assert all((tmp_path / file).is_file() for file in re.findall(r"written: (\S+)", text))
    assert [path.name for path in tmp_path.iterdir()] == ["out"]  # which git ignores


@pytest.mark.parametrize("name", SCRIPTS)
def test_an_example_is_short_and_listed(name):
    text = (EXAMPLES / f"{name}.py").read_text()
    assert len(text.splitlines()) < 60
    first = text.removeprefix('"""').splitlines()[0].removesuffix('"""')
    row = f"| [{name}]({name}.py) | {first} |"
    assert row in (EXAMPLES / "README.md").read_text().splitlines()


@pytest.fixture(scope="module")
def made(tmp_path_factory, run):
    folder = tmp_path_factory.mktemp("data")
    run(DATA / "make_data.py", folder, folder)
    return folder


@pytest.mark.parametrize("pattern", ["*.csv", "*.yaml"])
def test_tables_are_the_same_when_made_again(made, pattern):
    again = {path.name: path.read_text() for path in made.glob(pattern)}
    assert again == {path.name: path.read_text() for path in DATA.glob(pattern)}


@pytest.mark.parametrize("name", ["result_tracer.json", "result_ball_plate.json"])
def test_results_are_the_same_when_made_again(made, name):
    again, kept = rc.read_result(made / name), rc.read_result(DATA / name)
    for component, deviation in kept.deviations.items():
        assert again.deviations[component] == pytest.approx(deviation, abs=1e-12)


def test_the_bag_is_the_same_when_made_again(made):
    again, kept = (rc.read_streams(folder / "ball_plate_bag") for folder in (made, DATA))
    assert again.points["position"].ravel() == pytest.approx(
        kept.points["position"].ravel(), abs=1e-12
    )


def test_the_data_stay_small():
    files = [path for path in DATA.rglob("*") if "__pycache__" not in path.parts]
    assert sum(path.stat().st_size for path in files if path.is_file()) < 500_000
