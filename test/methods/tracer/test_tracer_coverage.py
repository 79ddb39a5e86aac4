"""The stated uncertainty is the true one: seeded runs of each variant."""

import numpy as np
import pytest
from chances import LONG, most, scatter, share, squares
from tracer_scene import arc, low_ring, paper_block, simulate

from rotcal_ros.methods.tracer.solver import solve

RUNS = 300 if LONG else 40
CASES = {
    "station": {"variant": "station", "target_std": 1e-6},
    "joint_prior": {"variant": "joint", "datum": "prior", "target_std": 1e-6},
    "joint_free": {"variant": "joint", "datum": "free", "target_std": 1e-5},
}


@pytest.mark.slow
@pytest.mark.parametrize("case", CASES)
def test_95_percent_intervals_hold_the_truth(case):
    options = CASES[case]
    layout = paper_block if case == "station" else low_ring
    angles, motion = arc(7, 45.0), 1e-7
    inside = np.empty((RUNS, 6))
    adjacent_inside = np.empty((RUNS, 6))
    chi2, square, verdicts = np.empty(RUNS), np.empty(RUNS), []
    for run in range(RUNS):
        scene = simulate(run, angles, 20, layout, 2e-7, options["target_std"], motion)
        result = solve(scene.problem(error_motion_std=motion, **options))
        error = result.deviations["ECC"] - scene.deviation
        square[run] = squares(error[1:], result.covariance["ECC"][1:, 1:])
        inside[run] = (np.abs(error) <= 1.96 * result.std["ECC"])[1:]
        error = result.adjacent_deviations - np.diff(scene.deviation)
        adjacent_inside[run] = np.abs(error) <= 1.96 * result.adjacent_std
        chi2[run] = result.sigma0**2
        verdicts.append(result.verdict)
    for hits in (inside, adjacent_inside):
        assert (hits.mean(axis=0) >= share(0.95, RUNS)[0]).all()
        if LONG:
            assert 0.925 <= hits.mean() <= 0.975
            # of one angle: three standard deviations of a binomial of 300 are 0.038
            assert (hits.mean(axis=0) >= 0.91).all()
            assert (hits.mean(axis=0) <= 0.99).all()
    low, high = scatter(inside.size)
    assert low <= square.sum() / inside.size <= high
    assert chi2.mean() == pytest.approx(1.0, abs=0.05)
    assert RUNS - verdicts.count("ok") <= (0.03 * RUNS if LONG else most(0.01, RUNS))
