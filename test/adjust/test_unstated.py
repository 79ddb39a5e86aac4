"""Noise that nobody stated is estimated from the residuals, whatever was guessed."""

import numpy as np
import pytest
from scipy.stats import t

from rotcal_ros.adjust.engine import adjust
from rotcal_ros.adjust.gathering import Words
from rotcal_ros.adjust.model import Model, linear

WORDS = Words("readings", "a draught", "in the air", "in it")


def mean_of(values, guess):
    return Model(
        blocks={"mean": 1},
        observed=values,
        std=np.full(len(values), guess),
        equations=linear(np.ones((len(values), 1))),
        outputs=np.ones((1, 1)),
        words=WORDS,
        unstated=True,
    )


@pytest.mark.parametrize("guess", [0.1, 1.0, 5.0])
def test_the_uncertainty_of_a_mean_is_that_of_its_readings_whatever_was_guessed(guess):
    values = 3.0 + np.random.default_rng(1).standard_normal(30)
    found = adjust(mean_of(values, guess))
    scatter = values.std(ddof=1) / np.sqrt(30) * t.ppf(0.975, 29) / 1.959964
    assert found.std[0] == pytest.approx(scatter, rel=0.01)
    assert (found.verdict, found.doubts) == ("ok", ())


def test_intervals_of_few_readings_hold():
    random, inside = np.random.default_rng(2), 0
    for _ in range(200):
        found = adjust(mean_of(random.standard_normal(8), 1.0))
        inside += abs(found.value[0]) < 1.959964 * found.std[0]
    assert 182 <= inside <= 198
