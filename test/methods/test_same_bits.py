"""A result does not depend on the number of threads that the linear algebra may take."""

from pathlib import Path

from threadpoolctl import threadpool_limits

import rotcal_ros as rc

MIRROR = Path(__file__).parents[2] / "config" / "plane_mirror_demo.yaml"


def test_one_thread_and_four_make_the_same_bits():
    configuration = rc.read_configuration(MIRROR)
    observations = rc.simulate_observations(configuration)
    results = []
    for threads in (1, 4):
        with threadpool_limits(threads, "blas"):
            results.append(rc.solve(observations, configuration).to_json())
    assert results[0] == results[1]
