"""A packet that had to be sent again is no clock that was set; one that was set is not hidden."""

from types import SimpleNamespace

from rotcal_ros.nodes.recorder.bookkeeping import JUMP_ON_ITS_WAY_S, LogTimes

S = 1_000_000_000


def times():
    """Return log times, and what the test says of clock and jumps."""
    said = SimpleNamespace(jumps=0, now_s=1000.0)
    return LogTimes(lambda: said.jumps, lambda: said.now_s), said


def test_messages_that_waited_for_one_sent_again_are_here_when_they_can_be_taken():
    made, _ = times()
    assert made.ascending("/a", [10 * S, 13 * S, 11 * S, 12 * S, 14 * S]) == [
        10 * S, 13 * S, 13 * S, 13 * S, 14 * S,
    ]  # fmt: skip
    assert made.ascending("/a", [13 * S, 15 * S]) == [14 * S, 15 * S]
    assert made.ascending("/b", [3 * S]) == [3 * S]  # each topic by itself


def test_a_clock_that_was_set_back_is_not_hidden_nor_what_was_on_its_way_meanwhile():
    made, said = times()
    made.ascending("/a", [100 * S])
    made.ascending("/b", [100 * S])
    said.jumps = 1
    assert made.ascending("/a", [40 * S, 41 * S]) == [40 * S, 41 * S]
    said.now_s += 1.0
    assert made.ascending("/b", [101 * S, 41 * S]) == [101 * S, 41 * S]
    said.now_s += JUMP_ON_ITS_WAY_S
    assert made.ascending("/a", [50 * S, 49 * S]) == [50 * S, 50 * S]
