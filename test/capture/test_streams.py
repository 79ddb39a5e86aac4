"""A stream against its rules in a plain loop: what is kept, counted, forgotten; when to look."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from rotcal_ros.capture import streams as streams_module
from rotcal_ros.capture.streams import Stream
from rotcal_ros.capture.window import TracerStream

TOLERANCE = 100
STEPS = [-150, -1, 0, 0, 1, 1, 2, 50, 100, 101, 250]
"""Between stamps; more than 100 is a jump ahead."""


def by_the_rules(samples):
    """Return the kept samples and the counts, sample by sample.

    One that does not ascend is dropped. So is one that jumps ahead, but the tenth in a row.
    """
    kept, jumps = [], 0
    counts = {"received": len(samples), "duplicates": 0, "backwards": 0, "foreign_clock": 0}
    for stamp, value in samples:
        if kept and stamp <= kept[-1][0]:
            counts["duplicates" if (stamp, value) == kept[-1] else "backwards"] += 1
            continue
        if kept and stamp - kept[-1][0] > TOLERANCE:
            jumps += 1
            if jumps < 10:
                counts["foreign_clock"] += 1
                continue
        jumps = 0
        kept.append((stamp, value))
    return kept, counts


samples_of_a_stream = st.lists(
    st.tuples(st.sampled_from(STEPS), st.sampled_from([0.0, 1.0]), st.integers(1, 12)),
    min_size=1,
    max_size=40,
)


def expanded(drawn):
    """Stamps that walk from the last kept one, so that jumps come in rows."""
    samples, at = [], 1000
    for step, value, times in drawn:
        count = times if step > TOLERANCE else 1
        samples += [(at + step + k, value) for k in range(count)]
        if 0 < step <= TOLERANCE or times > 10:
            at = samples[-1][0]
    return samples


@pytest.mark.parametrize("way", ["one by one", "in lots", "staged in lots"])
@settings(max_examples=80, deadline=None)
@given(drawn=samples_of_a_stream, seed=st.integers(0, 2**32 - 1))
def test_samples_are_kept_counted_and_forgotten_by_the_rules(way, drawn, seed):
    samples = expanded(drawn)
    expected, counts = by_the_rules(samples)
    capacity = 7
    rng = np.random.default_rng(seed)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(streams_module, "CAPACITY", capacity)
        stream = Stream(1, TOLERANCE)
        left = list(samples)
        while left:
            lot = [left.pop(0) for _ in range(min(len(left), int(rng.integers(1, 12))))]
            stamps = np.array([stamp for stamp, _ in lot], dtype=np.int64)
            values = np.array([value for _, value in lot])
            if way == "one by one":
                for stamp, value in lot:
                    stream.stage(stamp, (value,))
                stream.flush()
            elif way == "in lots":
                stream.admit(stamps, values[:, None])
            else:
                stream.stage_many(stamps, (values,))
                stream.flush()
    n = len(stream.stamps)
    assert {name: getattr(stream.counts, name) for name in counts} == counts
    assert min(len(expected), capacity) <= n <= 2 * capacity
    assert stream.stamps.tolist() == [stamp for stamp, _ in expected[-n:]]
    assert stream.values.tolist() == [[value] for _, value in expected[-n:]]
    assert stream.latest == expected[-1][0]
    assert stream.forgotten == (expected[-n - 1][0] if len(expected) > n else None)


def test_memory_is_let_go_only_when_it_is_twice_full(monkeypatch):
    monkeypatch.setattr(streams_module, "CAPACITY", 8)
    stream = Stream(1, TOLERANCE)
    for stamp in range(16):
        stream.admit(np.array([stamp]), np.array([[float(stamp)]]))
    assert (len(stream.stamps), stream.forgotten) == (16, None)
    stream.admit(np.array([16]), np.array([[16.0]]))
    assert stream.stamps.tolist() == list(range(9, 17))
    assert stream.values.ravel().tolist() == list(range(9, 17))
    assert stream.forgotten == 8


def test_two_minutes_of_a_thousand_samples_a_second_are_remembered():
    stream = Stream(1, 10**6)
    count = 120_000
    stream.admit(np.arange(count) * 1000, np.arange(count)[:, None] * 1.0)
    stream.admit(np.arange(count, 2 * count) * 1000, np.arange(count, 2 * count)[:, None] * 1.0)
    assert len(stream.stamps) >= count
    for index in (0, -1):
        assert stream.values[index, 0] * 1000 == stream.stamps[index]


def test_a_sample_again_is_the_same_in_every_bit_no_number_included():
    stream = Stream(2, TOLERANCE)
    for values in ((1.0, np.nan), (1.0, np.nan), (1.0, 2.0)):
        stream.admit(np.array([5]), np.array([values]))
    assert (stream.counts.duplicates, stream.counts.backwards) == (1, 1)
    assert stream.counts.non_finite == 1
    stream.admit(np.array([6, 7]), np.array([(np.inf, np.nan), (np.nan, 0.0)]))
    assert stream.counts.non_finite == 3


def test_index_and_knowledge():
    stream = Stream(1, TOLERANCE)
    assert not stream.is_complete_until(0)
    stream.admit(np.array([10, 20, 30]), np.zeros((3, 1)))
    assert [stream.index(at) for at in (9, 10, 11, 20, 30, 31)] == [0, 0, 1, 1, 2, 3]
    assert [stream.is_complete_until(at) for at in (10, 30, 31)] == [True, True, False]


# When a decision is due.


def due(stream, *stamps):
    return [stream.stage(stamp, (0.0,)) for stamp in stamps]


def test_a_decision_is_due_at_the_stamp_and_with_the_samples_that_were_asked_for():
    stream = Stream(1, TOLERANCE)
    stream.flush()
    assert due(stream, 1) == [True]  # nobody has asked for less
    stream.flush()
    stream.wait(100)
    assert due(stream, 98, 99, 100) == [False, False, True]
    stream.flush()
    stream.wait(100, 3)
    assert due(stream, 101, 102, 103, 104) == [False, False, True, True]
    stream.flush()
    stream.wait(110, 9, 120)
    assert due(stream, 111, 119, 120, 121) == [False, False, True, True]
    stream.flush()
    stream.wait(200, 2)
    assert due(stream, 150, 151, 152, 200) == [False, False, False, True]


def test_samples_in_a_lot_are_due_by_the_newest_of_them():
    stream = Stream(1, TOLERANCE)
    stream.wait(100, 2)
    assert not stream.stage_many(np.array([], dtype=np.int64), (np.array([]),))
    assert not stream.stage_many(np.array([40, 50]), (np.zeros(2),))
    assert stream.stage_many(np.array([60, 100, 70]), (np.zeros(3),))
    stream.flush()
    assert stream.stamps.tolist() == [40, 50, 60, 100]


@pytest.mark.parametrize("lot", [1, 4096])
def test_so_many_samples_are_admitted_whatever_was_asked_for(lot):
    stream = Stream(1, TOLERANCE)
    stream.wait(10**9)
    answers = [
        stream.stage_many(np.arange(begin, begin + lot), (np.zeros(lot),))
        for begin in range(0, 4096, lot)
    ]
    assert answers == [False] * (4096 // lot - 1) + [True]
    stream.flush()
    assert len(stream.stamps) == 4096


# Sequence numbers of the tracer, 32 bits wide.

HALF, WHOLE = 1 << 31, 1 << 32


@pytest.mark.parametrize(
    ("sequence", "lost", "out_of_order"),
    [
        ([7, 8, 9], 0, 0),
        ([0, 3, 4, 6], 3, 0),
        ([WHOLE - 2, WHOLE - 1, 0, 1], 0, 0),
        ([WHOLE - 1, 2], 2, 0),
        ([5, 5, 6], 0, 1),
        ([5, 4, 5], 0, 1),
        ([0, HALF - 1], HALF - 2, 0),
        ([0, HALF], 0, 1),
    ],
)
@pytest.mark.parametrize("lot", [1, 9])
def test_lost_readings_and_those_out_of_order(sequence, lost, out_of_order, lot):
    stream = TracerStream(TOLERANCE, 20.0)
    stamps = np.arange(len(sequence))
    rows = np.column_stack([sequence, np.zeros((len(sequence), 2))])
    for begin in range(0, len(sequence), lot):
        stream.admit(stamps[begin : begin + lot], rows[begin : begin + lot])
    assert (stream.counts.lost, stream.counts.out_of_order) == (lost, out_of_order)
