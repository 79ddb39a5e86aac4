"""The machine that touches balls: physics, and the same samples however time is cut."""

from dataclasses import replace

import numpy as np
import pytest

from rotcal_ros.capture.settings import CaptureSettings
from rotcal_ros.capture.touched_ball import fitted_centre
from rotcal_ros.foundation.observations import Approach, Command, PointKind
from rotcal_ros.foundation.units import ARCSEC
from rotcal_ros.methods.ball_plate.method import METHOD
from rotcal_ros.methods.ball_plate.settings import (
    TOUCH_PROBE,
    PlateSimulationSettings,
    SimulatedPlateSettings,
    TouchProbeSettings,
)
from rotcal_ros.methods.ball_plate.simulation import MachineError, plate_balls, upper_half
from rotcal_ros.methods.simulation.settings import LinearHarmonics, TableSettings
from rotcal_ros.planning.plan import Step

EXACT = PlateSimulationSettings(
    instrument=TOUCH_PROBE,
    table=TableSettings(settling_arcsec=0.0, exc=LinearHarmonics(amplitudes_um=(3.0,))),
    plate=SimulatedPlateSettings(grid=12, ball_steps=(0, 3, 5), manufacture_um=0.0),
    touch_probe=TouchProbeSettings(systematic_um=0.0, noise_um=0.0),
)
ORDER = Command(0, 0, np.pi / 2, Approach.POSITIVE, PointKind.SURFACE, 0, (0.0, 0.185, 0.0))


def touches(settings, order=ORDER, cut_s=100.0):
    cell = METHOD.simulated_cell(settings)
    cell.order_table(order)
    cell.order_probe(order)
    found = []
    while cell.now_ns < 100_000_000_000:
        out = cell.advance(cut_s)
        assert out.tracer == ()
        found += out.probe
    return found


def test_touches_lie_on_the_turned_ball_with_the_radius_of_the_tip():
    found = touches(EXACT)
    assert [s.point for s in found] == list(range(15))
    assert {(s.kind, s.target, s.tip_radius) for s in found} == {(PointKind.SURFACE, 0, 0.0015)}
    # ball 0 at 90 degrees; EXC = 3 um cos(90 deg) = 0 there
    away = np.array([s.position for s in found]) - [0.0, 0.185, 0.0]
    assert np.allclose(np.linalg.norm(away, axis=1), 0.0125 + 0.0015, atol=1e-15)
    assert (away[:, 2] > 0).all()
    stamps = np.diff([s.stamp_ns for s in found])
    assert (stamps == 1_500_000_000).all()


def test_a_centre_is_told_at_once_and_shows_the_table():
    order = replace(ORDER, table_angle=0.0, kind=PointKind.CENTRE, position=(0.185, 0.0, 0.0))
    (sample,) = touches(EXACT, order)
    assert sample.position == pytest.approx((0.185 + 3e-6, 0.0, 0.0), abs=1e-15)


@pytest.mark.parametrize("cut_s", [0.013, 0.5, 7.0])
def test_the_cut_of_time_changes_nothing(cut_s):
    noisy = replace(EXACT, touch_probe=TouchProbeSettings(dirt_probability=0.2))
    assert touches(noisy, cut_s=cut_s) == touches(noisy)


def test_the_plate_is_made_and_clamped_as_set():
    settings = SimulatedPlateSettings(
        grid=4, ball_steps=(0, 1), manufacture_um=0.0, clamping_shift_um=(1.0, 2.0, 3.0),
        clamping_turn_arcsec=(0.0, 10.0, 20.0), circle_radius_m=0.2,
    )  # fmt: skip
    first, second = plate_balls(settings, 0)
    shift = np.array([1e-6, 2e-6, 3e-6])
    turn = np.array([0.0, 10 * ARCSEC, 20 * ARCSEC])
    for ball, place in ((first, [0.2, 0.0, 0.0]), (second, [0.0, 0.2, 0.0])):
        moved = np.array(place) + np.cross(turn, place) + shift
        assert ball == pytest.approx(moved, abs=2e-9)
    rough = replace(settings, ball_steps=tuple(range(4)), manufacture_um=5.0)
    assert np.std(plate_balls(rough, 0) - plate_balls(replace(rough, manufacture_um=0), 0)) > 1e-6


def test_the_machine_error_is_a_smooth_field_of_the_stated_size():
    error = MachineError(TouchProbeSettings(systematic_um=2.0), 5)
    places = np.random.default_rng(0).uniform(-5, 5, (4000, 3))
    assert np.std(error(places), axis=0) == pytest.approx([2e-6] * 3, rel=0.1)
    assert (error(places) == error(places)).all()
    assert np.abs(error(places + 1e-4) - error(places)).max() < 0.1e-6


def test_touch_directions_cover_the_upper_half():
    directions = upper_half(15)
    assert np.allclose(np.linalg.norm(directions, axis=1), 1.0)
    assert np.abs(directions[:, :2].mean(axis=0)).max() < 0.05
    assert directions[:, 2].mean() == pytest.approx(0.5)


def test_touch_points_tell_a_z_of_the_wrong_sign():
    samples = touches(EXACT)
    step = Step(0, 0, np.pi / 2, Approach.POSITIVE, PointKind.SURFACE, 0, (0.0, 0.185, 0.0),
                n_points=15, ball_diameter=EXACT.plate.ball_diameter_m)  # fmt: skip
    assert fitted_centre(samples, step, CaptureSettings()).reason is None
    mirrored = [replace(s, position=(*s.position[:2], -s.position[2])) for s in samples]
    reason = fitted_centre(mirrored, step, CaptureSettings()).reason
    assert "below the centre" in reason
    assert "z of the probe has the wrong sign" in reason
