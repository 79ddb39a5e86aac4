"""Circles order by order: what dense least squares and the general solution say, in any case."""

import re
from dataclasses import replace

import numpy as np
import pytest
from coded import coded
from hypothesis import assume, given, settings
from hypothesis import strategies as st
from scipy.sparse import csr_array

from rotcal_ros.adjust import circles
from rotcal_ros.adjust.bordered import SparseDesign
from rotcal_ros.adjust.circles import (
    CircleTurns,
    CircularDesign,
    ConjugateGradients,
    EliminatedNormals,
    OrderwiseKernel,
)
from rotcal_ros.adjust.designs import dense
from rotcal_ros.adjust.engine import NO_OTHER_CHECKS, NOT_ASKED, adjust, predicted
from rotcal_ros.adjust.fit import fit_model
from rotcal_ros.adjust.gathering import Words
from rotcal_ros.adjust.kernels import LowRankUpdateKernel, ReweightedKernel
from rotcal_ros.adjust.model import (
    Grouping,
    Model,
    Steps,
    block_rows,
    from_first,
    from_mean,
    instrument_effects,
    knocks,
    linear,
)
from rotcal_ros.adjust.outputs import Outputs
from rotcal_ros.foundation.errors import ObservabilityError

SIGMA = 2e-7
WORDS = Words("readings", "heat", "at the reference", "at the reference")


def rows_of(size, shifts, *, tables=1, closed=True):
    """Return setting, table place and mark of readings: whole turns, closed by a last one.

    With two tables each comes in turn to all places: up, and down.
    """
    place = np.arange(size + closed)
    setting, table, mark = [], [], []
    for number, shift in enumerate(shifts):
        for side in range(tables):
            order = place[::-1] if side else place
            setting.append(np.full(len(order), number))
            table.append(side * size + order % size)
            mark.append((order - shift) % size)
    return tuple(map(np.concatenate, (setting, table, mark)))


def design_of(size, rows, settings, tables=1):
    """Return entries (n, p) of table - mark + zero of the setting."""
    setting, table, mark = rows
    column = np.stack([table, tables * size + mark, (tables + 1) * size + setting], axis=1)
    value, begin = np.tile([1.0, -1.0, 1.0], len(table)), 3 * np.arange(len(table) + 1)
    return csr_array(
        (value, column.ravel(), begin), shape=(len(table), (tables + 1) * size + settings)
    )


def model_of(size, shifts, seed=1, *, tables=1, closed=True, keep=slice(None), noise=1.0, zeros=0):
    """Return a model of readings with noise, of circles with errors of their own.

    ``zeros``: of what else is known, beside those of the settings.
    """
    random = np.random.default_rng(seed)
    rows = tuple(part[keep] for part in rows_of(size, shifts, tables=tables, closed=closed))
    design = design_of(size, rows, len(shifts) + zeros, tables)
    true = 50.0 * SIGMA * random.standard_normal(design.shape[1])
    observed = design @ true + noise * SIGMA * random.standard_normal(design.shape[0])
    blocks = {"table": tables * size, "mark": size, "setting": len(shifts) + zeros}
    when = np.arange(len(observed), dtype=np.float64)
    return Model(
        blocks=blocks,
        observed=observed,
        std=np.full(len(observed), SIGMA),
        equations=linear(CircularDesign.of(design, tables + 1, size)),
        outputs=from_first(blocks, "table"),
        further={"reference": from_mean(blocks, "mark")},
        words=WORDS,
        groupings=(
            Grouping("setting", rows[0], along=when),
            Grouping("mark", rows[2]),
            Grouping("table", rows[1]),
        ),
        effects=instrument_effects("the instrument", rows[0], when, 1e-4),
    )


def generally(model):
    """Return the same model, solved by its whole matrix."""
    whole = csr_array(dense(model.equations(model.first)[1]))
    return replace(model, equations=linear(whole))


def spoiled(model, rows, sizes):
    """Return a model whose rows read wrong by sizes, in standard deviations."""
    observed = model.observed.copy()
    observed[rows] += np.asarray(sizes) * SIGMA
    return replace(model, observed=observed)


def some_missing():
    keep = np.ones(100, dtype=np.bool_)
    keep[[3, 50, 70, 71]] = False
    return model_of(24, (0, 1, 5, 2), keep=keep)


def wild(share, sizes):
    random, model = np.random.default_rng(5), model_of(24, (0, 1, 5, 2, 9, 14))
    count = int(share * len(model.observed))
    rows = random.choice(len(model.observed), count, replace=False)
    return spoiled(model, rows, sizes * random.standard_normal(count))


def drifting():
    model = model_of(24, (0, 1, 5, 2))
    return replace(model, observed=model.observed + 10.0 * SIGMA * np.tile(np.arange(25) / 24, 4))


def certified(noise=1.0):
    """One setting, and a certificate of the marks from a zero of its own."""
    model = model_of(12, (0, 4), noise=noise, zeros=1)
    known = block_rows(model.blocks, "mark")
    known[:, -1] = 1.0
    values = SIGMA * np.random.default_rng(8).standard_normal(12)
    return model.with_prior("the certificate", known, values, 30.0 * SIGMA)


CASES = {
    "as planned": lambda: model_of(12, (0, 1, 5)),
    "not closed": lambda: model_of(12, (0, 1, 5), closed=False),
    "two settings": lambda: model_of(9, (0, 1)),
    "settings repeated": lambda: model_of(12, (0, 1, 0, 1)),
    "in reverse": lambda: model_of(12, (0, 1, 5), keep=slice(None, None, -1)),
    "up and down": lambda: model_of(12, (0, 1, 5), tables=2),
    "up and down, a wrong one": lambda: spoiled(
        model_of(24, (0, 1, 5, 2), tables=2), [17], [40.0]
    ),
    "some missing": some_missing,
    "one wrong": lambda: spoiled(model_of(24, (0, 1, 5, 2)), [17], [40.0]),
    "a twentieth wild": lambda: wild(0.05, 100.0),
    "a tenth wild": lambda: wild(0.1, 400.0),
    "noisier": lambda: model_of(24, (0, 1, 5, 2), noise=3.0),
    "a drift": drifting,
    "a knock": lambda: spoiled(model_of(24, (0, 1, 5, 2)), np.arange(59, 75), 12.0),
    "a stretch": lambda: spoiled(model_of(24, (0, 1, 5, 2)), np.arange(59, 65), 9.0),
    "a certificate": certified,
    "a certificate that is all": lambda: certified(noise=4.0),
}


@pytest.mark.parametrize("name", CASES)
def test_order_by_order_says_what_the_whole_matrix_says(name):
    """Values within 1e-9 of their uncertainty, and every word of the verdict."""
    model = CASES[name]()
    found, expected = adjust(model), adjust(generally(model))
    assert isinstance(found.fit.kernel, LowRankUpdateKernel | ReweightedKernel)
    assert not isinstance(expected.fit.kernel, LowRankUpdateKernel)
    std = np.where(expected.std > 0.0, expected.std, SIGMA)
    assert np.abs((found.value - expected.value) / std).max() < 1e-9
    assert found.covariance == pytest.approx(expected.covariance, abs=1e-9 * std.max() ** 2)
    for told, (value, std) in expected.further.items():
        assert np.abs((found.further[told][0] - value) / std).max() < 1e-9
        assert found.further[told][1] == pytest.approx(std, rel=1e-9)
    assert (found.verdict, found.doubts) == (expected.verdict, expected.doubts)
    assert found.why == expected.why
    assert [e.what for e in found.found_effects] == [e.what for e in expected.found_effects]
    for mine, other in zip(found.found_effects, expected.found_effects, strict=True):
        assert mine.std == pytest.approx(other.std, rel=1e-9)
    assert found.fit.dof == expected.fit.dof
    assert found.fit.redundancy == pytest.approx(expected.fit.redundancy, abs=1e-9)
    assert found.fit.test_value == pytest.approx(expected.fit.test_value, abs=1e-8)
    assert found.fit.response == pytest.approx(
        expected.fit.response, abs=1e-9 * np.abs(expected.fit.response).max()
    )
    drawn = [each.trials(np.random.default_rng(1), 3) for each in (found, expected)]
    # what gathers is drawn by the root of its covariance, which has half of the digits
    assert drawn[0] == pytest.approx(drawn[1], abs=1e-6 * SIGMA)
    assert [words_of(p) for p in found.protections()] == [
        words_of(p) for p in expected.protections()
    ]


def words_of(protection):
    """Return what is told, without which of several settings that are alike it is."""
    return protection.effect, protection.treatment, re.sub(r"setting \d", "a", protection.why)


def test_a_wrong_reading_changes_what_dense_least_squares_without_it_says():
    """Written down here: constraints instead of what stands still, no part of the engine."""
    size, shifts, wrong = 24, (0, 1, 5, 2), 17
    model = spoiled(model_of(size, shifts), [wrong], [40.0])
    found = adjust(model)
    assert list(found.why) == [wrong]
    design = dense(model.equations(model.first)[1])
    used = np.arange(len(design)) != wrong
    gauge = np.zeros((2, design.shape[1]))
    gauge[0, 0] = gauge[1, size : 2 * size] = 1.0
    normal = np.block([[design[used].T @ design[used], gauge.T], [gauge, np.zeros((2, 2))]])
    inverse = np.linalg.inv(normal)[: design.shape[1], : design.shape[1]]
    x = inverse @ design[used].T @ model.observed[used]
    std = SIGMA * np.sqrt(inverse.diagonal())
    assert np.abs((found.value - x[:size])[1:] / std[1:size]).max() < 1e-9
    assert found.std[1:] == pytest.approx(std[1:size], rel=1e-9)
    told, told_std = found.further["reference"]
    assert np.abs((told - x[size : 2 * size]) / told_std).max() < 1e-9
    assert told_std == pytest.approx(std[size : 2 * size], rel=1e-9)


@pytest.mark.parametrize("size", [12, 15])
def test_the_variance_of_each_order_is_that_of_the_closed_form(size):
    """K / (K^2 - |S|^2), S = sum exp(i h shift), of two normal equations by hand; odd and even."""
    shifts, h = np.array([0, 1, 5, 3]), np.arange(1, size // 2 + 1)
    rows = design_of(size, rows_of(size, shifts, closed=False), 4)
    turns = CircleTurns.of(rows, 2, size)
    found = OrderwiseKernel.of(turns, np.ones(4)).inverse[h]
    sums = np.exp(2j * np.pi * np.outer(h, shifts) / size).sum(axis=1)
    left = 16.0 - np.abs(sums) ** 2
    assert found[:, 0, 0] == pytest.approx(4.0 / left)
    assert found[:, 1, 1] == pytest.approx(4.0 / left)
    assert found[:, 0, 1] == pytest.approx(np.conj(sums) / left) or found[
        :, 0, 1
    ] == pytest.approx(sums / left)


@given(size=st.integers(5, 40), steps=st.sets(st.integers(1, 39), min_size=1, max_size=5))
@settings(max_examples=40, deadline=None)
def test_the_closed_form_of_a_complete_grid_is_the_pseudo_inverse(size, steps):
    """Values, variances and what each reading does, where all orders are told: to 1e-12."""
    shifts = sorted({0, 1, *(step % size for step in steps)})
    design = CircularDesign.of(
        design_of(size, rows_of(size, shifts, closed=False), len(shifts)), 2, size
    )
    blocks = {"table": size, "mark": size, "setting": len(shifts)}
    parts = [from_first(blocks, "table"), from_mean(blocks, "mark")]
    found, outputs, inverse = design.kernel(), Outputs.of(parts), np.linalg.pinv(design.dense())
    assume(found is not None and found.rank == 2 * size + len(shifts) - 2)
    response = np.concatenate(parts) @ inverse
    scale = np.abs(response).max()
    every = np.arange(size * len(shifts))
    assert found.response(outputs, every) == pytest.approx(response, abs=1e-12 * scale)
    mine = outputs.part(slice(size))
    assert found.response(mine, every[:size]) == pytest.approx(
        response[:size, :size], abs=1e-12 * scale
    )
    variance = (response**2).sum(axis=1)
    assert found.variances_of(outputs) == pytest.approx(variance, abs=1e-12 * variance.max())
    read = np.random.default_rng(size).standard_normal(len(every))
    solved = outputs.times(found.solve(read))
    assert solved == pytest.approx(response @ read, abs=1e-12 * np.abs(solved).max())
    among = design.dense() @ inverse
    # in the order of reading, and at each place of the table: the latter are alike
    for groups in (every.reshape(-1, len(shifts)), every.reshape(len(shifts), -1).T):
        kinds, kind = found.hat_blocks(groups)
        for rows, each in zip(groups, kinds[kind], strict=True):
            assert each == pytest.approx(among[np.ix_(rows, rows)], abs=1e-12)


def test_a_kernel_is_kept_for_the_same_weights_alone():
    shifts = [0, 1, 3]
    plain = CircularDesign.of(design_of(8, rows_of(8, shifts, closed=False), 3), 2, 8)
    asked = [np.full(24, 1.0), np.full(24, 2.0), np.repeat([1.0, 2.0, 1.0], 8), np.full(24, 2.0)]
    for weight in asked:
        design = plain.weighted(weight)
        dense = design.dense()
        leverage = np.einsum("ij,ji->i", dense, np.linalg.pinv(dense))
        found = design.kernel()
        assert found.leverage == pytest.approx(leverage, abs=1e-12)
        assert plain.weighted(weight.copy()).kernel() is found
        read = np.random.default_rng(3).standard_normal(24)
        assert dense @ found.solve(read) == pytest.approx(dense @ np.linalg.pinv(dense) @ read)


def test_trials_of_the_noise_scatter_by_order_as_is_said():
    """Amplitudes of 4000 solutions of drawn readings, each by numpy alone."""
    size, shifts = 12, (0, 1, 5)
    model = model_of(size, shifts, closed=False)
    design = dense(model.equations(model.first)[1])
    noise = np.random.default_rng(3).standard_normal((4000, len(design)))
    x = noise @ np.linalg.pinv(design).T
    orders = np.fft.rfft(x[:, :size], axis=1)[:, 1:] / size
    told = model.equations(model.first)[1].kernel().base.inverse[1:, 0, 0].real / size
    # of 4000 the mean square scatters by 1.6 %, of the last order, which is real, by 2.2 %
    assert (np.abs(orders) ** 2).mean(axis=0) == pytest.approx(told, rel=0.1)


@pytest.mark.parametrize(
    ("shifts", "words"),
    [((0, 4, 8), "cannot separate table 0"), ((0, 0), "cannot separate table 0")],
)
def test_orders_that_are_lost_are_refused_in_the_same_words(shifts, words):
    model = model_of(12, shifts)
    assert model.equations(model.first)[1].kernel().directions.shape[1] > 2
    said = []
    for each in (model, generally(model)):
        for solve in (adjust, predicted):
            with pytest.raises(ObservabilityError, match=words) as error:
                solve(each)
            said.append(str(error.value))
    assert len(set(said)) == 1


def test_a_place_without_readings_is_named():
    rows = rows_of(24, (0, 1, 5, 2))
    model = model_of(24, (0, 1, 5, 2), keep=rows[1] != 7)
    for each in (model, generally(model)):
        with pytest.raises(ObservabilityError, match="no observation determines table 7: measure"):
            adjust(each)


def test_a_place_that_is_left_out_is_not_solved_for():
    """What is left is determined by no order: the whole design, or words, tell."""
    model, rows = model_of(24, (0, 1, 5, 2)), rows_of(24, (0, 1, 5, 2))
    with pytest.raises(ObservabilityError, match="no observation determines table 7"):
        fit_model(model, rows[1] != 7, model.std, model.first)


@pytest.mark.parametrize("share", [0.1, 0.4, 0.8])
def test_any_weights_are_solved_as_by_dense_least_squares(share):
    """Those of a start that trusts some readings less, or not at all."""
    random, model = np.random.default_rng(4), model_of(24, (0, 1, 5, 2, 9, 14))
    used = random.uniform(size=len(model.observed)) > 0.3 * share
    std = np.where(
        random.uniform(size=len(used)) < share, random.uniform(1.0, 50.0, len(used)), 1.0
    )
    found = fit_model(model, used, SIGMA * std, model.first)
    design = dense(model.equations(model.first)[1]) / (SIGMA * std)[:, None]
    inverse = np.linalg.pinv(design[used])
    x, outputs = inverse @ (model.observed / (SIGMA * std))[used], model.every_output
    expected = np.sqrt(((outputs @ inverse) ** 2).sum(axis=1))
    assert np.abs((found.value - outputs @ x)[1:] / expected[1:]).max() < 1e-9
    assert found.output_std[1:24] == pytest.approx(expected[1:24], rel=1e-9)


def test_eliminated_circles_are_not_taken_where_two_are_read_at_once():
    """Two of three circles in one row: no diagonal is left of the first two."""
    size, random = 12, np.random.default_rng(2)
    place, shift = np.tile(np.arange(size), 6), np.repeat([0, 1, 5, 2, 3, 7], size)
    other = np.repeat([0, 2, 1, 7, 5, 3], size)
    column = np.stack([place, size + (place + shift) % size, 2 * size + (place + other) % size])
    begin = 3 * np.arange(len(place) + 1)
    rows = csr_array((np.tile([1.0, -1.0, 2.0], len(place)), column.T.ravel(), begin))
    design = CircularDesign.of(rows, 3, size)
    assert EliminatedNormals.of(design) is None
    found = design.kernel()
    errors = random.standard_normal((len(place), 2))
    plain = rows.toarray() @ (np.linalg.pinv(rows.toarray()) @ errors)
    assert found.projected(errors) == pytest.approx(plain, abs=1e-12)
    assert found.rank == np.linalg.matrix_rank(rows.toarray())


def test_a_design_of_other_form_stays_as_it_is():
    rows = design_of(12, rows_of(12, (0, 1, 5)), 3)
    whole = csr_array(rows.toarray())
    assert CircularDesign.of(whole, 3, 12) is whole  # there are no three circles
    few = csr_array(whole[:4])
    assert CircularDesign.of(few, 2, 12) is few  # most of the turn is missing
    twice = whole.toarray()
    twice[0, 1] = 1.0
    assert isinstance(CircularDesign.of(csr_array(twice), 2, 12), csr_array)
    free = np.zeros((1, 27))
    free[0, 24] = 1.0
    design = CircularDesign.of(whole, 2, 12)
    assert type(design.beside(free)) is SparseDesign
    assert dense(design.beside(free)) == pytest.approx(np.vstack([rows.toarray(), free]))


def errors_of(found):
    """Return what stays unseen of each effect of which that is told."""
    return {p.effect: p.error for p in found.protections() if p.error is not None}


def test_a_large_group_is_judged_by_running_sums(monkeypatch):
    """As by products of all subsets, which small groups are judged by."""
    model = spoiled(model_of(24, (0, 1, 5, 2)), np.arange(59, 65), 9.0)
    slow = adjust(model)
    monkeypatch.setattr("rotcal_ros.adjust.explanations.LARGE", 3)
    quick = adjust(model)
    assert quick.why == slow.why
    assert quick.diagnosis.gathering.blamed[0].group.name == "setting 2"
    assert quick.std == pytest.approx(slow.std, rel=1e-12)
    assert errors_of(quick) == pytest.approx(errors_of(slow), rel=1e-9)


def test_columns_are_worked_out_in_parts(monkeypatch):
    model = spoiled(model_of(24, (0, 1, 5, 2)), np.arange(59, 75), 12.0)
    whole = adjust(model)
    for module in ("kernels", "outputs"):
        monkeypatch.setattr(f"rotcal_ros.adjust.{module}.AT_ONCE", 7)
    parts = adjust(model)
    assert parts.doubts == whole.doubts
    assert parts.value == pytest.approx(whole.value, abs=1e-12 * SIGMA)
    assert errors_of(parts) == pytest.approx(errors_of(whole), rel=1e-9)


@pytest.fixture
def large(monkeypatch):
    """Take any circle for a large one, of which no whole matrix is made."""
    monkeypatch.setattr(circles, "LARGE", 3)


@pytest.mark.parametrize(
    "name",
    ["as planned", "two settings", "up and down", "one wrong", "a twentieth wild", "a drift"],
)
def test_a_large_circle_says_what_a_small_one_says(name, large):
    model = CASES[name]()
    found, expected = adjust(model), adjust(generally(model))
    std = np.where(expected.std > 0.0, expected.std, SIGMA)
    assert np.abs((found.value - expected.value) / std).max() < 1e-9
    assert found.std == pytest.approx(expected.std, rel=1e-9, abs=1e-18)
    assert (found.verdict, found.doubts, found.why) == (
        expected.verdict, expected.doubts, expected.why
    )  # fmt: skip


def test_a_large_circle_whose_places_are_not_joined_is_refused(large):
    """Two marks and two places that only see each other: nothing is without readings."""
    rows = rows_of(24, (0, 1, 5, 2))
    apart = np.isin(rows[1], [7, 8]) ^ np.isin(rows[2], [7, 8])
    model = model_of(24, (0, 1, 5, 2))
    with pytest.raises(ObservabilityError, match="cannot separate the places of the circles"):
        _ = fit_model(model, ~apart, model.std, model.first).output_std
    assert adjust(model).verdict == "ok"


@pytest.mark.parametrize("dropped", [0.0, 0.3])
def test_extreme_eigenvalues_are_those_of_the_whole_matrices(dropped, large):
    random, size, shifts = np.random.default_rng(6), 24, (0, 1, 5, 2, 9, 14)
    rows = design_of(size, rows_of(size, shifts), 6)
    weight = random.uniform(0.5, 1.0, rows.shape[0]) * (
        random.uniform(size=rows.shape[0]) > dropped
    )
    found = ConjugateGradients.of(CircularDesign.of(rows, 2, size).weighted(weight))
    plain = rows.toarray() * weight[:, None]
    mean = found.orders.turns.shares(weight)[0].mean(axis=1)
    turn = np.repeat(np.arange(6), size)
    cells = found.orders.turns.rows_of(turn, np.tile(np.arange(size), 6)).toarray()
    values, vectors = np.linalg.eigh((cells * mean[turn][:, None]).T @ cells)
    root = vectors[:, 2:] / np.sqrt(values[2:])  # two zeros are open
    every = np.linalg.eigvalsh(root.T @ plain.T @ plain @ root)
    assert found.extremes == pytest.approx((every[0], every[-1]), rel=0.02)


@pytest.mark.parametrize(
    "name", ["as planned", "two settings", "one wrong", "up and down", "a knock", "a drift"]
)
def test_large_groups_are_judged_as_a_whole_alike(name, monkeypatch):
    """T, its degrees of freedom and redundancy from the solution without the group."""
    model = CASES[name]()
    small = adjust(model)
    for module in ("look", "engine"):
        monkeypatch.setattr(f"rotcal_ros.adjust.{module}.LARGEST_GROUP", 8)
    found = adjust(model)
    assert found.value == pytest.approx(small.value, abs=1e-12 * SIGMA)
    for mine, other in zip(
        found.diagnosis.gathering.counts, small.diagnosis.gathering.counts, strict=True
    ):
        assert (mine.kind, mine.name, mine.whole, mine.lost) == (
            other.kind, other.name, other.whole, other.lost
        )  # fmt: skip
        assert mine.test.rank == other.test.rank
        assert mine.test.squares == pytest.approx(other.test.squares, abs=1e-7)
        assert mine.test.redundancy == pytest.approx(other.test.redundancy, abs=1e-9)
    told = {p.effect: p for p in found.protections()}["one place"]
    if told.treatment == "not protected" and NO_OTHER_CHECKS not in coded(told.why):
        assert coded(told.why)[NOT_ASKED][0][0] == 8


def test_covariances_of_many_angles_are_not_kept(monkeypatch):
    model = model_of(12, (0, 1, 5))
    found, angles = adjust(model), 2.0 * np.pi * np.arange(12) / 12
    _, table, mark = rows_of(12, (0, 1, 5))

    def result(**more):
        return found.result("two circles", angles, {"ECC": slice(0, 12)}, (table, mark), **more)

    whole = result()
    monkeypatch.setattr("rotcal_ros.adjust.engine.COVARIANCE_LIMIT", 11)
    monkeypatch.setattr("rotcal_ros.adjust.engine.MOST_INFLUENCES", 100)
    assert whole.covariance["ECC"].shape == (12, 12)
    assert whole.raw_data.influence is not None
    assert not result().covariance
    assert result().raw_data.influence is None
    assert result().std["ECC"].tolist() == whole.std["ECC"].tolist()
    assert result(joint=True).covariance["ECC"].tolist() == whole.covariance["ECC"].tolist()


def test_steps_begin_with_each_moment_of_a_run_but_the_first():
    """In any order, two readings at once; the last belongs to no run."""
    run, when = np.array([0, 1, 0, 0, 1, 0, -1]), np.array([3.0, 2.0, 1.0, 3.0, 5.0, 4.0, 9.0])
    expected = np.array([
        [1, 0, 0], [0, 0, 0], [0, 0, 0], [1, 0, 0], [0, 0, 1], [1, 1, 0], [0, 0, 0]
    ])  # fmt: skip
    steps = Steps(run, when)
    assert steps.shape == (7, 3)
    assert steps.whole().tolist() == expected.tolist()
    assert steps.whole(slice(1, 3)).tolist() == expected[:, 1:].tolist()
    assert knocks(run, when).tolist() == expected.tolist()


def test_outputs_are_kept_by_what_they_have_in_common():
    blocks = {"table": 30, "mark": 20, "setting": 3}
    parts = [from_first(blocks, "table"), from_mean(blocks, "mark"), np.zeros((0, 53))]
    found, whole = Outputs.of(parts), np.concatenate(parts)
    x = np.random.default_rng(1).standard_normal((53, 4))
    assert found.few.nnz < 3 * len(whole)
    assert found.times(x) == pytest.approx(whole @ x, abs=1e-14)
    scale = np.arange(1.0, whole.shape[1] + 1.0)
    assert found.lengths(scale) == pytest.approx(np.linalg.norm(whole / scale, axis=1))
    assert found.influenced.tolist() == (whole != 0.0).any(axis=0).tolist()
    assert np.concatenate([rows for _, rows in found.part(slice(7)).parts(55)])[
        :, :53
    ] == pytest.approx(whole[:7], abs=1e-16)
