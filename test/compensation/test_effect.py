"""Does the table in force act? Axis and control are made here, of sines and a sign."""

import numpy as np
import pytest
from compensation_examples import TAU, even

from rotcal_ros.compensation.held_table import regress_on_correction
from rotcal_ros.foundation.units import ARCSEC


def axis(angle, parts):
    return sum(a * ARCSEC * np.sin(k * angle + p) for k, a, p in parts)


def left_by(gain, parts, table, n=36, std=0.2, seed=1):
    """Deviations of an axis whose control adds ``gain`` times the ``table``."""
    angles, noise = even(n), np.random.default_rng(seed).normal(size=n) * std * ARCSEC
    seen = axis(angles, parts) + gain * table(angles) + noise
    to_first = np.eye(n)
    to_first[:, 0] -= 1.0
    covariance = to_first @ to_first.T * (std * ARCSEC) ** 2
    return seen - seen[0], -table(angles), covariance


PARTS = ((1, 20.0, 0.3), (2, 6.0, 1.0), (5, 1.5, 2.0))


def good(angles):
    """The table that was made of the axis: minus its deviation."""
    return -axis(angles, PARTS)


@pytest.mark.parametrize(
    ("gain", "factor", "words"),
    [
        (1.0, 0.0, ""),
        (0.0, 1.0, "inactive, or on the wrong axis"),
        (-1.0, 2.0, "its sign is wrong"),
        (2.0, -1.0, "acts twice"),
    ],
)
def test_the_factor_tells_what_the_control_makes_of_its_table(gain, factor, words):
    found = regress_on_correction(*left_by(gain, PARTS, good))
    assert abs(found.factor - factor) < 5.0 * found.std < 0.05
    assert (words in found.fault) if words else found.fault is None
    assert not (found.fault or "").endswith("?")  # sentences follow
    assert not found.describe().startswith("-0.0")
    assert " ± 0.00" in found.describe()  # two digits of U, the factor to the same place


def test_the_uncertainty_of_the_factor_is_that_of_the_measurement():
    found = [regress_on_correction(*left_by(0.0, PARTS, good, seed=seed)) for seed in range(400)]
    spread = np.std([f.factor - 1.0 for f in found])
    # sigma / sqrt(sum of squares of the shape), by hand: 0.2 / (sqrt(18 (20^2 + 6^2 + 1.5^2)))
    by_hand = 0.2 / np.sqrt(18.0 * (20.0**2 + 6.0**2 + 1.5**2))
    assert found[0].std == pytest.approx(by_hand, rel=1e-9)
    assert spread == pytest.approx(by_hand, rel=0.12)


@pytest.mark.parametrize("seed", range(20))
def test_an_axis_that_has_changed_its_shape_is_no_fault_of_the_table(seed):
    """Mounted anew: eccentricity of any size and direction, other harmonics worn."""
    draw = np.random.default_rng(seed)
    changed = [(k, a * draw.uniform(0.5, 1.6), p + draw.normal() * 0.4) for k, a, p in PARTS]
    assert regress_on_correction(*left_by(1.0, changed, good, seed=seed)).fault is None


@pytest.mark.parametrize("share", [0.01, 0.002])
def test_a_table_that_corrects_nearly_nothing_is_not_called_wrong(share):
    """Within the noise nothing can be shown, and what is left of the rest may be added."""

    def tiny(angles):
        return share * good(angles)

    for seed in range(20):
        assert regress_on_correction(*left_by(1.0, PARTS, tiny, std=1.0, seed=seed)).fault is None
        assert (
            regress_on_correction(
                *left_by(0.0, ((1, share, 0.3),), tiny, std=1.0, seed=seed)
            ).fault
            is None
        )


def test_a_table_of_nothing_has_no_effect_to_tell():
    assert regress_on_correction(np.zeros(5), np.full(5, 0.1), np.eye(5)) is None
    assert regress_on_correction(np.zeros(2), np.arange(2.0), np.eye(2)) is None
    assert TAU > 6.0
