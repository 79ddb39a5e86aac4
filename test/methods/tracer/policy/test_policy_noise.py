"""Noise of the first sweep: against the likelihood itself, maximised by scipy."""

import numpy as np
import pytest
from scipy import optimize, stats

from rotcal_ros.methods.tracer.policy.experiment import (
    LengthContrasts,
    estimated_noise,
    judged_lengths,
    likeliest,
    student_factor,
    suspect_length,
)

SIZES = (40, 9, 15)


@pytest.fixture
def data():
    rng = np.random.default_rng(4)
    k, p, q = SIZES
    design, targets = rng.standard_normal((k, p)), 1.5 * rng.standard_normal((k, q))
    targets[:, 5:] = 0.0
    y = design @ rng.standard_normal(p) + targets @ rng.standard_normal(q)
    return design, targets, y + 1.7 * rng.standard_normal(k), np.arange(float(k))


def weights(design, covariance):
    inverse = np.linalg.inv(covariance)
    inner = np.linalg.inv(design.T @ inverse @ design)
    return inverse - inverse @ design @ inner @ design.T @ inverse


def likeliest_factor(design, targets, y):
    """Maximise the restricted likelihood as it stands in the books."""

    def minus_log(log_factor):
        v = np.exp(2 * log_factor) * np.eye(len(y)) + targets @ targets.T
        inner = design.T @ np.linalg.inv(v) @ design
        determinants = np.linalg.slogdet(v)[1] + np.linalg.slogdet(inner)[1]
        return determinants + y @ weights(design, v) @ y

    best = optimize.minimize_scalar(minus_log, bounds=(-3, 3), options={"xatol": 1e-9})
    return np.exp(best.x)


def test_the_factor_maximises_the_restricted_likelihood(data):
    design, targets, y, time = data
    found = estimated_noise(LengthContrasts(*data))
    assert found.factor == pytest.approx(likeliest_factor(design, targets, y), rel=1e-6)
    w = weights(design, found.factor**2 * np.eye(len(y)) + targets @ targets.T)
    assert found.dof == pytest.approx(found.factor**4 * np.trace(w @ w), rel=1e-9)
    expected = w @ y / np.sqrt(np.diagonal(w))
    np.testing.assert_allclose(found.test_value, expected, rtol=1e-8)
    slope = time - time.mean()
    drift = slope @ w @ y / np.sqrt(slope @ w @ slope)
    assert found.drift_value == pytest.approx(drift, rel=1e-8)
    again = judged_lengths(LengthContrasts(*data), found.factor)
    np.testing.assert_allclose(again.test_value, expected, rtol=1e-8)
    assert again.drift_value == pytest.approx(drift, rel=1e-8)


@pytest.mark.parametrize("row", [0, 17])
def test_the_noise_without_a_length_is_that_of_the_others(data, row):
    others = [np.delete(values, row, axis=0) for values in data]
    left_out = LengthContrasts(*data).without(row)
    expected = likeliest_factor(*others[:3])
    assert np.sqrt(likeliest(left_out)) == pytest.approx(expected, rel=1e-6)
    design, targets, y, _ = others
    w = weights(design, 0.7 * np.eye(len(y)) + targets @ targets.T)
    moments = np.trace(w), np.trace(w @ w), y @ w @ w @ y
    np.testing.assert_allclose(left_out.moments(0.7), moments, rtol=1e-8)


def test_the_suspect_length_is_the_wrong_one_and_its_value_that_against_the_others(data):
    design, targets, y, time = data
    y[17] += 30.0
    lengths = LengthContrasts(design, targets, y, time)
    row, value = suspect_length(lengths, estimated_noise(lengths), 0.01)
    assert row == 17
    others = [np.delete(values, row, axis=0) for values in (design, targets, y)]
    v = likeliest_factor(*others) ** 2 * np.eye(len(y)) + targets @ targets.T
    w = weights(design, v)
    assert value == pytest.approx((w @ y)[row] / np.sqrt(w[row, row]), rel=1e-5)


def test_without_errors_of_targets_it_is_the_usual_estimate(data):
    design, targets, y, time = data
    found = estimated_noise(LengthContrasts(design, 0.0 * targets, y, time))
    residual = y - design @ np.linalg.lstsq(design, y)[0]
    dof = SIZES[0] - SIZES[1]
    assert found.dof == pytest.approx(dof)
    assert found.factor == pytest.approx(np.sqrt(residual @ residual / dof))


def test_lengths_that_check_nothing_leave_the_planned_noise():
    found = estimated_noise(
        LengthContrasts(np.eye(4), np.zeros((4, 3)), np.ones(4), np.arange(4.0))
    )
    assert (found.factor, found.dof) == (1.0, 0.0)
    assert not found.test_value.any()


def test_the_factor_of_student_holds_as_often_as_two_standard_deviations():
    probability = stats.norm.cdf(2.0)
    assert student_factor(9.0) == pytest.approx(stats.t.ppf(probability, 9.0))
    assert student_factor(np.inf) == pytest.approx(2.0)
