"""Means and scatter of repeated arrivals, written out with plain sums."""

from dataclasses import replace

import numpy as np
import pytest

from rotcal_ros.foundation.errors import DataError
from rotcal_ros.foundation.results import Result
from rotcal_ros.methods.arrivals import Arrivals, mean_curve, mean_of_runs, repeatability_std

# target, run, upward: target 2 has no way down in the second run, target 1 none at all
CAME = [(0, 0, 1), (1, 0, 1), (3, 0, 1), (3, 0, 0), (0, 0, 0), (0, 1, 1), (1, 1, 1), (3, 1, 1)]
TARGETS = np.radians([0.0, 90.0, 180.0, 270.0])
ECC = np.array([0.0, 3.0, -1.0, 2.0, 4.0, 1.0, 5.0, 2.5]) * 1e-6


def arrivals():
    target, run, upward = np.array(CAME).T
    return Arrivals(TARGETS, target, run, upward.astype(bool))


def result(covariance=None):
    covariance = 1e-18 * np.eye(8) if covariance is None else covariance
    return Result(
        method="own",
        angles=TARGETS[arrivals().target],
        deviations={"ECC": ECC},
        std={"ECC": np.sqrt(np.diag(covariance))},
        covariance={"ECC": covariance},
        sigma0=1.0,
        dof=5,
        n_observations=100,
        rejected=(),
        verdict="ok",
        warnings=(),
        details={"kept": 7},
    )


def means():
    """Up and down weigh the same; target 2 was never reached."""
    first = 0.5 * ((ECC[0] + ECC[5]) / 2 + ECC[4])
    second = (ECC[1] + ECC[6]) / 2
    third = 0.5 * ((ECC[2] + ECC[7]) / 2 + ECC[3])
    return np.array([first, second, third])


def test_both_directions_weigh_the_same():
    average = arrivals().averaging()
    np.testing.assert_allclose(average @ ECC, means(), atol=1e-20)
    np.testing.assert_allclose(average.sum(axis=1), 1.0)
    assert arrivals().measured.tolist() == [0, 1, 3]
    np.testing.assert_allclose(mean_curve(arrivals()) @ ECC, means() - means()[0], atol=1e-20)


def scatter(noise):
    """Pooled over (0 up), (1 up) and (3 up), two arrivals each: one degree of freedom each."""
    squares = sum((ECC[b] - ECC[a]) ** 2 / 2 for a, b in ((0, 5), (1, 6), (2, 7)))
    return np.sqrt(max(squares - 3 * noise, 0.0) / 3)


@pytest.mark.parametrize("noise", [0.0, 1e-12, 2.8e-12, 3e-12])
def test_scatter_is_what_the_noise_does_not_explain(noise):
    found = repeatability_std(ECC, noise * np.eye(8), arrivals())
    assert found == pytest.approx(scatter(noise), rel=1e-12)
    assert (found == 0.0) == (3 * noise > 0.5 * (1.0 + 4.0 + 12.25) * 1e-12)
    # what all arrivals have in common does not scatter
    together = noise * np.eye(8) + 3e-12
    assert repeatability_std(ECC, together, arrivals()) == pytest.approx(found, abs=1e-12)


def test_without_repetition_there_is_no_scatter():
    few = arrivals().take(np.array([0, 1, 3, 4]))
    assert few.target.tolist() == [0, 1, 3, 0]
    assert few.run.tolist() == [0, 0, 0, 0]
    assert few.upward.tolist() == [True, True, False, False]
    assert repeatability_std(ECC[[0, 1, 3, 4]], np.zeros((4, 4)), few) == 0.0


def test_the_mean_of_runs_pays_for_noise_and_scatter():
    root = 2e-7 * np.random.default_rng(3).normal(size=(8, 8))
    covariance = root @ root.T
    found = mean_of_runs(result(covariance), arrivals())
    np.testing.assert_allclose(found.angles, TARGETS[[0, 1, 3]])
    np.testing.assert_allclose(found.deviations["ECC"], means() - means()[0], atol=1e-20)
    np.testing.assert_allclose(found.adjacent_deviations, np.diff(means()), atol=1e-20)
    size = repeatability_std(ECC, covariance, arrivals())
    assert found.runs.repeatability_std == size > 0.0
    weights = np.zeros((3, 8))
    weights[0, [0, 5, 4]] = 0.25, 0.25, 0.5
    weights[1, [1, 6]] = 0.5
    weights[2, [2, 7, 3]] = 0.25, 0.25, 0.5
    spread = weights @ (covariance + size**2 * np.eye(8)) @ weights.T
    count = np.array([[0.0, 0, 0], [-1, 1, 0], [-1, 0, 1]])
    expected = count @ spread @ count.T
    np.testing.assert_allclose(found.covariance["ECC"], expected, atol=1e-12 * expected.max())
    np.testing.assert_allclose(found.std["ECC"], np.sqrt(np.diag(expected)), atol=1e-16)
    steps = np.array([[-1.0, 1, 0], [0, -1, 1]])
    adjacent = np.sqrt(np.diag(steps @ spread @ steps.T))
    np.testing.assert_allclose(found.adjacent_std, adjacent, rtol=1e-9)
    assert found.details["kept"] == 7
    np.testing.assert_array_equal(found.details["station_deviations"], ECC)
    np.testing.assert_array_equal(found.runs.targets, TARGETS)
    nan = np.nan
    forward = [[ECC[0], ECC[5]], [ECC[1], ECC[6]], [nan, nan], [ECC[2], ECC[7]]]
    reverse = [[ECC[4], nan], [nan, nan], [nan, nan], [ECC[3], nan]]
    np.testing.assert_array_equal(found.runs.forward, forward)
    np.testing.assert_array_equal(found.runs.reverse, reverse)


def test_both_directions_count_from_the_zero_of_the_mean():
    """Targets 0 and 3 were reached from both sides; written out arrival by arrival."""
    root = 2e-7 * np.random.default_rng(5).normal(size=(8, 8))
    covariance = root @ root.T
    found = mean_of_runs(result(covariance), arrivals())
    both = found.directions["ECC"]
    np.testing.assert_allclose(both.angles, TARGETS[[0, 3]])
    zero = means()[0]
    np.testing.assert_allclose(
        both.forward, [(ECC[0] + ECC[5]) / 2 - zero, (ECC[2] + ECC[7]) / 2 - zero], atol=1e-20
    )
    np.testing.assert_allclose(both.reverse, [ECC[4] - zero, ECC[3] - zero], atol=1e-20)
    np.testing.assert_allclose(
        (both.forward + both.reverse) / 2, found.deviations["ECC"][[0, 2]], atol=1e-20
    )
    weights = np.zeros((2, 8))
    weights[0, [0, 5, 4]] = 0.5, 0.5, -1.0
    weights[1, [2, 7, 3]] = 0.5, 0.5, -1.0
    size = found.runs.repeatability_std
    spread = weights @ (covariance + size**2 * np.eye(8)) @ weights.T
    np.testing.assert_allclose(both.reversal, weights @ ECC, atol=1e-20)
    np.testing.assert_allclose(both.reversal_std, np.sqrt(np.diag(spread)), rtol=1e-9)


def test_from_one_side_only_there_is_one_table():
    up = np.flatnonzero(arrivals().upward)
    one_sided = arrivals().take(up)
    covariance = 1e-18 * np.eye(len(up))
    part = replace(
        result(),
        angles=TARGETS[one_sided.target],
        deviations={"ECC": ECC[up]},
        std={"ECC": np.sqrt(np.diag(covariance))},
        covariance={"ECC": covariance},
    )
    found = mean_of_runs(part, one_sided)
    assert found.runs.reverse is None
    assert not found.directions
    assert found.runs.forward.shape == (4, 2)
    with pytest.raises(DataError, match="8 stations in the result, 6 arrivals"):
        mean_of_runs(result(), one_sided)
