"""Silences are counted once each, per stream, from the beginning of a bag."""

from rotcal_ros.nodes.recorder.bookkeeping import SilenceMonitor, SilentInterval

TRACER, PROBE = "/cell/tracer_length", "/cell/probe_point"


def test_a_silence_counts_once_however_long_and_again_after_a_message():
    silences = SilenceMonitor(2.0, 100.0)
    for now_s in (101.0, 102.5, 103.0, 110.0):
        silences.poll({TRACER: 100.0}, now_s)
    assert silences.counts == {f"silent {TRACER}": 1}
    silences.poll({TRACER: 110.5}, 111.0)
    silences.poll({TRACER: 110.5}, 113.0)
    assert silences.counts == {f"silent {TRACER}": 2}


def test_what_was_before_the_bag_and_streams_that_may_pause_do_not_count():
    silences = SilenceMonitor(2.0, 100.0)
    silences.poll({TRACER: 3.0}, 101.9)
    silences.poll({}, 200.0)
    assert not silences.counts
    silences = SilenceMonitor(2.0, 300.0)
    silences.poll({TRACER: 299.0}, 301.0)
    assert not silences.counts


def test_a_silence_is_told_when_it_ends_or_with_the_bag():
    silences = SilenceMonitor(2.0, 100.0)
    assert silences.poll({TRACER: 101.0}, 103.5) == []
    assert silences.poll({TRACER: 107.0}, 107.1) == [SilentInterval(TRACER, 101.0, 107.0)]
    assert silences.poll({TRACER: 107.0}, 109.5) == []
    assert silences.poll({TRACER: 109.6}, 112.0) == [SilentInterval(TRACER, 107.0, 109.6)]
    assert silences.end(113.0) == [SilentInterval(TRACER, 109.6, 113.0)]
    assert silences.counts == {f"silent {TRACER}": 3}
    assert silences.end(114.0) == []
