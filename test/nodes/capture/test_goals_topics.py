"""Units and clocks are those of the goal: a bag records no others, and its result is the same."""

import json
from types import SimpleNamespace

import pytest

pytest.importorskip("rclpy")
pytest.importorskip("rotcal_msgs")

from rotcal_ros.bags import names
from rotcal_ros.bags.settings import TopicSettings
from rotcal_ros.nodes.capture import instrument_streams
from rotcal_ros.nodes.capture.instrument_streams import InstrumentTopics
from rotcal_ros.nodes.runtime.beat_values import REFUSED, TOPICS, mismatched_topics


def heard(own, goal):
    """Return the settings in force under a goal, of a node with parameters, and its warnings."""
    told: list[str] = []
    health = SimpleNamespace(values=lambda _: {TOPICS: json.dumps(goal)}, beat=lambda: None)
    node = SimpleNamespace(
        given={"topics": own},
        settings=lambda _, kind: kind(**own),
        every=lambda _, work: timers.append(work),
        health=health,
        get_logger=lambda: SimpleNamespace(warning=told.append),
    )
    timers: list = []
    topics = InstrumentTopics(node, lambda _: None)
    assert topics.settings == TopicSettings(**own)
    for _ in range(2):
        timers[0]()
    return topics.settings, told


def test_units_and_clocks_of_the_nodes_own_do_not_outlast_a_goal():
    settings, told = heard({"length_unit": "mm", "length_clock_offset_s": 4.0}, {})
    assert settings == TopicSettings()
    (warning,) = told
    assert "topics.length_clock_offset_s, topics.length_unit" in warning


def test_names_of_the_nodes_own_stay_as_remapped_ones_do():
    settings, told = heard({"tracer_length": "/etalon"}, {"angle_unit": "deg"})
    assert settings == TopicSettings(tracer_length="/etalon", angle_unit="deg")
    assert told == []


def test_what_both_say_alike_is_worth_no_word():
    settings, told = heard({"length_unit": "mm"}, {"length_unit": "mm"})
    assert settings == TopicSettings(length_unit="mm")
    assert told == []


@pytest.mark.parametrize(("kind", "clock", "refused"), [
    ("std_msgs/msg/Float64", "stamp", True),
    ("sensor_msgs/msg/Range", "stamp", False),
    ("sensor_msgs/msg/Range", "sent", True),
])  # fmt: skip
@pytest.mark.parametrize("simulated", [True, False])
def test_the_time_of_sending_is_refused_under_a_simulated_clock(
    monkeypatch, kind, clock, refused, simulated
):
    chosen = []

    def subscription(_node, choose, _name, _take):
        chosen.append(choose)

    monkeypatch.setattr(instrument_streams, "InstrumentSubscription", subscription)
    node = SimpleNamespace(
        given={},
        settings=lambda _, kind: kind(length_clock=clock),
        every=lambda *_: None,
        health=SimpleNamespace(sim=SimpleNamespace(used=simulated)),
        get_namespace=lambda: "/cell",
        resolve_topic_name=lambda name: f"/cell/{name}",
        get_publishers_info_by_topic=lambda _: [],
    )
    topics = InstrumentTopics(node, lambda _: None)
    topics.listen(names.TRACER_LENGTH, lambda *_: None)
    assert chosen[0]([kind]) is not None
    text = topics.values().get(f"{REFUSED}{names.TRACER_LENGTH}", "")
    assert bool(text) == (refused and simulated)
    assert not text or ("/cell/tracer_length" in text and "use_sim_time" in text)


def test_names_that_the_planner_and_a_node_do_not_share_are_told():
    odd = list(mismatched_topics(lambda _: {}, "/cell", lambda role: f"/other/{role}"))
    assert odd[0].startswith("topic plan is /other/plan for the planner and /cell/plan for node")
