"""Every kernel says what the whole matrix says, of designs drawn at random."""

import numpy as np
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st
from scipy.sparse import csr_array, vstack

from rotcal_ros.adjust.bordered import BorderedKernel, SparseDesign
from rotcal_ros.adjust.circles import CircularDesign
from rotcal_ros.adjust.kernels import (
    ConstrainedKernel,
    DenseDesign,
    DenseKernel,
    LowRankUpdateKernel,
    ReweightedKernel,
)
from rotcal_ros.adjust.outputs import Outputs


def alike(found, expected):
    """Whether they agree to 1e-9 of the largest, or of one."""
    return np.abs(found - expected).max(initial=0.0) < 1e-9 * max(1.0, np.abs(expected).max())


class Reference:
    """N^-1 by numpy's pseudo inverse, and what follows."""

    def __init__(self, design):
        scale = np.linalg.norm(design, axis=0)
        scale[scale == 0.0] = 1.0
        unit = design / scale
        _, size, ways = np.linalg.svd(unit)
        self.rank = int((size > 1e-9 * size[0]).sum())
        self.design, self.directions = design, ways[self.rank :].T / scale[:, None]
        self.gain = np.linalg.pinv(unit, rcond=1e-9) / scale[:, None]
        self.hat = design @ self.gain
        self.firm = size[self.rank - 1] > 1e-4 * size[0]


def agrees(kernel, expected, random):
    """All of the protocol, for functions of the unknowns that are determined."""
    n, p = expected.design.shape
    some = np.sort(random.choice(n, size=max(1, n // 2), replace=False))
    white, told = random.standard_normal((n, 2)), random.standard_normal((3, n)) @ expected.design
    carried = told @ expected.gain
    assert kernel.rank == expected.rank
    assert expected.design @ kernel.directions == pytest.approx(0.0, abs=1e-9)
    assert np.linalg.matrix_rank(kernel.directions, tol=1e-9) == p - expected.rank
    assert alike(kernel.leverage, np.diagonal(expected.hat))
    assert alike(kernel.hat_block(some), expected.hat[np.ix_(some, some)])
    assert alike(kernel.projected(white), expected.hat @ white)
    assert alike(told @ kernel.solve(white), carried @ white)
    assert alike(told @ kernel.solve(white[:, 0]), carried @ white[:, 0])
    assert alike(told @ kernel.times(told.T), carried @ carried.T)
    assert alike(told @ kernel.gains(some), carried[:, some])
    assert alike(kernel.adjusted(told.T).T, carried)
    assert alike(kernel.variances(told), (carried**2).sum(axis=1))
    outputs = Outputs.of([told])
    share = random.random((2, n))
    assert alike(kernel.variances_of(outputs), (carried**2).sum(axis=1))
    assert alike(kernel.covariance_of(outputs), carried @ carried.T)
    pairs = random.integers(n, size=(2, n))
    products = carried[:, pairs[0]] * carried[:, pairs[1]] @ share.T
    assert alike(kernel.output_products(outputs, *pairs, share), products)
    assert alike(kernel.hat_square_sums(share), share @ expected.hat**2 @ share.T)
    assert alike(kernel.response(outputs, some), carried[:, some])
    assert alike(kernel.sensitivity(outputs, some).dense(), carried[:, some])
    if expected.rank == p > 2:  # each unknown by itself
        each = kernel.sensitivity(Outputs.of([np.eye(p)]), some[:-1])
        assert alike(each.dense(), expected.gain[:, some[:-1]])
    used = np.diagonal(expected.hat) > 0.0
    parts = (np.arange(n) % 3 == np.arange(3)[:, None]) & used
    whole = np.array([[(expected.hat[np.ix_(a, b)] ** 2).sum() for b in parts] for a in parts])
    assert alike(kernel.shared(parts), whole)


@st.composite
def bordered(draw):
    """Stations with unknowns of their own, and some that all share; some of it open, or weak."""
    random = np.random.default_rng(draw(st.integers(0, 2**32)))
    groups, own = draw(st.integers(6, 14)), draw(st.integers(1, 3))
    shared, known, extra = (draw(st.integers(0, most)) for most in (4, 4, 2))
    rows = []
    for group in range(groups):
        for _ in range(own + draw(st.integers(1, 4))):
            row = np.zeros(groups * own + shared)
            row[group * own : (group + 1) * own] = random.standard_normal(own)
            row[groups * own :] = random.standard_normal(shared)
            rows.append(row)
    few = np.array(rows)
    if shared > 1 and draw(st.booleans()):
        few[:, -1] = few[:, -2]  # which nothing tells apart
    if draw(st.booleans()):
        few[:, 0] *= 0.0  # which nothing determines
    more = 10.0 ** draw(st.integers(-1, 2)) * random.standard_normal((known, few.shape[1]))
    more[:, few.any(axis=0) == 0.0] = 0.0
    more[:, -1] = more[:, -2] if shared > 1 else more[:, -1]
    columns = random.standard_normal((len(few) + known, extra)) if extra else None
    pattern = csr_array((few != 0.0) | (np.arange(few.shape[1]) == 0))
    few = csr_array((few[pattern.nonzero()], pattern.indices, pattern.indptr), shape=few.shape)
    return SparseDesign(few, more, columns), random


@given(bordered(), st.integers(0, 6))
def test_blocks_and_a_border(drawn, left_out):
    design, random = drawn
    weight = np.exp(random.standard_normal(design.shape[0]))
    weight[random.choice(design.few.shape[0], left_out, replace=False)] = 0.0
    white = design.weighted(weight)
    expected = Reference(white.dense())
    assume(expected.firm)
    kernel = white.kernel()
    assert isinstance(kernel, BorderedKernel)
    agrees(kernel, expected, random)


@given(st.integers(4, 40), st.integers(1, 8), st.integers(0, 3), st.integers(0, 2**32))
def test_the_whole_matrix_itself(n, p, open_, seed):
    random = np.random.default_rng(seed)
    matrix = random.standard_normal((n, p)) * np.exp(5.0 * random.standard_normal(p))
    matrix = np.hstack([matrix, matrix[:, :open_] * 3.0])
    expected = Reference(matrix)
    assume(expected.firm)
    agrees(DenseKernel.of(DenseDesign(matrix), np.zeros(0, dtype=int)), expected, random)
    held = np.arange(p, matrix.shape[1])
    agrees(DenseKernel.of(DenseDesign(matrix), held), expected, random)


def circular(random, size, shifts):
    """Return readings of a table against marks, each at some shifts, and the zero of each."""
    setting, table = np.divmod(np.arange(len(shifts) * size), size)
    mark = (table - np.array(shifts)[setting]) % size
    column = np.stack([table, size + mark, 2 * size + setting], axis=1)
    value = np.tile([1.0, -1.0, 1.0], len(table))
    begin = 3 * np.arange(len(table) + 1)
    rows = csr_array((value, column.ravel(), begin), shape=(len(table), 2 * size + len(shifts)))
    return CircularDesign.of(rows, 2, size)


@given(st.integers(5, 16), st.integers(0, 4), st.integers(0, 2), st.integers(0, 2**32))
def test_circles_with_readings_left_out_and_effects(size, left_out, effects, seed):
    random = np.random.default_rng(seed)
    design = circular(random, size, (0, 1, 3)).with_extra(
        random.standard_normal((3 * size, effects))
    )
    weight = np.ones(3 * size)
    weight[random.choice(3 * size, left_out, replace=False)] = 0.0
    white = design.weighted(weight)
    expected = Reference(white.dense())
    assume(expected.firm)
    kernel = white.kernel()
    assume(kernel is not None)
    agrees(kernel, expected, random)


@given(
    st.integers(5, 12), st.integers(0, 3), st.sampled_from([1e-3, 0.4, 7.0]), st.integers(0, 2**32)
)
def test_circles_that_share_no_unknown_take_each_its_own_noise(size, left_out, ratio, seed):
    random = np.random.default_rng(seed)
    each, n = circular(random, size, (0, 1, 3)).few, 3 * size
    column = np.arange(2 * size + 3)
    place = np.where(column < 2 * size, column, column + 2 * size)  # zeros of settings come last
    shift = np.where(column < 2 * size, 2 * size, 3)
    parts = [
        csr_array((each.data, where[each.indices], each.indptr), shape=(n, 4 * size + 6))
        for where in (place, place + shift)
    ]
    design = CircularDesign.of(csr_array(vstack(parts, format="csr")), 4, size)
    used = np.ones(2 * n)
    used[random.choice(2 * n, left_out, replace=False)] = 0.0
    before = design.weighted(used).kernel()
    assume(before is not None)
    factors = np.repeat([1.0, ratio], n)
    white = design.weighted(used * factors)
    expected = Reference(white.dense())
    assume(expected.firm)
    kernel = white.kernel()
    assert isinstance(kernel, ReweightedKernel)
    assert kernel.base is before
    agrees(kernel, expected, random)
    uneven = np.where(np.arange(2 * n) % 2, factors, 1.3 * factors)
    assert not isinstance(design.weighted(used * uneven).kernel(), ReweightedKernel)


@given(bordered(), st.integers(0, 4), st.integers(0, 2), st.booleans())
def test_rows_left_out_and_effects_beside_any_kernel(drawn, left_out, effects, whole):
    design, random = drawn
    n = design.shape[0]
    base = DenseKernel.of(design, np.zeros(0, dtype=int)) if whole else design.kernel()
    out = random.choice(design.few.shape[0], left_out, replace=False)
    share = np.ones(n)
    share[out] = 0.0
    extra = random.standard_normal((n, effects)) * share[:, None]
    rest = design.weighted(share)
    expected = Reference(np.hstack([rest.dense(), extra]))
    assume(expected.firm)
    assume(
        np.abs(np.linalg.eigvalsh(np.eye(left_out) - base.hat_block(out))).min(initial=1.0) > 1e-4
    )
    kernel = LowRankUpdateKernel.of(
        base, rest, share, (design.rows(out), -np.ones(left_out)), extra
    )
    assume(kernel is not None)
    agrees(kernel, expected, random)


@pytest.mark.parametrize("each", [1, 3, 5])
@pytest.mark.parametrize("form", ["groups", "whole", "defined", "changed"])
def test_what_many_rows_show_together(form, each):
    """T and rank by eigenvalues; all rows of a group leave its own unknown open."""
    random = np.random.default_rng(7)
    matrix = np.hstack([np.eye(60)[np.repeat(np.arange(60), 5)], random.standard_normal((300, 3))])
    matrix[:, :60] *= random.uniform(0.5, 2.0, 300)[:, None]
    design = SparseDesign(csr_array(matrix), random.standard_normal((2, 63)))
    rows = np.append((np.arange(40)[:, None] * 5 + np.arange(each)).ravel(), 301)
    kernel = {
        "groups": design.kernel,
        "whole": lambda: DenseKernel.of(design, np.zeros(0, dtype=int)),
        "defined": lambda: ConstrainedKernel.of(design.kernel(), np.ones((1, 63))),
        "changed": lambda: LowRankUpdateKernel.of(
            design.kernel(), design, np.ones(302), (design.rows(rows[:0]), np.zeros(0)),
            random.standard_normal((302, 1)),
        ),
    }[form]()  # fmt: skip
    values, vectors = np.linalg.eigh(np.eye(len(rows)) - kernel.hat_block(rows))
    seen = values > 1e-6
    assert len(rows) - seen.sum() == 39 * (each == 5)  # one combination of them is known
    white = (vectors * values) @ random.standard_normal(len(rows))
    expected = ((vectors[:, seen].T @ white) ** 2 / values[seen]).sum()
    assert kernel.together(rows, white) == (pytest.approx(expected, rel=1e-9), seen.sum())


@given(st.integers(5, 12), st.integers(0, 2), st.integers(0, 2**32))
def test_sums_over_places_of_circles_by_their_orders(size, left_out, seed):
    """Rows of two settings, where the table stands alike; outputs are counted from one place."""
    random = np.random.default_rng(seed)
    weight = np.ones(3 * size)
    weight[random.choice(3 * size, left_out, replace=False)] = 0.0
    white = circular(random, size, (0, 1, 3)).weighted(weight)
    expected, kernel = Reference(white.dense()), white.kernel()
    assume(expected.firm and kernel is not None)
    place, turn = np.arange(size), random.uniform(0.0, 6.0, size)
    few, common = np.zeros((size + 1, expected.design.shape[1])), np.zeros((2, 2 * size + 3))
    few[place, place], few[place, size + (place + 1) % size] = np.cos(turn), np.sin(turn)
    common[[0, 1], [2, size]] = -1.0
    few[-1, -2:] = 1.0, -1.0  # zeros of settings are no places
    share = np.vstack([np.column_stack([np.cos(turn), np.sin(turn)]), np.zeros((1, 2))])
    outputs = Outputs(csr_array(few), common, share)
    assert outputs[:] @ expected.directions == pytest.approx(0.0, abs=1e-9)
    carried = outputs[:] @ expected.gain
    first = np.arange(2 * size)
    second = np.where(first < size, first + size, first)
    share = random.random((2, 2 * size))
    products = carried[:, first] * carried[:, second] @ share.T
    assert alike(kernel.output_products(outputs, first, second, share), products)
    assert alike(kernel.covariance_of(outputs), carried @ carried.T)
