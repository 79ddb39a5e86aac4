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
from warm import WarmServer

from rotcal_polygon.simulation import PolygonSimulationSettings, SimulatedAutocollimator
from rotcal_ros.foundation.machine_load import patient
from rotcal_ros.foundation.settings import load
from rotcal_ros.foundation.units import ARCSEC, DEGREE
from rotcal_ros.methods.ball_plate import solver as ball_plate
from rotcal_ros.methods.simulation.settings import TableSettings
from rotcal_ros.methods.simulation.table import SimulatedTable, deviations
from rotcal_ros.sessions.domains import free_domain

pytestmark = pytest.mark.slow

ROOT = Path(__file__).parents[2]
EXAMPLE = ROOT / "examples" / "own_method"
DEMO = EXAMPLE / "polygon_demo.yaml"
DEADLINE_S = 120.0
HARMONICS = {"amplitudes_arcsec": [2.0, 0.9, 0.5, 0.3], "phases_deg": [20.0, -75.0, 140.0, 60.0]}
"""The ECC of the demonstration."""
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
            timeout=patient(DEADLINE_S),
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
    assert (outcome["verdict"], outcome["n_used"], outcome["n_rejected"]) == ("ok", 3 * 13, 0)
    assert set(outcome["files"]) == {"bag", "result", "truth", "report", "compensation"}
    return folder


@pytest.mark.ros
def test_the_live_result_is_true_within_its_uncertainty(session):
    result, truth = (
        json.loads((session / name).read_text()) for name in ("result.json", "truth.json")
    )
    error = np.array(result["deviations"]["ECC"]) - truth["deviations"]["ECC"][:N]
    whitened = np.linalg.solve(np.array(result["covariance"]["ECC"])[1:, 1:], error[1:])
    assert error[1:] @ whitened < 34.0  # chi-squared with 11: one run in 3000
    assert np.ptp(truth["deviations"]["ECC"]) > 100.0 * max(result["std"]["ECC"])
    assert result["dof"] == 3 * 13 - (2 * N - 1 + 2)


@pytest.mark.ros
def test_the_live_run_finds_the_faces_of_the_simulated_polygon(session):
    details = json.loads((session / "result.json").read_text())["details"]
    text = yaml.safe_load(DEMO.read_text())["/**"]["ros__parameters"]["simulation"]
    settings = load(PolygonSimulationSettings, text, "simulation")
    table = SimulatedTable(settings.table, 1, 0)
    true = SimulatedAutocollimator(settings, table, None, 0).face_errors
    faces = details["also"]["face error"]
    error = np.array(faces["value"]) - (true - true.mean())
    assert np.abs(error / faces["std"]).max() < 4.5


@pytest.mark.ros
def test_bag_and_report_tell_the_same_as_the_live_run(session, rotcal):
    text = (session / "result.json").read_text()
    assert rotcal("solve", session / "bag", "--json").stdout.strip() == text.strip()
    rotcal("report", session / "bag", "-o", session / "again.html")
    page = (session / "again.html").read_text()
    for words in (
        "Optical polygon and autocollimator",
        "Face errors of the polygon",
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
    """The ball plate measures the same injected table, at three times as many angles."""
    settings = load(TableSettings, {"ecc": HARMONICS}, "table")
    angles = 2.0 * np.pi * np.arange(36) / 36
    true = np.stack(list(deviations(settings, angles).values()), axis=1)
    rng = np.random.default_rng(12)
    problem = by_ball_plate(true, rng, balls=(0, 2, 5, 9, 11, 15, 17, 21, 24, 26, 29, 33))
    other = tmp_path / "ball_plate.json"
    other.write_text(ball_plate.solve(problem).to_json())
    answer = rotcal("compare", session / "result.json", other, "--json").stdout
    (pair,) = json.loads(answer)["pairs"]
    assert pair["agree"]
    assert len(pair["angles"]) == N
    assert pair["rms"] < 0.3 * ARCSEC


@pytest.mark.ros
@pytest.mark.parametrize("controller", ["csv", "linuxcnc"])
def test_controllers_take_the_result(session, rotcal, tmp_path, controller):
    for source in ("bag", "result.json"):
        out = tmp_path / source
        done = rotcal(
            "export", session / source, "--to", controller, "--replace", "-o", out, "--json"
        )
        residual = json.loads(done.stdout)["provenance"]
        assert "polygon" in json.dumps(residual)
        assert len(list(out.iterdir())) >= 2


@pytest.mark.long
@pytest.mark.ros
def test_an_interrupted_plan_goes_on_in_the_same_mounting(rotcal, environment, tmp_path):
    pytest.importorskip("rclpy")
    folder = tmp_path / "session"
    slowly = ("--set", "simulation.time_scale=80.0")
    run = (sys.executable, "-m", "rotcal_ros.cli.main", "run", str(DEMO), *slowly)
    env = {**environment, "ROS_DOMAIN_ID": str(free_domain())}
    command = [*run, "--output", str(folder)]
    with subprocess.Popen(command, stderr=subprocess.PIPE, text=True, env=env, cwd=ROOT) as first:
        for line in first.stderr:
            step = re.match(r"(\d+) of 39 steps, table position", line)
            if step and int(step[1]) > 13:
                break
        first.send_signal(signal.SIGINT)
        assert "interrupted; the bag is closed" in first.stderr.read()
        assert first.wait(patient(DEADLINE_S)) == 130
    done = rotcal("run", DEMO, *slowly, "--resume", folder, "--json")
    assert json.loads(done.stdout)["verdict"] == "ok"
    assert "mounting 1 of 3" not in done.stderr
    assert "mounting 2 of 3" in done.stderr
    again = rotcal("solve", folder / "bag", "--json").stdout
    assert again.strip() == (folder / "result.json").read_text().strip()


UNSHOWN = """
from dataclasses import replace
from rotcal_polygon.method import METHOD as POLYGON

def plan(configuration):
    whole = POLYGON.plan(configuration)
    return replace(whole, pauses=tuple(replace(p, last=p.first - 1) for p in whole.pauses))

METHOD = replace(POLYGON, name="unshown", plan=plan)
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
    demo.write_text(DEMO.read_text().replace("method: polygon", "method: unshown"))
    path = os.pathsep.join([str(tmp_path), environment["PYTHONPATH"]])
    done = subprocess.run(
        [sys.executable, "-m", "rotcal_ros.cli.main", "run", demo, "--output", tmp_path / "out"],
        capture_output=True,
        text=True,
        timeout=patient(DEADLINE_S),
        cwd=ROOT,
        env={**environment, "PYTHONPATH": path, "ROS_DOMAIN_ID": str(free_domain())},
    )
    assert done.returncode == 0, done.stderr
    assert [done.stderr.count(f"mounting {m} of 3") for m in range(3)] == [1, 1, 1]


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ("solver.sgima=1", "solver: unknown setting 'sgima'; known: sigma_arcsec"),
        ("solver.sgima_arcsec=1", "did you mean 'sigma_arcsec'?"),
        ("plan.first_faces=[0, 12, 5]", "expected different faces from 0 to 11"),
        ("plan.first_faces=[0, 4, 8]", "turn the polygon by 1 face"),
        ("solver.face_errors_arcsec=[0.5, 0.1]", "2 values for a polygon with 12 faces"),
    ],
)
def test_settings_that_cannot_work_are_refused_before_anything_starts(
    rotcal, tmp_path, change, words
):
    pytest.importorskip("rclpy")
    done = rotcal("run", DEMO, "--set", change, "--output", tmp_path / "none", code=2)
    assert words in done.stderr
    assert not (tmp_path / "none").exists()


def ecc(position):
    """Return the demonstration's ECC, rad, counted from position 0."""
    orders = np.arange(1, 5)
    phases = np.array(HARMONICS["phases_deg"]) * DEGREE
    amplitudes = np.array(HARMONICS["amplitudes_arcsec"]) * ARCSEC
    values = [np.cos(orders * i * 30 * DEGREE + phases) @ amplitudes for i in (0, position)]
    return values[1] - values[0]


def rows_of(first_faces, faces=None, stops=N + 1):
    """Return exact rows of the plain table."""
    faces = np.zeros(N) if faces is None else faces
    return [
        [i, m, float(ecc(i) + faces[(first + i) % N] + (m + 1) * 20 * ARCSEC)]
        for m, first in enumerate(first_faces)
        for i in range(stops)
    ]


def write(path, rows):
    lines = [f"{position},{mounting},{reading!r}" for position, mounting, reading in rows]
    path.write_text("\n".join(["position,mounting,reading_rad", *lines]) + "\n")
    return path


def setup(path, plan="", solver=""):
    path.write_text(
        f"/**: {{ros__parameters: {{method: polygon, plan: {{{plan}}}, solver: {{{solver}}}}}}}\n"
    )
    return path


FACES = 2.0 * ARCSEC * np.random.default_rng(1).standard_normal(N)


def test_what_it_marked_is_told_first(rotcal):
    groups = json.loads(rotcal("settings", "polygon", "--json").stdout)["groups"]
    first = [s["name"] for group in groups for s in group["settings"] if s["first"]]
    assert [name for name in first if name.startswith(("plan.", "solver."))] == [
        "plan.faces", "plan.first_faces", "plan.table_start_deg",
        "solver.sigma_arcsec", "solver.face_errors_arcsec", "solver.face_std_arcsec",
    ]  # fmt: skip
    told = rotcal("settings", "polygon").stdout
    assert all(f"  {name} " in told for name in first)


def test_a_plain_table_of_exact_readings_gives_the_truth(rotcal, tmp_path):
    table = write(tmp_path / "readings.csv", rows_of((0, 1, 5), FACES))
    done = rotcal("solve", table, "--setup", setup(tmp_path / "setup.yaml"), "--json")
    result = json.loads(done.stdout)
    assert result["verdict"] == "ok"
    assert result["deviations"]["ECC"] == pytest.approx([ecc(i) for i in range(N)], abs=1e-16)
    found = result["details"]["also"]["face error"]["value"]
    assert found == pytest.approx(FACES - FACES.mean(), abs=1e-16)


def test_one_mounting_says_that_the_polygon_is_in_the_result(rotcal, tmp_path):
    table = write(tmp_path / "readings.csv", rows_of((0,), FACES))
    alone = setup(tmp_path / "alone.yaml", "first_faces: [0]")
    done = json.loads(rotcal("solve", table, "--setup", alone, "--json", code=1).stdout)
    assert done["verdict"] == "suspect"
    assert done["warnings"][0].startswith("the errors of the polygon are in the result")
    errors = (FACES / ARCSEC).tolist()
    known = setup(tmp_path / "known.yaml", "first_faces: [0]", f"face_errors_arcsec: {errors}")
    done = json.loads(rotcal("solve", table, "--setup", known, "--json").stdout)
    assert done["deviations"]["ECC"] == pytest.approx([ecc(i) for i in range(N)], abs=1e-16)


def test_a_turn_that_does_not_close_is_suspect(rotcal, tmp_path):
    rows = rows_of((0, 1, 5), FACES)
    for row in rows:
        row[2] += 0.5 * ARCSEC * row[0] / N  # drifts by ten standard deviations a turn
    table = write(tmp_path / "readings.csv", rows)
    done = rotcal("solve", table, "--setup", setup(tmp_path / "s.yaml"), "--json", code=1)
    result = json.loads(done.stdout)
    assert result["verdict"] == "suspect"
    assert result["warnings"][0].startswith("it looks as if the autocollimator drifts, by 0.5")
    error = np.array(result["deviations"]["ECC"]) - [ecc(i) for i in range(N)]
    assert np.abs(error).max() < 0.01 * ARCSEC  # the drift was taken off


def test_a_mounting_turned_by_another_number_of_faces_is_suspect(rotcal, tmp_path):
    table = write(tmp_path / "readings.csv", rows_of((0, 1, 6), FACES))
    done = rotcal("solve", table, "--setup", setup(tmp_path / "s.yaml"), "--json", code=1)
    assert any("of mounting 2" in words for words in json.loads(done.stdout)["warnings"])


def test_a_column_of_times_tells_what_came_before_what(rotcal, tmp_path):
    """The second mounting was read backwards: a drift in time is one that falls by position."""
    rows = rows_of((0, 1, 5), FACES)
    stops = N + 1
    for row in rows:
        position, mounting, _ = row
        when = stops - 1 - position if mounting == 1 else position
        row[2] += 0.5 * ARCSEC * when / N
        row.insert(3, 60.0 * when + 3600.0 * mounting)
    lines = [",".join(map(repr, row)) for row in rows]
    header = "position,mounting,reading_rad"
    table = tmp_path / "timed.csv"
    table.write_text("\n".join([f"{header},time_s", *lines]) + "\n")
    s = setup(tmp_path / "s.yaml")
    result = json.loads(rotcal("solve", table, "--setup", s, "--json", code=1).stdout)
    error = np.array(result["deviations"]["ECC"]) - [ecc(i) for i in range(N)]
    assert np.abs(error).max() < 0.01 * ARCSEC
    plain = write(tmp_path / "plain.csv", [row[:3] for row in rows])
    other = json.loads(rotcal("solve", plain, "--setup", s, "--json", code=1).stdout)
    for found, backwards in ((result, 1.0), (other, -1.0)):
        (drift,) = found["details"]["effects_found"]
        sizes = np.array(drift["size"]) / ARCSEC
        assert sizes == pytest.approx([0.5, 0.5 * backwards, 0.5], abs=0.01)


@pytest.mark.parametrize(
    ("row", "words"),
    [
        ([2, 3, 0.0], "which has positions 0 to 12 and mountings 0 to 2"),
        ([13, 0, 0.0], "row 2: position 13, mounting 0 is not in the plan"),
        ([1, 0, 1.7], "are these arcseconds? State the unit in the head of the column"),
        ([1, 0, float("nan")], "reading_rad must be a finite number"),
    ],
)
def test_rows_that_cannot_be_are_named(rotcal, tmp_path, row, words):
    table = write(tmp_path / "readings.csv", [row])
    done = rotcal("solve", table, "--setup", setup(tmp_path / "s.yaml"), code=3)
    assert words in done.stderr
