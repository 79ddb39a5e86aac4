"""One simulated table by four methods and a reference: they agree as often as they should."""

from dataclasses import replace

import numpy as np
import one_table
import pytest
from chances import LONG, most, scatter, share

from rotcal_ros.evaluation.combination import CombinationInput
from rotcal_ros.evaluation.compare import compare, compare_all
from rotcal_ros.evaluation.joint import combine
from rotcal_ros.evaluation.reference import subtract_polygon
from rotcal_ros.foundation.components import COMPONENTS
from rotcal_ros.foundation.curves.measured import MeasuredCurve, measured_curve
from rotcal_ros.foundation.units import ARCSEC
from rotcal_ros.methods.ball_plate import solver as ball_plate

RUNS = 32 if LONG else 8
pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def tables():
    """Many tables with their results of four methods; everything is drawn anew in each."""
    found = []
    for seed in range(RUNS):
        table, results = one_table.by_every_method(seed)
        assert [r.verdict for r in results.values()].count("failed") == 0
        found.append((table, results))
    return found


@pytest.fixture(scope="module")
def comparisons(tables):
    """All pairs of the methods."""
    return [
        compare_all({n: measured_curve(r) for n, r in results.items()}) for _, results in tables
    ]


PAIRS = [
    ("tracer", "plate"), ("tracer", "mirror"), ("plate", "mirror"),
    ("tracer", "six"), ("plate", "six"), ("mirror", "six"),
]  # fmt: skip


@pytest.mark.parametrize("pair", PAIRS, ids="-".join)
def test_normalised_errors_are_within_one_at_the_expected_rate(comparisons, pair):
    errors = np.concatenate([run[pair].normalised_error for run in comparisons])
    low, high = (0.925, 0.985) if LONG else share(0.9545, len(errors))
    assert low <= np.mean(np.abs(errors) <= 1.0) <= high
    low, high = scatter(sum(run[pair].dof for run in comparisons))
    assert low < np.mean([run[pair].chi2 / run[pair].dof for run in comparisons]) < high
    assert [run[pair].agree for run in comparisons].count(False) <= most(0.05, RUNS)


def test_all_angles_were_measured_by_both(comparisons):
    for pair, angles in zip(PAIRS, (12, 12, 24, 12, 12, 12), strict=True):
        comparison = comparisons[0][pair]
        assert len(comparison.angles) == angles
        assert not comparison.interpolated.any()


def test_the_combination_of_all_three_is_as_good_as_it_says(tables):
    inside, single, consistent = [], [], 0
    for table, every in tables:
        results = {name: every[name] for name in ("tracer", "plate", "mirror")}
        found = combine([CombinationInput.of(name, result) for name, result in results.items()])
        best = found.result
        error = best.deviations["ECC"] - (table[:, 5] - table[:, 5].mean())
        inside.append(np.abs(error) <= 1.96 * best.std["ECC"])
        alone = [
            combine([CombinationInput.of(n, r)]).result.std["ECC"] for n, r in results.items()
        ]
        single.append(min(np.mean(std) for std in alone) / np.mean(best.std["ECC"]))
        consistent += all(group.consistent for group in found.groups)
        plate = results["plate"]
        np.testing.assert_allclose(best.deviations["EXC"], plate.deviations["EXC"], atol=1e-13)
        np.testing.assert_allclose(best.std["EXC"], plate.std["EXC"], rtol=0.02)
    assert 0.93 < np.mean(inside) < 0.97
    assert min(single) > 1.0
    assert consistent >= 0.95 * RUNS


def test_all_six_by_plate_and_by_lengths_combine(tables):
    """Each has a gauge of its own; chi-squared of every group of components fits."""
    consistent = []
    for _, results in tables[:10]:
        found = combine([CombinationInput.of(name, results[name]) for name in ("plate", "six")])
        assert found.result.components == COMPONENTS
        consistent += [group.consistent for group in found.groups]
        for name in COMPONENTS:
            alone = min(results[one].std[name].mean() for one in ("plate", "six"))
            assert found.result.std[name].mean() < 1.05 * alone
    assert np.mean(consistent) > 0.85


def paper_check(seed):
    """Twelve balls at 30 degrees, and a 24-sided polygon every 15 degrees."""
    rng = np.random.default_rng(seed)
    table = one_table.table_deviations(24, rng)
    faces = rng.normal(0.0, 3.0 * ARCSEC, 24)
    reading = one_table.by_autocollimator(table, rng, faces)
    known = faces + rng.normal(0.0, 0.1 * ARCSEC, 24)
    calibrated = MeasuredCurve(
        reading.angles, known, (0.1 * ARCSEC) ** 2 * np.eye(24), reading.period
    )
    balls = ball_plate.solve(one_table.by_ball_plate(table[::2], rng, tuple(range(12))))
    return measured_curve(balls), reading, calibrated


def test_thirty_degree_points_of_a_fifteen_degree_reference():
    """The paper's check of its ball plate: at the common angles, nothing interpolated."""
    errors = []
    for seed in range(25):
        plate, reading, polygon = paper_check(seed)
        comparison = compare(plate, subtract_polygon(reading, polygon))
        np.testing.assert_allclose(np.rad2deg(comparison.angles), np.arange(12) * 30.0, atol=1e-9)
        assert not comparison.interpolated.any()
        errors.append(comparison.normalised_error)
    assert np.mean(np.abs(errors) <= 1.0) == pytest.approx(0.9545, abs=0.035)


def test_face_errors_of_the_polygon_matter():
    plate, reading, polygon = paper_check(1)
    assert compare(plate, subtract_polygon(reading, polygon)).agree
    assert not compare(plate, reading).agree
    wrong = replace(polygon, deviation=-polygon.deviation)
    assert not compare(plate, subtract_polygon(reading, wrong)).agree
