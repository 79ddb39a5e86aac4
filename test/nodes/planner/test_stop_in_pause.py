"""Who resumes after work has to know of a stop that came meanwhile; no graph."""

from types import SimpleNamespace

import pytest

pytest.importorskip("rclpy")
pytest.importorskip("rotcal_msgs")

from std_srvs.srv import Trigger

from rotcal_ros.nodes.planner.cell_links import GoalPauses
from rotcal_ros.nodes.planner.measuring import require_resumable

BETWEEN = "not resumed: an emergency stop came in between: look, then resume again"


class Stop(SimpleNamespace):
    """A stop that was pressed and released as often as it says."""

    def check_stop(self):
        pass


@pytest.fixture
def waiting():
    """Return a stop, a function that begins a pause, and one that calls resume."""
    stop = Stop(why="", count=2)
    offered = {}
    node = SimpleNamespace(
        create_publisher=lambda *_: None,
        offer=lambda _kind, name, work: offered.update({name: work}),
    )
    pauses = GoalPauses(node, lambda: require_resumable(watch), lambda: "idle")
    health = SimpleNamespace(present=list)
    watch = SimpleNamespace(
        stop=stop, pauses=pauses, links=SimpleNamespace(health=health), silent_streams=dict
    )

    def resume():
        answer = offered["resume"](Trigger.Request(), Trigger.Response())
        return answer.message or answer.success

    return stop, lambda: pauses.begin("plan", 1, 7, stop.count), resume


def test_the_first_resume_after_a_stop_that_came_in_a_pause_is_refused(waiting):
    stop, begin, resume = waiting
    begin()
    stop.count += 1
    assert resume() == BETWEEN
    assert resume() is True


def test_every_stop_that_comes_in_a_pause_has_to_be_known_of(waiting):
    stop, begin, resume = waiting
    begin()
    stop.count, stop.why = 3, "/safety/estop is true"
    assert resume() == "not resumed: the emergency stop is on: /safety/estop is true"
    stop.why = None
    assert resume() == BETWEEN
    stop.count = 4
    assert resume() == BETWEEN
    assert resume() is True


def test_who_answers_the_stop_itself_is_believed_at_once(waiting):
    _, begin, resume = waiting
    begin()
    assert resume() is True
