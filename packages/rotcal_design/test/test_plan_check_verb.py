"""``rotcal plan check``: from an earlier result to the plan that checks it, and to the verdict."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner
from test_check_balls import SETUP as PLATE_SETUP
from test_check_balls import SMALL
from test_check_balls import measured as measured_by_balls

from rotcal_ros.cli.main import rotcal, verbs
from rotcal_ros.foundation.circumstances import Circumstances
from rotcal_ros.foundation.identity import Identity
from rotcal_ros.foundation.results import Result
from rotcal_ros.foundation.units import ARCSEC
from rotcal_ros.geometry.rotations import positions_on_table
from rotcal_ros.methods import prepare_to_measure, read_configuration
from rotcal_ros.methods.tracer.simulation import cell_time
from rotcal_ros.methods.tracer.solver import TracerProblem, solve

ROOT = Path(__file__).parents[3]
PLATE = ROOT / "examples" / "data" / "result_ball_plate.json"
NOISE = ("--set", "solver.length_std_m=2e-7")
ASKED = ("--within", "2.5", "--ageing", "0.02", "--months", "6")
PLAN = ("plan", "check", PLATE, "--setup", ROOT / "config" / "tracer.yaml", *NOISE)


def run(*arguments):
    return CliRunner().invoke(rotcal, [str(argument) for argument in arguments])


@pytest.fixture(scope="module")
def planned(tmp_path_factory):
    folder = tmp_path_factory.mktemp("check")
    ran = run(
        *PLAN, "--within", "2.5", "--ageing", "0.02", "--months", "6", "-o", folder, "--json"
    )
    assert ran.exit_code == 0, ran.output
    return folder, json.loads(ran.stdout)


def place(step):
    return step.table_position, step.target


@pytest.mark.slow
def test_the_plan_that_is_written_is_the_plan_that_is_measured(planned):
    folder, data = planned
    configuration = read_configuration(folder / "check.yaml")
    plan = prepare_to_measure(configuration).plan
    np.testing.assert_allclose(plan.table_angles, data["angles_rad"], atol=1e-14)
    np.testing.assert_allclose(plan.targets, data["targets_m"], rtol=0, atol=0)
    assert [[step.table_position, step.target] for step in plan.steps] == data["pairs"]
    assert len(data["pairs"]) == data["lengths"] < data["offered"] / 5
    assert (folder / "pairs.csv").read_text().startswith("step,table_position,target\n0,0,")
    model, in_turn = cell_time(configuration), sorted(plan.steps, key=place)
    assert data["duration_s"] == pytest.approx(model.seconds(plan.steps), rel=1e-9)
    assert data["duration_s"] < model.seconds(in_turn)


def measured(folder, deviation, seed):
    """The solver's result of the plan in ``folder``, on a table that turns by so much more."""
    calibration = prepare_to_measure(read_configuration(folder / "check.yaml"))
    plan, solver = calibration.plan, calibration.configuration.solver
    rng = np.random.default_rng(seed)
    nominal, angles = np.array(plan.targets), np.array(plan.table_angles)
    stations = positions_on_table((0.0569, -0.0318, 0.1225), angles + deviation)
    position = np.array([step.table_position for step in plan.steps])
    target = np.array([step.target for step in plan.steps])
    targets = nominal + solver.target_std_m * rng.standard_normal(nominal.shape)
    apart = np.linalg.norm(stations[position] - targets[target], axis=1)
    zero = rng.uniform(-1e-3, 1e-3, len(stations))[position]
    return solve(
        TracerProblem(
            position=position,
            target=target,
            length=apart - zero + solver.length_std_m * rng.standard_normal(len(apart)),
            length_std=solver.length_std_m,
            targets=nominal,
            target_std=solver.target_std_m,
            table_angles=angles,
            error_motion_std=solver.error_motion_std_m,
        )
    )


@pytest.mark.slow
@pytest.mark.parametrize(
    ("size", "verdict", "code"), [(0.0, "still valid", 0), (5.0, "changed", 1)]
)
def test_what_the_plan_measures_decides(planned, tmp_path, size, verdict, code):
    folder, data = planned
    earlier = Result.from_dict(json.loads(PLATE.read_text())).deviations["ECC"]
    worn = earlier.copy()
    worn[4] += size * ARCSEC
    result = measured(folder, worn, 4)
    assert not result.rejected
    new = tmp_path / "result.json"
    new.write_text(result.to_json())
    ran = run("check", PLATE, new, *ASKED, "--json")
    assert ran.exit_code == code, ran.output
    check = json.loads(ran.stdout)
    assert check["verdict"] == verdict
    np.testing.assert_allclose(check["std"], data["predicted_std"], rtol=0.01)
    np.testing.assert_allclose(check["acceptance"], data["acceptance"], rtol=0.01)
    assert check["assurance"] == pytest.approx(data["assurance"], abs=0.01)


@pytest.fixture(scope="module")
def park(tmp_path_factory):
    """A history of five yearly results of a table that drifts by 0.3 arcsec in a year."""
    if "history" not in verbs():
        pytest.skip("no verb keeps a history here")
    folder = tmp_path_factory.mktemp("park")
    place = folder / "history.db"
    plate = Result.from_dict(json.loads(PLATE.read_text()))
    covariance = {"ECC": np.eye(len(plate.angles)) * (0.1 * ARCSEC) ** 2}
    rng = np.random.default_rng(3)
    for year in range(5):
        known = {"serial": "T1", "tolerance_arcsec": 12.0, "measured": f"{2021 + year}-01-01"}
        noise = 0.1 * ARCSEC * rng.standard_normal(len(plate.angles))
        result = replace(
            plate,
            deviations={"ECC": drifted(plate, year) + noise},
            std={"ECC": np.full(len(plate.angles), 0.1 * ARCSEC)},
            covariance=covariance,
            adjacent_deviations=None,
            adjacent_std=None,
            circumstances=Circumstances(axis="C", identity=Identity.from_dict(known)),
        )
        (folder / f"{year}.json").write_text(result.to_json())
    results = (folder / f"{year}.json" for year in range(5))
    added = run("history", "add", *results, "--database", place)
    assert added.exit_code == 0, added.output
    return place


def drifted(plate, years):
    return plate.deviations["ECC"] + 0.3 * years * ARCSEC * np.cos(plate.angles)


@pytest.mark.slow
def test_what_a_history_expects_is_checked_against_what_its_tolerance_leaves(park, tmp_path):
    setup = ("--setup", ROOT / "config" / "tracer.yaml", *NOISE)
    asked = ("plan", "check", "T1", "--from-history", park, "--at", "2026-01-01", *setup)
    ran = run(*asked, "-o", tmp_path, "--json")
    assert ran.exit_code == 0, ran.output
    within = float(ran.stderr.rpartition("--within ")[2])
    plate = Result.from_dict(json.loads(PLATE.read_text()))
    left = 12.0 - np.max(np.abs(drifted(plate, 5.0))) / ARCSEC
    assert within == pytest.approx(left, abs=0.3)
    new = tmp_path / "new.json"
    for truth, code in ((drifted(plate, 5.0), 0), (3.0 * drifted(plate, 5.0), 1)):
        new.write_text(measured(tmp_path, truth, 5).to_json())
        ran = run("check", tmp_path / "expected.json", new, "--within", within)
        assert ran.exit_code == code, ran.output


def test_what_a_history_expects_is_checked_by_the_fewest_balls_of_a_plate(park, tmp_path):
    setup = ("--setup", PLATE_SETUP, *(part for each in SMALL for part in ("--set", each)))
    asked = ("plan", "check", "T1", "--from-history", park, "--at", "2026-01-01", *setup)
    ran = run(*asked, "-o", tmp_path, "--json")
    assert ran.exit_code == 0, ran.output
    within, told = float(ran.stderr.rpartition("--within ")[2]), json.loads(ran.stdout)
    assert told["assurance"] >= 0.95
    assert told["centres"] < told["offered"]
    plate = Result.from_dict(json.loads(PLATE.read_text()))
    new, planned = tmp_path / "new.json", read_configuration(tmp_path / "check.yaml")
    for truth, code in ((drifted(plate, 5.0), 0), (3.0 * drifted(plate, 5.0), 1)):
        rng = np.random.default_rng(6)
        new.write_text(measured_by_balls(planned, truth, rng).to_json())
        ran = run("check", tmp_path / "expected.json", new, "--within", within)
        assert ran.exit_code == code, ran.output


def test_a_table_that_is_expected_beyond_its_tolerance_is_calibrated(park):
    setup = ("--setup", ROOT / "config" / "tracer.yaml")
    ran = run("plan", "check", "T1", "--from-history", park, "--at", "2060-01-01", *setup)
    assert (ran.exit_code, "no tolerance is left on 2060-01-01" in ran.stderr) == (2, True)


def test_options_of_a_history_need_one():
    ran = run(*PLAN, "--within", "3", "--at", "2026-01-01")
    assert (ran.exit_code, "belong to --from-history" in ran.stderr) == (2, True)
    assert "give --within" in run(*PLAN).stderr


@pytest.mark.parametrize(
    ("change", "text"),
    [
        (("--set", "solver.variant=station"), "variant joint"),
        (("--set", "solver.error_motion_std_m=null"), "what the full calibration has found"),
        (("--every", "6"), "2 angles to check"),
        (("--every", "3", "--set", "solver.length_std_m=3e-8"), "check more angles"),
    ],
)
def test_plans_that_cannot_be_are_refused(change, text):
    ran = run(*PLAN, "--within", "3", *change)
    assert ran.exit_code == 2
    assert text in ran.stderr


@pytest.mark.slow
def test_people_are_shown_what_is_not_covered():
    ran = run(*PLAN, "--within", "4", "--every", "2", "--least-redundancy", "0")
    assert ran.exit_code == 0, ran.output
    assert "nothing will be known of 1 of 2 angles" in ran.stderr
    assert "warning: some lengths are hardly checked" in ran.stderr
    assert "warning: no order of these lengths shows every drift and knock" in ran.stderr
    assert "30 lengths to 5 targets" in ran.stderr


@pytest.mark.slow
def test_a_volume_and_what_stands_in_it_are_those_of_a_tracer_plan():
    box = (-0.6, -0.6, 0.0, -0.3, 0.6, 2.0)
    ran = run(
        *PLAN, "--within", "6", "--every", "2", "--volume", ROOT / "config" / "tracer_goal.yaml",
        "--volume-set", f"keep_out_m={list(box)}", "--volume-set", "spacing_m=0.3", "--json",
    )  # fmt: skip
    assert ran.exit_code == 0, ran.output
    data = json.loads(ran.stdout)
    targets = np.array(data["targets_m"])
    assert (targets[:, 0] >= -0.3).all()
    assert targets[:, 2].min() >= 0.17
    mount = read_configuration(PLAN[4]).simulation.tracer.mount_m
    stations = positions_on_table(mount, data["angles_rad"])
    beam = targets - stations[:, None]  # from every angle
    distance = np.linalg.norm(beam, axis=2)
    assert distance.min() >= 0.25
    assert np.degrees(np.arcsin(beam[:, :, 2] / distance)).min() >= 10.0
    for share in np.linspace(0.0, 1.0, 201):
        place = stations[:, None] + share * beam
        assert not ((place > box[:3]) & (place < box[3:])).all(axis=2).any()


def test_a_volume_that_no_angle_sees_is_refused():
    ran = run(*PLAN, "--within", "6", "--volume-set", "blocked_azimuth_deg=[0, 359.9]")
    assert ran.exit_code == 2
    assert "free beam" in ran.stderr
