"""A table judged by two measurements: what acts, what cancels, what is refused.

The axis, its control and the instrument are simulated by hand: deviations d, a table -b of what
was measured, an error of calibration s, and noise.
"""

from dataclasses import replace

import numpy as np
import pytest

from rotcal_ros.evaluation.two_measurements import verification_of
from rotcal_ros.foundation.circumstances import Circumstances
from rotcal_ros.foundation.errors import DataError
from rotcal_ros.foundation.identity import Identity
from rotcal_ros.foundation.in_force import NONE
from rotcal_ros.foundation.results import Directions, Result
from rotcal_ros.foundation.units import ARCSEC, DEGREE

N = 24
ANGLES = np.arange(N) * 360.0 / N * DEGREE
TRUE = 10.0 * np.cos(ANGLES) + 3.0 * np.sin(4.0 * ANGLES)


def measured(values, std=0.1, angles=ANGLES, **facts):
    """Return a result of values and standard uncertainties in arcsec."""
    values, std = values * ARCSEC, np.full(len(values), std * ARCSEC)
    covariance = {"ECC": np.diag(std**2)}
    return Result("m", angles, {"ECC": values}, {"ECC": std}, covariance, 1.0, 1, 1, **facts)


def judged(before, after, **known):
    return verification_of({"b.csv": before, "a.csv": after}, **known)


def codes(found):
    return [note.template for note in found.notes]


@pytest.mark.parametrize(
    ("left", "fault", "verdict"),
    [(0.0, None, "ok"), (1.0, "it is inactive", "failed"), (2.0, "its sign is wrong", "failed"),
     (-1.0, "it acts twice", "failed"), (0.5, None, "suspect")],
)  # fmt: skip
def test_what_is_left_of_the_first_curve_says_whether_its_table_acts(left, fault, verdict):
    rng = np.random.default_rng(1)
    before = TRUE + rng.normal(0.0, 0.1, N)
    after = TRUE + (left - 1.0) * before + rng.normal(0.0, 0.1, N) + 40.0  # another zero
    found = judged(measured(before), measured(after))
    assert found.effect.factor == pytest.approx(left, abs=4.0 * found.effect.std)
    # the noise of both, over the root of the squares of the curve: 0.1414 / sqrt(24 x 54.5)
    assert found.effect.std == pytest.approx(0.0039, rel=0.05)
    assert (fault in found.fault) if fault else found.fault is None
    assert found.verdict == verdict
    assert f"the mean changed by {after.mean() - before.mean():.3g} arcsec" in found.notes[0]
    assert found.to_dict()["notes"] == list(found.notes)


@pytest.mark.parametrize("share", [0.0, 0.5, 2.0])
def test_a_curve_of_hardly_more_than_noise_accuses_no_table(share):
    """The table of mere noise takes it off again: what is left looks as if it acted twice."""
    rng, faults = np.random.default_rng(2), 0
    for _ in range(200):
        axis = rng.normal(0.0, share, N)
        before = axis + rng.normal(0.0, 1.0, N)
        found = judged(measured(before, 1.0), measured(axis - before + rng.normal(0, 1, N), 1.0))
        faults += found.fault is not None
    assert faults == 0


def test_an_error_that_both_share_cancels_and_less_may_be_left():
    """A table that acts by half is within U, but not within the scatter, of one instrument."""
    rng = np.random.default_rng(3)
    error = 5.0 * np.sin(3.0 * ANGLES)
    before = TRUE + error + rng.normal(0.0, 0.1, N)
    whole = np.hypot(5.0, 0.1)
    good = measured(TRUE - before + error + rng.normal(0.0, 0.1, N), whole)
    half = measured(TRUE - 0.5 * before + error + rng.normal(0.0, 0.1, N), whole)
    first = measured(before, whole)
    assert judged(first, half).verdict == "ok"
    assert judged(first, half, shared=5.0 * ARCSEC).verdict == "suspect"
    found = judged(first, good, shared=5.0 * ARCSEC)
    assert found.verdict == "ok"
    assert found.expected / ARCSEC == pytest.approx(4.0 * 0.1 * np.sqrt(2.0), rel=1e-9)
    assert found.to_dict()["shared_std_arcsec"] == pytest.approx(5.0)
    assert any("it cancels here" in code for code in codes(found))
    assert any("state it, for less may be left" in code for code in codes(judged(first, good)))
    with pytest.raises(DataError, match="nothing says how much may be left"):
        judged(first, good, shared=whole * ARCSEC)


def test_curves_are_compared_where_both_have_an_angle_and_never_between():
    every = np.arange(0, N, 3)
    second = np.append(ANGLES[every], 7.0 * DEGREE)
    found = judged(measured(TRUE), measured(np.append(TRUE[every], 300.0), angles=second))
    assert found.effect.factor == pytest.approx(1.0)
    assert len(found.before.angles) == len(every)
    assert "16 angles of the first and 1 of the second" in found.notes[0]
    with pytest.raises(DataError, match=r"b\.csv and a\.csv have 2 table angles in common"):
        judged(measured(TRUE), measured(np.arange(3.0), angles=np.r_[ANGLES[:2], 7.0 * DEGREE]))


def both_ways(mean, reversal):
    nothing = np.zeros((2 * N, 2 * N))
    up, down = ((mean + half) * ARCSEC for half in (reversal / 2.0, -reversal / 2.0))
    sides = {"ECC": Directions(ANGLES, up, down, nothing)}
    return replace(measured(mean), directions=sides)


def test_a_reversal_that_a_table_of_both_sides_takes_off_is_seen():
    found = judged(both_ways(TRUE, 4.0), both_ways(0.0 * TRUE, 0.0))
    assert found.before.systematic / ARCSEC == pytest.approx(np.ptp(TRUE) + 4.0)
    assert found.after.systematic == 0.0
    np.testing.assert_array_equal(found.before.angles, np.r_[ANGLES, ANGLES[::-1]])
    mixed = judged(both_ways(TRUE, 4.0), measured(0.0 * TRUE))
    assert mixed.before.systematic / ARCSEC == pytest.approx(np.ptp(TRUE))


@pytest.mark.parametrize(
    ("first", "second", "words"),
    [
        ({"verdict": "suspect", "warnings": ("a knock",)}, {}, "b.csv has the verdict suspect"),
        ({}, {"measured_on": NONE}, "a.csv: measured with no table in force"),
        ({"measured_on": "a" * 64}, {"measured_on": "a" * 64}, "both measured with table"),
        ({"circumstances": Circumstances(begun_ns=9)},
         {"circumstances": Circumstances(begun_ns=5)}, "a.csv was measured earlier than b.csv"),
        ({"circumstances": Circumstances(identity=Identity(serial="1"))},
         {"circumstances": Circumstances(identity=Identity(serial="2"))}, "serial number 1"),
    ],
)  # fmt: skip
def test_what_contradicts_that_a_table_was_loaded_between_is_refused(first, second, words):
    with pytest.raises(DataError) as refused:
        judged(measured(TRUE, **first), measured(0.01 * TRUE, **second))
    assert words in str(refused.value)


def test_the_same_numbers_twice_are_named():
    found = judged(measured(TRUE), measured(TRUE))
    assert found.verdict == "failed"
    assert "both hold the same numbers: is it one measurement, given twice?" in found.notes
