"""The simulated tracker: true geometry, a person who misses a little, repeatable numbers."""

from dataclasses import replace

import numpy as np
import pytest

from rotcal_ros.foundation.observations import Approach, Command, PointKind
from rotcal_ros.foundation.units import DEGREE
from rotcal_ros.methods.plane_mirror.method import METHOD
from rotcal_ros.methods.plane_mirror.settings import (
    MirrorSimulationSettings,
    SimulatedMirrorSettings,
    TrackerSettings,
)
from rotcal_ros.methods.simulation.settings import AngularHarmonics, TableSettings

EXACT = TrackerSettings(
    station_placing_mm=0.0,
    nest_placing_mm=0.0,
    reflector_placing_mm=0.0,
    range_std_um=1e-6,
    range_std_um_per_m=0.0,
    transverse_std_um=1e-6,
    transverse_std_um_per_m=0.0,
    measure_time_s=0.1,
)
TABLE = TableSettings(ecc=AngularHarmonics(amplitudes_arcsec=(20.0,), phases_deg=(30.0,)))
MIRROR = SimulatedMirrorSettings(centre_m=(0.05, 0.0, 0.35), lean_deg=0.0)
SETTINGS = MirrorSimulationSettings(
    instrument="tracker",
    tracker=EXACT,
    mirror=MIRROR,
    table=replace(TABLE, speed_deg_s=500.0, settling_arcsec=0.0),
)


def order(kind, position, *, step=0, angle=0.0, target=1, station=0, attempt=0):
    return Command(step, attempt, angle, Approach.POSITIVE, kind, target, position, station)


def measure(cell, command, cut_s=0.5):
    """Carry an order out; return its point."""
    cell.order_table(command)
    cell.order_probe(command)
    for _ in range(10_000):
        out = cell.advance(cut_s)
        assert out.tracer == ()
        if out.probe:
            (sample,) = out.probe
            return sample
    raise AssertionError("no point")


def distance(a, b):
    return float(np.linalg.norm(np.array(a.position) - np.array(b.position)))


def test_a_nest_is_seen_from_where_the_tracker_stands():
    """The frame is turned as the tracker happens to be, so distances are what can be compared."""
    cell = METHOD.simulated_cell(SETTINGS)
    places = [(1.0, 1.5, 0.2), (-1.0, 0.7, 0.9), (0.4, -1.2, 0.1)]
    points = [
        measure(cell, order(PointKind.NEST, place, step=n, target=n + 1))
        for n, place in enumerate(places)
    ]
    head = np.array([2.0, 0.0, 0.35])
    for point, place in zip(points, places, strict=True):
        expected = np.linalg.norm(np.array(place) - head)
        assert np.linalg.norm(point.position) == pytest.approx(expected, abs=1e-9)
        assert point.position[2] == pytest.approx(place[2] - 0.35, abs=1e-9)
    assert distance(points[0], points[1]) == pytest.approx(
        float(np.linalg.norm(np.subtract(places[0], places[1]))), abs=1e-9
    )


@pytest.mark.parametrize("angle_deg", [0.0, 2.0])
def test_the_image_is_the_reflector_mirrored_in_the_actual_plane(angle_deg):
    """Closed form: the chord from reflector to image is along the normal, turned by ECC too."""
    cell = METHOD.simulated_cell(SETTINGS)
    angle = angle_deg * DEGREE
    place = (1.2, 0.02, 0.33)
    kinds = (PointKind.DIRECT, PointKind.MIRRORED)
    direct, mirrored = (
        measure(cell, order(kind, place, step=n, angle=angle)) for n, kind in enumerate(kinds)
    )
    ecc = 20.0 / 3600 * DEGREE * np.cos(angle + 30.0 * DEGREE)
    normal = np.array([np.cos(angle + ecc), np.sin(angle + ecc), 0.0])
    # The middle of the mirror is 50 mm from the axis along the normal.
    height = np.array(place) @ normal - 0.05
    assert distance(direct, mirrored) == pytest.approx(2 * height, abs=1e-9)
    assert direct.kind == PointKind.DIRECT
    assert np.linalg.norm(mirrored.position) > np.linalg.norm(direct.position)


def test_a_beam_that_misses_the_mirror_gives_no_number():
    cell = METHOD.simulated_cell(SETTINGS)
    sample = measure(cell, order(PointKind.MIRRORED, (1.2, 1.0, 0.3)))
    assert np.all(np.isnan(sample.position))


def test_a_reflector_stays_between_direct_and_mirrored_and_is_put_up_anew_elsewhere():
    tracker = replace(EXACT, reflector_placing_mm=2.0)
    cell = METHOD.simulated_cell(replace(SETTINGS, tracker=tracker))
    place, other = (1.2, 0.02, 0.33), (1.2, 0.04, 0.33)
    first = measure(cell, order(PointKind.DIRECT, place))
    measure(cell, order(PointKind.MIRRORED, place, step=1))
    again = measure(cell, order(PointKind.DIRECT, place, step=2))
    assert distance(first, again) < 1e-9
    measure(cell, order(PointKind.DIRECT, other, step=3))
    new = measure(cell, order(PointKind.DIRECT, place, step=4))
    assert 1e-4 < distance(first, new) < 2e-2


def test_a_displaced_nest_is_seated_well_at_a_later_attempt():
    tracker = replace(EXACT, displaced_nest=2, displaced_at_stations=(0,), displaced_attempts=1)
    cell = METHOD.simulated_cell(replace(SETTINGS, tracker=tracker))
    place = (1.0, 1.5, 0.2)
    wrong = measure(cell, order(PointKind.NEST, place, target=2))
    right = measure(cell, order(PointKind.NEST, place, target=2, attempt=1))
    assert distance(wrong, right) == pytest.approx(1e-3, rel=1e-6)


def test_reflectors_on_the_table_turn_by_the_actual_angle():
    tracker = replace(EXACT, reflectors_on_table=True)
    cell = METHOD.simulated_cell(replace(SETTINGS, tracker=tracker))
    first = measure(cell, order(PointKind.DIRECT, (0.3, 0.0, 0.1)))
    turned = measure(cell, order(PointKind.DIRECT, (0.0, 0.3, 0.1), step=1, angle=np.pi / 2))
    ecc = 20.0 / 3600 * DEGREE * np.cos(np.array([30.0, 120.0]) * DEGREE)
    turn = np.pi / 2 + ecc[1] - ecc[0]
    assert distance(first, turned) == pytest.approx(2 * 0.3 * np.sin(turn / 2), abs=1e-9)


def test_points_scatter_as_stated_and_do_not_depend_on_the_cuts():
    noisy = replace(EXACT, range_std_um=3.0, transverse_std_um=30.0)
    place = (0.0, 1.5, 0.2)

    def run(cut_s):
        cell = METHOD.simulated_cell(replace(SETTINGS, tracker=noisy))
        orders = [order(PointKind.NEST, place, step=n) for n in range(300)]
        return np.array([measure(cell, command, cut_s).position for command in orders])

    points = run(0.3)
    np.testing.assert_array_equal(points, run(0.7))
    middle = points.mean(axis=0)
    beam = middle / np.linalg.norm(middle)
    along = (points - middle) @ beam
    across = points - middle - np.outer(along, beam)
    assert along.std() == pytest.approx(3e-6, rel=0.15)
    assert np.sqrt((across**2).sum(axis=1).mean() / 2) == pytest.approx(30e-6, rel=0.1)
