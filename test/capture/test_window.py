"""The reduction of one window against closed forms."""

from dataclasses import replace

import numpy as np
import pytest
from scipy import stats

from rotcal_ros.capture import CaptureSettings
from rotcal_ros.capture.window import ReadingFault, classify_readings, reduce_window
from rotcal_ros.foundation.observations import LengthStatus

LOOSE = CaptureSettings(max_std_m=1.0, max_drift_m=1.0, spike_floor_m=0.0)


def window(lengths):
    n = len(lengths)
    stamps = 1_000_000 * np.arange(n) + 10**18
    return stamps, np.column_stack([np.arange(n), lengths, np.zeros(n)])


@pytest.mark.parametrize(("distance", "used"), [(5.99, 101), (6.01, 100)])
def test_a_spike_is_beyond_so_many_robust_deviations(distance, used):
    """99 readings at -1, 0 and 1 um and one more at 0: the median absolute deviation is 1 um."""
    lengths = np.append(np.tile([-1e-6, 0.0, 1e-6], 33), [0.0, distance * 1.4826e-6])
    assert stats.median_abs_deviation(lengths) == pytest.approx(1e-6)
    assert reduce_window(*window(lengths), LOOSE).n_used == used


def test_the_floor_keeps_quantised_readings():
    lengths = np.append(np.zeros(50), 0.9e-7)
    assert reduce_window(*window(lengths), LOOSE).n_used == 50
    assert reduce_window(*window(lengths), replace(LOOSE, spike_floor_m=1e-7)).n_used == 51


def test_drift_is_the_change_of_the_regression_line():
    rng = np.random.default_rng(5)
    lengths = 3e-6 * np.linspace(0, 1, 40) + 1e-7 * rng.standard_normal(40)
    stamps, readings = window(lengths)
    slope = stats.linregress((stamps - stamps[0]) * 1e-9, lengths).slope
    drift_um = slope * (stamps[-1] - stamps[0]) * 1e-9 * 1e6
    reduced = reduce_window(stamps, readings, replace(LOOSE, max_drift_m=1e-6))
    assert reduced.reason == f"drifting: {drift_um:+.3g} um over the window, allowed 1 um"
    assert reduce_window(stamps, readings, replace(LOOSE, max_drift_m=4e-6)).reason is None


def test_numbers_agree_with_numpy():
    lengths = 0.123 + 1e-6 * np.random.default_rng(1).standard_normal(64)
    reduced = reduce_window(*window(lengths), LOOSE)
    assert reduced.mean == pytest.approx((np.mean(lengths),), abs=1e-16)
    assert reduced.scatter == pytest.approx((np.std(lengths, ddof=1),), rel=1e-9)
    assert reduced.std == pytest.approx((np.std(lengths, ddof=1) / 8,), rel=1e-9)


def test_fault_of_each_reading():
    ok, broken, unstable = LengthStatus.OK, LengthStatus.BEAM_BROKEN, LengthStatus.UNSTABLE
    status = np.array([ok, ok, ok, ok, broken, unstable, LengthStatus.UNKNOWN, 77])
    length = np.array([1.0, np.nan, -np.inf, -20.1, np.nan, 1.0, 1.0, 1.0])
    assert classify_readings(status, length, 20.0).tolist() == [
        ReadingFault.NONE,
        ReadingFault.NON_FINITE,
        ReadingFault.NON_FINITE,
        ReadingFault.IMPLAUSIBLE,
        ReadingFault.BEAM_BROKEN,
        ReadingFault.UNSTABLE,
        ReadingFault.UNKNOWN,
        ReadingFault.UNKNOWN,
    ]
