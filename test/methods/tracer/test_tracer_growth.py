"""Many stations that only targets tie: the same numbers as whole matrices, in little memory."""

import tracemalloc

import bench_growth
import pytest

from rotcal_ros.methods.tracer.solver import solve


def full_circle(m, n=6, **options):
    """The benchmark's problem, jointly, with an error motion of the table to be estimated."""
    return bench_growth.full_circle(
        m, n, **{"variant": "joint", "error_motion_std": None, **options}
    )


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
