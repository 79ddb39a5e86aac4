"""Table at rest, and a window of readings: limits that are met exactly, rows, and words."""

from dataclasses import replace

import numpy as np
import pytest

from rotcal_ros.capture import CaptureSettings
from rotcal_ros.capture.streams import Stream
from rotcal_ros.capture.table import (
    angle_offset,
    arrival,
    at_rest,
    departure,
    largest_offset,
    mean_angle,
    why_not_at_rest,
)
from rotcal_ros.capture.window import (
    ReadingFault,
    ReducedWindow,
    classify_readings,
    mean_and_scatter,
    reduce_window,
)
from rotcal_ros.foundation.observations import LengthStatus
from rotcal_ros.foundation.units import ARCSEC, DEGREE

SETTINGS = CaptureSettings(
    position_tolerance_arcsec=16.0, velocity_tolerance_deg_s=0.5, table_silence_s=2.0
)
SECOND = 10**9
BIT = 2.0**-20
"""About a micrometre, exact in binary."""


def table(stamps, angles, velocities=0.0):
    stream = Stream(2, 10**15)
    stamps = np.asarray(stamps, dtype=np.int64)
    columns = np.broadcast_to(angles, stamps.shape), np.broadcast_to(velocities, stamps.shape)
    stream.admit(stamps, np.column_stack(columns).astype(np.float64))
    return stream


@pytest.mark.parametrize("sign", [-1.0, 1.0])
def test_at_rest_up_to_the_limits_themselves(sign):
    """An angle and a speed; both limits belong to rest."""
    far, fast = 16.0 * ARCSEC, 0.5 * DEGREE
    rows = np.array([
        [far, 0.0], [np.nextafter(far, 1.0), 0.0], [0.0, fast], [0.0, np.nextafter(fast, 1.0)],
        [far, fast], [np.nan, 0.0], [0.0, np.nan],
    ])  # fmt: skip
    found = at_rest(sign * rows, 0.0, SETTINGS)
    assert found.tolist() == [True, False, True, False, True, False, False]


def test_full_turns_do_not_count():
    turns = np.array([-7, -1, 0, 1, 30]) * 2.0 * np.pi
    np.testing.assert_allclose(angle_offset(turns + 0.7, 0.5), 0.2, atol=1e-12)
    np.testing.assert_allclose(angle_offset(turns - 2.0, 2.0), 2.0 * np.pi - 4.0, atol=1e-12)


@pytest.mark.parametrize("row", [0, 1, 511, 512, 513, 1024, 1599])
def test_the_first_feedback_at_rest_is_the_arrival_however_late(row):
    angles = np.full(1600, 0.3)
    angles[row:] = 0.1
    angles[row + 1 :: 2] = 0.3
    stream = table(10 + 5 * np.arange(1600), angles)
    assert arrival(stream, 0, 0.1, SETTINGS) == 10 + 5 * row
    assert arrival(stream, 10 + 5 * row, 0.1, SETTINGS) == 10 + 5 * row
    assert arrival(stream, 10 + 5 * 1600, 0.1, SETTINGS) is None
    assert arrival(stream, 0, 0.2, SETTINGS) is None


def test_a_departure_is_looked_for_up_to_the_first_feedback_past_the_end():
    """Feedback every second; it is off at 5 s, which is past an end at 4.5 s but not at 4 s."""
    stamps = np.arange(10) * SECOND
    angles = np.where(np.arange(10) == 5, 0.1, 0.0)
    stream = table(stamps, angles)
    assert departure(stream, 0, 4 * SECOND, 0.0, SETTINGS) is None
    assert departure(stream, 0, 4 * SECOND + 1, 0.0, SETTINGS) == 5 * SECOND + 1
    assert departure(stream, 6 * SECOND, 8 * SECOND, 0.0, SETTINGS) is None
    assert departure(stream, 5 * SECOND, 8 * SECOND, 0.0, SETTINGS) == 5 * SECOND + 1
    assert departure(stream, 5 * SECOND + 1, 8 * SECOND, 0.0, SETTINGS) is None


@pytest.mark.parametrize(("pause_ns", "wrong"), [(2 * SECOND, False), (2 * SECOND + 1, True)])
def test_a_pause_may_be_as_long_as_allowed(pause_ns, wrong):
    """The feedback after the pause is at rest itself: it may be the new arrival."""
    after = SECOND + pause_ns
    stream = table([0, SECOND, after, after + SECOND], 0.0)
    found = departure(stream, 0, after + SECOND, 0.0, SETTINGS)
    assert found == (after if wrong else None)
    late = table([pause_ns, pause_ns + 1], 0.0)  # counted from the begin, too
    assert departure(late, 0, pause_ns, 0.0, SETTINGS) == (pause_ns if wrong else None)


def test_mean_and_farthest_take_the_first_feedback_past_the_end_with_them():
    stream = table([0, 10, 20, 30, 40], np.array([9.0, 1.0, 2.0, 6.0, 99.0]) * BIT)
    assert mean_angle(stream, 10, 30, 0.0) == 3.0 * BIT
    assert mean_angle(stream, 1, 21, 0.0) == 3.0 * BIT
    assert mean_angle(stream, 10, 20, BIT) == 1.5 * BIT
    assert largest_offset(stream, 10, 21, 0.0) == 6.0 * BIT
    assert largest_offset(stream, 10, 20, 3.0 * BIT) == 2.0 * BIT


def test_why_a_table_is_not_at_rest_in_words():
    off = table([10 * SECOND, 12 * SECOND, 14 * SECOND], [0.9, 1.0, 2.0], 0.25 * DEGREE)
    commanded = 1.0 + 36.0 * ARCSEC
    assert why_not_at_rest(off, 9 * SECOND, 12 * SECOND, commanded, SETTINGS) == (
        "table not at rest in position for a whole window within 3 s: the last feedback is "
        "-36 arcsec off the commanded 57.3058 deg (allowed 16) at 0.25 deg/s (allowed 0.5)"
    )
    assert why_not_at_rest(off, 12 * SECOND + 1, 13 * SECOND, 1.0, SETTINGS) == (
        "no table feedback in the 1 s after the probe reached its target; the next is stamped 2 s "
        "later (another clock?)"
    )
    assert why_not_at_rest(off, 15 * SECOND, 16 * SECOND, 1.0, SETTINGS) == (
        "no table feedback in the 1 s after the probe reached its target"
    )


# Windows.

LOOSE = CaptureSettings(max_std_m=1.0, max_drift_m=1.0, spike_floor_m=1.0, min_used_share=0.01)


def reduced(lengths, sequence=None, status=None, **changes):
    n = len(lengths)
    sequence = np.arange(n) if sequence is None else sequence
    status = np.zeros(n) if status is None else status
    rows = np.column_stack([sequence, lengths, status]).astype(np.float64)
    return reduce_window(10**18 + 2**20 * np.arange(n), rows, replace(LOOSE, **changes))


def test_an_empty_reduction_has_no_numbers():
    assert ReducedWindow() == ReducedWindow((), (), (), 0, None)


@pytest.mark.parametrize(("bad", "accepted"), [(4, True), (5, False)])
def test_a_share_that_is_just_enough_is_enough(bad, accepted):
    status = np.where(np.arange(8) < bad, ReadingFault.UNSTABLE, ReadingFault.NONE)
    found = reduced(np.zeros(8), status=status, min_used_share=0.5)
    assert found.n_used == 8 - bad
    words = "only 3 of 8 readings usable: 5 unstable by its own status; expected at least 50%"
    assert found.reason == (None if accepted else words)


@pytest.mark.parametrize(("used", "accepted"), [(2, True), (1, False), (0, False)])
def test_two_readings_are_the_least(used, accepted):
    status = np.where(np.arange(3) < used, ReadingFault.NONE, ReadingFault.BEAM_BROKEN)
    found = reduced(np.arange(3.0), status=status)
    assert (found.reason is None) is accepted
    assert found.n_used == used
    assert found.mean == ((0.5,) if accepted else ())


def test_every_fault_is_named_in_order_with_its_number():
    status = [6, 4, 5, 3, 1, 2, 1, 0]
    found = reduced([0.0, 0.0, -30.0, 0.0, 0.0, 0.0, 0.0, 0.0], status=status, min_used_share=0.9)
    assert found.reason == (
        "only 1 of 8 readings usable: 2 beam broken, 1 unstable by its own status, 1 of unknown "
        "status, 1 not a finite number, 1 implausibly long, 1 spikes; expected at least 90%; "
        "found 30 m, plausible are 20 m (millimetres instead of metres?); "
        "topics.length_unit says which"
    )


def test_the_largest_implausible_reading_is_told():
    found = reduced([30.0, -45.0, 33.0, 0.0], status=[5, 5, 5, 0])
    assert "3 implausibly long; expected at least 1%; found 45 m" in found.reason


@pytest.mark.parametrize("share", [1.0, 0.999])
def test_scatter_up_to_its_limit(share):
    """+1, -1, 0, -1, +1 bits have the standard deviation 1 bit and no drift."""
    found = reduced(np.array([1.0, -1.0, 0.0, -1.0, 1.0]) * BIT, max_std_m=share * BIT)
    assert (found.mean, found.scatter) == ((0.0,), (BIT,))
    assert found.std[0] == pytest.approx(BIT / np.sqrt(5.0), rel=1e-15)
    words = "unstable: standard deviation 0.954 um of the readings, allowed 0.952721 um"
    assert found.reason == (None if share == 1.0 else words)


@pytest.mark.parametrize("sign", [-1.0, 1.0])
@pytest.mark.parametrize("share", [1.0, 0.999])
def test_drift_up_to_its_limit(share, sign):
    """0 .. 4 bits in equal steps of time: a drift of 4 bits."""
    found = reduced(sign * np.arange(5.0) * BIT, max_drift_m=4.0 * share * BIT)
    words = f"drifting: {sign * 3.81:+.3g} um over the window, allowed 3.81088 um"
    assert found.reason == (None if share == 1.0 else words)


@pytest.mark.parametrize(("share", "used"), [(1.0, 51), (0.999, 50)])
def test_the_floor_of_spikes_itself_is_no_spike(share, used):
    found = reduced(np.append(np.zeros(50), BIT), spike_floor_m=share * BIT)
    assert found.n_used == used


@pytest.mark.parametrize(
    ("sequence", "words"),
    [
        ([3, 4, 5, 6], ""),
        ([3, 4, 6, 9], "3 tracer readings lost in the window (sequence 4 to 6)"),
        ([3, 4, 4, 5], "tracer sequence goes from 4 to 4 in the window; expected 5"),
        ([3, 4, 2, 3], "tracer sequence goes from 4 to 2 in the window; expected 5"),
        ([3, 5, 5, 6], "tracer sequence goes from 3 to 5 in the window; expected 4"),
        ([0, 1, 1 + 2**31, 2 + 2**31], "tracer sequence goes from 1 to 2147483649 in the "
         "window; expected 2"),
        ([0, 1, 2**31, 1 + 2**31], "2147483646 tracer readings lost in the window (sequence 1 to "
         "2147483648)"),
        ([2**32 - 2, 2**32 - 1, 0, 1], ""),
    ],
)  # fmt: skip
def test_a_gap_goes_before_every_other_reason(sequence, words):
    """The two publishers are named only where a number comes again or goes back."""
    if "goes from" in words:
        words += " (two publishers on the topic?)"
    assert reduced(np.zeros(4), sequence).reason == (words or None)
    noisy = reduced(np.arange(4.0), sequence, max_std_m=0.0)
    assert noisy.reason == (words or "unstable: standard deviation 1.29e+06 um of the readings, "
                            "allowed 0 um")  # fmt: skip
    few = reduced(np.zeros(4), sequence, status=[1, 1, 1, 1])
    assert few.reason == (words or "only 0 of 4 readings usable: 4 beam broken; expected at "
                          "least 1%")  # fmt: skip


def test_lengths_up_to_the_limit_are_plausible():
    ok = float(LengthStatus.OK)
    length = np.array([20.0, -20.0, np.nextafter(20.0, 30.0), -21.0])
    assert classify_readings(np.full(4, ok), length, 20.0).tolist() == [
        ReadingFault.NONE, ReadingFault.NONE, ReadingFault.IMPLAUSIBLE, ReadingFault.IMPLAUSIBLE,
    ]  # fmt: skip


def test_mean_and_scatter_are_rounded_once():
    """1e16, 1, -1e16 and 1 have the mean 0.5; a running sum would lose the ones."""
    assert mean_and_scatter(np.array([1e16, 1.0, -1e16, 1.0]))[0] == 0.5
    assert mean_and_scatter(np.array([1.0, 3.0])) == (2.0, np.sqrt(2.0))
