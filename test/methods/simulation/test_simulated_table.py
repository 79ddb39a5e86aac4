"""The table's deviations and poses against closed forms and first-order theory."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from rotcal_ros.foundation.components import COMPONENTS
from rotcal_ros.foundation.observations import Approach
from rotcal_ros.methods.simulation.settings import AngularHarmonics, LinearHarmonics, TableSettings
from rotcal_ros.methods.simulation.table import (
    SimulatedTable,
    deviations,
    harmonics,
    rotations,
    table_poses,
    true_deviations,
)

ARCSEC = np.pi / 180 / 3600
ANGLES = np.deg2rad([-145.0, -20.0, 0.0, 75.0, 400.0])
SETTINGS = TableSettings(
    exc=LinearHarmonics(amplitudes_um=(3.0, 1.0), phases_deg=(10.0, 20.0)),
    eyc=LinearHarmonics(amplitudes_um=(2.0,), phases_deg=(-50.0,)),
    ezc=LinearHarmonics(amplitudes_um=(0.0, 1.5), phases_deg=(0.0, 33.0)),
    eac=AngularHarmonics(amplitudes_arcsec=(1.0,), phases_deg=(5.0,)),
    ebc=AngularHarmonics(amplitudes_arcsec=(0.5, 0.2), phases_deg=(0.0, 15.0)),
    ecc=AngularHarmonics(amplitudes_arcsec=(4.0, 1.0), phases_deg=(70.0, -8.0)),
)


def test_harmonics_are_the_sum_they_say():
    series = LinearHarmonics(amplitudes_um=(2.0, 0.0, 0.5), phases_deg=(30.0, 0.0, -90.0))
    expected = 2e-6 * np.cos(ANGLES + np.pi / 6) + 0.5e-6 * np.sin(3 * ANGLES)
    assert harmonics(series, ANGLES) == pytest.approx(expected, abs=1e-20)


def test_missing_phases_are_zero():
    series = AngularHarmonics(amplitudes_arcsec=(2.0, 1.0), phases_deg=(90.0,))
    expected = ARCSEC * (-2 * np.sin(ANGLES) + np.cos(2 * ANGLES))
    assert harmonics(series, ANGLES) == pytest.approx(expected, abs=1e-18)


def test_rotations_agree_with_scipy():
    rng = np.random.default_rng(0)
    rx, ry, rz = rng.uniform(-3, 3, (3, 20))
    expected = Rotation.from_euler("xyz", np.column_stack([rx, ry, rz])).as_matrix()
    assert rotations(rx, ry, rz) == pytest.approx(expected, abs=1e-14)


def test_pose_is_nominal_plus_small_motions_about_the_fixed_axes():
    """To first order p = p0 + c x p0 + d, with c = (EAC, EBC, ECC), d = (EXC, EYC, EZC)."""
    point = np.array([0.1, -0.2, 0.3])
    rotation, translation = table_poses(SETTINGS, ANGLES)
    moved = rotation @ point + translation
    cosine, sine = np.cos(ANGLES), np.sin(ANGLES)
    x, y = cosine * 0.1 + sine * 0.2, sine * 0.1 - cosine * 0.2
    nominal = np.column_stack([x, y, np.full(5, 0.3)])
    error = deviations(SETTINGS, ANGLES)
    c = np.column_stack([error[name] for name in ("EAC", "EBC", "ECC")])
    d = np.column_stack([error[name] for name in ("EXC", "EYC", "EZC")])
    assert moved - nominal == pytest.approx(np.cross(c, nominal) + d, abs=1e-9)
    assert np.abs(moved - nominal).max() > 3e-6


def test_axis_offset_and_tilt_move_the_whole_table():
    settings = TableSettings(axis_offset_m=(1e-3, 2e-3, 3e-3), axis_tilt_arcsec=(20.0, -30.0))
    rotation, translation = table_poses(settings, ANGLES)
    axis = rotation @ np.array([0.0, 0.0, 1.0])
    assert axis == pytest.approx(
        np.tile([-30 * ARCSEC, -20 * ARCSEC, 1.0], (5, 1)), abs=1e-7
    )  # about x by a: z goes to -y a; about y by b: z goes to +x b
    assert translation == pytest.approx(np.tile([1e-3, 2e-3, 3e-3], (5, 1)))


def test_truth_is_relative_to_the_first_angle_only_for_the_angle():
    true, raw = true_deviations(SETTINGS, ANGLES), deviations(SETTINGS, ANGLES)
    assert set(true) == set(COMPONENTS)
    assert true["ECC"][0] == 0
    assert true["ECC"] == pytest.approx(raw["ECC"] - raw["ECC"][0])
    assert true["EXC"] == pytest.approx(raw["EXC"])


def run(table, angle, approach, now=0):
    table.order(now, angle, approach)
    stamps = np.arange(now, table.rest_ns + 2_000_000_000, 1_000_000)
    return stamps, table.angles(stamps)


@pytest.mark.parametrize("target", [0.5, -0.5, 0.0])
@pytest.mark.parametrize("approach", [Approach.POSITIVE, Approach.NEGATIVE])
def test_the_angle_is_approached_from_the_ordered_side(target, approach):
    table = SimulatedTable(TableSettings(settling_arcsec=0.0), 1, 0)
    run(table, -0.001, Approach.NEGATIVE)
    _, angles = run(table, target, approach, table.rest_ns)
    assert angles[-1] == target
    before_last_motion = angles[np.flatnonzero(angles != target)[-1]]
    assert (before_last_motion < target) == (approach == Approach.POSITIVE)


def test_an_order_to_stay_moves_nothing():
    table = SimulatedTable(TableSettings(), 1, 0)
    run(table, 0.3, Approach.POSITIVE)
    rest = table.rest_ns
    _, angles = run(table, 0.3, Approach.POSITIVE, rest + 10_000_000_000)
    assert np.ptp(angles) < 1e-12


def test_backlash_adds_to_the_angle_from_above_only():
    point = np.array([1.0, 0.0, 0.0])
    heights = []
    for approach in (Approach.POSITIVE, Approach.NEGATIVE):
        table = SimulatedTable(TableSettings(backlash_arcsec=10.0), 1, 0)
        stamps, _ = run(table, 0.0, Approach.NEGATIVE)
        stamps, _ = run(table, 0.0, approach, int(stamps[-1]))
        rotation, _ = table.poses(stamps[-1:])
        heights.append((rotation @ point)[0, 1])
    assert heights == pytest.approx([0.0, 10 * ARCSEC], abs=1e-9)


def test_repeatability_changes_with_each_arrival():
    table = SimulatedTable(TableSettings(repeatability_arcsec=5.0), 1, 0)
    errors, now = [], 0
    for number in range(400):
        stamps, _ = run(table, 0.01 * (number % 2), Approach.POSITIVE, now)
        now = int(stamps[-1])
        rotation, _ = table.poses(stamps[-1:])
        errors.append(np.arctan2(rotation[0, 1, 0], rotation[0, 0, 0]) - 0.01 * (number % 2))
    assert np.std(errors) == pytest.approx(5 * ARCSEC, rel=0.15)
    assert np.mean(errors) == pytest.approx(0.0, abs=1 * ARCSEC)


def test_a_stopped_table_stands_where_it_was_and_goes_on_only_when_ordered():
    table = SimulatedTable(TableSettings(speed_deg_s=10.0, acceleration_deg_s2=1e6), 1, 0)
    table.order(0, np.pi / 2, Approach.POSITIVE)
    at_ns = 3_000_000_000
    table.stop(at_ns)
    later = np.array([at_ns, at_ns + 60_000_000_000])
    assert np.rad2deg(table.angles(later)) == pytest.approx([30.0, 30.0], abs=0.01)
    assert table.rest_ns == at_ns
    table.order(at_ns, np.pi / 2, Approach.POSITIVE)
    assert table.rest_ns == pytest.approx(9_000_000_000, abs=1_000_000)
