"""Whole plans: judged as if they had been solved one by one, and checked as promised."""

import numpy as np
import pytest
from tracer_scenes import every_pair, paper_scene, some_plan

from rotcal_ros.methods.tracer.policy.exchange import Demands, LengthSelection, fewest_lengths
from rotcal_ros.methods.tracer.policy.information import Information, Scene, detectable_in_std

ARCSEC = np.pi / 180.0 / 3600.0
STRICT = Demands(mean=(0.5 * ARCSEC) ** 2, largest=(0.52 * ARCSEC) ** 2, redundancy=0.5)


def checked(known, delta0):
    """Redundancy of each length, and what an undetected error of it does, in U of the angle."""
    beams = known.beams(known.lengths)
    redundancy = known.redundancy
    effect = (
        beams.angles * (delta0 / np.sqrt(beams.variance * np.maximum(redundancy, 0.02)))[:, None]
    )
    return redundancy, (np.abs(effect) / (2.0 * np.sqrt(known.variances()))).max(axis=1)


def judged_anew(scene, lengths, delta0):
    """The penalty from its definition."""
    known = Information(scene, lengths, 11)
    variances, (redundancy, share) = known.variances(), checked(known, delta0)
    lacking = np.maximum(variances.mean() / STRICT.mean - 1.0, 0.0)
    lacking += np.maximum(variances.max() / STRICT.largest - 1.0, 0.0)
    return (
        10.0 * lacking
        + (np.maximum(share - 1.0, 0.0) ** 2).sum()
        + 40.0 * (np.maximum(0.5 - redundancy, 0.0) ** 2).sum()
    )


def test_every_further_length_and_every_removal_is_judged_exactly():
    scene, pairs, chosen = some_plan()
    plan = LengthSelection(scene, pairs, 11, STRICT, chosen)
    delta0 = detectable_in_std(len(chosen), STRICT.significance, STRICT.power)
    assert plan.penalty == pytest.approx(judged_anew(scene, pairs[chosen], delta0), rel=1e-9)
    without = plan.without_each()
    for k in range(0, len(chosen), 13):
        fewer = judged_anew(scene, pairs[np.delete(chosen, k)], delta0)
        assert without[k] == pytest.approx(fewer, rel=1e-6)
    more = np.append(np.setdiff1d(np.arange(len(pairs)), chosen)[::60], chosen[:2])  # and again
    penalties = plan.with_each(more)
    for k, index in enumerate(more):
        again = judged_anew(scene, pairs[np.append(chosen, index)], delta0)
        assert penalties[k] == pytest.approx(again, rel=1e-6)


def test_changes_gather_no_error_worth_mentioning():
    scene, pairs, chosen = some_plan()
    plan = LengthSelection(scene, pairs, 11, STRICT, chosen)
    rng = np.random.default_rng(1)
    for _ in range(50):
        plan.add(int(rng.integers(len(pairs))))
        plan.remove(int(rng.integers(len(plan.chosen))))
    changed = plan.penalty, plan.variances
    delta0 = detectable_in_std(len(chosen), STRICT.significance, STRICT.power)
    anew = judged_anew(scene, pairs[plan.chosen], delta0)
    assert changed[0] == pytest.approx(anew, rel=1e-6)
    assert changed[1] == pytest.approx(
        Information(scene, pairs[plan.chosen], 11).variances(), rel=1e-6
    )
    plan.recompute()
    assert plan.penalty == pytest.approx(anew, rel=1e-9)


def test_a_station_keeps_its_least_lengths():
    scene, pairs, _ = some_plan()
    five = np.flatnonzero(np.isin(pairs.target, [0, 13, 27, 44, 60]))
    assert np.isinf(LengthSelection(scene, pairs, 11, STRICT, five).without_each()).all()


def test_fewest_lengths_meets_all_demands_and_repeats_with_its_seed():
    whole = paper_scene()
    scene = Scene(whole.stations[::2], whole.table_angles[::2], whole.targets, 1e-6, 0.2e-6)
    pairs = every_pair(scene)
    demands = Demands(mean=(1.5 * ARCSEC) ** 2, largest=(1.8 * ARCSEC) ** 2, share=1.5)
    start = np.flatnonzero(pairs.target % 3 == 0)
    plans = [
        fewest_lengths(scene, pairs, 6, demands, start, seed=seed, exchanges=6) for seed in (4, 4)
    ]
    assert np.array_equal(*plans)
    chosen = plans[0]
    assert len(chosen) < len(start)
    known = Information(scene, pairs[chosen], 6)
    assert np.sqrt(known.mean_variance) <= 1.5 * ARCSEC
    assert np.sqrt(known.variances().max()) <= 1.8 * ARCSEC
    redundancy, share = checked(known, detectable_in_std(len(chosen), 0.01, 0.8))
    assert redundancy.min() >= 0.25
    assert share.max() <= 1.5 + 1e-6
