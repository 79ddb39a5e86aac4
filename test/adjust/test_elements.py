"""Rows that stand or fall together: centres of balls, each three coordinates with one noise."""

from dataclasses import replace

import numpy as np
import pytest
from scipy import stats

from rotcal_ros.adjust.engine import adjust
from rotcal_ros.adjust.gathering import Words
from rotcal_ros.adjust.model import Grouping, Model, Unit, linear
from rotcal_ros.adjust.stacking import stack_models, whiten
from rotcal_ros.foundation.errors import DataError

PLACES, SETTINGS = 10, 5
N = PLACES * SETTINGS
SIGMA = 1e-6
TURNED = 2.0 * np.pi * np.arange(PLACES) / PLACES
BLOCK = SIGMA**2 * np.array([[1.0, 0.7, 0.0], [0.7, 2.0, -0.5], [0.0, -0.5, 0.5]])


def noise_blocks():
    """Return covariances (n, 3, 3), each turned about z by another angle."""
    angle = np.arange(N)
    turn = np.zeros((N, 3, 3))
    turn[:, 0, 0] = turn[:, 1, 1] = np.cos(angle)
    turn[:, 0, 1], turn[:, 1, 0], turn[:, 2, 2] = -np.sin(angle), np.sin(angle), 1.0
    return turn @ BLOCK @ turn.swapaxes(1, 2)


BLOCKS, PLAIN = noise_blocks(), np.broadcast_to(np.eye(3) * SIGMA**2, (N, 3, 3))


def centres(rng=None, off=(), covariance=BLOCKS):
    """Return places (30,) and a model: in each setting all centres are seen from elsewhere.

    ``off``: pairs of a centre and by how much (3,) it is off.
    """
    setting, place = np.divmod(np.arange(N), PLACES)
    round_ = np.column_stack([np.cos(TURNED), np.sin(TURNED)])[place]
    one = np.hstack([np.eye(PLACES)[place], np.eye(SETTINGS)[setting][:, 1:]])
    design = np.kron(one, np.eye(3))
    truth = np.random.default_rng(1).standard_normal(design.shape[1]) * 1e-3
    observed = design @ truth
    if rng is not None:
        root = np.linalg.cholesky(covariance)
        observed = observed + (root @ rng.standard_normal((N, 3, 1))).ravel()
    for k, by in off:
        observed[3 * k : 3 * k + 3] += by
    model = Model(
        blocks={"place": 3 * PLACES, "setting": 3 * (SETTINGS - 1)},
        observed=observed,
        std=np.full(3 * N, SIGMA),
        equations=linear(design),
        outputs=np.eye(3 * PLACES, design.shape[1]),
        words=Words("centres", "warm air", "in the room", "near it"),
        unit=Unit("um", 1e-6),
        groupings=(
            Grouping(
                "setting", np.repeat(setting, 3),
                near=np.repeat(round_, 3, axis=0)
            ),
            Grouping("place", np.repeat(place, 3)),
        ),
        element=np.repeat(np.arange(N), 3),
    )  # fmt: skip
    return truth[: 3 * PLACES], model.with_blocks(covariance), design


def test_correlated_noise_of_elements_is_weighed_as_it_is():
    """Against generalised least squares of the whole, by plain algebra."""
    _, model, design = centres(np.random.default_rng(2))
    whole = np.zeros((3 * N, 3 * N))
    for k, block in enumerate(BLOCKS):
        whole[3 * k : 3 * k + 3, 3 * k : 3 * k + 3] = block
    weight = np.linalg.inv(whole)
    covariance = np.linalg.inv(design.T @ weight @ design)
    observed = model.mixed @ model.observed
    found = adjust(model)
    assert found.value == pytest.approx(
        (covariance @ design.T @ weight @ observed)[: 3 * PLACES], abs=1e-12
    )
    np.testing.assert_allclose(found.covariance, covariance[:30, :30], rtol=1e-8, atol=1e-20)
    angles = np.arange(float(PLACES))
    result = found.result("m", angles, {"EXC": slice(0, PLACES)}, (0 * model.of_element[::3],) * 2,
                          coordinates=3)  # fmt: skip
    left = (observed - design @ found.fit.x).reshape(N, 3)
    np.testing.assert_allclose(result.residuals.residual, np.linalg.norm(left, axis=1), rtol=1e-6)


def test_the_test_of_an_element_is_chi_squared_of_its_rows():
    """T = r'R^+r by plain algebra, also of one that was left out: as its own unknowns say."""
    _, model, _ = centres(np.random.default_rng(3), [(7, 40 * SIGMA)])
    found = adjust(model)
    assert set(found.why) == {21, 22, 23}
    assert {found.model.names[row] for row in found.why} == {"setting 0, place 7"}
    white = model.linearised(model.first)[1].dense() / model.std[:, None]
    squares, rank = found.fit.element_test
    assert (rank == 3).all()
    used = found.fit.used
    basis = np.linalg.qr(white[used])[0]
    left = np.eye(used.sum()) - basis @ basis.T
    at = np.cumsum(used) - 1
    for k in (0, 8, 33):
        rows = at[3 * k : 3 * k + 3]
        r = found.fit.white[3 * k : 3 * k + 3]
        assert squares[k] == pytest.approx(r @ np.linalg.inv(left[np.ix_(rows, rows)]) @ r)
    before = np.linalg.lstsq(white[used], (model.observed / model.std)[used])[1]
    every = np.linalg.lstsq(white, model.observed / model.std)[1]
    assert squares[7] == pytest.approx(float(every[0] - before[0]))


def test_what_is_off_in_all_coordinates_is_found_where_no_single_one_shows_it():
    """Three of 3.4 sigma of a residual: the root of chi-squared is 5.9, its limit 4.4."""
    found = single = 0
    for seed in range(10):
        _, model, _ = centres(np.random.default_rng(seed), [(20, [4e-6, -4e-6, 4e-6])], PLAIN)
        found += set(adjust(model).why) == {60, 61, 62}
        single += set(adjust(replace(model, element=None)).why) == {60, 61, 62}
    assert found >= 8
    assert single <= found // 2


def test_sound_centres_lose_as_few_as_stated():
    """One run in a hundred loses any; Student's F where the noise is estimated."""
    lost = sum(bool(adjust(centres(np.random.default_rng(seed))[1]).why) for seed in range(100))
    assert lost <= stats.binom.ppf(0.9999, 100, 0.01)


def test_a_sector_that_closes_round_the_circle():
    """Places 9, 0 and 1 of one setting stand by 6 sigma elsewhere in x and y."""
    at = [2 * PLACES + place for place in (9, 0, 1)]
    _, model, _ = centres(np.random.default_rng(4), [(k, [6e-6, -6e-6, 0.0]) for k in at])
    found = adjust(model)
    assert sorted({row // 3 for row in found.why}) == sorted(at)
    assert "3 of the 10 centres of setting 2 are off together" in " ".join(found.doubts)
    assert {p.effect: p.treatment for p in found.protections()}["one place"] == "tested"


def test_stacked_models_keep_their_elements():
    _, model, _ = centres()
    rest = replace(model, element=None, row_names=[f"r{k}" for k in range(3 * N)])
    both = stack_models(
        {"a": whiten(model), "b": whiten(rest)}, {"place": 30}, np.eye(30), model.words
    )
    assert len(both.elements) == N + 3 * N
    assert (both.elements[0] == [0, 1, 2]).all()
    assert (both.elements[-1] == [6 * N - 1, -1, -1]).all()
    assert both.groupings[0].near.shape == (6 * N, 2)
    known = model.with_prior("c", np.eye(1, 42), np.zeros(1), SIGMA)
    assert (known.elements[-1] == [3 * N, -1, -1]).all()
    assert known.rejectable_elements == N


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"judged": np.arange(3 * N) > 0}, "judged of the model: expected the same"),
        ({"groupings": [Grouping("run", np.arange(3 * N))]}, "run of .*: expected the same"),
        ({"element": np.where(np.arange(3 * N) < 2, -1, np.repeat(np.arange(N), 3))},
         "elements of g 0: expected as many rows"),
    ],
)  # fmt: skip
def test_elements_that_do_not_fit(change, words):
    _, model, _ = centres()
    if "element" in change:
        change["groupings"] = [Grouping("g", np.zeros(3 * N, dtype=int))]
    with pytest.raises(DataError, match=words):
        replace(model, **change)
