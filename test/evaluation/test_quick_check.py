"""A quick check against its definition, and both of its risks in simulation."""

import numpy as np
import pytest
from scipy import stats

from rotcal_ros.evaluation.quick_check import quick_check
from rotcal_ros.foundation.curves.measured import MeasuredCurve
from rotcal_ros.foundation.errors import ConfigurationError, DataError
from rotcal_ros.planning.check_rule import CheckRule

TAU = 2.0 * np.pi
N = 8


def curve(deviation, covariance, line="ok", angles=None):
    angles = np.arange(len(deviation)) * TAU / len(deviation) if angles is None else angles
    return MeasuredCurve(angles, np.asarray(deviation, dtype=float), covariance, TAU, line)


def checked(deviation, std=1.0, earlier_std=0.0, line="ok", **rule):
    """The verdict on ``deviation`` from an earlier curve of zeros."""
    n = len(deviation)
    return quick_check(
        curve(np.zeros(n), earlier_std**2 * np.eye(n)),
        curve(deviation, std**2 * np.eye(n), line),
        CheckRule(**rule),
    )


def spike(size, n=N):
    """A zero-mean curve whose largest value is ``size``, at the first angle."""
    return size * np.append(1.0, np.full(n - 1, -1.0 / (n - 1)))


K = stats.norm.ppf(0.95)
SHARE = stats.norm.ppf(1.0 - 0.05 / (2 * N))
U = np.sqrt(1.0 - 1.0 / N)  # of one of N independent values less their mean


@pytest.mark.parametrize(
    ("size", "limit", "earlier_std", "verdict"),
    [
        (10.0 - K * U - 1e-6, 10.0, 0.0, "still valid"),
        (10.0 - K * U + 1e-6, 10.0, 0.0, "changed"),  # far more than chance explains
        (10.0 - K * U + 1e-6, 10.0, 4.0, "undecided"),  # the earlier curve was not better
        (SHARE * U - 1e-6, 3.0, 0.0, "undecided"),
        (SHARE * U + 1e-6, 3.0, 0.0, "changed"),
        (SHARE * np.hypot(1.0, 0.6) * U - 1e-6, 3.0, 0.6, "undecided"),
        (SHARE * np.hypot(1.0, 0.6) * U + 1e-6, 3.0, 0.6, "changed"),
        (3.0 + SHARE * U - 1e-6, 3.0, 50.0, "undecided"),
        (3.0 + SHARE * U + 1e-6, 3.0, 50.0, "changed"),  # surely beyond the limit
    ],
)
def test_the_verdict_turns_where_the_definition_says(size, limit, earlier_std, verdict):
    assert checked(spike(size), earlier_std=earlier_std, limit=limit).verdict == verdict


def test_ageing_and_the_earlier_uncertainty_explain_alike():
    aged = checked(spike(3.5), limit=4.0, ageing_std=0.8)
    less_sure = checked(spike(3.5), limit=4.0, earlier_std=0.8)
    np.testing.assert_allclose(aged.alarm, less_sure.alarm, rtol=1e-12)
    np.testing.assert_allclose(aged.expected_std, 0.8 * U, rtol=1e-12)


def test_the_offset_of_neither_measurement_counts():
    rng = np.random.default_rng(1)
    deviation = rng.normal(size=N)
    plain, shifted = checked(deviation, limit=9.0), checked(deviation + 1e3, limit=9.0)
    np.testing.assert_allclose(shifted.difference, plain.difference, atol=1e-9)
    np.testing.assert_allclose(plain.difference, deviation - deviation.mean(), atol=1e-12)


@pytest.mark.parametrize("size", [0.0, 100.0])
def test_a_suspect_measurement_decides_nothing(size):
    assert checked(spike(size), limit=10.0, line="suspect").verdict == "undecided"


def test_a_failed_measurement_and_a_bare_one_are_refused():
    with pytest.raises(DataError, match="new result: the verdict is failed"):
        checked(spike(0.0), limit=10.0, line="failed")
    with pytest.raises(DataError, match="no uncertainty"):
        checked(spike(0.0), std=0.0, limit=10.0)


@pytest.mark.parametrize(
    "wrong",
    [{"limit": 0.0}, {"limit": np.nan}, {"miss": 0.0}, {"false_alarm": 0.5}, {"ageing_std": -1.0}],
)
def test_what_is_no_risk_or_no_limit_is_refused(wrong):
    with pytest.raises(ConfigurationError, match="expected"):
        CheckRule(**{"limit": 1.0, **wrong})


def test_angles_that_were_not_measured_again_are_counted_and_named():
    few = np.arange(4) * TAU / 4
    earlier = curve(np.zeros(N), 0.01 * np.eye(N))
    new = curve(np.zeros(4), 0.01 * np.eye(4), angles=few)
    check = quick_check(earlier, new, CheckRule(1.0))
    assert check.verdict == "still valid"
    assert check.notes == (
        "4 of 8 angles of the earlier curve were not measured again: nothing is known there",
    )
    between = curve(np.zeros(4), 0.01 * np.eye(4), angles=few + 0.1)
    assert "lie between" in quick_check(earlier, between, CheckRule(1.0)).notes[0]


def covariance(seed, size):
    root = np.random.default_rng(seed).normal(size=(N, N + 2))
    scale = size * np.linspace(0.6, 1.4, N)
    return scale[:, None] * (root @ root.T / (N + 2)) * scale


def verdicts(errors, rule, new, earlier):
    """How often each verdict comes when the earlier curve is off by ``errors`` (k, N)."""
    rng = np.random.default_rng(5)
    noise = rng.multivariate_normal(np.zeros(N), new, len(errors))
    found = [
        quick_check(curve(np.zeros(N), earlier), curve(d, new), rule).verdict
        for d in errors + noise
    ]
    return {name: found.count(name) / len(found) for name in set(found)}


RUNS = 1200
ABOVE = 3.0 * np.sqrt(0.05 * 0.95 / RUNS)
"""Three standard deviations of a share of 5 %."""


@pytest.mark.parametrize("alone", [True, False])
def test_the_risk_of_a_miss(alone):
    """Just beyond the limit at one angle, where the bound is reached, or at two opposite ones."""
    error = spike(4.0) if alone else 4.0 * np.append([1.0, -1.0], np.zeros(N - 2))
    new = covariance(2, 0.7)
    shares = verdicts(np.tile(error, (RUNS, 1)), CheckRule(4.0), new, np.zeros((N, N)))
    missed = shares.get("still valid", 0.0)
    assert missed < 0.05 + ABOVE
    assert missed > 0.05 - ABOVE or not alone


def test_the_risk_of_a_false_alarm_is_used_up_where_nothing_can_pass():
    """Nearly: the angles share the risk as if they were independent and never wrong together."""
    rule, new = CheckRule(0.05), covariance(3, 0.4)
    shares = verdicts(np.zeros((RUNS, N)), rule, new, np.zeros((N, N)))
    assert 0.05 - 1.5 * ABOVE < shares["changed"] < 0.05 + ABOVE
    assert shares["undecided"] == pytest.approx(1.0 - shares["changed"])


def test_the_risk_of_a_false_alarm_and_the_assurance():
    """Tables that aged as stated, errors of the earlier curve correlated."""
    rule, new, earlier = CheckRule(3.0, ageing_std=0.3), covariance(3, 0.4), covariance(4, 0.4)
    usual = earlier + 0.3**2 * np.eye(N)
    errors = np.random.default_rng(6).multivariate_normal(np.zeros(N), usual, RUNS)
    shares = verdicts(errors, rule, new, earlier)
    assert shares.get("changed", 0.0) < 0.05 + ABOVE
    promised = quick_check(curve(np.zeros(N), earlier), curve(np.zeros(N), new), rule).assurance
    assert promised > 0.3
    assert promised == pytest.approx(shares["still valid"], abs=0.05)
