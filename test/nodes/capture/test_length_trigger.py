"""Asking an instrument for a length: what is said of one that never answers; no graph."""

from concurrent.futures import Future
from types import SimpleNamespace

import pytest

pytest.importorskip("rclpy")

from rotcal_ros.nodes.capture import node as capture
from rotcal_ros.nodes.capture.node import ANSWER_S, LengthTrigger


class Client:
    """A service that is there, and answers when the test does."""

    srv_name = "/distance/measure"

    def __init__(self):
        self.calls = []

    def service_is_ready(self):
        return True

    def call_async(self, _request):
        self.calls.append(Future())
        return self.calls[-1]

    def remove_pending_request(self, _call):
        pass


def test_an_instrument_that_never_answers_is_named_and_asked_again(monkeypatch):
    now = [100.0]
    monkeypatch.setattr(capture, "time", SimpleNamespace(monotonic=lambda: now[0]))
    client = Client()
    trigger = LengthTrigger(SimpleNamespace(create_client=lambda *_: client))
    trigger.serve("/distance/measure")
    trigger.poll(0, wanted=True)
    now[0] += ANSWER_S
    trigger.poll(0, wanted=True)
    assert (trigger.current_fault, len(client.calls)) == (None, 1)
    now[0] += 0.1
    trigger.poll(0, wanted=True)
    assert trigger.current_fault == (
        "the instrument took no length: no answer to /distance/measure in 30 s (length_trigger)"
    )
    assert len(client.calls) == 2
    client.calls[1].set_result(SimpleNamespace(success=True))
    trigger.poll(1, wanted=False)
    assert trigger.current_fault is None
