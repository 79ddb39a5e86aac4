"""Unknowns of groups and shared ones: block by block as by the whole matrix, and quicker."""

import numpy as np
import pytest
from scipy.sparse import csr_array

from rotcal_ros.adjust.arrow import Arrow, FewEach, beside, dense, weighted
from rotcal_ros.adjust.engine import adjust
from rotcal_ros.adjust.fit import fitted
from rotcal_ros.adjust.gathering import Words
from rotcal_ros.adjust.model import Grouping, Model
from rotcal_ros.foundation.errors import ObservabilityError

WORDS = Words("readings", "heat", "at the station", "at the station")


def levels(groups=30, each=6, shared=4, uneven=False, seed=1):
    """Return a design of readings from stations with a zero and a slope, and what all share."""
    random, rows = np.random.default_rng(seed), []
    for group in range(groups):
        for number in range(each + (uneven and group % 3)):
            own = [(2 * group, 1.0), (2 * group + 1, number - 2.0)]
            own = own[: 1 if uneven and group % 5 == 0 else 2]
            common = enumerate(random.standard_normal(shared), 2 * groups)
            rows.append([*own, *common])
    lengths = [len(row) for row in rows]
    column, value = np.array([cell for row in rows for cell in row]).T
    begin = np.concatenate([[0], np.cumsum(lengths)])
    return csr_array((value, column.astype(int), begin), shape=(len(rows), 2 * groups + shared))


def by_whole(design, read):
    scale = np.linalg.norm(design, axis=0)
    scale[scale == 0.0] = 1.0
    return np.linalg.lstsq(design / scale, read, rcond=None)[0] / scale


@pytest.mark.parametrize("known", [0, 1, 5])
@pytest.mark.parametrize("shared", [0, 4])
def test_blocks_give_what_the_whole_matrix_gives(known, shared):
    """To 1e-12 of the uncertainty; what is known joins all groups, and holds far better."""
    random, few = np.random.default_rng(2), levels(shared=shared)
    rows = 1e3 * random.standard_normal((known, few.shape[1]))
    design = beside(few, rows)
    design = design if isinstance(design, FewEach) else FewEach(design, rows)
    read = random.standard_normal(few.shape[0] + known)
    arrow = Arrow.of(few)
    assert arrow.own.shape == (30, 2)
    assert arrow.shared.tolist() == list(range(60, 60 + shared))
    whole = dense(design)
    std = np.sqrt(np.linalg.inv(whole.T @ whole).diagonal())
    found = arrow.solved(design, read)
    assert np.abs((found - by_whole(whole, read)) / std).max() < 1e-12
    assert design.times(found) == pytest.approx(whole @ found, abs=1e-12)


def test_groups_may_differ_in_size_and_rows_be_left_out():
    random, few = np.random.default_rng(3), levels(uneven=True)
    few = csr_array(few[:, few.toarray().any(axis=0)])  # some stations have no slope
    design = FewEach(few, np.zeros((0, few.shape[1])))
    weight = random.uniform(0.5, 2.0, few.shape[0]) * (random.uniform(size=few.shape[0]) > 0.1)
    read, arrow = random.standard_normal(few.shape[0]), Arrow.of(few)
    assert (arrow.own < 0).sum() == 6
    found = arrow.solved(weighted(design, weight), weight * read)
    wanted = by_whole(weight[:, None] * few.toarray(), weight * read)
    assert found == pytest.approx(wanted, abs=1e-12)


def test_what_has_no_blocks_or_no_firm_ones_is_left_to_the_whole_matrix():
    whole = csr_array(np.random.default_rng(4).standard_normal((20, 5)))
    assert Arrow.of(whole) is None
    few = levels(groups=4, each=1)
    nothing = np.zeros((0, few.shape[1]))
    assert Arrow.of(few).solved(FewEach(few, nothing), np.ones(few.shape[0])) is None
    few = levels(groups=4)
    open_ = few.toarray()
    open_[:, -1] = open_[:, -2]
    twice = csr_array(open_)
    assert Arrow.of(twice).solved(FewEach(twice, nothing), np.ones(few.shape[0])) is None
    angles = np.append(np.arange(12), 0)
    one_zero = csr_array(np.column_stack([1e7 * np.eye(12)[angles], np.full(13, 1e7)]))
    arrow, read = Arrow.of(one_zero), np.random.default_rng(2).standard_normal(13)
    assert arrow.solved(FewEach(one_zero, np.zeros((0, 13))), read) is None


def stations(sparse):
    few = levels(groups=8)
    design = few if sparse else few.toarray()
    random = np.random.default_rng(6)
    true = random.standard_normal(few.shape[1])
    observed = few @ true + 1e-3 * random.standard_normal(48)
    observed[11] += 0.05
    model = Model(
        blocks={"station": 16, "shared": 4},
        observed=observed,
        std=np.full(48, 1e-3),
        equations=lambda x: (design @ x, design),
        outputs=np.eye(4, 20, 16),
        words=WORDS,
        groupings=[Grouping("station", np.arange(48) // 6)],
    )
    return model.knowing("a sum", np.ones((1, 20)), np.array([true.sum()]), 1e-6)


def test_the_engine_says_the_same_of_both_forms():
    few, whole = adjust(stations(True)), adjust(stations(False))
    assert list(few.why) == list(whole.why) == [11]
    assert np.abs((few.value - whole.value) / whole.std).max() < 1e-9
    assert few.std == pytest.approx(whole.std, rel=1e-9)
    assert few.doubts == whole.doubts


def test_what_nothing_tells_is_refused_in_both_forms():
    for sparse in (True, False):
        model = stations(sparse)
        used = np.arange(49) >= 48  # nothing but what is known
        with pytest.raises(ObservabilityError, match="shared"):
            fitted(model, used, model.std, model.first)


@pytest.mark.parametrize("known", [0, 5])
@pytest.mark.parametrize("lost", [(), range(3, 6), range(60, 66), range(1, 6)])
def test_cofactors_by_blocks_are_those_of_the_whole_matrix(known, lost):
    """By LAPACK's least squares; a station that keeps one reading or none joins what all share."""
    random, few = np.random.default_rng(4), levels()
    rows = random.standard_normal((known, few.shape[1]))
    weight = np.ones(few.shape[0] + known)
    weight[list(lost)] = 0.0
    design = FewEach(few, rows).weighted(weight)
    spanned, root, nothing = Arrow.of(few).factored(design)
    whole, unit = dense(design), np.eye(spanned.below.shape[1])
    inverse, rank = np.linalg.pinv(whole.T @ whole, rcond=1e-11), np.linalg.matrix_rank(whole)
    basis = spanned.times(unit)
    assert len(unit) == rank
    assert len(nothing) == whole.shape[1] - rank
    assert np.abs(whole @ nothing.T).max(initial=0.0) < 1e-12
    assert basis.T @ basis == pytest.approx(unit, abs=1e-11)
    assert whole @ root.times(unit) == pytest.approx(basis, abs=1e-11)
    assert basis @ basis.T == pytest.approx(whole @ inverse @ whole.T, abs=1e-9)
    some = np.arange(2, len(whole), 3)
    assert spanned.rows(some) == pytest.approx(basis[some], abs=1e-12)
    assert spanned.among(some) == pytest.approx(basis[some] @ basis[some].T, abs=1e-12)
    assert spanned.squares == pytest.approx((basis**2).sum(axis=1), abs=1e-12)
    right = random.standard_normal((len(whole), 2))
    assert spanned.adjoint(right) == pytest.approx(basis.T @ right, abs=1e-12)
    assert spanned.adjoint(right[:, 0]) == pytest.approx(basis.T @ right[:, 0], abs=1e-12)
    assert spanned.times(unit[0]) == pytest.approx(basis[:, 0], abs=1e-12)


def test_cofactors_by_blocks_are_kept_in_few_numbers():
    """Ten times as many stations take ten times as many numbers, not a hundred times."""

    def kept(groups):
        few = levels(groups)
        parts = Arrow.of(few).factored(FewEach(few, np.zeros((0, few.shape[1]))))[:2]
        return sum(part.few.nnz + part.ways.size + part.others.size for part in parts)

    assert kept(300) <= 10 * kept(30)
