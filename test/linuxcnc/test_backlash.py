"""What the real LinuxCNC makes of BACKLASH, and that a table of ours holds what it did."""

from datetime import datetime, timezone

import numpy as np
import pytest
from real_linuxcnc import Axis, Running

from rotcal_ros.compensation.export import prepare_export
from rotcal_ros.compensation.linuxcnc_machine import IniFile
from rotcal_ros.compensation.table import table_from_result
from rotcal_ros.foundation.results import Result
from rotcal_ros.foundation.units import ARCSEC, DEGREE

pytestmark = pytest.mark.linuxcnc

PLAY_DEG = 0.01
AT_DEG = (30.0, 200.0)


def machine(folder, section="JOINT_3", lines=None):
    axis = Axis(folder, limits=(-360, 720), velocity=360, acceleration=2000)
    wanted = {"BACKLASH": PLAY_DEG, **(lines or {})}
    axis.ini.write_text(IniFile.read(axis.ini).merged(section, wanted))
    return axis


def moved(axis):
    """Return what the control adds to the command from below, and from above; degrees."""
    with Running(axis) as running:
        up = [running.go(angle, 1)["motor_deg"] - angle for angle in AT_DEG]
        down = [running.go(angle, -1)["motor_deg"] - angle for angle in AT_DEG[::-1]]
        assert running.errors == []
    return np.array([up, down[::-1]])


def small_waves(angles_deg):
    return -2.0 * ARCSEC * np.sin(np.deg2rad(angles_deg))


def test_a_table_takes_over_what_backlash_did(tmp_path):
    axis = machine(tmp_path / "axis")
    halves = np.array([[PLAY_DEG], [-PLAY_DEG]]) / 2
    assert moved(axis) == pytest.approx(np.tile(halves, 2), abs=1e-6)
    angles = np.arange(0.0, 360.0, 10.0)
    result = Result(
        method="drawn",
        angles=angles * DEGREE,
        deviations={"ECC": small_waves(angles)},
        std={"ECC": np.full(36, 0.01 * ARCSEC)},
        covariance={"ECC": np.eye(36) * (0.01 * ARCSEC) ** 2},
        sigma0=1.0,
        dof=50,
        n_observations=100,
        verdict="ok",
    )
    made = prepare_export(
        table_from_result(result, axis="A"),
        "linuxcnc",
        now=datetime(2026, 1, 2, tzinfo=timezone.utc),
        spacing=10 * DEGREE,
        settings={"first_turn": -1, "turns": 3, "machine_ini": str(axis.ini)},
    )
    axis.take(made)
    wanted = halves - small_waves(np.array(AT_DEG)) / DEGREE
    assert moved(axis) == pytest.approx(wanted, abs=1e-6)


@pytest.mark.parametrize(
    ("section", "lines"),
    [("AXIS_A", {}), ("JOINT_3", {"COMP_FILE": "own.comp", "COMP_FILE_TYPE": 1})],
)
def test_backlash_does_nothing_beside_a_table_and_in_the_section_of_the_axis(
    tmp_path, section, lines
):
    axis = machine(tmp_path / "axis", section, lines)
    (axis.folder / "own.comp").write_text("-360 0 0\n720 0 0\n")
    assert moved(axis) == pytest.approx(0.0, abs=1e-9)
