"""Definitions without noise: free networks whose frame no observation determines."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.sparse import csr_array

from rotcal_ros.adjust import designs
from rotcal_ros.adjust.engine import adjust
from rotcal_ros.adjust.fit import fit_model
from rotcal_ros.adjust.gathering import Words
from rotcal_ros.adjust.kernels import ConstrainedKernel
from rotcal_ros.adjust.model import Grouping, Model, Unit, linear
from rotcal_ros.foundation.errors import ObservabilityError

SIGMA = 1e-6
WORDS = Words("readings", "warm air", "in the beams", "in its beams")
POINTS = np.random.default_rng(1).uniform(-1.0, 1.0, (8, 2))


def network(rng, sparse=False, definitions=True):
    """Return truth (16,) and all distances between eight points in a plane, which lie anywhere."""
    first, second = np.triu_indices(8, 1)

    def equations(x):
        places = POINTS + x.reshape(8, 2)
        apart = places[first] - places[second]
        length = np.linalg.norm(apart, axis=1)
        unit, row = apart / length[:, None], np.arange(len(length))
        design = np.zeros((len(length), 16))
        for axis in range(2):
            design[row, 2 * first + axis] = unit[:, axis]
            design[row, 2 * second + axis] = -unit[:, axis]
        return length, csr_array(design) if sparse else design

    frame = np.zeros((3, 16))
    frame[0, ::2] = frame[1, 1::2] = 1.0
    frame[2, ::2], frame[2, 1::2] = -POINTS[:, 1], POINTS[:, 0]
    shift = 1e-3 * np.random.default_rng(2).standard_normal(16)
    truth = shift - np.linalg.pinv(frame) @ (frame @ shift)
    observed = equations(truth)[0]
    observed = observed + SIGMA * rng.standard_normal(len(observed))
    return truth, frame, Model(
        blocks={"shift": 16},
        observed=observed,
        std=np.full(len(observed), SIGMA),
        equations=equations,
        outputs=np.eye(16),
        words=WORDS,
        unit=Unit("um", 1e-6),
        start=0.01 * np.random.default_rng(3).standard_normal(16),
        groupings=(Grouping("point", first),),
        definitions=frame if definitions else None,
    )  # fmt: skip


@pytest.mark.parametrize("sparse", [False, True])
def test_a_free_network_lies_where_it_is_defined_to(sparse, monkeypatch):
    """Its covariance is that of outputs less what the frame does: P N^+ P', whatever the start."""
    monkeypatch.setattr(designs, "FEW", 0)
    truth, frame, model = network(np.random.default_rng(4), sparse)
    found = adjust(model)
    np.testing.assert_allclose(frame @ found.value, 0.0, atol=1e-15)
    design = np.asarray(model.linearised(found.fit.x)[1].dense()) / SIGMA
    ways = np.linalg.svd(design)[2][-3:].T
    project = np.eye(16) - ways @ np.linalg.inv(frame @ ways) @ frame
    expected = project @ np.linalg.pinv(design.T @ design, rcond=1e-10) @ project.T
    np.testing.assert_allclose(found.covariance, expected, rtol=1e-6, atol=1e-20)
    assert found.std == pytest.approx(np.sqrt(expected.diagonal()))
    assert np.abs(found.value - truth).max() < 5.0 * found.std.max()
    influence = project @ np.linalg.pinv(design)
    assert found.fit.response == pytest.approx(influence, rel=1e-6, abs=1e-9)
    rows = np.array([3, 0, 7])
    assert found.fit.sensitivity(rows).dense() == pytest.approx(
        influence[:, rows], rel=1e-6, abs=1e-9
    )
    drawn = found.trials(np.random.default_rng(5), 20_000)
    np.testing.assert_allclose(np.cov(drawn.T), expected, atol=0.05 * expected.max())


def test_what_is_not_defined_is_named():
    _, frame, model = network(np.random.default_rng(4))
    for few in (None, frame[:2]):
        with pytest.raises(ObservabilityError, match="cannot separate shift"):
            adjust(replace(model, definitions=few))


def test_a_wrong_distance_is_found_whatever_the_frame():
    _, _, model = network(np.random.default_rng(4))
    observed = model.observed.copy()
    observed[5] += 50.0 * SIGMA
    assert list(adjust(replace(model, observed=observed)).why) == [5]


@pytest.mark.parametrize("sparse", [False, True])
def test_parts_that_nothing_joins_are_defined_each(sparse, monkeypatch):
    """Levels of two groups, the mean of each zero: as outputs that are deviations from it."""
    monkeypatch.setattr(designs, "FEW", 0)
    rng, pairs = np.random.default_rng(6), [(k, j) for k in range(6) for j in range(k)]
    design = np.zeros((30, 12))
    for row, (k, j) in enumerate(pairs):
        for group in (0, 1):
            design[15 * group + row, 6 * group + k] = 1.0
            design[15 * group + row, 6 * group + j] = -1.0
    means = np.kron(np.eye(2), np.full(6, 1.0 / 6.0))
    model = Model(
        blocks={"level": 12}, observed=SIGMA * rng.standard_normal(30), std=np.full(30, SIGMA),
        equations=linear(csr_array(design) if sparse else design), outputs=np.eye(12),
        words=WORDS, start=np.arange(12.0), definitions=means,
    )  # fmt: skip
    by_outputs = replace(
        model, outputs=np.eye(12) - np.repeat(means, 6, axis=0), definitions=None, start=None
    )
    one, other = adjust(model), adjust(by_outputs)
    assert isinstance(one.fit.kernel, ConstrainedKernel)
    assert one.fit.dof == other.fit.dof == 20
    assert one.value == pytest.approx(other.value, abs=1e-15)
    np.testing.assert_allclose(one.covariance, other.covariance, rtol=1e-9, atol=1e-24)
    with pytest.raises(ObservabilityError, match="level"):
        adjust(replace(model, definitions=means[:1]))
    every = np.ones(30, dtype=np.bool_)
    assert means @ fit_model(model, every, model.std, model.first).x == pytest.approx(
        0.0, abs=1e-15
    )
