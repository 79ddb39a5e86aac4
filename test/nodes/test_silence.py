"""Silences are counted once each, per stream, from the beginning of a bag."""

from rotcal_ros.nodes.bookkeeping import Silences

TRACER, PROBE = "/cell/tracer_length", "/cell/probe_point"


def test_a_silence_counts_once_however_long_and_again_after_a_message():
    silences = Silences(2.0)
    silences.begin(100.0)
    for now_s in (101.0, 102.5, 103.0, 110.0):
        silences.look({TRACER: 100.0}, now_s)
    assert silences.counts == {f"silent {TRACER}": 1}
    silences.look({TRACER: 110.5}, 111.0)
    silences.look({TRACER: 110.5}, 113.0)
    assert silences.counts == {f"silent {TRACER}": 2}


def test_what_was_before_the_bag_and_streams_that_may_pause_do_not_count():
    silences = Silences(2.0)
    silences.begin(100.0)
    silences.look({TRACER: 3.0, PROBE: 3.0}, 101.9)
    silences.look({PROBE: 3.0}, 200.0)
    assert not silences.counts
    silences.look({TRACER: 3.0}, 200.0)
    silences.begin(300.0)
    silences.look({TRACER: 299.0}, 301.0)
    assert not silences.counts
