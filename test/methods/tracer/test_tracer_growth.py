"""Many stations that only targets tie: the same numbers as whole matrices, in little memory."""

import tracemalloc
from dataclasses import replace

import bench_growth
import numpy as np
import pytest

from rotcal_ros.adjust.low_rank import LowRank
from rotcal_ros.methods.tracer.solver import solve
from rotcal_ros.methods.tracer.solver.adjustment import StationCovariance
from rotcal_ros.methods.tracer.solver.joint import network_covariance
from rotcal_ros.methods.tracer.solver.solution import adjust
from rotcal_ros.methods.tracer.solver.uncertainty import (
    angle_uncertainty,
    circle_test,
    circle_tested,
    error_motion_of,
)


def full_circle(m, n=6, **options):
    """The benchmark's problem, jointly, with an error motion of the table to be estimated."""
    return bench_growth.full_circle(
        m, n, **{"variant": "joint", "error_motion_std": None, **options}
    )


def whole(covariance):
    return StationCovariance(
        LowRank.whole(covariance.lengths.dense(), 3),
        LowRank.whole(covariance.targets.dense(), 3),
        covariance.sensitivity,
        covariance.dof_effective,
    )


def close(found, expected, share=1e-9):
    np.testing.assert_allclose(found, expected, rtol=0, atol=share * np.abs(expected).max())


def test_the_stations_have_the_covariance_of_the_network_that_keeps_them():
    """Targets eliminated in place of stations: another way through the same normal matrix."""
    solution = adjust(full_circle(90))
    fit, grid = solution.fit, solution.grid
    assert fit.network is not None
    assert solution.covariance.lengths.columns is not None
    other = network_covariance(
        grid, replace(fit, network=replace(fit.network, stations_kept=True))
    )
    for name in ("lengths", "targets"):
        found, expected = getattr(solution.covariance, name), getattr(other, name)
        close(found.dense(), expected.dense(), 1e-8)
    close(solution.covariance.sensitivity, other.sensitivity, 1e-8)


@pytest.mark.parametrize("variant", ["joint", "station"])
def test_angles_and_circle_are_those_of_whole_matrices(variant):
    solution = adjust(full_circle(90, variant=variant))
    motion, fit, thin = solution.motion, solution.fit, solution.covariance
    assert thin.lengths.columns is not None
    dense = whole(thin)
    one, other = (angle_uncertainty(motion, fit.stations, c, 3e-7, 1.2) for c in (thin, dense))
    largest = other.std.max()
    for found, expected in (
        (one.std, other.std),
        (one.adjacent_std, other.adjacent_std),
        *zip(one.budget.values(), other.budget.values(), strict=True),
    ):
        np.testing.assert_allclose(found, expected, rtol=0, atol=1e-8 * largest)
    close(one.covariance, other.covariance, 1e-10)
    assert one.std[0] == 0.0
    assert not one.covariance[0].any()
    moves = np.random.default_rng(3).standard_normal((4, 90, 3))
    tests = [circle_tested(fit.stations, motion, c.total, 1e-7, None) for c in (thin, dense)]
    assert tests[0].residuals.absorbed.size > tests[1].residuals.absorbed.size == 0
    close(*(test.residuals.squares(test.moved(moves)) for test in tests))
    close(*(np.array([test.residuals.variance, test.residuals.dof]) for test in tests))
    assert circle_test(tests[0]).sigma0 == pytest.approx(circle_test(tests[1]).sigma0, rel=1e-9)
    found = [error_motion_of(fit.stations, motion, c, 1.0, None, False)[0] for c in (thin, dense)]
    assert found[0].allowed == pytest.approx(found[1].allowed, rel=1e-9, abs=1e-12)
    assert found[0].likely == pytest.approx(found[1].likely, rel=1e-9)


@pytest.mark.slow
@pytest.mark.parametrize("variant", ["joint", "station"])
def test_800_positions_take_the_memory_of_their_covariance_a_few_times(variant):
    m = 800
    problem = full_circle(m, 8, variant=variant)
    tracemalloc.start()
    result = solve(problem)
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert result.verdict == "ok"
    assert peak < 8.0 * 8 * m**2  # a covariance of the stations alone is nine times the angles'
