"""Units and clocks are those of the goal: a bag tells no others, and its result is the same."""

import json
from types import SimpleNamespace

from rotcal_ros.bags.topic_settings import TopicSettings
from rotcal_ros.nodes.instrument_topics import InstrumentTopics
from rotcal_ros.nodes.topic_names import TOPICS


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
