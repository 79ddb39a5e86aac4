"""A fringe that the counter slips in the midst of a run, and nobody says so."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from chances import LONG
from six_coverage import TWELVE
from six_scene import good_targets, scene

from rotcal_ros.foundation.components import COMPONENTS
from rotcal_ros.foundation.protection import TOLERABLE
from rotcal_ros.methods.tracer.solver import TracerLimits
from rotcal_ros.methods.tracer_six.lengths.zeros import Shifts, slips_among
from rotcal_ros.methods.tracer_six.solver import SixProblem, solve
from rotcal_ros.methods.tracer_six.solver.solution import adjust

FRINGE = 0.3164e-6
M, N = 5, 12
KNOWN = {"scatter_translation_std": 0.0, "scatter_rotation_std": 0.0}
KEEP_ALL = TracerLimits(
    rejection_significance=1e-12, noise_significance=1e-300, test_significance=1e-300
)
"""As if there were no rejection and no second thought about noise."""
PER_ROUND = M * N


def measured(seed, at=None, arrivals=2, place=1, **options):
    """Return truth and problem; length ``at`` of a place and all after it are a fringe longer.

    With two arrivals the table goes round twice from each place.
    """
    made = scene(np.random.default_rng(seed), good_targets()[TWELVE], m=M, arrivals=arrivals)
    rows = dict(made.rows)
    time = rows["arrival"] * PER_ROUND + rows["position"] * N + rows["target"]
    if at is not None:
        rows["length"] = rows["length"] + FRINGE * ((rows["place"] == place) & (time >= at))
    order = rows["place"] * arrivals * PER_ROUND + time
    return made.truth, SixProblem(**rows, order=order, **options)


def slip_of(result):
    return next((p for p in result.protections if p.effect == "slip"), None)


def test_a_slip_between_two_rounds_is_found_named_and_does_no_harm():
    truth, problem = measured(1, at=PER_ROUND)
    result = solve(problem)
    assert result.verdict == "suspect"
    assert "the zero of place 1 jumps by +" in result.warnings[0]
    assert "as much as +1 fringe(s), a counter that slipped" in result.warnings[0]
    for name, curve in zip(COMPONENTS, truth, strict=True):
        assert np.abs((result.deviations[name] - curve) / result.std[name]).max() < 4.0, name


def test_a_counter_that_does_not_slip_is_not_asked():
    ignored = solve(measured(1, at=PER_ROUND, slip=0.0)[1])
    assert slip_of(ignored) is None
    assert ignored.details["slips"] is None
    assert not any("jumps by" in text for text in ignored.warnings)


def test_slips_are_found_as_often_as_is_stated():
    rng = np.random.default_rng(7)
    found, stated, inside = [], [], []
    runs = 20 if LONG else 10
    for seed in range(runs):
        truth, problem = measured(seed, int(rng.integers(2 * PER_ROUND)), place=seed % 3)
        solution = adjust(problem)
        curves = np.array(list(solution.deviations().values()))
        std = np.sqrt(np.einsum("ajaj->aj", solution.covariance))
        found.append(len(solution.evidence.jumps) > 0)
        stated.append(solution.slips.found)
        inside.append((np.abs(curves - truth) < 1.96 * std).mean())
    expected, error = np.mean(stated), np.sqrt(np.mean(stated) * (1.0 - np.mean(stated)) / runs)
    assert np.mean(found) == pytest.approx(expected, abs=3.0 * error)
    assert expected > 0.7
    assert np.mean(inside) > 0.9


def test_no_jump_is_seen_where_there_is_none():
    assert sum(len(adjust(measured(seed)[1]).evidence.jumps) for seed in range(8)) <= 1


def test_one_round_shows_little_and_the_verdict_says_so():
    """A place whose lengths have grown looks as if it rose, and three places have a plane."""
    once, twice = (solve(measured(3, arrivals=arrivals, **KNOWN)[1]) for arrivals in (1, 2))
    assert once.details["slips"]["found"] < 0.5 < 0.7 < twice.details["slips"]["found"]
    assert slip_of(once).treatment == "not protected"
    assert slip_of(once).error > TOLERABLE
    assert "plan.arrivals" in slip_of(once).why
    assert "slip" in once.unprotected


def coverage_of_slips(runs, **options):
    """Return the share of EZC, EAC and EBC inside their intervals; every run slips a fringe."""
    rng = np.random.default_rng(11)
    inside = []
    for seed in range(runs):
        at = int(rng.integers(PER_ROUND))
        truth, problem = measured(seed, at, 1, place=seed % 3, **KNOWN, **options)
        solution = adjust(problem)
        curves = np.array(list(solution.deviations().values()))
        std = np.sqrt(np.einsum("ajaj->aj", solution.covariance))
        inside.append((np.abs(curves - truth) < 1.96 * std)[2:5].mean())
    return np.mean(inside)


def test_what_stays_unseen_of_a_slip_is_in_the_uncertainty():
    """One round: a slip tilts the curves. Where none is allowed for, intervals are too narrow."""
    runs = 30 if LONG else 15
    assert coverage_of_slips(runs, slip=0.0) < 0.87
    assert coverage_of_slips(runs) > 0.9


@pytest.mark.slow
def test_the_allowance_is_what_plain_solves_make_of_slips():
    """Each slip solved whole: what it moves, and by chi-squared how probable it is."""
    made, every = scene(np.random.default_rng(1), good_targets()[TWELVE[:6]], m=4), np.arange(72)
    problem = SixProblem(**made.rows, **KNOWN, order=every)
    plain = replace(problem, slip=0.0, settings=KEEP_ALL)

    def shifted(at, size):
        later = (problem.place == problem.place[at]) & (every >= at)
        return adjust(replace(plain, length=problem.length + size * later))

    names, alone = ("EZC", "EAC", "EBC"), adjust(plain)
    begins = every[every % 24 > 0]  # a run that slips as a whole has another zero
    moved, ratio = {name: [] for name in names}, []
    for at in begins:
        up, down = shifted(at, FRINGE), shifted(at, -FRINGE)
        fall = alone.fit.chi2 - np.array([up.fit.chi2, down.fit.chi2])
        ratio.append(np.exp(0.5 * fall).mean() / len(begins))
        for name in names:
            moved[name].append(0.5 * (up.deviations()[name] - down.deviations()[name]))
    solution = adjust(problem)
    chance = np.array(ratio) / (1.0 + np.sum(ratio))
    for name in names:
        curve = np.array(moved[name])
        allowed = solution.covariance_of(name) - alone.covariance_of(name)
        assert np.abs(allowed - (curve.T * chance) @ curve).max() < 1e-3 * allowed.max(), name
        assert allowed.max() > 0.1 * alone.covariance_of(name).max(), name


def test_the_lengths_say_how_probable_an_unseen_slip_is():
    """By Bayes' theorem of exp(-chi-squared / 2), with a slip at each moment and without."""
    size, score = 3e-7, np.array([1e7, -6e6, 0.0, 2e6])
    information = np.array([2e13, 1e13, 1e12, 4e13])
    timed = SimpleNamespace(side=np.full(4, 100))
    shifts = Shifts(timed, np.arange(4), score, information, np.ones(4), np.zeros((4, 6)))
    slips = slips_among(shifts, size, 0.01, asked=True)
    fits = np.array([[s * u - s**2 * i / 2 for s in (size, -size)] for u, i in
                     zip(score, information, strict=True)])  # fmt: skip
    likely = np.exp(fits).mean(axis=1) / 4
    np.testing.assert_allclose(slips.chance, likely / (1 + likely.sum()), rtol=1e-12)
    before = slips_among(shifts, size, 0.01)
    assert (before.chance <= 0.5 / 4).all()
