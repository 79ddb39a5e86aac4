import pickle

import numpy as np
import pytest
from mirror_cell import measure, measure_direct, paper_cell

from rotcal_ros.evaluation.monte_carlo import compare_with_linear, propagate
from rotcal_ros.methods.plane_mirror.solver import mirror_trials, solve


def problem_of(way, lean=0.06):
    cell = paper_cell(lean=lean, reflectors=2)
    rng = np.random.default_rng(6)
    if way == "direct":
        return measure_direct(cell, np.zeros((17, 6)), np.array([[0.3, 0.1, 0.1]]), rng=rng)
    return measure(cell, np.zeros((17, 6)), rng=rng, way=way)


@pytest.mark.slow
@pytest.mark.parametrize("way", ["direct", "stitching", "registration", "joint"])
def test_trials_scatter_as_the_linear_covariance_says(way):
    problem = problem_of(way)
    result = solve(problem)
    found = propagate(mirror_trials(problem), seed=1, max_trials=1000)
    np.testing.assert_allclose(found.std[1:], result.std["ECC"][1:], rtol=0.1)
    assert not compare_with_linear(found, result.deviations["ECC"], result.std["ECC"])


def test_trials_travel_to_workers():
    trials = mirror_trials(problem_of("joint"))
    copy = pickle.loads(pickle.dumps(trials))
    first, second = (t(np.random.default_rng(3), 4) for t in (trials, copy))
    np.testing.assert_array_equal(first, second)
