"""The place of axes for controllers: against rotations about lines, and what is refused."""

import csv
import io
import json
import re
from dataclasses import replace
from datetime import datetime, timezone

import numpy as np
import pytest
from click.testing import CliRunner
from scipy.spatial.transform import Rotation

from rotcal_ros.cli.main import rotcal
from rotcal_ros.compensation.axis_location import prepare_location
from rotcal_ros.compensation.controllers import make_controller
from rotcal_ros.foundation.circumstances import Circumstances
from rotcal_ros.foundation.errors import ConfigurationError, DataError
from rotcal_ros.foundation.results import AxisLine, Result

NOW = datetime(2026, 1, 2, tzinfo=timezone.utc)
C = ((0.30012, -0.20007, 0.08), (2e-5, -3e-5))
A = ((0.3, -0.15003, -0.04002), (4e-5, -5e-5))
B = ((0.34, -0.2, -0.04), (0.0, 0.0))


def found(names, nominal, value):
    covariance = 1e-12 * np.eye(4)
    return AxisLine(names, np.array(value), np.full(4, 1e-6), covariance, np.array(nominal), 1)


def measured(tilting=None, verdict="ok", senses=(1, 1), **more):
    """Return a result that gives C and, with its letter, what tilts it, and how they turn."""
    (x, y, z), lean = C
    axes = [found(("XOC", "YOC", "AOC", "BOC"), [0.3, -0.2, z], [x - 0.3, y + 0.2, *lean])]
    if tilting == "A":
        (x, y, z), lean = A
        value = [y + 0.15, z + 0.04, *lean]
        axes.append(found(("YOA", "ZOA", "BOA", "COA"), [x, -0.15, -0.04], value))
    if tilting == "B":
        axes.append(found(("XOB", "ZOB", "AOB", "COB"), B[0], [0.0] * 4))
    axes = [replace(line, sense=sense) for line, sense in zip(axes, senses, strict=False)]
    return Result(
        method="table_balls", angles=np.zeros(1), deviations={"ECC": np.zeros(1)},
        std={"ECC": np.ones(1)}, covariance={}, sigma0=1.0, dof=1, n_observations=2,
        verdict=verdict, axes=tuple(axes) if more.pop("told", True) else (), **more,
    )  # fmt: skip


def location(result, name, *, settings=None, **more):
    """Return files and words for a kind of controller."""
    return prepare_location(result, name, make_controller(name, settings), now=NOW, **more)


def about(point, line, angle):
    """Return a point (3,) that turned by the angle (deg) about a line of point and direction."""
    through, along = np.array(line[0]), np.array(line[1]) / np.linalg.norm(line[1])
    return through + Rotation.from_rotvec(np.radians(angle) * along).apply(point - through)


def by_pins(point, pins, a, c, tilting="x"):
    """Return where a point of the work stands by the formula in the controller's source, mm."""
    r = np.array([pins.get(f"{axis}-rot-point", 0.0) for axis in "xyz"])
    d = np.array([pins.get(f"{axis}-offset", 0.0) for axis in "xyz"])
    turn, tilt = Rotation.from_euler("z", c, True), Rotation.from_euler(tilting, a, True)
    return r + d + tilt.apply(turn.apply(point - r) - d)


def pins_of(text):
    return {n: float(x) for n, x in re.findall(r"setp xyz[ab]c-trt-kins\.(\S+) (\S+)", text)}


def test_the_pins_turn_the_work_about_the_measured_c():
    files, words = location(measured(), "linuxcnc")
    pins = pins_of(files["c_linuxcnc_axis.hal"])
    work, upright = np.array([150.0, 20.0, 80.0]), (1e3 * np.array(C[0]), [0.0, 0.0, 1.0])
    for angle in (30.0, 200.0):
        away = by_pins(work, pins, 0.0, angle) - about(work, upright, angle)
        assert np.abs(away).max() < 2e-6
    assert "y-offset counts from y-rot-point" in " ".join(words)
    assert "no pin holds AOC = 4.13 arcsec: the zero of A can take it" in words
    assert "no pin holds BOC = -6.19 arcsec: 100 mm away it makes 3 um" in words


@pytest.mark.parametrize(("letter", "line", "axis"), [("A", A, "x"), ("B", B, "y")])
def test_the_pins_tilt_the_work_about_the_measured_axis(letter, line, axis):
    settings = {"kinematics": f"xyz{letter.lower()}c-trt-kins"}
    files, _ = location(measured(letter), "linuxcnc", settings=settings)
    pins, along = pins_of(files["c_linuxcnc_axis.hal"]), np.eye(3)["xy".index(axis)]
    work = np.array([150.0, 20.0, 80.0])
    for tilt, turn in ((25.0, 40.0), (-90.0, 100.0)):
        turned = about(work, (1e3 * np.array(C[0]), [0.0, 0.0, 1.0]), turn)
        away = by_pins(work, pins, tilt, turn, axis) - about(
            turned, (1e3 * np.array(line[0]), along), tilt
        )
        assert np.abs(away).max() < 4e-6


def test_the_plain_list_holds_points_and_directions():
    files, _ = location(measured("A"), "csv")
    rows = list(csv.DictReader(io.StringIO(files["c_csv_axis.csv"])))
    assert [row["axis"] for row in rows] == ["C", "A"]
    numbers = [[float(row[n]) for n in list(row)[1:]] for row in rows]
    # right-handed: a turn about +x moves the head of C to -y, about +y to +x
    assert numbers[0] == pytest.approx([300.12, -200.07, 80.0, -3e-5, -2e-5, 1.0], abs=1e-9)
    assert numbers[1] == pytest.approx([300.0, -150.03, -40.02, 1.0, -5e-5, -4e-5], abs=1e-9)


def test_a_table_that_turns_clockwise_by_iso_841_needs_the_sign_of_its_joint():
    _, words = location(measured(senses=(-1,)), "linuxcnc")
    assert any("reverse the sign of its joint" in word for word in words)


def machine(tmp_path, kinematics="xyzac-trt-kins", unit="inch"):
    path = tmp_path / "machine.ini"
    path.write_text(f"[KINS]\nKINEMATICS = {kinematics} x=1\n[TRAJ]\nLINEAR_UNITS = {unit}\n")
    return {"machine_ini": str(path)}


def test_a_machine_in_inches_gets_inches(tmp_path):
    files, _ = location(measured(), "linuxcnc", settings=machine(tmp_path))
    assert pins_of(files["c_linuxcnc_axis.hal"])["x-rot-point"] == pytest.approx(
        300.12 / 25.4, abs=1e-6
    )


def test_what_does_not_fit_is_refused(tmp_path):
    def refused(error, words, result=None, name="linuxcnc", **more):
        with pytest.raises(error, match=words):
            location(result or measured(), name, **more)

    refused(
        DataError, "verdict of the table_balls result is 'suspect'", measured(verdict="suspect")
    )
    refused(DataError, "does not say where the axis stands", measured(told=False))
    refused(
        ConfigurationError,
        "tilts about A, and B was measured: set kinematics to xyzbc",
        measured("B"),
    )
    other = machine(tmp_path, "trivkins")
    refused(ConfigurationError, "KINEMATICS = trivkins has no place", settings=other)
    refused(ConfigurationError, "LINEAR_UNITS = ell", settings=machine(tmp_path, unit="ell"))


def test_a_simulated_place_says_so():
    simulated = measured(circumstances=Circumstances(simulated=True))
    files, _ = location(simulated, "linuxcnc")
    assert "# SIMULATED: no instrument measured this" in files["c_linuxcnc_axis_simulated.hal"]


def test_the_command_writes_both_files_and_refuses_what_tables_take(tmp_path):
    (tmp_path / "result.json").write_text(measured().to_json())

    def export(*words):
        command = ["export", str(tmp_path / "result.json"), "--to", "linuxcnc", "--what", "axis"]
        return CliRunner().invoke(rotcal, [*command, "--out", str(tmp_path / "out"), *words])

    assert "--replace: no use for --what axis" in export("--replace").stderr
    done = export("--json")
    assert done.exit_code == 0, done.output
    told = json.loads(done.stdout)
    assert told["provenance"]["values"]["xyzac-trt-kins.x-rot-point"] == 300.12
    assert told["provenance"]["axes"]["C"]["found"]["XOC"]["std"] == 1e-6
    assert len(told["files"]) == 2
    assert "exists already" in export().stderr
