"""Losses are counted once, whoever reports them."""

from rotcal_ros.nodes.recorder.bookkeeping import TopicLosses

ONE, OTHER = b"1", b"2"


def taken(*numbers):
    losses = TopicLosses()
    for publisher, number in numbers:
        losses.number(number, publisher)
    return losses


def test_gaps_count_per_publisher():
    losses = taken((ONE, 7), (OTHER, 100), (ONE, 8), (ONE, 11), (OTHER, 102))
    assert losses.count == 3


def test_what_both_witnesses_tell_counts_once():
    losses = taken((ONE, 1))
    losses.report(2)
    losses.number(4, ONE)
    assert losses.count == 2


def test_what_only_the_middleware_knows_counts_too():
    losses = taken((ONE, 1), (ONE, 2))
    losses.report(3)  # behind the last message of a publisher that has ended
    assert losses.count == 3
    unnumbered = taken((ONE, 0), (ONE, None))
    unnumbered.report(1)
    assert unnumbered.count == 1


def test_a_new_bag_begins_at_zero_without_losing_the_thread():
    losses = taken((ONE, 1), (ONE, 5))
    losses.report(3)
    losses.forget()
    assert losses.count == 0
    losses.number(7, ONE)
    assert losses.count == 1


def test_each_witness_tells_only_what_is_new():
    losses = taken((ONE, 1))
    assert losses.report(2) == 2
    assert losses.number(4, ONE) == 0
    assert losses.number(5, ONE) is None
    assert losses.number(9, ONE) == 3
    assert losses.report(2) == 0
    assert losses.report(2) == 1
    assert losses.count == 6
