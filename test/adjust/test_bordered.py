"""Unknowns of groups and shared ones: block by block as by the whole matrix, and quicker."""

import numpy as np
import pytest
from scipy.sparse import csr_array

from rotcal_ros.adjust.bordered import Groups, SparseDesign
from rotcal_ros.adjust.designs import dense
from rotcal_ros.adjust.engine import adjust
from rotcal_ros.adjust.fit import fit_model
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
    design = SparseDesign(few, rows)
    read = random.standard_normal(few.shape[0] + known)
    kernel = design.kernel()
    assert kernel.groups.own.shape == (30, 2)
    assert kernel.groups.shared.tolist() == list(range(60, 60 + shared))
    whole = dense(design)
    std = np.sqrt(np.linalg.inv(whole.T @ whole).diagonal())
    found = kernel.solve(read)
    assert np.abs((found - by_whole(whole, read)) / std).max() < 1e-12
    assert design.times(found) == pytest.approx(whole @ found, abs=1e-12)


@pytest.mark.parametrize(("stations", "targets"), [(12, 60), (60, 12), (20, 30)])
def test_of_two_sides_that_feel_each_other_one_falls_into_groups(stations, targets):
    """All but a few of the pairs were read; a station has two unknowns, a target one."""
    random = np.random.default_rng(5)
    station, target = np.nonzero(random.random((stations, targets)) < 0.97)
    cells = np.stack([2 * station, 2 * station + 1, 2 * stations + target], axis=1)
    value = random.uniform(0.5, 1.5, cells.shape).ravel()
    begin = np.arange(0, 3 * len(cells) + 1, 3)
    shape = (len(cells), 2 * stations + targets)
    design = SparseDesign(
        csr_array((value, cells.ravel(), begin), shape=shape), np.zeros((0, shape[1]))
    )
    kernel = design.kernel()
    assert len(kernel.groups.own) >= max(stations, targets) - 2
    whole, read = dense(design), random.standard_normal(len(cells))
    std = np.sqrt(np.linalg.inv(whole.T @ whole).diagonal())
    assert np.abs((kernel.solve(read) - by_whole(whole, read)) / std).max() < 1e-9


def test_groups_may_differ_in_size_and_rows_be_left_out():
    random, few = np.random.default_rng(3), levels(uneven=True)
    few = csr_array(few[:, few.toarray().any(axis=0)])  # some stations have no slope
    design = SparseDesign(few, np.zeros((0, few.shape[1])))
    weight = random.uniform(0.5, 2.0, few.shape[0]) * (random.uniform(size=few.shape[0]) > 0.1)
    read, kernel = random.standard_normal(few.shape[0]), design.weighted(weight).kernel()
    assert (kernel.groups.own < 0).sum() == 6
    wanted = by_whole(weight[:, None] * few.toarray(), weight * read)
    assert kernel.solve(weight * read) == pytest.approx(wanted, abs=1e-12)


def test_what_has_no_blocks_or_no_firm_ones_is_left_to_the_whole_matrix():
    whole = csr_array(np.random.default_rng(4).standard_normal((20, 5)))
    assert Groups.of(whole) is None
    few = levels(groups=4, each=1)
    assert SparseDesign(few, np.zeros((0, few.shape[1]))).kernel() is None


def test_a_border_of_which_rounding_is_left_is_open():
    """Angles, one read twice, and a zero that all have in common: an angle and the zero."""
    angles = np.append(np.arange(12), 0)
    few = csr_array(np.column_stack([1e7 * np.eye(12)[angles], np.full(13, 1e7 / 3.0)]))
    read, kernel = (
        np.random.default_rng(2).standard_normal(13),
        SparseDesign(few, np.zeros((0, 13))),
    )
    kernel = kernel.kernel()
    assert kernel.directions.shape[1] == 1
    assert few @ kernel.solve(read) == pytest.approx(few @ by_whole(few.toarray(), read))


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
    return model.with_prior("a sum", np.ones((1, 20)), np.array([true.sum()]), 1e-6)


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
            fit_model(model, used, model.std, model.first)


def test_the_kernel_is_kept_in_few_numbers():
    """Ten times as many stations take ten times as many numbers, not a hundred times."""

    def kept(groups):
        few = levels(groups)
        kernel = SparseDesign(few, np.zeros((0, few.shape[1]))).kernel()
        return sum(part.size for part in vars(kernel).values() if isinstance(part, np.ndarray))

    assert kept(300) <= 10 * kept(30)
