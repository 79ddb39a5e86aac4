"""Combined results against dense least squares written down again, and their coverage."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from campaigns import TAU, about_mean, campaign, combined, plate, result_of, three, truth
from chances import LONG, most, scatter
from coded import coded
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy import stats
from scipy.linalg import block_diag

from rotcal_ros import read_result
from rotcal_ros.evaluation.combination import CombinationInput
from rotcal_ros.evaluation.compare import compare
from rotcal_ros.evaluation.component_groups import CONTRADICT
from rotcal_ros.evaluation.joint import combine
from rotcal_ros.foundation.curves.measured import MeasuredCurve
from rotcal_ros.foundation.raw_data import Influence, RawData
from rotcal_ros.foundation.units import ARCSEC

RUNS = 400 if LONG else 120
EXAMPLES = Path(__file__).parents[2] / "examples" / "data"


def dense(parts, n):
    """Least squares with curve and all offsets as unknowns; zero mean by a large weight."""
    offsets = len(parts)
    rows, design = [], []
    for k, (raw, _, at) in enumerate(parts):
        block = np.zeros((len(raw), n + offsets))
        block[np.arange(len(raw)), at] = 1.0
        block[:, n + k] = 1.0
        rows.append(raw)
        design.append(block)
    weight = np.linalg.inv(block_diag(*(cov for _, cov, _ in parts)))
    a, y = np.vstack(design), np.concatenate(rows)
    datum = np.zeros((1, n + offsets))
    datum[0, :n] = 1.0
    normal = np.block([[a.T @ weight @ a, datum.T], [datum, np.zeros((1, 1))]])
    size = np.trace(weight) / len(weight)
    normal[:-1, :-1] /= size
    inverse = np.linalg.inv(normal)
    x = inverse[:-1, :-1] @ (a.T @ weight @ y) / size
    rest = y - a @ x
    return x[:n], inverse[:n, :n] / size, rest @ weight @ rest


def test_equals_dense_least_squares_with_all_offsets_as_unknowns():
    campaigns = three(np.random.default_rng(1))
    found = combined(*(c[2] for c in campaigns))
    places = [np.arange(12), np.arange(12), np.arange(0, 12, 2)]
    parts = [(raw, cov, at) for (raw, cov, _), at in zip(campaigns, places, strict=True)]
    x, cov, chi2 = dense(parts, 12)
    np.testing.assert_allclose(found.deviations["ECC"], x, atol=1e-7 * ARCSEC)
    np.testing.assert_allclose(found.covariance["ECC"], cov, atol=1e-7 * ARCSEC**2)
    told = found.details["consistency"]["ECC"]
    assert told["chi2"] == pytest.approx(chi2, rel=1e-6)
    assert told["dof"] == found.dof == 12 + 12 + 6 - 12 - 2
    assert (found.method, found.verdict, found.n_observations) == ("combination", "ok", 30)
    steps = np.diff(np.eye(12), axis=0)
    np.testing.assert_allclose(found.adjacent_deviations, np.diff(x), atol=1e-7 * ARCSEC)
    np.testing.assert_allclose(
        found.adjacent_std, np.sqrt(np.diag(steps @ cov @ steps.T)), rtol=1e-6
    )


def test_coverage_of_many_combinations():
    rng = np.random.default_rng(2)
    grid = np.arange(12) * TAU / 12
    aim = truth(grid) - truth(grid).mean()
    inside, consistent, squares = [], 0, []
    for _ in range(RUNS):
        found = combined(*(c[2] for c in three(rng)))
        inside.append(np.abs(found.deviations["ECC"] - aim) <= 1.96 * found.std["ECC"])
        consistent += found.verdict == "ok"
        squares.append(found.details["consistency"]["ECC"]["chi2"])
    assert 0.93 < np.mean(inside) < 0.97
    assert RUNS - consistent <= most(0.01, RUNS)
    low, high = scatter(16 * RUNS)
    assert low < np.mean(squares) / 16.0 < high
    assert stats.kstest(squares, "chi2", args=(16,)).pvalue > 1e-3


@pytest.mark.parametrize(
    ("way", "factor", "extra"), [("birge", 0.5, 0.0), ("mandel-paule", 1, 0.5)]
)
def test_enlarged_uncertainties_hold_what_the_stated_ones_do_not(way, factor, extra):
    """Birge: all campaigns state half of their noise. Mandel-Paule: each has 0.5 arcsec more."""
    rng = np.random.default_rng(3)
    grid = np.arange(12) * TAU / 12
    aim = truth(grid) - truth(grid).mean()
    stated, enlarged = [], []
    for _ in range(100 if LONG else 40):
        results = [
            result_of(r.angles, r.deviations["ECC"], factor**2 * r.covariance["ECC"])
            for _, _, r in three(rng, extra=extra * ARCSEC)
        ]
        plain, wide = combined(*results, enlarge="none"), combined(*results, enlarge=way)
        for found, store in ((plain, stated), (wide, enlarged)):
            store.append(np.abs(found.deviations["ECC"] - aim) <= 1.96 * found.std["ECC"])
        assert plain.verdict == wide.verdict
        if wide.verdict == "suspect":
            assert coded(wide.warnings[0])[CONTRADICT][0][0] == "ECC"
            assert way in wide.warnings[0].lower()
            assert wide.details["enlargement"]["ECC"]["kind"] == way
    assert np.mean(stated) < 0.75
    assert 0.90 < np.mean(enlarged) < 0.97  # the enlargement is known from 16 residuals only


def test_birge_factor_is_the_root_of_the_reduced_chi_square():
    results = [c[2] for c in three(np.random.default_rng(4), extra=1.0 * ARCSEC)]
    plain, wide = combined(*results, enlarge="none"), combined(*results)
    told = wide.details["consistency"]["ECC"]
    factor = np.sqrt(told["chi2"] / told["dof"])
    np.testing.assert_allclose(wide.std["ECC"], factor * plain.std["ECC"], rtol=1e-12)
    np.testing.assert_array_equal(wide.deviations["ECC"], plain.deviations["ECC"])
    assert wide.sigma0 == pytest.approx(factor)


def test_mandel_paule_makes_chi_square_equal_to_the_degrees_of_freedom():
    campaigns = three(np.random.default_rng(4), extra=1.0 * ARCSEC)
    wide = combined(*(c[2] for c in campaigns), enlarge="mandel-paule")
    extra = wide.details["enlargement"]["ECC"]["common_std"]
    places = [np.arange(12), np.arange(12), np.arange(0, 12, 2)]
    parts = []
    for (raw, _, result), at in zip(campaigns, places, strict=True):
        # The scatter is added to what was handed over, counted from its own zero.
        given_cov = result.covariance["ECC"] + ARCSEC**2 * np.ones((len(raw), len(raw)))
        parts.append((raw, given_cov + extra**2 * np.eye(len(raw)), at))
    x, cov, chi2 = dense(parts, 12)
    assert chi2 == pytest.approx(16.0, rel=1e-5)
    np.testing.assert_allclose(wide.deviations["ECC"], x, atol=1e-6 * ARCSEC)
    np.testing.assert_allclose(wide.covariance["ECC"], cov, atol=1e-6 * ARCSEC**2)


def test_the_order_of_the_inputs_does_not_matter():
    rng = np.random.default_rng(5)
    results = [c[2] for c in three(rng, extra=1.0 * ARCSEC)]
    inputs = [CombinationInput.of(f"r{k}", r) for k, r in enumerate(results)]
    first, second = combine(inputs).result, combine(inputs[::-1]).result
    np.testing.assert_allclose(
        first.deviations["ECC"], second.deviations["ECC"], atol=1e-9 * ARCSEC
    )
    np.testing.assert_allclose(first.std["ECC"], second.std["ECC"], rtol=1e-9)
    told = [r.details["consistency"]["ECC"] for r in (first, second)]
    assert told[0]["chi2"] == pytest.approx(told[1]["chi2"], rel=1e-9)
    assert told[0]["farthest"] == told[1]["farthest"] != ""


def test_coverage_where_only_some_angles_are_common():
    """Twelve and eighteen angles share six: the others hang on the offsets that these fix."""
    rng = np.random.default_rng(19)
    grids = [np.arange(n) * TAU / n for n in (12, 18)]
    every = np.unique(np.round(np.concatenate(grids), 9))
    aim = truth(every) - truth(every).mean()
    inside = []
    for _ in range(300 if LONG else 120):
        found = combined(*(campaign(grid, 0.3 * ARCSEC, rng)[2] for grid in grids))
        inside.append(np.abs(found.deviations["ECC"] - aim) <= 1.96 * found.std["ECC"])
    assert found.dof == 12 + 18 - 24 - 1
    assert 0.93 < np.mean(inside) < 0.97


def test_a_single_result_returns_itself_about_its_mean():
    raw, cov, result = campaign(np.arange(12) * TAU / 12, 0.3 * ARCSEC, np.random.default_rng(6))
    found = combined(result)
    values, spread = about_mean(raw, cov)
    np.testing.assert_allclose(found.deviations["ECC"], values, atol=1e-9 * ARCSEC)
    np.testing.assert_allclose(found.covariance["ECC"], spread, atol=1e-8 * ARCSEC**2)
    assert (found.dof, found.sigma0, found.verdict) == (0, 1.0, "ok")
    assert compare(*(MeasuredCurve(r.angles, r.deviations["ECC"], r.covariance["ECC"], TAU)
                     for r in (found, result))).rms < 1e-9 * ARCSEC  # fmt: skip


def test_a_plate_alone_keeps_its_uncertainty():
    """Between components, too, errors follow from the influences of observations; 0.7 % of U."""
    result = read_result(EXAMPLES / "result_ball_plate.json")
    found = combined(result)
    for c in result.components:
        np.testing.assert_allclose(found.std[c], result.std[c], rtol=1e-6)
        apart = np.abs(found.deviations[c] - result.deviations[c])
        assert apart.max() < 1e-9 * result.std[c].min()


@settings(max_examples=25, deadline=None)
@given(st.lists(st.floats(-1e3, 1e3), min_size=3, max_size=3))
def test_offsets_of_the_inputs_do_not_matter(offsets):
    results = [c[2] for c in three(np.random.default_rng(7))]
    moved = [
        replace(r, deviations={"ECC": r.deviations["ECC"] + shift * ARCSEC})
        for r, shift in zip(results, offsets, strict=True)
    ]
    one, other = combined(*results), combined(*moved)
    np.testing.assert_allclose(other.deviations["ECC"], one.deviations["ECC"], atol=1e-8 * ARCSEC)
    np.testing.assert_array_equal(other.std["ECC"], one.std["ECC"])


# Pairs of components, and a plate that is shifted.


def test_plates_that_stand_elsewhere_are_combined():
    rng = np.random.default_rng(8)
    grid = np.arange(12) * TAU / 12
    aim, first = plate(grid, rng)
    _, second = plate(grid, rng, shift=5e-3)
    found = combined(first, second)
    both = np.append(found.deviations["EXC"], found.deviations["EYC"])
    assert np.max(np.abs(both - aim)) < 4 * 0.2e-6 / np.sqrt(2)
    turning = (found.deviations["EXC"] + 1j * found.deviations["EYC"]) @ np.exp(-1j * grid)
    assert abs(turning) < 1e-14
    assert found.details["consistency"]["EXC, EYC"]["dof"] == 2 * 24 - 2 * 4 - (24 - 4)


def test_coverage_and_chi_square_of_pairs():
    """With the covariance between the components, which no result holds, it would be exact."""
    rng = np.random.default_rng(9)
    grid = np.arange(8) * TAU / 8
    inside, squares, errors = [], [], []
    for _ in range(RUNS):
        aim, first = plate(grid, rng)
        found = combined(first, plate(grid, rng)[1], plate(grid, rng)[1])
        both = np.append(found.deviations["EXC"], found.deviations["EYC"])
        std = np.append(found.std["EXC"], found.std["EYC"])
        inside.append(np.abs(both - aim) <= 1.96 * std)
        errors.append((both - aim) / std)
        squares.append(found.details["consistency"]["EXC, EYC"]["chi2"])
    assert 0.93 < np.mean(inside) < 0.97
    assert np.std(errors) == pytest.approx(1.0, abs=0.05 * np.sqrt(400 / RUNS))
    assert stats.kstest(squares, "chi2", args=(2 * (16 - 4),)).pvalue > 1e-3


def test_components_that_only_some_measured():
    rng = np.random.default_rng(10)
    fine, coarse = np.arange(24) * TAU / 24, np.arange(12) * TAU / 12
    _, both = plate(coarse, rng)
    tracer = campaign(fine, 0.2 * ARCSEC, rng)[2]
    found = combined(both, tracer)
    assert found.components == ("EXC", "EYC", "ECC")
    assert len(found.angles) == 24
    np.testing.assert_allclose(found.deviations["EXC"][::2], both.deviations["EXC"], atol=1e-15)
    assert "EXC was measured at 12 of 24 angles: interpolated at the others" in found.warnings
    assert found.verdict == "ok"


def test_what_an_input_sees_otherwise_is_named():
    """Of four campaigns one saw 1 arcsec of order 2 more; of a scatter no order is named."""
    rng = np.random.default_rng(23)
    grid = np.arange(12) * TAU / 12
    good = [campaign(grid, 0.2 * ARCSEC, rng)[2] for _ in range(3)]
    raw, cov, _ = campaign(grid, 0.2 * ARCSEC, rng)
    odd = result_of(grid, *about_mean(raw + ARCSEC * np.cos(2 * grid - 1.0), cov))
    (words, *_) = combined(good[0], odd, *good[1:]).warnings
    assert "r1 is farthest off; order 2 of ECC (cosine, sine) is another for r1" in words
    wild = result_of(grid, *about_mean(raw + 1.5 * ARCSEC * (-1.0) ** np.arange(12), cov))
    (words, *_) = combined(good[0], wild, *good[1:]).warnings
    assert "r1 is farthest off): " in words


def of_readings(readings, rows, hashes, off=0.0):
    """Return the curve of ``rows`` of readings, three of each of 12 angles."""
    grid, std = np.arange(12) * TAU / 12, 0.2 * ARCSEC
    mean = np.arange(36) % 12 == np.arange(12)[:, None]
    mean = mean & np.isin(np.arange(36), rows)
    by = (np.eye(12) - 1.0 / 12) @ (mean / mean.sum(axis=1, keepdims=True)) * std
    aim = truth(grid) - truth(grid).mean() + off
    influence = Influence(np.arange(len(rows)), 1, {"ECC": by[:, rows]})
    raw = RawData(tuple(hashes[row] for row in rows), influence=influence)
    return result_of(grid, aim + by @ readings, by @ by.T, raw_data=raw)


def test_inputs_that_share_observations_are_weighed_with_their_common_errors():
    """Two of three rounds each, one in common; by hand."""
    rng, grid = np.random.default_rng(24), np.arange(12) * TAU / 12
    aim, inside, squares = truth(grid) - truth(grid).mean(), [], []
    for _ in range(RUNS):
        readings = rng.standard_normal(36)
        hashes = [f"{k:032x}" for k in rng.integers(2**60, size=36)]
        parts = [
            of_readings(readings, rows, hashes) for rows in (np.arange(24), np.arange(12, 36))
        ]
        found = combined(*parts)
        inside.append(np.abs(found.deviations["ECC"] - aim) <= 1.96 * found.std["ECC"])
        squares.append(found.details["consistency"]["ECC"]["chi2"])
    # a quarter of the first and the last round, half of the one in common, about the mean
    expected = 0.2 * ARCSEC * np.sqrt(6.0 / 16.0 * 11.0 / 12.0)
    np.testing.assert_allclose(found.std["ECC"], expected, rtol=1e-3)
    assert 0.93 < np.mean(inside) < 0.97
    low, high = scatter(11 * RUNS)
    assert low < np.mean(squares) / 11.0 < high
    odd = of_readings(readings, np.arange(24), hashes, off=ARCSEC * np.cos(2 * grid))
    (words, *_) = combined(odd, parts[1]).warnings
    assert "ECC: the inputs contradict each other" in words
    assert "another for" not in words  # of one whole nothing is another
