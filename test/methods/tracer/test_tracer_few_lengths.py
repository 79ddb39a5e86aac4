"""As many lengths as a station has unknowns are enough; fewer are refused, with the station."""

from dataclasses import replace

import numpy as np
import pytest
from chances import LONG, most
from coded import coded

from rotcal_ros.foundation.errors import DataError, ObservabilityError
from rotcal_ros.geometry.rotations import positions_on_table
from rotcal_ros.methods.tracer.settings import TracerLimits
from rotcal_ros.methods.tracer.solver import TracerProblem, solve
from rotcal_ros.methods.tracer.solver.problem import TOO_FEW, station_minimum
from rotcal_ros.methods.tracer.solver.solve import IN_ONE_PLANE

ANGLES = np.radians(30.0 * np.arange(9))
TARGETS = np.random.default_rng(4).uniform([-0.6, -0.5, 0.2], [0.6, 0.5, 0.9], (15, 3))
DEVIATION = np.radians(np.sin(ANGLES) / 3600.0)


def measured(each, one_zero, turned=1.0, targets=TARGETS, **options):
    """Lengths without noise of ``each`` targets per station, from one zero or one each."""
    stations = positions_on_table((0.06, 0.03, 0.1), turned * (ANGLES + DEVIATION), (0.01, 0.02))
    each = np.broadcast_to(each, 9)
    position = np.repeat(np.arange(9), each)
    rng = np.random.default_rng(7)
    target = np.concatenate([rng.permutation(15)[:k] for k in each])
    zero = 0.4 if one_zero else rng.uniform(0.0, 2.0, 9)[position]
    length = np.linalg.norm(stations[position] - targets[target], axis=1) - zero
    values = {"error_motion_std": 0.0, **options}
    if one_zero:
        values["segment"] = np.zeros_like(position)
    return TracerProblem(position, target, length, 2e-7, targets, 1e-6, ANGLES, **values)


def test_the_minimum_is_the_number_of_unknowns():
    assert station_minimum(own_zero=True, on_circle=False) == 4
    assert station_minimum(own_zero=False, on_circle=False) == 3
    assert station_minimum(own_zero=True, on_circle=True) == 2
    assert station_minimum(own_zero=False, on_circle=True) == 1


@pytest.mark.parametrize(
    ("each", "one_zero", "circle_std"),
    [
        ([4, 3, 3, 3, 3, 3, 3, 3, 3], True, None),
        (4, False, None),
        ([3, 2, 2, 2, 2, 2, 2, 1, 2], True, 7e-8),
        (3, False, 7e-8),
    ],
    ids=["one zero", "zero per station", "one zero, circle", "zero per station, circle"],
)
def test_stations_with_few_lengths_are_found(each, one_zero, circle_std):
    result = solve(measured(each, one_zero, circle_std=circle_std))
    assert result.details["station_ids"].tolist() == list(range(9))
    expected = DEVIATION - DEVIATION[0]
    assert result.deviations["ECC"] == pytest.approx(expected, abs=1e-9)
    assert result.rejected == ()


def test_nothing_is_left_to_test_of_as_many_lengths_as_unknowns():
    result = solve(measured([4, 3, 3, 3, 3, 3, 3, 3, 3], one_zero=True))
    assert result.rejected == ()
    (alone,) = (p for p in result.protections if p.effect == "single readings")
    assert alone.treatment == "not protected"


def test_sound_lengths_are_kept_beside_those_that_nothing_checks():
    """Residuals of stations with four lengths are zero, and say nothing of the usual miss."""
    exact = measured([4, 4, 4, 5, 6, 5, 4, 4, 4], one_zero=False)
    lost = 0
    runs = 100 if LONG else 30
    for seed in range(runs):
        rng = np.random.default_rng([seed, 5])
        moved = 1e-6 * rng.standard_normal(TARGETS.shape)
        noise = 2e-7 * rng.standard_normal(len(exact.length))
        result = solve(replace(exact, length=exact.length + noise, targets=TARGETS + moved))
        lost += bool(result.rejected)
    assert lost <= most(0.01, runs)  # significance


def test_a_poor_station_is_named():
    result = solve(measured([6, 6, 2, 6, 6, 6, 6, 6, 6], one_zero=True))
    assert result.details["station_ids"].tolist() == [0, 1, 3, 4, 5, 6, 7, 8]
    for rejection in result.rejected:
        assert coded(rejection.why)[TOO_FEW] == [("station 2", 2, 3)]
    with pytest.raises(ObservabilityError, match=r"0 stations with at least 3 .*station 0 has 2"):
        solve(measured(2, one_zero=True))
    with pytest.raises(ObservabilityError, match=r"27 usable lengths .* fewer than the 28"):
        solve(measured(3, one_zero=True))


def test_lengths_to_one_place_do_not_place_a_station():
    """Three targets at one place count as lengths, and leave directions open."""
    targets = np.vstack([TARGETS[:12], np.tile(TARGETS[12], (3, 1))])
    good = measured(6, one_zero=True, targets=targets)
    kept = good.position != 4
    near = np.linalg.norm(
        positions_on_table((0.06, 0.03, 0.1), ANGLES[4:5] + DEVIATION[4], (0.01, 0.02))
        - TARGETS[12]
    )
    problem = replace(
        good,
        position=np.append(good.position[kept], [4, 4, 4]),
        target=np.append(good.target[kept], [12, 13, 14]),
        length=np.append(good.length[kept], np.full(3, near - 0.4)),
        length_std=np.full(kept.sum() + 3, 2e-7),
        segment=np.zeros(kept.sum() + 3, dtype=int),
    )
    with pytest.raises(ObservabilityError, match=r"separate turn 4 \(station 4\)"):
        solve(problem)


def test_a_table_that_counts_clockwise_is_recognised():
    with pytest.raises(DataError, match="opposite sign"):
        solve(measured(4, one_zero=True, turned=-1.0))


def test_targets_in_a_plane_leave_a_mirror_image():
    flat = TARGETS * [1.0, 1.0, 0.0] + [0.0, 0.0, 0.5]
    result = solve(measured(4, one_zero=True, targets=flat))
    assert result.deviations["ECC"] == pytest.approx(DEVIATION - DEVIATION[0], abs=1e-9)
    assert IN_ONE_PLANE in coded(*result.warnings)
    assert result.details["stations"][:, 2].max() < 0.2


def test_a_pair_measured_again_is_a_length_with_the_same_target():
    """Twice with 0.2 um each is their mean with 0.2 um / sqrt(2); outliers stand alone."""
    once = measured(6, one_zero=False, settings=TracerLimits(noise_significance=1e-9))
    rng = np.random.default_rng(1)
    noise = 2e-7 * rng.standard_normal((2, len(once.length)))
    mean = replace(once, length=once.length + noise.mean(axis=0), length_std=2e-7 / np.sqrt(2.0))
    twice = replace(
        once,
        position=np.tile(once.position, 2),
        target=np.tile(once.target, 2),
        length=(once.length + noise).ravel(),
        length_std=2e-7,
        again=np.repeat([0, 1], len(once.length)),
    )
    expected, result = solve(mean), solve(twice)
    assert result.deviations["ECC"] == pytest.approx(expected.deviations["ECC"], abs=1e-9)
    assert result.std["ECC"] == pytest.approx(expected.std["ECC"], rel=1e-4)
    assert result.dof == expected.dof + len(once.length)
    assert "segments" not in result.details
    length = twice.length.copy()
    length[60] += 2e-5
    spoiled = solve(replace(twice, length=length))
    assert [r.index for r in spoiled.rejected] == [60]
