"""Variance components: what is estimated, what is believed, what contradicts a statement."""

import numpy as np
import pytest
from scipy import optimize, stats

from rotcal_ros.adjust.causes import diagnose_causes
from rotcal_ros.adjust.diagnosis import Limits
from rotcal_ros.adjust.look import SolutionView
from rotcal_ros.adjust.model import Model, Words, linear
from rotcal_ros.adjust.noise import PRIOR, NoiseEvidence, estimate_factors, robust_squares


def evidence_of(squares, factors, dof):
    """Two unconnected components: sums of squares of noise that was stated, after ``factors``."""
    return NoiseEvidence(
        np.array([True, True]), squares / factors**2, dof.copy(), np.diag(dof)
    )  # fmt: skip


def test_of_many_residuals_the_factor_is_their_scatter():
    dof, true = np.array([4000.0, 3000.0]), np.array([3.0, 0.5])
    squares = true**2 * dof
    found = estimate_factors(
        lambda f: evidence_of(squares, f, dof), np.ones(2), np.eye(2) / PRIOR**2
    )
    assert found.factors == pytest.approx(true, rel=2e-3)
    assert found.log_std == pytest.approx(1.0 / np.sqrt(2.0 * dof), rel=1e-3)
    assert found.contradicted(0.01).tolist() == [True, True]


def test_of_few_residuals_the_statement_counts():
    dof = np.array([1.0, 1e-6])
    squares = np.array([25.0, 1e-4])
    found = estimate_factors(
        lambda f: evidence_of(squares, f, dof), np.ones(2), np.eye(2) / PRIOR**2
    )
    assert 1.5 < found.factors[0] < 5.0
    assert found.factors[1] == pytest.approx(1.0, abs=1e-3)
    assert found.log_std[1] == pytest.approx(PRIOR, rel=1e-3)


def test_probabilities_are_those_of_chi_squared_on_both_sides():
    dof = np.array([12.0, 0.4])
    here = evidence_of(np.array([30.0, 50.0]), np.ones(2), dof)
    chance = here.probabilities()
    assert chance[0] == pytest.approx(2.0 * stats.chi2.sf(30.0, 12.0))
    assert chance[1] == 1.0  # hardly checked: nothing contradicts it


def test_bent_squares_of_sound_residuals_keep_their_sum():
    rng = np.random.default_rng(2)
    redundancy = rng.uniform(0.1, 1.0, 200_000)
    squares = redundancy * rng.standard_normal(200_000) ** 2
    bent = robust_squares(squares, redundancy, 1e-6)
    assert bent.sum() == pytest.approx(redundancy.sum(), rel=5e-3)
    assert robust_squares(np.array([1e6]), np.array([0.5]), 1e-6)[0] < 4.0


def known_places(places, each, noise, apart, seed):
    """Return readings of places that are known beforehand to 1, about a mean; as a model."""
    rng = np.random.default_rng(seed)
    read = np.repeat(apart * rng.standard_normal(places), each)
    observed = np.append(read + noise * rng.standard_normal(len(read)), np.zeros(places))
    design = np.vstack([np.repeat(np.eye(places), each, axis=0), np.eye(places)])
    design = np.column_stack([design, np.append(np.ones(len(read)), np.zeros(places))])
    component = np.append(np.zeros(len(read), int), np.ones(places, int))
    return Model(
        blocks={"place": places, "mean": 1},
        observed=observed,
        std=np.ones(len(observed)),
        equations=linear(design),
        outputs=np.eye(places + 1)[-1:],
        components=("readings", "places"),
        component=component,
        words=Words("readings", "a draught", "there", "it"),
    )


@pytest.mark.parametrize(("places", "each", "noise", "apart", "seed"), [
    (30, 4, 0.66, 0.1, 3), (60, 2, 0.66, 0.1, 0), (10, 3, 0.66, 0.35, 1), (30, 4, 1.0, 3.0, 0),
])  # fmt: skip
def test_the_estimate_is_where_restricted_likelihood_is_largest(places, each, noise, apart, seed):
    """Where places are apart by far less than stated the residuals show more of their noise than
    is expected, and steps by that go to and fro."""
    model = known_places(places, each, noise, apart, seed)
    y = model.observed[: places * each]

    def surprise(logs):
        """-ln of restricted likelihood and prior, of y with the covariance of both."""
        own, alike = np.exp(2.0 * logs)
        whole = own * np.eye(len(y)) + alike * np.kron(np.eye(places), np.ones((each, each)))
        inverse, ones = np.linalg.inv(whole), np.ones(len(y))
        left = inverse - np.outer(inverse @ ones, ones @ inverse) / (ones @ inverse @ ones)
        volume = np.linalg.slogdet(whole)[1] + np.log(ones @ inverse @ ones)
        return 0.5 * (volume + y @ left @ y) + 0.5 * (logs @ logs) / PRIOR**2

    best = optimize.minimize(surprise, np.zeros(2), method="Nelder-Mead",
                             options={"xatol": 1e-7, "fatol": 1e-10})  # fmt: skip
    found = diagnose_causes(model, Limits()).noise
    assert found.estimated is not None
    assert np.log(found.factors) == pytest.approx(best.x, abs=0.01)


def test_exact_places_say_nothing_of_the_scatter_of_others():
    """As targets that are typed without error: beside them all readings would scatter too much."""
    found = diagnose_causes(known_places(40, 60, 0.6, 0.0, 2), Limits())
    chi2, dof = SolutionView(found, found.fit).rest
    assert chi2 / dof == pytest.approx(1.0, abs=0.02)
    assert found.fit.chi2 / found.fit.dof < 0.985


@pytest.mark.parametrize(("noise", "stated"), [(0.0, True), (1e-6, False)])
def test_what_is_stated_beside_made_up_readings_stays(noise, stated):
    """Places that were read twice, and stated to be zero within 1; they are off by a fifth."""
    rng, places = np.random.default_rng(4), 20
    read = np.vstack([np.eye(places)] * 2)
    observed = read @ (0.2 * rng.standard_normal(places)) + noise * rng.standard_normal(len(read))
    model = Model(
        {"place": places}, observed, np.full(len(read), 1e-6), linear(read), np.eye(places),
        Words("reading", "readings", "readings", "contradicts other readings"),
    )  # fmt: skip
    known = model.with_prior("what is stated", np.eye(places), np.zeros(places), 1.0)
    factors = diagnose_causes(known, Limits()).noise.factors
    assert factors[0] == pytest.approx(1.0, abs=0.3)
    assert (factors[1] == 1.0) == stated
