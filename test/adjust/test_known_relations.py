"""What outputs are known to keep, as steps of a turn, and slips that may stay unseen."""

from dataclasses import replace

import numpy as np
import pytest
from chances import LONG, most, share
from scipy import stats

from rotcal_ros.adjust.closures import ClosureTest
from rotcal_ros.adjust.distributions import noncentrality
from rotcal_ros.adjust.engine import adjust
from rotcal_ros.adjust.gathering import Words
from rotcal_ros.adjust.model import (
    Disturbing,
    Grouping,
    KnownRelation,
    Model,
    Steps,
    Unit,
    UnseenEventPrior,
    indicators,
    linear,
)
from rotcal_ros.adjust.observable import observe_family

SIGMA, M, READ = 1e-6, 12, 4
MICRON = Unit("um", 1e-6)
WORDS = Words("readings", "warm air", "in the beams", "in its beams")


def turn(rng, creeping=0.0, closing=True, effect=None):
    """Return steps (12,) of a turn, each read four times, while something creeps on."""
    step, when = np.repeat(np.arange(M), READ), np.arange(float(M * READ))
    truth = 1e-5 * rng.standard_normal(M)
    truth -= truth.mean()
    observed = truth[step] + creeping + SIGMA * rng.standard_normal(len(step))
    offset = Disturbing("drift", "the reader turns on", np.ones((len(step), 1)), 1e-3, MICRON)
    return truth, Model(
        blocks={"step": M}, observed=observed, std=np.full(len(step), SIGMA),
        equations=linear(indicators((step, M))), outputs=np.eye(M), words=WORDS, unit=MICRON,
        groupings=(Grouping("step", step, along=when),), effects=(effect or offset,),
        closures=[KnownRelation("the steps of a turn do not add up", np.ones((1, M)))]
        if closing else (),
    )  # fmt: skip


def test_what_no_residual_shows_is_shown_by_what_does_not_close():
    _, model = turn(np.random.default_rng(1), creeping=2e-6)
    found = adjust(model)
    assert found.verdict == "suspect"
    assert found.doubts[0].startswith("the steps of a turn do not add up, by 2")
    assert "it looks as if the reader turns on" in found.doubts[1]
    (closed,) = found.closed
    assert closed.error == pytest.approx(found.value.sum())
    assert closed.std == pytest.approx(SIGMA * np.sqrt(M / READ))
    assert closed.probability == pytest.approx(
        2.0 * stats.norm.sf(abs(closed.error[0]) / closed.std[0])
    )
    assert adjust(replace(model, closures=())).verdict == "ok"
    assert found.details()["closed"][0]["p_value"] == closed.probability


def test_a_sound_turn_closes_as_often_as_stated():
    runs, open_ = 200, 0
    for seed in range(runs):
        _, model = turn(np.random.default_rng(seed))
        open_ += adjust(model).closed[0].probability < 0.05
    assert open_ <= most(0.05, runs)
    assert open_ >= 1


def noisy(rng):
    """Return eight steps of unknown noise, two of them with four degrees of freedom of their own.

    That one alone does not close.
    """
    step = np.append(np.repeat(np.arange(6), 12), np.repeat([6, 7], 3))
    component = (step > 5).astype(np.int64)
    return Model(
        blocks={"step": 8}, observed=[3e-6, 5e-7] @ np.eye(2)[:, component]
        * rng.standard_normal(len(step)), std=np.full(len(step), SIGMA),
        equations=linear(indicators((step, 8))), outputs=np.eye(8), words=WORDS, unit=MICRON,
        components=("six", "two"), component=component, unstated=True,
        closures=[KnownRelation("two steps do not add up", np.eye(1, 8, 6) + np.eye(1, 8, 7))],
    )  # fmt: skip


def test_noise_of_few_degrees_of_freedom_is_no_surer_beside_that_of_many():
    """Student's t of the four that tell of it, not of all 70; and sound data close as often."""
    runs, open_ = 200, 0
    for seed in range(runs):
        (closed,) = adjust(noisy(np.random.default_rng(seed))).closed
        ratio = abs(closed.error[0]) / closed.std[0]
        assert closed.probability == pytest.approx(2.0 * stats.t.sf(ratio, 4), rel=0.02)
        open_ += closed.probability < 0.05
    low, high = share(0.05, runs)
    assert low < open_ / runs < high


def test_an_effect_that_only_a_closure_shows_is_as_probable_as_that():
    """What does not close is among what the effect explains: it does not make the noise less."""
    _, model = turn(np.random.default_rng(1), creeping=2e-6)
    found = adjust(replace(model, unstated=True))
    assert found.doubts[1].startswith("it looks as if the reader turns on")
    (closed,) = found.closed
    assert found.doubts[1].parts[1] == pytest.approx(closed.probability, rel=0.01, abs=0.0)


def test_protections_know_what_closes():
    """Baarda's size of an offset that only the sum shows; without it nothing does."""
    _, model = turn(np.random.default_rng(2))
    (effect,) = (p for p in adjust(model).protections() if p.effect == "drift")
    assert effect.treatment == "tested"
    size = np.sqrt(noncentrality(0.01, 0.95)) * np.sqrt(M / READ) / M
    assert effect.error == pytest.approx(size / np.sqrt(1.0 / READ), rel=1e-3)
    (effect,) = (
        p for p in adjust(replace(model, closures=())).protections() if p.effect == "drift"
    )
    assert effect.treatment == "not protected"


@pytest.mark.parametrize("ways", [None, np.random.default_rng(3).standard_normal((M * READ, 2))])
def test_moves_are_seen_by_both(ways):
    """By running sums as by columns that are written out, and by plain algebra."""
    n = M * READ
    move = Steps(np.zeros(n, dtype=int), np.arange(float(n)), ways)
    knock = Disturbing("knock", "it moved", move, 1e-3, MICRON, family=True)
    _, model = turn(np.random.default_rng(4), effect=knock)
    fit = adjust(model).fit
    closed = ClosureTest(fit, KnownRelation("", np.ones((1, M)), 2e-7))
    written = replace(knock, columns=move.whole(), of_each=move.width)
    one = closed.beside(knock, observe_family(fit, move))
    two = closed.beside(written, observe_family(fit, move.whole(), move.width))
    white = move.whole() / SIGMA
    sums = np.ones(M) @ np.linalg.pinv(indicators((np.repeat(np.arange(M), READ), M))) * SIGMA
    root = np.sqrt(sums @ sums + 2e-7**2)
    left = np.vstack([fit.residuals_of(white), sums @ white / root])
    expected = left.T @ left
    for each in (one, two):
        k, w = each.score.shape
        blocks = expected.reshape(k, w, k, w)[np.arange(k), :, np.arange(k)]
        np.testing.assert_allclose(each.information, blocks, rtol=1e-6, atol=1e-3)
        white_error = fit.value.sum() / root
        score = left.T @ np.append(fit.white, white_error)
        np.testing.assert_allclose(each.score.ravel(), score, rtol=1e-6, atol=1e-3)


def drifting(rng, slip, probability=0.5):
    """Return truth (8,) and runs of one zero, with a slip at any moment of one as often as not."""
    run, place = np.divmod(np.arange(24), 8)
    truth, zeros = 1e-4 * rng.standard_normal(8), 1e-4 * rng.standard_normal(3)
    observed = truth[place] + zeros[run] + SIGMA * rng.standard_normal(24)
    moves = Steps(run, np.arange(24.0))
    if rng.random() < 0.5:
        observed += moves.whole()[:, rng.integers(21)] * slip * rng.choice([-1.0, 1.0])
    outputs = np.eye(8, 11) - np.pad(np.full((8, 8), 1.0 / 8.0), ((0, 0), (0, 3)))
    slips = Disturbing("slip", "lengths shifted", moves, 1e-4, MICRON, family=True)
    return truth - truth.mean(), Model(
        blocks={"place": 8, "zero": 3}, observed=observed, std=np.full(24, SIGMA),
        equations=linear(indicators((place, 8), (run, 3))), outputs=outputs, words=WORDS,
        unit=MICRON, groupings=(Grouping("run", run),), effects=(slips,),
        expected=[UnseenEventPrior(slips, slip, probability)] if probability else (),
    )  # fmt: skip


def test_slips_that_stay_unseen_are_held():
    """Three times the noise, of which most are not found: 95 % hold all the same."""
    held, bare = [], []
    for seed in range(400 if LONG else 80):
        for probability, into in ((0.5, held), (0.0, bare)):
            truth, model = drifting(np.random.default_rng(seed), 3.0 * SIGMA, probability)
            found = adjust(model)
            into += (np.abs(found.value - truth) < 1.96 * found.std).tolist()
    runs = len(held) // 8
    low, high = share(0.945, runs)
    assert low < np.mean(held) < max(high, 0.98)
    assert np.mean(bare) < np.mean(held) - 0.01


def test_trials_hold_expected_slips():
    _, model = drifting(np.random.default_rng(3), 4.0 * SIGMA)
    found = adjust(model)
    drawn = found.trials(np.random.default_rng(8), 20_000)
    assert drawn.std(axis=0) == pytest.approx(found.std, rel=0.03)
    assert np.sqrt(found.covariance.diagonal()) == pytest.approx(found.std)
    bare = adjust(replace(model, expected=()))
    seen = observe_family(found.fit, model.effects[0].columns)
    more = np.zeros(8)
    ratio = np.exp(-0.5 * seen.information[:, 0, 0] * (4 * SIGMA) ** 2)
    ratio *= np.cosh(seen.score[:, 0] * 4 * SIGMA) / 21
    for k, each in enumerate(ratio / (1.0 + ratio.sum())):
        more += each * (4 * SIGMA * seen.moved[k : k + 1][0]) ** 2
    assert found.std**2 - bare.std**2 == pytest.approx(more)
