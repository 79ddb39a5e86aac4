"""A fringe that slips unseen: what is found of it, and what of it the uncertainty holds."""

import numpy as np
import pytest
from chances import LONG
from scipy.stats import norm
from segment_scene import LENGTH_STD, Dense, measure
from test_tracer_segments import ecc_covariance

from rotcal_ros.foundation.protection import EFFECTS, PARTICULAR
from rotcal_ros.methods.tracer.solver import solve
from rotcal_ros.methods.tracer.solver.solution import adjust

FRINGE = 0.3164e-6


def dense_slips(problem, stations, moments):
    """By one dense inverse: what a fringe does to the stations (t, 3 m), and its d (t,)."""
    dense = Dense(problem)
    x = dense.solve(stations)
    jacobian = dense.slope(x)
    scale = 1.0 / np.linalg.norm(jacobian, axis=0)
    inverse = scale[:, None] * np.linalg.pinv(jacobian * scale)
    shifts = np.zeros((len(moments), len(jacobian)))
    later = problem.order >= np.asarray(moments)[:, None]
    shifts[:, : later.shape[1]] = FRINGE / LENGTH_STD * later
    taken = shifts @ inverse.T
    left = shifts - taken @ jacobian.T
    return taken[:, : 3 * dense.m], np.sqrt((left**2).sum(axis=1))


def test_the_share_of_slips_is_that_of_dense_algebra():
    run = measure(kept=8, n=24, by_target=False)
    problem = run.problem(0.5, 0)
    solution = adjust(problem)
    moments = np.arange(1, len(problem.length))
    moved, apart = dense_slips(problem, run.stations, moments)
    side = np.minimum(moments, len(problem.length) - moments)
    limit = solution.slips.shifts.limit(0.01)
    assert 3.0 < limit < norm.isf(0.005 / len(moments))  # never more than Bonferroni's
    missed = np.where(side < 4, 1.0, norm.cdf(limit - apart))
    chance = 0.5 * missed / len(moments)
    share = ecc_covariance(solution.fit.stations, run.angles, (moved.T * chance) @ moved)
    alone = adjust(run.problem(0.5, 0, slip=0.0)).covariance
    stated = solution.covariance - alone
    assert np.abs(stated - share).max() < 1e-5 * share.max()
    assert solution.angles.budget["slips"] == pytest.approx(np.sqrt(share.diagonal()), rel=1e-5)
    assert share.max() > 0.02 * alone.max()
    foreseen = predicted(problem, solution.fit.stations).covariance
    assert foreseen == pytest.approx(solution.covariance, rel=1e-4, abs=1e-16)


def test_a_slip_that_cannot_be_missed_costs_nothing_but_at_the_ends():
    result = solve(measure(by_target=False).problem(0.5, 0, slip=1e-4))
    # three lengths at either end of 140 are too few to tell a slip from outliers
    assert result.details["slips"]["found"] == pytest.approx(1 - 6 / 139)


@pytest.mark.slow
@pytest.mark.slow
def test_as_many_slips_are_found_as_is_stated():
    found, stated, runs = 0, [], 60 if LONG else 25
    for seed in range(runs):
        run = measure(seed, n=24, by_target=False)
        moment = np.random.default_rng([seed, 3]).integers(1, 168)
        solution = adjust(run.problem(0.5 + FRINGE * (np.arange(168) >= moment), 0))
        found += bool(solution.evidence.jumps)
        if not solution.evidence.jumps:
            stated.append(solution.slips.found)
    expected = np.mean(stated)
    assert 0.3 < expected < 0.9
    assert abs(found / runs - expected) < 3 * np.sqrt(expected * (1 - expected) / runs)


def test_trials_slip_as_often_as_the_uncertainty_holds():
    solution = adjust(measure(by_target=True).problem(0.5, 0))
    drawn = solution.slips.draw(solution.grid, np.random.default_rng(1), 4000)
    time = solution.problem.order[solution.grid.row]
    in_time = drawn.reshape(len(drawn), -1)[:, np.argsort(time.ravel())]
    slipped = in_time[:, -1] != 0.0
    expected = solution.slips.chance.sum()
    assert 0.4 < expected < 0.5  # half of all measurements hold one, few are found in this order
    assert slipped.mean() == pytest.approx(expected, abs=3 * np.sqrt(0.25 / 4000))
    assert set(np.abs(in_time[slipped]).ravel()) == {0.0, FRINGE}
    assert ((np.diff(in_time[slipped], axis=1) != 0.0).sum(axis=1) == 1).all()
    assert np.sign(in_time[:, -1]).mean() == pytest.approx(0.0, abs=0.05)


def test_the_result_says_how_many_slips_would_be_found():
    by_target, by_station = (
        {p.effect: p for p in solve(measure(n=40, by_target=b).problem(0.5, 0)).protections}
        for b in (True, False)
    )
    others = (
        "growth", "uneven drift", "sign of z", "sign of readings", "sense", "gain", "probe tip",
        "lag", "straightness", "play", "single readings", "polygon tilt",
    )  # fmt: skip
    assert tuple(by_target) == (*EFFECTS, *(e for e in PARTICULAR if e not in others))
    assert by_target["slip"].treatment == "bounded"
    assert "is found in 1 % of the cases, by these lengths in this order" in by_target["slip"].why
    assert by_target["slip"].error < 0.6 < 1.0 < by_station["slip"].error
    for options in ({"segment": None}, {"segment": 0, "slip": 0.0}):
        given = {"zero": 0.5, **options}
        assert "slip" not in {p.effect for p in solve(measure().problem(**given)).protections}
