"""Where segments of unbroken beam begin."""

import numpy as np
import pytest

from rotcal_ros.capture.window import Beam

MS = 1_000_000


def follow(cuts, sequence=None, length=None, broken=(), unusable=(), stamps=None, fastest=10.0):
    """100 readings of 1 kHz, taken in pieces that end at ``cuts``."""
    stamps = MS * np.arange(100) if stamps is None else stamps
    sequence = np.arange(100.0) if sequence is None else sequence
    length = np.full(100, 0.5) if length is None else length
    dark = np.isin(np.arange(100), broken)
    usable = ~dark & ~np.isin(np.arange(100), unusable)
    beam = Beam(silence_s=0.02, fastest=fastest)
    for part in np.split(np.arange(100), cuts):
        beam.follow(stamps[part], sequence[part], length[part], usable[part], dark[part])
    return [beam.segment(-1, stamp, stamp) // 2 for stamp in stamps.tolist()]


@pytest.mark.parametrize("cuts", [[], [40], [39], [41], list(range(1, 100))])
def test_segments_do_not_depend_on_how_the_readings_are_cut(cuts):
    assert follow(cuts) == [0] * 100
    assert follow(cuts, broken=[40, 41]) == [0] * 42 + [1] * 58
    assert follow(cuts, broken=[0, 1, 40]) == [0] * 41 + [1] * 59  # before the first good one
    assert follow(cuts, unusable=[40, 41]) == [0] * 100
    assert follow(cuts, broken=[40], unusable=[39, 41, 42]) == [0] * 43 + [1] * 57


@pytest.mark.parametrize("cuts", [[], [40], list(range(1, 100))])
def test_a_restart_a_silence_and_a_leap_begin_a_segment(cuts):
    after = np.arange(100) >= 40
    assert follow(cuts, sequence=np.arange(100.0) - 40 * after) == [0] * 40 + [1] * 60
    wrapped = (np.arange(100.0) + 2**32 - 30) % 2**32
    assert follow(cuts, sequence=wrapped) == [0] * 100
    late = MS * (np.arange(100) + 30 * after)
    assert follow(cuts, stamps=late) == [0] * 100  # a slow instrument, nothing is missing
    missing = np.arange(100.0) + 30 * after
    assert follow(cuts, stamps=late, sequence=missing) == [0] * 40 + [1] * 60
    assert follow(cuts, sequence=missing) == [0] * 100
    leap = 0.5 + 0.02 * after
    assert follow(cuts, length=leap) == [0] * 40 + [1] * 60
    assert follow(cuts, length=0.5 + 0.0099 * np.arange(100)) == [0] * 100


def test_a_window_that_lost_the_beam_has_a_number_of_its_own():
    beam = Beam(silence_s=1.0, fastest=10.0)
    dark = np.isin(np.arange(100), [50])
    beam.follow(MS * np.arange(100), np.arange(100.0), np.full(100, 0.5), ~dark, dark)
    windows = [(0, 40), (45, 60), (60, 90)]
    numbers = [beam.segment(-1, MS * begin, MS * end) for begin, end in windows]
    assert len(set(numbers)) == 3
    assert beam.segment(55 * MS, 60 * MS, 90 * MS) == 0  # counted from a later begin


def test_a_slipped_fringe_is_a_leap_while_the_length_changes_slower_than_a_fringe_per_reading():
    after = np.arange(100) >= 40
    slow = 0.5 + 0.1e-3 * 1e-3 * np.arange(100)  # 0.1 mm/s
    assert follow([], length=slow + 0.3164e-6 * after, fastest=0.3e-3) == [0] * 40 + [1] * 60
    # as the reflector is carried every reading would be one: the limit has to be above its speed
    fast = 0.5 + 0.1 * 1e-3 * np.arange(100)
    assert follow([], length=fast, fastest=0.3e-3) == list(range(100))
    assert follow([], length=fast + 0.3164e-6 * after, fastest=0.11) == [0] * 100
