"""From touches to six curves without ROS: truth, gauge, selection, and set-up mistakes."""

import re
from dataclasses import dataclass, replace

import numpy as np
import pytest
from plate_cell import measure, simulated_cell, small

from rotcal_ros.evaluation.ways import describe_evaluations, evaluate, setting_combinations
from rotcal_ros.foundation.components import COMPONENTS
from rotcal_ros.foundation.errors import (
    ConfigurationError,
    DataError,
    ObservabilityError,
    PlanError,
)
from rotcal_ros.foundation.observations import PointKind
from rotcal_ros.methods import changed
from rotcal_ros.methods.ball_plate.method import problem
from rotcal_ros.methods.simulation.table import true_deviations


@dataclass(frozen=True)
class Data:
    calibration: object
    observations: tuple


def errors_in_std(calibration, result):
    injected = true_deviations(calibration.configuration.simulation.table, result.angles)
    truth = calibration.method.gauge(result.angles, injected)
    return {n: (result.deviations[n] - truth[n]) / result.std[n] for n in COMPONENTS}


@pytest.mark.slow
def test_six_curves_are_true_within_their_uncertainties(measured):
    calibration, observations = measured
    assert all(o.accepted for o in observations), [o.reason for o in observations]
    result = calibration.solve(observations)
    assert result.verdict == "ok", result.warnings
    assert set(result.deviations) == set(COMPONENTS)
    for name, error in errors_in_std(calibration, result).items():
        assert np.abs(error).max() < 4.5, name
        assert np.sqrt(np.mean(error**2)) < 2.0, name
        assert np.ptp(result.deviations[name]) > 10 * result.std[name].max(), name  # seen at all
    # 15 touches of 0.15 um on the upper half, known radius: about 0.15 um sqrt(3/15)
    assert result.details["sigma_axes"] == pytest.approx(0.15e-6 * np.sqrt(3 / 15), rel=0.3)


def test_machine_and_plate_errors_are_those_injected(measured):
    calibration, observations = measured
    (group,) = calibration.solve(observations).details["groups"]
    machine = np.array(group["cmm_errors"])
    cell = simulated_cell(calibration)
    places = np.array(calibration.plan.targets)
    injected = cell.instrument._error(places)
    angle = 2 * np.pi * np.arange(12) / 12
    # what Eq. 15 leaves of them: no shift, no rotation, no scale
    columns = [np.tile(e, (12, 1)) for e in np.eye(3)]
    columns += [np.cross(e, places) for e in np.eye(3)]
    columns.append(np.column_stack([np.cos(angle), np.sin(angle), 0 * angle]))
    design = np.array([c.ravel() for c in columns]).T
    rest = injected.ravel() - design @ np.linalg.lstsq(design, injected.ravel(), rcond=None)[0]
    error = (machine.ravel() - rest) / np.array(group["cmm_errors_std"]).ravel()
    assert np.abs(error).max() < 4.5
    assert np.ptp(machine) > 0.5e-6


def test_angles_are_those_of_the_table_wherever_it_starts(measured):
    calibration, observations = measured
    first = calibration.solve(observations)
    turned = small("plan.table_start_deg=-75.0")
    assert turned.plan.table_angles[0] == pytest.approx(np.radians(-75))
    result = turned.solve(observations)
    assert np.allclose(result.angles - first.angles, np.radians(-75))
    assert (result.deviations["ECC"] == first.deviations["ECC"]).all()


def test_surface_and_centre_measurements_agree():
    calibration = small("plan.measure=centre")
    observations = measure(calibration)
    assert {o.kind for o in observations} == {PointKind.CENTRE}
    result = calibration.solve(observations)
    for name, error in errors_in_std(calibration, result).items():
        assert np.abs(error).max() < 4.5, name


@pytest.mark.slow
def test_attempts_and_order_do_not_change_a_bit(measured):
    calibration, observations = measured
    first = calibration.solve(observations)
    again = calibration.solve(reversed(measure(calibration, turn_s=0.37, order=reversed_streams)))
    # They were made at another time, when it was warmer.
    assert replace(again, circumstances=first.circumstances).to_json() == first.to_json()


def reversed_streams(records):
    """Let the streams arrive the other way round, each in its own order."""
    return sorted(records, key=lambda record: type(record).__name__, reverse=True)


def test_nothing_and_too_little_are_refused(measured):
    calibration, observations = measured
    with pytest.raises(DataError, match="no ball was measured"):
        calibration.solve(())
    with pytest.raises(ObservabilityError, match="at 7 table positions fewer than 3 balls"):
        calibration.solve(observations[:30])


def test_several_evaluations_of_the_same_data(measured):
    calibration, observations = measured
    data = Data(calibration, observations)
    whole, five = evaluate(
        data.calibration, data.observations, setting_combinations(["all", "0,1,3,5,8"], [])
    )
    assert (whole.name, five.name) == ("all data", "balls=[0,1,3,5,8]")
    assert (whole.result.n_observations, five.result.n_observations) == (78, 65)
    for name in COMPONENTS:
        between = np.abs(five.result.deviations[name] - whole.result.deviations[name]).max()
        assert five.differences[name] == pytest.approx(between, rel=1e-9)
        assert between < 5 * five.result.std[name].max()
    lines = describe_evaluations([whole, five])
    assert lines[0].startswith("all data: 78 observations")
    assert len(lines) == 2 * 7
    with pytest.raises(PlanError, match=r"ball steps \[2\] were not measured"):
        evaluate(data.calibration, data.observations, setting_combinations(["0,1,2,3,5"], []))
    with pytest.raises(PlanError, match="5 times coarser"):
        evaluate(data.calibration, data.observations, setting_combinations([], [5]))


def test_a_coarser_evaluation_is_compared_at_its_own_angles():
    calibration = small("plan.plate.ball_steps=[0, 2, 4, 6, 8, 10, 1]")
    rows = [(i, j) for j in (0, 2, 4, 6, 8, 10, 1) for i in range(12)]
    configuration = changed(calibration.configuration, ("solver.coarser=2",))
    plan = calibration.plan
    observations = measure(small(), steps=1) * len(rows)
    rng = np.random.default_rng(1)
    observations = [
        replace(o, step=n, table_position=i, target=j,
                mean=tuple(plan.targets[(i + j) % 12] + 1e-7 * rng.normal(size=3)))
        for n, (o, (i, j)) in enumerate(zip(observations, rows, strict=True))
    ]  # fmt: skip
    result = replace(calibration, configuration=configuration).solve(observations)
    assert np.allclose(result.angles, np.radians(60) * np.arange(6))
    assert result.n_observations == 36
    assert problem(calibration.configuration, plan, observations).grid == 12


@pytest.mark.parametrize(
    ("change", "text"),
    [
        ("simulation.plate.azimuth_deg=30.0", "mm from its planned place"),
        ("simulation.plate.clamping_turn_arcsec=[648000.0, 0.0, 0.0]", "mounted shifted or"),
        ("simulation.plate.ball_diameter_m=0.0254", r"diameter 25\.(39|40)"),
        ("simulation.touch_probe.tip_radius_m=0.0", ""),
        ("simulation.touch_probe.points_per_ball=9", "only 9 of 15 probe points"),
        ("simulation.touch_probe.noise_um=20.0", "form deviation"),
        ("simulation.touch_probe.dirt_probability=0.5", "um"),
        ("simulation.plate.circle_radius_m=0.19", r" (4\.99|5\.0)\d* mm from its planned place"),
        ("plan.centre_m=[0.0, 0.0, 0.1]", r" (99\.9\d|100) mm from its planned place"),
    ],
)
def test_a_wrong_set_up_is_rejected_at_the_first_ball(change, text):
    (observation,) = measure(small(change), steps=1)
    if text:
        assert not observation.accepted
        assert re.search(text, observation.reason)
    else:  # the tip is given by the machine, so another one is no mistake
        assert observation.accepted


def test_a_little_dirt_is_left_out():
    calibration = small("simulation.touch_probe.dirt_probability=0.04")
    observations = measure(calibration, steps=20)
    good = [o for o in observations if o.accepted]
    assert len(good) >= 16  # two dirty touches hide each other: measured again
    assert 12 <= min(o.n_used for o in good) < 15
    clean = {o.step: o.mean for o in measure(small(), steps=20)}
    away = [np.abs(np.array(o.mean) - clean[o.step]).max() for o in good]
    assert max(away) < 0.5e-6  # 8 um of dirt under one touch of 15 would shift by 1.6 um


@pytest.mark.parametrize(
    ("change", "text"),
    [
        ("plan.plate.ball_steps=[0, 1, 1, 5]", "named twice"),
        ("plan.plate.circle_radius_m=185.0", "looks like millimetres"),
        ("plan.cmm_positions=[0, 99]", "must lie in 0..11"),
        ("plan.rounds=50", "cannot be shared out"),
        ("plan.plate.grid=two", "expected int"),
        ("plan.points_per_ball=4", "out of range 5 to 1000"),
        ("simulation.touch_probe.points_per_ball=4", "out of range 5 to 1000"),
        ("plan.plate.grid=36001", "out of range 3 to 36000"),
        ("simulation.plate.grid=36001", "out of range 3 to 36000"),
    ],
)
def test_an_impossible_plan_is_refused(change, text):
    with pytest.raises((ConfigurationError, PlanError), match=text):
        small(change)


@pytest.mark.slow
def test_the_solver_estimates_a_drift_in_the_time_of_the_centres():
    """A cell without drift: its centres are shifted by a drift in time, with a long pause."""
    changes = ("plan.order=interleaved", "plan.rounds=3", "solver.drift=linear")
    calibration = small(*changes)
    observations = list(measure(calibration))
    pause = 3600 * 10**9
    half = len(observations) // 2
    late = [
        replace(o, window_end_ns=o.window_end_ns + pause) if n >= half else o
        for n, o in enumerate(observations)
    ]
    times = np.array([o.window_end_ns for o in late], dtype=float)
    share = (times - times[0]) / (times[-1] - times[0])
    shifted = [
        replace(o, mean=(o.mean[0], o.mean[1] + 2e-6 * s, o.mean[2]))
        for o, s in zip(late, share.tolist(), strict=True)
    ]
    without, found = calibration.solve(late), calibration.solve(shifted)
    difference = np.subtract(*(r.details["origin_drift"]["amount"][0] for r in (found, without)))
    np.testing.assert_allclose(difference, [0.0, 2e-6, 0.0], atol=1e-10)
    for name in COMPONENTS:
        np.testing.assert_allclose(
            found.deviations[name], without.deviations[name], atol=1e-9 * found.std[name].max()
        )
    assert found.protections[0].treatment == "estimated"
    with pytest.raises(ConfigurationError, match="drift"):
        small("solver.drift=cubic")


@pytest.mark.slow
def test_a_stated_drift_is_in_the_budget():
    hidden = ("plan.order=table_once", "plan.closing=false")
    plain = small(*hidden)
    observations = measure(plain)
    less = plain.solve(observations)
    more = small(*hidden, "solver.drift_allowance_m=1.0e-6").solve(observations)
    assert "drift" in less.unprotected
    assert "drift" not in more.unprotected
    assert more.std["EZC"].max() > 2.0 * less.std["EZC"].max()


def test_touches_tell_which_way_z_points_and_feedback_the_positions(measured):
    """Captured, both are known; centres in a table give neither."""
    calibration, captured = measured
    found = {p.effect: p.treatment for p in calibration.solve(captured).protections}
    assert found["sign of z"] == found["numbering"] == "harmless"
    centres = calibration.solve([replace(o, kind=PointKind.CENTRE) for o in captured])
    assert "sign of z" in centres.unprotected
    assert "numbering" not in centres.unprotected
    written = [replace(o, window_start_ns=0, window_end_ns=0) for o in captured]
    assert {"sign of z", "numbering"} <= set(calibration.solve(written).unprotected)
