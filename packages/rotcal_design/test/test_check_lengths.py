"""The lengths of a quick check against dense algebra, and against trying all sets of targets."""

from dataclasses import replace
from itertools import combinations

import numpy as np
import pytest
from scipy import stats
from tracer_scenes import (
    STATIONS,
    dense_angles,
    dense_covariance,
    every_pair,
    paper_scene,
    zero_mean,
)

from rotcal_design.tracer.check_lengths import fewest_lengths
from rotcal_ros.foundation.errors import PlanError
from rotcal_ros.foundation.units import ARCSEC
from rotcal_ros.planning.check_rule import CheckRule

M = len(STATIONS)
EXPECTED = np.full(M, 0.3 * ARCSEC)
LOW = np.array(
    [[x, y, z] for x in (-0.45, 0.15, 0.45) for y in (-0.45, 0.0, 0.45) for z in (0.3, 0.7)]
)


def low_scene(targets=LOW, **changes):
    """Targets low around the tracer, exact in the sense that none is like another."""
    rng = np.random.default_rng(3)
    return paper_scene(targets=targets + 0.02 * rng.normal(size=targets.shape), **changes)


def dense(scene, lengths, one_zero=False):
    """Standard deviations of the angles and redundancies by one dense inverse."""
    whole, rows = dense_covariance(scene, lengths, 1 if one_zero else M)
    std = np.sqrt(dense_angles(scene, lengths, 1 if one_zero else M).diagonal())
    redundancy = 1.0 - np.einsum("ki,ij,kj->k", rows, whole, rows)
    return std, redundancy


def assured(std, limit):
    """The product over the angles, written out."""
    room = limit - stats.norm.ppf(0.95) * std
    return np.prod(stats.norm.cdf(room / np.hypot(std, EXPECTED)) * 2.0 - 1.0) * (room > 0).all()


def deep(scene, lengths):
    """Whether the targets of every station fill a volume."""
    for station in range(M):
        seen = scene.targets[lengths.target[lengths.position == station]]
        size = np.linalg.svd(seen - seen.mean(axis=0), compute_uv=False)
        if size[2] < 0.1 * size[0]:
            return False
    return True


def suffices(scene, lengths, limit, one_zero=False, least=0.25):
    count = np.bincount(lengths.position, minlength=M)
    if count.min() < 5 or not deep(scene, lengths):
        return False
    std, redundancy = dense(scene, lengths, one_zero)
    return assured(std, limit) >= 0.95 - 1e-6 and redundancy.min() >= least - 1e-6


@pytest.mark.parametrize("one_zero", [False, True])
def test_the_choice_keeps_its_promises_and_no_length_is_too_many(one_zero):
    scene, limit = low_scene(), 2.3 * ARCSEC
    found = fewest_lengths(scene, CheckRule(limit), EXPECTED, one_zero)
    std, redundancy = dense(scene, found.lengths, one_zero)
    np.testing.assert_allclose(found.std, std, rtol=1e-5)
    assert found.assurance == pytest.approx(assured(std, limit), rel=1e-6)
    assert found.least_redundancy == pytest.approx(redundancy.min(), abs=1e-5)
    assert suffices(scene, found.lengths, limit, one_zero)
    pairs = list(zip(found.lengths.position, found.lengths.target, strict=True))
    assert len(set(pairs)) == len(pairs)
    for left_out in range(len(pairs)):
        rest = found.lengths[np.arange(len(pairs)) != left_out]
        assert not suffices(scene, rest, limit, one_zero)


def test_no_set_of_targets_is_smaller():
    """Each of the 8 targets or not: with those that all stations see."""
    scene, limit = low_scene(LOW[[0, 3, 5, 8, 10, 12, 15, 17]]), 2.6 * ARCSEC
    every = every_pair(scene)
    smallest = next(
        size
        for size in range(5, 9)
        if any(
            suffices(scene, every[np.isin(every.target, chosen)], limit, least=0.1)
            for chosen in combinations(range(8), size)
        )
    )
    assert 5 < smallest < 8
    found = fewest_lengths(scene, CheckRule(limit), EXPECTED, least_redundancy=0.1)
    assert smallest * M - M < len(found.lengths) <= smallest * M


def test_a_larger_limit_and_a_larger_risk_need_no_more():
    scene, strict = low_scene(LOW[[0, 3, 4, 7, 8, 11, 12, 15, 16]]), CheckRule(2.2 * ARCSEC)
    least = {"least_redundancy": 0.1}
    most = len(fewest_lengths(scene, strict, EXPECTED, **least).lengths)
    for looser in (replace(strict, limit=2.6 * ARCSEC), replace(strict, false_alarm=0.2)):
        assert len(fewest_lengths(scene, looser, EXPECTED, **least).lengths) < most
    unchecked = fewest_lengths(
        scene, replace(strict, limit=5.0 * ARCSEC), EXPECTED, least_redundancy=0.0
    )
    assert len(unchecked.lengths) == 5 * M  # what the solver needs, whatever it checks


def test_what_cannot_be_reached_is_refused_and_the_limit_that_can_is_named():
    scene = low_scene(error_motion_std=1e-7)
    with pytest.raises(PlanError, match="even exact lengths") as raised:
        fewest_lengths(scene, CheckRule(1.0 * ARCSEC), EXPECTED)
    factor = float(str(raised.value).split("at least ")[1].split()[0])
    in_plane = zero_mean(scene).reshape(M, M, 3)[:, :, :2]
    motion = 1e-7 * np.sqrt((in_plane**2).sum(axis=(1, 2)))
    assert assured(motion, (factor + 0.005) * ARCSEC) >= 0.95
    assert assured(motion, (factor - 0.005) * ARCSEC) <= 0.95
    with pytest.raises(PlanError, match="lengths to all 5 targets"):
        fewest_lengths(low_scene(LOW[[0, 3, 8, 13, 16]]), CheckRule(1.0 * ARCSEC), EXPECTED)
    level = LOW * [1.0, 1.0, 0.05]
    with pytest.raises(PlanError, match="nearly in one plane"):
        fewest_lengths(paper_scene(targets=level), CheckRule(5.0 * ARCSEC), EXPECTED)
    with pytest.raises(PlanError, match="4 possible targets"):
        fewest_lengths(low_scene(LOW[:4]), CheckRule(5.0 * ARCSEC), EXPECTED)
    with pytest.raises(PlanError, match="accept less redundancy"):
        fewest_lengths(low_scene(), CheckRule(9.0 * ARCSEC), EXPECTED, least_redundancy=0.9)
