"""When the bag of a goal is closed."""

from types import SimpleNamespace

import pytest

pytest.importorskip("rclpy")
pytest.importorskip("rotcal_msgs")

from rotcal_ros.nodes.planner.node import GoalBag


class Service:
    """A service that is called at once, and answers so."""

    def __init__(self):
        self.called = False

    def call_async(self, _):
        self.called = True
        answer = SimpleNamespace(success=True, folder="session")
        return SimpleNamespace(done=lambda: True, result=lambda: answer)


class Watch(SimpleNamespace):
    async def call(self, client, request, _):
        return client.call_async(request).result()


def opened_bag(links):
    watch = Watch(links=links, tell=lambda _: None, recording=False)
    bag = GoalBag(SimpleNamespace(plan_id="plan", text=""), watch)
    with pytest.raises(StopIteration):
        bag.open(goes_on=False).send(None)
    return bag


@pytest.mark.parametrize("how", ["close", "close_after_failure"])
@pytest.mark.parametrize("lost", [False, True])
def test_it_is_closed_behind_the_last_observation_rejected_or_not(how, lost):
    stop, missing = Service(), []
    links = SimpleNamespace(
        observations={(7, 0): "rejected"},
        receipts={},
        health=SimpleNamespace(missing=lambda _: missing),
        services=SimpleNamespace(start_recording=Service(), stop_recording=stop),
    )
    closing = getattr(opened_bag(links), how)()
    for _ in range(3):
        closing.send(None)
        assert not stop.called
    if lost:
        missing.append("recorder is lost")  # it will not confirm any more
    else:
        links.receipts[7, 0] = 0
    for _ in closing.__await__():
        pass
    assert stop.called
