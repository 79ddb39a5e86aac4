"""Two instruments as one model: a level in arcsec and a length gauge in um at the same places."""

import numpy as np
import pytest

from rotcal_ros.adjust.engine import adjust
from rotcal_ros.adjust.gathering import Words
from rotcal_ros.adjust.model import Disturbing, Grouping, Model, Unit, UnseenEventPrior, linear
from rotcal_ros.adjust.stacking import reparametrise, stack_models, whiten

PLACES, ARM = 5, 0.2
WORDS = Words("readings", "a draught", "there", "there")
LEVEL = np.tile(np.eye(PLACES), (3, 1))
"""Three readings of each place by a level, whose unknowns are the places and nothing else."""
GAUGE = np.hstack([ARM * np.eye(PLACES), np.ones((PLACES, 1))])
"""A length gauge on an arm, with a zero of its own."""


def model(design, std, blocks, seed, **more):
    rng = np.random.default_rng(seed)
    true = np.append(1e-5 * np.sin(np.arange(PLACES)), np.full(design.shape[1] - PLACES, 3e-6))
    observed = design @ true + std * rng.standard_normal(len(design))
    return Model(
        blocks=blocks,
        observed=observed,
        std=np.full(len(design), std),
        equations=linear(design),
        outputs=np.eye(PLACES, design.shape[1]),
        words=WORDS,
        groupings=[Grouping("pass", np.arange(len(design)) // PLACES)],
        **more,
    )


def both(**more):
    drift = Disturbing("drift", "it drifts", np.linspace(0.0, 1.0, 15)[:, None], 1e-3)
    level = model(LEVEL, 2e-7, {"place": PLACES}, 1, effects=[drift])
    gauge = model(GAUGE, 1e-7, {"place": PLACES, "zero": 1}, 2, **more)
    parts = {"level": whiten(level), "gauge": whiten(gauge)}
    return level, gauge, stack_models(parts, {"place": PLACES}, np.eye(PLACES), WORDS)


def test_it_is_the_least_squares_of_all_readings_in_their_noise():
    level, gauge, together = both()
    design = np.zeros((20, PLACES + 1))
    design[:15, :PLACES], design[15:] = LEVEL / 2e-7, GAUGE / 1e-7
    observed = np.append(level.observed / 2e-7, gauge.observed / 1e-7)
    cofactors = np.linalg.inv(design.T @ design)
    found = adjust(together)
    np.testing.assert_allclose(found.value, (cofactors @ design.T @ observed)[:PLACES], rtol=1e-9)
    np.testing.assert_allclose(found.covariance, cofactors[:PLACES, :PLACES], rtol=1e-9)


def test_what_is_of_one_instrument_bears_its_name():
    _, _, together = both(further={"zero": np.eye(1, PLACES + 1, PLACES)})
    assert dict(together.blocks) == {"place": PLACES, "zero of gauge": 1}
    assert list(together.components) == ["the observations of level", "the observations of gauge"]
    assert [g.kind for g in together.groupings] == ["level, pass", "gauge, pass"]
    assert together.groupings[1].number.tolist() == [-1] * 15 + [0] * 5
    assert together.names[0] == "pass 0 (1 of 5) of level"
    assert together.effects[0].what == "in level it drifts"
    columns = together.effects[0].at(together.observed)
    np.testing.assert_allclose(columns[:15, 0], np.linspace(0.0, 1.0, 15) / 2e-7)
    assert not columns[15:].any()
    assert adjust(together).further["zero of gauge"][0] == pytest.approx(3e-6, abs=1e-6)


def test_an_effect_of_what_is_read_stays_one():
    scale = Disturbing(
        "scale", "its scale is wrong", lambda read: read[:, None], 0.1, Unit("%", 0.01)
    )
    level, _, together = both(effects=[scale])
    computed = np.arange(20.0)
    columns = together.effects[1].at(computed)
    np.testing.assert_allclose(columns[15:, 0], computed[15:])  # both are divided by the noise
    assert not columns[:15].any()
    assert level.size == (15, 5)


def test_other_unknowns_give_the_same_outputs():
    """From steps between places instead of places."""
    _, gauge, _ = both()
    to = np.eye(PLACES + 1)
    to[:PLACES, :PLACES] = np.tril(np.ones((PLACES, PLACES)))
    to[:PLACES, 0] = 0.0
    to[0, 0] = to[PLACES, PLACES] = 1.0
    gauge = Model(
        gauge.blocks, gauge.observed, gauge.std, gauge.equations,
        gauge.outputs - gauge.outputs[0], WORDS,
    )  # fmt: skip
    steps = reparametrise(gauge, to, {"step": PLACES, "zero": 1})
    one, other = adjust(gauge), adjust(steps)
    np.testing.assert_allclose(other.value, one.value, atol=1e-15)
    np.testing.assert_allclose(other.covariance, one.covariance, atol=1e-20)


ZEROED = np.hstack([LEVEL, np.ones((15, 1))])
"""The level from a zero of its own: the places have no mean."""
SLIP = Disturbing("knock", "it slips", np.tril(np.ones((15, 15)))[:, 1:], 1e-4, family=True)
BLOCKS = {"place": PLACES, "zero": 1}


@pytest.mark.parametrize(
    "alone",
    [
        model(ZEROED, 2e-7, BLOCKS, 3, definitions=np.append(np.ones(PLACES), 0.0)[None]),
        model(LEVEL, 2e-7, {"place": PLACES}, 3, expected=[UnseenEventPrior(SLIP, 8e-7, 0.5)]),
        model(LEVEL, 1e-5, {"place": PLACES}, 3).scattering(
            "the places", np.eye(4, PLACES, 1) - np.eye(4, PLACES), 8e-6, 1e-4
        ),
    ],
    ids=["definitions", "expected", "scattering"],
)
def test_what_a_model_says_beside_its_readings_holds_in_others_units_too(alone):
    blocks = dict(alone.blocks)
    outputs = np.eye(PLACES, alone.size[1])
    one = adjust(alone)
    other = adjust(stack_models({"level": whiten(alone)}, blocks, outputs, WORDS))
    np.testing.assert_allclose(other.value, one.value, rtol=1e-6, atol=1e-13)
    np.testing.assert_allclose(other.covariance, one.covariance, rtol=1e-5, atol=1e-20)
