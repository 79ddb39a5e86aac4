"""What disturbs a measurement is physics that can be checked by hand, and nothing else changes."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from chances import LONG, most

from rotcal_ros.evaluation.power import PowerBench
from rotcal_ros.foundation.observations import PointKind
from rotcal_ros.foundation.protection import EFFECTS, PARTICULAR
from rotcal_ros.foundation.units import ARCSEC
from rotcal_ros.methods import changed, prepare, read_configuration

PLANS = Path(__file__).parents[2] / "research" / "power_plans"
METHODS = ("tracer", "ball_plate", "plane_mirror", "tracer_six")
each_method = pytest.mark.parametrize("name", METHODS)


TURNING = "tracer_turning"
"""The plan of the tracer for a table that turns: 24 angles in both directions."""


def calibration(name):
    if name != TURNING:
        return prepare(read_configuration(PLANS / f"{name}.yaml"))
    turns = (
        "plan.turning_deg_s=[12.0, -12.0]",
        "plan.table_step_deg=15.0",
        "plan.table_positions=24",
    )
    return prepare(changed(read_configuration(PLANS / "tracer.yaml"), turns))


def calm(name):
    """A calibration whose uncertainty holds nothing that the undisturbed simulation lacks."""
    given = read_configuration(PLANS / f"{name}.yaml")
    if name == "plane_mirror":
        given = replace(given, solver=replace(given.solver, uneven_drift_std_arcsec=0.0))
    return prepare(given)


def change(prepared, effect, size, seed=3):
    """Return what an effect changes in the values (n, k), the noise being the same."""
    values = [
        np.array([o.mean for o in prepared.measured(sizes, seed).observations])
        for sizes in ({}, {effect: size})
    ]
    return values[1] - values[0], values[0]


@pytest.mark.parametrize("name", [*METHODS, TURNING])
def test_every_effect_is_there_once_and_none_of_it_is_nothing(name):
    prepared = calibration(name)
    listed = PowerBench(prepared, 1).listed()
    assert sorted(d.effect for d in listed if d.effect not in PARTICULAR) == sorted(EFFECTS)
    for d in listed:
        nothing = 1.0 if d.effect == "axis noise" else 0.0
        assert not np.any(change(prepared, d.effect, nothing)[0]), d.effect
        something = change(prepared, d.effect, d.start * d.unit_si)[0]
        assert np.any(something) != (name == "ball_plate" and d.effect == "refraction"), d.effect


@pytest.mark.slow
@each_method
def test_noise_follows_the_seed_and_the_undisturbed_result_agrees_with_the_truth(name):
    prepared = calm(name)
    first, again, other = (prepared.measured({}, seed) for seed in (5, 5, 6))
    assert first.observations == again.observations
    assert first.observations != other.observations
    squares, doubts, runs = [], 0, 20 if LONG else 4
    for seed in range(runs):
        measured = prepared.measured({}, seed)
        result = prepared.solve(measured.observations)
        doubts += result.verdict != "ok"
        for component in result.components:
            known = result.std[component] > 0.0
            off = result.deviations[component] - measured.truth[component]
            squares.append(np.mean((off[known] / result.std[component][known]) ** 2))
    assert np.mean(squares) == pytest.approx(1.0, abs=0.35 * np.sqrt(20 / runs))
    assert doubts <= most(0.02, runs)


def test_a_tracer_is_knocked_half_way_and_the_machine_drifts_from_nothing():
    prepared = calibration("tracer")
    knocked, _ = change(prepared, "knock", 1e-6)
    half = len(knocked) // 2
    assert not np.any(knocked[:half])
    assert 0.1e-6 < np.sqrt(np.mean(knocked[half:] ** 2)) < 1e-6
    drifted, _ = change(prepared, "drift", 1e-6)
    assert drifted[0] == 0.0
    # The beam goes mostly upwards: the length grows with the drift's part along it.
    step = prepared.plan.steps[-1]
    mount = np.array(prepared.configuration.simulation.tracer.mount_m)
    angle = step.table_angle
    turn = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
    beam = np.array(step.position) - np.array([*(turn @ mount[:2]), mount[2]])
    expected = 1e-6 * beam.sum() / np.sqrt(3.0) / np.linalg.norm(beam)
    assert drifted[-1, 0] == pytest.approx(expected, rel=1e-4)


def test_a_zero_jumps_in_one_turn_and_a_late_feedback_turns_each_speed_alike():
    prepared = calibration(TURNING)
    slipped, _ = change(prepared, "slip", 1e-6)
    jumped = np.flatnonzero(slipped[:, 0])
    assert np.ptp(jumped) == len(jumped) - 1 < 24
    np.testing.assert_allclose(slipped[jumped], 1e-6, atol=1e-15)
    assert prepared.plan.passed_from(int(jumped[0])).stop == jumped[-1] + 1
    late, _ = change(prepared, "lag", 1e-3)
    mount = np.array(prepared.configuration.simulation.tracer.mount_m)
    at_rest = [step.turn is None for step in prepared.plan.steps]
    assert not np.any(late[at_rest])
    for step, by in zip(prepared.plan.steps, late[:, 0], strict=True):
        speed = 0.0 if step.turn is None else step.turn.speed
        lengths = []
        for angle in (step.table_angle, step.table_angle + 1e-3 * speed):
            c, s = np.cos(angle), np.sin(angle)
            at = [c * mount[0] - s * mount[1], s * mount[0] + c * mount[1], mount[2]]
            lengths.append(np.linalg.norm(np.array(step.position) - at))
        assert by == pytest.approx(lengths[1] - lengths[0], abs=2e-9)  # the target's own error


def test_a_tracer_shifted_along_its_circle_reads_as_a_table_that_turns_further():
    prepared = calibration("tracer")
    size, mount = 1e-6, np.array(prepared.configuration.simulation.tracer.mount_m)
    shifted, _ = change(prepared, "tangential motion", size)
    for step, by in zip(prepared.plan.steps, shifted[:, 0], strict=True):
        further = step.table_angle + size * np.cos(2 * step.table_angle) / np.hypot(*mount[:2])
        lengths = []
        for angle in (step.table_angle, further):
            turn = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
            at = np.array([*(turn @ mount[:2]), mount[2]])
            lengths.append(np.linalg.norm(np.array(step.position) - at))
        assert by == pytest.approx(lengths[1] - lengths[0], abs=2e-9)  # the target's own error


def test_a_tracer_with_a_wrong_scale_and_in_air_with_a_gradient():
    prepared = calibration("tracer")
    dead = prepared.configuration.simulation.tracer.dead_distance_m
    scaled, lengths = change(prepared, "scale", 2e-6)
    np.testing.assert_allclose(scaled, 2e-6 * (lengths + dead), atol=2e-12)
    bent, lengths = change(prepared, "refraction", 1e-6)
    height = np.array([step.position[2] for step in prepared.plan.steps])
    expected = 1e-6 * 0.5 * (height - height.mean()) * (lengths[:, 0] + dead)
    np.testing.assert_allclose(bent[:, 0], expected, atol=5e-12)


def test_two_fifths_of_one_stations_beams_are_too_long_in_one_sector():
    prepared = calibration("tracer")
    longer, _ = change(prepared, "one place", 1e-6)
    steps = np.array(prepared.plan.steps, dtype=object)[longer[:, 0] != 0.0]
    np.testing.assert_allclose(longer[longer != 0.0], 1e-6, atol=1e-12)
    (position,) = {step.table_position for step in steps}
    mine = [step for step in prepared.plan.steps if step.table_position == position]
    assert len(steps) == round(0.4 * len(mine))


def test_a_leaning_table_moves_the_tracer_by_its_height():
    """0.3 arcsec of tilt at 0.12 m: 0.18 um sideways, seen by lengths to all sides."""
    prepared = calibration("tracer")
    tilted, _ = change(prepared, "tilt", 0.3 * ARCSEC)
    height = prepared.configuration.simulation.tracer.mount_m[2]
    assert 0.1 * height * 0.3 * ARCSEC < np.std(tilted) < height * 0.3 * ARCSEC


def test_the_table_of_a_ball_plate_moves_as_its_truth_says():
    prepared = calibration("ball_plate")
    measured = prepared.measured({"error motion": 1e-6}, 2)
    moved, _ = change(prepared, "error motion", 1e-6, seed=2)
    for k, step in enumerate(prepared.plan.steps):
        x, y = (measured.truth[name][step.table_position] for name in ("EXC", "EYC"))
        np.testing.assert_allclose(moved[k], [x, y, 0.0], atol=1e-15)
    turned, _ = change(prepared, "repeatability", 1.0 * ARCSEC)
    table = np.array([step.table_angle for step in prepared.plan.steps])
    along = np.linalg.norm(turned, axis=1) / (0.185 * ARCSEC)
    stays = np.flatnonzero(np.diff(table) == 0.0)  # one turn for all balls of an arrival
    np.testing.assert_allclose(along[stays + 1], along[stays], rtol=1e-3)
    comes = np.flatnonzero(np.diff(table) != 0.0)
    assert np.all(np.abs(along[comes + 1] - along[comes]) > 1e-4)


def test_a_plate_is_knocked_between_two_positions_and_turned_at_its_circle():
    prepared = calibration("ball_plate")
    knocked, _ = change(prepared, "knock", 1e-6)
    half = len(knocked) // 2
    assert not np.any(knocked[:half])
    # A shift of 1 um, and a turn whose part about z moves every ball by 1 um / sqrt(3).
    size = np.linalg.norm(knocked[half:], axis=1)
    assert size.min() > 0.5e-6
    assert size.max() < 2.0e-6


def test_a_leaning_axis_with_a_plate_off_centre():
    prepared = calibration("ball_plate")
    lean = 1e-3
    moved, centres = change(prepared, "gauge", lean)
    angle = np.array([step.table_angle for step in prepared.plan.steps])
    off = 0.5 * lean * np.column_stack([np.cos(angle), np.sin(angle), 0.0 * angle])
    expected = off + lean * np.column_stack([0.0 * angle, 0.0 * angle, centres[:, 1]])
    np.testing.assert_allclose(moved, expected, atol=1.5e-6)  # second order: 0.2 m x 1e-6 and more


def test_a_tracker_turns_while_it_stands_and_sees_bent_beams():
    prepared = calibration("plane_mirror")
    steps = prepared.plan.steps
    turned, seen = change(prepared, "drift", 3.0 * ARCSEC)
    station = np.array([step.station for step in steps])
    for s in np.unique(station):
        first, *_, last = np.flatnonzero(station == s)
        assert not np.any(turned[first])
        x, y, _ = seen[last]
        expected = 3.0 * ARCSEC * np.array([-y, x, 0.0])
        np.testing.assert_allclose(turned[last], expected, atol=2e-9)
    bent, seen = change(prepared, "refraction", 1e-6)
    distance = np.linalg.norm(seen, axis=1)
    sideways = np.sqrt(1.0 - (seen[:, 0] / distance) ** 2)
    np.testing.assert_allclose(
        np.linalg.norm(bent, axis=1), 0.5e-6 * distance**2 * sideways, rtol=1e-3
    )
    np.testing.assert_allclose(np.sum(bent * seen, axis=1) / distance, 0.0, atol=1e-10)


def test_a_mirror_that_leans_or_was_knocked_changes_images_only():
    prepared = calibration("plane_mirror")
    image = np.array([step.kind is PointKind.MIRRORED for step in prepared.plan.steps])
    for effect in ("knock", "tilt", "repeatability", "error motion", "gauge"):
        moved, _ = change(prepared, effect, 1e-5)
        assert not np.any(moved[~image]), effect
    knocked, _ = change(prepared, "knock", 30.0 * ARCSEC)
    assert not np.any(knocked[: len(image) // 2])
    # Turned about z by a, a mirror moves an image sideways by 2 a times its distance from there.
    sizes = np.linalg.norm(knocked[len(image) // 2 :][image[len(image) // 2 :]], axis=1)
    assert np.all(sizes < 2.0 * 30.0 * ARCSEC * 1.7)
    assert np.all(sizes > 30.0 * ARCSEC * 1.0)


def test_a_scale_of_the_tracker_lengthens_beams():
    prepared = calibration("plane_mirror")
    longer, seen = change(prepared, "scale", 1e-5)
    np.testing.assert_allclose(longer, 1e-5 * seen, atol=1e-9)
    wide, _ = change(prepared, "axis noise", 3.0)
    beam = seen / np.linalg.norm(seen, axis=1)[:, None]
    np.testing.assert_allclose(np.sum(wide * beam, axis=1), 0.0, atol=1e-9)
