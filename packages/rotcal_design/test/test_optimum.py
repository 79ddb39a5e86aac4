"""The ideal plan and its bound, against figures of a prototype, random plans, and by hand."""

import numpy as np
import pytest
from scipy.optimize import minimize
from tracer_scenes import BLOCK, dense_angles, every_pair, paper_scene

from rotcal_design.tracer.optimum import ideal_plan, least_count
from rotcal_ros.foundation.errors import PlanError
from rotcal_ros.methods.tracer.policy.information import Information, Scene

ARCSEC = np.pi / 180.0 / 3600.0
GOAL = (0.5 * 1.202 * ARCSEC) ** 2
"""Mean variance of the angles that the paper's 704 lengths reach, k = 2."""


def test_the_papers_block_needs_half_of_its_lengths():
    # A prototype that knew nothing of a round table: 357 reached, 355 proven, with a zero per
    # station; circle of 0.07 um, whose centre was held to be known: 270, 269.
    plain = paper_scene()
    own = ideal_plan(plain, every_pair(plain), 11, GOAL, gap=0.03)
    assert own.gap < 0.03
    assert own.bound == pytest.approx(323.0, rel=0.03)
    assert own.count == pytest.approx(325.0, rel=0.03)
    dense = dense_angles(plain, every_pair(plain).weighing(own.weight), 11)
    assert np.trace(dense) / 11 <= GOAL * (1.0 + 1e-6)
    round_ = paper_scene(circle_std=7e-8)
    shared = ideal_plan(round_, every_pair(round_, "one"), 1, GOAL, gap=0.03)
    assert shared.gap < 0.03
    assert 269.0 <= shared.count <= 1.05 * 270.0
    known = Information(round_, every_pair(round_, "one").weighing(shared.weight), 1)
    assert known.mean_variance <= GOAL * (1.0 + 1e-9)


def test_no_plan_is_below_the_bound():
    # With known targets phi is inverse to the number of lengths: any plan scales to the goal.
    scene = paper_scene(target_std=0.0)
    pairs = every_pair(scene)
    found = ideal_plan(scene, pairs, 11, GOAL, gap=0.05)
    rng = np.random.default_rng(8)
    counts = []
    for spread in np.linspace(0.0, 3.0, 12):
        weight = (found.weight + 1e-3) * rng.lognormal(sigma=spread, size=len(pairs))
        phi = Information(scene, pairs.weighing(weight), 11).mean_variance
        counts.append(weight.sum() * phi / GOAL)
    assert found.bound <= min(counts) <= 1.1 * found.count
    assert max(counts) > 1.3 * found.count
    assert found.bound <= found.count <= 1.05 * found.bound


def test_bound_by_hand():
    slopes, weight = np.array([4.0, 2.0, 1.0]), np.array([1.0, 1.0, 0.0])
    # sum w d + phi - goal = 6 + 3 - 1 = 8
    assert least_count(3.0, weight, slopes, 1.0) == pytest.approx(2.0)
    assert least_count(3.0, weight, slopes, 1.0, repeats=2) == pytest.approx(2.0)
    assert least_count(1.5, weight, slopes, 1.0, repeats=1) == pytest.approx(2.5)
    assert least_count(1.0, weight, slopes, 8.0) == 0.0
    assert least_count(9.0, weight, slopes, 1.0, repeats=1) == 3.0  # all of them are too few


@pytest.mark.parametrize("repeats", [1, 2, 4])
def test_few_repeats_settle_on_what_another_solver_finds(repeats):
    whole = paper_scene()
    scene = Scene(whole.stations[::2], whole.table_angles[::2], BLOCK[::6], 1e-6, 0.2e-6)
    pairs = every_pair(scene)
    most = np.full(len(pairs), float(repeats))
    goal = 1.2 * Information(scene, pairs.weighing(most), 6).mean_variance

    def known(weight):
        return Information(scene, pairs.weighing(weight), 6)

    found = ideal_plan(scene, pairs, 6, goal, repeats=repeats, gap=0.005)
    least = minimize(
        np.sum, most, jac=np.ones_like, bounds=[(0.0, repeats)] * len(pairs), method="SLSQP",
        constraints={
            "type": "ineq",
            "fun": lambda weight: 1.0 - known(weight).mean_variance / goal,
            "jac": lambda weight: known(weight).slopes(pairs) / goal,
        },
    )  # fmt: skip
    assert least.success
    assert found.weight.max() <= repeats
    assert known(found.weight).mean_variance <= goal * (1.0 + 1e-9)
    assert found.bound <= least.fun * (1.0 + 1e-4)
    assert found.count == pytest.approx(least.fun, rel=0.01)
    assert (found.weight > 0.999 * repeats).sum() > len(pairs) / 4  # the limit is felt


def test_out_of_reach_says_so():
    scene = paper_scene()
    with pytest.raises(PlanError, match="out of reach: all 704 candidates"):
        ideal_plan(scene, every_pair(scene), 11, GOAL / 4.0, repeats=1)
