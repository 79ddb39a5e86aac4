import signal

import numpy as np
import pytest
from scipy.stats import chi2, norm

from rotcal_ros.evaluation.monte_carlo import compare_with_linear, numerical_tolerance, propagate
from rotcal_ros.foundation.errors import ConfigurationError


def gaussian(rng, count):
    return rng.normal([1.0, -2.0], [0.5, 3.0], (count, 2))


def squared(rng, count):
    return rng.normal(size=(count, 1)) ** 2


def deaf(_rng, count):
    """Return whether a Ctrl-C in the terminal would reach this worker: 0, it would not."""
    blocked = signal.SIGINT in signal.pthread_sigmask(signal.SIG_BLOCK, ())
    return np.full((count, 1), 0.0 if blocked else 1.0)


def drift_free(rng, count):
    return np.column_stack([np.zeros(count), rng.normal(size=count)])


def test_gaussian_and_chi_square_give_their_own_figures():
    found = propagate(gaussian, seed=1, max_trials=60_000)
    np.testing.assert_allclose(found.mean, [1.0, -2.0], atol=0.05)
    np.testing.assert_allclose(found.std, [0.5, 3.0], rtol=0.02)
    np.testing.assert_allclose(found.low, norm.ppf(0.025, [1.0, -2.0], [0.5, 3.0]), atol=0.12)
    np.testing.assert_allclose(found.covariance, np.diag([0.25, 9.0]), atol=0.25)
    found = propagate(squared, seed=2, max_trials=60_000, probability=0.9)
    assert found.low[0] == pytest.approx(chi2.ppf(0.05, 1), rel=0.08)
    assert found.high[0] == pytest.approx(chi2.ppf(0.95, 1), rel=0.03)


def test_workers_leave_ctrl_c_to_the_process_that_waits_for_them():
    found = propagate(deaf, seed=1, max_trials=20, block=10, workers=2)
    assert found.mean[0] == 0.0
    assert signal.SIGINT not in signal.pthread_sigmask(signal.SIG_BLOCK, ())


@pytest.mark.slow
def test_result_does_not_depend_on_the_number_of_workers():
    """The adaptive stop included: the second worker computes blocks that are then not needed."""
    one, two = (
        propagate(gaussian, seed=7, digits=1, max_trials=40_000, block=500, workers=workers)
        for workers in (1, 2)
    )
    assert one.stable
    assert one.trials == two.trials < 40_000
    for name in ("mean", "std", "low", "high", "covariance"):
        np.testing.assert_array_equal(getattr(one, name), getattr(two, name))


def test_other_seeds_and_other_blocks_are_other_numbers():
    one, other = (propagate(gaussian, seed=s, max_trials=1000, block=500) for s in (1, 2))
    assert not np.any(one.mean == other.mean)
    seen = []

    def keep(rng, count):
        seen.append(rng.normal(size=(count, 1)))
        return seen[-1]

    propagate(keep, seed=1, max_trials=1000, block=500)
    assert not np.isin(seen[0], seen[1]).any()


def test_stops_when_two_digits_stand_and_says_when_they_do_not():
    rough = propagate(gaussian, seed=3, digits=1, max_trials=200_000)
    fine = propagate(gaussian, seed=3, digits=2, max_trials=200_000)
    assert rough.stable
    assert rough.trials < fine.trials
    short = propagate(gaussian, seed=3, digits=3, max_trials=6000)
    assert not short.stable
    assert short.trials == 6000
    # What was called stable is: another seed agrees within the tolerance.
    again = propagate(gaussian, seed=4, digits=1, max_trials=200_000)
    tolerance = numerical_tolerance(np.array([0.5, 3.0]), 1)
    assert np.all(np.abs(again.std - rough.std) < 2 * tolerance)


def test_constant_outputs_do_not_hold_the_stop_up():
    found = propagate(drift_free, seed=1, digits=1, max_trials=200_000)
    assert found.stable
    assert found.std[0] == 0.0


@pytest.mark.parametrize(
    ("std", "digits", "tolerance"),
    [
        (0.00035, 2, 0.000005),  # JCGM 101, 7.9.2, example 1: 35e-5, half of 1e-5
        (0.00035, 1, 0.00005),  # example 2: 4e-4, half of 1e-4
        (2.0, 1, 0.5),  # example 3: 2, half of 1
        (0.0999, 2, 0.005),
    ],
)
def test_numerical_tolerance_of_the_standard(std, digits, tolerance):
    assert numerical_tolerance(np.array([std]), digits)[0] == pytest.approx(tolerance)


def test_linear_uncertainty_is_judged():
    found = propagate(gaussian, seed=5, max_trials=20_000)
    value, std = np.array([1.0, -2.0]), np.array([0.5, 3.0])
    assert compare_with_linear(found, value, std) == []
    wrong = compare_with_linear(found, value, np.array([0.5, 2.5]), ("first", "second"))
    assert len(wrong) == 1
    assert wrong[0].startswith("second: the linear standard uncertainty is 2.5")
    # y = x^2 at x = 0: the linear uncertainty is nothing at all.
    curved = propagate(squared, seed=5, max_trials=20_000)
    assert len(compare_with_linear(curved, np.array([0.0]), np.array([1e-9]))) == 1


def test_progress_counts_trials():
    steps = []
    propagate(gaussian, seed=1, max_trials=2500, block=1000, digits=3,
              progress=lambda done, total: steps.append((done, total)))  # fmt: skip
    assert steps == [(1000, 3000), (2000, 3000), (3000, 3000)]


@pytest.mark.parametrize(
    "bad", [{"probability": 1.0}, {"digits": 0}, {"workers": 0}, {"max_trials": 0}, {"seed": -1}]
)
def test_impossible_orders_are_refused(bad):
    with pytest.raises(ConfigurationError, match="Monte Carlo needs"):
        propagate(gaussian, **{"seed": 1, **bad})
