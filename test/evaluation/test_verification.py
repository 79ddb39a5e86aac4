"""Before and after compensation: figures by hand, the verdict's limits, and the words of the file.

All numbers are exact in binary: one radian here may be as large as one likes.
"""

import json
from dataclasses import replace

import numpy as np
import pytest

from rotcal_ros.evaluation.iso230 import BidirectionalRuns, iso230
from rotcal_ros.evaluation.verification import Positioning, Verification, positioning
from rotcal_ros.foundation.errors import DataError
from rotcal_ros.foundation.results import Directions, Result
from rotcal_ros.foundation.units import ARCSEC

ANGLES = np.arange(4) * np.pi / 2
BEFORE = np.array([10.0, 0.0, 4.0, 2.0])
AFTER = np.array([2.0, 0.0, 1.0, 1.0])


def run(deviation, std=0.0):
    return Positioning(ANGLES, np.asarray(deviation), np.asarray(np.broadcast_to(std, 4)))


def test_range_and_scatter_by_hand():
    """The mean of 10, 0, 4, 2 is 4; the squares around it are 36, 16, 0, 4: together 56."""
    measured = run(BEFORE)
    assert measured.systematic == 10.0
    assert measured.rms == pytest.approx(np.sqrt(56.0 / 4.0), rel=1e-15)


def test_both_directions_are_one_range_and_go_up_and_down():
    """Up 10, 0, 4, 2 and down 13, 1, 4, -1: from -1 to 13."""
    up, down = BEFORE, np.array([13.0, 1.0, 4.0, -1.0])
    both = Directions(ANGLES, up, down, np.diag(np.arange(8.0) ** 2))
    mean = (up + down) / 2
    zero = {"ECC": np.zeros(4)}
    result = Result(
        "m", ANGLES, {"ECC": mean}, zero, {"ECC": np.zeros((4, 4))}, 1.0, 1, 1,
        directions={"ECC": both},
    )  # fmt: skip
    found = positioning(result)
    assert found.systematic == 14.0
    np.testing.assert_array_equal(found.angles, [*ANGLES, *ANGLES[::-1]])
    np.testing.assert_array_equal(found.deviation, [10, 0, 4, 2, -1, 4, 1, 13])
    np.testing.assert_array_equal(found.std, [0, 1, 2, 3, 7, 6, 5, 4])


def test_expected_are_four_standard_uncertainties_of_both_and_what_the_table_leaves():
    """4 x sqrt(3^2 + 4^2) + 0.5, of the largest uncertainties."""
    both = Verification(run(BEFORE, [1.0, 3.0, 2.0, 0.0]), run(AFTER, [4.0, 0.0, 0.0, 1.0]), 0.5)
    assert both.expected == 20.5


@pytest.mark.parametrize(
    ("stated", "verdict"), [(1.0, "ok"), (np.nextafter(1.0, 0.0), "suspect"), (2.0, "ok")]
)
def test_what_is_left_may_be_as_much_as_expected(stated, verdict):
    """2, 0, 1, 1 are at most 1 from their mean; without uncertainties that has to be stated."""
    assert Verification(run(BEFORE), run(AFTER), stated).verdict == verdict
    assert Verification(run(BEFORE), run(AFTER + 7.0), stated).verdict == verdict


@pytest.mark.parametrize(("least", "verdict"), [(0.0, "failed"), (1.0, "ok"), (-1.0, "failed")])
def test_a_range_that_is_not_smaller_has_failed(least, verdict):
    after = np.array([10.0, least, 4.0, 2.0])
    assert Verification(run(BEFORE), run(after), 100.0).verdict == verdict


def test_ratio_of_both_ranges_is_never_infinite():
    assert Verification(run(BEFORE), run(AFTER), 0.0).ratio == 5.0
    assert Verification(run(BEFORE), run(AFTER / 16.0), 0.0).ratio == 80.0
    assert Verification(run(BEFORE), run(np.zeros(4)), 0.0).ratio == pytest.approx(1e16)


def plain(deviation, std):
    """The entry of one run, its figures worked out by the standard library's rules."""
    arcsec = [value * 180.0 * 3600.0 / np.pi for value in deviation]
    mean = sum(arcsec) / 4.0
    return {
        "systematic_E_arcsec": pytest.approx(max(arcsec) - min(arcsec)),
        "rms_arcsec": pytest.approx((sum((x - mean) ** 2 for x in arcsec) / 4.0) ** 0.5),
        "largest_std_arcsec": pytest.approx(max(std) * 180.0 * 3600.0 / np.pi),
        "angles_deg": pytest.approx([0.0, 90.0, 180.0, 270.0]),
        "deviation_arcsec": pytest.approx(arcsec),
        "std_arcsec": pytest.approx([value * 180.0 * 3600.0 / np.pi for value in std]),
    }


def test_the_file_holds_everything_in_degrees_and_arcseconds():
    before, after = [3e-5, -1e-5, 2e-5, 0.0], [1e-6, 2e-6, 0.0, -1e-6]
    std = [1e-6, 2e-6, 3e-6, 4e-6]
    lines = {"before": "ok", "after": "suspect"}
    both = Verification(run(before, std), run(after, 2e-6), stated=5e-6, verdict_lines=lines)
    expected = {
        "schema": 1,
        "verdict": "ok",
        "verdict_lines": {"before": "ok", "after": "suspect"},
        "ratio": pytest.approx(40.0 / 3.0),
        "stated_residual_arcsec": pytest.approx(5e-6 * 206264.806247),
        "expected_at_most_arcsec": pytest.approx((4.0 * 20.0**0.5 + 5.0) * 0.206264806247),
        "before": plain(before, std),
        "after": plain(after, [2e-6] * 4),
    }
    assert json.loads(json.dumps(both.to_dict(), allow_nan=False)) == expected


def test_the_iso_figures_of_the_axis_are_added_where_they_are_known():
    """Two targets, two runs, both ways; s = half the distance of two runs times sqrt(2)."""
    up, down = np.array([[1.0, 3.0], [7.0, 7.0]]), np.array([[0.0, 0.0], [6.0, 6.0]])
    figures = iso230(BidirectionalRuns(np.array([0.0, 1.0]), up * ARCSEC, down * ARCSEC))
    both = Verification(run(BEFORE), run(AFTER), 0.0, {"before": figures, "after": figures})
    root = np.sqrt(2.0)
    expected = {
        "accuracy": pytest.approx(7.0 - (2.0 - 2.0 * root)),
        "repeatability": pytest.approx(max(2.0 * root + 2.0, 4.0 * root)),
        "systematic": pytest.approx(7.0),
        "reversal": pytest.approx(2.0),
        "mean_range": pytest.approx(6.5 - 1.0),
    }
    assert both.to_dict()["iso230_2_arcsec"] == {"before": expected, "after": expected}


def result(**deviations):
    return Result(
        method="simulated",
        angles=ANGLES,
        deviations=deviations,
        std={name: np.full(4, 1e-6) for name in deviations},
        covariance={},
        sigma0=1.0,
        dof=1,
        n_observations=5,
    )


def test_the_positioning_of_a_result_is_its_ecc():
    given = result(ECC=BEFORE, EXC=AFTER)
    found = positioning(replace(given, std={"ECC": AFTER, "EXC": BEFORE}))
    np.testing.assert_array_equal(found.angles, ANGLES)
    np.testing.assert_array_equal(found.deviation, BEFORE)
    np.testing.assert_array_equal(found.std, AFTER)
    with pytest.raises(DataError, match="the simulated result holds no ECC: no positioning"):
        positioning(result(EXC=AFTER))
