"""The bridge stands still while others call it: it answers late, by what is true by then."""

import os
import signal
import time

import pytest
from test_bridge import SECRET, Bench, table

pytest.importorskip("rclpy")
pytest.importorskip("rotcal_msgs")
pytestmark = pytest.mark.ros

STANDSTILL_S = 5.0 if os.environ.get("ROTCAL_LONG_TESTS") else 2.0


@pytest.fixture
def bench(cell, tmp_path):
    made = Bench(cell, tmp_path)
    yield made
    made.end()


def called(bench, kind, name, request):
    """Return the future of a call."""
    client = bench.node.create_client(kind, name)
    bench.wait(client.service_is_ready, name)
    return client.call_async(request)


def test_calls_and_tables_of_a_standstill_are_answered_by_what_is_true_behind_it(bench):
    from rotcal_msgs.msg import NodeState
    from rotcal_msgs.srv import ApplyTable, GetCorrection

    beats = bench.node.create_publisher(NodeState, "heartbeat", 10)
    beat = NodeState(node="planner", state=NodeState.STATE_READY)
    bench.node.create_timer(0.1, lambda: beats.publish(beat))
    bench.publish(table())
    bench.start()
    bench.wait_for_state("written, not applied")
    bench.wait(lambda: "apply_offered" in bench.status, "the services")
    request = ApplyTable.Request(confirmation=bench.status["confirmation"], secret=SECRET)
    newer = table(0.5)

    bench.live.processes.signal("bridge", signal.SIGSTOP)
    apply = called(bench, ApplyTable, "apply", request)
    correction = called(bench, GetCorrection, "get_correction", GetCorrection.Request(approach=1))
    bench.publish(newer)
    beat.state = NodeState.STATE_CALIBRATING
    until = time.monotonic() + STANDSTILL_S  # the standstill is the test's subject
    bench.wait(lambda: time.monotonic() > until, "the standstill")
    assert not apply.done()
    bench.live.processes.signal("bridge", signal.SIGCONT)

    bench.wait(apply.done, "the answer to apply")
    assert not apply.result().success
    assert "a calibration runs" in apply.result().message
    assert bench.files() == set()
    bench.wait(correction.done, "the correction")
    assert correction.result().success, correction.result().message
    bench.wait(lambda: bench.status["table_hash"] == newer.table_hash, "the newer table")
    beat.state = NodeState.STATE_READY
    bench.wait(lambda: bench.apply().success, "the newer table is applied")
