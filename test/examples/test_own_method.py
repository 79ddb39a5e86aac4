"""A stranger's package beside an unchanged rotcal_ros: installed, then used by every verb."""

import json
import os
import re
import shutil
import signal
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
import yaml
from one_table import by_ball_plate
from snippets import PYTHON, blocks
from test_level import PLAN, World
from warm import WarmServer

from rotcal_level.settings import LevelSimulationSettings
from rotcal_level.simulation import SimulatedLevels
from rotcal_ros.foundation.machine_load import load_scaled_timeout
from rotcal_ros.foundation.settings import load
from rotcal_ros.foundation.units import ARCSEC
from rotcal_ros.methods.ball_plate import solver as ball_plate
from rotcal_ros.methods.simulation.table import SimulatedTable, deviations
from rotcal_ros.sessions.domains import free_domain

pytestmark = pytest.mark.slow

ROOT = Path(__file__).parents[2]
EXAMPLE = ROOT / "examples" / "own_method"
DEMO = EXAMPLE / "level_demo.yaml"
DEADLINE_S = 120.0
SIMULATION = load(
    LevelSimulationSettings,
    yaml.safe_load(DEMO.read_text())["/**"]["ros__parameters"]["simulation"],
    "simulation",
)
N = 12


@pytest.fixture(scope="session")
def environment(tmp_path_factory):
    """Install the package offline into a folder; return what lets subprocesses find it."""
    folder = tmp_path_factory.mktemp("stranger")
    shutil.copytree(EXAMPLE, folder / "source", ignore=shutil.ignore_patterns("__pycache__"))
    offline = ("--no-deps", "--no-build-isolation", "--no-index", "--disable-pip-version-check")
    command = (sys.executable, "-m", "pip", "install", "-q", *offline)
    subprocess.run([*command, "--target", folder / "site", folder / "source"], check=True)
    rest = [part for part in sys.path if part and Path(part) != EXAMPLE]
    path = os.pathsep.join([str(folder / "site"), str(ROOT), *rest])
    return {**os.environ, "PYTHONPATH": path, "ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST"}


@pytest.fixture(scope="session")
def warm_stranger(environment):
    """Return what runs ``rotcal`` beside the installed package without its imports."""
    process = WarmServer(environment, ros=True)
    yield process
    process.close()


@pytest.fixture(scope="session")
def rotcal(environment, warm_stranger):
    """Return a function that runs a verb and returns its output, the exit code checked."""

    def anew(*arguments):
        return subprocess.run(
            [sys.executable, "-m", "rotcal_ros.cli.main", *map(str, arguments)],
            capture_output=True,
            text=True,
            timeout=load_scaled_timeout(DEADLINE_S),
            cwd=ROOT,
            env={**environment, "ROS_DOMAIN_ID": str(free_domain())},
        )

    def run(*arguments, code=0):
        if arguments[0] == "run":  # starts nodes
            done = anew(*arguments)
        else:
            done = warm_stranger.run("rotcal", *arguments, folder=ROOT)
        assert done.returncode == code, done.stderr
        assert "Traceback" not in done.stderr
        return done

    return run


@pytest.fixture(scope="session")
def session(rotcal, tmp_path_factory):
    """Return the folder of a live calibration of the demonstration."""
    pytest.importorskip("rclpy")
    pytest.importorskip("rotcal_msgs")
    folder = tmp_path_factory.mktemp("live") / "session"
    outcome = json.loads(rotcal("run", DEMO, "--output", folder, "--json").stdout)
    assert (outcome["verdict"], outcome["n_used"], outcome["n_rejected"]) == ("ok", 4 * 13, 0)
    assert set(outcome["files"]) == {"bag", "result", "truth", "report"}  # no ECC
    return folder


@pytest.mark.ros
def test_the_live_result_is_true_within_its_uncertainty(session):
    result, truth = (
        json.loads((session / name).read_text()) for name in ("result.json", "truth.json")
    )
    for name in ("EAC", "EBC"):
        true = np.array(truth["deviations"][name])
        error = np.array(result["deviations"][name]) - true
        square = error @ np.linalg.pinv(result["covariance"][name], rcond=1e-6) @ error
        assert square < 34.0  # chi-squared with 11: one run in 3000
        assert np.ptp(true) > 30.0 * max(result["std"][name])
    assert result["dof"] == 4 * 13 - (2 * N + 4 - 2)
    assert result["zeros"]["counts_from"] == "mean"


@pytest.mark.ros
def test_the_live_run_finds_how_the_levels_and_the_axis_really_stand(session):
    also = json.loads((session / "result.json").read_text())["details"]["also"]
    placed = SimulatedLevels(SIMULATION, SimulatedTable(SIMULATION.table, 1, 0), None, 0).placed
    lean = np.array(SIMULATION.table.axis_tilt_arcsec) * ARCSEC
    for name, true in (("azimuth error", placed), ("lean of the axis", lean)):
        error = np.array(also[name]["value"]) - true
        assert np.abs(error / also[name]["std"]).max() < 4.5


@pytest.mark.ros
def test_bag_and_report_tell_the_same_as_the_live_run(session, rotcal):
    text = (session / "result.json").read_text()
    assert rotcal("solve", session / "bag", "--json").stdout.strip() == text.strip()
    rotcal("report", session / "bag", "-o", session / "again.html")
    page = (session / "again.html").read_text()
    for words in (
        "Electronic levels on the table",
        "Azimuth error",
        "Harmonic content",
    ):
        assert words in page


@pytest.mark.ros
def test_trials_confirm_the_uncertainty(session, rotcal):
    for source in (session / "bag", DEMO):
        words = rotcal("uncertainty", source, "--trials", "20000", "--workers", "1").stderr
        assert "trials confirm the solver's uncertainty" in words


@pytest.mark.ros
def test_it_agrees_with_a_ball_plate_on_the_same_table(session, rotcal, tmp_path):
    """Both take off the mean and what turns with the table; the plate tells ECC beside."""
    true = np.stack(list(deviations(SIMULATION.table, 2.0 * np.pi * np.arange(N) / N).values()), 1)
    other = tmp_path / "ball_plate.json"
    problem = by_ball_plate(true, np.random.default_rng(12), balls=tuple(range(N)))
    other.write_text(ball_plate.solve(problem).to_json())
    for name in ("EAC", "EBC"):
        answer = rotcal("compare", session / "result.json", other, "--component", name, "--json")
        (pair,) = json.loads(answer.stdout)["pairs"]
        assert pair["agree"]
        assert len(pair["angles"]) == N
        assert pair["rms"] < 0.3 * ARCSEC
    both = json.loads(rotcal("combine", session / "result.json", other, "--json").stdout)
    one = json.loads((session / "result.json").read_text())
    assert {"EAC", "EBC", "ECC"} <= set(both["deviations"])
    assert max(both["std"]["EAC"]) < max(one["std"]["EAC"])


@pytest.mark.ros
def test_controllers_are_not_given_what_was_not_measured(session, rotcal, tmp_path):
    out = tmp_path / "tables"
    done = rotcal("export", session / "result.json", "--to", "csv", "-o", out, code=3)
    assert "holds no ECC, only EAC, EBC" in done.stderr
    assert not out.exists()


@pytest.mark.long
@pytest.mark.ros
def test_an_interrupted_plan_goes_on_in_the_same_setting(rotcal, environment, tmp_path):
    pytest.importorskip("rclpy")
    folder = tmp_path / "session"
    slowly = ("--set", "simulation.time_scale=80.0")
    run = (sys.executable, "-m", "rotcal_ros.cli.main", "run", str(DEMO), *slowly)
    env = {**environment, "ROS_DOMAIN_ID": str(free_domain())}
    command = [*run, "--output", str(folder)]
    with subprocess.Popen(command, stderr=subprocess.PIPE, text=True, env=env, cwd=ROOT) as first:
        for line in first.stderr:
            step = re.match(r"(\d+) of 52 steps, table position", line)
            if step and int(step[1]) > 26:
                break
        first.send_signal(signal.SIGINT)
        assert "interrupted; the bag is closed" in first.stderr.read()
        assert first.wait(load_scaled_timeout(DEADLINE_S)) == 130
    done = rotcal("run", DEMO, *slowly, "--resume", folder, "--json")
    assert json.loads(done.stdout)["verdict"] == "ok"
    assert "setting 0 of 2" not in done.stderr
    again = rotcal("solve", folder / "bag", "--json").stdout
    assert again.strip() == (folder / "result.json").read_text().strip()


UNSHOWN = """
from dataclasses import replace
from rotcal_level.method import METHOD as LEVEL

def plan(configuration):
    whole = LEVEL.plan(configuration)
    return replace(whole, pauses=tuple(replace(p, last=p.first - 1) for p in whole.pauses))

METHOD = replace(LEVEL, name="unshown", plan=plan)
"""


@pytest.mark.long  # test_calibrator.py asks once for every work
@pytest.mark.ros
def test_work_that_no_step_shows_is_asked_for_once(environment, tmp_path):
    """Also: a method needs no more than a module and the entry point that names it."""
    pytest.importorskip("rclpy")
    (tmp_path / "unshown.py").write_text(UNSHOWN)
    info = tmp_path / "unshown-1.dist-info"
    info.mkdir()
    (info / "METADATA").write_text("Metadata-Version: 2.1\nName: unshown\nVersion: 1\n")
    (info / "entry_points.txt").write_text("[rotcal_ros.methods]\nunshown = unshown:METHOD\n")
    demo = tmp_path / "demo.yaml"
    demo.write_text(DEMO.read_text().replace("method: level", "method: unshown"))
    path = os.pathsep.join([str(tmp_path), environment["PYTHONPATH"]])
    done = subprocess.run(
        [sys.executable, "-m", "rotcal_ros.cli.main", "run", demo, "--output", tmp_path / "out"],
        capture_output=True,
        text=True,
        timeout=load_scaled_timeout(DEADLINE_S),
        cwd=ROOT,
        env={**environment, "PYTHONPATH": path, "ROS_DOMAIN_ID": str(free_domain())},
    )
    assert done.returncode == 0, done.stderr
    assert [done.stderr.count(f"setting {m} of 2") for m in range(2)] == [1, 1]


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ("solver.sgima=1", "solver: unknown setting 'sgima'; known: sigma_arcsec"),
        ("solver.sgima_arcsec=1", "did you mean 'sigma_arcsec'?"),
        ("plan.azimuths_deg=[0, 90, 180]", "3 azimuths for 2 levels"),
        ("plan.azimuths_deg=[0, 180]", "add a second level at 90 deg to the first"),
    ],
)
def test_settings_that_cannot_work_are_refused_before_anything_starts(
    rotcal, tmp_path, change, words
):
    pytest.importorskip("rclpy")
    done = rotcal("run", DEMO, "--set", change, "--output", tmp_path / "none", code=2)
    assert words in done.stderr
    assert not (tmp_path / "none").exists()


def write(path, world, value, times=()):
    """Write readings as a plain table."""
    columns = [world.position, world.level, value, *times]
    rows = (",".join(map(repr, row)) for row in zip(*(c.tolist() for c in columns), strict=True))
    header = ",".join(["position", "level", "reading_rad", *["time_s"] * len(times)])
    path.write_text("\n".join([header, *rows]) + "\n")
    return path


@pytest.fixture
def setup(tmp_path):
    path = tmp_path / "setup.yaml"
    angles = "table_start_deg: 0.0, table_step_deg: 30.0, table_positions: 12"
    path.write_text(f"/**: {{ros__parameters: {{method: level, plan: {{{angles}}}}}}}\n")
    return path


def test_what_it_marked_is_told_first(rotcal):
    groups = json.loads(rotcal("settings", "level", "--json").stdout)["groups"]
    first = [s["name"] for group in groups for s in group["settings"] if s["first"]]
    assert [name for name in first if name.startswith(("plan.", "solver."))] == [
        "plan.table_start_deg", "plan.table_step_deg", "plan.table_positions",
        "plan.azimuths_deg", "solver.sigma_arcsec", "solver.azimuth_std_deg",
    ]  # fmt: skip
    told = rotcal("settings", "level").stdout
    assert all(f"  {name} " in told for name in first)


def test_a_plain_table_of_exact_readings_gives_the_truth(rotcal, tmp_path, setup):
    world = World(PLAN, off_deg=0.0)
    table = write(tmp_path / "readings.csv", world, world.value)
    result = json.loads(rotcal("solve", table, "--setup", setup, "--json").stdout)
    assert result["verdict"] == "ok"
    for name, true in zip(("EAC", "EBC"), world.true, strict=True):
        assert result["deviations"][name] == pytest.approx(true, abs=1e-5 * ARCSEC)


def test_a_column_of_times_tells_what_came_before_what(rotcal, tmp_path, setup):
    """The second setting was read backwards: a drift in time is one that falls by position."""
    world = World(PLAN, off_deg=0.0)
    when = np.where(world.level < 2, world.order, 12 - world.order)
    value = world.noisy(np.random.default_rng(4)) + 2.0 * ARCSEC * when / 12
    times = 60.0 * when + 3600.0 * (world.level >= 2) + 20.0 * (world.level % 2)
    for name, given, backwards in (("timed", [times], 1.0), ("plain", [], -1.0)):
        table = write(tmp_path / f"{name}.csv", world, value, given)
        done = rotcal("solve", table, "--setup", setup, "--json", code=1)
        (drift,) = json.loads(done.stdout)["details"]["effects_found"]
        sizes = np.array(drift["size"]) / ARCSEC
        assert sizes == pytest.approx([2.0, 2.0, 2.0 * backwards, 2.0 * backwards], abs=0.5)


@pytest.mark.parametrize(
    ("row", "words"),
    [
        ([2, 4, 0.0], "which has positions 0 to 11 and levels 0 to 3"),
        ([12, 0, 0.0], "row 2: position 12, level 0 is not in the plan"),
        ([1, 0, 1.7], "are these arcseconds? State the unit in the head of the column"),
        ([1, 0, float("nan")], "reading_rad must be a finite number"),
    ],
)
def test_rows_that_cannot_be_are_named(rotcal, tmp_path, setup, row, words):
    table = tmp_path / "readings.csv"
    table.write_text(f"position,level,reading_rad\n{','.join(map(repr, row))}\n")
    done = rotcal("solve", table, "--setup", setup, code=3)
    assert words in done.stderr


def test_what_the_page_shows_without_ros_runs(warm_stranger):
    (shown,) = (block.text for block in blocks(EXAMPLE / "README.md") if block.kind == PYTHON)
    done = warm_stranger.run("python", "-c", shown, folder=EXAMPLE)
    assert done.returncode == 0, done.stderr
    line, *errors = done.stdout.splitlines()
    assert line.startswith("ok (SIMULATED)")
    found = np.array(" ".join(errors).strip("[]").split(), float)
    assert (np.abs(found) < 0.2).all()  # arcsec, of 1.6
