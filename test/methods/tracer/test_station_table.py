"""Coordinates of stations in the place of lengths: simulated truth, and what is refused."""

from pathlib import Path

import numpy as np
import pytest
from coded import coded

import rotcal_ros as rc
from rotcal_ros.foundation.errors import ConfigurationError, DataError, ObservabilityError
from rotcal_ros.methods.tracer.solver.stations import (
    DIFFER_AT_ONE_ANGLE,
    MORE_THAN_STATED,
    StationProblem,
    solve,
)

DATA = Path(__file__).parents[3] / "examples" / "data"
ANGLES = np.radians(-145.0 + 30.0 * np.arange(11))
RADIUS = 0.065


def stations_of(ecc, rng=None, std=0.0, angles=ANGLES):
    """Stations of a table with the errors ``ecc``, on a leaning circle off the origin."""
    turned = angles + ecc
    flat = RADIUS * np.column_stack([np.cos(turned), np.sin(turned), np.zeros_like(turned)])
    lean = np.array([[1.0, 0.0, -2e-5], [0.0, 1.0, 1e-5], [2e-5, -1e-5, 1.0]])
    noise = 0.0 if rng is None else rng.normal(0.0, std, flat.shape)
    return flat @ lean.T + [1e-4, -2e-4, 0.12] + noise


def posed(stations, angles=ANGLES, **more):
    return StationProblem(stations, angles, np.arange(len(angles)), np.zeros(0), **more)


def test_exact_stations_give_the_truth():
    truth = 1e-5 * np.sin(2 * ANGLES)
    result = solve(posed(stations_of(truth)))
    np.testing.assert_allclose(result.deviations["ECC"], truth - truth[0], atol=2e-7)
    assert result.placement.distance(np.array([1e-4, -2e-4, 0.12])) < 1e-6
    assert result.std["ECC"].max() < 1e-6


@pytest.mark.slow
def test_intervals_hold_the_truth_of_noisy_stations():
    """At equal noise in all directions, 95 % intervals hold 94 to 97 % (1000 runs, 10 angles)."""
    rng, held = np.random.default_rng(4), []
    for _ in range(1000):
        result = solve(posed(stations_of(np.zeros(11), rng, 5e-7)))
        held.append(np.abs(result.deviations["ECC"][1:]) < 1.96 * result.std["ECC"][1:])
    assert 0.94 <= np.mean(held) <= 0.97


def test_a_statement_that_the_circle_contradicts_is_replaced():
    stations = stations_of(np.zeros(11), np.random.default_rng(1), 2e-6)
    believed = solve(posed(stations, error_motion_std=2e-6))
    assert believed.verdict == "ok"
    doubted = solve(posed(stations, error_motion_std=1e-7))
    assert doubted.verdict == "suspect"
    ((*_, stated, _used),) = coded(doubted.warnings[0])[MORE_THAN_STATED]
    assert stated == pytest.approx(0.1)
    assert doubted.std["ECC"].max() > 0.5 * believed.std["ECC"].max()


def test_turning_the_world_does_not_change_the_curve():
    stations = stations_of(1e-5 * np.cos(ANGLES), np.random.default_rng(2), 1e-6)
    turn = np.array([[0.6, -0.8, 0.0], [0.8, 0.6, 0.0], [0.0, 0.0, 1.0]])
    one, other = (solve(posed(at)) for at in (stations, stations @ turn.T + [1.0, 2.0, 3.0]))
    np.testing.assert_allclose(other.deviations["ECC"], one.deviations["ECC"], atol=1e-13)
    np.testing.assert_allclose(other.std["ECC"], one.std["ECC"], rtol=1e-6)


def test_an_angle_that_comes_again_has_to_agree():
    angles = np.append(ANGLES, ANGLES[0] + 2 * np.pi)
    sound, moved = (
        solve(posed(stations_of(np.append(np.zeros(11), off), angles=angles), angles))
        for off in (0.0, 3e-5)
    )
    assert sound.verdict == "ok"
    assert moved.verdict == "suspect"
    assert DIFFER_AT_ONE_ANGLE in coded(moved.warnings[0])


def test_a_table_of_stations_has_no_targets(tmp_path):
    setup = rc.read_configuration(DATA / "paper/stations.yaml")
    with pytest.raises(DataError, match="has no column of targets: leave out"):
        rc.read_table(DATA / "paper/stations.csv", setup, targets=DATA / "targets.csv")


def test_too_few_stations_are_refused():
    with pytest.raises(ObservabilityError, match="give at least 5, or the lengths"):
        solve(posed(stations_of(np.zeros(4), angles=ANGLES[:4]), ANGLES[:4]))


def test_stations_of_another_order_are_refused():
    with pytest.raises(DataError, match="order of the stations"):
        solve(posed(stations_of(np.zeros(11))[::2], ANGLES[:6]))


@pytest.mark.parametrize(
    ("row", "words"),
    [
        ("11,0.06,0.0,0.12", "position 11 is not in the plan, which has 0 to 10"),
        ("0,0.06,0.0,0.12", "position 0 is listed twice"),
        ("1,64.9,0.0,122.5", "are these millimetres"),
    ],
)
def test_a_row_that_cannot_be_is_refused_with_its_place(tmp_path, row, words):
    table = tmp_path / "stations.csv"
    table.write_text(f"position,x_m,y_m,z_m\n0,0.065,0.0,0.12\n{row}\n")
    with pytest.raises(DataError, match=f"row 3: .*{words}"):
        rc.read_table(table, rc.read_configuration(DATA / "paper/stations.yaml"))


def test_coordinates_have_no_trials_and_say_why():
    setup = rc.read_configuration(DATA / "paper/stations.yaml")
    with pytest.raises(ConfigurationError, match="give the table of lengths"):
        rc.read_table(DATA / "paper/stations.csv", setup).trials()
