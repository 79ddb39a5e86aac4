"""Receipts wait for the readings of their window, whatever becomes of the clock of these."""

from rotcal_ros.nodes.recorder.bookkeeping import PendingReceipts

SECOND = 1_000_000_000
T = 1_700_000_000 * SECOND


def confirmed(receipts, reached_ns, now_s=0.0):
    return [receipt.step for receipt in receipts.due(reached_ns, 0, now_s)]


def test_a_receipt_waits_for_the_readings_of_its_window():
    receipts = PendingReceipts(answered=False)
    receipts.expect(1, 0, T)
    assert confirmed(receipts, T - 1) == []
    assert confirmed(receipts, T) == [1]


def test_readings_of_before_a_clock_was_set_back_have_come():
    receipts = PendingReceipts(answered=False)
    receipts.expect(1, 0, T)
    assert confirmed(receipts, T - SECOND // 100) == []
    assert confirmed(receipts, T - 45 * SECOND) == [1]
    receipts.expect(2, 0, T - SECOND // 50)  # on its way when the clock was set
    assert confirmed(receipts, T - 45 * SECOND + SECOND // 10) == [2]


def test_behind_it_a_receipt_waits_as_before():
    receipts = PendingReceipts(answered=False)
    for at in (T, T - 45 * SECOND, T - 44 * SECOND):
        receipts.reach(at)
    receipts.expect(3, 0, T - 43 * SECOND)
    assert confirmed(receipts, T - 43 * SECOND - 1) == []
    assert confirmed(receipts, T - 43 * SECOND) == [3]
    receipts.reach(T - 42 * SECOND)
    receipts.expect(4, 0, T - SECOND)  # half an hour on it would be long ago that it was set
    assert confirmed(receipts, T - 2 * SECOND) == []


def test_a_receipt_waits_for_the_point_that_answered_the_order():
    receipts = PendingReceipts(answered=True)
    receipts.answer(1, 0)
    receipts.expect(1, 1, T)
    assert confirmed(receipts, T + SECOND) == []  # that was the attempt before
    receipts.answer(1, 1)
    assert confirmed(receipts, T + SECOND) == [1]


def test_a_point_that_does_not_come_is_lost_so_that_its_step_is_measured_again():
    receipts = PendingReceipts(answered=True)
    receipts.expect(1, 0, T)
    assert confirmed(receipts, T - 1, now_s=0.0) == []
    assert confirmed(receipts, T - 1, now_s=100.0) == []  # its readings are on their way
    assert confirmed(receipts, T, now_s=101.0) == []
    assert confirmed(receipts, T, now_s=102.9) == []
    (receipt,) = receipts.due(T, 5, 103.1)
    assert (receipt.step, receipt.lost) == (1, 6)
    assert not receipts.is_answered(receipt)
    receipts.answer(2, 0)
    receipts.expect(2, 0, T)
    (receipt,) = receipts.due(T, 5, 104.0)
    assert (receipt.step, receipt.lost) == (2, 0)
    assert receipts.is_answered(receipt)
