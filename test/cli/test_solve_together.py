"""``rotcal solve`` of several tables, and ``rotcal plan add``."""

import json

import numpy as np
import pytest
from carried_tracer import tracer_problem
from click.testing import CliRunner
from joint_world import instrument, polygon
from two_groups import ALTERNATING, ANGLES, plate_problem

from rotcal_ros.cli.main import rotcal
from rotcal_ros.evaluation.joint import predicted_together

SHIFTS = ((0.0, -30.0, -150.0), (0.0, -60.0, -90.0))


def run(*arguments):
    return CliRunner().invoke(rotcal, [str(argument) for argument in arguments])


@pytest.fixture(scope="module")
def tables(tmp_path_factory):
    """Two tables of readings with their set-ups: (readings, set-up) of each polygon."""
    folder, rng, found = tmp_path_factory.mktemp("polygons"), np.random.default_rng(1), []
    for number, shifts in enumerate(SHIFTS):
        measured = polygon(ALTERNATING, rng, shifts=shifts)
        rows = [f"{o.table_position},{o.station},{o.mean[0]!r}" for o in measured.observations]
        table, setup = folder / f"{number}.csv", folder / f"{number}.yaml"
        table.write_text("\n".join(["position,setting,reading_rad", *rows, ""]))
        setup.write_text(measured.configuration.text)
        found.append((table, setup))
    return found


def test_two_tables_are_solved_together(tables, tmp_path):
    (first, its), (second, others) = tables
    best = tmp_path / "best.json"
    ran = run("solve", first, second, "--setup", its, "--setup", others, "--json", "-o", best)
    assert ran.exit_code == 0, ran.output
    data = json.loads(ran.stdout)
    assert list(data["details"]["inputs"]) == [str(first), str(second)]
    assert (data["method"], data["n_observations"]) == ("combination", 78)
    each = [json.loads(run("solve", t, "--setup", s, "--json").stdout) for t, s in tables]
    together = max(data["std"]["ECC"])
    assert all(together < 0.9 * max(alone["std"]["ECC"]) for alone in each)
    words = run("solve", first, second, "--setup", its, "--setup", others)
    assert "ECC: chi-square" in words.stderr
    assert "measurement: ok" in words.stderr
    assert run("report", best, "-o", tmp_path / "page.html").exit_code == 0


def test_tables_that_cannot_be_solved_alone_are_solved_together(tmp_path):
    """Three angles of lengths give no circle; the two groups of a plate have no common zero."""
    six, arc = plate_problem(noise=2e-8), tracer_problem(1, ALTERNATING[:3], ANGLES[:3])
    centres = zip(six.position, six.ball_step, *six.centres.T, strict=True)
    lengths = zip(arc.position, arc.target, arc.length, strict=True)
    plate = written(tmp_path / "plate.csv", "position,ball_step,x_m,y_m,z_m", centres)
    tracer = written(tmp_path / "tracer.csv", "position,target,length_m", lengths)
    written(
        tmp_path / "targets.csv",
        "target,x_m,y_m,z_m",
        ((k, *place) for k, place in enumerate(arc.targets)),
    )
    balls, its = tmp_path / "plate.yaml", tmp_path / "tracer.yaml"
    balls.write_text(
        "{method: ball_plate, plan: {measure: centre, plate: {name: six balls, grid: 12, "
        "ball_steps: [0, 2, 4, 6, 8, 10], circle_radius_m: 0.185, ball_diameter_m: 0.02, "
        "separate_groups: true}}, solver: {sigma_centre_m: 2.0e-8}}"
    )
    its.write_text(
        "{method: tracer_multistation, plan: {table_angles_deg: [0, 30, 60]}, solver: "
        "{length_std_m: 2.0e-7, target_std_m: 1.0e-6, error_motion_std_m: 5.0e-8}}"
    )
    alone = run("solve", tracer, "--setup", its)
    assert alone.exit_code == 3, alone.output
    assert "at least 4 are needed" in alone.stderr
    ran = run("solve", plate, tracer, "--setup", balls, "--setup", its, "--json")
    assert ran.exit_code == 0, ran.output
    data = json.loads(ran.stdout)
    assert (data["verdict"], list(data["deviations"])) == ("ok", ["ECC"])
    error = np.array(data["deviations"]["ECC"]) - ALTERNATING
    assert np.abs(error).max() < 3.5 * max(data["std"]["ECC"])
    assert data["n_observations"] == 72 + 54


def written(path, header, rows):
    path.write_text("\n".join([header, *(",".join(map(repr_of, row)) for row in rows), ""]))
    return path


def repr_of(value):
    """Return a number with all its digits, whatever type numpy gave it."""
    return repr(value.item()) if isinstance(value, np.generic) else repr(value)


def test_a_result_stands_for_its_observations(tables, tmp_path):
    """Of a linear method with one component it says all: the same as from both tables."""
    (first, its), (second, others) = tables
    made = tmp_path / "first.json"
    assert run("solve", first, "--setup", its, "-o", made).exit_code == 0
    both = json.loads(
        run("solve", first, second, "--setup", its, "--setup", others, "--json").stdout
    )
    ran = run("solve", made, second, "--setup", others, "--json")
    assert ran.exit_code == 0, ran.output
    mixed = json.loads(ran.stdout)
    for name in ("deviations", "std"):
        assert mixed[name]["ECC"] == pytest.approx(both[name]["ECC"], abs=1e-12)
    assert mixed["n_observations"] == both["n_observations"]
    ran = run("solve", made)
    assert ran.exit_code == 2
    assert "is a result, solved already" in ran.stderr
    ran = run("solve", made, first, "--setup", its)
    assert ran.exit_code == 3
    assert "share 39 observations" in ran.stderr


def test_what_is_of_one_source_only_is_refused(tables):
    (first, its), (second, others) = tables
    setups = ("--setup", its, "--setup", others)
    ran = run("solve", first, second, *setups, "--set", "solver.sigma_arcsec=1")
    assert ran.exit_code == 2
    assert "are for one source" in ran.stderr
    ran = run("solve", first, second, "--setup", its)
    assert ran.exit_code == 2
    assert "1 set-ups (--setup) for 2 sources, 2 of them tables" in ran.stderr
    ran = run("solve", first, first, "--setup", its, "--setup", its)
    assert ran.exit_code == 3
    assert "share 39 observations" in ran.stderr


def test_the_same_plan_once_more_is_told_to_divide_by_the_root_of_two(tables, tmp_path):
    (_, setup), (_, other) = tables
    ran = run("plan", "add", "--to", setup, setup, other, "--json")
    assert ran.exit_code == 0, ran.output
    now, again, more = json.loads(ran.stdout)["additions"]
    assert (now["plan"], now["duration_s"]) == ("as it is", 0.0)
    assert again["std"]["ECC"] == pytest.approx(now["std"]["ECC"] / np.sqrt(2.0), rel=1e-6)
    assert more["plan"] == str(other)
    assert more["std"]["ECC"] < now["std"]["ECC"]
    assert more["duration_s"] > 60.0
    assert now["open"] == more["open"] == []


def test_a_plan_says_the_same_without_being_solved(tables, monkeypatch):
    """As of measurements that were solved: only the layout matters."""
    (_, setup), (_, other) = tables
    rng = np.random.default_rng(2)
    solved = [
        instrument(f"polygon {shifts}", polygon(ALTERNATING, rng, shifts=shifts))
        for shifts in SHIFTS
    ]
    expected = predicted_together(solved).std["ECC"]

    def never(*_arguments):
        raise AssertionError("a plan was solved")

    monkeypatch.setattr("rotcal_ros.methods.calibration.Calibration.solve", never)
    ran = run("plan", "add", "--to", setup, other, "--json")
    assert ran.exit_code == 0, ran.output
    _, added = json.loads(ran.stdout)["additions"]
    assert added["std"] == {"ECC": pytest.approx(expected, rel=1e-9)}
    assert added["open"] == []


def test_a_method_is_planned_with_its_defaults():
    ran = run("plan", "add", "angle_comparison")
    assert ran.exit_code == 0, ran.output
    heading, row = ran.stdout.splitlines()
    assert heading == "plan,time/min,U(ECC)/arcsec"
    assert row.startswith("angle_comparison,")
    ran = run("plan", "add", "ball_plate")
    assert ran.exit_code == 2
    assert "setting 'plate' is missing" in ran.stderr


def test_an_addition_that_is_neither_method_nor_file_is_refused_with_the_methods():
    ran = run("plan", "add", "ball_plates")
    assert ran.exit_code == 2
    assert (
        "ball_plates is neither the file of a configuration nor one of the methods" in ran.stderr
    )
    assert "angle_comparison, ball_plate," in ran.stderr
