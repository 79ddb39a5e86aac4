"""The whole engine on two worlds of simulated truth: runs there and back, and a plane network."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.optimize import least_squares
from scipy.sparse import csr_array

from rotcal_ros.adjust.diagnosis import Limits
from rotcal_ros.adjust.effects import worst_combined_effect
from rotcal_ros.adjust.engine import adjust, predicted
from rotcal_ros.adjust.fit import fit_model
from rotcal_ros.adjust.gathering import Words
from rotcal_ros.adjust.model import (
    Disturbing,
    Grouping,
    Model,
    Steps,
    Unit,
    drifts,
    from_mean,
    indicators,
    instrument_effects,
    knocks,
    linear,
)
from rotcal_ros.adjust.observable import observe_columns, observe_family
from rotcal_ros.foundation.errors import DataError, ObservabilityError

SIGMA = 1e-6
MICRON = Unit("um", 1e-6)
WORDS = Words("readings", "warm air", "in the beams", "in its beams")
RUNS, PLACES = 4, 15


def comparison(rng=None, noise=SIGMA):
    """Return truth (o,) and a model: each run reads all places, there or back, from its zero."""
    run, place = np.divmod(np.arange(RUNS * PLACES), PLACES)
    place = np.where(run % 2, PLACES - 1 - place, place)
    when = np.arange(len(run), dtype=float)
    truth = np.random.default_rng(1).standard_normal(PLACES + RUNS) * 1e-3
    design = indicators((place, PLACES), (run, RUNS))
    observed = design @ truth
    if rng is not None:
        observed = observed + noise * rng.standard_normal(len(run))
    outputs = np.eye(PLACES, PLACES + RUNS)
    outputs[:, 0] -= 1.0
    model = Model(
        blocks={"place": PLACES, "zero of run": RUNS},
        observed=observed,
        std=np.full(len(run), SIGMA),
        equations=linear(design),
        outputs=outputs,
        words=WORDS,
        unit=MICRON,
        groupings=(Grouping("run", run, along=when), Grouping("place", place)),
        effects=(
            Disturbing(
                "drift", "the instrument drifts", drifts(0 * run, when), 1e-3, MICRON
            ),
            Disturbing(
                "knock", "something moved", knocks(run, when), 1e-3, MICRON, family=True
            ),
        ),
    )  # fmt: skip
    return outputs @ truth, model


def network(rng=None, spoiled=()):
    """Return truth (o,) and a model: distances in a plane from stations to unknown targets.

    Three stations are known, the rest is not; ``spoiled``: observations that are 1 mm too long.
    """
    there = np.random.default_rng(3)
    stations = there.uniform(-1.0, 1.0, (9, 2))
    targets = there.uniform([-0.4, -0.5], [0.8, 0.7], (14, 2))
    station, target = np.divmod(np.arange(9 * 14), 14)

    def equations(x):
        places = np.concatenate([stations[:3], x[:12].reshape(6, 2)])
        apart = places[station] - x[12:].reshape(14, 2)[target]
        length = np.linalg.norm(apart, axis=1)
        unit, rows = apart / length[:, None], np.arange(len(length))
        jacobian = np.zeros((len(length), 40))
        moving = station >= 3
        for axis in range(2):
            jacobian[rows[moving], 2 * (station[moving] - 3) + axis] = unit[moving, axis]
            jacobian[rows, 12 + 2 * target + axis] = -unit[:, axis]
        return length, jacobian

    truth = np.concatenate([stations[3:].ravel(), targets.ravel()])
    observed = equations(truth)[0]
    if rng is not None:
        observed = observed + SIGMA * rng.standard_normal(len(observed))
    observed[list(spoiled)] += 1e-3
    outputs = np.eye(12, 40)
    return truth[:12], Model(
        blocks={"station coordinate": 12, "target coordinate": 28},
        observed=observed,
        std=np.full(len(observed), SIGMA),
        equations=equations,
        outputs=outputs,
        words=WORDS,
        unit=MICRON,
        start=truth + 0.01 * np.random.default_rng(4).standard_normal(40),
        groupings=(
            Grouping("station", station, along=target.astype(float)),
            Grouping("target", target),
        ),
        effects=(Disturbing("scale", "the scale is wrong", lambda y: y[:, None], 1e-3),),
    )


def test_derivatives_of_the_world_are_right():
    """Central differences: what the tests rest on."""
    _, model = network()
    x, step = model.first, 1e-6
    numeric = np.column_stack(
        [
            (model.equations(x + step * e)[0] - model.equations(x - step * e)[0]) / (2 * step)
            for e in np.eye(len(x))
        ]
    )
    assert model.equations(x)[1] == pytest.approx(numeric, abs=1e-8)


@pytest.mark.parametrize("world", [comparison, network])
def test_exact_observations_give_the_truth_and_no_doubt(world):
    truth, model = world()
    found = adjust(model)
    assert found.value == pytest.approx(truth, abs=1e-14)
    assert (found.verdict, found.doubts, found.why) == ("ok", (), {})


def test_the_solution_is_that_of_scipy():
    _, model = network(np.random.default_rng(5))
    found = adjust(model)
    other = least_squares(
        lambda x: (model.equations(x)[0] - model.observed) / SIGMA,
        model.first,
        lambda x: model.equations(x)[1] / SIGMA,
        xtol=1e-15, ftol=1e-15, gtol=1e-15,
    )  # fmt: skip
    covariance = np.linalg.inv(other.jac.T @ other.jac)
    assert found.value == pytest.approx(other.x[:12], abs=1e-4 * SIGMA)
    assert found.covariance == pytest.approx(covariance[:12, :12], rel=1e-5)
    assert found.fit.dof == 9 * 14 - 40


@pytest.mark.parametrize("world", [comparison, network])
def test_quick_steps_and_quick_factors_end_where_singular_values_do(world, monkeypatch):
    _, model = world(np.random.default_rng(6))
    quick = adjust(model)
    monkeypatch.setattr("rotcal_ros.adjust.fit.FIRM", np.inf)
    slow = adjust(model)
    assert quick.value == pytest.approx(slow.value, abs=1e-9 * SIGMA)
    assert quick.std == pytest.approx(slow.std, rel=1e-9)
    assert quick.fit.test_value == pytest.approx(slow.fit.test_value, abs=1e-7)


def test_nearly_dependent_unknowns_keep_their_digits():
    """A polynomial in powers, condition 6e7: its normal equations have no digit that is right."""
    x = np.linspace(1.0, 1.5, 40)
    powers = x[:, None] ** np.arange(7)
    truth = np.arange(1.0, 8.0)
    everything = np.ones(40, dtype=bool)
    model = Model(
        blocks={"coefficient": 7},
        observed=powers @ truth,
        std=np.full(40, 1e-9),
        equations=linear(powers),
        outputs=np.eye(7),
        words=WORDS,
    )
    assert np.linalg.cond(powers / np.linalg.norm(powers, axis=0)) > 1e7
    assert fit_model(model, everything, model.std, model.first).x == pytest.approx(truth, abs=1e-6)


@pytest.mark.slow
@pytest.mark.parametrize("world", [comparison, network])
def test_sound_observations_are_seldom_doubted_and_u_holds(world):
    doubted, inside, lost = 0, [], 0
    for seed in range(150):
        truth, model = world(np.random.default_rng(1000 + seed))
        found = adjust(model)
        doubted += found.verdict != "ok"
        lost += bool(found.why)
        uncertain = found.std > 0.0
        inside.append((np.abs(found.value - truth) <= 1.96 * found.std)[uncertain].mean())
    assert doubted <= 9  # the tests of noise, groups, effects at 1 % each, and what is suspected
    assert lost <= 6
    assert 0.93 < np.mean(inside) < 0.97


def test_single_wrong_observations_are_found_however_large():
    truth, model = network(np.random.default_rng(6))
    for size in (20e-6, 1e-3, 10.0):
        observed = model.observed.copy()
        observed[[17, 60, 100]] += size
        found = adjust(replace(model, observed=observed))
        assert sorted(found.why) == [17, 60, 100]
        assert found.verdict == "ok"  # three of 126 are nothing unusual
        assert np.abs(found.value - truth).max() < 5.0 * found.std.max()


@pytest.mark.slow
def test_two_fifths_of_one_station_are_found_and_left_out():
    for seed in range(5):
        rng = np.random.default_rng(seed)
        wrong = sorted((5 * 14 + rng.choice(14, 5, replace=False)).tolist())
        truth, model = network(rng, wrong)
        found = adjust(model)
        assert sorted(found.why) == wrong
        assert found.verdict == "suspect"
        assert np.abs(found.value - truth).max() < 5.0 * found.std.max()


def test_a_drift_is_found_told_in_words_and_taken_off():
    truth, model = comparison(np.random.default_rng(7))
    drifting = model.effects[0].columns[:, 0] * 40e-6
    found = adjust(replace(model, observed=model.observed + drifting))
    assert [e.effect.effect for e in found.diagnosis.nuisance] == ["drift"]
    assert found.found_effects[0].sizes == pytest.approx([40e-6], rel=0.2)
    assert found.doubts[0].startswith("it looks as if the instrument drifts, by ")
    assert found.verdict == "suspect"
    assert (np.abs(found.value - truth) <= 4.0 * found.std).all()
    (said,) = [p for p in found.protections() if p.effect == "drift"]
    assert said.treatment == "estimated"


def test_two_explanations_that_fit_alike_are_both_told_and_covered():
    """The last reading of a run but one is off, the last by a sixth: a knock, or not?"""
    truth, model = comparison(np.random.default_rng(21))
    observed = model.observed.copy()
    observed[PLACES - 2 : PLACES] += [9e-6, 1.5e-6]
    found = adjust(replace(model, observed=observed))
    assert found.verdict == "suspect"
    assert any("nearly as well" in words for words in found.doubts)
    assert (np.abs(found.value - truth) <= 3.0 * found.std + 1e-12).all()


def test_it_is_no_matter_which_of_two_causes_it_was_where_both_do_the_same():
    """A knock before the last reading of a run is one wrong reading there."""
    truth, model = comparison(np.random.default_rng(21))
    observed = model.observed.copy()
    observed[PLACES - 1] += 12e-6
    found = adjust(replace(model, observed=observed))
    assert (found.verdict, list(found.why)) == ("ok", [PLACES - 1])
    assert (np.abs(found.value - truth) <= 3.0 * found.std + 1e-12).all()


@pytest.mark.parametrize("factor", [3.0, 0.3])
def test_noise_that_was_stated_wrong_is_estimated(factor):
    truth, model = comparison(np.random.default_rng(9), noise=factor * SIGMA)
    found = adjust(model)
    assert found.diagnosis.noise.factors[0] == pytest.approx(factor, rel=0.25)
    assert found.verdict == ("suspect" if factor > 1.0 else "ok")
    assert (np.abs(found.value - truth) <= 4.0 * found.std).all()


def test_components_of_the_noise_are_told_apart():
    _, model = comparison(np.random.default_rng(10), noise=0.0)
    noisy = np.arange(RUNS * PLACES) < 2 * PLACES
    rng = np.random.default_rng(11)
    observed = model.observed + np.where(noisy, 5.0, 1.0) * SIGMA * rng.standard_normal(60)
    parts = replace(
        model, observed=observed, components=("runs 0, 1", "runs 2, 3"),
        component=np.where(noisy, 0, 1),
    )  # fmt: skip
    found = adjust(parts)
    assert found.diagnosis.noise.factors == pytest.approx([5.0, 1.0], rel=0.3)
    assert "the scatter of runs 0, 1 is" in found.doubts[0]


def test_what_nothing_tells_is_named():
    _, model = comparison()
    kept = np.flatnonzero(model.groupings[1].number != 6)
    part = _rows(model, kept)
    with pytest.raises(ObservabilityError, match="no observation determines place 6: measure"):
        adjust(part)
    from_nowhere = replace(model, outputs=np.eye(PLACES, PLACES + RUNS))
    with pytest.raises(ObservabilityError, match="cannot separate place 0"):
        adjust(from_nowhere)
    with pytest.raises(DataError, match="nothing was observed"):
        _rows(model, kept[:0])


def test_parts_that_nothing_joins_are_named_with_their_runs():
    _, model = comparison()
    run, place = (grouping.number for grouping in model.groupings)
    apart = _rows(model, np.flatnonzero((run < 2) == (place < 2)))
    with pytest.raises(ObservabilityError) as refused:
        adjust(apart)
    assert "separate place 0, place 1 (run 0, run 1) from place 2, place 3, " in str(refused.value)
    assert "others (run 2, run 3): measure what joins them" in str(refused.value)


def _rows(model, rows):
    """Return the linear model with some of its observations, without effects."""
    design = model.equations(model.first)[1][rows]
    groupings = tuple(
        Grouping(g.kind, g.number[rows], None if g.along is None else g.along[rows])
        for g in model.groupings
    )
    return replace(
        model, observed=model.observed[rows], std=model.std[rows], equations=linear(design),
        groupings=groupings, effects=(),
    )  # fmt: skip


def test_the_order_of_the_observations_and_their_unit_change_nothing():
    _, model = comparison(np.random.default_rng(12))
    observed = model.observed.copy()
    observed[33] += 30e-6
    model = replace(model, observed=observed)
    found = adjust(model)
    other = np.random.default_rng(13).permutation(len(model.observed))
    turned = adjust(_rows(model, other))
    assert turned.value == pytest.approx(adjust(_rows(model, np.arange(60))).value, abs=1e-15)
    assert [other[row] for row in turned.why] == [33]
    effects = tuple(replace(e, columns=e.columns * 1e3) for e in model.effects)
    scaled = replace(model, observed=1e3 * model.observed, std=1e3 * model.std, effects=effects)
    assert adjust(scaled).value == pytest.approx(1e3 * found.value, rel=1e-9)


def test_a_prediction_is_what_data_then_give():
    _, model = comparison()
    told = predicted(model)
    found = adjust(comparison(np.random.default_rng(14))[1])
    assert found.verdict == "ok"
    assert told.std == pytest.approx(found.std, rel=1e-9)
    assert told.redundancy == pytest.approx(found.fit.redundancy, rel=1e-9)
    said = {p.effect: p.error for p in found.protections() if p.treatment == "tested"}
    assert told.undetected["knock"].error == pytest.approx(said["knock"], rel=1e-9)


@pytest.mark.slow
def test_an_effect_of_the_size_that_is_promised_is_found():
    """The worst knock at its detectable size, in 95 % of the cases.

    At the end of a run it is one wrong reading, and is left out as that.
    """
    truth, model = comparison()
    told = predicted(model)
    std, knock = told.std, model.effects[1].columns
    counts = std > 0.0
    lost, hidden = 0, 0.0
    design = model.equations(model.first)[1]
    influence = np.abs(
        (model.outputs @ np.linalg.pinv(design) @ knock)[counts] / std[counts, None]
    )
    per_size = influence.max(axis=0)
    worst = int(np.argmax(per_size))
    size = told.undetected["knock"].error / per_size[worst]
    for seed in range(100):
        _, here = comparison(np.random.default_rng(2000 + seed))
        found = adjust(replace(here, observed=here.observed + size * knock[:, worst]))
        lost += found.verdict == "ok" and not found.why
        hidden = max(hidden, np.abs((found.value - truth)[counts] / found.std[counts]).max())
    assert lost <= 12  # binomial about 5 at most: others are found from smaller sizes on
    assert hidden < 12.0


def test_trials_draw_what_the_covariance_says():
    _, model = comparison(np.random.default_rng(15))
    found = adjust(model)
    drawn = found.trials(np.random.default_rng(16), 20000)
    assert np.cov(drawn.T)[1:, 1:] == pytest.approx(found.covariance[1:, 1:], abs=0.05 * SIGMA**2)
    assert drawn.mean(axis=0) == pytest.approx(found.value, abs=0.05 * SIGMA)


@pytest.mark.slow
def test_limits_are_kept():
    """A larger chance of losing sound observations loses more of them."""
    lost = [0, 0]
    for seed in range(40):
        _, model = comparison(np.random.default_rng(seed))
        for k, chance in enumerate((0.001, 0.5)):
            lost[k] += bool(adjust(model, Limits(rejection=chance)).why)
    assert lost[0] <= 2
    assert 10 <= lost[1] <= 32


def twins(rng, size):
    """Return truth (o,) and a model: two readings of each of eight places, one is off by size."""
    place, truth = np.repeat(np.arange(8), 2), np.linspace(0.0, 7e-3, 8)
    observed = truth[place] + SIGMA * rng.standard_normal(16)
    observed[5] += size
    return truth, Model(
        {"place": 8}, observed, np.full(16, SIGMA), linear(indicators((place, 8))), np.eye(8),
        WORDS, MICRON,
    )  # fmt: skip


def test_of_two_readings_nobody_knows_which_is_wrong():
    for seed in range(20):
        truth, model = twins(np.random.default_rng(seed), 15e-6)
        found = adjust(model)
        assert found.verdict == "suspect"
        assert any(
            "observation 4 is off" in d and "observation 5 is off" in d for d in found.doubts
        )
        assert (np.abs(found.value - truth) <= 4.0 * found.std).all()


def test_a_knock_at_one_of_two_moments_that_do_the_same_is_covered_whichever_it_was():
    """Of two runs, there and back, a knock of the first looks like one of the second."""
    truth, model = comparison(np.random.default_rng(31))
    two = np.flatnonzero(model.groupings[0].number < 2)
    run, when = model.groupings[0].number[two], np.arange(len(two), dtype=float)
    pair = _rows(model, two)
    design = model.equations(model.first)[1][two][:, : PLACES + 2]
    knock = Disturbing("knock", "something moved", knocks(run, when), 1e-3, MICRON, family=True)
    pair = replace(
        pair, blocks={"place": PLACES, "zero of run": 2}, equations=linear(design),
        outputs=model.outputs[:, : PLACES + 2], effects=(knock,),
        observed=pair.observed + 50e-6 * ((run == 0) & (when >= 6)),
    )  # fmt: skip
    found = adjust(pair)
    assert found.verdict == "suspect"
    assert (np.abs(found.value - truth) <= 3.0 * found.std).all()


def test_of_a_drift_in_each_run_only_what_residuals_tell_becomes_an_unknown():
    """A drift alike in all runs is a slope of the places where all are read in one order."""
    _, model = comparison(np.random.default_rng(32))
    run, when = model.groupings[0].number, np.arange(RUNS * PLACES, dtype=float)
    each = Disturbing("drift", "it drifts", drifts(run, when), 1e-3, MICRON)
    observed = model.observed + each.columns @ [30e-6, 0.0, 0.0, 0.0]
    observed[33] += 50e-6
    found = adjust(replace(model, observed=observed, effects=(each,)))
    assert list(found.why) == [33]
    (drift,) = found.found_effects
    assert drift.effect is each
    assert drift.sizes[0] - drift.sizes[2] == pytest.approx(30e-6, abs=5.0 * drift.std.max())


def test_the_size_that_is_told_is_that_which_was_taken_off():
    _, model = comparison(np.random.default_rng(33))
    knock = model.effects[1].columns[:, 20]
    observed = model.observed + 200e-6 * model.effects[0].columns[:, 0] + 80e-6 * knock
    found = adjust(replace(model, observed=observed))
    sizes = {e.effect.effect: e for e in found.found_effects}
    assert sizes["drift"].sizes[0] == pytest.approx(200e-6, abs=4.0 * sizes["drift"].std[0])
    assert sizes["knock"].sizes[0] == pytest.approx(80e-6, abs=4.0 * sizes["knock"].std[0])
    assert sizes["knock"].what.endswith("on")


def test_exact_numbers_of_one_kind_do_not_keep_the_noise_of_another_from_being_estimated():
    _, model = comparison()
    exact = np.arange(RUNS * PLACES) < 2 * PLACES
    rng = np.random.default_rng(34)
    observed = model.observed + np.where(exact, 0.0, 6.0) * SIGMA * rng.standard_normal(60)
    parts = replace(
        model, observed=observed, components=("exact", "noisy"), component=np.where(exact, 0, 1)
    )
    factors = adjust(parts).diagnosis.noise.factors
    assert factors[0] == 1.0
    assert factors[1] == pytest.approx(6.0, rel=0.3)


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"outputs": np.eye(PLACES, PLACES + RUNS)}, "cannot separate place 0, place 1"),
        ({"further": {"places": np.eye(3)}}, "places of the model: shape"),
        ({"std": np.full(60, np.inf)}, "std of the model: expected finite numbers"),
        ({"start": np.zeros(3)}, "start of the model: shape"),
        (
            {"effects": [Disturbing("drift", "it drifts", np.ones((59, 1)), 1e-3, MICRON)]},
            r"columns of drift of the model: shape \(59, 1\), expected \(60, 'k'\)",
        ),
        ({"component": np.full(60, 2)}, "component of the model: expected 0 to 0"),
    ],
)
def test_a_model_that_contradicts_itself_is_refused(change, words):
    _, model = comparison()
    with pytest.raises((DataError, ObservabilityError), match=words):
        adjust(replace(model, **change))


def test_sizes_of_groups_are_told_in_the_unit_of_the_model():
    _, model = comparison(np.random.default_rng(35))
    observed = model.observed.copy()
    observed[18:23] += 40e-6
    found = adjust(replace(model, observed=observed, effects=(), unit=Unit("mm", 1e-3)))
    assert sorted(found.why) == [18, 19, 20, 21, 22]
    assert any("by about +0.04 mm" in words for words in found.doubts)


def test_what_is_known_beforehand_is_weighed_and_never_left_out():
    """Like an observation of its own noise: the weighted mean of one reading and a certificate."""
    read, std, each = np.array([3e-6, 5e-6]), np.full(2, SIGMA), np.eye(2)
    model = Model({"place": 2}, read, std, linear(each), each, WORDS)
    effects = (
        Disturbing("scale", "the scale is wrong", lambda read: read[:, None], 0.1),
        Disturbing("drift", "it drifts", np.array([[0.0], [1.0]]), 1e-3),
    )
    model = replace(model, groupings=(Grouping("place", np.arange(2)),), effects=effects)
    known = model.with_prior("the certificate", np.eye(1, 2), np.array([6e-6]), 2.0 * SIGMA)
    found = adjust(known)
    assert found.value == pytest.approx([(3e-6 + 6e-6 / 4) / (1 + 1 / 4), 5e-6])
    assert found.std == pytest.approx([SIGMA / np.sqrt(1.25), SIGMA])
    assert known.rejectable.tolist() == [True, True, False]
    assert known.of_component.tolist() == [0, 0, 1]
    assert list(known.names) == ["place 0", "place 1", "value 0 of the certificate"]
    assert known.groupings[0].number.tolist() == [0, 1, -1]
    assert known.effects[0].at(known.observed).tolist() == [[3e-6], [5e-6], [0.0]]
    assert known.effects[1].at(known.observed).tolist() == [[0.0], [1.0], [0.0]]


def test_observations_are_called_by_their_groups():
    _, model = comparison()
    assert model.names[17] == "run 1, place 12"
    runs = replace(model, groupings=model.groupings[:1])
    assert runs.names[17] == "run 1 (3 of 15)"
    assert replace(model, groupings=()).names[17] == "observation 17"
    asked = []
    own = replace(model, row_names=lambda row: asked.append(row) or f"reading {row}")
    known = own.with_prior("the certificate", np.eye(1, model.size[1]), np.zeros(1), 1e-6)
    assert not asked  # a name is made when it is asked for
    n = len(model.observed)
    assert known.name_of_row(17) == "reading 17"
    assert known.name_of_row(n) == "value 0 of the certificate"
    assert asked == [17]


def test_outputs_that_are_only_told_change_no_judgement_and_no_bit_of_the_others():
    _, model = comparison(np.random.default_rng(36))
    observed = model.observed + 60e-6 * model.effects[1].columns[:, 20]
    model = replace(model, observed=observed)
    also = {"zero of run": from_mean(model.blocks, "zero of run")}
    plain, more = adjust(model), adjust(replace(model, further=also))
    assert more.value == pytest.approx(plain.value, rel=1e-12)
    assert more.covariance == pytest.approx(plain.covariance, rel=1e-12, abs=1e-24)
    assert (more.doubts, more.why) == (plain.doubts, plain.why)
    assert [p.why for p in more.protections()] == [p.why for p in plain.protections()]
    zeros, std = more.further["zero of run"]
    truth = np.random.default_rng(1).standard_normal(PLACES + RUNS)[PLACES:] * 1e-3
    assert (np.abs(zeros - (truth - truth.mean())) <= 4.0 * std).all()


def test_where_the_noise_was_estimated_larger_effects_stay_unseen():
    _, model = comparison(np.random.default_rng(37), noise=4.0 * SIGMA)
    found = adjust(model)
    assert np.isfinite(found.freedom)
    said = {p.effect: p for p in found.protections()}
    stated = {p.effect: p for p in adjust(replace(model, std=found.fit.std)).protections()}
    assert said["knock"].error > 1.05 * stated["knock"].error


def test_exact_observations_beside_a_certificate_that_nothing_checks_keep_their_noise():
    truth, model = comparison()
    zero = np.eye(1, PLACES + RUNS)  # of the first place: all readings leave it open
    found = adjust(model.with_prior("the certificate", zero, np.zeros(1), SIGMA))
    assert found.value == pytest.approx(truth, abs=1e-12)
    assert (found.verdict, found.diagnosis.noise.estimated) == ("ok", None)


def test_exact_readings_with_one_redundant_one_are_no_matter():
    drift = Disturbing("drift", "it drifts", np.array([[0.0], [1.0]]), 1e-3)
    std, design = np.full(2, SIGMA), np.ones((2, 1))
    model = Model({"place": 1}, np.zeros(2), std, linear(design), np.eye(1), WORDS)
    assert adjust(replace(model, effects=(drift,))).value == pytest.approx(0.0)


@pytest.mark.slow
def test_few_residuals_widen_the_uncertainty_as_students_t_does():
    inside = []
    for seed in range(150):
        truth, model = twins(np.random.default_rng(seed), 0.0)
        noisy = replace(model, observed=truth.repeat(2) + 3.0 * (model.observed - truth.repeat(2)))
        found = adjust(noisy)
        if found.diagnosis.noise.estimated is not None:
            inside.append(np.abs(found.value - truth) <= 1.96 * found.std)
    assert 0.92 < np.mean(inside) < 0.98


def with_usual_effects(model):
    run = model.groupings[0].number
    usual = instrument_effects(
        "the instrument", run, model.groupings[0].along, 1e-3, unit=MICRON, scale=1e-6
    )
    return replace(model, effects=usual)


@pytest.mark.parametrize("seed", [9, 10])
def test_a_drift_in_one_run_is_no_knock_and_what_all_runs_may_do_is_still_named(seed):
    model = with_usual_effects(comparison(np.random.default_rng(seed))[1])
    run, when = model.groupings[0].number, model.groupings[0].along
    ramp = 20 * SIGMA * drifts(run, when)[:, 2]
    found = adjust(replace(model, observed=model.observed + ramp))
    assert [e.effect.effect for e in found.found_effects] == ["drift"]
    # runs that go there and back in turn cannot tell a drift of all of them from the places
    assert {p.effect: p.treatment for p in found.protections()}["drift"] == "not protected"


def test_a_drift_that_only_one_of_many_runs_has_is_told_with_its_run():
    run, place = np.divmod(np.arange(12 * PLACES), PLACES)
    place = (place * (1 + run % 3) + 4 * run) % PLACES  # another order in every run
    when = np.arange(len(run), dtype=float)
    blocks = {"place": PLACES, "run": 12}
    noise = SIGMA * np.random.default_rng(3).standard_normal(len(run))
    model = Model(
        blocks=blocks,
        observed=noise + 15 * SIGMA * drifts(run, when)[:, 7],
        std=np.full(len(run), SIGMA),
        equations=linear(indicators((place, PLACES), (run, 12))),
        outputs=from_mean(blocks, "place"),
        words=WORDS,
        unit=MICRON,
        groupings=(Grouping("run", run, along=when), Grouping("place", place)),
    )
    (effect,) = adjust(with_usual_effects(model)).found_effects
    assert effect.what.startswith("the instrument drifts in one run, from run 7")
    np.testing.assert_allclose(effect.sizes, 15 * SIGMA, atol=4 * effect.std[0])


def test_a_scale_that_nobody_believes_to_be_off_is_harmless():
    model = with_usual_effects(comparison(np.random.default_rng(6))[1])
    assert {p.effect: p.treatment for p in adjust(model).protections()}["scale"] == "harmless"


def test_where_nothing_checks_anything_the_verdict_is_not_ok():
    _, model = comparison(np.random.default_rng(7))
    model = _rows(model, np.arange(PLACES))  # one run: as many readings as it can tell
    found = adjust(model)
    assert found.fit.dof == 0
    assert found.verdict == "suspect"
    assert "nothing checks the result" in found.doubts[0]


def test_a_block_that_is_not_there_is_named_with_those_that_are():
    with pytest.raises(DataError, match="no block 'plaec': its blocks are place, zero"):
        from_mean({"place": 3, "zero": 2}, "plaec")


def ready(design, outputs, noise, **more):
    """Return a model with one block of the columns of a design."""
    return Model(
        blocks={"unknown": design.shape[1]}, observed=noise, std=np.ones(len(noise)),
        equations=more.pop("equations", linear(design)), outputs=outputs, words=WORDS,
    )  # fmt: skip


@pytest.mark.parametrize("zeros", [1, 2, 5])
def test_which_unknown_stands_still_where_nothing_tells_one_is_no_matter(zeros):
    """Against the pseudoinverse; every open direction holds one unknown."""
    rng = np.random.default_rng(zeros)
    telling = rng.standard_normal((60, 12))
    open_ = np.linalg.qr(rng.standard_normal((12, zeros)))[0]
    design = telling - telling @ open_ @ open_.T
    outputs = rng.standard_normal((4, 12))
    outputs -= outputs @ open_ @ open_.T
    model = ready(design, outputs, rng.standard_normal(60))
    found, plain = adjust(model), np.linalg.pinv(design, rcond=1e-9)
    assert len(model.fixed) == zeros
    assert found.value == pytest.approx(outputs @ plain @ model.observed, abs=1e-12)
    assert found.covariance == pytest.approx(outputs @ plain @ plain.T @ outputs.T, abs=1e-12)
    assert found.fit.dof == 60 - 12 + zeros


def test_what_is_hardly_told_stands_still_for_nobody():
    """Two columns that differ by a part in ten million: badly conditioned, and yet determined."""
    rng = np.random.default_rng(4)
    design = rng.standard_normal((50, 6))
    apart = rng.standard_normal(50)
    design[:, 5] = design[:, 2] + 1e-7 * apart
    outputs, noise = np.eye(6), rng.standard_normal(50)
    model = ready(design, outputs, noise)
    split = np.column_stack([design[:, :5], apart])  # in other unknowns it is well conditioned
    back = np.eye(6)
    back[5, 5], back[2, 5] = 1e7, -1e7
    assert model.fixed.size == 1
    found = fit_model(model, np.ones(50, dtype=bool), model.std, model.first)
    expected = back @ np.linalg.lstsq(split, noise, rcond=None)[0]
    spread = back @ np.linalg.inv(split.T @ split) @ back.T
    assert found.value == pytest.approx(expected, rel=1e-6)
    assert found.output_std == pytest.approx(np.sqrt(spread.diagonal()), rel=1e-6)


def test_sparse_derivatives_give_the_same_where_they_do_not_fall_into_groups():
    rng = np.random.default_rng(5)
    row, unknown = np.arange(80), rng.integers(0, 20, (3, 80))
    design = np.zeros((80, 20))
    for each in unknown:
        design[row, each] += rng.standard_normal(80)
    noise = rng.standard_normal(80)
    one, other = (
        adjust(ready(design, np.eye(20), noise, equations=linear(given)))
        for given in (design, csr_array(design))
    )
    assert other.value == pytest.approx(one.value, rel=1e-9)
    assert other.value == pytest.approx(np.linalg.lstsq(design, noise, rcond=None)[0], rel=1e-9)


@pytest.mark.parametrize("width", [1, 3])
@pytest.mark.parametrize("written", [True, False])
def test_a_family_is_seen_as_its_columns_one_by_one_are(width, written):
    """Written out, and by running sums along two runs."""
    model = comparison(np.random.default_rng(6))[1]
    fit, n = adjust(model).fit, RUNS * PLACES
    ways = np.random.default_rng(7).standard_normal((n, 3)) if width > 1 else None
    moves = Steps(np.arange(n) // 20, np.arange(float(n)), ways)
    columns = moves.whole()
    found, plain = (
        observe_family(fit, columns if written else moves, width),
        observe_columns(fit, columns),
    )
    each, at = plain.information.reshape(57, width, 57, width), np.arange(57)
    assert found.information == pytest.approx(each[at, :, at], rel=1e-9, abs=1.0)
    assert found.beside == pytest.approx(each[at[:-1], :, at[1:]], rel=1e-9, abs=1.0)
    assert found.moved[:] == pytest.approx(plain.moved)
    assert found.score.ravel() == pytest.approx(plain.score, rel=1e-6, abs=1e-3)
    assert found.whole.ravel() == pytest.approx(plain.whole)
    roots = np.random.default_rng(8).standard_normal((57, width, 2))
    worst = worst_combined_effect(found.moved, fit.noise_std, roots)[0]
    share = plain.moved.reshape(57, width, -1)[:, :, 1:] / fit.noise_std[1:]
    expected = np.sqrt((np.einsum("kwo,kwr->kor", share, roots) ** 2).sum(axis=2)).max(axis=1)
    assert worst == pytest.approx(expected)


@pytest.mark.parametrize("width", [1, 2])
def test_a_move_is_found_whichever_way_it_goes(width):
    """From the 38th reading on; what it does to even and to odd readings are two ways."""
    n, found = RUNS * PLACES, 0
    odd = np.arange(n) % 2 == 1
    ways = np.column_stack([odd, ~odd]).astype(float) if width > 1 else None
    for seed in range(10):
        truth, model = comparison(np.random.default_rng(seed))
        move = Steps(0 * odd, np.arange(float(n)), ways)
        knock = Disturbing("knock", "something moved", move, 1e-3, MICRON, family=True)
        moved = model.observed + (np.arange(n) >= 37) * (8e-6 * odd if width > 1 else 8e-6)
        result = adjust(replace(model, observed=moved, effects=[model.effects[0], knock]))
        sizes = [np.abs(e.sizes).max() for e in result.found_effects]
        found += bool(sizes) and sizes[0] == pytest.approx(8e-6, abs=3e-6)
        assert np.abs(result.value - truth).max() < 5.0 * result.std.max()
    assert found >= 9


def test_where_nothing_at_all_is_told_outputs_that_ask_nothing_are_told():
    nothing, noise = np.zeros((5, 2)), np.arange(5.0)
    assert adjust(ready(nothing, np.zeros((1, 2)), noise)).value == [0.0]
    for solved in (adjust, lambda m: fit_model(m, np.ones(5, dtype=bool), m.std, m.first).kernel):
        with pytest.raises(ObservabilityError, match="no observation determines unknown 0, unk"):
            solved(ready(nothing, np.eye(2), noise))


def test_a_move_in_two_ways_is_looked_for_from_every_moment_on():
    """Of two runs, the second backwards in time: moment by moment the columns of both ways."""
    run, when = np.array([0, 0, 0, 1, 1]), np.array([1.0, 2.0, 3.0, 9.0, 8.0])
    influence = np.array([[1.0, 10.0], [2.0, 20.0], [3.0, 30.0], [4.0, 40.0], [5.0, 50.0]])
    one = np.array([[0.0, 0.0, 0.0], [2.0, 0.0, 0.0], [3.0, 3.0, 0.0], [0.0, 0.0, 4.0], [0.0] * 3])
    both = np.stack([one, 10.0 * one], axis=2).reshape(5, 6)
    np.testing.assert_array_equal(Steps(run, when, influence).whole(), both)
    assert Steps(np.zeros(1, dtype=np.int64), np.zeros(1), np.ones((1, 2))).whole().shape == (1, 0)
    many = np.arange(2100)
    moves = Steps(0 * many, many.astype(np.float64), np.ones((2100, 2)))
    assert moves.thinned(1000).whole().shape == (2100, 2100)
